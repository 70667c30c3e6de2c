"""Tests on the state: extended RAIM, separation of solutions with a protection level, and one satellite system checked against another.

Lives here: statistics, thresholds and protection level of one epoch, as functions of estimates and covariances.
Does not live here: the filters that give the solutions (riins_federated.structures), tests over many innovations (innovation_tests).
"""

from __future__ import annotations

import functools

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike, NDArray

from riins_core.jit import jit
from riins_core.kalman import cholesky_into
from riins_fdi.innovation import nis_threshold

Array = NDArray[np.float64]

_SINGULAR = 1e-3
"""Directions in which the separation has less variance than this part of the solution's own are not tested."""


def eraim_statistic(x: ArrayLike, P: ArrayLike, z: ArrayLike, H: ArrayLike, R: ArrayLike) -> float:
    """Global test of extended RAIM: weighted residuals of the least squares over measurement and prediction together.

    Parameters
    ----------
    x, P : (n,), (n, n), predicted state and covariance
    z, H, R : (m,), (m, n), (m, m), measurement z = H x + v

    Returns
    -------
    v' W v of [z; x] = [H; I] x + v, chi-square with m degrees of freedom

    Notes
    -----
    002, 4.2.1 gives no formula. The residuals weighted with the inverse of diag(R, P) are the innovation weighted with the inverse of
    H P H' + R: this is the NIS (target 44), at the cost of a least squares over n + m rows. The navigator uses the NIS.
    """
    prediction, measurement = np.asarray(x, dtype=np.float64), np.asarray(z, dtype=np.float64)
    design = np.asarray(H, dtype=np.float64)
    root_p = np.linalg.cholesky(np.asarray(P, dtype=np.float64))
    root_r = np.linalg.cholesky(np.asarray(R, dtype=np.float64))
    # unknown: P^(-1/2) (state - prediction), so that the rows of the prediction are the identity whatever its units
    rows = np.vstack([scipy.linalg.solve_triangular(root_r, design @ root_p, lower=True), np.eye(prediction.size)])
    right = np.append(scipy.linalg.solve_triangular(root_r, measurement - design @ prediction, lower=True), np.zeros(prediction.size))
    residual = right - rows @ np.linalg.lstsq(rows, right, rcond=None)[0]
    return float(residual @ residual)


@jit
def separation_into(x_all: Array, P_all: Array, x_loo: Array, P_loo: Array, states: NDArray[np.int64], D: Array) -> tuple[float, int]:
    """Kernel: the solution with all aids against one that has left an aid out, d' D^-1 d over some of their states.

    Parameters
    ----------
    x_all, P_all, x_loo, P_loo : (n,), (n, n)
    states : (m,), those compared
    D : (m, m), written: covariance of the difference, directions without a test set to zero

    Returns
    -------
    statistic, chi-square distributed without a fault, and degrees of freedom; it is correlated over minutes, so false onsets are fewer than tests.
    D is P_loo - P_all, since the solution with all aids is optimal and uses all the other one uses (Brenner 1996). Just after one has been put in
    the place of the other it is nearly singular: those directions are left out.
    """
    m = states.shape[0]
    A, V, scale, e = np.empty((m, m)), np.empty((m, m)), np.empty(m), np.empty(m)
    for i in range(m):  # metres and radians may stand side by side
        v = P_all[states[i], states[i]]
        scale[i] = 1.0 / np.sqrt(v) if v > 0.0 else 0.0
        e[i] = (x_all[states[i]] - x_loo[states[i]]) * scale[i]
    for i in range(m):
        for j in range(m):
            D[i, j] = 0.0
            A[i, j] = 0.5 * scale[i] * scale[j] * (
                P_loo[states[i], states[j]] - P_all[states[i], states[j]] + P_loo[states[j], states[i]] - P_all[states[j], states[i]]
            )  # fmt: skip
    eigen_into(A, V)
    statistic, dof = 0.0, 0
    for k in range(m):
        w = A[k, k]
        if w > _SINGULAR:
            dof += 1
            s = 0.0
            for i in range(m):
                s += V[i, k] * e[i]
            statistic += s * s / w
            for i in range(m):
                if scale[i] > 0.0:
                    for j in range(m):
                        if scale[j] > 0.0:
                            D[i, j] += V[i, k] * V[j, k] * w / (scale[i] * scale[j])
    return statistic, dof


@jit
def separations_into(X: Array, P: Array, rows: NDArray[np.int64], states: NDArray[np.int64], statistic: Array, dof: NDArray[np.int64]) -> None:
    """Kernel: `separation_into` of filter 0 of several from each of `rows`; statistic and dof (k,) written."""
    D = np.empty((states.shape[0], states.shape[0]))
    for k in range(rows.shape[0]):
        statistic[k], dof[k] = separation_into(X[0], P[0], X[rows[k]], P[rows[k]], states, D)


