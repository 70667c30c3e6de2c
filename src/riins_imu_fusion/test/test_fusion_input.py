"""What the fusion pipeline refuses, leaves out and counts: bad values, stamps, numbers, axes, commands."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fusion_feed import ALL, CONFIG, DT, Feed, changes, in_use, state

from riins_fdi.health import HealthState
from riins_fdi.parity import Capability
from riins_imu_fusion.pipeline import FusionPipeline
from riins_imu_fusion.types import Counters, Reason

BAD_VALUES = [(np.nan, Reason.NOT_FINITE), (np.inf, Reason.NOT_FINITE), (2.0, Reason.SATURATED), (None, Reason.INVALID)]


@pytest.mark.parametrize(("value", "reason"), BAD_VALUES)
def test_a_bad_value_in_one_axis_is_left_out_and_counted(value: float | None, reason: Reason) -> None:
    feed, pipeline = Feed(300), FusionPipeline(replace(CONFIG, gyro_limit=2.0))
    for k in (50, 100, 101, 102, 103):
        if value is None:
            feed.gyro_valid[k] &= ~np.uint64(8)
        else:
            feed.gyro[k, 3] = value
    block = feed.into(pipeline, 0, 104)
    used = in_use(block.gyro_used, 3)
    assert len(block) == 104 and np.isfinite(block.rate).all() and np.all(block.accel_used == ALL)
    assert not used[[50, 100, 101, 102, 103]].any() and used[51:100].all()
    assert changes(pipeline) == [
        ("gyro", 3, "SUSPECT", reason), ("gyro", 3, "HEALTHY", 0), ("gyro", 3, "SUSPECT", reason), ("gyro", 3, "ISOLATED", reason)]  # fmt: skip
    status = pipeline.status().gyro
    assert status.left_out[3, reason] == 4 and status.left_out.sum() == 4  # the last one found it isolated already
    assert status.reason[3] == reason and status.since_ns[3] == feed.stamp[102]
    feed.into(pipeline, 104)
    assert state(pipeline, 3) is HealthState.HEALTHY


def test_a_stuck_value_is_found_within_the_threshold() -> None:
    """Held at its last value on a steady platform, the parity test cannot see it."""
    feed, pipeline = Feed(200), FusionPipeline(replace(CONFIG, stuck_count=8))
    feed.accel[100:150, 2] = feed.accel[99, 2]
    block = feed.into(pipeline)
    used = in_use(block.accel_used, 2)
    assert used[:106].all() and not used[106:150].any()  # sample 106 is the eighth of the same value
    assert changes(pipeline)[:2] == [("accel", 2, "SUSPECT", Reason.STUCK), ("accel", 2, "ISOLATED", Reason.STUCK)]
    assert in_use(feed.into(FusionPipeline(replace(CONFIG, stuck_count=0))).accel_used, 2).all()


def test_an_outage_of_the_whole_unit_isolates_nobody() -> None:
    feed, pipeline = Feed(300), FusionPipeline(CONFIG)
    feed.gyro[100:200, :4] = np.nan
    block = feed.into(pipeline)
    assert len(block) == 200 and block.stamp_ns[100] == feed.stamp[200] and np.all(block.gyro_used == ALL)
    assert pipeline.counters == Counters(300, 200, 0, 0, 0, 100, 0, 0)
    assert [(e.kind, e.stamp_ns // DT, e.text) for e in pipeline.drain_events()] == [
        ("stream", 101, "no solution: too few usable axes of gyro"),
        ("stream", 201, "solution again"),
    ]


def test_capability_says_no_solution_while_there_is_none() -> None:
    feed, pipeline = Feed(10), FusionPipeline(CONFIG)
    feed.gyro[9, :4] = np.nan
    feed.into(pipeline)
    status = pipeline.status()
    assert status.gyro.capability is Capability.NO_SOLUTION and status.accel.capability is Capability.ISOLATES
    assert np.isnan(status.gyro.threshold) and status.gyro.parity.size == 0 and np.isnan(pipeline.rate_covariance(0b110000)).all()


def test_stamps_that_go_back_a_little_are_rejected() -> None:
    feed, pipeline = Feed(100), FusionPipeline(CONFIG)
    feed.stamp[50] = feed.stamp[49]
    feed.stamp[60] = feed.stamp[40]
    block = feed.into(pipeline)
    assert len(block) == 98 and np.all(np.diff(block.stamp_ns) > 0) and 51 not in block.sequence and 61 not in block.sequence
    assert pipeline.counters == Counters(100, 98, 0, 0, 2, 0, 0, 0)  # rejected is not lost


@pytest.mark.parametrize("jump", [2_000_000_001 - DT, -2_000_000_001 - DT])
def test_a_stamp_that_jumps_restarts_the_run(jump: int) -> None:
    feed, pipeline = Feed(900), FusionPipeline(CONFIG)
    feed.stamp[500:] += jump
    feed.gyro[400:500, 0] += 1e-3  # isolated when the jump comes
    pipeline.set_sensor_use("gyro_1", False)
    block = feed.into(pipeline)
    assert len(block) == 900 and pipeline.counters == Counters(900, 900, 0, 0, 0, 0, 1, 0)
    event = next(e for e in pipeline.drain_events() if e.kind == "restart")
    assert event.stamp_ns == feed.stamp[500] and event.text == f"restart: the stamp jumped by {(jump + DT) / 1e9:+.3f} s"
    assert np.all(block.gyro_used[500:] == 0b111101)  # what the machines decided is forgotten, the operator's word is not


def test_a_jump_of_just_max_delay_does_not_restart() -> None:
    feed, pipeline = Feed(100), FusionPipeline(CONFIG)
    feed.stamp[50:] += 2_000_000_000 - DT
    feed.into(pipeline)
    assert pipeline.counters.restarts == 0


def test_lost_samples_are_counted_across_the_wrap_of_the_number() -> None:
    feed, pipeline = Feed(100), FusionPipeline(CONFIG)
    feed.sequence = (np.arange(100, dtype=np.uint64) + np.uint64(2**32 - 50)).astype(np.uint32)
    keep = np.ones(100, bool)
    keep[[10, 11, 49, 50, 51, 99]] = False
    for name in ("stamp", "sequence", "gyro", "accel", "gyro_valid", "accel_valid"):
        setattr(feed, name, getattr(feed, name)[keep])
    feed.into(pipeline)
    assert pipeline.counters.lost == 5 and pipeline.counters.fused == 94  # the last one is not missed yet


def test_a_new_numbering_is_no_loss() -> None:
    feed, pipeline = Feed(100), FusionPipeline(CONFIG)
    feed.sequence[50:] += 5_000_000
    feed.sequence[70:] -= 5_000_000
    feed.into(pipeline)
    assert pipeline.counters.lost == 0


def test_a_wrong_number_of_axes_is_rejected() -> None:
    feed, pipeline = Feed(300), FusionPipeline(CONFIG)
    feed.into(pipeline, 0, 10)
    whole, feed.gyro = feed.gyro, feed.gyro[:, :5]
    assert len(feed.into(pipeline, 10, 200)) == 0
    feed.gyro = whole
    assert len(feed.into(pipeline, 200)) == 100
    assert pipeline.counters == Counters(300, 110, 0, 190, 0, 0, 0, 0)
    assert [e.text for e in pipeline.drain_events()] == ["rejected: 5 gyros and 6 accelerometers instead of 6 each"] * 2  # one a second
    with pytest.raises(ValueError, match="one row for each sample"):
        pipeline.process(feed.stamp, feed.sequence[:-1], feed.gyro, feed.accel, feed.gyro_valid, feed.accel_valid)


def test_operator_excludes_from_a_stamp_on_and_restores_through_probation() -> None:
    feed, pipeline = Feed(600), FusionPipeline(CONFIG)
    assert pipeline.set_sensor_use("gyro_2", False, int(feed.stamp[200])) == (True, feed.stamp[200], "gyro_2: excluded from 2.010 s on")
    assert pipeline.set_sensor_use("gyro_2", True, int(feed.stamp[300]) - 1).success
    used = in_use(feed.into(pipeline).gyro_used, 2)
    assert used[:200].all() and not used[200:401].any() and used[401:].all()  # tested from sample 300 to 400
    assert changes(pipeline) == [("gyro", 2, "EXCLUDED", 6), ("gyro", 2, "PROBATION", 6), ("gyro", 2, "HEALTHY", 7)]


@pytest.mark.parametrize("target", ["gyro_6", "gyro_", "gyro_-1", "gps", "accel", "fog_1", ""])
def test_commands_for_nobody_are_refused(target: str) -> None:
    pipeline = FusionPipeline(CONFIG)
    result = pipeline.set_sensor_use(target, False)
    assert not result.success and "gyro_0 .. gyro_5" in result.message and pipeline.counters.commands_refused == 1


def test_a_command_whose_stamp_has_passed_is_refused_and_counted() -> None:
    feed, pipeline = Feed(100), FusionPipeline(CONFIG)
    feed.into(pipeline)
    assert not pipeline.set_sensor_use("accel_0", False, int(feed.stamp[-1])).success
    assert pipeline.counters.commands_refused == 1 and pipeline.status().accel.state == (0,) * 6
    far = pipeline.set_sensor_use("accel_0", False, int(feed.stamp[-1]) + 10**17)
    assert far == (False, 0, "accel_0: the effective stamp lies 1157 days ahead of the newest sample")
    far = pipeline.set_method("opt", effective_ns=int(feed.stamp[-1]) + 10**17)
    assert not far.success and pipeline.counters.commands_refused == 3
    now = pipeline.set_sensor_use("accel_0", False)
    assert now.success and now.effective_ns == feed.stamp[-1] + 1
