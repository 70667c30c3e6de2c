"""Standing still by the IMU: as many misses as configured, motion is seen, and what the navigator makes of it obeys its laws."""

from __future__ import annotations

import numpy as np
import pytest

from riins_core.earth import earth_rate_n, gravity
from riins_core.settings import build
from riins_federated.config import NavigatorConfig
from riins_federated.navigator import Navigator
from riins_federated.standstill import Standstill
from riins_federated.types import InitialState

DT = 0.01
ARW, VRW = 0.1, 50.0
DECLARED = {
    "aids": ["stand"],
    "stand": {"type": "zero_velocity", "detect": True, "period_s": 0.5, "timeout_s": 2.0, "sigma_mps": 0.01, "miss_probability": 0.05},
    "inertial": {"gyro_arw_deg_sqrt_h": ARW, "accel_vrw_ug_sqrt_hz": VRW, "gyro_bias_deg_h": 1.0, "accel_bias_ug": 100.0},
    "height": {"enabled": False},
}


def imu(seconds: float, seed: int = 1, shake: float = 0.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Stamps, rates and forces of a vehicle that stands level at 0.7 rad north; `shake` m/s^2 of vibration while it moves in the second half."""
    rng, m = np.random.default_rng(seed), round(seconds / DT)
    rate = earth_rate_n(0.7) + rng.normal(size=(m, 3)) * np.radians(ARW) / 60.0 / np.sqrt(DT)
    force = np.array([0.0, 0.0, -float(gravity(0.7, 0.0))]) + rng.normal(size=(m, 3)) * VRW * 9.80665e-6 / np.sqrt(DT)
    moving = np.arange(m) >= m // 2
    force[:, 2] += moving * shake * rng.normal(size=m)
    return np.arange(1, m + 1) * round(DT * 1e9), rate, force


def test_misses_are_as_many_as_configured_and_vibration_is_motion() -> None:
    stamps, rate, force = imu(1000.0)
    seen = Standstill(build(NavigatorConfig, DECLARED)).take(stamps, rate, force, np.full(len(stamps), DT))
    missed = 2000 - len(seen)
    assert abs(missed - 100) < 4.0 * np.sqrt(100 * 0.95)  # binomial
    stamps, rate, force = imu(100.0, shake=0.02)
    seen = Standstill(build(NavigatorConfig, DECLARED)).take(stamps, rate, force, np.full(len(stamps), DT))
    assert all(aid.stamp_ns <= 50_000_000_000 for aid in seen) and len(seen) > 80
    gappy = np.delete(np.arange(len(stamps)), np.arange(110, 140))  # of the third window more than half is lost
    steps = np.diff(stamps[gappy], prepend=0) * 1e-9
    holes = Standstill(build(NavigatorConfig, DECLARED)).take(stamps[gappy], rate[gappy], force[gappy], np.minimum(steps, DT))
    assert 1_500_000_000 in [aid.stamp_ns for aid in seen] and 1_500_000_000 not in [aid.stamp_ns for aid in holes]


@pytest.mark.parametrize("cuts", [(), (1, 49, 50, 51, 333), tuple(range(7, 1000, 13))])
def test_the_navigator_stands_still_in_blocks_of_any_length(cuts: tuple[int, ...]) -> None:
    stamps, rate, force = imu(10.0, seed=3)
    ones = np.ones(3)
    initial = InitialState(0, 0.7, 0.1, 0.0, 0.3 * ones, 0.0 * ones, ones, 0.5 * ones, 0.002 * ones)

    def navigated(pieces: tuple[int, ...]) -> Navigator:
        navigator = Navigator(build(NavigatorConfig, DECLARED))
        navigator.set_initial_state(initial)
        for part in np.split(np.arange(len(stamps)), pieces):
            navigator.add_imu(stamps[part], part + 1, rate[part], force[part])
        navigator.finish()
        return navigator

    whole, one = navigated(()), navigated(cuts)
    speeds = np.array([s.v_n for s in whole.drain_settled()])
    assert np.abs(speeds[-1]).max() < 0.02 and whole.status().subfilters[0].accepted >= 15
    assert np.array_equal(speeds, np.array([s.v_n for s in one.drain_settled()]))
