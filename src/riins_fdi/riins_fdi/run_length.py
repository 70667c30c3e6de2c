"""Thresholds of the sequential tests from the mean time between false alarms.

Lives here: exact run length of CUSUM, alarm rate of the windowed GLR by importance sampling, good to any rarity; both inverted for the threshold.
Does not live here: the tests themselves (sequential), probabilities of a single epoch (parity, innovation).
"""

from __future__ import annotations

import functools
import math

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import brentq
from scipy.special import ndtri_exp
from scipy.stats import norm

from riins_core.jit import jit

Array = NDArray[np.float64]

_SAMPLES = 2000
_PER_OCTAVE = 6
_STEPS, _CLOSE = 30, 1e-2  # of the search for the GLR's threshold; the importance sampling is good to more than a tenth of it


def epochs_between_alarms(hours: float, rate_hz: float) -> float:
    """Mean number of epochs between false alarms for `hours` [h] at `rate_hz` [Hz]."""
    if not (hours > 0.0 and rate_hz > 0.0):
        raise ValueError("the mean time between false alarms and the rate must be positive")
    return hours * 3600.0 * rate_hz


def window_lengths(window: int, dense: bool = False) -> NDArray[np.int64]:
    """Lengths a windowed test looks at: 1 .. window, all of them or about six an octave, ascending."""
    if window < 1:
        raise ValueError("the window must be at least one epoch long")
    if dense:
        return np.arange(1, window + 1, dtype=np.int64)
    steps = math.ceil(_PER_OCTAVE * math.log2(window)) if window > 1 else 0
    return np.unique(np.append(np.minimum(np.round(2.0 ** (np.arange(steps + 1) / _PER_OCTAVE)), window), window).astype(np.int64))


@functools.lru_cache(maxsize=256)
def _gauss(points: int) -> tuple[Array, Array]:
    """Nodes and weights of Gauss-Legendre quadrature."""
    return np.polynomial.legendre.leggauss(points)


def cusum_run_length(threshold: float, reference: float) -> float:
    """Mean number of epochs until a one-sided CUSUM of standard normals exceeds its threshold.

    Parameters
    ----------
    threshold : h > 0
    reference : k > 0, g <- max(0, g + x - k)

    Returns
    -------
    L(0) of L(g) = 1 + L(0) Phi(k - g) + integral_0^h L(y) phi(y - g + k) dy, by Gauss-Legendre quadrature (Goel and Wu 1971); k = 0.5, h = 5: 930.9
    """
    nodes, weights = _gauss(max(48, math.ceil(6.0 * threshold)))
    y, w = 0.5 * threshold * (nodes + 1.0), 0.5 * threshold * weights
    at = np.append(y, 0.0)  # the unknowns: L at the nodes and at zero
    kernel = np.zeros((at.size, at.size))
    kernel[:, :-1] = w * norm.pdf(y[None, :] - at[:, None] + reference)
    kernel[:, -1] = norm.cdf(reference - at)
    return float(np.linalg.solve(np.eye(at.size) - kernel, np.ones(at.size))[-1])


@functools.lru_cache(maxsize=256)
def cusum_threshold(epochs: float, reference: float, charts: int) -> float:
    """Threshold at which `charts` one-sided sums together give a false alarm every `epochs` epochs.

    The sums' alarms are taken as exclusive of each other, which is safe (more time between alarms, not less) and nearly true when alarms are rare.
    """
    if not (epochs > 1.0 and reference > 0.0 and charts >= 1):
        raise ValueError("needs more than one epoch between alarms, a positive reference and at least one chart")
    aim = math.log(epochs * charts)

    def excess(h: float) -> float:
        return math.log(cusum_run_length(h, reference)) - aim

    high = 1.0
    while excess(high) < 0.0:
        high *= 1.5
    return float(brentq(excess, 1e-6, high, xtol=1e-6))


