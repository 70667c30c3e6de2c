"""`glr_kf` in the pipeline: health of a compensated sensor, isolation of a dead one, blocks, covariance, nothing changed without a fault."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from riins_fdi.health import HealthState
from riins_imu_fusion.config import FusionConfig
from riins_imu_fusion.pipeline import FusionPipeline
from riins_imu_fusion.types import FusedBlock, join

DT = 10_000_000
GLR = FusionConfig(method="glr_kf")
RATE, FORCE = np.array([1e-3, -2e-3, 5e-4]), np.array([0.2, -0.1, -9.8])


class Feed:
    """m samples of six and six sensors at 100 Hz."""

    def __init__(self, m: int, seed: int = 0) -> None:
        rng = np.random.default_rng(seed)
        H, self.sigma = GLR.array().H, GLR.sigma()[:, :1]
        self.stamp = DT * (1 + np.arange(m, dtype=np.int64))
        self.gyro = H @ RATE + self.sigma[0] * rng.standard_normal((m, 6))
        self.accel = H @ FORCE + self.sigma[1] * rng.standard_normal((m, 6))

    def into(self, pipeline: FusionPipeline, a: int = 0, b: int | None = None) -> FusedBlock:
        s = slice(a, b)
        m = len(self.stamp[s])
        valid = np.full(m, 0b111111, np.uint64)
        return pipeline.process(self.stamp[s], np.arange(a, a + m), self.gyro[s], self.accel[s], valid, valid)


def test_without_a_fault_it_is_least_squares_to_the_bit() -> None:
    feed = Feed(3000)
    one, other = feed.into(FusionPipeline(GLR)), feed.into(FusionPipeline(FusionConfig()))
    for name in FusedBlock._fields:
        assert np.array_equal(getattr(one, name), getattr(other, name)), name


@pytest.mark.parametrize("kind", ["gyro", "accel"])
def test_a_drift_is_compensated_and_the_covariance_says_so(kind: str) -> None:
    """Three sigma: a single sample cannot tell it; least squares fuses it for ever, here the sensor is kept without its drift."""
    index = ("gyro", "accel").index(kind)
    feed, twin = Feed(6000, 1), Feed(6000, 1)
    getattr(feed, kind)[1500:, 4] += 3.0 * feed.sigma[index]
    pipeline, clean = FusionPipeline(GLR), FusionPipeline(GLR)
    block, other = feed.into(pipeline), twin.into(clean)
    states = [(e.index, e.state) for e in pipeline.drain_events() if e.kind == kind]
    assert states[-1] == (4, HealthState.COMPENSATED) and all(i == 4 for i, _ in states)
    status = getattr(pipeline.status(), kind)
    assert status.state[4] == int(HealthState.COMPENSATED) and status.used == 0b111111 and not status.doubtful
    assert abs(pipeline.drift[index, 4] / feed.sigma[index, 0] - 3.0) < 0.8 and np.count_nonzero(pipeline.drift) == 1
    fused, clear = (block.rate, other.rate) if kind == "gyro" else (block.force, other.force)
    column = np.linalg.norm(GLR.array().least_squares()[:, 4]) * 3.0 * feed.sigma[index, 0]
    assert np.linalg.norm((fused - clear)[1500:].sum(axis=0)) < 0.03 * 4500 * column  # with what went in before the detection
    excess = block.gyro_excess if kind == "gyro" else block.accel_excess
    assert np.all(excess[:1500] == 0.0)
    # honest: the covariance of the error that the removal leaves, but for the ordinary bias (one sigma of noise here), which the twin shares
    late = (fused - clear)[5000:]
    assert np.all(np.linalg.eigvalsh(excess[5999] - np.outer(late.mean(axis=0), late.mean(axis=0)) / 9.0) > -1e-3 * np.trace(excess[5999]))


def test_a_drift_beyond_the_limit_is_isolated_and_returns() -> None:
    feed = Feed(9000, 2)
    feed.gyro[1000:4000, 2] += feed.sigma[0] * np.minimum(0.01 * np.arange(3000), 15.0)
    pipeline = FusionPipeline(GLR)
    feed.into(pipeline)
    states = [e.state for e in pipeline.drain_events() if e.kind == "gyro" and e.index == 2]
    assert HealthState.COMPENSATED in states and HealthState.ISOLATED in states
    assert states.index(HealthState.COMPENSATED) < states.index(HealthState.ISOLATED)
    assert pipeline.status().gyro.state[2] == int(HealthState.HEALTHY)


def test_law_3_blocks_change_nothing() -> None:
    feed = Feed(4000, 3)
    feed.gyro[800:, 1] += 3.0 * feed.sigma[0]
    feed.accel[1200:, 5] -= 2.0 * feed.sigma[1]
    feed.gyro[2000:2004, 3] = np.nan
    feed.accel[2500:, 2] += 30.0 * feed.sigma[1]
    results = []
    for lengths in ([4000], [1] * 4000, [7, 993] * 4):
        pipeline = FusionPipeline(GLR, statuses=True)
        edges = np.cumsum([0, *lengths]).tolist()
        whole = join([feed.into(pipeline, a, b) for a, b in itertools.pairwise(edges)])
        results.append((whole, pipeline.drain_events(), [s.gyro.drift.tobytes() + s.accel.drift.tobytes() for s in pipeline.drain_statuses()]))
    for other in results[1:]:
        for name in FusedBlock._fields[:-1]:
            assert np.array_equal(getattr(results[0][0], name), getattr(other[0], name), equal_nan=True), name
        assert results[0][1] == other[1] and results[0][2] == other[2]


def test_an_ambiguous_pair_is_said_to_be_doubtful() -> None:
    feed = Feed(4000, 4)
    feed.gyro[1000:, 0] += 2.5 * feed.sigma[0]
    feed.gyro[1000:, 2] -= 2.5 * feed.sigma[0]
    pipeline = FusionPipeline(GLR)
    feed.into(pipeline)
    status = pipeline.status().gyro
    assert status.doubtful and status.state == (0,) * 6
