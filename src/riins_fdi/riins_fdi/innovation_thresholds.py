"""Thresholds of the innovation tests from the mean number of epochs between false alarms.

Lives here: run length of MEWMA by quadrature, alarm rate of averages and their maxima by importance sampling, calibration of the improved chi-square.
Does not live here: the tests (innovation_tests), thresholds of one epoch (innovation) and of the CUSUM (run_length).
"""

from __future__ import annotations

import functools
import math

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import brentq
from scipy.stats import chi2, ncx2

from riins_core.jit import jit

Array = NDArray[np.float64]

_SAMPLES = 2000
_CALIBRATION = 2_000_000
_CLUSTERS = 30
"""Below so many clusters of alarms in the calibration run their rate is extrapolated."""


def mewma_run_length(threshold: float, dof: int, weight: float) -> float:
    """Mean number of epochs until the MEWMA of standard normals exceeds its threshold, from zero.

    Parameters
    ----------
    threshold : of Z'Z (2 - weight) / weight
    dof : components
    weight : of the newest innovation

    Returns
    -------
    L(0) of L(v) = 1 + integral_0^c L(y) f(y; dof, (1 - weight)^2 v) dy, v = Z'Z / weight^2, f the noncentral chi-square density (Rigdon 1995),
    by Gauss-Legendre quadrature in sqrt(y)
    """
    c = math.sqrt(threshold / (weight * (2.0 - weight)))
    nodes, weights = np.polynomial.legendre.leggauss(max(48, math.ceil(5.0 * c)))
    s, w = 0.5 * c * (nodes + 1.0), 0.5 * c * weights
    at = np.append(s, 0.0)
    centre = np.maximum(((1.0 - weight) * at) ** 2, 1e-12)[:, None]
    kernel = np.zeros((at.size, at.size))
    kernel[:, :-1] = w * 2.0 * s * ncx2.pdf((s**2)[None, :], dof, centre)
    return float(np.linalg.solve(np.eye(at.size) - kernel, np.ones(at.size))[-1])


@functools.lru_cache(maxsize=256)
def mewma_threshold(epochs: float, dof: int, weight: float) -> float:
    """Threshold at which the MEWMA gives a false alarm every `epochs` epochs on the mean; arguments as in `mewma_run_length`."""
    _check(epochs)
    high = float(chi2.isf(1.0 / epochs, dof)) + 1.0  # that of independent statistics: a correlated one alarms less often

    def excess(threshold: float) -> float:
        return math.log(mewma_run_length(threshold, dof, weight) / epochs)

    return float(brentq(excess, 1e-3, high, xtol=1e-4))


@jit
def _cluster_sizes(noise: Array, lengths: NDArray[np.int64], width: NDArray[np.int64], level: Array, threshold: float, sizes: Array) -> None:
    """Given that the mean of length `width` that ends at epoch 0 is `level`, the number of (epoch, length) about it that exceed the threshold.

    noise (samples, 3 W + 1, dof), level (samples, dof): the epoch 0 is row 2 W; epochs -W .. W are looked at.
    """
    reach, dof = lengths[-1], noise.shape[2]
    sums = np.zeros((3 * reach + 2, dof))
    for sample in range(noise.shape[0]):
        w = width[sample]
        for i in range(dof):
            s = 0.0
            for k in range(2 * reach + 1 - w, 2 * reach + 1):
                s += noise[sample, k, i]
            lift = (level[sample, i] - s / np.sqrt(w)) / np.sqrt(w)
            for k in range(3 * reach + 1):
                inside = 2 * reach + 1 - w <= k <= 2 * reach
                sums[k + 1, i] = sums[k, i] + noise[sample, k, i] + (lift if inside else 0.0)
        count = 0
        for k in range(reach, 3 * reach + 1):
            for length in lengths:
                s = 0.0
                for i in range(dof):
                    s += (sums[k + 1, i] - sums[k + 1 - length, i]) ** 2
                if s > threshold * length:
                    count += 1
        sizes[sample] = max(count, 1)  # rounding of the one that is certain


