"""The state at the start: the errors have the covariance that is stated, and a self-aligned attitude is what its sensors say."""

import numpy as np
import pytest
from scipy.stats import chi2

from riins_core.earth import OMEGA_IE, earth_rate_n, gravity, radii
from riins_core.ins_error import State
from riins_core.rotation import dcm_from_euler, log_so3
from riins_core.sensor_errors import ARCMIN, ARCSEC
from riins_sim.initial import initial_state
from riins_sim.sensors import RedundantImuSim
from riins_sim.trajectory import Trajectory

MOORED = {"latitude_deg": 40.0, "longitude_deg": 121.0, "height_m": 5.0, "speed_kn": 0.0, "heading_deg": 70.0}


def _voyage(voyage, **changes):
    return voyage(duration_s=2.0, start=MOORED, sea={"significant_wave_height_m": 0.0}, legs=[], **changes)


def test_state_is_the_truth_plus_the_errors_said(voyage):
    scenario = voyage(duration_s=2.0)
    trajectory = Trajectory(scenario)
    drawn, truth = initial_state(scenario, trajectory), trajectory.truth(0.0)
    r_m, r_n = radii(truth.lat[0])
    assert (drawn.lat - truth.lat[0]) * (r_m + truth.h[0]) == pytest.approx(drawn.error[State.POS_N], abs=1e-8)
    assert (drawn.lon - truth.lon[0]) * (r_n + truth.h[0]) * np.cos(truth.lat[0]) == pytest.approx(drawn.error[State.POS_E], abs=1e-8)
    assert truth.h[0] - drawn.h == pytest.approx(drawn.error[State.POS_D])
    assert drawn.v_n - truth.v_n[0] == pytest.approx(drawn.error[3:6])
    # computed C_nb = exp(-[phi x]) true C_nb
    phi = -log_so3(dcm_from_euler(*drawn.rph) @ truth.C_nb[0].T)
    assert phi == pytest.approx(drawn.error[6:9], abs=1e-12)
    assert np.array_equal(drawn.error[9:12], RedundantImuSim(scenario, trajectory).fused_bias(0)[0])
    assert np.array_equal(np.sqrt(np.diag(drawn.covariance))[6:9], drawn.sigma_attitude)
    assert drawn.stamp_ns == 0 and drawn.source == "scenario"
    again = initial_state(scenario, trajectory)
    assert np.array_equal(again.error, drawn.error)
    other = initial_state(scenario, trajectory, seed=99)
    assert not np.array_equal(other.error[:9], drawn.error[:9]) and np.array_equal(other.error[9:], drawn.error[9:])


def test_self_aligned_attitude_levels_the_force_and_nulls_the_east_rate(voyage):
    """With no other error the computed specific force is vertical and the computed Earth rate has no east component, to second order."""
    tiny = {"self_aligned": True, "tilt_arcsec": 1e-3, "heading_arcmin": 1e-3}
    scenario = _voyage(voyage, initial=tiny, imu={"gyro": {"constant_drift_deg_h": 0.01}, "accel": {"bias_ug": 50.0}})
    trajectory = Trajectory(scenario)
    drawn, truth = initial_state(scenario, trajectory), trajectory.truth(0.0)
    bias_g, bias_a = RedundantImuSim(scenario, trajectory).fused_bias(0)
    computed = dcm_from_euler(*drawn.rph)
    force = computed @ (truth.force_b[0] + bias_a)
    g = float(gravity(truth.lat[0], truth.h[0]))
    tilt = np.hypot(drawn.error[6], drawn.error[7])
    assert tilt > 2.0 * ARCSEC
    assert np.hypot(force[0], force[1]) / g < 0.01 * ARCSEC
    rate = computed @ (truth.C_nb[0].T @ earth_rate_n(truth.lat[0]) + bias_g)
    assert abs(rate[1]) / (OMEGA_IE * np.cos(truth.lat[0])) < 0.01 * ARCMIN
    assert abs(drawn.error[8]) > 0.5 * ARCMIN


def test_errors_have_their_covariance(voyage):
    """NEES over seeds is chi-square with 15 degrees of freedom: variances and cross-covariances, those of attitude with biases too."""
    sensors = {"gyro": {"constant_drift_deg_h": 0.014, "markov_drift_deg_h": 0.004}, "accel": {"bias_ug": 70.0}}
    start = _voyage(voyage, initial={"self_aligned": True, "tilt_arcsec": 5.0, "heading_arcmin": 0.5}, imu=sensors)
    trajectory = Trajectory(start)
    nees, attitude = [], []
    for seed in range(150):
        drawn = initial_state(start.with_seed(seed), trajectory)
        nees.append(drawn.error @ np.linalg.solve(drawn.covariance, drawn.error))
        attitude.append(drawn.error[6:9] / drawn.sigma_attitude)
    low, high = chi2.ppf([1e-4, 1 - 1e-4], 15 * 150)
    assert low < np.sum(nees) < high
    # errata 003: tilt 50 ug / g and 5 arcsec, azimuth 0.0103 deg/h / (W cos L), the tilt's tan L and 0.5 arcmin
    bias = 70.0e-6 * 9.80665 / np.sqrt(2) / float(gravity(trajectory.truth(0.0).lat[0], 5.0))
    tilt = np.hypot(bias, 5.0 * ARCSEC)
    assert drawn.sigma_attitude[:2] == pytest.approx(tilt, rel=1e-6)
    drift = np.deg2rad(np.hypot(0.014, 0.004) / np.sqrt(2) / 3600.0)
    azimuth = np.sqrt((drift / (OMEGA_IE * np.cos(np.deg2rad(40.0)))) ** 2 + (tilt * np.tan(np.deg2rad(40.0))) ** 2 + (0.5 * ARCMIN) ** 2)
    assert drawn.sigma_attitude[2] == pytest.approx(azimuth, rel=1e-6)
    assert np.sum(np.square(attitude), axis=0) == pytest.approx(150.0, abs=4.5 * np.sqrt(300.0))


def test_plain_start_has_no_correlation(voyage):
    scenario = _voyage(voyage, initial={"position_m": 7.0, "height_m": 3.0, "velocity_mps": 0.2, "tilt_arcsec": 30.0, "heading_arcmin": 6.0})
    drawn = initial_state(scenario, Trajectory(scenario))
    assert drawn.sigma_position == pytest.approx([7.0, 7.0, 3.0])
    assert drawn.sigma_attitude == pytest.approx([30.0 * ARCSEC, 30.0 * ARCSEC, 6.0 * ARCMIN])
    off_diagonal = drawn.covariance - np.diag(np.diag(drawn.covariance))
    assert np.max(np.abs(off_diagonal)) < 1e-20


def test_perfect_sensors_leave_a_singular_but_valid_covariance(voyage):
    scenario = _voyage(voyage, imu={"gyro": {}, "accel": {}}, initial={"self_aligned": True})
    drawn = initial_state(scenario, Trajectory(scenario))
    assert np.all(drawn.error[9:] == 0.0) and np.all(drawn.covariance[9:] == 0.0)
