"""Information-sharing factors beta of the local filters; they are positive and sum to one.

Lives here: equal and checked fixed shares.
Does not live here: the structures that use them (master.py).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from .types import Array


def equal_shares(n: int) -> Array:
    """beta = 1/n for each of n local filters, shape (n,)."""
    return np.full(n, 1.0 / n)


def checked_shares(beta: ArrayLike) -> Array:
    """Shares as an array, shape (n,).

    Raises
    ------
    ValueError
        A share is not positive, or they do not sum to one (1e-9): information would be made or lost.
    """
    beta = np.array(beta, dtype=np.float64)
    if (beta <= 0.0).any() or abs(beta.sum() - 1.0) > 1e-9:
        raise ValueError(f"information shares must be positive and sum to one, not {beta.tolist()}")
    return beta
