"""Vectors in inertial frames that stand still: the attitude of the first moment from integrals of specific force and of gravity.

Lives here: `body_integrals`, `navigation_turn`, `accumulate`, `fit`. The motion of the body cancels, so no attitude is needed to begin with.
Does not live here: what is done with it (swaying.py, riins_federated.alignment_in_motion).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..jit import jit
from ..rotation import exp_so3, exp_so3_into
from .coarse import wahba
from .result import TooSoon

Array = NDArray[np.float64]


@jit
def _integrate(rate: Array, force: Array, dt: float, every: int, C: Array, u: Array) -> None:
    turn = np.empty((3, 3))
    c = np.eye(3)
    s = np.zeros(3)
    p = np.zeros(3)
    q = np.zeros(3)
    a = np.empty(3)
    b = np.empty(3)
    d = np.empty(3)
    C[0] = c
    u[0] = s
    for i in range(rate.shape[0]):
        for j in range(3):
            a[j], b[j] = rate[i, j] * dt, force[i, j] * dt
        for j in range(3):
            k, m = (j + 1) % 3, (j + 2) % 3
            sculling = (p[k] * b[m] - p[m] * b[k] + q[k] * a[m] - q[m] * a[k]) / 12.0
            d[j] = b[j] + 0.5 * (a[k] * b[m] - a[m] * b[k]) + sculling
        for r in range(3):
            s[r] += c[r, 0] * d[0] + c[r, 1] * d[1] + c[r, 2] * d[2]
        exp_so3_into(
            a[0] + (p[1] * a[2] - p[2] * a[1]) / 12.0, a[1] + (p[2] * a[0] - p[0] * a[2]) / 12.0, a[2] + (p[0] * a[1] - p[1] * a[0]) / 12.0, turn
        )
        for r in range(3):
            x, y, z = c[r, 0], c[r, 1], c[r, 2]
            for j in range(3):
                c[r, j] = x * turn[0, j] + y * turn[1, j] + z * turn[2, j]
        p[:] = a
        q[:] = b
        if i % every == every - 1:
            C[i // every + 1] = c
            u[i // every + 1] = s


def body_integrals(rate: Array, force: Array, dt: float, every: int) -> tuple[Array, Array]:
    """Attitude and integrated specific force relative to the body of the first moment.

    Parameters
    ----------
    rate, force : (m, 3), means over dt [rad/s], [m/s^2]
    dt : s
    every : samples between two rows

    Returns
    -------
    C (k + 1, 3, 3), u (k + 1, 3) : C_b0b and the integral of C_b0b f, m/s, at 0, every dt, 2 every dt, ...; k = m // every
    """
    k = len(rate) // every
    C, u = np.empty((k + 1, 3, 3)), np.empty((k + 1, 3))
    m = k * every
    _integrate(np.ascontiguousarray(rate[:m], dtype=np.float64), np.ascontiguousarray(force[:m], dtype=np.float64), dt, every, C, u)
    return C, u


def navigation_turn(rate_n: Array, step: float) -> Array:
    """C_n0n at the ends of intervals in which n turns at rate_n (k, 3) [rad/s] for `step` s each; (k + 1, 3, 3), the first is the unit matrix."""
    turns = exp_so3(np.asarray(rate_n) * step)
    C = np.empty((len(turns) + 1, 3, 3))
    C[0] = np.eye(3)
    for i, turn in enumerate(turns):
        C[i + 1] = C[i] @ turn
    return C


def accumulate(values: Array, step: float) -> Array:
    """Running integral (k + 1, 3) of values (k + 1, 3) given at the ends of k intervals of `step` s: trapezoids, from zero."""
    out = np.zeros_like(values)
    np.cumsum(0.5 * step * (values[1:] + values[:-1]), axis=0, out=out[1:])
    return out


class Fit(NamedTuple):
    """Attitude of the first moment: C (3, 3) = C_n0b0, covariance P (3, 3) of its error in n0 [rad^2], rms of the residuals, unit of the vectors."""

    C: Array
    P: Array
    rms: float


def fit(body: Array, reference: Array, degree: int) -> Fit:
    """Attitude that turns one series of vectors into another, but for a polynomial in time.

    Parameters
    ----------
    body, reference : (k, 3), at equal intervals, in b0 and in n0
    degree : of the polynomial nobody knows: 0 for velocities (the first one), 1 for positions (first place and velocity)

    Returns
    -------
    Fit

    Raises
    ------
    AlignmentError
        Fewer than ten vectors (`TooSoon`), or vectors that do not leave a line.

    Notes
    -----
    To take a polynomial out of a series commutes with a rotation: both series lose it, and what is left is Wahba's problem with equal weights.
    """
    if len(body) < 10:
        raise TooSoon(f"{len(body)} vectors are not enough for an alignment in the inertial frame")
    basis, _ = np.linalg.qr(np.vander(np.linspace(-1.0, 1.0, len(body)), degree + 1))
    b, r = body - basis @ (basis.T @ body), reference - basis @ (basis.T @ reference)
    C = wahba(b, r, np.ones(len(b)))
    residual = r - b @ C.T
    rms = float(np.sqrt(np.mean(residual**2)))
    information = np.sum(r * r) * np.eye(3) - r.T @ r
    return Fit(C, np.asarray(rms**2 * np.linalg.inv(information), dtype=np.float64), rms)
