"""Bookkeeping of a live run, and how it is printed.

Lives here: tests of riins_bringup.monitor and riins_bringup.table on made-up observations.
Does not live here: ROS.
"""

from __future__ import annotations

import math

import pytest
from rich.console import Console

from riins_bringup.monitor import Monitor, NavRow
from riins_bringup.table import angle, change_line, live_table, not_comparable, plain_line, summary_table

START = 1_800_000_000_000_000_000
STEP = 10_000_000
LATITUDE = math.radians(54.0)


def row(k: int, north_m: float = 0.0, heading: float = 1.0, sequence: int | None = None, mode: int = 2) -> NavRow:
    return NavRow(START + k * STEP, k if sequence is None else sequence, LATITUDE + north_m / 6_380_000.0, 0.3, 0.0, 3.0, 0.0, heading, mode)


@pytest.fixture
def fed() -> Monitor:
    monitor = Monitor(START, wall_stamps=True, rate=1.0, score_from_s=1.0)
    for k in range(1, 201):
        stamp = START + k * STEP
        late = 20_000_000 if k % 50 == 0 else 3_000_000
        monitor.arrived("nav/state", stamp + late)
        monitor.nav_state(row(k, north_m=100.0 if k < 100 else 2.0), stamp + late)
        if k % 10 == 0:
            monitor.truth_state(row(k))
    return monitor


def test_latency_is_arrival_minus_stamp(fed):
    latency = fed.summary()["latency_ms"]
    assert latency["p50"] == pytest.approx(3.0, abs=1e-6) and latency["max"] == pytest.approx(20.0, abs=1e-6)


def test_no_latency_when_stamps_are_not_wall_time():
    for monitor in (Monitor(START, wall_stamps=False), Monitor(START, wall_stamps=True, rate=3.0)):
        monitor.nav_state(row(1), START + STEP)
        assert monitor.summary()["latency_ms"] is None


def test_errors_count_from_the_scoring_time_and_only_at_equal_stamps(fed):
    summary = fed.summary()
    assert summary["position_rms_m"] == pytest.approx(2.0, rel=5e-3) and summary["position_max_m"] < 2.1
    assert summary["velocity_rms_mps"] == 0.0 and summary["heading_rms_arcmin"] == 0.0


def test_truth_may_come_first_and_headings_wrap():
    monitor = Monitor(START)
    monitor.truth_state(row(1, heading=2.0 * math.pi - 1e-4))
    monitor.nav_state(row(1, heading=1e-4), START)
    assert monitor.summary()["heading_rms_arcmin"] == pytest.approx(math.degrees(2e-4) * 60.0)


def test_waiting_navigator_is_not_scored():
    monitor = Monitor(START)
    monitor.nav_state(row(1, north_m=5000.0, mode=0), START)
    monitor.truth_state(row(1))
    assert monitor.summary()["position_rms_m"] is None


def test_gap_in_sequence_is_lost_states():
    monitor = Monitor(START)
    for k in (1, 2, 5, 6):
        monitor.nav_state(row(k), START)
    assert monitor.summary()["samples"]["nav_states_lost"] == 2


def test_changes_of_health_are_news_suspicion_is_not():
    monitor = Monitor(START)
    for t, state in ((1, "healthy"), (2, "suspect"), (3, "healthy"), (4, "isolated"), (4, "isolated"), (5, "probation"), (6, "healthy")):
        monitor.health(START + t * 10**9, "gps", state, "innovation")
    summary = monitor.summary()
    assert [(c["state"], c["at_s"]) for c in summary["changes"]] == [("isolated", 4.0), ("probation", 5.0), ("healthy", 6.0)]
    assert summary["isolations"] == [{"target": "gps", "at_s": 4.0, "reason": "innovation"}]
    assert len(monitor.changes_since(2)) == 1


def test_rate_over_the_last_seconds(fed):
    assert fed.snapshot(START + 200 * STEP).rates_hz["nav/state"] == pytest.approx(100.0, rel=0.02)
    assert fed.snapshot(START + 60 * 10**9).rates_hz["nav/state"] == 0.0


def test_memory_is_bounded():
    monitor = Monitor(START)
    for k in range(1, 6000):
        monitor.nav_state(row(k), START)
        monitor.truth_state(row(k + 100_000))
    assert len(monitor._nav_by_stamp) == len(monitor._truth_by_stamp) == 2048


def printed(renderable) -> str:
    console = Console(width=160, record=True, file=open("/dev/null", "w"))
    console.print(renderable)
    return console.export_text()


def test_table_and_plain_line_show_the_figures(fed):
    fed.health(START + 10**9, "gyro_2", "isolated", "parity")
    fed.health(START + 10**9, "gps", "healthy", "none")
    fed.subfilter("gps", {"accepted": 5, "rejected": 1, "late": 0, "malformed": 0, "statistic": 1.5, "threshold": 23.0})
    fed.counts(lost=3, navigator_lost=4)
    snapshot = fed.snapshot(START + 200 * STEP)
    text = printed(live_table("harbour", snapshot, 150.0))
    for word in ("54° 00.001' N", "057.296°", "navigating", "2 isolated", "used 5 rejected 1", "p50", "gyro_2 isolated (parity)"):
        assert word in text, word
    line = plain_line(snapshot)
    assert "error 2.0" in line and "lost 4" in line and "gyro_2 isolated" in line and "\n" not in line
    assert change_line(snapshot.changes[0], snapshot).endswith("1.00 s  gyro_2 isolated (parity)")


def test_everything_prints_before_the_first_message():
    snapshot = Monitor(START).snapshot(START)
    assert "waiting" in printed(live_table("harbour", snapshot, 150.0)) and "waiting" in plain_line(snapshot)


@pytest.mark.parametrize(
    ("samples", "line"),
    [
        ({"lost": 0, "restarts": 0}, ""),
        ({}, ""),
        ({"lost": 2, "navigator_lost": 3, "restarts": 0}, "not comparable: 3 samples lost, 0 restarts"),
        ({"lost": 0, "restarts": 1}, "not comparable: 0 samples lost, 1 restarts"),
    ],
)
def test_lost_samples_and_restarts_are_said(samples, line):
    assert not_comparable(samples) == line


def test_summary_prints(fed):
    text = printed(summary_table({"title": "harbour", "ended": "completed", "bag": "out/b", "logs": "/tmp/x", **fed.summary()}))
    assert "completed" in text and "3.0, 20.0, 20.0 ms" in text and "out/b" in text


@pytest.mark.parametrize(
    ("degrees", "letters", "text"), [(54.5, "NS", "54° 30.000' N"), (-0.25, "EW", "00° 15.000' W"), (59.99999999, "NS", "60° 00.000' N")]
)
def test_angle_as_on_a_chart(degrees, letters, text):
    assert angle(math.radians(degrees), letters) == text
