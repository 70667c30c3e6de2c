"""Tests on the state: extended RAIM, separation of solutions with a protection level, and one satellite system checked against another.

Lives here: statistics, thresholds and protection level of one epoch, as functions of estimates and covariances.
Does not live here: the filters that give the solutions (riins_federated.structures), tests over many innovations (innovation_tests).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike, NDArray
from scipy.stats import chi2

from riins_fdi.innovation import nis_threshold

Array = NDArray[np.float64]

_SINGULAR = 1e-3
"""Directions in which the separation has less variance than this part of the solution's own are not tested."""


class Separation(NamedTuple):
    """Verdict on two solutions of which one has left an aid out."""

    statistic: float
    """d' D^-1 d over the directions that can be tested"""
    threshold: float
    """of chi-square(dof); 0 where nothing can be tested"""
    dof: int
    alarm: bool
    covariance: Array
    """D = P_loo - P_all, (m, m), directions without a test set to zero"""


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


def solution_separation(x_all: ArrayLike, P_all: ArrayLike, x_loo: ArrayLike, P_loo: ArrayLike, pfa: float) -> Separation:
    """Test the solution with all aids against one that has left an aid out.

    Parameters
    ----------
    x_all, P_all : (m,), (m, m), what is compared (the horizontal position, say) with all aids
    x_loo, P_loo : the same without the aid
    pfa : false-alarm probability of one test; the statistic is correlated over minutes, so false onsets are fewer

    Returns
    -------
    the verdict. The covariance of the difference is P_loo - P_all, since the solution with all aids is optimal and uses all the other one uses
    (Brenner 1996). Just after one has been put in the place of the other it is nearly singular: those directions are left out.
    """
    d = np.asarray(x_all, dtype=np.float64) - np.asarray(x_loo, dtype=np.float64)
    P = np.asarray(P_all, dtype=np.float64)
    scale = 1.0 / np.sqrt(np.diag(P))  # metres and radians may stand side by side
    D = (np.asarray(P_loo, dtype=np.float64) - P) * np.outer(scale, scale)
    values, vectors = np.linalg.eigh(0.5 * (D + D.T))
    tested = values > _SINGULAR
    dof = int(np.count_nonzero(tested))
    kept = vectors[:, tested]
    covariance = (kept * values[tested]) @ kept.T / np.outer(scale, scale)
    if dof == 0:
        return Separation(0.0, 0.0, 0, False, covariance)
    statistic = float(np.sum((kept.T @ (d * scale)) ** 2 / values[tested]))
    threshold = nis_threshold(pfa, dof)
    return Separation(statistic, threshold, dof, not statistic <= threshold, covariance)


def protection_level(separation: Separation, P_loo: ArrayLike, integrity_risk: float) -> float:
    """Radius that the error of the solution with all aids exceeds unnoticed with no more than a stated probability, if this aid is the faulty one.

    Parameters
    ----------
    separation : of the two solutions
    P_loo : (m, m), covariance without the aid, m = 2 for a horizontal position
    integrity_risk : probability that it is exceeded although no alarm is given

    Returns
    -------
    |d| that passes the test plus the error of the solution without the aid: sqrt(threshold lambda(D)) + sqrt(chi-square^-1(risk) lambda(P_loo)),
    lambda the largest eigenvalue; the level of a navigator is the largest over its aids. An upper bound: both are taken in their worst direction.
    """
    if not 0.0 < integrity_risk < 1.0:
        raise ValueError(f"the integrity risk must be in (0, 1), not {integrity_risk}")
    P = np.asarray(P_loo, dtype=np.float64)
    unseen = np.sqrt(separation.threshold * max(float(np.linalg.eigvalsh(separation.covariance)[-1]), 0.0))
    return float(unseen + np.sqrt(chi2.isf(integrity_risk, len(P)) * np.linalg.eigvalsh(P)[-1]))


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
    statistic, threshold = float(d @ np.linalg.solve(S, d)), nis_threshold(pfa, d.size)
    return statistic, threshold, not statistic <= threshold
