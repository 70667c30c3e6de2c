"""The parity tests within the compiled loop: statistic, alarm, and who explains it.

Lives here: kernels on the tables of one set of sensors, the numbers of the tests, what each test puts into those tables.
Does not live here: the tests as objects (riins_fdi.methods), tests over many samples (sequences.py), what follows from an answer (kernel.py).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from riins_core.imu_array import ImuArray
from riins_core.jit import inner
from riins_fdi.groups import suspect_group
from riins_fdi.methods import DirectComparison, OptimalParityVector
from riins_fdi.parity import parity_relations, parity_vector, suspect, suspect_pair
from riins_imu_fusion.state import RESOLVED, UNRESOLVED, B, F, I, U

GLT, OPTIMAL, DIRECT, SVD = 0, 1, 2, 3
PARITY_TESTS = {"glt": GLT, "optimal_parity_vector": OPTIMAL, "direct_comparison": DIRECT, "svd": SVD}
"""Number of each test of a single epoch by the name that riins_fdi.methods gives it."""


def rows_needed(test: int, array: ImuArray) -> int:
    """Equations that a test looks at with all sensors; a subset has no more.

    Raises
    ------
    ValueError
        Too many sensors for the direct comparison.
    """
    return len(parity_relations(array)[1]) if test == DIRECT else array.n if test == OPTIMAL else 0


def equations(test: int, array: ImuArray, mask: int, sigma: ArrayLike, pfa: float) -> tuple[F, U, float]:
    """What a test needs beyond the GLT's table.

    Parameters
    ----------
    test : number of the test
    array, mask, sigma, pfa : as riins_fdi.methods.make takes them; four sensors at least

    Returns
    -------
    rows : (q, n), equations of unit variance; none for GLT and SVD, whose statistic is the length of the parity vector
    members : (q,), sensors of each as bits
    threshold : of the largest absolute residual, in sigma
    """
    if test == OPTIMAL:
        vectors = OptimalParityVector(array, mask, sigma, pfa)
        return vectors.vectors @ vectors.test.whitened, np.zeros(len(vectors.vectors), np.uint64), vectors.threshold
    if test == DIRECT:
        direct = DirectComparison(array, mask, sigma, pfa)
        return direct.relations, np.array([sum(1 << i for i in chosen) for chosen in direct.members], np.uint64), direct.threshold
    return np.zeros((0, array.n)), np.zeros(0, np.uint64), math.nan


@inner
def quadratic(kind: int, slot: int, dof: int, whitened: F, z: F) -> float:
    """GLT statistic of the set of sensors in `slot`."""
    total = 0.0
    for r in range(dof):
        s = 0.0
        for i in range(z.shape[1]):
            s += whitened[kind, slot, r, i] * z[kind, i]
        total += s * s
    return total


@inner
def largest(rows: F, z: F) -> float:
    """Largest absolute residual of the equations (q, n)."""
    most = 0.0
    for r in range(rows.shape[0]):
        s = 0.0
        for i in range(z.shape[0]):
            s += rows[r, i] * z[i]
        most = max(most, abs(s))
    return most


@inner
def explain(dof: int, p: F, total: float, whitened: F, gain: F, pick: F, isolable: B, threshold: F) -> tuple[int, int, int, int]:
    """Who explains an alarm; arrays are those of one kind and slot.

    One sensor that explains the parity vector leaves; else two, if only one pair explains it. Otherwise the alarm is unresolved: the best
    pair (with five sensors, the best one) stays out of the sample, and nobody's health is judged by it. With four sensors all stay.

    Parameters
    ----------
    dof, p, total : whitened parity vector (dof,) and its squared length
    whitened, gain, isolable : as in riins_fdi.parity
    pick : (n,), weight of (w_i'p)^2 by which the sensor is named: `gain`, which is maximum likelihood, or sigma^2, which is SVD
    threshold : of the squared length, by degrees of freedom

    Returns
    -------
    alarm : RESOLVED or UNRESOLVED
    first, second : sensors to leave out, -1: none
    pointed : sensor the test points at, -1: it cannot tell
    """
    best, value = suspect(whitened, dof, pick, p)
    if dof < 2 or best < 0 or not isolable[best]:
        return UNRESOLVED, -1, -1, -1
    if total - value * gain[best] / pick[best] <= threshold[dof - 1]:
        return RESOLVED, best, -1, best
    if dof == 2:
        return UNRESOLVED, best, -1, best
    i, j, _, count = suspect_pair(whitened, dof, gain, p, total - threshold[dof - 2])
    unique = count == 1 and isolable[i] and isolable[j]
    return RESOLVED if unique else UNRESOLVED, i, j, best


@inner
def resolve(dof: int, whitened: F, gain: F, pick: F, isolable: B, z: F, threshold: F) -> tuple[int, int, int, int]:
    """`explain` for the measurements z (n,)."""
    p = np.empty(dof)
    total = parity_vector(whitened, dof, z, p)
    return explain(dof, p, total, whitened, gain, pick, isolable, threshold)


@inner
def blame_unit(dof: int, whitened: F, z: F, group: I, threshold: F) -> int:
    """Unit that alone explains the measurements z (n,), when no single sensor does; -1: none, or more than one."""
    p = np.empty(dof)
    parity_vector(whitened, dof, z, p)
    best, count = suspect_group(whitened, dof, p, group, threshold)
    return best if count == 1 else -1


@inner
def explain_parity(dof: int, p: F, white: F, isolable: B, threshold: F) -> tuple[int, int, int, int]:
    """`explain` for a parity vector p that a test over many samples has made, scaled to the noise of one; `white` (d, n) is the matrix it is of."""
    gain = np.zeros(white.shape[1])
    total = 0.0
    for r in range(dof):
        total += p[r] * p[r]
    for i in range(white.shape[1]):
        s = 0.0
        for r in range(dof):
            s += white[r, i] * white[r, i]
        if s > 0.0:
            gain[i] = 1.0 / s
    return explain(dof, p, total, white, gain, gain, isolable, threshold)


@inner
def compare(rows: F, members: U, level: float, dof: int, whitened: F, gain: F, isolable: B, z: F) -> tuple[int, int, int, int]:
    """Who explains an alarm of the direct comparison: every broken equation must have the sensor, or one of the two, in it.

    Where several explain it as well the alarm is unresolved, and the likeliest of them stays out of the sample. Returns as `explain`.
    """
    n = z.shape[0]
    broken = np.empty(rows.shape[0], np.uint64)
    count, common = 0, ~np.uint64(0)
    for r in range(rows.shape[0]):
        s = 0.0
        for i in range(n):
            s += rows[r, i] * z[i]
        if abs(s) > level and members[r] != 0:
            broken[count] = members[r]
            common &= members[r]
            count += 1
    p = np.empty(dof)
    parity_vector(whitened, dof, z, p)
    best, found, most = -1, 0, -1.0
    for i in range(n):
        if gain[i] > 0.0 and (common >> np.uint64(i)) & np.uint64(1):
            found += 1
            s = 0.0
            for r in range(dof):
                s += whitened[r, i] * p[r]
            if s * s * gain[i] > most:
                best, most = i, s * s * gain[i]
    if dof < 2 or (found > 0 and not isolable[best]):
        return UNRESOLVED, -1, -1, -1
    if found > 0:
        return RESOLVED if found == 1 else UNRESOLVED, best, -1, best if found == 1 else -1
    if dof == 2:
        best, _ = suspect(whitened, dof, gain, p)
        return UNRESOLVED, best, -1, -1
    pairs, first, second = 0, -1, -1
    for i in range(n):
        if gain[i] == 0.0:
            continue
        rest = ~np.uint64(0)  # sensors in all broken equations that lack sensor i
        for q in range(count):
            if not (broken[q] >> np.uint64(i)) & np.uint64(1):
                rest &= broken[q]
        for j in range(i + 1, n):
            if gain[j] > 0.0 and (rest >> np.uint64(j)) & np.uint64(1):
                pairs += 1
                first, second = i, j
    if pairs == 1:
        return RESOLVED if isolable[first] and isolable[second] else UNRESOLVED, first, second, -1
    first, second, _, _ = suspect_pair(whitened, dof, gain, p, np.inf)
    return UNRESOLVED, first, second, -1
