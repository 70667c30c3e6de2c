"""Ordinary biases: no jump when a sensor leaves, what a navigator says of them, honest covariance of a compensated sample."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from riins_fdi.health import HealthState
from riins_imu_fusion.config import FusionConfig
from riins_imu_fusion.known_bias import KnownBias
from riins_imu_fusion.pipeline import FusionPipeline
from riins_imu_fusion.types import FusedBlock

DT = 10_000_000
SIGMA = FusionConfig().sigma()[:, 0]
CONFIG = FusionConfig(method="glr_kf", gyro_bias_sigma=5.0 * SIGMA[0], accel_bias_sigma=5.0 * SIGMA[1])
W = CONFIG.array().least_squares()
TRUE = (np.array([1e-3, -2e-3, 5e-4]), np.array([0.2, -0.1, -9.8]))


class Unit:
    """Six and six sensors with biases of 5 sigma, drawn by seed."""

    def __init__(self, m: int, seed: int) -> None:
        rng = np.random.default_rng(seed)
        self.bias = 5.0 * SIGMA[:, None] * rng.standard_normal((2, 6))
        self.z = [CONFIG.array().H @ TRUE[k] + self.bias[k] + SIGMA[k] * rng.standard_normal((m, 6)) for k in range(2)]
        self.stamp = DT * np.arange(1, m + 1)

    def into(self, pipeline: FusionPipeline, a: int = 0, b: int | None = None) -> FusedBlock:
        s = slice(a, b)
        m = len(self.stamp[s])
        valid = np.full(m, 0b111111, np.uint64)
        return pipeline.process(self.stamp[s], np.arange(a, a + m), self.z[0][s], self.z[1][s], valid, valid)


def tell(pipeline: FusionPipeline, unit: Unit, effective_ns: int, sigma: float, seed: int) -> bool:
    """What a navigator would say that knows the bias of the fused output to `sigma` of a sample's noise."""
    error = sigma * SIGMA[:, None] * np.random.default_rng(seed).standard_normal((2, 3))
    P = [sigma**2 * SIGMA[k] ** 2 * np.eye(3) for k in range(2)]
    c = [W @ unit.bias[k] + error[k] for k in range(2)]
    return pipeline.add_calibration(effective_ns, c[0], P[0], c[1], P[1]).success


def test_the_bias_does_not_jump_when_a_sensor_leaves() -> None:
    jumps = {"glr_kf": [], "wls": []}
    for seed in range(12):
        for method, found in jumps.items():
            unit, pipeline = Unit(2000, seed), FusionPipeline(replace(CONFIG, method=method))
            pipeline.set_sensor_use("gyro_2", False, int(unit.stamp[1000]))
            block = unit.into(pipeline)
            assert np.all(block.gyro_used[1000:] == 0b111011) and np.all(block.gyro_used[:1000] == 0b111111)
            jump = block.rate[1000:].mean(axis=0) - block.rate[:1000].mean(axis=0)
            noise = (pipeline.rate_covariance(0b111011) + pipeline.rate_covariance(0b111111)) / 1000.0
            found.append(jump @ np.linalg.solve(noise + block.gyro_excess[1000:].mean(axis=0), jump))
    assert np.mean(jumps["glr_kf"]) < 3.0 + 4.0 * np.sqrt(6.0 / 12.0)  # chi-square, 3 degrees of freedom
    assert np.mean(jumps["wls"]) > 100.0


def test_biases_of_the_sensors_with_and_without_a_navigator() -> None:
    """Without, the part in the range of H is as uncertain as the prior; with it, every sensor's bias is known."""
    scaled, sigmas = ([], []), ([], [])
    for seed in range(40):
        for told in (0, 1):
            unit, pipeline = Unit(300, seed), FusionPipeline(CONFIG)
            assert not told or tell(pipeline, unit, int(unit.stamp[200]), 0.1, seed)
            unit.into(pipeline)
            status = pipeline.status().gyro
            scaled[told].append((status.bias - unit.bias[0]) / status.bias_sigma)
            sigmas[told].append(status.bias_sigma / SIGMA[0])
    assert 0.7 < np.mean(np.square(scaled[0])) < 1.4 and 0.7 < np.mean(np.square(scaled[1])) < 1.4
    assert np.mean(sigmas[0]) > 3.0 and np.mean(sigmas[1]) < 0.2


