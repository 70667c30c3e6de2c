"""Faults of whole IMUs in the fusion: one says that it has no redundancy, two detect, three isolate."""

from __future__ import annotations

import numpy as np
import pytest

from riins_core.rotation import dcm_from_euler
from riins_core.settings import SettingError
from riins_fdi.health import HealthState
from riins_fdi.parity import Capability
from riins_imu_fusion.array_config import ArrayConfig
from riins_imu_fusion.config import FusionConfig
from riins_imu_fusion.pipeline import FusionPipeline
from riins_imu_fusion.types import FusedBlock

RATE, FORCE = np.array([0.02, -0.01, 0.03]), np.array([0.3, -0.2, -9.8])
M, ONSET = 400, 200


def pipeline(imus: int) -> FusionPipeline:
    array = ArrayConfig(
        topics=tuple(f"imu_{i}" for i in range(imus)), mounting_rpy_deg=tuple(np.ravel([[15.0 * i, -10.0 * i, 60.0 * i] for i in range(imus)])),
        gyro_bias_sigma=0.0, accel_bias_sigma=0.0,
    )  # fmt: skip
    given = {name: tuple(value) if isinstance(value, list) else value for name, value in array.fusion_parameters().items()}
    return FusionPipeline(FusionConfig(method="wls", **given), statuses=True)  # type: ignore[arg-type]


def readings(p: FusionPipeline, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    rng, sigma = np.random.default_rng(seed), p.config.sigma()
    made = (p.array.H @ x + s * rng.standard_normal((M, p.n)) for x, s in zip((RATE, FORCE), sigma, strict=True))
    return tuple(made)  # type: ignore[return-value]


def fuse(p: FusionPipeline, gyro: np.ndarray, accel: np.ndarray, cuts: tuple[int, ...] = ()) -> FusedBlock:
    every = np.full(M, (1 << p.n) - 1, np.uint64)
    stamp, number = 10_000_000 * np.arange(1, M + 1), np.arange(M)
    blocks = [p.process(*(a[i:j] for a in (stamp, number, gyro, accel, every, every))) for i, j in zip((0, *cuts), (*cuts, M), strict=True)]
    return FusedBlock(*(np.concatenate([getattr(b, name) for b in blocks]) for name in FusedBlock._fields[:-1]), recalls=())


def isolated(p: FusionPipeline, kind: str) -> list[int]:
    triad = p.status().gyro if kind == "gyro" else p.status().accel
    return [i for i, state in enumerate(triad.state) if state == HealthState.ISOLATED]


@pytest.mark.parametrize("imus", [3, 4])
def test_a_whole_imu_is_isolated_and_none_of_it_is_fused(imus: int) -> None:
    p = pipeline(imus)
    gyro, accel = readings(p)
    gyro[ONSET:, 3:6] += [0.03, -0.02, 0.025]
    block = fuse(p, gyro, accel)
    assert isolated(p, "gyro") == [3, 4, 5] and isolated(p, "accel") == []
    assert np.all(block.gyro_used[ONSET:] & np.uint64(0b111000) == 0) and np.all(block.gyro_used[: ONSET - 1] == (1 << p.n) - 1)
    np.testing.assert_allclose(block.rate[ONSET:].mean(axis=0), RATE, atol=6 * 1e-3 / np.sqrt(M - ONSET))


def test_an_imu_that_has_turned_in_its_mount_is_isolated() -> None:
    """Its specific force is wrong across gravity, in two dimensions only."""
    p = pipeline(3)
    gyro, accel = readings(p)
    turned = p.array.H[3:6] @ dcm_from_euler(0.05, 0.07, 0.3)
    accel[ONSET:, 3:6] += (turned - p.array.H[3:6]) @ FORCE
    fuse(p, gyro, accel)
    assert isolated(p, "accel") == [3, 4, 5] and isolated(p, "gyro") == []


def test_one_axis_of_an_imu_costs_this_axis_alone() -> None:
    p = pipeline(3)
    gyro, accel = readings(p)
    gyro[ONSET:, 7] += 0.03
    fuse(p, gyro, accel)
    assert isolated(p, "gyro") == [7]


def test_two_imus_detect_and_one_says_that_it_cannot() -> None:
    two = pipeline(2)
    gyro, accel = readings(two)
    gyro[ONSET:, 3:6] += [0.03, -0.02, 0.025]
    fuse(two, gyro, accel)
    assert two.status().gyro.doubtful and isolated(two, "gyro") == []
    one = pipeline(1)
    block = fuse(one, *readings(one))
    assert len(block) == M and one.status().gyro.capability == one.status().accel.capability == Capability.NEITHER


def test_any_cut_into_blocks_gives_the_same_bits() -> None:
    whole, parts = pipeline(3), pipeline(3)
    gyro, accel = readings(whole)
    gyro[ONSET:, 3:6] += [0.03, -0.02, 0.025]
    a, b = fuse(whole, gyro, accel), fuse(parts, gyro, accel, (1, 150, 200, 201, 203, 390))
    assert np.array_equal(a.rate, b.rate) and np.array_equal(a.force, b.force) and np.array_equal(a.gyro_used, b.gyro_used)
    assert [e.text for e in whole.drain_events()] == [e.text for e in parts.drain_events()]


@pytest.mark.parametrize("groups", [(0, 0), (0, 0, 0, 1, 1, 6)])
def test_groups_that_do_not_fit_are_refused(groups: tuple[int, ...]) -> None:
    with pytest.raises(SettingError, match="groups"):
        FusionConfig(groups=groups)