@jit
def _cluster_sizes(
    noise: Array, directions: Array, lengths: NDArray[np.int64], who: NDArray[np.int64], width: NDArray[np.int64], level: Array, b: float,
    sizes: Array,
) -> None:  # fmt: skip
    """Given that |Z(0, who, width)| is `level` > b, the number of (k, i, w) about epoch 0 with |Z(k, i, w)| > b.

    noise (3 W + 1, dof) and who, width, level are one sample each: the epoch 0 is row 2 W; epochs -W .. W are looked at.
    """
    reach = lengths[-1]
    dof = directions.shape[1]
    sums = np.zeros((3 * reach + 2, dof))
    for sample in range(sizes.shape[0]):
        i, w = who[sample], width[sample]
        z = 0.0
        for k in range(2 * reach - w + 1, 2 * reach + 1):
            for r in range(dof):
                z += directions[i, r] * noise[sample, k, r]
        lift = (level[sample] - z / np.sqrt(w)) / np.sqrt(w)
        for k in range(3 * reach + 1):
            inside = 2 * reach - w < k <= 2 * reach
            for r in range(dof):
                sums[k + 1, r] = sums[k, r] + noise[sample, k, r] + (lift * directions[i, r] if inside else 0.0)
        count = 0
        for k in range(reach, 3 * reach + 1):
            for length in lengths:
                for j in range(directions.shape[0]):
                    s = 0.0
                    for r in range(dof):
                        s += directions[j, r] * (sums[k + 1, r] - sums[k + 1 - length, r])
                    if s * s > b * b * length:
                        count += 1
        sizes[sample] = max(count, 1)  # rounding of the one that is certain


def glr_alarm_rate(threshold: float, directions: ArrayLike, lengths: ArrayLike, samples: int = _SAMPLES, seed: int = 1) -> float:
    """False alarms per epoch of the windowed GLR, each run of alarms counted once.

    Parameters
    ----------
    threshold : of g = max (u_i'S_w)^2 / w
    directions : (n, dof), unit vectors u_i
    lengths : window lengths w, ascending
    samples : of the importance sampling; the error is about 1.5 / sqrt(samples) of the rate
    seed : of these

    Returns
    -------
    rate. With Z(k, i, w) = u_i'S_w / sqrt(w) standard normal, rate = sum over (i, w) of P(|Z| > b) E[1 / N | |Z(0, i, w)| > b], N the size of
    the cluster of exceedances around it (Naiman and Priebe 2001 for scan statistics): every cluster counts once, and because the condition is
    drawn and not waited for, an alarm in a year costs no more than one in a minute.
    """
    u = np.asarray(directions, dtype=np.float64)
    widths = np.asarray(lengths, dtype=np.int64)
    b = math.sqrt(threshold)
    rng = np.random.default_rng(seed)
    who = rng.integers(0, u.shape[0], samples)
    width = widths[(np.arange(samples) * widths.size) // samples]  # every length its share
    log_tail = norm.logsf(b)
    level = -ndtri_exp(np.log(rng.uniform(size=samples)) + log_tail)  # normal above b; by the logarithm, for tails of any rarity
    reach, sizes, part = int(widths[-1]), np.empty(samples), 100
    for start in range(0, samples, part):
        some = slice(start, start + part)
        noise = rng.standard_normal((min(part, samples - start), 3 * reach + 1, u.shape[1]))
        _cluster_sizes(noise, u, widths, who[some], width[some], level[some], b, sizes[some])
    return float(2.0 * math.exp(log_tail) * u.shape[0] * widths.size * np.mean(1.0 / sizes))


def glr_threshold(epochs: float, directions: ArrayLike, lengths: ArrayLike, samples: int = _SAMPLES) -> float:
    """Threshold at which the windowed GLR gives a false alarm every `epochs` epochs on the mean; arguments as in `glr_alarm_rate`."""
    if not epochs > 1.0:
        raise ValueError("needs more than one epoch between alarms")
    u = np.round(np.asarray(directions, dtype=np.float64), 9)  # gyros and accelerometers of one array: the same test
    widths = np.ascontiguousarray(lengths, dtype=np.int64)
    return _glr_threshold(epochs, u.tobytes(), u.shape, tuple(widths.tolist()), samples)


@functools.lru_cache(maxsize=256)
def _glr_threshold(epochs: float, directions: bytes, shape: tuple[int, int], lengths: tuple[int, ...], samples: int) -> float:
    u = np.frombuffer(directions).reshape(shape)

    def excess(threshold: float) -> float:
        return math.log(glr_alarm_rate(threshold, u, lengths, samples) * epochs)

    # by Bonferroni the rate is below n L P(|Z| > b); the logarithm of the rate falls by about half of the threshold, so few steps do
    at = float(norm.isf(0.5 / (epochs * shape[0] * len(lengths))) ** 2)
    value, slope = excess(at), -0.5
    for _ in range(_STEPS):
        after = max(at - value / slope, 0.5 * at)
        if abs(after - at) < _CLOSE:
            return after
        new = excess(after)
        slope = min((new - value) / (after - at), -0.1)
        at, value = after, new
    return at
