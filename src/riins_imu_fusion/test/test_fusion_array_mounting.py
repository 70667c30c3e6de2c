"""Mounting of one IMU against another: recovered within its own sigma, and said to be unknown where the motion does not show it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from riins_core.frames import FLU_FROM_FRD
from riins_core.rotation import exp_so3, log_so3
from riins_imu_fusion.array_align import AlignedSample, ArrayAligner
from riins_imu_fusion.array_config import ArrayConfig, MountingConfig
from riins_imu_fusion.array_mounting import MountingEstimator

DATA = Path(__file__).resolve().parents[3].parent / "shared" / "data"
SIGMA, HZ = 2e-3, 100.0


def config(n: int = 2, **mounting: float) -> ArrayConfig:
    return ArrayConfig(
        topics=tuple(f"imu_{i}" for i in range(n)), gyro_sigma=(SIGMA,), mounting_rpy_deg=(0.0, 0.0, 0.0, 20.0, -30.0, 90.0)[: 3 * n],
        mounting=MountingConfig(**mounting),  # type: ignore[arg-type]
    )  # fmt: skip


def rolling(t: np.ndarray, all_axes: bool = True) -> np.ndarray:
    """Rates of a boat in waves."""
    rates = np.column_stack([0.3 * np.sin(0.9 * t), 0.2 * np.sin(1.3 * t + 1.0), 0.15 * np.sin(0.5 * t) + 0.05])
    return rates if all_axes else rates * [1.0, 0.0, 0.0]


def run(seed: int, angle: np.ndarray, seconds: float = 60.0, all_axes: bool = True, clock_s: float = 0.0) -> tuple[MountingEstimator, np.ndarray]:
    rng, settings = np.random.default_rng(seed), config()
    C = settings.rotations()[1]
    estimator, t = MountingEstimator(settings), np.arange(1, round(seconds * HZ) + 1) / HZ
    bias, scale = rng.normal(0.0, 0.01, 3), rng.normal(0.0, 0.003, 3)
    first = rolling(t - 0.005, all_axes) + SIGMA * rng.standard_normal((t.size, 3))
    own = (1.0 + scale) * (rolling(t - 0.005 - clock_s, all_axes) @ exp_so3(angle) @ C) + bias + SIGMA * rng.standard_normal((t.size, 3))
    for k in range(t.size):
        values = np.concatenate([first[k], own[k]])
        estimator.add(AlignedSample(round((k + 1) * 1e9 / HZ), k + 1, values, np.zeros(6), 63, 63))
    return estimator, C @ bias


def test_one_degree_is_recovered_within_three_sigma() -> None:
    angle = np.radians([0.6, -0.6, 0.5])  # one degree in all
    normalized, clock = [], []
    for seed in range(12):
        estimator, bias = run(seed, angle, clock_s=0.004)
        found = estimator.result(1)
        assert found.known and found.directions == 3 and found.worst_sigma < np.radians(0.1)
        assert np.all(np.abs(found.angle - angle) <= 3.5 * found.angle_sigma) and np.all(np.abs(found.bias - bias) <= 4.0 * found.bias_sigma)
        normalized.append(np.mean(((found.angle - angle) / found.angle_sigma) ** 2))
        clock.append((found.clock - 0.004) / found.clock_sigma)
    assert 0.4 < np.mean(normalized) < 1.8  # 36 squares of unit mean
    assert found.clock_sigma < 1e-3 and np.max(np.abs(clock)) < 4.0


def test_a_large_angle_is_exact() -> None:
    """The model is linear in the Gibbs vector whatever its size."""
    angle = np.radians([6.0, -4.0, 9.0])
    estimator = run(3, angle, 120.0)[0]
    assert np.degrees(np.abs(estimator.result(1).angle - angle)).max() < 0.15


def test_turning_about_one_axis_is_not_enough() -> None:
    angle = np.radians([0.6, -0.6, 0.5])
    found = run(1, angle, all_axes=False)[0].result(1)
    assert not found.known and found.directions == 2 and found.worst_sigma > np.radians(1.6)
    assert found.angle_sigma[0] > np.radians(1.6) and np.all(found.angle_sigma[1:] < np.radians(0.2))
    assert np.all(np.abs(found.angle - angle)[1:] < 4.0 * found.angle_sigma[1:])


def test_without_motion_nothing_is_known() -> None:
    settings = config()
    estimator, rng = MountingEstimator(settings), np.random.default_rng(5)
    for k in range(1, 3000):
        estimator.add(AlignedSample(k * 10_000_000, k, SIGMA * rng.standard_normal(6), np.zeros(6), 63, 63))
    found = estimator.result(1)
    assert found.directions == 0 and found.used > 250 and 0.7 < found.misfit < 1.3
    assert np.all(found.bias_sigma < 1e-3)


def test_readings_are_turned_when_the_mounting_is_known() -> None:
    angle = np.radians([0.6, -0.6, 0.5])
    estimator = run(2, angle, 120.0)[0]
    C = config().rotations()[1]
    rate, force = np.array([0.1, -0.2, 0.3]), np.array([0.5, 0.2, 9.8])
    mine = (C.T @ exp_so3(-angle) @ rate, C.T @ exp_so3(-angle) @ force)
    sample = AlignedSample(0, 0, np.concatenate([rate, mine[0]]), np.concatenate([force, mine[1]]), 63, 63)
    turned = estimator.turned(sample)
    np.testing.assert_allclose(C @ turned.accel[3:], force, atol=9.8 * np.radians(0.15))
    assert np.abs(C @ sample.accel[3:] - force).max() > 9.8 * np.radians(0.4) and np.array_equal(turned.gyro[:3], rate)
    lacking = estimator.turned(sample._replace(gyro_valid=0b101111))
    assert lacking.gyro_valid == 0b000111 and lacking.accel_valid == 63


def test_a_gap_or_an_invalid_axis_is_not_compared() -> None:
    settings, rng = config(), np.random.default_rng(5)
    estimator = MountingEstimator(settings)
    for k in range(1, 2001):
        if not 500 <= k < 733:
            valid = 63 if not 1000 <= k < 1300 else 63 - (1 << 4)
            estimator.add(AlignedSample(k * 10_000_000, k, SIGMA * rng.standard_normal(6), np.zeros(6), valid, 63))
    found = estimator.result(1)
    assert 130 <= found.used + found.left_out <= 145  # of 200 blocks, 24 and 30 lack data, and each one's neighbours


@pytest.mark.skipif(not (DATA / "quad4imu.npz").is_file(), reason="the recording with four IMUs is not on this machine (../shared/data/quad4imu.npz)")
def test_four_real_imus_against_the_angles_of_the_recording() -> None:
    data = np.load(DATA / "quad4imu.npz", allow_pickle=False)
    settings = ArrayConfig(
        topics=tuple("abcd"),
        imu_rate_hz=(120.0,),
        rate_hz=50.0,
        bridge=6.0,
        gyro_sigma=(0.01,),
        mounting=MountingConfig(bias_sigma=0.1, angle_sigma_deg=3.0),
    )
    clocks = [data[f"imu_t_{i}"] for i in range(4)]
    plan = sorted((float(t), i, k) for i in range(4) for k, t in enumerate(clocks[i]) if 60.0 < t - clocks[0][0] < 120.0)
    readings = [(data[f"gyro_{i}"] @ FLU_FROM_FRD, data[f"accel_{i}"] @ FLU_FROM_FRD) for i in range(4)]
    aligner, estimator = ArrayAligner(settings), MountingEstimator(settings)
    for t, i, k in plan:
        for sample in aligner.add(i, round(t * 1e9), readings[i][0][k], readings[i][1][k]):
            estimator.add(sample)
    C = [FLU_FROM_FRD @ data[f"C_body_imu_{i}"] @ FLU_FROM_FRD for i in range(4)]
    for i in range(1, 4):
        found, given = estimator.result(i), log_so3(C[0].T @ C[i])
        assert found.known and found.used > 550 and np.degrees(np.linalg.norm(given)) > 0.9
        assert np.all(np.abs(found.angle - given) <= 3.0 * found.angle_sigma + np.radians(0.05))
