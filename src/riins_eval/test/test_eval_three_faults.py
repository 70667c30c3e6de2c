"""Three inertial faults one after another, shortened: the scenario's own promises hold with both methods of fusion, and a sabotaged run breaks them.

Lives here: the shipped scenario `three_faults` offline.
Does not live here: its 20 seeds and live runs (bench/three_faults.py), the faults one by one (riins_imu_fusion).
"""

from __future__ import annotations

import dataclasses
from typing import Any

import pytest

from riins_eval import metrics
from riins_eval.offline import RunResult, sail
from riins_eval.score import verdict
from riins_sim.scenario import load

ONSETS = {"gyro_1": 20.0, "accel_5": 60.0, "gyro_3": 75.0}


def shortened(fusion: dict[str, Any]) -> RunResult:
    """100 s of the scenario with the same faults, earlier."""
    scenario = load("three_faults")
    faults = tuple(dataclasses.replace(fault, start_s=ONSETS[fault.target]) for fault in scenario.faults)
    return sail(dataclasses.replace(scenario, duration_s=100.0, faults=faults, fusion=fusion))


@pytest.mark.parametrize(("method", "limit"), [("wls", 1.25), ("glr_kf", 1.1)])  # wls finds the drift after a quarter of the time
def test_nothing_is_fused_after_its_isolation_and_the_error_stays_that_of_the_twin(method: str, limit: float) -> None:
    run = shortened({"method": method})
    ratios = {
        key: {"max": limit} for key in run.expect if key.startswith("oracle_ratio.")
    }  # in so short a run the time until the isolation weighs more
    assert len(ratios) == 3 and verdict(run.score, run.expect | ratios) == []
    assert [fault["target"] for fault in run.score["faults"]] == list(ONSETS)
    assert [fault["epochs_fused"] for fault in run.score["faults"]] == [0, 0, 0]
    record = run.record
    assert record.twin is not None
    counts = record.settled.stamp_ns >= record.scoring_from_ns
    truth, own, twin = (track.take(counts) for track in (record.truth, record.settled, record.twin))
    position = [metrics.rms(metrics.position_error(track, truth)[:, :2]) for track in (own, twin)]
    velocity = [metrics.rms((track.v_n - truth.v_n)[:, :2]) for track in (own, twin)]
    assert position[0] < limit * position[1] and velocity[0] < limit * velocity[1]


def test_the_promises_are_broken_where_no_fault_can_be_isolated() -> None:
    run = shortened({"method": "wls", "false_alarm_probability": 1e-300, "stuck_count": 0})
    failures = verdict(run.score, run.expect)
    assert any("accel_5" in line and "isolated" in line for line in failures)
