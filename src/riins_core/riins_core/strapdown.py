"""Strapdown mechanization in NED: coning and sculling increments, attitude, velocity and position, sample by sample.

Lives here: the kernels `strapdown_block` and `strapdown_slaved`, and the layout of the navigation state they work on.
Does not live here: error states and corrections (ins_error.py, the navigator), the vertical channel's aiding.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .earth import E2, OMEGA_IE, A, gravity_s
from .jit import jit
from .rotation import exp_so3_into

Array = NDArray[np.float64]

LAT, LON, H, V_N, V_E, V_D = range(6)
"""Elements of a navigation state: rad, rad, m, m/s."""
C_NB = slice(6, 15)
"""C_nb, row-major, in a navigation state."""
DT_PREV = 15
"""Length of the previous sample in a navigation state, s; 0: there is none."""
NAV_SIZE = 16

SUM_FORCE = slice(0, 3)
"""Sum of f^n dt, m/s, in `sums`."""
SUM_C_NB = slice(3, 12)
"""Sum of C_nb dt, row-major, in `sums`."""
SUM_DT = 12
"""Sum of dt, s, in `sums`."""
SUMS_SIZE = 13


class StrapdownState:
    """Everything the mechanization remembers between samples, as plain arrays; copied for a roll-back.

    Attributes
    ----------
    nav : (16,), latitude, longitude [rad], height [m], velocity NED [m/s], C_nb row-major, length of the previous sample [s]
    dtheta_prev, dv_prev : (3,), previous increments [rad], [m/s], bias removed
    sums : (13,), sums of f^n dt, C_nb dt and dt since `sums[:] = 0`
    """

    def __init__(self, lat: float, lon: float, h: float, v_n: ArrayLike, c_nb: ArrayLike) -> None:
        self.nav: Array = np.zeros(NAV_SIZE)
        self.nav[:3] = lat, lon, h
        self.nav[3:6] = v_n
        self.nav[C_NB] = np.asarray(c_nb, dtype=np.float64).reshape(9)
        self.dtheta_prev: Array = np.zeros(3)
        self.dv_prev: Array = np.zeros(3)
        self.sums: Array = np.zeros(SUMS_SIZE)

    def copy(self) -> StrapdownState:
        """Independent copy."""
        other = StrapdownState(0.0, 0.0, 0.0, self.nav[3:6], self.nav[C_NB])
        other.nav[:] = self.nav
        other.dtheta_prev[:] = self.dtheta_prev
        other.dv_prev[:] = self.dv_prev
        other.sums[:] = self.sums
        return other

    def forget_previous(self) -> None:
        """Drop the previous sample: call it when a gap or a restart breaks the sequence."""
        self.nav[DT_PREV] = 0.0
        self.dtheta_prev[:] = 0.0
        self.dv_prev[:] = 0.0

    def propagate(self, rate: Array, force: Array, dt: Array, bias_g: Array, bias_a: Array) -> None:
        """Advance by a block; see `strapdown_block`."""
        strapdown_block(self.nav, self.dtheta_prev, self.dv_prev, rate, force, dt, bias_g, bias_a, self.sums)

    @property
    def v_n(self) -> Array:
        """(3,), velocity NED, m/s; a view."""
        return self.nav[3:6]

    @property
    def c_nb(self) -> Array:
        """(3, 3), a view."""
        return self.nav[C_NB].reshape(3, 3)


@jit
def _advance(
    nav: Array,
    dtheta_prev: Array,
    dv_prev: Array,
    ax: float,
    ay: float,
    az: float,
    bx: float,
    by: float,
    bz: float,
    dt: float,
    sums: Array,
    turn: Array,
) -> None:
    """One sample: increments a [rad] and b [m/s] of length dt; `turn` (3, 3) is room to work in."""
    # previous increments; the factor is 1 unless the sample rate changes: then it keeps the slope of a rate linear over both samples
    previous = nav[15]
    ratio = 2.0 * dt * dt / (previous * (previous + dt)) if previous > 0.0 else 0.0
    px, py, pz = ratio * dtheta_prev[0], ratio * dtheta_prev[1], ratio * dtheta_prev[2]
    qx, qy, qz = ratio * dv_prev[0], ratio * dv_prev[1], ratio * dv_prev[2]

    # rotation vector with coning
    rx = ax + (py * az - pz * ay) / 12.0
    ry = ay + (pz * ax - px * az) / 12.0
    rz = az + (px * ay - py * ax) / 12.0

    # velocity increment in b at the start of the sample: rotation during the sample to fourth order, and sculling
    a2 = ax * ax + ay * ay + az * az
    k1 = 0.5 - a2 / 24.0
    k2 = 1.0 / 6.0 - a2 / 120.0
    sx, sy, sz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    ux = bx + k1 * sx + k2 * (ay * sz - az * sy) + (py * bz - pz * by + qy * az - qz * ay) / 12.0
    uy = by + k1 * sy + k2 * (az * sx - ax * sz) + (pz * bx - px * bz + qz * ax - qx * az) / 12.0
    uz = bz + k1 * sz + k2 * (ax * sy - ay * sx) + (px * by - py * bx + qx * ay - qy * ax) / 12.0

    c00, c01, c02 = nav[6], nav[7], nav[8]
    c10, c11, c12 = nav[9], nav[10], nav[11]
    c20, c21, c22 = nav[12], nav[13], nav[14]
    fx = c00 * ux + c01 * uy + c02 * uz
    fy = c10 * ux + c11 * uy + c12 * uz
    fz = c20 * ux + c21 * uy + c22 * uz

    # place in the middle of the sample
    vn, ve, vd = nav[3], nav[4], nav[5]
    s = math.sin(nav[0])
    w2 = 1.0 - E2 * s * s
    r_n = A / math.sqrt(w2)
    r_m = r_n * (1.0 - E2) / w2
    lat = nav[0] + 0.5 * dt * vn / (r_m + nav[2])
    h = nav[2] - 0.5 * dt * vd
    s = math.sin(lat)
    c = math.cos(lat)
    w2 = 1.0 - E2 * s * s
    r_n = A / math.sqrt(w2)
    r_m = r_n * (1.0 - E2) / w2 + h
    r_n += h
    tan = s / c
    g = gravity_s(lat, h)
    ie_n = OMEGA_IE * c
    ie_d = -OMEGA_IE * s

    # velocity in the middle of the sample, predicted; then the rates of n that go with it
    en_n, en_e = ve / r_n, -vn / r_m
    en_d = -en_n * tan
    cn, ce, cd = 2.0 * ie_n + en_n, en_e, 2.0 * ie_d + en_d
    mn = vn + 0.5 * (fx - (ce * vd - cd * ve) * dt)
    me = ve + 0.5 * (fy - (cd * vn - cn * vd) * dt)
    md = vd + 0.5 * (fz + (g - (cn * ve - ce * vn)) * dt)
    en_n, en_e = me / r_n, -mn / r_m
    en_d = -en_n * tan
    cn, ce, cd = 2.0 * ie_n + en_n, en_e, 2.0 * ie_d + en_d
    zx, zy, zz = (ie_n + en_n) * dt, en_e * dt, (ie_d + en_d) * dt

    # specific force: n turns by z during the sample, on average by half of it
    gx = fx - 0.5 * (zy * fz - zz * fy)
    gy = fy - 0.5 * (zz * fx - zx * fz)
    gz = fz - 0.5 * (zx * fy - zy * fx)
    wn = vn + gx - (ce * md - cd * me) * dt
    we = ve + gy - (cd * mn - cn * md) * dt
    wd = vd + gz + (g - (cn * me - ce * mn)) * dt

    # position: trapezoid of velocity, radii in the middle
    nav[0] += 0.5 * (vn + wn) * dt / r_m
    lon = nav[1] + 0.5 * (ve + we) * dt / (r_n * c)
    if lon > math.pi:
        lon -= 2.0 * math.pi
    elif lon < -math.pi:
        lon += 2.0 * math.pi
    nav[1] = lon
    nav[2] -= 0.5 * (vd + wd) * dt
    nav[3], nav[4], nav[5] = wn, we, wd

    # attitude: C <- exp(-z) C exp(r)
    exp_so3_into(rx, ry, rz, turn)
    t00 = c00 * turn[0, 0] + c01 * turn[1, 0] + c02 * turn[2, 0]
    t01 = c00 * turn[0, 1] + c01 * turn[1, 1] + c02 * turn[2, 1]
    t02 = c00 * turn[0, 2] + c01 * turn[1, 2] + c02 * turn[2, 2]
    t10 = c10 * turn[0, 0] + c11 * turn[1, 0] + c12 * turn[2, 0]
    t11 = c10 * turn[0, 1] + c11 * turn[1, 1] + c12 * turn[2, 1]
    t12 = c10 * turn[0, 2] + c11 * turn[1, 2] + c12 * turn[2, 2]
    t20 = c20 * turn[0, 0] + c21 * turn[1, 0] + c22 * turn[2, 0]
    t21 = c20 * turn[0, 1] + c21 * turn[1, 1] + c22 * turn[2, 1]
    t22 = c20 * turn[0, 2] + c21 * turn[1, 2] + c22 * turn[2, 2]
    exp_so3_into(-zx, -zy, -zz, turn)
    d00 = turn[0, 0] * t00 + turn[0, 1] * t10 + turn[0, 2] * t20
    d01 = turn[0, 0] * t01 + turn[0, 1] * t11 + turn[0, 2] * t21
    d02 = turn[0, 0] * t02 + turn[0, 1] * t12 + turn[0, 2] * t22
    d10 = turn[1, 0] * t00 + turn[1, 1] * t10 + turn[1, 2] * t20
    d11 = turn[1, 0] * t01 + turn[1, 1] * t11 + turn[1, 2] * t21
    d12 = turn[1, 0] * t02 + turn[1, 1] * t12 + turn[1, 2] * t22
    d20 = turn[2, 0] * t00 + turn[2, 1] * t10 + turn[2, 2] * t20
    d21 = turn[2, 0] * t01 + turn[2, 1] * t11 + turn[2, 2] * t21
    d22 = turn[2, 0] * t02 + turn[2, 1] * t12 + turn[2, 2] * t22

    # orthonormal again at every sample: rows share the small error evenly, C <- (3 I - C C') C / 2
    e00 = 1.5 - 0.5 * (d00 * d00 + d01 * d01 + d02 * d02)
    e11 = 1.5 - 0.5 * (d10 * d10 + d11 * d11 + d12 * d12)
    e22 = 1.5 - 0.5 * (d20 * d20 + d21 * d21 + d22 * d22)
    e01 = -0.5 * (d00 * d10 + d01 * d11 + d02 * d12)
    e02 = -0.5 * (d00 * d20 + d01 * d21 + d02 * d22)
    e12 = -0.5 * (d10 * d20 + d11 * d21 + d12 * d22)
    nav[6] = e00 * d00 + e01 * d10 + e02 * d20
    nav[7] = e00 * d01 + e01 * d11 + e02 * d21
    nav[8] = e00 * d02 + e01 * d12 + e02 * d22
    nav[9] = e01 * d00 + e11 * d10 + e12 * d20
    nav[10] = e01 * d01 + e11 * d11 + e12 * d21
    nav[11] = e01 * d02 + e11 * d12 + e12 * d22
    nav[12] = e02 * d00 + e12 * d10 + e22 * d20
    nav[13] = e02 * d01 + e12 * d11 + e22 * d21
    nav[14] = e02 * d02 + e12 * d12 + e22 * d22

    dtheta_prev[0], dtheta_prev[1], dtheta_prev[2] = ax, ay, az
    dv_prev[0], dv_prev[1], dv_prev[2] = bx, by, bz
    nav[15] = dt

    half = 0.5 * dt
    sums[0] += gx
    sums[1] += gy
    sums[2] += gz
    sums[3] += half * (c00 + nav[6])
    sums[4] += half * (c01 + nav[7])
    sums[5] += half * (c02 + nav[8])
    sums[6] += half * (c10 + nav[9])
    sums[7] += half * (c11 + nav[10])
    sums[8] += half * (c12 + nav[11])
    sums[9] += half * (c20 + nav[12])
    sums[10] += half * (c21 + nav[13])
    sums[11] += half * (c22 + nav[14])
    sums[12] += dt


@jit
def _advance_sample(
    nav: Array, dtheta_prev: Array, dv_prev: Array, rate: Array, force: Array, dt: float, bias_g: Array, bias_a: Array, sums: Array, turn: Array
) -> None:
    _advance(
        nav,
        dtheta_prev,
        dv_prev,
        (rate[0] - bias_g[0]) * dt,
        (rate[1] - bias_g[1]) * dt,
        (rate[2] - bias_g[2]) * dt,
        (force[0] - bias_a[0]) * dt,
        (force[1] - bias_a[1]) * dt,
        (force[2] - bias_a[2]) * dt,
        dt,
        sums,
        turn,
    )


@jit
def strapdown_block(
    nav: Array,
    dtheta_prev: Array,
    dv_prev: Array,
    rate: Array,
    force: Array,
    dt: Array,
    bias_g: Array,
    bias_a: Array,
    sums: Array,
) -> None:
    """Advance the navigation state by a block of samples, in place.

    Parameters
    ----------
    nav : (16,), latitude, longitude [rad], height [m], velocity NED [m/s], C_nb row-major, length of the previous sample [s] (0: none)
    dtheta_prev, dv_prev : (3,), previous increments, bias removed [rad], [m/s]
    rate, force : (m, 3), mean rate [rad/s] and specific force [m/s^2] of the body, FRD, over (stamp - dt, stamp]
    dt : (m,), lengths of the samples, s, > 0
    bias_g, bias_a : (3,), measured - true, subtracted from every sample [rad/s], [m/s^2]
    sums : (13,), added to: f^n dt [m/s], C_nb dt (mean of both ends), dt

    Notes
    -----
    Attitude: rotation vector a + 1/12 a_prev x a. Velocity: b + 1/2 a x b + 1/6 a x (a x b) + 1/12 (a_prev x b + b_prev x a), the two-sample form of
    Savage (1998, part 1 eq. 47, part 2 eq. 56) applied at every sample, so the kernel has no phase and any split into blocks gives the same bits.
    Coriolis, transport rate and gravity are taken in the middle of the sample, position is the trapezoid of velocity. When the
    sample rate changes the previous increments are scaled as a rate linear in time demands. C_nb is made orthonormal at every sample.
    The vertical channel is free, hence unstable over minutes: aid it, or use `strapdown_slaved`. Singular at the poles.
    The seeds' mechanization, thesis (6-7), rotates by the wrong rate: the attitude needs w_in = w_ie + w_en.
    """
    turn = np.empty((3, 3))
    for i in range(rate.shape[0]):
        _advance_sample(nav, dtheta_prev, dv_prev, rate[i], force[i], dt[i], bias_g, bias_a, sums, turn)


@jit
def strapdown_slaved(
    nav: Array,
    dtheta_prev: Array,
    dv_prev: Array,
    rate: Array,
    force: Array,
    dt: Array,
    bias_g: Array,
    bias_a: Array,
    sums: Array,
    height: Array,
    v_down: Array,
) -> None:
    """`strapdown_block` with the vertical channel slaved: after each sample height and vertical velocity are set to given values.

    Parameters
    ----------
    nav .. sums : as in `strapdown_block`
    height : (m,), at the stamps, m
    v_down : (m,), at the stamps, m/s
    """
    turn = np.empty((3, 3))
    for i in range(rate.shape[0]):
        _advance_sample(nav, dtheta_prev, dv_prev, rate[i], force[i], dt[i], bias_g, bias_a, sums, turn)
        nav[2] = height[i]
        nav[5] = v_down[i]
