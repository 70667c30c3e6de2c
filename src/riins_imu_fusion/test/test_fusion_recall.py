"""Law 4: what a sensor put in between the onset of its fault and its isolation is known, to the sensors' noise; nothing else is recalled."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from riins_core.rotation import exp_so3, log_so3
from riins_core.sensor_errors import normal
from riins_fdi.health import HealthState
from riins_imu_fusion.config import FusionConfig, SensorHealth
from riins_imu_fusion.pipeline import FusionPipeline
from riins_imu_fusion.types import FusedBlock, Reason, Recall, join

DT, DT_S = 10_000_000, 0.01
ALL = 0b111111
CONFIG = FusionConfig(method="wls")
SIGMA = CONFIG.sigma()[:, 0]
TURN = np.array([0.0, 0.0, np.radians(1.5)])
GRAVITY = np.array([0.0, 0.0, -9.8])
ARCMIN = np.radians(1.0 / 60.0)


class Turn:
    """Samples 1 .. m of a unit that turns at 1.5 deg/s, or as told, to be spoilt by a test."""

    def __init__(self, m: int, seed: int = 1, noise: float = 1.0, rate: np.ndarray = TURN, force: np.ndarray = GRAVITY) -> None:
        H = CONFIG.array().H
        self.m, self.stamp, self.sequence = m, np.arange(1, m + 1, dtype=np.int64) * DT, np.arange(1, m + 1).astype(np.uint32)
        self.gyro = np.broadcast_to(rate, (m, 3)) @ H.T + noise * SIGMA[0] * normal(seed, 0, 0, m, 6)
        self.accel = np.broadcast_to(force, (m, 3)) @ H.T + noise * SIGMA[1] * normal(seed, 1, 0, m, 6)
        self.valid = np.full(m, ALL, np.uint64)

    def into(self, pipeline: FusionPipeline, start: int = 0, stop: int | None = None) -> FusedBlock:
        part = slice(start, stop)
        return pipeline.process(self.stamp[part], self.sequence[part], self.gyro[part], self.accel[part], self.valid[part], self.valid[part])


def entered(block: FusedBlock, fault: np.ndarray, kind: str, sensor: int) -> tuple[np.ndarray, float]:
    """What a known fault (m,) did to the integral in the samples it was fused in, in the body at each sample: (m, 3), and how many these were."""
    used, array = getattr(block, f"{kind}_used"), CONFIG.array()
    out = np.zeros((len(block), 3))
    for mask in np.unique(used):
        if int(mask) >> sensor & 1:
            out[used == mask] = np.outer(fault[used == mask], array.least_squares(int(mask))[:, sensor]) * DT_S
    return out, float(np.count_nonzero((used >> np.uint64(sensor)) & np.uint64(1) & (fault != 0.0)))


def in_the_end(parts: np.ndarray, last: int) -> np.ndarray:
    """Sum of contributions (m, 3) up to sample `last`, turned at the constant rate TURN from the middle of each to the end of the last."""
    ago = (last - np.arange(last + 1) + 0.5) * DT_S
    return np.einsum("kij,kj->i", exp_so3(-np.outer(ago, TURN)), parts[: last + 1])


def only(block: FusedBlock) -> Recall:
    assert len(block.recalls) == 1
    return block.recalls[0]


def shape(name: str, size: float, onset: int, m: int) -> np.ndarray:
    """A step of `size`, or a ramp of `size` a second, from sample `onset` on."""
    since = np.maximum(np.arange(m) - onset + 1, 0)
    return size * np.minimum(since, 1) if name == "step" else size * since * DT_S


CASES = [("step", 6.0), ("step", 7.0), ("ramp", 0.53), ("ramp", 3.0)]


@pytest.mark.parametrize(("name", "size"), CASES)
@pytest.mark.parametrize("seed", range(4))
def test_the_angle_recalled_is_what_entered(name: str, size: float, seed: int) -> None:
    """Steps in sigma of a sample, ramps in sigma a second (0.53: that of the harbour voyage), in a turn; three sigma of the 5-sensor noise."""
    feed, pipeline, onset = Turn(7000, 10 + seed), FusionPipeline(CONFIG), 4003
    fault = shape(name, size * SIGMA[0], onset, feed.m)
    feed.gyro[:, 2] += fault
    block = feed.into(pipeline)
    recall = only(block)
    last = recall.stamp_ns // DT - 1
    parts, samples = entered(block, fault, "gyro", 2)
    truth = in_the_end(parts, last)
    column = np.linalg.norm(CONFIG.array().least_squares()[:, 2])
    sigma = column * SIGMA[0] * DT_S * np.sqrt(2.0 * samples * (1.0 + samples / onset))  # var f = 2 sigma^2 with six sensors; and of the mean before
    assert np.linalg.norm(recall.angle - truth) < 3.0 * sigma < 0.5 * np.linalg.norm(truth)
    assert (recall.kind, recall.index) == ("gyro", 2) and abs(recall.onset_ns * 1e-9 - onset * DT_S) < (0.3 if name == "step" else 3.0)
    event = next(e for e in pipeline.drain_events() if e.state is HealthState.ISOLATED)
    age, arcmin = (recall.stamp_ns - recall.onset_ns) * 1e-9, np.linalg.norm(recall.angle) / ARCMIN
    assert event.text == f"gyro_2 suspect -> isolated (parity test, since {age:.1f} s; recalled {arcmin:.2f} arcmin)"


@pytest.mark.parametrize("seed", range(3))
def test_the_velocity_recalled_is_what_entered(seed: int) -> None:
    feed, pipeline, onset = Turn(6000, 20 + seed), FusionPipeline(CONFIG), 4003
    fault = shape("ramp", 1.0 * SIGMA[1], onset, feed.m)
    feed.accel[:, 5] += fault
    block = feed.into(pipeline)
    recall = only(block)
    parts, samples = entered(block, fault, "accel", 5)
    truth = in_the_end(parts, recall.stamp_ns // DT - 1)
    column = np.linalg.norm(CONFIG.array().least_squares()[:, 5])
    sigma = column * SIGMA[1] * DT_S * np.sqrt(2.0 * samples * (1.0 + samples / onset))
    assert np.linalg.norm(recall.velocity - truth) < 3.0 * sigma < 0.3 * np.linalg.norm(truth)
    assert not recall.angle.any()


def integrate(block: FusedBlock, until_ns: int) -> tuple[np.ndarray, np.ndarray]:
    """Attitude and velocity in the axes of the start."""
    C, v = np.eye(3), np.zeros(3)
    for rate, force in zip(block.rate[block.stamp_ns <= until_ns], block.force[block.stamp_ns <= until_ns], strict=True):
        v = v + C @ exp_so3(0.5 * rate * DT_S) @ force * DT_S
        C = C @ exp_so3(rate * DT_S)
    return C, v


@pytest.mark.parametrize(("kind", "fault"), [("gyro", "ramp"), ("gyro", "stuck"), ("accel", "ramp"), ("accel", "stuck")])
def test_taken_out_it_leaves_what_the_others_alone_give(kind: str, fault: str) -> None:
    """A unit that rolls, heaves and turns, almost without noise: with the recall the integrals are those of a pipeline told at the onset."""
    m, onset, sensor = 3000, 1000, 3
    t = np.arange(1, m + 1)[:, None] * DT_S
    rate = TURN + np.array([0.1, 0.04, 0.01]) * np.cos(0.8 * t + [0.0, 1.0, 2.0])
    force = GRAVITY + np.array([0.3, 0.5, 0.8]) * np.cos(0.9 * t + [0.5, 1.5, 2.5])
    feed = Turn(m, noise=0.01, rate=rate, force=force)
    values = getattr(feed, kind)
    if fault == "ramp":
        values[:, sensor] += shape("ramp", 1.6 * SIGMA[("gyro", "accel").index(kind)], onset, m)
    else:
        values[onset:, sensor] = values[onset, sensor]
    config = replace(CONFIG, stuck_count=40, mean_time_between_false_alarms_h=1e9 if fault == "ramp" else 10.0)
    if fault == "stuck":  # so that the parity test leaves it to the count
        config = replace(config, gyro_bias_sigma=0.1, accel_bias_sigma=10.0)
    told, other = FusionPipeline(config), FusionPipeline(config)
    told.set_sensor_use(f"{kind}_{sensor}", False, int(feed.stamp[onset]))
    block = feed.into(other)
    recall = only(block)
    reference, velocity = integrate(feed.into(told), recall.stamp_ns)
    C, v = integrate(block, recall.stamp_ns)
    corrected = C @ exp_so3(-recall.angle)
    before, after = log_so3(reference.T @ C), log_so3(reference.T @ corrected)
    if kind == "gyro":
        assert np.linalg.norm(after) < 0.01 * np.linalg.norm(before)
        assert np.linalg.norm(recall.angle) > 0.1 * ARCMIN
    else:
        assert not recall.angle.any()
    assert np.linalg.norm(v - corrected @ recall.velocity - velocity) < 0.03 * np.linalg.norm(v - velocity)
    state, reason = next((e.state, e.reason) for e in other.drain_events() if e.state is HealthState.ISOLATED)
    assert state is HealthState.ISOLATED and reason == (Reason.PARITY if fault == "ramp" else Reason.STUCK)


def test_false_alarms_recall_nothing() -> None:
    """Healthy sensors, isolated again and again by a test that is far too strict: none has a past to be taken out."""
    config = replace(CONFIG, false_alarm_probability=0.03, health=SensorHealth(hold_s=0.5, probation_s=1.0))
    feed, pipeline = Turn(60_000, 3), FusionPipeline(config)
    block = feed.into(pipeline)
    isolated = [e for e in pipeline.drain_events() if e.state is HealthState.ISOLATED]
    assert len(isolated) > 50 and not block.recalls


@pytest.mark.parametrize("kind", ["gyro", "accel"])
def test_a_turn_on_bias_is_not_recalled(kind: str) -> None:
    """A sensor that is off from the beginning is isolated sooner or later, but nothing began: its bias is part of the fused one."""
    feed, pipeline = Turn(6000, 4), FusionPipeline(CONFIG)
    getattr(feed, kind)[:, 1] += 5.5 * SIGMA[("gyro", "accel").index(kind)]
    block = feed.into(pipeline)
    first = next(e for e in pipeline.drain_events() if e.state is HealthState.ISOLATED)
    assert (first.kind, first.index) == (kind, 1) and not block.recalls


def test_the_bias_before_the_onset_stays() -> None:
    feed, pipeline, onset = Turn(6000, 5), FusionPipeline(CONFIG), 4003
    fault = shape("ramp", 1.0 * SIGMA[0], onset, feed.m)
    feed.gyro[:, 2] += fault - 2.0 * SIGMA[0]
    block = feed.into(pipeline)
    parts, samples = entered(block, fault, "gyro", 2)
    truth = in_the_end(parts, only(block).stamp_ns // DT - 1)
    column = np.linalg.norm(CONFIG.array().least_squares()[:, 2])
    sigma = column * SIGMA[0] * DT_S * np.sqrt(2.0 * samples * (1.0 + samples / onset))
    bias = column * 2.0 * SIGMA[0] * DT_S * samples
    assert np.linalg.norm(only(block).angle - truth) < 3.0 * sigma < 0.3 * bias


def test_samples_it_was_left_out_of_do_not_count() -> None:
    """A gross step never enters: there is nothing to recall."""
    feed, pipeline = Turn(3000, 6), FusionPipeline(CONFIG)
    feed.gyro[2000:, 0] += 50.0 * SIGMA[0]
    assert not feed.into(pipeline).recalls
    assert any(e.state is HealthState.ISOLATED for e in pipeline.drain_events())


def test_nothing_is_recalled_twice() -> None:
    """It fails, is isolated, heals, returns and fails again within the window."""
    config = replace(CONFIG, health=SensorHealth(hold_s=0.5, probation_s=1.0))
    feed, pipeline = Turn(5000, 7), FusionPipeline(config)
    fault = np.zeros(feed.m)
    for onset, stop in ((1500, 2500), (3500, 5000)):
        fault[onset:stop] = shape("ramp", 2.0 * SIGMA[0], onset, stop)[onset:]
    feed.gyro[:, 4] += fault
    block = feed.into(pipeline)
    assert [recall.index for recall in block.recalls] == [4, 4]
    parts, _ = entered(block, fault, "gyro", 4)
    for recall, begin in zip(block.recalls, (1500, 3500), strict=True):
        truth = in_the_end(np.where(np.arange(feed.m)[:, None] >= begin, parts, 0.0), recall.stamp_ns // DT - 1)
        assert recall.onset_ns // DT > begin - 100
        assert np.linalg.norm(recall.angle - truth) < 0.15 * np.linalg.norm(truth)


def test_a_restart_forgets_the_past() -> None:
    feed, pipeline = Turn(5000, 8), FusionPipeline(CONFIG)
    feed.gyro[:, 2] += shape("step", 7.0 * SIGMA[0], 3995, feed.m)
    feed.stamp[4000:] += 10_000_000_000
    block = feed.into(pipeline)
    assert pipeline.counters.restarts == 1 and not block.recalls
    assert any(e.state is HealthState.ISOLATED for e in pipeline.drain_events())


def test_the_window_bounds_what_is_recalled_and_can_be_off() -> None:
    angles = []
    for window in (0.0, 3.0, 60.0):
        feed, pipeline = Turn(7000, 9), FusionPipeline(replace(CONFIG, recall_window_s=window))
        feed.gyro[:, 2] += shape("ramp", 0.53 * SIGMA[0], 3000, feed.m)
        recalls = feed.into(pipeline).recalls
        angles.append(sum(np.linalg.norm(recall.angle) for recall in recalls))
    assert angles[0] == 0.0 and 0.0 < angles[1] < 0.6 * angles[2]


def test_recalls_of_one_sample_are_added_up() -> None:
    block = Turn(20, 1).into(FusionPipeline(CONFIG))
    one, two = Recall(50_000_000, "gyro", 1, 7, np.array([1.0, 2.0, 3.0]), np.zeros(3)), Recall(50_000_000, "accel", 2, 3, np.zeros(3), np.ones(3))
    angle, velocity, onset = FusedBlock(**{**block._asdict(), "recalls": (one, two)}).recalled()
    assert np.flatnonzero(onset).tolist() == [4] and onset[4] == 3
    assert angle[4].tolist() == [1.0, 2.0, 3.0] and velocity[4].tolist() == [1.0, 1.0, 1.0] and angle.sum() == 6.0 and velocity.sum() == 3.0


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 1000), st.lists(st.integers(1, 400), min_size=1, max_size=20))
def test_law_3_blocks_change_no_recall(seed: int, lengths: list[int]) -> None:
    rng, m, results = np.random.default_rng(seed), 2500, []
    feed = Turn(m, seed)
    for values, sigma in ((feed.gyro, SIGMA[0]), (feed.accel, SIGMA[1])):
        values[:, rng.integers(6)] += shape("ramp", rng.uniform(2.0, 6.0) * sigma, int(rng.integers(300, 1500)), m)
    cuts = [0, *np.clip(np.cumsum(lengths), 0, m).tolist(), m]
    for edges in ([0, m], cuts, range(m + 1)):
        pipeline = FusionPipeline(CONFIG)
        block = join([feed.into(pipeline, a, b) for a, b in itertools.pairwise(edges)])
        results.append(([column.tobytes() for column in block.recalled()], pipeline.drain_events()))
        assert len(block.recalls) >= 2
    assert results[0] == results[1] == results[2]
