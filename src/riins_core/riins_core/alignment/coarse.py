"""Coarse alignment at rest: attitude from gravity and the Earth rate, three ways, and the checks that it may be used at all.

Lives here: `analytic` (thesis 3-5), `triad`, `wahba` (weighted), `check_still`.
Does not live here: sensors on skew axes (redundant.py makes the two vectors of them), filters (stationary.py), a ship in waves (swaying.py).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from ..earth import OMEGA_IE, earth_rate_n, gravity
from ..rotation import orthonormalize
from .result import AlignmentError, TooSoon, check_latitude

Array = NDArray[np.float64]

FALSE_ALARM = 1e-6
"""Probability with which a base at rest is refused."""


def _references(lat: float) -> tuple[Array, Array]:
    check_latitude(lat)
    return np.array([0.0, 0.0, -float(gravity(lat, 0.0))]), earth_rate_n(lat)


def _checked(force: Array, rate: Array) -> tuple[Array, Array]:
    f, w = np.asarray(force, dtype=np.float64), np.asarray(rate, dtype=np.float64)
    if f.shape != (3,) or w.shape != (3,) or not (np.all(np.isfinite(f)) and np.all(np.isfinite(w))):
        raise AlignmentError("the mean force and rate must be three finite numbers each")
    sine = float(np.linalg.norm(np.cross(f, w)))
    if sine <= 1e-3 * float(np.linalg.norm(f)) * float(np.linalg.norm(w)):
        raise AlignmentError("force and rate are parallel or zero: they give no heading")
    return f, w


def analytic(force: Array, rate: Array, lat: float) -> Array:
    """C_nb by thesis (3-5): three vectors inverted, then made orthonormal.

    Parameters
    ----------
    force, rate : (3,), mean specific force [m/s^2] and rate [rad/s] in the body
    lat : rad

    Returns
    -------
    (3, 3)

    Raises
    ------
    AlignmentError
        Latitude beyond 85 deg, or vectors that give no heading.

    Notes
    -----
    The thesis' f^n = +g is gravity, not specific force; the triple is (f, f x w, (f x w) x f) on both sides.
    """
    f_n, w_n = _references(lat)
    f, w = _checked(force, rate)
    left = np.array([f_n, np.cross(f_n, w_n), np.cross(np.cross(f_n, w_n), f_n)])
    right = np.array([f, np.cross(f, w), np.cross(np.cross(f, w), f)])
    return orthonormalize(np.linalg.solve(left, right))


def triad(force: Array, rate: Array, lat: float) -> Array:
    """C_nb by TRIAD: down is exactly along -force, the rate gives the heading alone; parameters and errors as in `analytic`."""
    check_latitude(lat)
    f, w = _checked(force, rate)
    down = -f / np.linalg.norm(f)
    east = np.cross(down, w)  # z x (W cos L, 0, .) = W cos L along y
    east /= np.linalg.norm(east)
    return np.array([np.cross(east, down), east, down])


def wahba(body: Array, reference: Array, weight: Array) -> Array:
    """Attitude that fits pairs of vectors best: min sum w |r - C b|^2 (Wahba 1965, by SVD as Markley 1988).

    Parameters
    ----------
    body, reference : (k, 3), vectors in the body and in the reference frame; lengths count as weights
    weight : (k,), >= 0

    Returns
    -------
    (3, 3), reference = C body

    Raises
    ------
    AlignmentError
        The vectors do not span a plane.

    Notes
    -----
    With unit vectors of gravity and Earth rate and weights 1 / variance of their directions this is the maximum likelihood attitude.
    """
    B = np.asarray(reference).T @ (np.asarray(weight)[:, None] * np.asarray(body))
    u, s, vt = np.linalg.svd(B)
    if not np.all(np.isfinite(s)) or s[1] <= 1e-12 * s[0]:
        raise AlignmentError("the vectors are parallel: they give no attitude")
    return np.asarray(u @ np.diag([1.0, 1.0, np.linalg.det(u) * np.linalg.det(vt)]) @ vt)


def wahba_static(force: Array, rate: Array, lat: float, sigma_a: float, sigma_g: float) -> Array:
    """`wahba` of gravity and Earth rate with the standard deviations [m/s^2, rad/s] of the two mean vectors; otherwise as `analytic`."""
    f_n, w_n = _references(lat)
    f, w = _checked(force, rate)
    lengths = np.array([np.linalg.norm(f_n), np.linalg.norm(w_n)])
    sigma = np.array([sigma_a, sigma_g]) / lengths
    body = np.array([f / np.linalg.norm(f), w / np.linalg.norm(w)])
    return wahba(body, np.array([f_n, w_n]) / lengths[:, None], (sigma.min() / sigma) ** 2)


def check_still(rate: Array, force: Array, dt: float, lat: float, arw: float, vrw: float, sigma_g: float, sigma_a: float) -> None:
    """Refuse what is not a base at rest at this latitude.

    Parameters
    ----------
    rate, force : (m, 3), body rate [rad/s] and specific force [m/s^2]
    dt : s
    lat : rad, as given by the operator
    arw, vrw : noise densities of an axis, rad/sqrt(s) and m/s/sqrt(s)
    sigma_g, sigma_a : standard deviations of an axis' bias, rad/s and m/s^2

    Raises
    ------
    AlignmentError
        Less than two seconds of data; values that are not finite; scatter of 1 s means beyond the noise (moving); mean rate or force of a wrong
        length (moving steadily, broken); vertical and horizontal Earth rate that belong to another latitude (wrong latitude, or a steady turn).

    Notes
    -----
    Each test fails with probability `FALSE_ALARM` on a base at rest whose sensors are as stated. Micro-vibration of a quay is inside the
    noise densities one states; what passes may still be a slow steady turn as large as the bias of a gyro.
    """
    check_latitude(lat)
    per = max(1, round(1.0 / dt))
    m = len(rate) // per
    if m < 2:
        raise TooSoon(f"{len(rate) * dt:.3g} s of data are not enough: alignment at rest needs two seconds")
    if not (np.all(np.isfinite(rate)) and np.all(np.isfinite(force))):
        raise AlignmentError("the IMU data contain values that are not finite")
    second = per * dt
    for values, density, what in ((rate, arw, "rate"), (force, vrw, "force")):
        means = np.asarray(values)[: m * per].reshape(m, per, 3).mean(axis=1)
        sigma = density / math.sqrt(second)
        statistic = float(np.sum((means - means.mean(axis=0)) ** 2)) / sigma**2
        if statistic > chi2.isf(FALSE_ALARM, 3 * (m - 1)):
            ratio = math.sqrt(statistic / (3 * (m - 1)))
            raise AlignmentError(f"the base moves: the {what} varies {ratio:.1f} times as much from second to second as the sensors' noise")
    w, f, time = rate.mean(axis=0), force.mean(axis=0), len(rate) * dt
    gate = math.sqrt(chi2.isf(FALSE_ALARM, 1))
    limit_a, limit_g = gate * math.hypot(sigma_a, vrw / math.sqrt(time)), gate * math.hypot(sigma_g, arw / math.sqrt(time))
    g = float(gravity(lat, 0.0))
    if abs(float(np.linalg.norm(f)) - g) > limit_a + 1e-3:  # gravity anomalies and the height above the ellipsoid
        raise AlignmentError(f"the mean force is {np.linalg.norm(f):.5f} m/s^2 where gravity is {g:.5f}: moving, wrong latitude, or a wrong sensor")
    if abs(float(np.linalg.norm(w)) - OMEGA_IE) > limit_g:
        raise AlignmentError(f"the mean rate is {np.linalg.norm(w) / OMEGA_IE:.3g} times the Earth rate: moving, or a wrong sensor")
    down = -f / np.linalg.norm(f)
    vertical = float(w @ down)
    horizontal = float(np.linalg.norm(w - vertical * down))
    if abs(vertical + OMEGA_IE * math.sin(lat)) > limit_g or abs(horizontal - OMEGA_IE * math.cos(lat)) > limit_g:
        seen = math.degrees(math.atan2(-vertical, horizontal))
        raise AlignmentError(f"gravity and the Earth rate say latitude {seen:.1f} deg, not {math.degrees(lat):.1f}: wrong latitude, or a steady turn")
