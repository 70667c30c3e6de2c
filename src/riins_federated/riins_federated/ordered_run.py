"""What happens when: everything is worked in the order of measurement time, whatever the order of arrival.

Lives here: `OrderedRun`: samples and items in their queues, forward through the filter, back for what is late, from one state to the next.
Does not live here: what a navigator is asked and answers (navigator.py), navigation and filtering (integrated_filter.py), queues (timeline.py).
"""

from __future__ import annotations

import bisect
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from riins_fdi.health import Change

from .alignment_desk import AlignmentDesk
from .config import NavigatorConfig
from .gaps import Gaps
from .integrated_filter import IntegratedFilter
from .logbook import Logbook
from .standstill import Standstill
from .timeline import MONTH_NS, Checkpoint, Due, EventQueue, ImuBuffer, next_due, to_ns
from .types import Aid, Array, InitialState, Judged, Reason, Recall, UseCommand

LOST_BEYOND = 2**31
"""A step of the sequence number beyond this is a number that went back, not a loss."""
RANK_ALIGNED, RANK_INITIAL, RANK_COMMAND, RANK_RECALL = -3000, -2000, -1000, -1
"""At one stamp: what an alignment has found, an initial state, then commands, then what is recalled, then the aids in the order of the subfilters."""


class OrderedRun:
    """A filter that is worked by measurement time; see `Navigator`."""

    def __init__(self, config: NavigatorConfig) -> None:
        self.config = config
        self._filter = IntegratedFilter(config)
        self._rank = {local.name: i for i, local in enumerate(self._filter.subfilters)}
        self._max_delay, self._max_gap = to_ns(config.max_delay_s), to_ns(config.max_gap_s)
        height_s = config.height.period_s if config.height.enabled else 0.0
        self._period = Due(to_ns(config.covariance_period_s), to_ns(height_s), to_ns(config.settle_period_s), to_ns(config.feedback_period_s))
        self._initials: list[InitialState] = []
        self._log = Logbook()
        self._desk = AlignmentDesk(config)
        self._standstill = Standstill(config)
        self._gaps = Gaps()
        self._last_ns: int | None = None
        self._last_sequence: int | None = None
        self.imu_received = self.imu_lost = self.imu_rejected = self.restarts = self.rollbacks = self.commands_refused = 0
        self._clear()

    def _clear(self) -> None:
        self._imu, self._queue = ImuBuffer(), EventQueue()
        self._log.new_run()
        self._checkpoints: list[Checkpoint] = []
        self._due = Due(0, 0, 0, 0)
        self._dropped_samples = 0  # so that indices stay true when the oldest go
        self._sample = 0  # the first not yet worked

    def _is_late(self, stamp_ns: int) -> bool:
        return self._last_ns is not None and self._last_ns - stamp_ns >= self._max_delay

    def _append(
        self, stamp_ns: NDArray[np.int64], sequence: NDArray[np.int64], rate: Array, force: Array, rate_covariance: Array, force_covariance: Array
    ) -> None:
        if len(stamp_ns) == 0:
            return
        if self._last_ns is None:
            self._forget_beyond(int(stamp_ns[0]) + MONTH_NS)
        first = stamp_ns[0] - self._last_ns if self._last_ns is not None else 0  # the first step of a run is counted from the initial state
        dt = np.diff(stamp_ns, prepend=stamp_ns[0] - first) * 1e-9
        gaps = np.diff(sequence, prepend=sequence[0] - 1 if self._last_sequence is None else self._last_sequence)
        self.imu_lost += int(np.where((gaps > 1) & (gaps < LOST_BEYOND), gaps - 1, 0).sum())
        rate, force = np.asarray(rate, np.float64), np.asarray(force, np.float64)
        self._imu.append(self._gaps.fill(stamp_ns, rate, force, rate_covariance, force_covariance, dt))
        if not self._filter.running:
            self._desk.begin(int(stamp_ns[0]), self._queue.waiting())
        self._desk.append(stamp_ns, rate, force, rate_covariance, force_covariance)
        for aid in self._standstill.take(stamp_ns, rate, force, dt):
            self._queue.add(aid.stamp_ns, self._rank[aid.name], aid)
            self._go_back(aid.stamp_ns)
        self._last_ns, self._last_sequence = int(stamp_ns[-1]), int(sequence[-1])

    def _forget_beyond(self, stamp_ns: int) -> None:
        """The first sample of a run says what time it is: what waits for another clock's time is refused now."""
        for _, rank, item in self._queue.cut(stamp_ns):
            if isinstance(item, Aid):
                self._filter.subfilters[rank].late += 1
            else:
                self.commands_refused += 1
        self.commands_refused += self._desk.forget_beyond(stamp_ns)

    def _queue_recalls(self, stamp_ns: NDArray[np.int64], recalls: Sequence[Recall]) -> Sequence[Recall]:
        """Put the recalls that belong to samples just appended into the queue; returns the others."""
        n = 0
        while n < len(recalls) and recalls[n].stamp_ns in stamp_ns:
            self._queue.add(recalls[n].stamp_ns, RANK_RECALL, recalls[n])
            self._desk.add(recalls[n])
            n += 1
        return recalls[n:]

    def _bridges(self, step_ns: int, number: int) -> bool:
        """Whether a sample that comes `step_ns` after the last one ends a gap that the filter goes on over, and not a jump of the clock."""
        self._advance()
        if self._last_sequence is None or not self._filter.running or self._desk.busy or step_ns > self._max_gap:
            return False
        return self._gaps.is_gap(step_ns * 1e-9, number - self._last_sequence - 1)

    def _restart(self, stamp_ns: int, step_ns: int) -> None:
        """The IMU stamp has jumped: settle what was, and wait for an initial state near the new stamp."""
        self._advance()
        self._log.settle()
        waiting = self._queue.waiting()
        self._filter.stop()
        self._clear()
        self._desk.new_run(stamp_ns)
        self._standstill.new_run()
        self._gaps.new_run()
        self._last_ns = self._last_sequence = None
        self.restarts += 1
        for stamp, rank, item in waiting:
            if step_ns > 0 and stamp > stamp_ns - self._max_delay:
                self._queue.add(stamp, rank, item)
            elif isinstance(item, Aid):
                self._filter.subfilters[rank].late += 1
        self._log.jumped(stamp_ns, step_ns)

    def _take_in(self, stamp_ns: int) -> None:
        """Work in a new item of the queue, going back if its time has passed."""
        if self._filter.running:
            self._go_back(stamp_ns)
            self._advance()

    def _go_back(self, stamp_ns: int) -> None:
        """To before a stamp, if it has passed."""
        if stamp_ns <= self._filter.stamp_ns and self._sample > 0:
            while len(self._checkpoints) > 1 and self._checkpoints[-1].stamp_ns >= stamp_ns:
                self._checkpoints.pop()
            self._return_to(self._checkpoints[-1])
            self.rollbacks += 1

    def _return_to(self, point: Checkpoint) -> None:
        self._filter.restore(point.filter)
        self._sample, self._queue.cursor, self._due = point.sample, point.cursor, point.due
        self._log.truncate(point.journal)

    def _advance(self) -> None:
        """Work everything up to the newest sample."""
        self._align()
        if not self._filter.running:
            if not self._begin():
                return
            self._align()  # what was commanded goes on beside it
        imu, queue = self._imu, self._queue
        k = self._sample - self._dropped_samples
        while k < len(imu):
            due = min(self._due.first(), queue.head_ns())
            stop = min(max(int(imu.stamp.searchsorted(due)), k), len(imu) - 1)
            part = slice(k, stop + 1)
            noise = (imu.rate_covariance[part], imu.force_covariance[part], imu.unknown[part])
            self._filter.integrate(imu.rate[part], imu.force[part], imu.dt[part], int(imu.stamp[stop]), *noise)
            k = stop + 1
            self._sample = k + self._dropped_samples
            if imu.stamp[stop] >= due:
                self._work(int(imu.stamp[stop]), stop)
        self._trim()

    def _align(self) -> None:
        """Work the alignments up to where everything is settled; what they find becomes the state from its stamp on."""
        if self._last_ns is None or not self._desk.busy:
            return
        until = self._last_ns - self._max_delay
        given = [] if self._filter.running else self._fitting()
        if given:  # had the samples come one by one, this state would have been begun from at the first sample behind it
            until = min(until, int(self._imu.stamp[np.searchsorted(self._imu.stamp, given[0].stamp_ns, side="right")]) - self._max_delay)
        while (report := self._desk.step(until)) is not None:
            found = report.initial
            assert found is not None
            if self._filter.running:
                self._queue.add(found.stamp_ns + 1, RANK_ALIGNED, found)  # up to the stamp itself all is settled
                self._go_back(found.stamp_ns + 1)
            else:
                self._begin_from(found)

    def _fitting(self) -> list[InitialState]:
        """Initial states that fit the samples at hand."""
        stamps = self._imu.stamp
        return [known for known in self._initials if stamps[0] - self._max_delay <= known.stamp_ns < stamps[-1]] if len(stamps) else []

    def _begin(self) -> bool:
        """Start from the earliest initial state that fits the samples at hand; until there is one, keep `max_delay_s` of them."""
        stamps = self._imu.stamp
        if len(stamps) == 0:
            return False
        fitting = self._fitting()
        if not fitting:
            self._drop_samples(int(np.searchsorted(stamps, stamps[-1] - self._max_delay)))
            self._sample = self._dropped_samples
            return False
        self._desk.stop(fitting[0].stamp_ns, "an initial state was given")
        self._begin_from(fitting[0])
        return True

    def _begin_from(self, initial: InitialState) -> None:
        stamps = self._imu.stamp
        first = int(np.searchsorted(stamps, initial.stamp_ns, side="right"))
        self._imu.dt[first] = (stamps[first] - initial.stamp_ns) * 1e-9
        self._sample = first + self._dropped_samples
        self._filter.start(initial)
        for later in self._initials:
            if later.stamp_ns > initial.stamp_ns:
                self._queue.add(later.stamp_ns, RANK_INITIAL, later)
        while self._queue.head_ns() <= initial.stamp_ns:
            _, rank, item = self._queue.take()
            if isinstance(item, Aid):
                self._filter.subfilters[rank].refuse(Reason.NOT_READY)
            elif isinstance(item, UseCommand):
                self._filter.subfilters[self._rank[item.name]].use(item.stamp_ns, item.use)
        self._due = self._period.after(initial.stamp_ns)
        self._log.begun(initial)
        self._checkpoints = [self._checkpoint(initial.stamp_ns)]

    def _work(self, stamp_ns: int, sample: int) -> None:
        """Do what is due at a sample that has just been integrated."""
        flt, due, period = self._filter, self._due, self._period
        flt.propagate()
        due = due._replace(covariance=stamp_ns + period.covariance)
        corrected = False
        seen: list[tuple[Judged, Change | None]] = []
        while self._queue.head_ns() <= stamp_ns:
            stamp, rank, item = self._queue.take()
            if isinstance(item, Aid) and stamp <= flt.started_ns:
                flt.subfilters[rank].refuse(Reason.NOT_READY)
                continue
            if isinstance(item, Aid):
                seen.append(flt.judge(rank, item))
                corrected |= seen[-1][0].accepted
                continue
            self._log.judged(seen)  # the log is in the order of stamps
            seen = []
            if isinstance(item, UseCommand):
                self._log.health(item.name, flt.subfilters[self._rank[item.name]].use(stamp, item.use))
            elif isinstance(item, Recall):
                self._recall(item)
            else:
                self._start_again(item, sample)
                due = self._due
        if stamp_ns >= due.height:
            flt.fuse_height()
            corrected = True
            due = due._replace(height=next_due(due.height, period.height, stamp_ns))
        taken_out = flt.close()
        corrected |= bool(taken_out)
        self._log.judged(seen, taken_out)
        if (corrected and not period.feedback) or stamp_ns >= due.feedback:
            flt.feed_back(announced=bool(taken_out))
            due = due._replace(feedback=next_due(due.feedback, period.feedback, stamp_ns) if period.feedback else due.feedback)
        elif corrected:
            flt.damp_vertical()
        for local in flt.subfilters:
            self._log.health(local.name, local.watch(stamp_ns, flt.started_ns))
        if stamp_ns >= due.settle:
            self._log.add(stamp_ns, replace(flt.solution(), inertial=flt.inertial()) if period.feedback else flt.solution())
            due = due._replace(settle=next_due(due.settle, period.settle, stamp_ns))
        self._due = due
        margin = self._max_delay + 2 * period.covariance
        if self._last_ns is not None and stamp_ns > self._last_ns - margin and stamp_ns >= self._checkpoints[-1].stamp_ns + period.covariance // 4:
            self._checkpoints.append(self._checkpoint(stamp_ns))

    def _recall(self, recall: Recall) -> None:
        """Take out what declared inertial sensors have put in, if this run integrated all of it."""
        possible = recall.onset_ns >= self._filter.started_ns
        if possible:
            self._filter.recall(recall)
        self._log.recalled(recall, possible)

    def _start_again(self, initial: InitialState, sample: int) -> None:
        """Re-initialise within the sample that has just been integrated, and integrate what is left of it."""
        imu = self._imu
        self._filter.start(initial)
        rest = (int(imu.stamp[sample]) - initial.stamp_ns) * 1e-9
        if rest > 0.0:
            one = slice(sample, sample + 1)
            stamp, noise = int(imu.stamp[sample]), (imu.rate_covariance[one], imu.force_covariance[one], imu.unknown[one])
            self._filter.integrate(imu.rate[one], imu.force[one], np.array([rest]), stamp, *noise)
            self._filter.propagate()
        self._due = self._period.after(initial.stamp_ns)
        self._log.begun(initial, again=True)

    def _checkpoint(self, stamp_ns: int) -> Checkpoint:
        return Checkpoint(stamp_ns, self._sample, self._queue.cursor, len(self._log), self._due, self._filter.snapshot())

    def _trim(self) -> None:
        """Forget what no measurement can bring back."""
        if self._last_ns is None or len(self._checkpoints) < 2:
            return
        horizon = self._last_ns - self._max_delay
        keep = max(bisect.bisect_right(self._checkpoints, horizon, key=lambda point: point.stamp_ns) - 1, 0)
        if keep == 0:
            return
        del self._checkpoints[:keep]
        oldest = self._checkpoints[0]
        self._drop_samples(oldest.sample - self._dropped_samples)
        self._queue.drop(oldest.cursor)

    def _drop_samples(self, n: int) -> None:
        self._imu.drop(n)
        self._dropped_samples += n

    def _drain(self, kind: type) -> list[Any]:
        if self._last_ns is not None:
            self._log.settle(self._last_ns - self._max_delay)
        return self._log.drain(kind)
