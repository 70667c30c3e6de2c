"""Several IMUs with clocks of their own on one clock: each output is the mean over its interval of what each IMU measured.

Lives here: `ArrayAligner`: order, waiting, interpolation, lever arms, what is not valid. Vectors are in each IMU's own axes.
Does not live here: settings (array_config.py), mounting errors (array_mounting.py), fault detection (the fusion), ROS (array_node.py).
"""

from __future__ import annotations

import bisect
from enum import Enum
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from riins_imu_fusion.array_config import ArrayConfig

Array = NDArray[np.float64]

_WHOLE = 1.5
"""Samples closer than this many nominal intervals have none missing between them."""
_MOST_ASIDE = 10_000


class Cause(Enum):
    """Why a sample, or an IMU for one output, was not used."""

    LATE = "late"
    DUPLICATE = "stamp seen before"
    CLOCK = "clock out of step"
    SILENT = "silent"
    GAP = "gap"
    NOT_FINITE = "axis not finite"
    STUCK = "axis stuck"


class AlignedSample(NamedTuple):
    """One sample of the array, of n IMUs.

    Attributes
    ----------
    stamp_ns : end of the interval
    sequence : number of the interval since the epoch, modulo 2^32
    gyro, accel : (3 n,), mean rate and specific force at the common point along the axes of each IMU, rad/s, m/s^2; 0 where not valid
    gyro_valid, accel_valid : bit 3 i + a set: axis a of IMU i is valid
    """

    stamp_ns: int
    sequence: int
    gyro: Array
    accel: Array
    gyro_valid: int
    accel_valid: int


class _Sample(NamedTuple):
    raw: Array  # (6,), rate, specific force
    point: Array  # (6,), the same without the centripetal force of the lever arm


class _Stream:
    """What is remembered of one IMU. Stamps are corrected for its clock offset."""

    def __init__(self, period_ns: float, bridge: float, lever: Array) -> None:
        self.whole_ns, self.bridge_ns = round(_WHOLE * period_ns), round(bridge * period_ns)
        self.lever: Array | None = lever if lever.any() else None
        self.counts = dict.fromkeys(Cause, 0)
        self.received = self.used = 0
        self.out_of_step = False  # the last sample was refused for its stamp
        self.reset()

    def reset(self) -> None:
        self.done = 0  # end of the last interval it was used for
        self.stamps: list[int] = []
        self.samples: list[_Sample] = []
        self.heard: int | None = None  # newest stamp, except of samples found to be out of step
        self.last: int | None = None  # last stamp of all
        self.alone = 0  # own time gone by since another IMU was heard
        self.aside: list[tuple[int, Array]] = []
        self.behind = 0  # own time gone by in what is aside because it is behind
        self.silent = False  # the others' clocks are not compared with this one
        self.out = False  # not waited for
        self.back: int | None = None  # first stamp since then
        self.repeats = np.ones(6, np.int64)

    def note(self, cause: Cause) -> None:
        self.counts[cause] += 1
        self.out_of_step |= cause in (Cause.LATE, Cause.CLOCK)

    def take(self, stamp: int, raw: Array) -> None:
        place = bisect.bisect_left(self.stamps, stamp)
        if place < len(self.stamps) and self.stamps[place] == stamp:
            return self.note(Cause.DUPLICATE)
        self.out_of_step = False
        point = raw
        if self.lever is not None:
            rate = raw[:3]
            point = raw.copy()
            point[3:] -= rate * (rate @ self.lever) - self.lever * (rate @ rate)
        self.stamps.insert(place, stamp)
        self.samples.insert(place, _Sample(raw, point))
        if self.out:
            self.back = stamp if self.back is None else min(self.back, stamp)

    def longest(self, begin: int, end: int) -> int | None:
        """Longest interval between the samples from the last not after `begin` to the first not before `end`; None: they do not reach so far."""
        first, last = bisect.bisect_right(self.stamps, begin) - 1, bisect.bisect_left(self.stamps, end)
        if first < 0 or last == len(self.stamps):
            return None
        return max(self.stamps[k + 1] - self.stamps[k] for k in range(first, last))

    def mean(self, begin: int, end: int) -> Array:
        """Mean (6,) of the linear interpolation, turned to the common point; counts repeated values."""
        k = bisect.bisect_right(self.stamps, begin) - 1
        reference = self.samples[k].point  # differences from it: a constant comes out as it is, to the last bit
        area, at_begin = np.zeros(6), np.zeros(6)
        start, value = begin, np.zeros(6)
        while start < end:
            t0, t1 = self.stamps[k], self.stamps[k + 1]
            v0, v1 = self.samples[k].point - reference, self.samples[k + 1].point - reference
            if start == begin:
                at_begin = value = v0 + (v1 - v0) * ((begin - t0) / (t1 - t0))
            stop = min(t1, end)
            following = v1 if stop == t1 else v0 + (v1 - v0) * ((stop - t0) / (t1 - t0))
            area += (0.5 * (stop - start)) * (value + following)
            if t1 <= end:
                self.repeats = np.where(self.samples[k + 1].raw == self.samples[k].raw, self.repeats + 1, 1)
            start, value, k = stop, following, k + 1
        self.done = end
        made = reference + area / (end - begin)
        if self.lever is not None:
            x, y, z = (value[:3] - at_begin[:3]) / ((end - begin) * 1e-9)  # mean angular acceleration
            r = self.lever
            made[3:] -= (y * r[2] - z * r[1], z * r[0] - x * r[2], x * r[1] - y * r[0])
        return made

    def forget(self, before: int) -> None:
        """Drop what no later interval needs."""
        k = bisect.bisect_right(self.stamps, before) - 1
        if k > 0:
            del self.stamps[:k], self.samples[:k]


