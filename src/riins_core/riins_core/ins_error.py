"""Error states of the strapdown INS: their order, their dynamics, and how a correction is applied.

Lives here: the 15-state model (position, velocity, attitude, gyro and accelerometer biases) in NED, errors = computed - true.
Does not live here: sensor states of aids (riins_federated.local_filter), discretization and updates (kalman.py).
"""

from __future__ import annotations

import math
from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .earth import E2, OMEGA_IE, gravity_gradient_s, radii_s
from .jit import jit
from .rotation import exp_so3_into
from .strapdown import NAV_SIZE

Array = NDArray[np.float64]


class State(IntEnum):
    """Order of the error states; position in metres NED, so POS_D = -(computed - true height)."""

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


POS = slice(0, 3)
VEL = slice(3, 6)
PHI = slice(6, 9)
BG = slice(9, 12)
BA = slice(12, 15)
N_STATES = 15


@jit
def fill_dynamics(F: Array, lat: float, h: float, v_n: Array, f_n: Array, C_nb: Array) -> None:
    """Write the continuous dynamics of the 15 states into F[0:15, 0:15]: x' = F x + noise.

    Parameters
    ----------
    F : (>= 15, >= 15), the leading block is overwritten, the rest is left alone
    lat, h : rad, m
    v_n : (3,), velocity NED, m/s
    f_n : (3,), specific force in NED, m/s^2 (at rest (0, 0, -g))
    C_nb : (3, 3)

    Notes
    -----
    With errors computed - true and computed C_nb = (I - [phi x]) true C_nb (conventions):
    dv' = f x phi + C_nb b_a - (2 w_ie + w_en) x dv - (2 d w_ie + d w_en) x v + d g,  phi' = -w_in x phi + d w_in - C_nb b_g.
    Every first-order term is kept, also the change of the radii and of gravity with latitude, so F is the exact Jacobian of the
    mechanization in these coordinates: dN = dL (R_M + h), dE = dl (R_N + h) cos L, dD = -dh.
    Wrong in the thesis: (6-7) needs w_in; (6-14)/(6-15) need -(2 d w_ie + d w_en) x v, and + d g; F11(3,5) is -tan L / R, F12(1,4) -v_E / R^2;
    F22(2,4), dv_D against h, lacks -2 g / R. Its f^n = +g in ch. 3 is gravity, not specific force. Likewise 002 (12) lacks d g / d h.
    """
    for i in range(15):
        for j in range(15):
            F[i, j] = 0.0
    s, c = math.sin(lat), math.cos(lat)
    tan = s / c
    r_m, r_n = radii_s(lat)
    w2 = 1.0 - E2 * s * s
    r_m_lat = 3.0 * E2 * s * c / w2 * r_m  # derivatives of the radii by latitude
    r_n_lat = E2 * s * c / w2 * r_n
    m, n = r_m + h, r_n + h
    vn, ve, vd = v_n[0], v_n[1], v_n[2]
    by_lat, by_h = gravity_gradient_s(lat, h)

    # Jacobians of w_ie and w_en by latitude error dN / m and by dD = -dh: columns 0 and 2 of the angular rates
    ie_n, ie_d = OMEGA_IE * c, -OMEGA_IE * s
    en_n, en_e, en_d = ve / n, -vn / m, -ve * tan / n
    die_n, die_d = -OMEGA_IE * s / m, -OMEGA_IE * c / m
    den_n0, den_n2 = -ve * r_n_lat / (n * n) / m, ve / (n * n)
    den_e0, den_e2 = vn * r_m_lat / (m * m) / m, -vn / (m * m)
    den_d0 = (-ve / (c * c * n) + ve * tan * r_n_lat / (n * n)) / m
    den_d2 = -ve * tan / (n * n)

    # position in metres: the terms beyond dv come from metres that shrink or grow while the ship moves
    F[0, 0], F[0, 2], F[0, 3] = -vd / m, vn / m, 1.0
    F[1, 0], F[1, 1], F[1, 2], F[1, 4] = ve * tan / n, -(vn * tan + vd) / n, ve / n, 1.0
    F[2, 5] = 1.0

    # velocity by position: -(2 d w_ie + d w_en) x v + d g
    an0, ae0, ad0 = 2.0 * die_n + den_n0, den_e0, 2.0 * die_d + den_d0
    F[3, 0], F[4, 0], F[5, 0] = -(ae0 * vd - ad0 * ve), -(ad0 * vn - an0 * vd), -(an0 * ve - ae0 * vn) + by_lat / m
    F[3, 2], F[4, 2], F[5, 2] = -(den_e2 * vd - den_d2 * ve), -(den_d2 * vn - den_n2 * vd), -(den_n2 * ve - den_e2 * vn) - by_h
    # velocity by velocity: -(2 w_ie + w_en) x dv - (d w_en / dv) x v
    wn, we, wd = 2.0 * ie_n + en_n, en_e, 2.0 * ie_d + en_d
    F[3, 3], F[3, 4], F[3, 5] = vd / m, wd - ve * tan / n, -we
    F[4, 3], F[4, 4], F[4, 5] = -wd, (vn * tan + vd) / n, wn
    F[5, 3], F[5, 4] = we - vn / m, -wn - ve / n
    # velocity by attitude: f x phi, and by accelerometer bias
    F[3, 7], F[3, 8] = -f_n[2], f_n[1]
    F[4, 6], F[4, 8] = f_n[2], -f_n[0]
    F[5, 6], F[5, 7] = -f_n[1], f_n[0]

    # attitude: d w_in by position and velocity, -w_in x phi, gyro bias
    F[6, 0], F[6, 2], F[6, 4] = die_n + den_n0, den_n2, 1.0 / n
    F[7, 0], F[7, 2], F[7, 3] = den_e0, den_e2, -1.0 / m
    F[8, 0], F[8, 2], F[8, 4] = die_d + den_d0, den_d2, -tan / n
    wn, we, wd = ie_n + en_n, en_e, ie_d + en_d
    F[6, 7], F[6, 8] = wd, -we
    F[7, 6], F[7, 8] = -wd, wn
    F[8, 6], F[8, 7] = we, -wn
    for i in range(3):
        for j in range(3):
            F[3 + i, 12 + j] = C_nb[i, j]
            F[6 + i, 9 + j] = -C_nb[i, j]


