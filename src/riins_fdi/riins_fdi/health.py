"""One health machine for every sensor and every subfilter: healthy, suspect, isolated, probation, and the operator's word.

Lives here: the states, their settings, the machine with hysteresis, hold and probation, and its message codes.
Does not live here: the tests that judge a measurement (parity, innovation), ROS; every time is a measurement stamp in nanoseconds.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Any, NamedTuple

from riins_core.settings import setting

NEVER_NS = 2**63 - 1
"""A stamp that is never reached."""
ALWAYS_NS = -(2**63)
"""A stamp that has always been reached."""


class HealthState(IntEnum):
    """State of a sensor or a subfilter. 0 to 5 are TriadFdi's constants; `SUBFILTER_CODE` has SubfilterStatus', where 4 is ABSENT."""

    HEALTHY = 0
    SUSPECT = 1
    ISOLATED = 2
    PROBATION = 3
    COMPENSATED = 4
    EXCLUDED = 5
    ABSENT = 6


TRIAD_CODE: dict[HealthState, int] = {state: int(state) for state in HealthState if state is not HealthState.ABSENT}
"""State -> constant of TriadFdi. A sensor is never absent: a missing value is a failed test."""

SUBFILTER_CODE: dict[HealthState, int] = {
    HealthState.HEALTHY: 0,
    HealthState.SUSPECT: 1,
    HealthState.ISOLATED: 2,
    HealthState.PROBATION: 3,
    HealthState.ABSENT: 4,
    HealthState.EXCLUDED: 5,
}
"""State -> constant of SubfilterStatus. A subfilter is never compensated."""

IN_USE = frozenset({HealthState.HEALTHY, HealthState.SUSPECT, HealthState.COMPENSATED})
"""States in which what passes its own test is fused."""

REASON_NONE = 0
"""The one reason both messages share."""


@dataclass(frozen=True)
class HealthConfig:
    """When a sensor or subfilter is isolated and when it may return."""

    isolate_count: int = setting(3, "failed tests that isolate; passed ones in between do not erase them until cleared", "", 1, 1_000_000)
    isolate_s: float = setting(0.0, "isolated only when the failed tests also span this long", "s", 0.0, 1e6)
    clear_count: int = setting(3, "passed tests in a row that clear a suspect", "", 1, 1_000_000)
    clear_s: float = setting(0.0, "and that reach at least this long beyond its last failed one", "s", 0.0, 1e6)
    hold_s: float = setting(5.0, "isolated at least this long before probation may begin", "s", 0.0, 1e6)
    hold_after_failure: bool = setting(False, "count the hold from the last failed test instead of from the isolation")
    hold_growth: float = setting(2.0, "each relapse from probation makes the hold this much longer: no flapping", "", 1.0, 100.0)
    hold_max_s: float = setting(600.0, "longest hold, unless hold_s is longer", "s", 0.0, 1e6)
    probation_count: int = setting(1, "passed tests in a row on probation before the return", "", 1, 1_000_000)
    probation_s: float = setting(10.0, "probation lasts at least this long", "s", 0.0, 1e6)


class Change(NamedTuple):
    """A change of state."""

    stamp_ns: int
    previous: HealthState
    state: HealthState
    reason: int
    """code of the reason, in the caller's enumeration"""


class _Memory(NamedTuple):
    """All that a machine remembers; immutable, so that a snapshot is a reference."""

    state: HealthState = HealthState.HEALTHY
    reason: int = REASON_NONE
    since_ns: int = 0
    bad_count: int = 0
    good_count: int = 0
    first_ns: int = 0  # SUSPECT: first failed test; PROBATION: first passed test
    last_bad_ns: int = 0
    relapses: int = 0
    fallback: HealthState = HealthState.HEALTHY  # ABSENT: the state to come back to


