"""Tests over many epochs on parity vectors: cumulative sums (CUSUM) and a generalized likelihood ratio over a sliding window (GLR).

Lives here: the two tests as objects fed in blocks, sample by sample, with the estimated onset and size of the fault.
Does not live here: their thresholds (run_length), parity vectors that carry a calibration (riins_imu_fusion), what follows from an alarm (health).
"""

from __future__ import annotations

import copy
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from riins_core.jit import jit
from riins_fdi.parity import ParityTest, parity_vector
from riins_fdi.run_length import cusum_threshold, glr_threshold, window_lengths

Array = NDArray[np.float64]

_REBASE = 4096
"""Samples after which the running sums are counted from zero again, so that they keep their digits over a voyage."""


class SequentialBlock(NamedTuple):
    """What a test says at each sample of a block."""

    statistic: Array
    """(m,)"""
    alarm: NDArray[np.bool_]
    """(m,), the statistic is above the threshold"""
    sensor: NDArray[np.int64]
    """(m,), the most suspect sensor, alarm or not; -1 before there is one"""
    onset: NDArray[np.int64]
    """(m,), sample number at which its fault is estimated to have begun, the first sample ever fed being 0; -1 likewise"""
    size: Array
    """(m,), estimated size of its fault, in the unit of the measurements, as a mean since the onset"""


class SequentialTest(Protocol):
    """A test over many epochs. Noise is taken as white and without bias: an ordinary bias must be in the parity test's sigma or taken out before."""

    threshold: float

    def process(self, z: ArrayLike) -> SequentialBlock:
        """Feed measurements z (m, n); the result does not depend on how they are cut into blocks."""
        ...

    def reset(self) -> None:
        """Forget everything but the sample number."""
        ...

    def clone(self) -> SequentialTest:
        """A copy that goes on independently."""
        ...


def _directions(test: ParityTest) -> tuple[Array, Array]:
    """Unit columns of the whitened parity matrix as rows (n, dof), zero for unchecked sensors, and their lengths (n,)."""
    if test.dof < 1:
        raise ValueError("the sensors in use have no redundancy")
    length = np.linalg.norm(test.whitened, axis=0)
    checked = test.gain > 0.0
    return np.where(checked[:, None], test.whitened.T / np.where(checked, length, 1.0)[:, None], 0.0), np.where(checked, length, np.inf)


@jit
def _glr(
    z: Array, whitened: Array, directions: Array, lengths: NDArray[np.int64], threshold: float, restart: bool,
    sums: Array, counts: NDArray[np.int64], statistic: Array, alarm: NDArray[np.bool_], sensor: NDArray[np.int64], onset: NDArray[np.int64],
    mean: Array,
) -> None:  # fmt: skip
    """`sums` (W + 1, dof) is a ring of running sums of p; `counts` = [samples fed, samples since the last restart]."""
    size, dof = sums.shape
    n = directions.shape[0]
    p = np.empty(dof)
    for k in range(z.shape[0]):
        parity_vector(whitened, dof, z[k], p)
        previous, now = counts[1] % size, (counts[1] + 1) % size
        for r in range(dof):
            sums[now, r] = sums[previous, r] + p[r]
        counts[0] += 1
        counts[1] += 1
        best, who, width = -1.0, -1, 0
        for length in lengths:
            if length > counts[1]:
                break
            then = (now - length) % size
            for i in range(n):
                s = 0.0
                for r in range(dof):
                    s += directions[i, r] * (sums[now, r] - sums[then, r])
                s = s * s / length
                if s > best:
                    best, who, width = s, i, length
        statistic[k] = best
        alarm[k] = best > threshold
        if alarm[k]:  # every length for the onset, whatever few are tested
            fine = best
            for length in range(1, min(size - 1, counts[1]) + 1):
                then = (now - length) % size
                s = 0.0
                for r in range(dof):
                    s += directions[who, r] * (sums[now, r] - sums[then, r])
                if s * s / length > fine:
                    fine, width = s * s / length, length
        sensor[k] = who
        onset[k] = counts[0] - width
        then = (now - width) % size
        s = 0.0
        for r in range(dof):
            s += directions[who, r] * (sums[now, r] - sums[then, r])
        mean[k] = s / width
        if alarm[k] and restart:
            counts[1] = 0
            sums[0, :] = 0.0
        elif counts[1] % _REBASE == 0:
            for r in range(dof):
                s = sums[now, r]
                for row in range(size):
                    sums[row, r] -= s


class WindowedGlr:
    """Generalized likelihood ratio over a sliding window: which sensor, since when, how much.

    Parameters
    ----------
    test : parity test of the sensors in use (its single-epoch threshold is not used)
    epochs : mean number of epochs between false alarms; `run_length.epochs_between_alarms` makes it from hours
    window : longest time a fault is looked for, epochs
    dense : test every length 1 .. window; otherwise about six an octave, which costs 2 % of delay and takes a third of the time
    restart : begin anew after an alarm
    threshold : instead of the one that `epochs` gives

    Notes
    -----
    g_k = max over sensors i and lengths w of (u_i' sum_{j = k-w+1..k} p_j)^2 / w, u_i the unit column of the whitened parity matrix: twice the log
    of the likelihood ratio of a constant fault of sensor i since w epochs (Willsky and Jones 1976). The thesis' window of failures in a row
    (4.3.1) has neither a size nor an error probability.
    """

    def __init__(
        self, test: ParityTest, epochs: float = 3.6e6, window: int = 100, *, dense: bool = False, restart: bool = True, threshold: float | None = None
    ) -> None:
        self.test = test
        self._u, self._length = _directions(test)
        self.lengths = window_lengths(window, dense)
        self.restart = restart
        checked = self._u[test.gain > 0.0]
        self.threshold = glr_threshold(epochs, checked, self.lengths) if threshold is None else threshold
        self._sums = np.zeros((int(self.lengths[-1]) + 1, test.dof))
        self._counts = np.zeros(2, dtype=np.int64)

    def process(self, z: ArrayLike) -> SequentialBlock:
        """Feed measurements z (m, n)."""
        m, out = _prepared(z, self.test)
        mean = np.empty(len(m))
        _glr(m, self.test.whitened, self._u, self.lengths, self.threshold, self.restart, self._sums, self._counts, *out[:4], mean)
        return SequentialBlock(*out[:4], mean / self._length[out[2]])

    def reset(self) -> None:
        """Forget everything but the sample number."""
        self._sums[:] = 0.0
        self._counts[1] = 0

    def clone(self) -> WindowedGlr:
        """A copy that goes on independently."""
        other = copy.copy(self)
        other._sums, other._counts = self._sums.copy(), self._counts.copy()
        return other


