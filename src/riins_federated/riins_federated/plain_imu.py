"""An ordinary IMU in place of the fused one: samples without a number, whose values may be those of an instant.

Lives here: `PlainImu`, which makes of sensor_msgs/Imu readings what the navigator integrates.
Does not live here: several IMUs and fault detection (riins_imu_fusion), the message (riins_node.readings).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .types import Array


class PlainSample(NamedTuple):
    """Number, mean rate and mean specific force (3,) over the time since the sample before."""

    sequence: int
    rate: Array
    force: Array


class PlainImu:
    """Numbers and means of one stream.

    Parameters
    ----------
    rate_hz : nominal rate, by which losses are counted; 0: not known, none are
    instant : values are those of the stamp; the mean since the last sample is then that of both (trapezoid rule). False: they are means already
    max_delay_s : a stamp that goes back by more than this begins anew, as it does in the navigator
    """

    def __init__(self, rate_hz: float, instant: bool, max_delay_s: float) -> None:
        self._period = 1e9 / rate_hz if rate_hz > 0.0 else 0.0
        self._instant = instant
        self._max_delay = round(max_delay_s * 1e9)
        self._before: tuple[int, int, Array, Array] | None = None

    def take(self, stamp_ns: int, rate: Array, force: Array) -> PlainSample:
        """Next sample; one that the navigator will reject (not finite, a stamp not after the last) changes nothing here.

        Parameters
        ----------
        stamp_ns : its stamp
        rate, force : (3,), rad/s, m/s^2, FRD
        """
        before = self._before
        if (before is not None and -self._max_delay <= stamp_ns - before[0] <= 0) or not np.isfinite([rate, force]).all():
            return PlainSample(0 if before is None else before[1], rate, force)
        if before is None or abs(stamp_ns - before[0]) > self._max_delay:
            self._before = (stamp_ns, 1, rate, force)
            return PlainSample(1, rate, force)
        step = stamp_ns - before[0]
        number = before[1] + max(1, round(step / self._period) if self._period else 1)
        self._before = (stamp_ns, number & 0xFFFFFFFF, rate, force)
        if not self._instant:
            return PlainSample(number & 0xFFFFFFFF, rate, force)
        return PlainSample(number & 0xFFFFFFFF, 0.5 * (before[2] + rate), 0.5 * (before[3] + force))
