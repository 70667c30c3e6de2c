"""The alignment study: table 2 comes back, the numbers of targets 45 to 49 with few seeds, target 50 where the recording is at hand.

Does not live here: tests of the methods themselves (riins_core, riins_federated).
"""

import math
from pathlib import Path

import numpy as np
import pytest

from riins_core.sensor_errors import DEG
from riins_eval.reproduce import missed
from riins_eval.studies import alignment, alignment_at_sea, alignment_recording

DATA = Path(__file__).resolve().parents[3].parent / "shared" / "data"


@pytest.mark.parametrize("states", [7, 10])
def test_table_2_of_seed_001(states):
    for i, angle in enumerate(alignment.ANGLES):
        error, history = alignment.seed_001(states, angle, False, 0)
        _, pitch, roll = alignment.TABLE_2[states][i]
        assert np.abs(error[[1, 0]]) / DEG == pytest.approx(np.abs([pitch, roll]), rel=0.15)
        assert history.t[-1] == 600.0


def test_the_chapter_at_rest_reaches_every_target():
    done = []
    rows, figures = alignment.run(2, True, done.append)
    assert not missed(rows) and {r.target for r in rows} == {45, 46, 47, 48, None}
    assert done == sorted(done) and len({f.name for f in figures}) == 5
    ranks = {r.name: r.value for r in rows if r.name.startswith("rank")}
    assert ranks["rank, 12 states"] == 9.0 and ranks["rank, 3 states of the thesis, heading 0°"] == 2.0


def test_one_ship_under_way_and_where_no_recording_is(tmp_path):
    found, history, truth = alignment_at_sea.in_motion("log", 0)
    assert found.sigma[2] < 0.3 * DEG and history.refused == 0 and len(truth.t) == 401
    rows, figures = alignment_recording.run(1, True, lambda part: None, tmp_path)
    assert len(rows) == 1 and rows[0].ok is None and "skipped" in rows[0].remark and not figures


@pytest.mark.skipif(not (DATA / "snapir_open.npz").is_file(), reason="the sea recording is not on this machine (../shared/data/snapir_open.npz)")
def test_target_50_on_the_sea_recording():
    found = [alignment_recording.align_piece(p, p.log) for p in alignment_recording.prepare(DATA / "snapir_open.npz")[1:7:2]]
    assert not any(f.refused for f in found)
    assert math.sqrt(np.mean([f.error[-1] ** 2 for f in found])) <= 0.3 * DEG  # 0.6 are allowed