def averaged_alarm_rate(threshold: float, dof: int, lengths: ArrayLike, samples: int = _SAMPLES, seed: int = 1) -> float:
    """False alarms per epoch of max over w of |sum of the last w innovations|^2 / w, each run of alarms counted once.

    Parameters
    ----------
    threshold : of that maximum
    dof : components
    lengths : lengths w, ascending; one length is the averaged innovation
    samples, seed : of the importance sampling

    Returns
    -------
    sum over w of P(chi-square(dof) > threshold) E[1 / N | length w exceeds it], N the size of its cluster (Naiman and Priebe 2001); an alarm in a
    year costs no more than one in a minute
    """
    widths = np.ascontiguousarray(lengths, dtype=np.int64)
    rng = np.random.default_rng(seed)
    width = widths[(np.arange(samples) * widths.size) // samples]
    radius = np.sqrt(chi2.isf(rng.uniform(size=samples) * chi2.sf(threshold, dof), dof))
    direction = rng.standard_normal((samples, dof))
    level = direction * (radius / np.linalg.norm(direction, axis=1))[:, None]
    reach, sizes, part = int(widths[-1]), np.empty(samples), 100
    for start in range(0, samples, part):
        some = slice(start, start + part)
        noise = rng.standard_normal((min(part, samples - start), 3 * reach + 1, dof))
        _cluster_sizes(noise, widths, width[some], level[some], threshold, sizes[some])
    return float(chi2.sf(threshold, dof) * widths.size * np.mean(1.0 / sizes))


def averaged_threshold(epochs: float, dof: int, lengths: ArrayLike) -> float:
    """Threshold at which that maximum gives a false alarm every `epochs` epochs on the mean; arguments as in `averaged_alarm_rate`."""
    return _averaged_threshold(epochs, dof, tuple(np.asarray(lengths, dtype=np.int64).tolist()))


@functools.lru_cache(maxsize=256)
def _averaged_threshold(epochs: float, dof: int, lengths: tuple[int, ...]) -> float:
    _check(epochs)

    def excess(threshold: float) -> float:
        return math.log(averaged_alarm_rate(threshold, dof, lengths) * epochs)

    high = float(chi2.isf(0.5 / (epochs * len(lengths)), dof))  # by Bonferroni the rate is below what is asked
    low = 0.1 * high
    return float(brentq(excess, low, high, xtol=2e-2))


def improved_statistic(u: Array, kept: int, membership: tuple[float, float], relief: float) -> Array:
    """Statistic of the improved chi-square for standardized innovations (n, dof): (n - kept,), from the first one that is complete."""
    square = np.einsum("ki,ki->k", u, u)
    across = np.einsum("ki,ki->k", u[:-1], u[1:])
    largest = 0.5 * (square[:-1] + square[1:]) + np.sqrt(0.25 * (square[:-1] - square[1:]) ** 2 + across**2)
    mu = np.clip((largest - membership[0]) / (membership[1] - membership[0]), 0.0, 1.0)
    count = len(largest) - kept + 1
    mean = sum(largest[i : i + count] for i in range(kept)) / kept
    return np.asarray(mean / (1.0 - relief * sum(mu[i : i + count] for i in range(kept)) / kept))


@functools.lru_cache(maxsize=64)
def improved_threshold(epochs: float, dof: int, kept: int, membership: tuple[float, float], relief: float, seed: int = 1) -> float:
    """Threshold of the improved chi-square, calibrated on seeded noise.

    Parameters
    ----------
    epochs : mean number of epochs between false alarms
    dof : components of the innovation
    kept, membership, relief : of the test
    seed : of the two million innovations

    Returns
    -------
    threshold; where the noise holds fewer than 30 clusters of alarms (epochs above 6e4), their rate is continued as an exponential of the threshold,
    which the tail of an eigenvalue is but for slow factors
    """
    _check(epochs)
    rng = np.random.default_rng(seed)
    peaks, block = [], kept + 1  # alarms within the reach of one innovation are one
    for _ in range(20):
        s = improved_statistic(rng.standard_normal((_CALIBRATION // 20, dof)), kept, membership, relief)
        s = s[: len(s) // block * block]
        inner = np.maximum.reduce([np.roll(s, shift) for shift in range(-block, block + 1)])
        peaks.append(s[(s == inner) & (s > np.median(s))])
    level = np.sort(np.concatenate(peaks))[::-1]
    wanted = _CALIBRATION / epochs
    if wanted >= len(level):
        raise ValueError(f"the improved chi-square cannot alarm every {epochs:g} epochs")
    if wanted >= _CLUSTERS:
        return float(np.interp(wanted, np.arange(1, len(level) + 1), level))
    upper, lower = level[_CLUSTERS - 1], level[20 * _CLUSTERS - 1]
    return float(upper + (upper - lower) / math.log(20.0) * math.log(_CLUSTERS / wanted))


def _check(epochs: float) -> None:
    if not epochs > 1.0:
        raise ValueError("needs more than one epoch between alarms")
