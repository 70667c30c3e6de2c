"""Observability of an alignment model: rank and singular values, in units in which one is as large as the prior.

Lives here: `Observability`, `observability`. Does not live here: the models (stationary.py, redundant.py).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Observability(NamedTuple):
    """Rank and singular values of the scaled observability matrix.

    Attributes
    ----------
    states, rank : number of states, and of those combinations of them that the measurements see
    singular : (n,), descending: measured effect of a combination as large as its prior, over the noise of one measurement
    unseen : (n, n - rank), orthonormal basis of what cannot be seen, in units of the prior
    """

    states: int
    rank: int
    singular: Array
    unseen: Array


def observability(F: Array, H: Array, prior: Array, noise: Array, horizon: float, tolerance: float = 1e-10) -> Observability:
    """Observability of x' = F x, z = H x + v over a time.

    Parameters
    ----------
    F, H : (n, n), (m, n)
    prior : (n,), standard deviations of the states before anything is measured: states of different units become comparable
    noise : (m,), standard deviations of one measurement
    horizon : s; derivative i of the measurement counts with horizon^i / i!, as in its Taylor series
    tolerance : singular values below this part of the largest count as zero

    Notes
    -----
    Seed 001 (8)-(13): the rank of [H; H F; ...; H F^(n-1)]. The rank does not depend on the scales, the singular values do.
    """
    n = F.shape[0]
    block = np.asarray(H, dtype=np.float64) * prior / noise[:, None]
    scaled = F * prior[None, :] / prior[:, None]
    blocks = [block]
    for i in range(1, n):
        block = block @ scaled * (horizon / i)
        blocks.append(block)
    _, s, vt = np.linalg.svd(np.vstack(blocks))
    rank = int(np.count_nonzero(s > tolerance * s[0]))
    return Observability(n, rank, s, vt[rank:].T)