def error_dynamics(nav: ArrayLike, f_n: ArrayLike, C_nb: ArrayLike | None = None) -> Array:
    """F (15, 15) of the error states; `fill_dynamics` for a navigation state.

    Parameters
    ----------
    nav : (>= 6,), latitude, longitude, height, velocity NED, and C_nb in 6..14 where `C_nb` is not given
    f_n : (3,), specific force in NED, m/s^2
    C_nb : (3, 3), None: that of `nav`
    """
    state = np.asarray(nav, dtype=np.float64)
    c = np.ascontiguousarray(state[6:15].reshape(3, 3) if C_nb is None else C_nb, dtype=np.float64)
    F = np.zeros((N_STATES, N_STATES))
    fill_dynamics(F, float(state[0]), float(state[2]), np.ascontiguousarray(state[3:6]), np.ascontiguousarray(f_n, dtype=np.float64), c)
    return F


def noise_input(C_nb: ArrayLike) -> Array:
    """G (15, 6) of white gyro and accelerometer noise in the body: phi' has -C_nb w_g, dv' has +C_nb w_a; the rest is zero.

    The thesis' and 002's G lack three zero rows.
    """
    c = np.asarray(C_nb, dtype=np.float64)
    G = np.zeros((N_STATES, 6))
    G[PHI, 0:3] = -c
    G[VEL, 3:6] = c
    return G


@jit
def correct_into(nav: Array, x: Array, turn: Array) -> None:
    """`correct` for kernels: nothing is checked, `turn` (3, 3) is work space."""
    r_m, r_n = radii_s(nav[0])
    m, n = r_m + nav[2], r_n + nav[2]
    nav[1] -= x[1] / (n * math.cos(nav[0]))
    nav[0] -= x[0] / m
    nav[2] += x[2]
    for i in range(3):
        nav[3 + i] -= x[3 + i]
    exp_so3_into(x[6], x[7], x[8], turn)
    for j in range(3):
        a, b, c = nav[6 + j], nav[9 + j], nav[12 + j]
        for i in range(3):
            nav[6 + 3 * i + j] = turn[i, 0] * a + turn[i, 1] * b + turn[i, 2] * c


def correct(nav: Array, x: ArrayLike) -> None:
    """Take the estimated errors out of a navigation state, in place.

    Parameters
    ----------
    nav : (16,), see `strapdown`
    x : (>= 9,), estimated errors, computed - true; C_nb <- exp(+[phi x]) C_nb
    """
    if nav.shape != (NAV_SIZE,):
        raise ValueError(f"a navigation state has {NAV_SIZE} elements, not {nav.shape}")
    correct_into(nav, np.ascontiguousarray(x, dtype=np.float64), np.empty((3, 3)))


def difference(nav: Array, true: Array) -> Array:
    """Errors (9,) of a navigation state against another: position NED [m], velocity [m/s], phi [rad]; `correct` undoes it to first order.

    Parameters
    ----------
    nav, true : (>= 15,), computed and true
    """
    r_m, r_n = radii_s(float(nav[0]))
    e = np.empty(9)
    dlon = math.remainder(float(nav[1] - true[1]), 2.0 * math.pi)
    e[0], e[1], e[2] = (nav[0] - true[0]) * (r_m + nav[2]), dlon * (r_n + nav[2]) * math.cos(nav[0]), true[2] - nav[2]
    e[3:6] = nav[3:6] - true[3:6]
    c = true[6:15].reshape(3, 3) @ nav[6:15].reshape(3, 3).T  # exp(+phi)
    s = 0.5 * np.array([c[2, 1] - c[1, 2], c[0, 2] - c[2, 0], c[1, 0] - c[0, 1]])
    sine = float(np.linalg.norm(s))
    e[6:9] = s * (math.atan2(sine, 0.5 * (float(np.trace(c)) - 1.0)) / sine if sine > 1e-12 else 1.0)
    return e
