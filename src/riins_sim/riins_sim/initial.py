"""The state a navigator starts from, with errors drawn by seed and the covariance that belongs to them.

Lives here: `initial_state`, `DrawnInitialState`.
Does not live here: real alignment, which estimates this state from measurements.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from riins_core.earth import OMEGA_IE, gravity, radii
from riins_core.noise import normal
from riins_core.rotation import euler_from_dcm, exp_so3
from riins_core.sensor_errors import ARCMIN, ARCSEC, InertialErrors

from .sensors import RedundantImuSim

if TYPE_CHECKING:
    from .scenario import Scenario
    from .trajectory import Trajectory

Array = NDArray[np.float64]


@dataclass(frozen=True)
class DrawnInitialState:
    """Initial state with its errors.

    Attributes
    ----------
    stamp_ns : since the start of the scenario
    lat, lon, h : rad, rad, m
    v_n : (3,), NED, m/s
    rph : (3,), roll, pitch, heading, rad
    sigma_position, sigma_velocity, sigma_attitude : (3,), NED, m, m/s, rad
    sigma_gyro_bias, sigma_accel_bias : (3,), FRD, of the fused triad, rad/s, m/s^2
    covariance : (15, 15), order of riins_core.ins_error.State: position, velocity, phi (NED), gyro bias, accelerometer bias (FRD)
    error : (15,), the errors drawn, computed - true; biases measured - true (the initial estimate of a bias is 0, so these are minus its error)
    source : who says so, for riins_msgs/InitialState
    """

    stamp_ns: int
    lat: float
    lon: float
    h: float
    v_n: Array
    rph: Array
    sigma_position: Array
    sigma_velocity: Array
    sigma_attitude: Array
    sigma_gyro_bias: Array
    sigma_accel_bias: Array
    covariance: Array
    error: Array
    source: str = "scenario"


def initial_state(scenario: Scenario, trajectory: Trajectory, seed: int | None = None) -> DrawnInitialState:
    """Draw the state at the start of a voyage.

    Parameters
    ----------
    scenario : its sections initial and imu are read
    trajectory : the motion
    seed : of the errors; None: the scenario's. The biases are those of the scenario's sensors in any case

    Returns
    -------
    DrawnInitialState

    Notes
    -----
    A self-aligned attitude is the one with which specific force has no horizontal and Earth rate no east component. With the computed
    C_nb = (I - [phi x]) true C_nb and biases measured - true, -phi x (0, 0, -g) + C b_a = 0 gives phi_N = b_E / g, phi_E = -b_N / g, and
    -(phi x w_ie)_E + (C b_g)_E = 0 gives phi_D = (C b_g)_E / (W cos L) - phi_N tan L, to each of which the settings add an independent error.
    Errata 003: the seed's azimuth eps_x / (W cos L), without the tilt's share tan L.
    """
    s = scenario.initial
    seed = scenario.seed if seed is None else seed
    truth = trajectory.truth(0.0)
    c_nb, lat = truth.C_nb[0], float(truth.lat[0])
    imu = RedundantImuSim(scenario, trajectory)
    own = np.array([s.tilt_arcsec * ARCSEC, s.tilt_arcsec * ARCSEC, s.heading_arcmin * ARCMIN])
    sigma = np.concatenate([[s.position_m, s.position_m, s.height_m], np.full(3, s.velocity_mps), own])
    triad = imu.array.covariance()
    bias_cov = np.zeros((6, 6))
    bias_cov[:3, :3] = _bias_variance(scenario.imu.gyro.si()) * triad
    bias_cov[3:, 3:] = _bias_variance(scenario.imu.accel.si()) * triad

    # phi = to_phi own errors + from_bias (b_g, b_a)
    to_phi, from_bias = np.eye(3), np.zeros((3, 6))
    if s.self_aligned:
        g = float(gravity(lat, truth.h[0]))
        to_phi[2, 0] = -np.tan(lat)
        from_bias[0, 3:] = c_nb[1] / g
        from_bias[1, 3:] = -c_nb[0] / g
        from_bias[2, :3] = c_nb[1] / (OMEGA_IE * np.cos(lat))
        from_bias[2, 3:] = -np.tan(lat) * from_bias[0, 3:]
    transform = np.eye(15)
    transform[6:9, 6:9] = to_phi
    transform[6:9, 9:] = from_bias
    independent = np.zeros((15, 15))
    independent[:9, :9] = np.diag(sigma**2)
    independent[9:, 9:] = bias_cov
    covariance = transform @ independent @ transform.T
    covariance = 0.5 * (covariance + covariance.T)

    error = np.zeros(15)
    error[:9] = sigma * normal(seed, "initial", 0, 1, 9)[0]
    error[9:12], error[12:] = imu.fused_bias(0)
    error = transform @ error
    r_m, r_n = radii(lat)
    h = float(truth.h[0])
    roll, pitch, heading = euler_from_dcm(exp_so3(-error[6:9]) @ c_nb)
    deviation = np.sqrt(np.diag(covariance))
    return DrawnInitialState(
        0,
        lat + float(error[0] / (r_m + h)),
        float(truth.lon[0]) + float(error[1] / ((r_n + h) * np.cos(lat))),
        h - float(error[2]),
        truth.v_n[0] + error[3:6],
        np.array([roll, pitch, heading]),
        deviation[:3],
        deviation[3:6],
        deviation[6:9],
        deviation[9:12],
        deviation[12:],
        covariance,
        error,
    )


def _bias_variance(errors: InertialErrors) -> float:
    return errors.constant**2 + errors.markov**2
