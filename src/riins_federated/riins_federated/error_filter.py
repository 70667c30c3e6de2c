"""Error model of the navigator: 15 INS states, a Gauss-Markov drift of each gyro and the log's mounting yaw and scale factor.

Lives here: `NavError`, transition and process noise over an interval, covariance propagation, and the correction of the nominal state.
Does not live here: measurement models (aiding.py), the master and its structures (master.py), the mechanization (riins_core.strapdown).
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np

from riins_core import ins_error
from riins_core.ins_error import BA, BG, PHI, VEL, fill_dynamics
from riins_core.jit import jit
from riins_core.sensor_errors import DEG_PER_H, DEG_PER_SQRT_H, MICRO_G

from .config import NavigatorConfig
from .types import Array, InitialState

N_INS = 15
N_ERROR = 20
N_COUPLED = 9  # position, velocity, attitude: the rows of the transition that are not diagonal


class NavError(IntEnum):
    """Order of the error state; the first fifteen are riins_core.ins_error.State.

    Position [m], velocity [m/s], attitude [rad] and log parameters are computed minus true; BG, BA and GM are what is left
    of gyro bias, accelerometer bias and gyro Gauss-Markov drift after the estimate has been subtracted (rad/s, m/s^2, FRD).
    """

    POS_N = 0
    POS_E = 1
    POS_D = 2
    VEL_N = 3
    VEL_E = 4
    VEL_D = 5
    PHI_N = 6
    PHI_E = 7
    PHI_D = 8
    BG_X = 9
    BG_Y = 10
    BG_Z = 11
    BA_X = 12
    BA_Y = 13
    BA_Z = 14
    GM_X = 15
    GM_Y = 16
    GM_Z = 17
    LOG_YAW = 18
    LOG_SCALE = 19


GM = slice(15, 18)

LABELS = tuple(
    f"{name.lower()} [{unit}]"
    for name, unit in zip(
        (state.name for state in NavError),
        ["m"] * 3 + ["m/s"] * 3 + ["rad"] * 3 + ["rad/s"] * 3 + ["m/s^2"] * 3 + ["rad/s"] * 3 + ["rad", "1"],
        strict=True,
    )
)


class ProcessNoise:
    """Spectral densities and correlation times of an `InertialModel`, in SI, as the kernels want them.

    Attributes
    ----------
    density : (20,), diagonal of the continuous process noise, unit of the state squared per second
    markov_rate : 1 / correlation time of the gyro drift, 1/s
    """

    def __init__(self, config: NavigatorConfig) -> None:
        model = config.inertial
        self.markov_rate = 1.0 / model.gyro_markov_time_s
        density = np.zeros(N_ERROR)
        density[VEL] = (model.accel_vrw_ug_sqrt_hz * MICRO_G) ** 2
        density[PHI] = (model.gyro_arw_deg_sqrt_h * DEG_PER_SQRT_H) ** 2
        density[BG] = (model.gyro_bias_walk_deg_h_sqrt_h * DEG_PER_H) ** 2 / 3600.0
        density[BA] = (model.accel_bias_walk_ug_sqrt_h * MICRO_G) ** 2 / 3600.0
        density[GM] = 2.0 * (model.gyro_markov_deg_h * DEG_PER_H) ** 2 * self.markov_rate
        self.density = density


def initial_covariance(initial: InitialState, config: NavigatorConfig) -> Array:
    """Covariance of the error state at the start.

    Parameters
    ----------
    initial : its covariance, or its sigmas, with the configured bias sigmas where it gives none
    config : bias, drift and log sigmas

    Returns
    -------
    (20, 20)
    """
    model, log = config.inertial, config.doppler
    variance = np.zeros(N_ERROR)
    bias_g = np.where(np.asarray(initial.sigma_gyro_bias) > 0.0, initial.sigma_gyro_bias, model.gyro_bias_deg_h * DEG_PER_H)
    bias_a = np.where(np.asarray(initial.sigma_accel_bias) > 0.0, initial.sigma_accel_bias, model.accel_bias_ug * MICRO_G)
    sigmas = (initial.sigma_position, initial.sigma_velocity, initial.sigma_attitude, bias_g, bias_a)
    variance[:N_INS] = np.concatenate(sigmas) ** 2
    variance[GM] = (model.gyro_markov_deg_h * DEG_PER_H) ** 2
    variance[NavError.LOG_YAW] = np.radians(log.misalignment_deg) ** 2
    variance[NavError.LOG_SCALE] = (log.scale_ppm * 1e-6) ** 2
    P = np.diag(variance)
    if initial.covariance is not None:
        P[:N_INS, :N_INS] = initial.covariance
    return P


@jit
def transition(nav: Array, sums: Array, density: Array, markov_rate: float, Phi: Array, Qd: Array) -> None:
    """Transition matrix and process noise over the interval that `sums` has accumulated.

    Parameters
    ----------
    nav : (16,), nominal state at the end of the interval, as in riins_core.strapdown
    sums : (13,), sum of f^n dt, of C_nb dt, and of dt
    density, markov_rate : of ProcessNoise
    Phi, Qd : (20, 20), written

    Notes
    -----
    Second order in the interval: Phi = I + F T + (F T)^2 / 2 with specific force and attitude averaged over the interval, and
    Qd by the trapezoid rule, T/2 (Phi Q Phi' + Q). Waves turn the ship within the interval; the averages keep that.
    """
    T = sums[12]
    f_n = sums[0:3] / T
    C = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            C[i, j] = sums[3 + 3 * i + j] / T
    F = np.zeros((N_INS, N_INS))
    fill_dynamics(F, nav[0], nav[2], nav[3:6], f_n, C)
    A = np.zeros((N_ERROR, N_ERROR))  # F T
    for i in range(N_INS):
        for j in range(N_INS):
            A[i, j] = F[i, j] * T
    for i in range(3):
        for j in range(3):
            A[6 + i, 15 + j] = A[6 + i, 9 + j]
        A[15 + i, 15 + i] = -markov_rate * T
    for i in range(N_ERROR):
        for j in range(N_ERROR):
            value = A[i, j]
            if i < N_COUPLED:
                square = 0.0
                for k in range(N_ERROR):
                    square += A[i, k] * A[k, j]
                value += 0.5 * square
            elif i == j:
                value += 0.5 * A[i, i] * A[i, i]
            Phi[i, j] = value
        Phi[i, i] += 1.0
    for i in range(N_ERROR):
        for j in range(N_ERROR):
            total = 0.0
            if i < N_COUPLED or j < N_COUPLED or i == j:
                for k in range(N_ERROR):
                    total += Phi[i, k] * density[k] * Phi[j, k]
            if i == j:
                total += density[i]
            Qd[i, j] = 0.5 * T * total


@jit
def propagate(x: Array, P: Array, Phi: Array, Qd: Array, scale: float) -> None:
    """x <- Phi x, P <- Phi P Phi' + scale Qd, in place; rows beyond N_COUPLED of Phi are diagonal.

    Parameters
    ----------
    x, P : (20,), (20, 20)
    Phi, Qd : from `transition`
    scale : 1, or 1/beta of a local filter that carries a share of the process noise
    """
    n = N_ERROR
    y = np.empty(n)
    W = np.empty((n, n))
    for i in range(n):
        if i < N_COUPLED:
            total = 0.0
            for k in range(n):
                total += Phi[i, k] * x[k]
            y[i] = total
            for j in range(n):
                total = 0.0
                for k in range(n):
                    total += Phi[i, k] * P[k, j]
                W[i, j] = total
        else:
            y[i] = Phi[i, i] * x[i]
            for j in range(n):
                W[i, j] = Phi[i, i] * P[i, j]
    for i in range(n):
        x[i] = y[i]
        for j in range(i, n):
            if j < N_COUPLED:
                total = 0.0
                for k in range(n):
                    total += W[i, k] * Phi[j, k]
            else:
                total = W[i, j] * Phi[j, j]
            P[i, j] = total + scale * Qd[i, j]
            P[j, i] = P[i, j]


def correct(nav: Array, parameters: Array, x: Array) -> None:
    """Subtract the estimated errors from the nominal state, in place.

    Parameters
    ----------
    nav : (16,), latitude, longitude, height, velocity NED, C_nb row-major
    parameters : (11,), gyro bias, accelerometer bias, gyro drift, log yaw, log scale
    x : (20,), estimated error state
    """
    ins_error.correct(nav, x[:9])
    parameters[0:9] += x[9:18]  # BG, BA, GM: what was left over is now known
    parameters[9:11] -= x[18:20]
