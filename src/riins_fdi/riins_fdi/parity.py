"""Fault detection in parity space: generalized likelihood test (GLT), optimal parity vectors, direct comparison.

Lives here: statistics, thresholds, isolation, what a geometry can tell apart, and the kernels that the fusion pipeline calls at every sample.
Does not live here: the parity matrix itself (riins_core.imu_array), tests over several samples (sequential), what follows from an alarm (health).
"""

from __future__ import annotations

import functools
import itertools
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import brentq
from scipy.stats import chi

from riins_core.imu_array import ImuArray
from riins_core.jit import jit
from riins_fdi.innovation import nis_threshold

Array = NDArray[np.float64]

_BLIND = 1e-6
"""A column of V shorter than this belongs to a sensor that no other one checks."""
MOST_RELATED = 24
"""Sensors the direct comparison takes: 10626 sets of four."""
_CLASSES, _FEWEST, _PRODUCTS = 4096, 25_000, 12_000_000
"""Of `family_threshold`: classes of the largest product, points at least, products of points and tests that are computed."""
_PARALLEL = 1e-9
"""1 - |cos| of two columns of V below which two sensors cannot be told apart."""


class Capability(IntEnum):
    """What the sensors in use can do about a further fault of any one of them, TriadFdi.ISOLATES and so on."""

    ISOLATES = 0
    DETECTS = 1
    NEITHER = 2
    NO_SOLUTION = 3


def false_alarm_probability(hours: float, rate_hz: float) -> float:
    """Probability per sample that gives `hours` [h] as the mean time between false alarms at `rate_hz` [Hz] independent tests a second."""
    if not (hours > 0.0 and rate_hz > 0.0):
        raise ValueError("the mean time between false alarms and the rate must be positive")
    return 1.0 / (hours * 3600.0 * rate_hz)


def glt_statistic(parity: ArrayLike, sigma: float) -> Array:
    """Statistic of the generalized likelihood test.

    Parameters
    ----------
    parity : (..., d), p = V m with V V' = I
    sigma : standard deviation of each sensor's noise, in the unit of m

    Returns
    -------
    (...), p'p / sigma^2, chi-square with d degrees of freedom without a fault; thesis (4-37), which lacks the division by sigma^2
    """
    p = np.asarray(parity, dtype=np.float64)
    return np.asarray(np.sum(p * p, axis=-1) / sigma**2)


def glt_threshold(pfa: float, dof: int) -> float:
    """Threshold of `glt_statistic` for a false-alarm probability per sample; thesis (4-38) leaves it to experience."""
    return nis_threshold(pfa, dof)


def isolate(parity: ArrayLike, V: ArrayLike) -> NDArray[np.intp]:
    """Sensor whose fault explains the parity vector best.

    Parameters
    ----------
    parity : (..., d)
    V : (d, m), parity matrix

    Returns
    -------
    (...), arg max of (v_i'p)^2 / (v_i'v_i): the maximum-likelihood sensor when one has failed and the noise is equal
    """
    v = np.asarray(V, dtype=np.float64)
    direction = v / np.linalg.norm(v, axis=0)
    return np.asarray(np.argmax(np.abs(np.asarray(parity, dtype=np.float64) @ direction), axis=-1))


def optimal_parity_vectors(V: ArrayLike) -> Array:
    """Optimal parity vector of each sensor, thesis (4-10) with D = F = I.

    Parameters
    ----------
    V : (d, m), parity matrix with V V' = I

    Returns
    -------
    (m, d), unit vectors c_i / |c_i|: the residual of sensor i is c_i'p, of variance sigma^2

    Notes
    -----
    Maximizes (4-6), whose denominator must be a sum of noise and other faults (the thesis prints a product), as c'u u'c / c'M c with
    M = 2 I - v_i v_i' ((4-9) has c^2 M c). By Sherman and Morrison M^-1 v_i is parallel to v_i: for equal sensors it is the direction
    in which the GLT isolates.
    """
    v = np.asarray(V, dtype=np.float64)
    c = np.empty((v.shape[1], v.shape[0]))
    for i in range(v.shape[1]):
        c[i] = np.linalg.solve(2.0 * np.eye(v.shape[0]) - np.outer(v[:, i], v[:, i]), v[:, i])
    return np.asarray(c / np.linalg.norm(c, axis=1, keepdims=True))


