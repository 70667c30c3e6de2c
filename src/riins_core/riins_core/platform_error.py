"""Error states of a marine platform INS with horizontal damping, the form of seed 003: its order, its dynamics, its start.

Lives here: 17 states (the paper's 15 and two accelerometer biases) in east, north, up, as continuous dynamics, process noise, initial covariance.
Does not live here: the strapdown form (ins_error.py), discretization and updates (kalman.py), the voyage (riins_eval.studies).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from .earth import OMEGA_IE, gravity_s, radii_s
from .sensor_errors import ARCMIN, ARCSEC, DEG_PER_H, DEG_PER_SQRT_H, MICRO_G

Array = NDArray[np.float64]


class PlatformState(IntEnum):
    """Order of the error states: 003's X with latitude and longitude in metres north and east, and two accelerometer biases.

    ALPHA, BETA, GAMMA: platform angles about east, north, up [rad]; DAMP_E, DAMP_N: of the damping network [m/s]; EPS_C, EPS_R: constant and
    correlated platform drift about x = east, y = north, z = up [rad/s]; B_E, B_N: accelerometer biases [m/s^2].
    """

    POS_N = 0
    POS_E = 1
    VEL_E = 2
    VEL_N = 3
    ALPHA = 4
    BETA = 5
    GAMMA = 6
    DAMP_E = 7
    DAMP_N = 8
    EPS_CX = 9
    EPS_CY = 10
    EPS_CZ = 11
    EPS_RX = 12
    EPS_RY = 13
    EPS_RZ = 14
    B_E = 15
    B_N = 16


N_PLATFORM = 17


@dataclass(frozen=True)
class Damping:
    """Horizontal damping network H(s) = k1 + k3 / (s + k2); k2 and k3 in 1/s. k1 = 1, k3 = 0 is undamped.

    003 lost its coefficients; these have H(0) = 1, damping ratio 0.5 and 1.5 times the Schuler frequency.
    """

    k1: float = 4.05
    k2: float = 3.350e-3
    k3: float = -1.0217e-2


UNDAMPED = Damping(1.0, 3.350e-3, 0.0)


@dataclass(frozen=True)
class PlatformNoise:
    """Errors of the (fused) sensors, in SI; the defaults are those chosen for 003, which lost its own."""

    constant_drift: float = 0.01 * DEG_PER_H
    markov_drift: float = 0.003 * DEG_PER_H
    markov_time: float = 3600.0
    bias: float = 50.0 * MICRO_G
    arw: float = 0.002 * DEG_PER_SQRT_H
    vrw: float = 10.0 * MICRO_G

    def density(self) -> Array:
        """Diagonal of the continuous process noise (17,), unit of the state squared per second."""
        q = np.zeros(N_PLATFORM)
        q[PlatformState.VEL_E : PlatformState.ALPHA] = self.vrw**2
        q[PlatformState.ALPHA : PlatformState.DAMP_E] = self.arw**2
        q[PlatformState.EPS_RX : PlatformState.B_E] = 2.0 * self.markov_drift**2 / self.markov_time
        return q


def platform_dynamics(lat: float, v_e: float, v_n: float, f_e: float, f_n: float, damping: Damping, markov_time: float) -> Array:
    """Continuous dynamics F (17, 17), x' = F x + w.

    Parameters
    ----------
    lat : rad
    v_e, v_n : true velocity east and north, m/s
    f_e, f_n : specific force east and north, m/s^2 (vertical: gravity)
    damping : network between velocity and platform
    markov_time : of the correlated drift, s

    Notes
    -----
    003 (1)-(3); its velocity and position equations and its damping are lost and taken as in errata.md. With dN = R_M dphi and
    dE = R_N cos(phi) dlam, dE' keeps what the narrowing of the meridians adds: (v_e dN / R_M - v_n dE / R_M) tan(phi).
    """
    F = np.zeros((N_PLATFORM, N_PLATFORM))
    s = PlatformState
    r_m, r_n = radii_s(lat)
    sin, cos = math.sin(lat), math.cos(lat)
    tan, sec2 = sin / cos, 1.0 / (cos * cos)
    w_up, w_north = OMEGA_IE * sin, OMEGA_IE * cos
    f_u = gravity_s(lat, 0.0)
    F[s.POS_N, s.VEL_N] = 1.0
    F[s.POS_E, s.VEL_E], F[s.POS_E, s.POS_N], F[s.POS_E, s.POS_E] = 1.0, v_e * tan / r_m, -v_n * tan / r_m
    F[s.VEL_E, s.GAMMA], F[s.VEL_E, s.BETA], F[s.VEL_E, s.B_E] = f_n, -f_u, 1.0
    F[s.VEL_E, s.VEL_E], F[s.VEL_E, s.VEL_N] = v_n * tan / r_n, 2.0 * w_up + v_e * tan / r_n
    F[s.VEL_E, s.POS_N] = (2.0 * w_north * v_n + v_e * v_n * sec2 / r_n) / r_m
    F[s.VEL_N, s.GAMMA], F[s.VEL_N, s.ALPHA], F[s.VEL_N, s.B_N] = -f_e, f_u, 1.0
    F[s.VEL_N, s.VEL_E] = -2.0 * (w_up + v_e * tan / r_n)
    F[s.VEL_N, s.POS_N] = -(2.0 * w_north * v_e + v_e * v_e * sec2 / r_n) / r_m
    F[s.ALPHA, s.VEL_N], F[s.ALPHA, s.DAMP_N] = -damping.k1 / r_m, -1.0 / r_m
    F[s.ALPHA, s.BETA], F[s.ALPHA, s.GAMMA] = w_up + v_e * tan / r_n, -(w_north + v_e / r_n)
    F[s.BETA, s.VEL_E], F[s.BETA, s.DAMP_E] = damping.k1 / r_n, 1.0 / r_n
    F[s.BETA, s.POS_N] = -w_up / r_m
    F[s.BETA, s.ALPHA], F[s.BETA, s.GAMMA] = -(w_up + v_e * tan / r_n), -v_n / r_m
    F[s.GAMMA, s.VEL_E], F[s.GAMMA, s.DAMP_E] = damping.k1 * tan / r_n, tan / r_n
    F[s.GAMMA, s.POS_N] = (w_north + v_e * sec2 / r_n) / r_m
    F[s.GAMMA, s.ALPHA], F[s.GAMMA, s.BETA] = w_north + v_e / r_n, v_n / r_m
    for axis in range(3):
        F[s.ALPHA + axis, s.EPS_CX + axis] = F[s.ALPHA + axis, s.EPS_RX + axis] = 1.0
        F[s.EPS_RX + axis, s.EPS_RX + axis] = -1.0 / markov_time
    F[s.DAMP_E, s.DAMP_E], F[s.DAMP_E, s.VEL_E] = -damping.k2, damping.k3
    F[s.DAMP_N, s.DAMP_N], F[s.DAMP_N, s.VEL_N] = -damping.k2, damping.k3
    return F


def self_aligned(lat: float, noise: PlatformNoise, position: float = 30.0, velocity: float = 0.1) -> Array:
    """Square root A (17, 17) of the covariance of a ship that has aligned itself: x0 = A times standard normals.

    Parameters
    ----------
    lat : rad
    noise : of the sensors
    position, velocity : initial sigma per axis, m and m/s

    Notes
    -----
    The level is where the accelerometers read zero (alpha = -b_N / g, beta = b_E / g) but for 5 arcsec, the azimuth where the gyrocompass
    settles (eps_x / (W cos phi)) but for 0.5 arcmin; the damping network is at rest.
    """
    s = PlatformState
    A = np.diag(
        [position, position, velocity, velocity, 5.0 * ARCSEC, 5.0 * ARCSEC, 0.5 * ARCMIN, 0.0, 0.0]
        + [noise.constant_drift] * 3 + [noise.markov_drift] * 3 + [noise.bias] * 2
    )  # fmt: skip
    g = gravity_s(lat, 0.0)
    A[s.ALPHA, s.B_N], A[s.BETA, s.B_E] = -noise.bias / g, noise.bias / g
    for drift in (s.EPS_CX, s.EPS_RX):
        A[s.GAMMA, drift] = A[drift, drift] / (OMEGA_IE * math.cos(lat))
    return A
