"""Tests over many samples within the compiled loop: cumulative sums (CUSUM) and windowed likelihood ratios (GLR) on the parity vector.

Lives here: their memory and kernel, for gyros and accelerometers, and `Sequences`, which makes them anew when another set of sensors is in use.
Does not live here: the tests as objects (riins_fdi.sequential), their thresholds (riins_fdi.run_length), who explains an alarm (judges.py).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from riins_core.jit import inner
from riins_core.settings import setting
from riins_fdi.motion import errors_of
from riins_fdi.parity import ParityTest
from riins_fdi.run_length import cusum_threshold, glr_threshold, window_lengths

F = NDArray[np.float64]
I = NDArray[np.int64]  # noqa: E741
U = NDArray[np.uint64]

NONE, CUSUM, GLR = 0, 1, 2
SEQUENTIAL_TESTS = {"none": NONE, "cusum": CUSUM, "glr": GLR}
"""Number of each test by name."""
BIAS_SIGMAS = 4.0
"""CUSUM lets the mean of ordinary biases pass up to this many of their sigmas; GLR has their variance in that of each window."""
SAMPLES = 200
"""Of the importance sampling of the GLR's threshold: 10 % of the false-alarm rate."""
_REBASE = 4096
"""Samples after which the running sums are counted from zero again, so that they keep their digits over a voyage."""

# elements of SequenceState.ints, then the length of each chart, (n, 2)
FED, COUNT, ALARM, WIDTH, WHO = range(5)
"""stamp of the last sample fed; samples since the beginning; 1: the last sample alarmed; samples since the likeliest onset; the sensor"""
INTS = 5
# rows of SequenceState.vec
BIAS2, UP, DOWN, STILL2, PEAK2 = 0, 1, 2, 3, 4
"""variance of the mean of u_i'p that ordinary biases give, and errors that grow with the motion; sums of the charts for positive and negative
faults; the former part of the variance; the latter"""
# elements of SequenceState.level
THRESHOLD, REFERENCE = 0, 1


@dataclass(frozen=True)
class SequenceSettings:
    """What a test over many samples looks for; its threshold comes from the mean time between false alarms."""

    window_s: float = setting(1.0, "longest window of the GLR", "s", 0.01, 60.0)
    shift: float = setting(1.0, "mean of a unit parity equation that CUSUM is made for, in its sigma", "", 0.01, 100.0)


class SequenceState(NamedTuple):
    """Memory of both kinds of sensor, leading axis 2; of the set of sensors in `key`."""

    key: U  # (2,), 0: none yet
    ints: I  # (2, INTS + 2 n)
    vec: F  # (2, 5, n)
    level: F  # (2, 2)
    u: F  # (2, n, d), unit columns of the parity matrix in white noise of unit variance
    sums: F  # (2, W + 1, d), ring of running sums (GLR); (2, 2 n, d), sums since each chart was zero (CUSUM)
    p: F  # (2, d), parity vector of an alarm, scaled to the noise of one sample
    lengths: I  # (l,), window lengths


@inner
def move(kind: int, t: int, test: int, H: F, W: F, errors: F, white: F, dof: int, z: F, st: SequenceState) -> None:
    """Before `feed`: let the variance of the mean follow the motion of the sample, H (n, 3), W (3, n), errors as in riins_fdi.motion.

    What the GLR holds of an earlier motion counts on, less by e^-2 for a longest window: the mean over a window holds no more of it.
    """
    if st.ints[kind, FED] == t:
        return
    n, longest = z.shape[0], st.lengths[st.lengths.shape[0] - 1]
    keep = np.exp(-2.0 / longest) if test == GLR else 0.0
    D = np.empty(n)
    errors_of(H, W, z, errors, D)
    for i in range(n):
        a = 0.0
        for j in range(n):
            b = 0.0
            for r in range(dof):
                b += st.u[kind, i, r] * white[r, j]
            a += b * b * D[j]
        st.vec[kind, PEAK2, i] = max(a, keep * st.vec[kind, PEAK2, i])
        st.vec[kind, BIAS2, i] = st.vec[kind, STILL2, i] + st.vec[kind, PEAK2, i]


@inner
def feed(kind: int, t: int, test: int, white: F, dof: int, z: F, st: SequenceState) -> bool:
    """Feed a sample (n,) of the set st.key; True: alarm, and st.p is the parity vector to be explained.

    Parameters
    ----------
    t : stamp; a sample that was fed already, because the loop had to begin it again, only repeats its answer
    white : (d, n), parity matrix scaled to white noise of unit variance
    """
    ints = st.ints[kind]
    if ints[FED] == t:
        return bool(ints[ALARM] == 1)
    ints[FED] = t
    p = np.zeros(dof)
    for r in range(dof):
        for i in range(z.shape[0]):
            p[r] += white[r, i] * z[i]
    ints[COUNT] += 1
    best = feed_cusum(p, dof, st.u[kind], st.level[kind], st.vec[kind], ints, st.sums[kind]) if test == CUSUM else (
        feed_glr(p, dof, st.u[kind], st.vec[kind], ints, st.sums[kind], st.lengths)
    )  # fmt: skip
    ints[ALARM] = 1 if best > st.level[kind, THRESHOLD] else 0
    if ints[ALARM] == 0:
        return False
    n, w = z.shape[0], ints[WIDTH]
    scale = 1.0 / np.sqrt(w + w * w * st.vec[kind, BIAS2, ints[WHO]])
    if test == CUSUM:
        side = 0 if st.vec[kind, UP, ints[WHO]] >= st.vec[kind, DOWN, ints[WHO]] else 1
        for r in range(dof):
            st.p[kind, r] = scale * st.sums[kind, side * n + ints[WHO], r]
    else:
        size = st.sums.shape[1]
        now = ints[COUNT] % size
        for r in range(dof):
            st.p[kind, r] = scale * (st.sums[kind, now, r] - st.sums[kind, (now - w) % size, r])
    return True


