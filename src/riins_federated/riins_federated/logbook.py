"""What the navigator has to say, in the order of measurement time, and when it is final.

Lives here: `Logbook`: verdicts, epochs and events as they are worked, taken back with the filter, handed out once they are settled.
Does not live here: the journal's bookkeeping (timeline.py), what happens when (navigator.py).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from riins_fdi.health import SUBFILTER_CODE, Change

from .timeline import Journal
from .types import EventKind, InitialState, Judged, NavEvent, NavSolution, Reason, Recall, TakenOut

FOREVER_NS = 2**63 - 1


class Logbook:
    """Results of a navigator over its runs."""

    def __init__(self) -> None:
        self._out: dict[type, list[Any]] = {NavSolution: [], Judged: [], NavEvent: []}
        self._journal = Journal()

    def __len__(self) -> int:
        """Length since the beginning of the run."""
        return len(self._journal)

    def new_run(self) -> None:
        """Forget what is not settled; what has been settled is still handed out."""
        self._journal = Journal()

    def truncate(self, length: int) -> None:
        """Take back what was noted after the log had this length."""
        self._journal.truncate(length)

    def settle(self, until_ns: int = FOREVER_NS) -> None:
        """What is not later than a stamp is final."""
        for entry in self._journal.take(until_ns):
            self._out[type(entry)].append(entry)

    def drain(self, kind: type) -> list[Any]:
        """Final results of a kind since the last call, oldest first."""
        out, self._out[kind] = self._out[kind], []
        return out

    def add(self, stamp_ns: int, result: Judged | NavSolution) -> None:
        """Note a verdict or an epoch."""
        self._journal.add(stamp_ns, result)

    def begun(self, initial: InitialState, again: bool = False) -> None:
        """Note that navigation begins."""
        word = " again" if again else ""
        self._tell(initial.stamp_ns, f"navigation begins{word} from the initial state of {initial.source or 'an unnamed source'}", EventKind.BEGUN)

    def jumped(self, stamp_ns: int, step_ns: int) -> None:
        """Note that the IMU stamp jumped."""
        text = f"IMU stamp jumped by {step_ns * 1e-9:+.3f} s: the run restarts and waits for an initial state"
        self._tell(stamp_ns, text, EventKind.RESTARTED)

    def recalled(self, recall: Recall, done: bool) -> None:
        """Note what was recalled, or that it could not be."""
        angle, velocity = (float(np.linalg.norm(v)) for v in (recall.angle, recall.velocity))
        text = f"{np.degrees(angle) * 60.0:.2f} arcmin and {velocity:.3g} m/s of isolated inertial sensors"
        since = f"since {(recall.stamp_ns - recall.onset_ns) * 1e-9:.1f} s"
        self._tell(recall.stamp_ns, f"recalled {text} {since}" if done else f"not recalled, it began before the run: {text}", EventKind.RECALLED)

    def judged(self, seen: Iterable[tuple[Judged, Change | None]], taken_out: Sequence[TakenOut] = ()) -> None:
        """Note verdicts with the changes of health they brought, and what was taken out: a measurement that went with it was not accepted."""
        gone = {one.name: one for one in taken_out}
        for judged, change in seen:
            out = gone.get(judged.name)
            if out is not None and judged.accepted:
                judged = replace(judged, nis=out.statistic, threshold=out.threshold, accepted=False, reason=Reason.SEPARATION)
            self.add(judged.stamp_ns, judged)
            self.health(judged.name, change)
        for out in taken_out:
            self.taken_out(out)

    def taken_out(self, out: TakenOut) -> None:
        """Note that an aid was found faulty by the separation of solutions, and what it had put in."""
        self.health(out.name, out.change)
        position, velocity, heading = out.reset
        moved = f"{position:.3g} m, {velocity:.3g} m/s, {abs(np.degrees(heading)) * 60.0:.3g} arcmin"
        text = f"{out.name}: what it had put in is taken out, {moved} (separation {out.statistic:.1f}, threshold {out.threshold:.1f})"
        self._journal.add(out.stamp_ns, NavEvent(out.stamp_ns, text, EventKind.TAKEN_OUT, out.name, None, Reason.SEPARATION))

    def health(self, name: str, change: Change | None) -> None:
        """Note a change of health of a subfilter, if there is one."""
        if change is not None:
            reason = f" ({Reason(change.reason).name.lower()})" if change.reason else ""
            text = f"{name}: {change.previous.name.lower()} -> {change.state.name.lower()}{reason}"
            event = NavEvent(change.stamp_ns, text, EventKind.HEALTH, name, SUBFILTER_CODE[change.state], Reason(change.reason))
            self._journal.add(change.stamp_ns, event)

    def _tell(self, stamp_ns: int, text: str, kind: EventKind) -> None:
        self._journal.add(stamp_ns, NavEvent(stamp_ns, text, kind))
