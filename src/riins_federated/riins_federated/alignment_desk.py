"""The navigator's alignments: the one it begins with, those that are commanded, one at a time, all by measurement time.

Lives here: `AlignmentDesk`: takes what the navigator takes, and says what has come of it up to a stamp.
Does not live here: an alignment itself (aligner.py), what the navigator does with its result (navigator.py).
"""

from __future__ import annotations

import bisect
from collections import deque
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from .aligner import Aligner
from .alignment_settings import CANCEL, AlignCommand, AlignmentReport, MasterState
from .config import NavigatorConfig
from .timeline import NEVER_NS, Timed
from .types import Aid, Array, Mode, Recall, UseCommand

MASTERS_KEPT = 10_000
"""Newest states of a master, for an alignment that is not known yet."""


class AlignmentDesk:
    """Alignments of one navigator.

    Parameters
    ----------
    config : of the navigator

    Attributes
    ----------
    reports : what has come of them and was not yet taken, settled
    """

    def __init__(self, config: NavigatorConfig) -> None:
        self._config = config
        self._active: Aligner | None = None
        self._waiting: list[Aligner | AlignCommand] = []  # in order of stamp; a command is one to give up
        self._automatic = config.alignment.method != "none"
        self._failed = False
        self._masters: deque[MasterState] = deque(maxlen=MASTERS_KEPT)
        self.reports: list[AlignmentReport] = []

    @property
    def busy(self) -> bool:
        """Whether an alignment is under way or will be."""
        return self._active is not None or bool(self._waiting)

    @property
    def mode(self) -> Mode:
        """Mode of a navigator that has no state."""
        if self._active is not None:
            return Mode.ALIGNMENT
        return Mode.FAILED if self._failed else Mode.WAITING

    @property
    def running(self) -> str:
        """Method of the alignment under way, or ''."""
        return self._active.method if self._active is not None else ""

    def new_run(self, stamp_ns: int | None) -> None:
        """The IMU stamp has jumped to `stamp_ns`: begin anew with it; commands of what is still to come stay."""
        if self._active is not None and stamp_ns is not None:
            self.reports.append(self._active.give_up(self._active.due_ns - 1, "the IMU stamp jumped"))
        self._active, self._failed = None, False
        self._waiting = [one for one in self._waiting if stamp_ns is None or _stamp(one) > stamp_ns]
        self._automatic = self._config.alignment.method != "none"

    def command(self, command: AlignCommand, waiting: Iterable[Timed]) -> None:
        """Put a command in its place."""
        made = command if command.method == CANCEL else self._begun(command, waiting)
        bisect.insort(self._waiting, made, key=_stamp)

    def _begun(self, command: AlignCommand, waiting: Iterable[Timed]) -> Aligner:
        """An alignment, with what was taken before it was known."""
        aligner = Aligner(self._config, command)
        for _, _, item in waiting:
            feed(aligner, item)
        for state in self._masters:
            feed(aligner, state)
        return aligner

    def stamps(self) -> set[int]:
        """Of the commands that wait."""
        return {_stamp(one) for one in self._waiting}

    def begin(self, stamp_ns: int, waiting: Iterable[Timed]) -> None:
        """The first sample of a run ends at this stamp: the automatic alignment begins with it."""
        if self._automatic:
            self._active = self._begun(AlignCommand(stamp_ns - 1, self._config.alignment.method), waiting)
        self._automatic = False

    def forget_beyond(self, stamp_ns: int) -> int:
        """Give up commands that wait for a later stamp; returns how many."""
        far = [one for one in self._waiting if _stamp(one) > stamp_ns]
        self.reports += [one.give_up(_stamp(one), "its stamp is far ahead of the IMU") for one in far if isinstance(one, Aligner)]
        self._waiting = [one for one in self._waiting if _stamp(one) <= stamp_ns]
        return len(far)

    def append(self, stamp_ns: NDArray[np.int64], rate: Array, force: Array, rate_covariance: Array, force_covariance: Array) -> None:
        """Samples of a run."""
        for aligner in self._aligners():
            aligner.data.append(stamp_ns, rate, force, rate_covariance, force_covariance)

    def add(self, item: Aid | UseCommand | Recall | MasterState) -> None:
        """An item that the navigator has taken, or a state of the master."""
        if isinstance(item, MasterState):
            self._masters.append(item)
        for aligner in self._aligners():
            feed(aligner, item)

    def stop(self, stamp_ns: int, why: str) -> None:
        """Give up what is under way."""
        if self._active is not None:
            self.reports.append(self._active.give_up(stamp_ns, why))
            self._active = None

    def step(self, until_ns: int) -> AlignmentReport | None:
        """Work up to a stamp to which everything is settled; stops at a result, which it returns: call it again."""
        while True:
            commanded = _stamp(self._waiting[0]) if self._waiting else NEVER_NS
            due = self._active.due_ns if self._active is not None else NEVER_NS
            if min(commanded, due) > until_ns:
                return None
            if commanded <= due:
                one = self._waiting.pop(0)
                self.stop(commanded, "the operator gave it up" if isinstance(one, AlignCommand) else "another one was commanded")
                self._active, self._failed = (None, False) if isinstance(one, AlignCommand) else (one, False)
                continue
            assert self._active is not None
            report = self._active.second()
            self.reports.append(report)
            if self._active.ended:
                self._active, self._failed = None, report.ended == "failed"
                if report.initial is not None:
                    return report

    def drain(self) -> list[AlignmentReport]:
        """Reports since the last call, oldest first."""
        out, self.reports = self.reports, []
        return out

    def _aligners(self) -> list[Aligner]:
        active = [self._active] if self._active is not None else []
        return active + [one for one in self._waiting if isinstance(one, Aligner)]


def feed(aligner: Aligner, item: object) -> None:
    """Give an item to an alignment."""
    if isinstance(item, Aid):
        aligner.data.add_aid(item)
    elif isinstance(item, UseCommand):
        aligner.data.add_use(item)
    elif isinstance(item, Recall):
        aligner.data.add_recall(item)
    elif isinstance(item, MasterState):
        aligner.data.add_master(item)


def _stamp(one: Aligner | AlignCommand) -> int:
    return one.stamp_ns if isinstance(one, AlignCommand) else one.command.stamp_ns
