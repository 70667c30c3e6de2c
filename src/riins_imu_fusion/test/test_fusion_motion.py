"""Scale factor and mounting errors in the tests of the fusion: false alarms as set, faults still found, nothing while the setting is zero.

Lives here: parity tests, tests over many samples and `glr_kf` on drawn errors and a vehicle that accelerates and turns.
Does not live here: the variance itself (riins_fdi's test_fdi_motion.py), the aircraft (riins_eval).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fusion_feed import ALL, CONFIG, DT, SHORT, changes

from riins_core.settings import SettingError, build
from riins_imu_fusion.config import FusionConfig
from riins_imu_fusion.pipeline import FusionPipeline
from riins_imu_fusion.types import FdiEvent, FusedBlock

KNOWN = {"gyro_scale_ppm": 100.0, "accel_scale_ppm": 200.0, "gyro_misalignment_arcmin": 2.0, "accel_misalignment_arcmin": 1.0}
GRAVITY = np.array([0.0, 0.0, -9.8])


def readings(config: FusionConfig, x: np.ndarray, kind: int, seed: int, anew: bool) -> np.ndarray:
    """Readings (m, n) at x (m, 3) of sensors with drawn errors, new ones for every sample or for the whole run."""
    H, (scale, tilt) = config.array().H, config.motion_errors()[kind]
    rng = np.random.default_rng([seed, kind])
    shape = (len(x) if anew else 1, *H.shape)
    across = rng.normal(0.0, tilt, shape)
    across -= np.sum(across * H, axis=2, keepdims=True) * H
    axes = H * (1.0 + rng.normal(0.0, scale, shape[:2]))[..., None] + across
    return np.einsum("mna,ma->mn", np.broadcast_to(axes, (len(x), *H.shape)), x) + rng.normal(0.0, config.sigma()[kind], (len(x), len(H)))


def fuse(config: FusionConfig, gyro: np.ndarray, accel: np.ndarray, parts: int = 1) -> tuple[FusedBlock, FusionPipeline]:
    pipeline, m = FusionPipeline(config), len(gyro)
    stamp, every = np.arange(1, m + 1) * DT, np.full(m, (1 << gyro.shape[1]) - 1)
    blocks = [pipeline.process(stamp[p], np.arange(m)[p], gyro[p], accel[p], every[p], every[p]) for p in np.array_split(np.arange(m), parts)]
    return FusedBlock(*(np.concatenate(fields) for fields in list(zip(*blocks, strict=True))[:-1]), ()), pipeline


@pytest.mark.parametrize(("test", "low", "high"), [("glt", 0.8, 1.2), ("optimal_parity_vector", 0.6, 1.3)])
def test_false_alarms_are_as_set_while_the_vehicle_moves(test: str, low: float, high: float) -> None:
    """Errors drawn anew for each of 60 000 samples, at 6 m/s^2 and 20 deg/s; told nothing the tests alarm ten times as often."""
    pfa, m = 5e-3, 60_000
    config = replace(CONFIG, method="wls", parity_test=test, false_alarm_probability=pfa, health=replace(SHORT, isolate_count=1_000_000), **KNOWN)
    x = np.random.default_rng(1).normal(0.0, 1.0, (2, m, 3))
    x *= np.array([0.35, 6.0])[:, None, None] / np.linalg.norm(x, axis=2, keepdims=True)
    x[1] += GRAVITY
    raw = [readings(config, x[kind], kind, 2, True) for kind in range(2)]
    block, pipeline = fuse(config, *raw)
    status = pipeline.status()
    told = [float(np.mean(block.gyro_statistic > status.gyro.threshold)), float(np.mean(block.accel_statistic > status.accel.threshold))]
    assert all(low * pfa < rate < high * pfa for rate in told)
    block, _ = fuse(replace(config, **dict.fromkeys(KNOWN, 0.0)), *raw)
    assert np.mean(block.gyro_statistic > status.gyro.threshold) > 10.0 * pfa
    assert np.mean(block.accel_statistic > status.accel.threshold) > 5.0 * pfa


def voyage(config: FusionConfig, seed: int) -> list[np.ndarray]:
    """Readings of 60 s: at rest, 5 m/s^2 forward and up from 20 s to 30 s, a turn of 10 deg/s from 35 s to 45 s, at rest; the errors stay."""
    t = np.arange(6000) * 0.01
    rate, force = np.zeros((6000, 3)), np.tile(GRAVITY, (6000, 1))
    force[(t >= 20.0) & (t < 30.0)] += [5.0, 0.0, -1.0]
    rate[(t >= 35.0) & (t < 45.0)] += [0.0, 0.02, 0.17]
    force[(t >= 35.0) & (t < 45.0)] += [0.0, 3.0, 0.0]
    return [readings(config, x, kind, seed, False) for kind, x in enumerate((rate, force))]


def told(config: FusionConfig, raw: list[np.ndarray]) -> list[FdiEvent]:
    return fuse(config, *raw)[1].drain_events()


@pytest.mark.parametrize(("method", "sequential"), [("glr_kf", "none"), ("wls", "none"), ("wls", "cusum"), ("wls", "glr")])
def test_nobody_healthy_is_declared_by_a_manoeuvre(method: str, sequential: str) -> None:
    config = FusionConfig(method=method, sequential_test=sequential, **KNOWN)
    silent = replace(config, **dict.fromkeys(KNOWN, 0.0))
    runs = [voyage(config, seed) for seed in range(12)]
    assert sum(bool(told(silent, raw)) for raw in runs) >= 10
    assert sum(bool(told(config, raw)) for raw in runs) == 0


@pytest.mark.parametrize(("method", "sequential"), [("wls", "none"), ("wls", "cusum"), ("wls", "glr")])
@pytest.mark.parametrize("at", [10.0, 25.0, 40.0])
def test_a_fault_is_found_at_rest_and_on_the_move(method: str, sequential: str, at: float) -> None:
    """Forty sigma of a sample or more, and ten of what the motion adds at 25 s and 40 s."""
    config = FusionConfig(method=method, sequential_test=sequential, **KNOWN)
    raw, k = voyage(config, 5), round(at * 100.0)
    raw[0][k:, 4] += 1.5e-3
    raw[1][k:, 1] -= 0.06
    events = [e for e in told(config, raw) if e.state is not None]
    assert {(e.kind, e.index) for e in events} == {("gyro", 4), ("accel", 1)}
    assert {e.state.name for e in events if e.stamp_ns < (at + 3.0) * 1e9} & {"ISOLATED", "COMPENSATED"}


def test_a_sensor_on_the_way_back_is_judged_by_the_motion_too() -> None:
    """Probation in the turn: its own errors do not keep it out, a fault does."""
    config = replace(CONFIG, method="wls", health=replace(SHORT, hold_s=1.0, probation_s=5.0), **KNOWN)
    for fault, returns in ((0.0, True), (1.5e-3, False)):
        raw = voyage(config, 9)
        raw[0][3400:3480, 2] += 0.01
        raw[0][3480:, 2] += fault
        _, pipeline = fuse(config, *raw)
        states = [state for kind, index, state, _ in changes(pipeline) if (kind, index) == ("gyro", 2)]
        assert (states[-1] == "HEALTHY") == returns and "ISOLATED" in states


def test_law_3_holds_with_errors_that_grow_with_the_motion() -> None:
    config = FusionConfig(method="glr_kf", sequential_test="glr", **KNOWN)
    raw = voyage(config, 3)
    raw[0][2400:, 1] += 4e-4
    whole, other = fuse(config, *raw), fuse(config, *raw, parts=137)
    assert all(np.asarray(a).tobytes() == np.asarray(b).tobytes() for a, b in zip(whole[0], other[0], strict=True))
    events = [pipeline.drain_events() for _, pipeline in (whole, other)]
    assert events[0] == events[1] != []


def test_settings_have_ranges() -> None:
    for name in KNOWN:
        with pytest.raises(SettingError, match=name):
            build(FusionConfig, {name: -1.0})
    assert FusionConfig().motion_errors().tolist() == [[0.0, 0.0], [0.0, 0.0]]
    assert FusionConfig(**KNOWN).motion_errors() == pytest.approx(np.array([[1e-4, 2.0 * 2.908882e-4], [2e-4, 2.908882e-4]]))
    assert FusionConfig(**KNOWN).array().n == ALL.bit_count()