def family_threshold(directions: ArrayLike, pfa: float, points: int = 200_000, seed: int = 1) -> float:
    """Threshold T of max_i |u_i'p| / sigma that the whole family exceeds with probability `pfa`.

    Parameters
    ----------
    directions : (m, d), unit vectors u_i
    pfa : probability of a false alarm of any of the m tests
    points : directions of p at which the radial integral is taken; fewer for more than 60 tests, which leave less between them
    seed : of these directions

    Returns
    -------
    T. The thesis' T_D = u_(1 - alpha/2) ignores that m tests are made: its real false-alarm rate with six sensors is 5.6 times nominal.

    Notes
    -----
    p = r e with e uniform on the sphere and r chi-distributed: P(alarm) = mean over e of P(r > T / max_i |u_i'e|). Only the directions are sampled,
    so probabilities far below 1 / points are reached.
    """
    u = np.round(np.asarray(directions, dtype=np.float64), 9)  # gyros and accelerometers of one array: the same test
    return _family_threshold(u.tobytes(), u.shape, pfa, min(points, max(_FEWEST, _PRODUCTS // len(u))), seed)


@functools.lru_cache(maxsize=256)
def _family_threshold(directions: bytes, shape: tuple[int, int], pfa: float, points: int, seed: int) -> float:
    u = np.frombuffer(directions).reshape(shape)
    d = shape[1]
    e = np.random.default_rng(seed).standard_normal((points, d))
    e /= np.linalg.norm(e, axis=1, keepdims=True)
    largest = np.concatenate([np.max(np.abs(part @ u.T), axis=1) for part in np.array_split(e, max(1, points // 10_000))])
    # only how often each size occurs matters: the means of narrow classes give T to 1e-8 in a tenth of the time
    low, high = float(largest.min()), float(largest.max())
    place = np.minimum((largest - low) * (_CLASSES / max(high - low, 1e-300)), _CLASSES - 1).astype(np.int64)
    count = np.bincount(place, minlength=_CLASSES)
    size, share = np.bincount(place, largest, _CLASSES)[count > 0] / count[count > 0], count[count > 0] / points
    upper = 1.001 * float(chi.isf(pfa, d))  # max |u_i'p| <= |p|
    return float(brentq(lambda t: float(chi.sf(t / size, d) @ share) - pfa, 1e-9, upper, xtol=1e-10))


def parity_relations(array: ImuArray) -> tuple[Array, list[tuple[int, ...]]]:
    """Parity equations of the direct comparison, thesis 4.2.1, for any geometry.

    Parameters
    ----------
    array : n sensors, n <= 24

    Returns
    -------
    relations : (q, n), unit rows r with r H = 0, first coefficient positive; thesis table 4.1 up to scale and sign
    members : the sensors of each row: every smallest set that has a relation, four in general (all n over 4 of them for a dodecahedron or
        cone 1), three in one plane, two parallel; ordered by their number, then as the table is

    Raises
    ------
    ValueError
        More than 24 sensors: their sets of four are too many to look through at every sample.
    """
    if array.n > MOST_RELATED:
        raise ValueError(f"direct comparison takes at most {MOST_RELATED} sensors, not {array.n}")
    members: list[tuple[int, ...]] = []
    rows: list[Array] = []
    for size in (2, 3, 4):
        smaller = [set(m) for m in members]
        for chosen in itertools.combinations(range(array.n), size):
            if any(m <= set(chosen) for m in smaller):
                continue
            _, singular, vt = np.linalg.svd(array.H[list(chosen)].T)
            if size == 4 or singular[-1] < _BLIND:  # of four, three span the space: exactly one relation
                null = vt[size - 1]
                row = np.zeros(array.n)
                row[list(chosen)] = null if null[0] > 0.0 else -null
                members.append(chosen)
                rows.append(row)
    return np.array(rows).reshape(-1, array.n), members


def fault_identifier(residuals: ArrayLike, threshold: float) -> int:
    """Word of the direct comparison, thesis table 4.2.

    Parameters
    ----------
    residuals : (q,), parity relations times the measurements
    threshold : T; a relation holds when |residual| <= T (table 4.1 lacks the absolute value)

    Returns
    -------
    integer with K_1 as its lowest bit; K_i = 1: relation i holds
    """
    holds = np.abs(np.asarray(residuals, dtype=np.float64)) <= threshold
    return sum(1 << i for i in np.flatnonzero(holds).tolist())


def fault_identifiers(members: list[tuple[int, ...]], n: int) -> dict[int, tuple[int, ...]]:
    """Word -> failed sensors, for no, one and two failed sensors whose faults break every relation they enter.

    Of the 22 words of table 4.2 that of sensor 2 is misprinted: 0x43C0, not 0x03C0.
    """
    table: dict[int, tuple[int, ...]] = {}
    for failed in itertools.chain([()], itertools.combinations(range(n), 1), itertools.combinations(range(n), 2)):
        word = sum(1 << row for row, four in enumerate(members) if not set(four) & set(failed))
        table[word] = failed
    return table


class ParityTest(NamedTuple):
    """The generalized likelihood test of one set of sensors, in a form a kernel reads."""

    mask: int
    """bit i: sensor i takes part"""
    dof: int
    """sensors - 3; -1 when they do not span three axes"""
    capability: Capability
    V: Array
    """(dof, n), V H = 0, V V' = I, zero columns for the others"""
    whitened: Array
    """(dof, n), V scaled so that the parity vector of ordinary sensors has unit covariance"""
    gain: Array
    """(n,), 1 / (v_i'v_i) of the whitened columns; 0 where there is none"""
    isolable: NDArray[np.bool_]
    """(n,), a fault of this sensor can be told from one of any other"""
    threshold: float
    """NaN without redundancy"""


def parity_test(array: ImuArray, mask: int, sigma: ArrayLike, pfa: float) -> ParityTest:
    """Prepare the test for the sensors in `mask`.

    Parameters
    ----------
    array : geometry of n sensors
    mask : bit i set: sensor i takes part
    sigma : (n,) or scalar, standard deviation of each sensor about the truth (noise and ordinary bias together)
    pfa : false-alarm probability per sample

    Returns
    -------
    ParityTest; with unequal sigma the statistic is p'(V R V')^-1 p, which is GLT (4-37) for E[ee'] = R

    Notes
    -----
    Four sensors, two parallel ones or fewer can at most detect; a sensor without redundancy (its column of V is zero) is not even checked:
    the capability is that of the worst sensor in use.
    """
    n = array.n
    s = np.broadcast_to(np.asarray(sigma, dtype=np.float64), (n,))
    try:
        index = array.used(mask)
    except ValueError:
        empty = np.zeros((0, n))
        return ParityTest(mask, -1, Capability.NO_SOLUTION, empty, empty, np.zeros(n), np.zeros(n, bool), float("nan"))
    v = array.parity_full(mask)
    dof = index.size - 3
    gain, isolable = np.zeros(n), np.zeros(n, dtype=bool)
    if dof == 0:
        return ParityTest(mask, 0, Capability.NEITHER, v, v, gain, isolable, float("nan"))
    whitened = np.linalg.solve(np.linalg.cholesky((v * s**2) @ v.T), v)
    checked = index[np.linalg.norm(v[:, index], axis=0) > _BLIND]
    length = np.linalg.norm(whitened[:, checked], axis=0)
    gain[checked] = 1.0 / length**2
    direction = whitened[:, checked] / length
    alike = np.abs(direction.T @ direction) > 1.0 - _PARALLEL
    isolable[checked] = alike.sum(axis=0) == 1
    if checked.size < index.size:
        capability = Capability.NEITHER
    else:
        capability = Capability.ISOLATES if isolable[index].all() else Capability.DETECTS
    return ParityTest(mask, dof, capability, v, whitened, gain, isolable, glt_threshold(pfa, dof))


@jit
def parity_vector(whitened: Array, dof: int, z: Array, p: Array) -> float:
    """p[:dof] = whitened z, in place; returns p'p. Elements of z whose column is zero may be anything finite."""
    total = 0.0
    for r in range(dof):
        s = 0.0
        for i in range(z.shape[0]):
            s += whitened[r, i] * z[i]
        p[r] = s
        total += s * s
    return total


@jit
def suspect(whitened: Array, dof: int, gain: Array, p: Array) -> tuple[int, float]:
    """Sensor with the largest (v_i'p)^2 / (v_i'v_i), and that value: what its removal takes off the statistic. -1: none."""
    best, value = -1, -1.0
    for i in range(gain.shape[0]):
        if gain[i] > 0.0:
            s = 0.0
            for r in range(dof):
                s += whitened[r, i] * p[r]
            s = s * s * gain[i]
            if s > value:
                best, value = i, s
    return best, value


@jit
def suspect_pair(whitened: Array, dof: int, gain: Array, p: Array, explained: float) -> tuple[int, int, float, int]:
    """Two sensors whose faults together explain the parity vector best.

    Parameters
    ----------
    whitened, dof, gain, p : as in `suspect`
    explained : a pair explains p when what it takes off the statistic is at least this

    Returns
    -------
    i, j : the best pair, i < j; -1, -1: none
    value : what their removal takes off the statistic
    count : number of pairs that explain p; more than one: ambiguous
    """
    n = gain.shape[0]
    best_i, best_j, value, count = -1, -1, -1.0, 0
    for i in range(n):
        if gain[i] == 0.0:
            continue
        a = 0.0
        for r in range(dof):
            a += whitened[r, i] * p[r]
        for j in range(i + 1, n):
            if gain[j] == 0.0:
                continue
            b, c = 0.0, 0.0
            for r in range(dof):
                b += whitened[r, j] * p[r]
                c += whitened[r, i] * whitened[r, j]
            g, h = 1.0 / gain[i], 1.0 / gain[j]
            determinant = g * h - c * c
            if determinant <= 1e-9 * g * h:
                continue  # parallel: one unknown, not two
            s = (a * a * h - 2.0 * a * b * c + b * b * g) / determinant
            if s >= explained:
                count += 1
            if s > value:
                best_i, best_j, value = i, j, s
    return best_i, best_j, value, count