class ArrayAligner:
    """Samples of n IMUs in any order; samples of the array, in order, out.

    Parameters
    ----------
    config : settings

    Attributes
    ----------
    restarts : times all stamps went back
    empty : output intervals in which no IMU was valid; they are not given out, the sequence number counts them

    Notes
    -----
    Values of sensor_msgs/Imu are taken as instantaneous and linear in between. An output is the mean over (stamp - period, stamp] of that
    (the integral is interpolated: this low-pass is the one against aliases), so every piece of measured time enters exactly one output: the
    outputs add up to the trapezoidal integral of the samples, none counts twice and none is lost.

    An output is given once each IMU has samples around its whole interval with none missing in between; else when the newest stamp is `hold`
    beyond its end: the bridge, plus `max_wait_s`. Then an IMU whose gaps are no longer than the bridge is interpolated, any other is not valid.
    One with nothing at all within the bridge is silent: it is no longer waited for until it has been heard for `max_wait_s`. So the outputs are
    a function of the measurements and their stamps, whatever the order of arrival, as long as none comes after another one that is
    `max_wait_s` younger.

    One clock must not stop the others: a sample ahead of all other IMUs by more than `hold` is kept aside, and counts only if none of them is
    heard for as long as the bridge. Likewise when stamps go back by more than `max_jump_s`: if all do, the run restarts.
    """

    def __init__(self, config: ArrayConfig) -> None:
        self.config = config
        self._period = config.period_ns
        self._wait = round(config.max_wait_s * 1e9)
        self._offset = [round(offset * 1e9) for offset in config.clock_offset_s] * (config.n if len(config.clock_offset_s) == 1 else 1)
        periods = (1e9 / config.each("imu_rate_hz")).tolist()
        self._streams = [_Stream(period, config.bridge, lever) for period, lever in zip(periods, config.levers(), strict=True)]
        self._hold = self._wait + max(stream.bridge_ns for stream in self._streams)
        self._jump = round(config.max_jump_s * 1e9)
        self._front: int | None = None  # end of the last interval
        self._newest = 0
        self.restarts = self.empty = 0

    @property
    def hold_s(self) -> float:
        """Longest that an output waits for an IMU, by stamps of the others."""
        return self._hold * 1e-9

    @property
    def streams(self) -> list[_Stream]:
        """Memory of each IMU, to be read for its counts."""
        return self._streams

    def add(self, imu: int, stamp_ns: int, rate: ArrayLike, force: ArrayLike) -> list[AlignedSample]:
        """Take a sample.

        Parameters
        ----------
        imu : number of the IMU
        stamp_ns : its stamp, by its own clock
        rate, force : (3,), in its axes, rad/s, m/s^2; what is not finite makes its axis not valid

        Returns
        -------
        samples of the array that are now complete, in order
        """
        stream, stamp = self._streams[imu], int(stamp_ns) - self._offset[imu]
        raw = np.concatenate([np.asarray(rate, np.float64), np.asarray(force, np.float64)])
        raw[~np.isfinite(raw)] = np.nan
        stream.received += 1
        step = 0 if stream.last is None else min(max(stamp - stream.last, 0), stream.bridge_ns)
        stream.last = stamp
        for other in self._streams:
            other.alone = other.alone + step if other is stream else 0
        if self._ahead(imu, stamp) or self._behind(stamp):
            if not self._set_aside(imu, stamp, step, raw):
                return []
        else:
            self._accept(imu, stamp, raw)
            self._review()
        return self._give()

    def _ahead(self, imu: int, stamp: int) -> bool:
        others = [s.heard for k, s in enumerate(self._streams) if k != imu and s.heard is not None and not s.silent]
        return bool(others) and stamp > max(others) + self._hold

    def _behind(self, stamp: int) -> bool:
        return self._front is not None and stamp < self._front - self._jump

    def _set_aside(self, imu: int, stamp: int, step: int, raw: Array) -> bool:
        """Keep a sample out of step; True: it is the others that are gone, and what was kept has been taken."""
        stream, behind = self._streams[imu], self._behind(stamp)
        if not behind:
            stream.heard = stamp
            self._drop_behind()  # not all stamps have gone back
        elif stream.aside:
            stream.behind += step
        stream.silent |= behind
        stream.aside.append((stamp, raw))
        if (stream.behind <= self._hold if behind else stream.alone <= self._hold - self._wait) and len(stream.aside) < _MOST_ASIDE:
            return False
        kept = [s.aside for s in self._streams]
        if behind:
            kept = [[one for one in samples if self._behind(one[0])] for samples in kept]
            self._restart()
        for s, samples in zip(self._streams, kept, strict=True):
            s.aside, s.behind, s.silent = [], 0, s.silent or not samples
        self._sort_in(kept)
        return True

    def _drop_behind(self) -> None:
        for stream in self._streams:
            if stream.aside and self._behind(stream.aside[-1][0]):
                for _ in stream.aside:
                    stream.note(Cause.CLOCK)
                stream.aside, stream.behind = [], 0

    def _sort_in(self, kept: list[list[tuple[int, Array]]]) -> None:
        """Take what is in step of what was kept aside."""
        for k, samples in enumerate(kept):
            for stamp, raw in samples:
                if self._ahead(k, stamp) or self._behind(stamp):
                    self._streams[k].note(Cause.CLOCK)
                else:
                    self._accept(k, stamp, raw)

    def _accept(self, imu: int, stamp: int, raw: Array) -> None:
        stream = self._streams[imu]
        if self._front is not None and stamp <= max(stream.done, self._front - self._wait):
            stream.silent = True
            return stream.note(Cause.LATE)
        stream.heard, stream.silent = max(stamp, stamp if stream.heard is None else stream.heard), False
        stream.take(stamp, raw)
        if self._front is None:  # who is ahead may have been the first to be heard
            for k, other in enumerate(self._streams):
                if other.stamps and self._ahead(k, other.stamps[-1]):
                    for _ in other.stamps:
                        other.note(Cause.CLOCK)
                    other.reset()
        self._newest = max((s.stamps[-1] for s in self._streams if s.stamps), default=0)

    def _review(self) -> None:
        """Somebody in step has been heard: what was kept aside is in step with it, or wrong."""
        if not any(stream.aside for stream in self._streams):
            return
        kept = [stream.aside for stream in self._streams]
        for stream in self._streams:
            if stream.aside:
                stream.aside, stream.behind = [], 0
                stream.heard = stream.stamps[-1] if stream.stamps else None
        self._sort_in(kept)

    def _restart(self) -> None:
        for stream in self._streams:
            stream.reset()
        self._front, self._newest = None, 0
        self.restarts += 1

    def _give(self) -> list[AlignedSample]:
        given: list[AlignedSample] = []
        while self._begun():
            begin = self._front or 0
            end = begin + self._period
            if self._newest < end:
                break
            overdue = self._newest >= end + self._hold
            for stream in self._streams:
                if stream.out and stream.back is not None and begin >= stream.back + self._wait:
                    stream.out, stream.back = False, None
            longest = [None if stream.out else stream.longest(begin, end) for stream in self._streams]
            complete = all(s.out or (gap is not None and gap <= s.whole_ns) for s, gap in zip(self._streams, longest, strict=True))
            if not (complete or overdue):
                break
            sample = self._sample(begin, end, longest)
            if sample.gyro_valid or sample.accel_valid:
                given.append(sample)
            else:
                self.empty += 1
            self._front = end
            for stream in self._streams:
                stream.forget(end)
            if not (sample.gyro_valid or sample.accel_valid):
                self._skip()
        return given

    def _begun(self) -> bool:
        """The first interval is known: the first that all have who begin together; none of its samples can still be on the way."""
        if self._front is None:
            stamps = [stream.stamps[0] for stream in self._streams if stream.stamps]
            if stamps and self._newest >= min(stamps) + self._hold:
                early = max(stamp for stamp in stamps if stamp <= min(stamps) + self._hold - self._wait)  # all such have come by now
                self._front = -(-early // self._period) * self._period
        return self._front is not None

    def _skip(self) -> None:
        """Nobody has anything for long: go on where somebody has."""
        front = self._front or 0
        later = [stamp for stream in self._streams for stamp in stream.stamps if stamp > front]
        ahead = (min([*later, self._newest - self._hold]) - self._hold - front) // self._period
        if ahead > 0:
            self.empty += ahead
            self._front = front + ahead * self._period

    def _sample(self, begin: int, end: int, longest: list[int | None]) -> AlignedSample:
        n, stuck = len(self._streams), self.config.stuck_count
        values, valid = np.zeros((n, 6)), np.zeros((n, 6), np.bool_)
        for i, (stream, gap) in enumerate(zip(self._streams, longest, strict=True)):
            if stream.out:
                stream.note(Cause.SILENT)
                continue
            if gap is None or gap > stream.bridge_ns:
                if not any(end < stamp <= end + stream.bridge_ns for stamp in stream.stamps):  # a later one may still be on its way
                    stream.out = True
                    stream.back = min((stamp for stamp in stream.stamps if stamp > end), default=None)
                stream.note(Cause.SILENT if stream.out else Cause.GAP)
                continue
            made = stream.mean(begin, end)
            finite = np.isfinite(made)
            moving = stream.repeats < stuck if stuck else np.ones(6, np.bool_)
            if not finite.all():
                stream.note(Cause.NOT_FINITE)
            elif not moving.all():
                stream.note(Cause.STUCK)
            else:
                stream.used += 1
            valid[i] = finite & moving
            values[i] = np.where(valid[i], made, 0.0)
        bits = [sum(1 << int(k) for k in np.flatnonzero(valid[:, part])) for part in (slice(0, 3), slice(3, 6))]
        sequence = end // self._period & 0xFFFFFFFF
        return AlignedSample(end, sequence, values[:, :3].ravel(), values[:, 3:].ravel(), bits[0], bits[1])
