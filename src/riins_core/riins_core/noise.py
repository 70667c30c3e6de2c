"""Counter-based random sequences: standard normals, first-order Gauss-Markov and random walk, each addressed by sample number.

Lives here: Philox4x32-10, the ziggurat, and bridged sequences. Sample k is a pure function of (seed, stream, k): any split into blocks, any
order of calls and any restart give the same bits. Does not live here: what the noise is added to (sensor_errors.py, riins_sim).
"""

from __future__ import annotations

import hashlib
import math

import numpy as np
from numpy.typing import NDArray

from .jit import jit

Array = NDArray[np.float64]

K_MAX = 1 << 40
"""Sample numbers are 0 .. K_MAX - 1."""
_BLOCK = 64  # samples of a bridged sequence filled one after the other between two knots
_LEVELS = 40 - 6  # halvings from K_MAX down to _BLOCK

_R = 3.6541528853610088  # right edge of the ziggurat's base layer, 256 layers (Doornik 2005, table 1)
_AREA = 0.00492867323399


def _ziggurat() -> tuple[Array, Array]:
    x = np.zeros(257)
    x[0] = _AREA / math.exp(-0.5 * _R * _R)
    x[1] = _R
    for i in range(2, 256):
        x[i] = math.sqrt(-2.0 * math.log(_AREA / x[i - 1] + math.exp(-0.5 * x[i - 1] ** 2)))
    return x, np.exp(-0.5 * x * x)


_X, _FX = _ziggurat()


def stream_id(name: str) -> int:
    """Number of a named stream: the same on every machine and in every run (BLAKE2b, 63 bits)."""
    return int.from_bytes(hashlib.blake2b(name.encode(), digest_size=8).digest(), "little") >> 1


def _key(seed: int, stream: int | str) -> tuple[np.uint64, np.uint64]:
    number = stream_id(stream) if isinstance(stream, str) else stream
    digest = hashlib.blake2b(f"{int(seed)}/{int(number)}".encode(), digest_size=8).digest()
    word = int.from_bytes(digest, "little")
    return np.uint64(word & 0xFFFFFFFF), np.uint64(word >> 32)


@jit
def philox4x32(
    c0: np.uint64, c1: np.uint64, c2: np.uint64, c3: np.uint64, k0: np.uint64, k1: np.uint64
) -> tuple[np.uint64, np.uint64, np.uint64, np.uint64]:
    """Philox4x32-10 (Salmon et al. 2011) on 32-bit words held in 64-bit integers.

    Parameters
    ----------
    c0, c1, c2, c3 : counter words
    k0, k1 : key words

    Returns
    -------
    four random words
    """
    low = np.uint64(0xFFFFFFFF)
    shift = np.uint64(32)
    for _ in range(10):
        p0 = np.uint64(0xD2511F53) * c0
        p1 = np.uint64(0xCD9E8D57) * c2
        c0, c1, c2, c3 = (p1 >> shift) ^ c1 ^ k0, p1 & low, (p0 >> shift) ^ c3 ^ k1, p0 & low
        k0 = (k0 + np.uint64(0x9E3779B9)) & low
        k1 = (k1 + np.uint64(0xBB67AE85)) & low
    return c0, c1, c2, c3


@jit
def _unit(bits: np.uint64) -> float:
    """Uniform in (0, 1) from 64 bits."""
    return float((np.float64(bits >> np.uint64(11)) + 0.5) * 2.0**-53)


@jit
def _normal_rare(bits: np.uint64, k: np.uint64, column: np.uint64, key0: np.uint64, key1: np.uint64) -> float:
    """The ziggurat where the first look fails (1 in 90): wedge, tail and further tries, drawn from the counter's fourth word."""
    attempt = np.uint64(0)
    one, shift, low, rare = np.uint64(1), np.uint64(32), np.uint64(0xFFFFFFFF), np.uint64(0x80000000)
    while True:
        layer = np.int64(bits & np.uint64(255))
        u = float(np.float64(np.int64(bits) >> 11) * 2.0**-52)
        x = float(u * _X[layer])
        if abs(x) < _X[layer + 1]:
            return x
        # the fourth word counts the draws of this sample, its top bit tells them from the first; the third is the column, not the pair
        while True:
            attempt += one
            r0, r1, r2, r3 = philox4x32(k & low, k >> shift, column, attempt | rare, key0, key1)
            a, b = _unit(r0 | (r1 << shift)), _unit(r2 | (r3 << shift))
            if layer > 0:
                break
            t = -math.log(a) / _R
            if -2.0 * math.log(b) > t * t:
                return _R + t if u > 0.0 else -_R - t
        if _FX[layer] + a * (_FX[layer + 1] - _FX[layer]) < math.exp(-0.5 * x * x):
            return x
        attempt += one
        r0, r1, r2, r3 = philox4x32(k & low, k >> shift, column, attempt | rare, key0, key1)
        bits = r0 | (r1 << shift)


