"""The health machine: transitions, hysteresis, hold, probation, the operator's word, snapshots."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from riins_core.settings import SettingError, build
from riins_fdi.health import (
    IN_USE,
    NEVER_NS,
    SUBFILTER_CODE,
    TRIAD_CODE,
    HealthConfig,
    HealthMachine,
    HealthState,
)

S = 1_000_000_000
BAD, OPERATOR, RECOVERED = 1, 6, 7
CONFIG = HealthConfig(isolate_count=3, clear_count=2, hold_s=5.0, probation_s=4.0, hold_growth=2.0, hold_max_s=15.0)

LEAKY = HealthConfig(isolate_count=3, clear_count=1, clear_s=6.0, hold_s=5.0, probation_s=4.0)


def isolated(config: HealthConfig = CONFIG, at: int = 100) -> HealthMachine:
    machine = HealthMachine(config, RECOVERED)
    for k in range(config.isolate_count):
        machine.step((at - config.isolate_count + 1 + k) * S, False, BAD)
    assert machine.state is HealthState.ISOLATED and machine.since_ns == at * S
    return machine


def test_isolation_after_the_count_with_reason_and_time() -> None:
    machine = HealthMachine(CONFIG)
    assert machine.step(1 * S, True) is None and machine.since_ns == 0
    first = machine.step(2 * S, False, BAD)
    assert first == (2 * S, HealthState.HEALTHY, HealthState.SUSPECT, BAD) and machine.in_use
    assert machine.step(3 * S, False, BAD) is None
    last = machine.step(4 * S, False, BAD)
    assert last == (4 * S, HealthState.SUSPECT, HealthState.ISOLATED, BAD) and not machine.in_use
    assert machine.since_ns == 4 * S and machine.reason == BAD


def test_count_of_one_isolates_at_once() -> None:
    change = HealthMachine(HealthConfig(isolate_count=1)).step(S, False, BAD)
    assert change == (S, HealthState.HEALTHY, HealthState.ISOLATED, BAD)


def test_hysteresis_a_single_good_does_not_clear() -> None:
    machine = HealthMachine(CONFIG)
    for k, good in enumerate([False, True, False, True, False]):  # never two good in a row
        machine.step(k * S, good, BAD)
    assert machine.state is HealthState.ISOLATED
    machine = HealthMachine(CONFIG)
    for k, good in enumerate([False, True, True, False, False]):
        machine.step(k * S, good, BAD)
    assert machine.state is HealthState.SUSPECT


def test_scattered_failures_add_up_until_clear_s_has_passed() -> None:
    told = []
    for failures in ((0, 5, 11), (0, 5, 12)):
        machine = HealthMachine(LEAKY)
        changes = [machine.step(t * S, t not in failures, BAD) for t in range(13)]
        told.append([(c.state.name, c.stamp_ns // S) for c in changes if c])
    assert told[0] == [("SUSPECT", 0), ("ISOLATED", 11)]  # passed tests reach five seconds beyond the second failure
    assert told[1] == [("SUSPECT", 0), ("HEALTHY", 11), ("SUSPECT", 12)]  # six


def test_failed_tests_must_span_isolate_s() -> None:
    machine = HealthMachine(HealthConfig(isolate_count=2, isolate_s=10.0))
    states = [machine.step(t * S, False, BAD) for t in range(10)]
    assert machine.state is HealthState.SUSPECT and sum(c is not None for c in states) == 1
    assert machine.step(10 * S, False, BAD).state is HealthState.ISOLATED


def test_hold_then_probation_then_return() -> None:
    machine = isolated()
    assert machine.step(104 * S, True) is None and machine.state is HealthState.ISOLATED
    assert machine.step(105 * S, True).state is HealthState.PROBATION
    assert machine.step(108 * S, True) is None and not machine.in_use
    back = machine.step(109 * S, True)
    assert back == (109 * S, HealthState.PROBATION, HealthState.HEALTHY, RECOVERED) and machine.in_use


def test_hold_counted_from_the_last_failure() -> None:
    from dataclasses import replace

    machine = isolated(replace(CONFIG, hold_after_failure=True))
    machine.step(104 * S, False, BAD)
    assert machine.step(106 * S, True) is None
    assert machine.step(109 * S, True).state is HealthState.PROBATION


def test_relapse_goes_back_and_holds_longer_up_to_the_maximum() -> None:
    machine, now, holds = isolated(), 100, []
    for _ in range(4):
        holds.append(machine.hold_ns // S)
        assert machine.step((now + holds[-1]) * S - 1, True) is None
        now += holds[-1]
        assert machine.step(now * S, True).state is HealthState.PROBATION
        now += 1
        relapse = machine.step(now * S, False, BAD)
        assert relapse.previous is HealthState.PROBATION and relapse.state is HealthState.ISOLATED
    assert holds == [5, 10, 15, 15]
    now += 15
    machine.step(now * S, True)
    assert machine.step((now + 4) * S, True).state is HealthState.HEALTHY
    assert machine.hold_ns == 5 * S  # a return makes good


def test_probation_without_length_returns_at_the_first_good() -> None:
    machine = isolated(HealthConfig(isolate_count=2, hold_s=0.0, probation_s=0.0))
    change = machine.step(101 * S, True)
    assert change == (101 * S, HealthState.ISOLATED, HealthState.HEALTHY, RECOVERED)


def test_probation_count_in_a_row() -> None:
    machine = isolated(HealthConfig(isolate_count=1, hold_s=0.0, probation_s=0.0, probation_count=3))
    assert [machine.step((101 + k) * S, True) is not None for k in range(3)] == [True, False, True]
    assert machine.state is HealthState.HEALTHY


def test_operator_excludes_and_restores_through_probation() -> None:
    machine = HealthMachine(CONFIG, RECOVERED)
    assert machine.exclude(S, OPERATOR).state is HealthState.EXCLUDED and machine.exclude(2 * S, OPERATOR) is None
    for k in range(3, 50):
        assert machine.step(k * S, True) is None and machine.step(k * S, False, BAD) is None
    machine.reset()
    assert machine.state is HealthState.EXCLUDED and machine.reason == OPERATOR and machine.since_ns == S
    assert machine.restore(50 * S, OPERATOR).state is HealthState.PROBATION and not machine.in_use
    assert machine.step(60 * S, True) is None  # the trial counts from the first test
    assert machine.step(64 * S, True).state is HealthState.HEALTHY
    assert machine.restore(65 * S, OPERATOR) is None


def test_reset_forgets_what_the_machine_itself_decided() -> None:
    machine = isolated()
    machine.reset()
    assert machine.state is HealthState.HEALTHY and machine.since_ns == 0


def test_absence_remembers_the_isolation() -> None:
    machine = HealthMachine(CONFIG)
    assert machine.absent(10 * S).state is HealthState.ABSENT and machine.absent(11 * S) is None and not machine.in_use
    assert machine.step(12 * S, True) == (12 * S, HealthState.ABSENT, HealthState.HEALTHY, 0)
    machine.absent(20 * S)
    assert machine.step(22 * S, False, BAD) == (22 * S, HealthState.ABSENT, HealthState.SUSPECT, BAD)
    machine = isolated()
    machine.absent(110 * S)
    assert machine.step(112 * S, True) == (112 * S, HealthState.ABSENT, HealthState.ISOLATED, 0)  # the hold starts again
    assert machine.step(117 * S, True).state is HealthState.PROBATION


def test_snapshot_takes_the_machine_back() -> None:
    machine = HealthMachine(CONFIG)
    machine.step(S, False, BAD)
    kept = machine.snapshot()
    later = [machine.step(k * S, False, BAD) for k in (2, 3)]
    machine.restore_snapshot(kept)
    assert machine.state is HealthState.SUSPECT
    assert [machine.step(k * S, False, BAD) for k in (2, 3)] == later
    with pytest.raises(TypeError):
        machine.restore_snapshot((1, 2))


def test_codes_of_the_messages() -> None:
    assert TRIAD_CODE[HealthState.COMPENSATED] == 4 and TRIAD_CODE[HealthState.EXCLUDED] == 5
    assert SUBFILTER_CODE[HealthState.ABSENT] == 4 and SUBFILTER_CODE[HealthState.EXCLUDED] == 5
    assert len(TRIAD_CODE) == len(SUBFILTER_CODE) == 6 and len(IN_USE) == 3


def test_settings_are_checked() -> None:
    with pytest.raises(SettingError, match="isolate_count"):
        build(HealthConfig, {"isolate_count": 0})
    with pytest.raises(SettingError, match="probation_s"):
        build(HealthConfig, {"probation": 1.0})


@settings(max_examples=50, deadline=None)
@given(st.lists(st.tuples(st.booleans(), st.integers(0, 4)), max_size=120), st.sampled_from([CONFIG, LEAKY]))
def test_steps_before_the_wake_may_be_left_out(steps: list[tuple[bool, int]], config: HealthConfig) -> None:
    """What a kernel relies on: a step that `wakes_at_ns` rules out changes nothing that can be seen, now or later."""
    every, woken, now = HealthMachine(config, RECOVERED), HealthMachine(config, RECOVERED), 0
    for good, gap in steps:
        now += gap * S
        change = every.step(now, good, BAD)
        wake_good, wake_bad = woken.wakes_at_ns()
        seen = woken.step(now, good, BAD) if now >= (wake_good if good else wake_bad) else None
        assert seen == change
        assert (woken.state, woken.since_ns, woken.reason, woken.hold_ns) == (every.state, every.since_ns, every.reason, every.hold_ns)
    assert every.wakes_at_ns() == woken.wakes_at_ns()


def test_excluded_never_wakes() -> None:
    machine = HealthMachine(CONFIG)
    machine.exclude(S, OPERATOR)
    assert machine.wakes_at_ns() == (NEVER_NS, NEVER_NS)
