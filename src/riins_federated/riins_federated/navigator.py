"""The navigator as others see it: samples, aids and commands in as they come, settled results and the newest state out.

Lives here: `Navigator`: what is taken, what is refused and why, what can be asked.
Does not live here: the order in which things are worked (ordered_run.py), navigation and filtering (integrated_filter.py).
"""

from __future__ import annotations

import bisect
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .aligner import warm_up as warm_up_alignment
from .alignment_settings import AlignCommand, AlignmentReport, MasterState
from .config import NavigatorConfig
from .ordered_run import RANK_COMMAND, RANK_INITIAL, OrderedRun
from .timeline import MONTH_NS, SOON_NS
from .types import Aid, Array, FederatedReport, InitialState, Judged, NavEvent, NavSolution, Reason, Recall, SettledEpoch, UseCommand

MAX_WAITING = 100_000
"""Measurements of one aid that may wait for the IMU to reach their stamp."""


class Navigator(OrderedRun):
    """Federated integrated navigation by measurement time.

    Parameters
    ----------
    config : NavigatorConfig

    Attributes
    ----------
    imu_received, imu_lost, imu_rejected : samples
    commands_refused : of `set_use` and `align`
    restarts : jumps of the IMU stamp by more than `max_delay_s` that were no gap to be bridged
    rollbacks : times a late measurement was worked in

    Notes
    -----
    An aid is judged at the first IMU sample at or after its stamp, against the state interpolated to its stamp. Between aids the error
    covariance moves every `covariance_period_s`. Any cut of the input into blocks gives the same numbers, bit for bit.
    """

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of the states with their units, in the order of the covariance."""
        return self._filter.states.labels

    @property
    def newest_ns(self) -> int | None:
        """Stamp of the newest IMU sample; None before the first of a run."""
        return self._last_ns

    # ---- input ----

    def set_initial_state(self, initial: InitialState) -> str:
        """Start, or start again, from a state that holds from its stamp on.

        Parameters
        ----------
        initial : InitialState

        Returns
        -------
        '' if it was taken, else one sentence why not
        """
        problem = initial.problem()
        if problem:
            return problem
        stamps = [known.stamp_ns for known in self._initials]
        running = self._filter.running
        if initial.stamp_ns in stamps and running and initial.stamp_ns <= self._filter.started_ns:
            return ""  # a latched message heard again
        if initial.stamp_ns in stamps:
            self._initials[stamps.index(initial.stamp_ns)] = initial
        else:
            bisect.insort(self._initials, initial, key=lambda known: known.stamp_ns)
        if running and (initial.stamp_ns <= self._filter.started_ns or self._is_late(initial.stamp_ns)):
            # kept all the same: the IMU stamp may be about to jump back to it, as when a bag loops
            return f"the initial state comes too late: its stamp is before the run, or {self.config.max_delay_s:g} s before the newest IMU sample"
        if problem := self._far(initial.stamp_ns):
            return problem  # kept, as above
        if running:
            self._queue.add(initial.stamp_ns, RANK_INITIAL, initial)
            self._take_in(initial.stamp_ns)
        else:
            self._advance()
        return ""

    def add_aid(self, aid: Aid, newest_ns: int | None = None) -> Reason:
        """Take a measurement, whenever it arrives.

        Parameters
        ----------
        aid : Aid
        newest_ns : the newest IMU sample at its arrival; None: it is not known who came first, as where whole blocks are given

        Returns
        -------
        Reason.NONE if it will be judged, else why it was counted and dropped
        """
        if aid.name not in self._rank:
            return Reason.OPERATOR  # configured off
        local = self._filter.subfilters[self._rank[aid.name]]
        reason = local.defect(aid)
        if reason is Reason.NONE and self._is_late(aid.stamp_ns):
            local.late += 1
            return Reason.LATE
        ahead = newest_ns is not None and aid.stamp_ns - newest_ns > max(SOON_NS, self._max_delay)
        if reason is Reason.NONE and (ahead or self._queue.number(self._rank[aid.name]) >= MAX_WAITING):
            local.late += 1
            return Reason.AHEAD
        if reason is Reason.NONE and not self._queue.add(aid.stamp_ns, self._rank[aid.name], aid):
            reason = Reason.DUPLICATE
        if reason is Reason.NO_FIX:
            local.no_fix += 1
        elif reason is not Reason.NONE:
            local.malformed += 1
        if reason is not Reason.NONE:
            return reason
        self._desk.add(aid)
        self._take_in(aid.stamp_ns)
        return Reason.NONE

    def set_use(self, command: UseCommand) -> str:
        """Exclude or restore a subfilter from a measurement time on; '' or one sentence why not."""
        if command.name not in self._rank:
            return self._refuse(f'there is no subfilter "{command.name}"; there are: {", ".join(self._rank)}')
        if self._is_late(command.stamp_ns):
            return self._refuse(f"the command is more than {self.config.max_delay_s:g} s older than the newest IMU sample")
        if problem := self._far(command.stamp_ns):
            return self._refuse(problem)
        if not self._queue.add(command.stamp_ns, RANK_COMMAND + self._rank[command.name], command):
            return self._refuse("there is a command of this stamp already")
        self._desk.add(command)
        self._take_in(command.stamp_ns)
        return ""

    def align(self, command: AlignCommand) -> str:
        """Align from a measurement time on, while navigating or not, or give up what is under way; '' or one sentence why not."""
        if problem := command.problem() or self._far(command.stamp_ns):
            return self._refuse(problem)
        if self._last_ns is not None and command.stamp_ns <= self._last_ns:
            return self._refuse("the command comes after its stamp: samples behind it have been taken")
        if command.stamp_ns in self._desk.stamps():
            return self._refuse("there is a command of this stamp already")
        self._desk.command(command, self._queue.waiting())
        return ""

    def _far(self, stamp_ns: int) -> str:
        """What is wrong with a stamp of another clock, one sentence, or ''."""
        ahead = stamp_ns - self._last_ns if self._last_ns is not None else 0
        return f"its stamp is {ahead / 86_400e9:.0f} days ahead of the newest IMU sample" if ahead > MONTH_NS else ""

    def _refuse(self, why: str) -> str:
        self.commands_refused += 1
        return why

    def add_master(self, state: MasterState) -> Reason:
        """Take a state of the INS that transfer alignment learns from; it is dropped when it is not valid, not usable, too late or far ahead."""
        reason = state.defect()
        if reason is not Reason.NONE:
            return reason
        if self._is_late(state.stamp_ns):
            return Reason.LATE
        if self._far(state.stamp_ns):
            return Reason.AHEAD
        self._desk.add(state)
        return Reason.NONE

    def add_imu(
        self,
        stamp_ns: NDArray[np.int64],
        sequence: NDArray[Any],
        rate: Array,
        force: Array,
        recalls: Sequence[Recall] = (),
        rate_covariance: Array | None = None,
        force_covariance: Array | None = None,
    ) -> None:
        """Take a block of samples of any length.

        Parameters
        ----------
        stamp_ns : (m,), ends of the averaging intervals, ns
        sequence : (m,), numbers of the source; a gap counts as lost, and is bridged up to `max_gap_s`
        rate, force : (m, 3), mean body rate and specific force over the interval, rad/s, m/s^2, FRD
        recalls : what declared sensors have put in, in order of stamp, one at most for a sample of this block
        rate_covariance, force_covariance : (m, 3, 3), white noise of each sample, (rad/s)^2, (m/s^2)^2, FRD; zero or None: not known
        """
        unknown = np.zeros((len(stamp_ns), 3, 3))
        noise = [unknown if given is None else given for given in (rate_covariance, force_covariance)]
        stamp_ns = np.asarray(stamp_ns, np.int64)
        numbers: NDArray[np.int64] = np.asarray(sequence, np.int64)
        self.imu_received += len(stamp_ns)
        finite: NDArray[np.bool_] = np.isfinite(np.concatenate([rate, force], axis=1)).all(axis=1)
        start, bridged = 0, -1
        while start < len(stamp_ns):
            before = stamp_ns[start] - 1 if self._last_ns is None else self._last_ns
            steps = np.diff(stamp_ns[start:], prepend=before)
            usual = finite[start:] & (steps > 0) & (steps <= self._max_delay)
            usual[0] |= start == bridged
            unusual = np.flatnonzero(~usual)
            stop = start + int(unusual[0]) if len(unusual) else len(stamp_ns)
            part = slice(start, stop)
            self._append(stamp_ns[part], numbers[part], rate[part], force[part], noise[0][part], noise[1][part])
            recalls = self._queue_recalls(stamp_ns[start:stop], recalls)
            if stop == len(stamp_ns):
                break
            step = int(steps[stop - start])
            if not finite[stop] or -self._max_delay <= step <= 0:
                self.imu_rejected += 1
                start = stop + 1
            elif self._bridges(step, int(numbers[stop])):
                start = bridged = stop
            else:
                self._restart(int(stamp_ns[stop]), step)
                start = stop
        self._advance()

    # ---- output ----

    def head(self) -> NavSolution | None:
        """Newest state, provisional for `max_delay_s`; None before the start."""
        return self._filter.solution() if self._filter.running else None

    def drain_settled(self) -> list[SettledEpoch]:
        """States that no measurement can change any more, oldest first."""
        return self._drain(NavSolution)

    def drain_judged(self) -> list[Judged]:
        """Verdicts that no measurement can change any more, oldest first."""
        return self._drain(Judged)

    def drain_events(self) -> list[NavEvent]:
        """What happened, settled, oldest first."""
        return self._drain(NavEvent)

    def drain_alignment(self) -> list[AlignmentReport]:
        """How alignments went on, second by second, settled, oldest first."""
        return self._desk.drain()

    def status(self) -> FederatedReport:
        """State of the subfilters and counts, as of the newest IMU sample."""
        counts = (self.imu_received, self.imu_lost, self.imu_rejected, self.restarts, self.rollbacks)
        mode = self._filter.mode() if self._filter.running else self._desk.mode
        return FederatedReport(self._last_ns or 0, mode, self._filter.reports(), *counts, *self._filter.cross_check)

    def finish(self) -> None:
        """End of the recording: everything is settled."""
        self._log.settle()

    @staticmethod
    def warm_up() -> None:
        """Compile the kernels on a made-up second of motion, so that the first real sample does not wait."""
        warm_up_alignment()
        navigator = Navigator(NavigatorConfig(states=("gyro_markov", "gyro_scale")))  # a scale factor has a kernel more
        zero, sigma = np.zeros(3), np.ones(3)
        navigator.set_initial_state(InitialState(0, 0.7, 0.1, 0.0, zero, zero, sigma, sigma, 0.01 * sigma))
        stamps = np.arange(1, 201) * 10_000_000
        navigator.add_aid(Aid("gps", 1_005_000_000, np.array([0.7, 0.1, 0.0]), np.zeros((3, 3))))
        navigator.add_imu(stamps, np.arange(200), np.zeros((200, 3)), np.tile([0.0, 0.0, -9.8], (200, 1)))
