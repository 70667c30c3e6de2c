"""Figures and report of a made-up run: thinning, broken lines, timelines, one page that needs no network."""

from __future__ import annotations

import dataclasses
import itertools
import json
import re

import numpy as np
import pytest
from test_eval_metrics import S, make_track
from test_eval_score import make_record

from riins_eval import plots
from riins_eval.figure import MOST_POINTS, thin
from riins_eval.report import write_report
from riins_eval.run_record import HealthChange, RunRecord


@pytest.fixture(scope="module")
def record() -> RunRecord:
    made = make_record(400)
    made.protection_radius = np.full(400, 12.0)
    made.aid_fixes = {"gps": (made.truth.stamp_ns, made.truth.lat, made.truth.lon)}
    made.notes = ["GPS <is> simulated"]
    made.expect = {"position_rms_m": {"max": 0.5}}
    return made


def test_thinning_keeps_the_extremes_and_the_limit():
    y = np.random.default_rng(1).normal(size=43200)
    y[777], y[40000] = 50.0, -60.0
    x, thinned = thin(np.arange(43200.0), y)
    assert len(x) <= MOST_POINTS
    assert thinned.max() == 50.0 and thinned.min() == -60.0
    assert (np.diff(x) > 0).all()
    assert (y[x.astype(int)] == thinned).all()


def test_every_figure_is_made_and_none_is_too_large(record):
    long = make_track(43200)
    big = dataclasses.replace(record, settled=long, truth=make_track(43200, 1), covariance=None, twin=None, oracle=None, protection_radius=None)
    for one in (record, big):
        made = plots.figures(one)
        assert [f.key for f in made] == ["track", "position", "velocity", "attitude", "innovations", "health"]
        for figure in made:
            for panel in figure.panels:
                assert all(len(t.x) == len(t.y) <= MOST_POINTS + 2 for t in panel.traces)
                assert all(len(b.x) == len(b.low) == len(b.high) for b in panel.bands)


def test_a_line_breaks_at_the_gap_between_pieces(record):
    stamps = record.settled.stamp_ns.copy()
    stamps[200:] += 600 * S
    shifted = dataclasses.replace(record.settled, stamp_ns=stamps)
    gapped = dataclasses.replace(record, settled=shifted, truth=dataclasses.replace(record.truth, stamp_ns=stamps), twin=None)
    error = next(f for f in plots.figures(gapped) if f.key == "position").panels[0].traces[0]
    assert np.isnan(error.y).sum() == 1
    assert len(error.y) == 401


def test_bands_are_three_sigma(record):
    panel = next(f for f in plots.figures(record) if f.key == "position").panels[0]
    assert panel.bands[0].high == pytest.approx(3.0)
    assert panel.bands[0].low == pytest.approx(-3.0)


def test_the_timeline_covers_the_run_without_holes(record):
    panel = next(f for f in plots.figures(record) if f.key == "health").panels[0]
    assert panel.rows[0] == "gyro_0" and panel.rows[-1] == "gps" and len(panel.rows) == 13
    for row in panel.rows:
        bars = [b for b in panel.bars if b.row == row and b.state != "fault"]
        assert bars[0].start == 0.0 and bars[-1].stop == pytest.approx(399.0)
        assert all(a.stop == b.start for a, b in itertools.pairwise(bars))
    assert [b.state for b in panel.bars if b.row == "gyro_2"] == ["healthy", "isolated", "fault"]


def test_a_fluttering_sensor_does_not_drown_the_timeline(record):
    flutter = [HealthChange(S + i * S // 10, "gyro_1", 1 + i % 2 if i % 3 else 0) for i in range(3900)]
    panel = next(f for f in plots.figures(dataclasses.replace(record, health=flutter)) if f.key == "health").panels[0]
    bars = [b for b in panel.bars if b.row == "gyro_1"]
    assert len(bars) <= 2001
    assert bars[0].start == 0.0 and bars[-1].stop == pytest.approx(399.0)


def test_the_report_is_one_page_with_pictures_and_numbers(record, tmp_path):
    page = write_report(record, tmp_path / "report")
    text = page.read_text()
    outside = re.sub(r"<script>.*?</script>", "", text, flags=re.DOTALL)
    assert not re.search(r"(?:src|href)=['\"]?(?:https?:)?//", outside)
    assert text.count("plotly.js v") <= 2 and outside.count("class=card>") >= 5
    assert "not as expected" in text and "position_rms_m is 0.9987" in text
    assert "GPS &lt;is&gt; simulated" in text
    embedded = json.loads(re.search(r"id=score>(.*?)</script>", text).group(1))
    assert embedded == json.loads((tmp_path / "report" / "score.json").read_text())
    for name in ("track", "position", "velocity", "attitude", "innovations", "health"):
        picture = (tmp_path / "report" / f"{name}.png").read_bytes()
        assert picture[:8] == b"\x89PNG\r\n\x1a\n" and len(picture) > 8000
        assert f"plot_{name}" in text