def test_the_fused_output_does_not_depend_on_what_the_navigator_says() -> None:
    """It goes on subtracting its bias: if the samples lacked it too, it would be counted twice."""
    blocks = []
    for told in (False, True):
        unit, pipeline = Unit(600, 3), FusionPipeline(CONFIG)
        assert not told or tell(pipeline, unit, int(unit.stamp[100]), 0.1, 3)
        pipeline.set_sensor_use("gyro_1", False, int(unit.stamp[300]))
        blocks.append(unit.into(pipeline))
    for name in FusedBlock._fields:
        assert np.array_equal(getattr(blocks[0], name), getattr(blocks[1], name)), name


def test_a_calibration_that_cannot_be_used_is_refused_and_counted() -> None:
    unit, pipeline = Unit(100, 0), FusionPipeline(CONFIG)
    unit.into(pipeline)
    good, zero, late = np.eye(3), np.zeros(3), int(unit.stamp[-1])
    nan, flat, then = np.array([0.0, np.nan, 0.0]), np.diag([1.0, 0.0, 1.0]), late + 1
    for one in ((late, zero, good, zero, good), (then, nan, good, zero, good), (then, zero, flat, zero, good), (then, zero, good, zero, -good)):
        assert not pipeline.add_calibration(*one).success
    assert pipeline.counters.calibrations_refused == 4 and pipeline.counters.commands_refused == 0
    assert [e.text for e in pipeline.drain_events()][1:] == [
        "calibration refused: it holds a value that is not finite",
        "calibration refused: a covariance is not positive definite",
        "calibration refused: a covariance is not positive definite",
    ]
    assert pipeline.add_calibration(late + 1, zero, good, zero, good).success


def test_blocks_change_nothing() -> None:
    results = []
    for length in (600, 1, 77):
        unit, pipeline = Unit(600, 5), FusionPipeline(CONFIG, statuses=True)
        tell(pipeline, unit, int(unit.stamp[200]), 0.1, 5)
        pipeline.set_sensor_use("gyro_2", False, int(unit.stamp[300]))
        rate = np.concatenate([unit.into(pipeline, a, min(a + length, 600)).rate for a in range(0, 600, length)])
        results.append((rate.tobytes(), [s.gyro.bias.tobytes() for s in pipeline.drain_statuses()]))
    assert results[0] == results[1] == results[2]


def test_a_sensor_that_returns_is_expected_as_it_was() -> None:
    """Relative to the fused output, whose bias may have moved meanwhile as the navigator says."""
    unit, pipeline = Unit(1500, 7), FusionPipeline(CONFIG)
    known: KnownBias = pipeline._methods.compensation.known[0]
    tell(pipeline, unit, int(unit.stamp[100]), 0.01, 7)
    pipeline.set_sensor_use("gyro_4", False, int(unit.stamp[1000]))
    unit.into(pipeline)
    h = CONFIG.array().H[4]
    relative = unit.bias[0, 4] - h @ (W @ unit.bias[0])
    assert abs(known.returning()[4] - relative) < 0.3 * SIGMA[0]
    moved = np.array([3.0, 0.0, -2.0]) * SIGMA[0]
    c, P = known.fused
    known.fused = c + moved, P
    assert known.returning()[4] == pytest.approx(relative - h @ moved, abs=0.3 * SIGMA[0])


def test_the_covariance_of_a_compensated_sample_is_honest() -> None:
    """Of the error less the ordinary bias of the fused output, from the declaration on, with what is repaid."""
    scaled = []
    for seed in range(25):
        unit, pipeline = Unit(2500, 100 + seed), FusionPipeline(CONFIG)
        unit.z[0][1000:, 1] += 4.0 * SIGMA[0]
        block = unit.into(pipeline)
        states = [(e.index, e.state) for e in pipeline.drain_events() if e.kind == "gyro"]
        assert states and states[-1] == (1, HealthState.COMPENSATED)
        at = next(int(k) for k in np.flatnonzero(block.gyro_drift[:, 1]))
        error = block.rate[at:] - TRUE[0] - W @ unit.bias[0]
        covariance = pipeline.rate_covariance(0b111111) + block.gyro_excess[at:]
        scaled.append(np.mean(np.einsum("ka,kab,kb->k", error, np.linalg.inv(covariance), error)) / 3.0)
    assert 0.85 < np.mean(scaled) < 1.15
