"""What a sensor declared faulty has put into the integrals of the fused output since its fault began, to be taken out again.

Lives here: `Recaller`: onset of the fault by maximum likelihood, and its contribution to attitude and velocity in the present body axes.
Does not live here: the records it reads (state.Past, filled by kernel.py), who is declared (pipeline.py), the correction (riins_federated).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from riins_core.imu_array import ImuArray
from riins_core.rotation import exp_so3
from riins_fdi.health import ALWAYS_NS
from riins_fdi.innovation import nis_threshold
from riins_imu_fusion import state as K
from riins_imu_fusion.config import FusionConfig
from riins_imu_fusion.tables import TableCache
from riins_imu_fusion.types import Recall

Array = NDArray[np.float64]

SIGNIFICANT = 3.0
"""A contribution below this many of its own sigmas stays where it is: to take it out would add noise."""


class _Fault(NamedTuple):
    """Fault estimate of one sensor over the records; the sum is zero where the sensor was not fused or nobody checks it."""

    sum: Array  # (r,), sum of dt f, rad or m/s
    variance: Array  # (r,), of it
    span: Array  # (r,), s, time in which it was fused
    column: Array  # (r, 3), what a unit of it does to the fused output
    known: NDArray[np.bool_]  # (r,)


class Recaller:
    """Contributions of declared sensors.

    Parameters
    ----------
    config : settings
    array : geometry
    cache : parity tests of the sets of sensors

    Notes
    -----
    Taking sensor i out of the set U changes the least-squares solution by exactly -w_i f_i, where w_i is its column of the estimator of U and
    f_i = v_i'p / v_i'v_i (whitened) is the fault that U's parity vector says it has. So the sum of dt w_i f_i, turned to the present body axes, is
    what the integral would lack had the sensor left at the onset: no model of the fault enters it. Of f_i its mean before the onset is kept:
    a turn-on bias is part of the fused bias that the navigator estimates. What the fault did to the position is left to the aids.
    """

    def __init__(self, config: FusionConfig, array: ImuArray, cache: TableCache) -> None:
        self._array, self._cache = array, cache
        self._sigma, self._total = config.sigma(), config.total_sigma()
        self._window_ns = round(config.recall_window_s * 1e9)
        self._period_ns = 1e9 / config.rate_hz
        self._probability = config.recall_false_alarm_probability
        self._declared = np.full((2, array.n), ALWAYS_NS, np.int64)

    def reset(self) -> None:
        """Forget who was declared when: the run begins anew."""
        self._declared[:] = ALWAYS_NS

    def recall(self, past: K.Past, kind: int, index: int, stamp_ns: int, stuck: int = 0) -> Recall | None:
        """Contribution of a sensor that is declared faulty.

        Parameters
        ----------
        past : records up to the sample of `stamp_ns`
        kind, index : the sensor
        stamp_ns : sample at which it is declared; present body axes are those at its end
        stuck : samples since which its value has not changed; 0: the parity test declared it, and the onset is to be estimated

        Returns
        -------
        Recall, or None when nothing significant has entered
        """
        since = max(stamp_ns - self._window_ns, int(self._declared[kind, index]))
        self._declared[kind, index] = stamp_ns  # what is recalled now must not be recalled again
        rows = _rows(past, since)
        if not len(rows):
            return None
        fault = self._fault(past, rows, kind, index)
        if stuck:
            onset = int(np.searchsorted(past.last[rows], stamp_ns - round((stuck - 1) * self._period_ns)))
        else:
            onset = self._onset(fault, 1e-9 * (past.last[rows] - stamp_ns).astype(np.float64))
        before, after = slice(0, onset), slice(onset, None)
        weight = float(np.sum(_weights(fault)[before]))
        if weight == 0.0:  # not to be told from a turn-on bias
            return None
        mean = float(np.sum((_weights(fault) * _means(fault))[before])) / weight
        excess = fault.sum[after] - mean * fault.span[after]
        variance = float(np.sum(fault.variance[after]) + np.sum(fault.span[after]) ** 2 / weight)
        if abs(float(np.sum(excess))) < SIGNIFICANT * math.sqrt(variance):
            return None
        angle, velocity = _carry(
            kind, excess[:, None] * fault.column[after], self._fused(past, rows[after], 0), self._fused(past, rows[after], 1)
        )
        return Recall(stamp_ns, ("gyro", "accel")[kind], index, int(past.last[rows[onset - 1]]), angle, velocity)

    def _fault(self, past: K.Past, rows: NDArray[np.int64], kind: int, index: int) -> _Fault:
        m = len(rows)
        fault = _Fault(np.zeros(m), np.zeros(m), np.zeros(m), np.zeros((m, 3)), np.zeros(m, np.bool_))
        for mask, same in _sets(past, rows, kind):
            test = self._cache.test(kind, mask)
            if not mask >> index & 1 or test.dof < 1 or test.gain[index] == 0.0:
                continue
            used = self._array.used(mask)
            row = test.gain[index] * (test.whitened[:, index] @ test.whitened[:, used])
            fault.sum[same] = past.sum[rows[same], kind][:, used] @ row
            fault.variance[same] = past.span[rows[same], 1] * float(np.sum((row * self._sigma[kind, used]) ** 2))
            fault.span[same] = past.span[rows[same], 0]
            fault.column[same] = self._array.least_squares(mask, self._total[kind])[:, index]
            fault.known[same] = True
        return fault

    def _onset(self, fault: _Fault, end: Array) -> int:
        """First row of the fault, 0: not found.

        Of the hypotheses "a step at the beginning of row j" and "a ramp from there on", over a constant that is unknown, the one whose fit takes
        most off the weighted sum of squares: the generalized likelihood ratio 2 ln L1/L0, chi-square with one degree of freedom for a given j
        and shape without a fault. The largest must exceed the threshold of `recall_false_alarm_probability` shared among all of them. The fault
        counts from one row earlier: it may begin within that, which if healthy adds a little noise and nothing else.
        """
        at = np.flatnonzero(fault.known)
        if len(at) < 2:
            return 0
        w, t, start = _weights(fault)[at], end[at] - 0.5 * fault.span[at], end[at] - fault.span[at]
        y = _means(fault)[at]
        total = float(np.sum(w))
        y = y - float(np.sum(w * y)) / total

        def later(x: Array) -> Array:
            """Sum over the rows from each one on, without the first."""
            return np.asarray(np.cumsum(x[::-1])[::-1][1:])

        tau = start[1:]
        a0, a1, a2, b0, b1 = later(w), later(w * t), later(w * t * t), later(w * y), later(w * t * y)
        fits = ((a0, a0, b0), (a1 - tau * a0, a2 - 2.0 * tau * a1 + tau**2 * a0, b1 - tau * b0))  # sums of w g, w g^2, w g y: step, ramp
        ratios = np.stack([np.divide(c * c, d := g2 - g * g / total, out=np.zeros_like(c), where=d > 1e-9 * g2) for g, g2, c in fits])
        best = int(np.argmax(ratios))
        if ratios.flat[best] <= nis_threshold(self._probability / ratios.size, 1):
            return 0
        return int(at[max(1, best % len(tau))])

    def _fused(self, past: K.Past, rows: NDArray[np.int64], kind: int) -> Array:
        """Integral (r, 3) of the fused output over each record."""
        out = np.zeros((len(rows), 3))
        for mask, same in _sets(past, rows, kind):
            used = self._array.used(mask)
            out[same] = past.sum[rows[same], kind][:, used] @ self._array.least_squares(mask, self._total[kind])[:, used].T
        return out


def _rows(past: K.Past, since_ns: int) -> NDArray[np.int64]:
    """Places of the records that end later than a stamp, oldest first."""
    size, filled, newest = len(past.last), int(past.place[K.FILLED]), int(past.place[K.OPEN])
    rows: NDArray[np.int64] = (newest - np.arange(filled - 1, -1, -1)) % size
    return rows[past.last[rows] > since_ns]


def _sets(past: K.Past, rows: NDArray[np.int64], kind: int) -> list[tuple[int, NDArray[np.bool_]]]:
    """Sets of sensors met, and the rows of each."""
    used = past.used[rows, kind]
    return [(int(mask), used == mask) for mask in np.unique(used)]


def _weights(fault: _Fault) -> Array:
    """1 / variance of the mean fault over each record; 0: not known."""
    return np.divide(fault.span**2, fault.variance, out=np.zeros_like(fault.sum), where=fault.known)


def _means(fault: _Fault) -> Array:
    return np.divide(fault.sum, fault.span, out=np.zeros_like(fault.sum), where=fault.known)


def _carry(kind: int, put_in: Array, turned: Array, pushed: Array) -> tuple[Array, Array]:
    """Contributions to attitude and velocity, in the body axes at the end of the last record.

    Parameters
    ----------
    kind : 0: `put_in` is angles, 1: velocities
    put_in : (r, 3), contribution within each record, body axes in its middle
    turned, pushed : (r, 3), integrals of body rate and specific force over each record

    Returns
    -------
    angle, velocity : (3,), the latter with what the specific force makes of the wrong attitude: dv' = angle x f
    """
    angle, velocity = np.zeros(3), np.zeros(3)
    whole, half = exp_so3(-turned), exp_so3(-0.5 * turned)
    for k in range(len(put_in)):
        if kind == 0:
            tilt = half[k] @ angle + 0.5 * put_in[k]
            velocity = whole[k] @ velocity + half[k] @ np.cross(tilt, pushed[k])
            angle = whole[k] @ angle + half[k] @ put_in[k]
        else:
            velocity = whole[k] @ velocity + half[k] @ put_in[k]
    return angle, velocity
