"""Faults of a whole unit: which group of sensors explains a parity vector, when no single sensor does.

Lives here: `suspect_group`, the kernel, and `GroupTest`, the same for one parity vector at a time.
Does not live here: the parity test itself and single sensors (parity.py), what follows from an answer (the fusion pipeline).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from riins_core.imu_array import ImuArray
from riins_core.jit import jit
from riins_fdi.parity import glt_threshold, parity_test

Array = NDArray[np.float64]
Whole = NDArray[np.int64]

_BLIND = 1e-6
"""A column of the parity matrix shorter than this part of its length adds no dimension to those before it."""


@jit
def suspect_group(whitened: Array, dof: int, p: Array, group: Whole, threshold: Array) -> tuple[int, int]:
    """Group of sensors whose faults, free of each other, explain the parity vector.

    Parameters
    ----------
    whitened : (dof, n), parity matrix scaled to unit covariance of p; zero columns for sensors that do not take part
    dof, p : degrees of freedom, whitened parity vector (dof,)
    group : (n,), group of each sensor, 0 .. n - 1; negative: in none
    threshold : of the squared length of p, by degrees of freedom; [0] is infinite

    Returns
    -------
    group : the one that takes most off p'p, -1: none explains it
    count : groups that explain it; more than one: ambiguous

    Notes
    -----
    The faults of a group are taken out by projecting p across the space of its columns, of r dimensions (three for a triad). What is left is
    chi-square with dof - r degrees of freedom if the group is the cause, and is held against that threshold: with two triads nothing is
    left and both explain everything, with three the one at fault is found.
    """
    n = group.shape[0]
    basis = np.empty((dof, dof))
    total = 0.0
    for r in range(dof):
        total += p[r] * p[r]
    best, most, count = -1, -1.0, 0
    for g in range(n):
        rank, explained = 0, 0.0
        for i in range(n):
            if group[i] != g or rank == dof:
                continue
            length = 0.0
            for r in range(dof):
                basis[rank, r] = whitened[r, i]
                length += whitened[r, i] * whitened[r, i]
            for _ in range(2):  # Gram and Schmidt, twice: orthogonal to rounding
                for q in range(rank):
                    s = 0.0
                    for r in range(dof):
                        s += basis[q, r] * basis[rank, r]
                    for r in range(dof):
                        basis[rank, r] -= s * basis[q, r]
            left = 0.0
            for r in range(dof):
                left += basis[rank, r] * basis[rank, r]
            if left <= _BLIND * _BLIND * length:
                continue
            s = 0.0
            for r in range(dof):
                basis[rank, r] /= np.sqrt(left)
                s += basis[rank, r] * p[r]
            explained += s * s
            rank += 1
        if rank > 0 and total - explained <= threshold[dof - rank]:
            count += 1
            if explained > most:
                best, most = g, explained
    return best, count


class GroupFinding(NamedTuple):
    """Answer of `GroupTest`."""

    statistic: float
    """p'p, whitened: chi-square without a fault"""
    detected: bool
    sensor: int
    """the one that explains it alone, -1: none"""
    group: int
    """else the group that does, -1: none, or several"""


class GroupTest:
    """Single sensors against whole groups, for readings one at a time.

    Parameters
    ----------
    array : geometry of n sensors
    group : (n,), group of each sensor; negative: in none
    sigma : (n,) or scalar, standard deviation of each sensor about the truth
    pfa : false-alarm probability of one test
    """

    def __init__(self, array: ImuArray, group: ArrayLike, sigma: ArrayLike, pfa: float) -> None:
        self.test = parity_test(array, (1 << array.n) - 1, sigma, pfa)
        self.group = np.asarray(group, np.int64)
        self.threshold = np.array([np.inf, *(glt_threshold(pfa, d) for d in range(1, max(2, array.n - 2)))])

    def judge(self, reading: ArrayLike) -> GroupFinding:
        """Test a reading (n,)."""
        dof, w, gain = self.test.dof, self.test.whitened, self.test.gain
        p = w @ np.asarray(reading, np.float64)
        total = float(p @ p)
        if dof < 1 or total <= self.threshold[dof]:
            return GroupFinding(total, False, -1, -1)
        values = gain * (w.T @ p) ** 2
        best = int(np.argmax(values))
        if total - values[best] <= self.threshold[dof - 1] and self.test.isolable[best]:
            return GroupFinding(total, True, best, -1)
        group, count = suspect_group(w, dof, p, self.group, self.threshold)
        return GroupFinding(total, True, -1, group if count == 1 else -1)