@jit
def eigen_into(A: Array, V: Array) -> None:
    """Kernel: eigenvalues of a small symmetric A (m, m), left on its diagonal, and eigenvectors as columns of V, by Jacobi's rotations."""
    m = A.shape[0]
    for i in range(m):
        for j in range(m):
            V[i, j] = 1.0 if i == j else 0.0
    for _ in range(50):
        off, on = 0.0, 0.0
        for i in range(m):
            on += A[i, i] * A[i, i]
            for j in range(i):
                off += A[i, j] * A[i, j]
        if not off > 1e-30 * on:
            break
        for p in range(m - 1):
            for q in range(p + 1, m):
                if A[p, q] == 0.0:
                    continue
                ratio = 0.5 * (A[q, q] - A[p, p]) / A[p, q]
                t = 1.0 / (abs(ratio) + np.sqrt(1.0 + ratio * ratio))
                if ratio < 0.0:
                    t = -t
                c = 1.0 / np.sqrt(1.0 + t * t)
                s = t * c
                for k in range(m):
                    x, y = A[k, p], A[k, q]
                    A[k, p], A[k, q] = c * x - s * y, s * x + c * y
                for k in range(m):
                    x, y = A[p, k], A[q, k]
                    A[p, k], A[q, k] = c * x - s * y, s * x + c * y
                    x, y = V[k, p], V[k, q]
                    V[k, p], V[k, q] = c * x - s * y, s * x + c * y
                A[p, q] = 0.0
                A[q, p] = 0.0


@functools.lru_cache(maxsize=64)
def quantiles(pfa: float, integrity_risk: float, tested: int) -> tuple[Array, Array]:
    """Thresholds of the separation test over two and over `tested` states, and quantiles of the chi-square of 2 and 1 dof; (2,) each."""
    return (
        np.array([nis_threshold(pfa, 2), nis_threshold(pfa, tested)]),
        np.array([nis_threshold(integrity_risk, 2), nis_threshold(integrity_risk, 1)]),
    )


@jit
def protection_levels(
    X: Array, P: Array, rows: NDArray[np.int64], position: NDArray[np.int64], heading: int, unseen: Array, quantile: Array
) -> tuple[float, float]:  # fmt: skip
    """Kernel: what the error of filter 0 of several exceeds unnoticed with no more than a stated probability, whichever aid is faulty.

    Parameters
    ----------
    X, P : (k, n), (k, n, n)
    rows : filters that have left an aid out
    position, heading : states, the latter -1 where there is none: its level is infinite
    unseen, quantile : of `quantiles`

    Returns
    -------
    levels of horizontal position [m] and heading [rad]: |d| that passes the test, or the one found where that is larger (an alarm that is not yet
    acted on), plus the error of the solution without the aid: sqrt(threshold lambda(D)) + sqrt(chi-square^-1(risk) lambda(P_loo)), lambda the
    largest eigenvalue; the largest over the aids, and not below that of its own noise. An upper bound: both are taken in their worst direction.
    """
    a, b = position[0], position[1]
    level = np.sqrt(quantile[0] * largest_horizontal(P[0, a, a], P[0, b, b], P[0, a, b]))
    angle = np.sqrt(quantile[1] * max(P[0, heading, heading], 0.0)) if heading >= 0 else np.inf
    for r in rows:
        D = largest_horizontal(P[r, a, a] - P[0, a, a], P[r, b, b] - P[0, b, b], P[r, a, b] - P[0, a, b])
        bias = max(np.sqrt(unseen[0] * D), np.hypot(X[0, a] - X[r, a], X[0, b] - X[r, b]))
        level = max(level, bias + np.sqrt(quantile[0] * largest_horizontal(P[r, a, a], P[r, b, b], P[r, a, b])))
        if heading >= 0:
            D = max(P[r, heading, heading] - P[0, heading, heading], 0.0)
            bias = max(np.sqrt(unseen[1] * D), abs(X[0, heading] - X[r, heading]))
            angle = max(angle, bias + np.sqrt(quantile[1] * max(P[r, heading, heading], 0.0)))
    return level, angle


@jit
def largest_horizontal(xx: float, yy: float, xy: float) -> float:
    """Larger eigenvalue of a symmetric 2 x 2 matrix, not below 0."""
    half = 0.5 * (xx - yy)
    return max(0.5 * (xx + yy) + np.sqrt(half * half + xy * xy), 0.0)


def cross_check(z_one: ArrayLike, R_one: ArrayLike, z_other: ArrayLike, R_other: ArrayLike, pfa: float) -> tuple[float, float, bool]:
    """Check one satellite system against another: neither needs the filter, and a fault of both alike is not seen.

    Parameters
    ----------
    z_one, R_one : (m,), (m, m), position of one and its covariance, m
    z_other, R_other : the same of the other, at the same time and place (lever arms taken out)
    pfa : false-alarm probability of one test

    Returns
    -------
    statistic, threshold, alarm
    """
    d = np.asarray(z_one, dtype=np.float64) - np.asarray(z_other, dtype=np.float64)
    S = np.asarray(R_one, dtype=np.float64) + np.asarray(R_other, dtype=np.float64)
    statistic, threshold = float(_weighted(d, S)), nis_threshold(pfa, d.size)
    return statistic, threshold, not statistic <= threshold


@jit
def _weighted(d: Array, S: Array) -> float:
    """d' S^-1 d, infinite where S is not positive definite."""
    L, u, total = np.zeros_like(S), np.empty_like(d), 0.0
    if not cholesky_into(S, L):
        return np.inf
    for a in range(d.shape[0]):
        s = d[a]
        for b in range(a):
            s -= L[a, b] * u[b]
        u[a] = s / L[a, a]
        total += u[a] * u[a]
    return total