@jit
def _cusum(
    z: Array, whitened: Array, directions: Array, reference: float, threshold: float, restart: bool,
    g: Array, length: NDArray[np.int64], counts: NDArray[np.int64],
    statistic: Array, alarm: NDArray[np.bool_], sensor: NDArray[np.int64], onset: NDArray[np.int64], mean: Array,
) -> None:  # fmt: skip
    """`g`, `length` (n, 2): the sums for positive and negative faults and the samples since they were zero."""
    dof, n = whitened.shape[0], directions.shape[0]
    p = np.empty(dof)
    for k in range(z.shape[0]):
        parity_vector(whitened, dof, z[k], p)
        counts[0] += 1
        best, who, sign = 0.0, -1, 0
        for i in range(n):
            s = 0.0
            for r in range(dof):
                s += directions[i, r] * p[r]
            for side in range(2):
                if side == 1:
                    s = -s
                g[i, side] += s - reference
                length[i, side] += 1
                if g[i, side] <= 0.0:
                    g[i, side] = 0.0
                    length[i, side] = 0
                elif g[i, side] > best:
                    best, who, sign = g[i, side], i, side
        statistic[k] = best
        alarm[k] = best > threshold
        sensor[k] = who
        onset[k] = -1 if who < 0 else counts[0] - length[who, sign]
        mean[k] = 0.0 if who < 0 else (1.0 - 2.0 * sign) * (best / length[who, sign] + reference)
        if alarm[k] and restart:
            g[:] = 0.0
            length[:] = 0


class Cusum:
    """Cumulative sums, two for each sensor: the quickest test of all for a fault of the size it is made for (Page 1954).

    Parameters
    ----------
    test : parity test of the sensors in use
    epochs : mean number of epochs between false alarms
    shift : mean of u_i'p that the sums are made for, in units of its sigma; a fault of f sigma of a dodecahedron's sensor shifts it by f / sqrt 2
    restart : begin anew after an alarm
    threshold : instead of the one that `epochs` gives

    Notes
    -----
    g <- max(0, g + s u_i'p - shift / 2) for s = +1, -1, alarm when any exceeds the threshold; the onset is where that sum was last zero.
    """

    def __init__(self, test: ParityTest, epochs: float = 3.6e6, shift: float = 1.0, *, restart: bool = True, threshold: float | None = None) -> None:
        if not shift > 0.0:
            raise ValueError("the shift must be positive")
        self.test = test
        self._u, self._length = _directions(test)
        self.reference = 0.5 * shift
        self.restart = restart
        charts = 2 * int(np.count_nonzero(test.gain > 0.0))
        self.threshold = cusum_threshold(epochs, self.reference, charts) if threshold is None else threshold
        self._g = np.zeros((self._u.shape[0], 2))
        self._since = np.zeros((self._u.shape[0], 2), dtype=np.int64)
        self._counts = np.zeros(1, dtype=np.int64)

    def process(self, z: ArrayLike) -> SequentialBlock:
        """Feed measurements z (m, n)."""
        m, out = _prepared(z, self.test)
        mean = np.empty(len(m))
        _cusum(
            m, self.test.whitened, self._u, self.reference, self.threshold, self.restart, self._g, self._since, self._counts, *out[:4], mean
        )  # fmt: skip
        return SequentialBlock(*out[:4], mean / self._length[out[2]])

    def reset(self) -> None:
        """Forget everything but the sample number."""
        self._g[:] = 0.0
        self._since[:] = 0

    def clone(self) -> Cusum:
        """A copy that goes on independently."""
        other = copy.copy(self)
        other._g, other._since, other._counts = self._g.copy(), self._since.copy(), self._counts.copy()
        return other


SEQUENTIAL: dict[str, type[WindowedGlr] | type[Cusum]] = {"windowed_glr": WindowedGlr, "cusum": Cusum}
"""The tests by name."""


def _prepared(z: ArrayLike, test: ParityTest) -> tuple[Array, tuple[Array, NDArray[np.bool_], NDArray[np.int64], NDArray[np.int64]]]:
    """Measurements with zeros where a sensor has no part, and room for the answers."""
    m = np.atleast_2d(np.asarray(z, dtype=np.float64))
    m = np.ascontiguousarray(np.where(np.any(test.whitened != 0.0, axis=0), m, 0.0))
    count = len(m)
    return m, (np.empty(count), np.empty(count, dtype=bool), np.empty(count, dtype=np.int64), np.empty(count, dtype=np.int64))