@jit
def _normal_of(bits: np.uint64, k: np.uint64, column: np.uint64, key0: np.uint64, key1: np.uint64) -> float:
    layer = np.int64(bits & np.uint64(255))
    x = float(np.float64(np.int64(bits) >> 11) * 2.0**-52 * _X[layer])
    if abs(x) < _X[layer + 1]:
        return x
    return _normal_rare(bits, k, column, key0, key1)


@jit
def _fill_normal(k: np.uint64, key0: np.uint64, key1: np.uint64, out: Array) -> None:
    """Normals of sample k for every column of out (width,): one Philox call serves two columns."""
    shift, low = np.uint64(32), np.uint64(0xFFFFFFFF)
    for pair in range((out.shape[0] + 1) // 2):
        r0, r1, r2, r3 = philox4x32(k & low, k >> shift, np.uint64(pair), np.uint64(0), key0, key1)
        out[2 * pair] = _normal_of(r0 | (r1 << shift), k, np.uint64(2 * pair), key0, key1)
        if 2 * pair + 1 < out.shape[0]:
            out[2 * pair + 1] = _normal_of(r2 | (r3 << shift), k, np.uint64(2 * pair + 1), key0, key1)


@jit
def _normal_block(k0: np.uint64, key0: np.uint64, key1: np.uint64, out: Array) -> None:
    for i in range(out.shape[0]):
        _fill_normal(k0 + np.uint64(i), key0, key1, out[i])


def normal(seed: int, stream: int | str, k0: int, m: int, width: int) -> Array:
    """Standard normals addressed by sample number.

    Parameters
    ----------
    seed : of the run
    stream : number or name of the sequence; different streams are independent
    k0 : first sample number, 0 <= k0
    m : number of samples
    width : columns

    Returns
    -------
    (m, width); row i depends on (seed, stream, k0 + i) and columns on their number alone, whatever the width

    Raises
    ------
    ValueError
        Sample numbers outside 0 .. K_MAX - 1.
    """
    _check_span(k0, m)
    out = np.empty((m, width))
    _normal_block(np.uint64(k0), *_key(seed, stream), out)
    return out


@jit
def _knot(k: int, key0: np.uint64, key1: np.uint64, mean: Array, spread: Array, ends: Array, w: Array, out: Array) -> None:
    """Value at knot k (a multiple of _BLOCK): halve the interval [0, K_MAX] around it, drawing each midpoint between its neighbours."""
    left, right = ends[0].copy(), ends[1].copy()
    start, length, level = 0, K_MAX, 0
    out[:] = left
    while start != k:
        length //= 2
        middle = start + length
        _fill_normal(np.uint64(middle), key0, key1, w)
        for j in range(out.shape[0]):
            out[j] = mean[level] * (left[j] + right[j]) + spread[level] * w[j]
        level += 1
        if k >= middle:
            start = middle
            left[:] = out
        else:
            right[:] = out
    out[:] = left


@jit
def _bridge_block(
    k0: int, key0: np.uint64, key1: np.uint64, mean: Array, spread: Array, ends: Array, fine: Array, out: Array
) -> None:
    """Samples k0 .. of a bridged sequence; `fine` (_BLOCK, 3) are weights of the last sample, of the next knot, and of the noise."""
    m, width = out.shape
    now, knot, w = np.empty(width), np.empty(width), np.empty(width)
    k = k0 - k0 % _BLOCK
    _knot(k, key0, key1, mean, spread, ends, w, now)
    while k < k0 + m:
        if k + _BLOCK < K_MAX:
            _knot(k + _BLOCK, key0, key1, mean, spread, ends, w, knot)
        else:
            knot[:] = ends[1]
        for i in range(_BLOCK):
            if k + i >= k0 + m:
                break
            if i > 0:
                _fill_normal(np.uint64(k + i), key0, key1, w)
                for j in range(width):
                    now[j] = fine[i, 0] * now[j] + fine[i, 1] * knot[j] + fine[i, 2] * w[j]
            if k + i >= k0:
                out[k + i - k0] = now
        now[:] = knot
        k += _BLOCK


class _Bridged:
    """A Markov sequence with random access: knots by halving, samples between two knots one after the other."""

    def __init__(self, seed: int, stream: int | str, width: int) -> None:
        self.width = width
        self._keys = _key(seed, stream)
        self._first = np.empty((1, width))
        self._last = np.empty((1, width))
        _normal_block(np.uint64(0), *self._keys, self._first)
        _normal_block(np.uint64(K_MAX), *self._keys, self._last)
        self._mean = np.empty(_LEVELS)
        self._spread = np.empty(_LEVELS)
        self._fine = np.zeros((_BLOCK, 3))
        self._ends = np.zeros((2, width))

    def block(self, k0: int, m: int) -> Array:
        """Samples k0 .. k0 + m - 1, (m, width); the same bits however the range is split."""
        _check_span(k0, m)
        out = np.empty((m, self.width))
        if m:
            _bridge_block(k0, *self._keys, self._mean, self._spread, self._ends, self._fine, out)
        return out


class GaussMarkov(_Bridged):
    """Stationary first-order Gauss-Markov sequence, autocorrelation sigma^2 exp(-|t| / tau).

    Parameters
    ----------
    sigma : standard deviation, any unit
    tau : correlation time, s
    dt : interval of the samples, s
    seed, stream, width : as in `normal`
    """

    def __init__(self, sigma: float, tau: float, dt: float, seed: int, stream: int | str, width: int) -> None:
        if not (tau > 0.0 and dt > 0.0):
            raise ValueError("correlation time and sample interval must be positive")
        super().__init__(seed, stream, width)
        rate = dt / tau

        def phi(n: int) -> float:
            return math.exp(-n * rate)

        def fresh(n: int) -> float:  # 1 - phi(n)^2 without cancellation
            return -math.expm1(-2.0 * n * rate)

        for level in range(_LEVELS):
            n = K_MAX >> (level + 1)
            self._mean[level] = phi(n) / (1.0 + phi(n) ** 2)
            self._spread[level] = sigma * math.sqrt(fresh(n) / (1.0 + phi(n) ** 2))
        for i in range(1, _BLOCK):
            rest = _BLOCK - i
            whole = fresh(rest + 1)
            self._fine[i] = phi(1) * fresh(rest) / whole, phi(rest) * fresh(1) / whole, sigma * math.sqrt(fresh(1) * fresh(rest) / whole)
        self._ends[0] = sigma * self._first[0]
        self._ends[1] = phi(K_MAX) * self._ends[0] + sigma * math.sqrt(fresh(K_MAX)) * self._last[0]


class RandomWalk(_Bridged):
    """Random walk that starts from 0 at sample 0.

    Parameters
    ----------
    step : standard deviation of one step, any unit (q sqrt(dt) of a continuous walk with density q)
    seed, stream, width : as in `normal`
    """

    def __init__(self, step: float, seed: int, stream: int | str, width: int) -> None:
        super().__init__(seed, stream, width)
        for level in range(_LEVELS):
            self._mean[level] = 0.5
            self._spread[level] = step * math.sqrt(0.5 * (K_MAX >> (level + 1)))
        for i in range(1, _BLOCK):
            rest = _BLOCK - i
            self._fine[i] = rest / (rest + 1), 1.0 / (rest + 1), step * math.sqrt(rest / (rest + 1))
        self._ends[1] = step * math.sqrt(K_MAX) * self._last[0]


def _check_span(k0: int, m: int) -> None:
    if k0 < 0 or m < 0 or k0 + m > K_MAX:
        raise ValueError(f"sample numbers {k0} .. {k0 + m - 1} are outside 0 .. 2^40 - 1")
