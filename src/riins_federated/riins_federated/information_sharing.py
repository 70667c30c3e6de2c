"""Information-sharing factors beta of the local filters; they are positive and sum to one.

Lives here: equal, checked fixed, by covariance trace, and adapted to the innovations (004).
Does not live here: the structures that use them (master.py, structures.py), adaptation of R, which is what helps (adaptive_noise.py).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from .types import Array


def equal_shares(n: int) -> Array:
    """beta = 1/n for each of n local filters, shape (n,); none where there is no aid."""
    return np.full(n, 1.0 / max(n, 1))


def checked_shares(beta: ArrayLike) -> Array:
    """Shares as an array, shape (n,).

    Raises
    ------
    ValueError
        A share is not positive, or they do not sum to one (1e-9): information would be made or lost.
    """
    beta = np.array(beta, dtype=np.float64)
    if not (beta > 0.0).all() or not abs(beta.sum() - 1.0) <= 1e-9:
        raise ValueError(f"information shares must be positive and sum to one, not {beta.tolist()}")
    return beta


def trace_shares(covariances: Sequence[Array], least: float = 0.05) -> Array:
    """beta_i ~ 1 / tr P_i, what 004 quotes from its [6]; shape (n,).

    Parameters
    ----------
    covariances : (m, m) of each local filter, in units that make a trace meaningful
    least : share that none falls below; a filter without information would have a singular covariance
    """
    return _normalised(np.array([1.0 / np.trace(P) for P in covariances]), least)


def innovation_shares(expected: ArrayLike, found: ArrayLike, c: float = 1.0, least: float = 0.05) -> Array:
    """beta_i ~ (tr S_i / tr C_i)^c, 004 (13)-(15); shape (n,).

    Parameters
    ----------
    expected : (n,), trace of the innovation covariance that each filter expects
    found : (n,), trace of the mean outer product of its last innovations
    c : 0.8 .. 1 in 004
    least : as in `trace_shares`

    Notes
    -----
    It changes nothing that fusion-reset gives (the shares cancel) and next to nothing without reset (errata.md, 004).
    """
    ratio = np.asarray(expected, dtype=np.float64) / np.maximum(np.asarray(found, dtype=np.float64), 1e-300)
    return _normalised(np.minimum(ratio, 1e12) ** c, least)


def _normalised(weight: Array, least: float) -> Array:
    if not 0.0 < least * weight.size <= 1.0:
        raise ValueError(f"a least share of {least} for each of {weight.size} filters is more than there is")
    return np.asarray(least + (1.0 - least * weight.size) * weight / weight.sum())
