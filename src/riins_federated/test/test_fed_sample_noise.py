"""What the covariance of the fused samples adds to the process noise: nothing while the set is whole, noise and a bias step when a sensor leaves."""

from __future__ import annotations

import numpy as np
import pytest
from fed_voyage import config, voyage

from riins_core.imu_array import CONFIGURATIONS, ImuArray
from riins_core.ins_error import BA, BG, N_STATES, PHI, VEL
from riins_core.rotation import dcm_from_euler
from riins_federated.navigator import Navigator
from riins_federated.sample_noise import SampleNoise
from riins_federated.state_blocks import inertial_density

DT = 0.01
ARRAY = ImuArray(CONFIGURATIONS["dodecahedron"])
WHOLE, FIVE = 0b111111, 0b101111


def covariance(mask: int, density: float) -> np.ndarray:
    """Of the fused triad, from six sensors that together have a density."""
    used = np.array([bool(mask >> i & 1) for i in range(6)])
    return ARRAY.covariance(used, np.full(6, np.sqrt(2.0 * density / DT)))


def test_subset_and_set_differ_by_an_error_of_the_difference_of_their_covariances() -> None:
    """The identity behind the bias step."""
    used = np.array([bool(FIVE >> i & 1) for i in range(6)])
    step = ARRAY.least_squares(used) - ARRAY.least_squares()
    assert step @ step.T == pytest.approx(ARRAY.covariance(used, np.ones(6)) - ARRAY.covariance(None, np.ones(6)), abs=1e-12)


def gathered(noise: SampleNoise, gyro: np.ndarray, accel: np.ndarray, cuts: tuple[int, ...] = ()) -> np.ndarray:
    """Process noise of one interval with samples of these covariances, the body turned."""
    state, Qd = noise.fresh(), np.zeros((N_STATES, N_STATES))
    for part in np.split(np.arange(len(gyro)), cuts):
        noise.gather(state, gyro[part], accel[part], np.zeros((len(part), 6)), np.full(len(part), DT))
    noise.add(state, C_NB, len(gyro) * DT, Qd)
    assert not state[:, (0, 2)].any()
    return Qd


C_NB = dcm_from_euler(0.1, -0.2, 1.0)


def test_a_sensor_that_leaves_adds_white_noise_and_a_step_of_the_bias() -> None:
    density = inertial_density(config().inertial)
    gyro = np.array([covariance(WHOLE if k < 30 else FIVE, density[PHI][0]) for k in range(100)])
    accel = np.tile(covariance(WHOLE, density[VEL][0]), (100, 1, 1))
    noise = SampleNoise(config())
    Qd = gathered(noise, gyro, accel)
    lost = gyro[-1] - gyro[0]
    assert Qd[PHI, PHI] == pytest.approx(C_NB @ (70 * DT**2 * lost) @ C_NB.T, rel=1e-9, abs=1e-25)
    bias = np.radians(0.035) / 3600.0
    assert Qd[BG, BG] == pytest.approx(bias**2 * lost * DT / density[PHI][0], rel=1e-9, abs=1e-25)
    assert not gathered(SampleNoise(config(inertial={"bias_steps": False})), gyro, accel)[BG, BG].any()  # fused by glr_kf
    assert np.trace(Qd[BG, BG]) == pytest.approx(bias**2)  # 6 -> 5 of a dodecahedron: one direction has lost as much as it had
    assert not Qd[VEL, VEL].any() and not Qd[BA, BA].any()
    assert np.array_equal(Qd, gathered(noise, gyro, accel, (1, 29, 30, 31, 77)))  # law 3


def test_a_sensor_that_returns_steps_the_bias_again_and_no_covariance_means_the_model() -> None:
    density = inertial_density(config().inertial)
    gyro = np.array([covariance(FIVE if k < 30 else WHOLE, density[PHI][0]) for k in range(100)])
    bad = np.full((100, 3, 3), np.nan)
    Qd = gathered(SampleNoise(config()), gyro, bad)
    assert np.trace(Qd[BG, BG]) == pytest.approx((np.radians(0.035) / 3600.0) ** 2)
    assert not gathered(SampleNoise(config()), np.zeros((100, 3, 3)), bad).any()
    assert not gathered(SampleNoise(config(inertial={"follow_covariance": False})), 9.0 * gyro, bad).any()
    assert not gathered(SampleNoise(config()), 0.5 * np.tile(gyro[-1], (100, 1, 1)), bad).any()  # less noise than the model is not believed


def test_navigator_is_less_sure_after_a_loss_and_as_sure_as_ever_with_the_whole_set() -> None:
    v, density = voyage(), inertial_density(config().inertial)
    accel = np.tile(covariance(WHOLE, density[VEL][0]), (3000, 1, 1))
    heading = {}
    for name, mask in (("unknown", None), ("whole", WHOLE), ("five", FIVE)):
        navigator = Navigator(config())
        navigator.set_initial_state(v.initial)
        gyro = None if mask is None else np.array([covariance(WHOLE if k < 1000 else mask, density[PHI][0]) for k in range(3000)])
        for part in np.split(np.arange(3000), (1, 999, 1001, 2500)):
            noise = (None, None) if gyro is None else (gyro[part], accel[part])
            navigator.add_imu(v.stamp[part], v.sequence[part], v.rate[part], v.force[part], (), *noise)
        navigator.finish()
        heading[name] = np.array([s.P for s in navigator.drain_settled()])
    assert heading["whole"] == pytest.approx(heading["unknown"], rel=1e-9, abs=1e-30)
    grown = np.einsum("kii->ki", heading["five"])[:, 6:9].sum(axis=1) / np.einsum("kii->ki", heading["whole"])[:, 6:9].sum(axis=1)
    assert grown[:9] == pytest.approx(1.0) and grown[-1] > 1.0 + 1e-6
