"""Samples of the IMU that never came: what the vehicle may have done meanwhile, and how much of it is not known.

Lives here: `Gaps`, which learns the motion from the samples that come and puts interpolated ones, with their uncertainty, where some are missing.
Does not live here: samples in which a sensor is missing (riins_imu_fusion), the counting of losses (ordered_run.py).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from riins_core.jit import jit

from .types import Array

LONG = 1.5
"""A step beyond so many sample intervals is a gap."""
MEMORY_S = 60.0
"""Time constant of what is learned of the motion: some ten waves."""
INTERVAL_MEMORY = 20.0
"""Samples over which the sample interval is averaged."""
MISCOUNT = 0.1
"""Part by which the time of a gap and the number of missing samples may differ where both are known."""
GRAVITY = 9.8

MEAN, SQUARE, CHANGE, LAST = 0, 1, 2, 3


class Filled(NamedTuple):
    """Samples without gaps; as those given where there was none.

    unknown : (m, 6), variance of rates and forces that their noise does not have, (rad/s)^2, (m/s^2)^2; zero for a sample that came
    """

    stamp_ns: NDArray[np.int64]
    rate: Array
    force: Array
    rate_covariance: Array
    force_covariance: Array
    dt: Array
    unknown: Array


class Gaps:
    """Fills gaps in a stream of IMU samples.

    Notes
    -----
    Over a step U rates and forces are interpolated. A motion of angular frequency w and standard deviation s then integrates to s U |sin x / x -
    cos x| beside the truth, x = w U / 2: x^2 / 3 while the step is short, s U when nothing is known. s and w are those of the last minute, axis by
    axis, w^2 from the mean square of the changes from sample to sample; noise makes it larger, which errs on the safe side. Attitude unknown by e
    leaves g e U / sqrt(3) of the velocity unknown.
    """

    def __init__(self) -> None:
        self._state: Array = np.zeros((4, 6))
        self._scalars: Array = np.zeros(2)  # sample interval, samples learned from
        self.new_run()

    def new_run(self) -> None:
        """The next sample is not compared with the last one."""
        self._fresh = True

    def is_gap(self, step_s: float, missing: int) -> bool:
        """Whether a step of the stamps is that of as many missing samples, and not of the clock."""
        interval = float(self._scalars[0])
        return interval > 0.0 and missing > 0 and abs(step_s / interval / (missing + 1) - 1.0) < MISCOUNT

    def fill(self, stamp_ns: NDArray[np.int64], rate: Array, force: Array, rate_covariance: Array, force_covariance: Array, dt: Array) -> Filled:
        """Take samples (m,), (m, 3), (m, 3), (m, 3, 3), (m, 3, 3), (m,) in their order, finite; returns as many or more."""
        given = Filled(stamp_ns, rate, force, rate_covariance, force_covariance, dt, np.zeros((len(dt), 6)))
        out, start = [], 0
        while start < len(dt):
            before = self._state[LAST].copy()
            if self._fresh:  # its step is that from the initial state
                self._state[LAST, :3], self._state[LAST, 3:] = rate[start], force[start]
                self._fresh, k = False, 0
            else:
                k = _learn(self._state, self._scalars, rate[start:], force[start:], dt[start:])
            stop = start + k
            if k:
                before = np.concatenate([rate[stop - 1], force[stop - 1]])
                out.append(_rows(given, slice(start, stop)))
            if stop < len(dt):
                if dt[stop] > LONG * self._scalars[0] > 0.0:
                    out.append(self._bridge(_rows(given, stop), before))
                else:
                    out.append(_rows(given, slice(stop, stop + 1)))
                _pass(self._state, rate[stop], force[stop])
            start = stop + 1
        if not out:
            return given
        return out[0] if len(out) == 1 else Filled._make(np.concatenate(parts) for parts in zip(*out, strict=True))

    def _bridge(self, after: Filled, before: Array) -> Filled:
        """The missing samples and the one behind them."""
        dt, interval = float(after.dt), float(self._scalars[0])
        n = max(round(dt / interval) - 1, 1)
        gap = dt - interval
        known = np.concatenate([after.rate, after.force])
        part = (np.arange(1, n + 1)[:, None]) / (n + 1)
        values = np.vstack([before + part * (known - before), known])
        steps = np.append(np.full(n, gap / n), interval)
        stamps = int(after.stamp_ns) - np.round((dt - np.cumsum(steps)) * 1e9).astype(np.int64)
        unknown = np.zeros((n + 1, 6))
        unknown[:n] = self.variance(dt) * n / gap**2  # from the middle of the last sample to that of the next it is as long as the step
        rates, forces = (np.broadcast_to(one, (n + 1, 3, 3)) for one in (after.rate_covariance, after.force_covariance))
        return Filled(stamps, values[:, :3], values[:, 3:], rates, forces, steps, unknown)

    def variance(self, step: float) -> Array:
        """(6,), of the angle [rad^2] and the velocity [m^2/s^2] that a step [s] over a gap leaves unknown, axis by axis of the body."""
        spread = np.maximum(self._state[SQUARE] - self._state[MEAN] ** 2, 0.0)
        with np.errstate(divide="ignore", invalid="ignore"):
            x = np.where(spread > 0.0, 0.5 * step * np.sqrt(self._state[CHANGE] / spread), 0.0)
        out: Array = spread * step**2 * np.minimum(x * x / 3.0, 1.0) ** 2
        out[3:] += (GRAVITY * step) ** 2 / 3.0 * out[:3].max()
        return out


def _rows(samples: Filled, index: int | slice) -> Filled:
    return Filled._make(column[index] for column in samples)


@jit
def _learn(state: Array, scalars: Array, rate: Array, force: Array, dt: Array) -> int:
    """Learn from samples up to the first gap; returns their number."""
    for k in range(len(dt)):
        if dt[k] <= 0.0:
            continue
        if scalars[0] > 0.0 and dt[k] > LONG * scalars[0]:
            return k
        scalars[0] += (dt[k] - scalars[0]) / min(scalars[1] + 1.0, INTERVAL_MEMORY)
        scalars[1] += 1.0
        weight = max(dt[k] / MEMORY_S, 1.0 / scalars[1])
        for i in range(6):
            value = rate[k, i] if i < 3 else force[k, i - 3]
            change = (value - state[LAST, i]) / dt[k]
            state[MEAN, i] += weight * (value - state[MEAN, i])
            state[SQUARE, i] += weight * (value * value - state[SQUARE, i])
            state[CHANGE, i] += weight * (change * change - state[CHANGE, i])
            state[LAST, i] = value
    return len(dt)


@jit
def _pass(state: Array, rate: Array, force: Array) -> None:
    """The last sample, without learning from its change."""
    for i in range(3):
        state[LAST, i] = rate[i]
        state[LAST, 3 + i] = force[i]
