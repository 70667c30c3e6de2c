"""Scale factor and mounting errors of redundant sensors in the parity test: the covariance of the parity vector grows with the motion.

Lives here: variance of a reading's error at a rate or specific force, the parity test with it, kernels for the fusion pipeline.
Does not live here: the test without them (parity.py), tests over many samples (sequential.py; riins_imu_fusion.sequences, glr_kf_kernel).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from riins_core.jit import inner

Array = NDArray[np.float64]

SCALE2, TILT2 = 0, 1
"""Elements of the errors of one kind of sensor: variance of the scale factor, and of the tilt about each transverse axis [rad^2]."""


def error_variance(H: ArrayLike, x: ArrayLike, scale: float, misalignment: float) -> Array:
    """Variance of what scale factor and mounting add to each reading.

    Parameters
    ----------
    H : (n, 3), sensing axes, unit rows
    x : (..., 3), rate [rad/s] or specific force [m/s^2], in the axes of H
    scale : standard deviation of the scale factor
    misalignment : standard deviation of the tilt of a sensing axis about each transverse axis, rad

    Returns
    -------
    (..., n), (scale h_i'x)^2 + misalignment^2 (|x|^2 - (h_i'x)^2): a reading is (1 + s_i) h_i'x + m_i'x + noise, m_i across h_i
    """
    given = np.asarray(x, dtype=np.float64)
    along = (given @ np.asarray(H, dtype=np.float64).T) ** 2
    return np.asarray(scale**2 * along + misalignment**2 * (np.sum(given * given, axis=-1)[..., None] - along))


@inner
def errors_at(H: Array, x0: float, x1: float, x2: float, scale2: float, tilt2: float, D: Array) -> None:
    """`error_variance` at x = (x0, x1, x2), in place in D (n,)."""
    square = x0 * x0 + x1 * x1 + x2 * x2
    for i in range(H.shape[0]):
        a = H[i, 0] * x0 + H[i, 1] * x1 + H[i, 2] * x2
        D[i] = scale2 * a * a + tilt2 * max(square - a * a, 0.0)


@inner
def errors_of(H: Array, W: Array, z: Array, errors: Array, D: Array) -> None:
    """`errors_at` for the least-squares solution W z of a sample (n,), in place in D (n,); a fault in z adds its square times `errors` at most."""
    x0, x1, x2 = 0.0, 0.0, 0.0
    for i in range(z.shape[0]):
        x0 += W[0, i] * z[i]
        x1 += W[1, i] * z[i]
        x2 += W[2, i] * z[i]
    errors_at(H, x0, x1, x2, errors[SCALE2], errors[TILT2], D)


@inner
def white_in_motion(dof: int, whitened: Array, gain: Array, D: Array) -> tuple[Array, Array]:
    """Parity matrix of unit covariance when each reading has the further variance D.

    Parameters
    ----------
    dof, whitened, gain : of the test without it, as in riins_fdi.parity.ParityTest
    D : (n,)

    Returns
    -------
    white : as `whitened`, L^-1 w with L L' = I + w D w'
    gain : (n,), 1 / (v_i'v_i) of its columns; 0 where it was
    """
    n = whitened.shape[1]
    white, L = np.zeros_like(whitened), np.empty((dof, dof))
    for r in range(dof):
        for c in range(r + 1):
            a = 1.0 if r == c else 0.0
            for i in range(n):
                a += whitened[r, i] * D[i] * whitened[c, i]
            for k in range(c):
                a -= L[r, k] * L[c, k]
            L[r, c] = np.sqrt(a) if r == c else a / L[c, c]
        for i in range(n):
            a = whitened[r, i]
            for k in range(r):
                a -= L[r, k] * white[k, i]
            white[r, i] = a / L[r, r]
    scaled = np.zeros(n)
    for i in range(n):
        if gain[i] > 0.0:
            s = 0.0
            for r in range(dof):
                s += white[r, i] * white[r, i]
            scaled[i] = 1.0 / s
    return white, scaled


@inner
def rows_in_motion(rows: Array, D: Array) -> Array:
    """Equations (q, n) of unit variance, scaled to it again when each reading has the further variance D (n,)."""
    scaled = np.empty_like(rows)
    for q in range(rows.shape[0]):
        a = 1.0
        for i in range(rows.shape[1]):
            a += rows[q, i] * rows[q, i] * D[i]
        a = 1.0 / np.sqrt(a)
        for i in range(rows.shape[1]):
            scaled[q, i] = a * rows[q, i]
    return scaled
