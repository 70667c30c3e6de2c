"""One subfilter: the aid's measurement model, its innovation test, its health and its counts.

Lives here: `LocalFilter`, which takes the verdict of the tests on a measurement and says whether it may be fused, and why not.
Does not live here: the measurement models (aiding.py), the tests and the fusion (structures.py), the health machine (riins_fdi).
"""

from __future__ import annotations

from typing import Any, NamedTuple

from riins_fdi.health import SUBFILTER_CODE, Change, HealthConfig, HealthMachine, HealthState

from .aiding import AidModel
from .config import Isolation
from .structures import Verdict, Watched
from .types import Aid, Judged, Reason, SubfilterReport


class _Last(NamedTuple):
    """What the last judged measurement was like; immutable, so that a snapshot is a reference."""

    stamp_ns: int = 0
    accepted_ns: int = 0
    statistic: float = 0.0
    threshold: float = 0.0
    reason: Reason = Reason.NONE
    information: tuple[float, float] = (0.0, 0.0)
    accepted: int = 0
    rejected: int = 0
    accepted_before_ns: int = 0


class LocalFilter:
    """Judge of one aid.

    Parameters
    ----------
    model : its measurement model, with the settings of the aid
    isolation : fault test of an aid that has no settings of its own for it

    Attributes
    ----------
    late, malformed, no_fix : counts of what never reached the test; arrival decides them, so they are not rolled back
    """

    def __init__(self, model: AidModel[Any], isolation: Isolation) -> None:
        own = model.settings
        self.name = model.name
        self.model = model
        self.timeout_ns = round(own.timeout_s * 1e9)
        self.late = 0
        self.malformed = 0
        self.no_fix = 0
        self._health = HealthMachine(
            HealthConfig(
                isolate_count=own.isolate_after or isolation.isolate_after,
                clear_count=1,
                hold_s=own.hold_s if own.hold_s >= 0.0 else isolation.hold_s,
                hold_after_failure=True,
                hold_growth=1.0,
                probation_count=own.readmit_after or isolation.readmit_after,
                probation_s=0.0,
            )
        )
        self._last = _Last()

    def defect(self, aid: Aid) -> Reason:
        """Why a measurement cannot be used at all, NONE if it can."""
        return self.model.defect(aid)

    def judge(self, stamp_ns: int, verdict: Verdict, separated: bool) -> tuple[Judged, Change | None]:
        """Step the health machine by a verdict.

        Parameters
        ----------
        stamp_ns : measurement time
        verdict : of the structure's tests
        separated : the structure keeps the aid out

        Returns
        -------
        what is said of the measurement, and the change of health if there was one
        """
        if verdict.alarm and self._health.in_use:
            change = self._health.isolate(stamp_ns, Reason.INNOVATIONS)
        else:
            failed = Reason.INNOVATIONS if verdict.alarm else Reason.NIS
            change = self._health.step(stamp_ns, verdict.passed, failed, confirmed=not separated)
        accepted = verdict.passed and self._health.in_use and not separated
        reason = Reason.NONE
        if not accepted:
            reason = Reason.INNOVATIONS if verdict.alarm else Reason.NIS if not verdict.passed else Reason.SEPARATION if separated else self._held()
        last = self._last
        self._last = _Last(
            stamp_ns,
            stamp_ns if accepted else last.accepted_ns,
            verdict.statistic,
            verdict.threshold,
            reason,
            (float(verdict.information[0]), float(verdict.information[1])) if accepted else (0.0, 0.0),
            last.accepted + accepted,
            last.rejected + (not accepted),
            last.accepted_ns,
        )
        told = verdict.innovation, verdict.sigma, verdict.standardized, verdict.statistic, verdict.threshold
        return Judged(stamp_ns, self.name, *told, accepted, reason, self.model.frame), change

    def take_out(self, stamp_ns: int) -> Change | None:
        """The separation of solutions has found it faulty: what it had put in is out of the master, its measurement of this moment too."""
        last = self._last
        if last.reason is Reason.NONE and last.stamp_ns > 0:
            self._last = last._replace(
                reason=Reason.SEPARATION, accepted=last.accepted - 1, rejected=last.rejected + 1, accepted_ns=last.accepted_before_ns
            )
        return self._health.isolate(stamp_ns, Reason.SEPARATION)

    def watch(self, stamp_ns: int, started_ns: int) -> Change | None:
        """Declare the aid absent when its time-out has passed, by IMU time."""
        if stamp_ns - max(self._last.stamp_ns, started_ns) > self.timeout_ns:
            return self._health.absent(stamp_ns)
        return None

    def use(self, stamp_ns: int, use: bool) -> Change | None:
        """The operator's word."""
        return self._health.restore(stamp_ns, Reason.NONE) if use else self._health.exclude(stamp_ns, Reason.OPERATOR)

    def restart(self) -> None:
        """Forget what was judged before a restart of the run; counts and the operator's exclusion stay."""
        self._health.reset()
        self._last = self._last._replace(stamp_ns=0, accepted_ns=0, statistic=0.0, reason=Reason.NONE, information=(0.0, 0.0))

    def refuse(self, reason: Reason) -> None:
        """Count a measurement that was not judged."""
        self._last = self._last._replace(reason=reason, rejected=self._last.rejected + 1)

    def fusing(self, stamp_ns: int) -> bool:
        """It is in use, and a measurement of it has been fused within its time-out."""
        return self._health.in_use and self._last.accepted_ns > 0 and stamp_ns - self._last.accepted_ns <= self.timeout_ns

    def snapshot(self) -> tuple[object, _Last]:
        """All that roll-back needs."""
        return self._health.snapshot(), self._last

    def restore(self, snapshot: tuple[object, _Last]) -> None:
        """Go back to a snapshot."""
        self._health.restore_snapshot(snapshot[0])  # type: ignore[arg-type]
        self._last = snapshot[1]

    def report(self, beta: float, watched: Watched) -> SubfilterReport:
        """State and counts, for the status message."""
        last = self._last
        return SubfilterReport(
            self.name,
            SUBFILTER_CODE[self._health.state],
            last.reason,
            last.stamp_ns,
            self._health.since_ns,
            last.statistic,
            last.threshold,
            beta,
            last.information,
            last.accepted,
            last.rejected,
            self.late,
            self.malformed,
            self.no_fix,
            *watched,
        )

    def _held(self) -> Reason:
        return Reason.OPERATOR if self._health.state is HealthState.EXCLUDED else Reason.HOLD