@inner
def feed_glr(p: F, dof: int, u: F, vec: F, ints: I, sums: F, lengths: I) -> float:
    """Largest (u_i'S_w)^2 / (w + w^2 b_i) over sensors and window lengths."""
    size, count = sums.shape[0], ints[COUNT]
    previous, now = (count - 1) % size, count % size
    for r in range(dof):
        sums[now, r] = sums[previous, r] + p[r]
    best = -1.0
    for length in lengths:
        if length > count:
            break
        then = (now - length) % size
        for i in range(u.shape[0]):
            s = 0.0
            for r in range(dof):
                s += u[i, r] * (sums[now, r] - sums[then, r])
            s = s * s / (length + length * length * vec[BIAS2, i])
            if s > best:
                best = s
                ints[WHO] = i
                ints[WIDTH] = length
    if count % _REBASE == 0:
        for r in range(dof):
            s = sums[now, r]
            for row in range(size):
                sums[row, r] -= s
    return best


@inner
def feed_cusum(p: F, dof: int, u: F, level: F, vec: F, ints: I, sums: F) -> float:
    """Largest of all charts g <- max(0, g + s u_i'p - reference), s = +1, -1; none grows beyond twice the threshold: it must come down again."""
    n, best = u.shape[0], -1.0
    for i in range(n):
        s = 0.0
        for r in range(dof):
            s += u[i, r] * p[r]
        for side in range(2):
            g = vec[UP + side, i] + (s if side == 0 else -s) - level[REFERENCE] - BIAS_SIGMAS * np.sqrt(vec[BIAS2, i])
            place = INTS + side * n + i
            if g <= 0.0:
                g = 0.0
                ints[place] = 0
                sums[side * n + i, :] = 0.0
            else:
                ints[place] += 1
                for r in range(dof):
                    sums[side * n + i, r] += p[r]
            vec[UP + side, i] = min(g, 2.0 * level[THRESHOLD])
            if g > best:
                best = g
                ints[WHO] = i
                ints[WIDTH] = max(1, ints[place])
    return best


class Sequences:
    """The sequential test of both kinds of sensor.

    Parameters
    ----------
    settings : windows and shift
    n : number of sensors
    rate_hz : sample rate
    epochs : mean number of samples between false alarms
    """

    def __init__(self, settings: SequenceSettings, n: int, rate_hz: float, epochs: float) -> None:
        self._settings, self._n, self._epochs = settings, n, epochs
        self._lengths = window_lengths(max(1, round(settings.window_s * rate_hz)))

    def fresh(self, test: int) -> SequenceState:
        """Memory before the first sample: no set of sensors yet."""
        n, d = self._n, max(1, self._n - 3)
        rows = {NONE: 1, CUSUM: 2 * n, GLR: int(self._lengths[-1]) + 1}[test]
        ints = np.zeros((2, INTS + 2 * n), np.int64)
        ints[:, FED] = -1
        return SequenceState(
            key=np.zeros(2, np.uint64),
            ints=ints,
            vec=np.zeros((2, 5, n)),
            level=np.full((2, 2), math.inf),
            u=np.zeros((2, n, d)),
            sums=np.zeros((2, rows, d)),
            p=np.zeros((2, d)),
            lengths=self._lengths,
        )

    def begin(self, state: SequenceState, test: int, kind: int, parity: ParityTest, white: F, bias_sigma: float) -> None:
        """Begin anew with a set of sensors.

        Parameters
        ----------
        state : written
        test : number of the test
        kind : 0 gyros, 1 accelerometers
        parity : test of the set
        white : (dof, n), its parity matrix scaled to white noise of unit variance
        bias_sigma : ordinary bias of a sensor, in the unit of the measurements
        """
        state.key[kind] = np.uint64(parity.mask)
        fed = state.ints[kind, FED]
        for array in (state.ints, state.vec, state.u, state.sums):
            array[kind] = 0
        state.ints[kind, FED] = fed
        state.level[kind] = math.inf
        if parity.dof < 1:
            return
        length = np.linalg.norm(white, axis=0)
        checked = parity.gain > 0.0
        u = np.where(checked[:, None], white.T / np.where(checked, length, 1.0)[:, None], 0.0)
        state.u[kind, :, : parity.dof] = u
        state.vec[kind, (BIAS2, STILL2)] = np.sum((u @ white) ** 2, axis=1) * bias_sigma**2
        reference = 0.5 * self._settings.shift
        if test == CUSUM:
            state.level[kind] = cusum_threshold(self._epochs, reference, 2 * int(np.count_nonzero(checked))), reference
        else:
            state.level[kind, THRESHOLD] = glr_threshold(self._epochs, u[checked], self._lengths, SAMPLES)


def forget(state: SequenceState, kind: int) -> None:
    """Begin anew with the next sample: what the sums hold is no longer what the sensors say."""
    state.key[kind] = 0
