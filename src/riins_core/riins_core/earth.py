"""The Earth: WGS-84 radii, normal gravity, Earth rate and transport rate in NED.

Lives here: constants and closed forms, as broadcasting NumPy functions and as scalar kernels (suffix `_s`) with the same values.
Does not live here: frames and positions (frames.py), the mechanization (strapdown.py).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .jit import jit

A = 6378137.0
"""Semi-major axis, m."""
F = 1.0 / 298.257223563
"""Flattening."""
E2 = F * (2.0 - F)
"""First eccentricity squared."""
B = A * (1.0 - F)
"""Semi-minor axis, m."""
OMEGA_IE = 7.292115e-5
"""Earth rate, rad/s."""
GM = 3.986004418e14
"""Gravitational constant of the Earth, m^3/s^2."""
GAMMA_E = 9.7803253359
"""Normal gravity at the equator, m/s^2."""
GAMMA_P = 9.8321849378
"""Normal gravity at a pole, m/s^2."""
SOMIGLIANA = B * GAMMA_P / (A * GAMMA_E) - 1.0
"""Somigliana's constant k."""
M_RATIO = OMEGA_IE**2 * A**2 * B / GM
"""Centrifugal to gravitational acceleration, m of the gravity formula."""
STANDARD_GRAVITY = 9.80665
"""g of data sheets (ug, mg), m/s^2."""


@jit
def radii_s(lat: float) -> tuple[float, float]:
    """Radii of curvature of the ellipsoid; `radii` for one latitude."""
    s = math.sin(lat)
    w2 = 1.0 - E2 * s * s
    r_n = A / math.sqrt(w2)
    return r_n * (1.0 - E2) / w2, r_n


@jit
def gravity_s(lat: float, h: float) -> float:
    """Magnitude of normal gravity; `gravity` for one place."""
    s2 = math.sin(lat) ** 2
    surface = GAMMA_E * (1.0 + SOMIGLIANA * s2) / math.sqrt(1.0 - E2 * s2)
    x = h / A
    return surface * (1.0 - 2.0 * (1.0 + F + M_RATIO - 2.0 * F * s2) * x + 3.0 * x * x)


@jit
def gravity_gradient_s(lat: float, h: float) -> tuple[float, float]:
    """Derivatives of `gravity_s`: by latitude [m/s^2/rad] and by height [1/s^2]."""
    s = math.sin(lat)
    c = math.cos(lat)
    s2 = s * s
    w2 = 1.0 - E2 * s2
    w = math.sqrt(w2)
    surface = GAMMA_E * (1.0 + SOMIGLIANA * s2) / w
    surface_lat = 2.0 * s * c * (GAMMA_E * SOMIGLIANA / w + 0.5 * E2 * surface / w2)
    x = h / A
    slope = -2.0 * (1.0 + F + M_RATIO - 2.0 * F * s2)
    by_lat = surface_lat * (1.0 + slope * x + 3.0 * x * x) + surface * 8.0 * F * s * c * x
    by_h = surface * (slope + 6.0 * x) / A
    return by_lat, by_h


def radii(lat: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Radii of curvature of the WGS-84 ellipsoid.

    Parameters
    ----------
    lat : (...), geodetic latitude, rad

    Returns
    -------
    R_M, R_N : (...), of the meridian and of the prime vertical, m
    """
    w2 = 1.0 - E2 * np.sin(np.asarray(lat, dtype=np.float64)) ** 2
    r_n = A / np.sqrt(w2)
    return np.asarray(r_n * (1.0 - E2) / w2), np.asarray(r_n)


def gravity(lat: ArrayLike, h: ArrayLike) -> NDArray[np.float64]:
    """Magnitude of normal gravity; the vector is (0, 0, +g) in NED.

    Parameters
    ----------
    lat, h : (...), geodetic latitude [rad] and ellipsoidal height [m]

    Returns
    -------
    (...), m/s^2

    Notes
    -----
    Somigliana at the surface and its second-order series in h (NIMA TR8350.2, eqs. 4-1 and 4-3). The deflection of the vertical and the small
    north component above the ellipsoid are left out, in the simulation and in the mechanization alike.
    """
    s2 = np.sin(np.asarray(lat, dtype=np.float64)) ** 2
    surface = GAMMA_E * (1.0 + SOMIGLIANA * s2) / np.sqrt(1.0 - E2 * s2)
    x = np.asarray(h, dtype=np.float64) / A
    return np.asarray(surface * (1.0 - 2.0 * (1.0 + F + M_RATIO - 2.0 * F * s2) * x + 3.0 * x * x))


def earth_rate_n(lat: ArrayLike) -> NDArray[np.float64]:
    """Earth rate in NED.

    Parameters
    ----------
    lat : (...), rad

    Returns
    -------
    (..., 3), rad/s: OMEGA_IE (cos L, 0, -sin L)

    Notes
    -----
    Thesis ch. 3 writes the north component with the wrong sign; it is +OMEGA_IE cos L.
    """
    lat = np.asarray(lat, dtype=np.float64)
    return np.stack([OMEGA_IE * np.cos(lat), np.zeros_like(lat), -OMEGA_IE * np.sin(lat)], axis=-1)


def transport_rate_n(lat: ArrayLike, h: ArrayLike, v_n: ArrayLike) -> NDArray[np.float64]:
    """Rate of NED relative to the Earth, in NED.

    Parameters
    ----------
    lat, h : (...), rad and m
    v_n : (..., 3), velocity in NED, m/s

    Returns
    -------
    (..., 3), rad/s: (v_E / (R_N + h), -v_N / (R_M + h), -v_E tan L / (R_N + h)); singular at the poles
    """
    lat = np.asarray(lat, dtype=np.float64)
    h = np.asarray(h, dtype=np.float64)
    v = np.asarray(v_n, dtype=np.float64)
    r_m, r_n = radii(lat)
    east = v[..., 1] / (r_n + h)
    return np.stack([east, -v[..., 0] / (r_m + h), -east * np.tan(lat)], axis=-1)