class HealthMachine:
    """Health of one sensor or subfilter.

    Parameters
    ----------
    config : when to isolate and when to return
    recovered_reason : code of the reason given to a return that the machine decides

    Notes
    -----
    HEALTHY -> SUSPECT at the first failed test -> ISOLATED after `isolate_count` of them that span `isolate_s` -> PROBATION at the first
    passed test after the hold -> HEALTHY after `probation_count` passed tests in a row that span `probation_s`; a failed one goes back to
    ISOLATED with a longer hold. A suspect's failed tests are forgotten after `clear_count` passed ones in a row that reach `clear_s` beyond
    the last failed one (hysteresis: failures scattered among passes add up).
    EXCLUDED is left by `restore` alone, through PROBATION.
    The machine is pure: the same steps give the same states, and `snapshot`/`restore_snapshot` take it back to any earlier moment.
    """

    __slots__ = ("_config", "_hold_ns", "_m", "_recovered")

    def __init__(self, config: HealthConfig, recovered_reason: int = REASON_NONE) -> None:
        self._config = config
        self._recovered = recovered_reason
        self._m = _Memory()
        self._hold_ns = _ns(config.hold_s)

    @property
    def state(self) -> HealthState:
        """State in force."""
        return self._m.state

    @property
    def reason(self) -> int:
        """Reason of the last change of state."""
        return self._m.reason

    @property
    def since_ns(self) -> int:
        """Stamp of the last change of state; 0 before any."""
        return self._m.since_ns

    @property
    def in_use(self) -> bool:
        """The state is one whose measurements are used."""
        return self._m.state in IN_USE

    @property
    def relapses(self) -> int:
        """Times probation has failed since the last return."""
        return self._m.relapses

    @property
    def hold_ns(self) -> int:
        """Length of the present hold [ns], with the growth of its relapses."""
        config, relapses = self._config, self._m.relapses
        if relapses == 0 or config.hold_growth == 1.0:
            return self._hold_ns
        longest = max(config.hold_s, config.hold_max_s)
        return _ns(min(longest, config.hold_s * config.hold_growth ** min(relapses, 60)))

    def step(self, stamp_ns: int, good: bool, reason: int = REASON_NONE, confirmed: bool = True) -> Change | None:
        """Judge one test.

        Parameters
        ----------
        stamp_ns : stamp of the measurement that was tested, not before the last one
        good : it passed
        reason : why it failed; kept if the state changes
        confirmed : nothing else stands against a return from probation

        Returns
        -------
        the change of state, or None
        """
        m, config = self._m, self._config
        if m.state is HealthState.ABSENT:
            back = self._to(stamp_ns, m.fallback, m.reason if m.fallback in (HealthState.ISOLATED, HealthState.PROBATION) else REASON_NONE)
            return _merge(back, self.step(stamp_ns, good, reason, confirmed))
        if m.state is HealthState.EXCLUDED:
            return None
        if m.state is HealthState.PROBATION:
            return self._probation(stamp_ns, good, reason, confirmed)
        if m.state is HealthState.ISOLATED:
            if not good:
                self._m = m._replace(last_bad_ns=stamp_ns)
                return None
            start = m.last_bad_ns if config.hold_after_failure else m.since_ns
            if stamp_ns - start < self.hold_ns:
                return None
            change = self._to(stamp_ns, HealthState.PROBATION, m.reason, first_ns=stamp_ns, relapses=m.relapses)
            return _merge(change, self._probation(stamp_ns, True, reason, confirmed))
        return self._in_use(stamp_ns, good, reason)

    def absent(self, stamp_ns: int, reason: int = REASON_NONE) -> Change | None:
        """No measurement within the time-out. The next one brings the machine back to where it was (a suspect starts afresh)."""
        m = self._m
        if m.state in (HealthState.ABSENT, HealthState.EXCLUDED):
            return None
        # probation must be unbroken, so it begins again
        fallback = HealthState.ISOLATED if m.state in (HealthState.ISOLATED, HealthState.PROBATION) else HealthState.HEALTHY
        return self._to(stamp_ns, HealthState.ABSENT, reason, fallback=fallback, relapses=m.relapses)

    def exclude(self, stamp_ns: int, reason: int) -> Change | None:
        """Take out of use on the operator's word, until `restore`."""
        if self._m.state is HealthState.EXCLUDED:
            return None
        return self._to(stamp_ns, HealthState.EXCLUDED, reason)

    def restore(self, stamp_ns: int, reason: int) -> Change | None:
        """Let an excluded or isolated one return through probation, at once on trial, without the hold."""
        if self._m.state not in (HealthState.EXCLUDED, HealthState.ISOLATED):
            return None
        return self._to(stamp_ns, HealthState.PROBATION, reason, first_ns=NEVER_NS)

    def compensate(self, stamp_ns: int, reason: int) -> Change | None:
        """What drifts is known and removed: stay in use, watched like any other."""
        m = self._m
        if m.state not in (HealthState.HEALTHY, HealthState.SUSPECT):
            return None
        return self._to(stamp_ns, HealthState.COMPENSATED, reason)

    def recover(self, stamp_ns: int) -> Change | None:
        """The drift that was removed has gone."""
        return self._to(stamp_ns, HealthState.HEALTHY, self._recovered) if self._m.state is HealthState.COMPENSATED else None

    def isolate(self, stamp_ns: int, reason: int) -> Change | None:
        """Take out of use at once, on other grounds than the tests given to `step`; it returns like any other."""
        return self._to(stamp_ns, HealthState.ISOLATED, reason, last_bad_ns=stamp_ns) if self.in_use else None

    def reset(self) -> None:
        """Forget everything but the operator's exclusion."""
        m = self._m
        self._m = _Memory(HealthState.EXCLUDED, m.reason, m.since_ns) if m.state is HealthState.EXCLUDED else _Memory()

    def wakes_at_ns(self) -> tuple[int, int]:
        """Earliest stamps at which a passed and a failed test can change the machine.

        A kernel need not call `step` before: it would do nothing but count. Asks for `probation_count` = 1.
        """
        m, config = self._m, self._config
        if m.state is HealthState.EXCLUDED:
            return NEVER_NS, NEVER_NS
        if m.state is HealthState.ISOLATED:
            if config.hold_after_failure:
                return ALWAYS_NS, ALWAYS_NS
            return m.since_ns + self.hold_ns, NEVER_NS
        if m.state is HealthState.PROBATION:
            return (ALWAYS_NS if m.first_ns == NEVER_NS else m.first_ns + _ns(config.probation_s)), ALWAYS_NS
        if m.state is HealthState.HEALTHY or (m.state is HealthState.COMPENSATED and m.bad_count == 0):
            return NEVER_NS, ALWAYS_NS
        if m.state in (HealthState.SUSPECT, HealthState.COMPENSATED) and config.clear_count == 1:
            return m.last_bad_ns + _ns(config.clear_s), ALWAYS_NS
        return ALWAYS_NS, ALWAYS_NS

    def snapshot(self) -> tuple[object, ...]:
        """All that the machine remembers, immutable."""
        return self._m

    def restore_snapshot(self, snapshot: tuple[object, ...]) -> None:
        """Go back to a `snapshot`."""
        if not isinstance(snapshot, _Memory):
            raise TypeError("not a snapshot of a HealthMachine")
        self._m = snapshot

    def _in_use(self, stamp_ns: int, good: bool, reason: int) -> Change | None:
        m, config = self._m, self._config
        if good:
            if m.bad_count == 0:
                return None
            self._m = m = m._replace(good_count=m.good_count + 1)
            if m.good_count < config.clear_count or stamp_ns - m.last_bad_ns < _ns(config.clear_s):
                return None
            if m.state is HealthState.COMPENSATED:
                self._m = m._replace(bad_count=0, good_count=0)
                return None
            return self._to(stamp_ns, HealthState.HEALTHY, REASON_NONE)
        first = stamp_ns if m.bad_count == 0 else m.first_ns
        self._m = m = m._replace(bad_count=m.bad_count + 1, good_count=0, first_ns=first, last_bad_ns=stamp_ns)
        if m.bad_count >= config.isolate_count and stamp_ns - first >= _ns(config.isolate_s):
            return self._to(stamp_ns, HealthState.ISOLATED, reason, last_bad_ns=stamp_ns)
        if m.state is HealthState.HEALTHY:
            return self._to(stamp_ns, HealthState.SUSPECT, reason, bad_count=m.bad_count, first_ns=first, last_bad_ns=stamp_ns)
        return None

    def _probation(self, stamp_ns: int, good: bool, reason: int, confirmed: bool) -> Change | None:
        m, config = self._m, self._config
        if not good:
            return self._to(stamp_ns, HealthState.ISOLATED, reason, last_bad_ns=stamp_ns, relapses=m.relapses + 1)
        first = stamp_ns if m.first_ns == NEVER_NS else m.first_ns
        self._m = m = m._replace(first_ns=first, good_count=m.good_count + 1)
        if confirmed and m.good_count >= config.probation_count and stamp_ns - first >= _ns(config.probation_s):
            return self._to(stamp_ns, HealthState.HEALTHY, self._recovered)
        return None

    def _to(self, stamp_ns: int, state: HealthState, reason: int, **memory: Any) -> Change:
        change = Change(stamp_ns, self._m.state, state, reason)
        self._m = _Memory(state, reason, stamp_ns)._replace(**memory)
        return change


def _merge(first: Change, second: Change | None) -> Change:
    """Two changes at one stamp, seen from outside as one."""
    return first if second is None else Change(second.stamp_ns, first.previous, second.state, second.reason)


def _ns(seconds: float) -> int:
    return round(seconds * 1e9)
