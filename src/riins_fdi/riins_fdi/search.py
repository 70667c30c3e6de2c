"""Which sensors explain a parity vector: two-stage search for one and for two simultaneous faults, with every explanation the data allow.

Lives here: `explain` and the scores it is made of, in closed form from one parity test.
Does not live here: the tests that raise the alarm (methods), what follows from an answer (health): an ambiguous answer isolates nobody.
"""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from riins_fdi.innovation import nis_threshold
from riins_fdi.parity import Capability, ParityTest

Array = NDArray[np.float64]

_PARALLEL = 1e-9
"""Relative determinant below which two sensors are one unknown."""
KEEP = 1e-3
"""Probability that the true explanation is not among those reported."""


class Explanation(NamedTuple):
    """Sensors whose faults would explain a parity vector."""

    sensors: tuple[int, ...]
    sizes: tuple[float, ...]
    """least-squares size of each sensor's fault, in the unit of the measurements"""
    log_likelihood: float
    """log of the likelihood ratio against no fault: half of what leaves the statistic with these sensors"""
    probability: float
    """share of the likelihood of all sets of as many sensors"""


class Diagnosis(NamedTuple):
    """Answer of the two-stage search."""

    statistic: float
    alarm: bool
    sensors: tuple[int, ...]
    """the failed sensors; empty: none, or not known which"""
    explanations: tuple[Explanation, ...]
    """every smallest set of sensors that explains the data, the most likely first; empty without alarm or when three or more have failed"""

    @property
    def ambiguous(self) -> bool:
        """More than one set of sensors explains the data: none of them may be isolated."""
        return len(self.explanations) > 1

    @property
    def unexplained(self) -> bool:
        """Neither one nor two failed sensors explain the data."""
        return self.alarm and not self.explanations


def components(test: ParityTest, z: ArrayLike) -> Array:
    """Products w_i'p of the whitened columns with the parity vector, (..., n), from measurements z (..., n)."""
    m = np.where(np.any(test.whitened != 0.0, axis=0), np.asarray(z, dtype=np.float64), 0.0)  # what has no part in the test may be anything
    return np.asarray((m @ test.whitened.T) @ test.whitened)


def single_scores(test: ParityTest, z: ArrayLike) -> Array:
    """What leaves the statistic with each sensor, (..., n): (w_i'p)^2 / (w_i'w_i); -inf for sensors nobody checks."""
    score = components(test, z) ** 2 * test.gain
    return np.asarray(np.where(test.gain > 0.0, score, -np.inf))


def pair_scores(test: ParityTest, z: ArrayLike) -> tuple[NDArray[np.intp], Array]:
    """What leaves the statistic with each pair of sensors.

    Parameters
    ----------
    test : of the sensors in use
    z : (..., n), measurements

    Returns
    -------
    pairs : (q, 2), i < j, without pairs of parallel columns, which are one unknown
    scores : (..., q), squared length of p projected on the plane of w_i and w_j
    """
    gram = test.whitened.T @ test.whitened
    checked = np.flatnonzero(test.gain > 0.0)
    listed = [
        (i, j)
        for i, j in itertools.combinations(checked.tolist(), 2)
        if gram[i, i] * gram[j, j] - gram[i, j] ** 2 > _PARALLEL * gram[i, i] * gram[j, j]
    ]
    pairs = np.array(listed, dtype=np.intp).reshape(-1, 2)
    i, j = pairs[:, 0], pairs[:, 1]
    c = components(test, z)
    a, b = c[..., i], c[..., j]
    gi, gj, gij = gram[i, i], gram[j, j], gram[i, j]
    return pairs, np.asarray((a * a * gj - 2.0 * a * b * gij + b * b * gi) / (gi * gj - gij**2))


def explain(test: ParityTest, z: ArrayLike, keep: float = KEEP, pairs: bool = True) -> Diagnosis:
    """Two-stage search: one failed sensor if that explains the data, otherwise two.

    Parameters
    ----------
    test : of the sensors in use, dof >= 1
    z : (n,), measurements of one epoch
    keep : an explanation is kept when what it leaves of the statistic is no more than noise exceeds with this probability
    pairs : look for two failed sensors when one does not explain the data

    Returns
    -------
    Diagnosis. Two faults of equal size are explained by another pair as well, for all 30 pairs and signs of the dodecahedron (errata): both
    pairs come back with their likelihoods, and `sensors` is empty.
    """
    if test.dof < 1:
        raise ValueError("the search needs at least four sensors that span three axes")
    m = np.asarray(z, dtype=np.float64)
    p = test.whitened @ np.where(np.any(test.whitened != 0.0, axis=0), m, 0.0)
    statistic = float(p @ p)
    if not statistic > test.threshold:
        return Diagnosis(statistic, False, (), ())
    scores = single_scores(test, m)
    single = _kept(test, p, statistic, [(int(i),) for i in np.flatnonzero(test.gain > 0.0)], scores[test.gain > 0.0], keep)
    found = single
    if not found and pairs and test.capability is not Capability.NEITHER:
        listed, values = pair_scores(test, m)
        found = _kept(test, p, statistic, [(int(i), int(j)) for i, j in listed], values, keep)
    return Diagnosis(statistic, True, found[0].sensors if len(found) == 1 else (), found)


def _kept(test: ParityTest, p: Array, statistic: float, sets: list[tuple[int, ...]], scores: Array, keep: float) -> tuple[Explanation, ...]:
    """Explanations whose remainder noise could have left, the most likely first."""
    if not sets:
        return ()
    left = test.dof - len(sets[0])
    limit = nis_threshold(keep, left) if left > 0 else np.inf
    share = np.exp(0.5 * (scores - scores.max()))
    share /= share.sum()
    chosen = []
    for index in np.argsort(-scores, kind="stable"):
        if statistic - scores[index] <= limit:
            sizes = np.linalg.lstsq(test.whitened[:, list(sets[index])], p, rcond=None)[0]
            chosen.append(Explanation(sets[index], tuple(sizes.tolist()), 0.5 * float(scores[index]), float(share[index])))
    return tuple(chosen)
