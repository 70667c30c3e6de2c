"""The structures in the navigator: separation isolates and takes out, masters that never saw an aid, every structure by every order of arrival."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fed_voyage import Voyage, config, run, voyage
from hypothesis import given, settings
from hypothesis import strategies as st
from test_fed_navigator import errors, same

from riins_core.settings import SettingError
from riins_fdi.health import SUBFILTER_CODE, HealthState
from riins_federated import integrated_filter
from riins_federated.assembly import make_structure
from riins_federated.navigator import Navigator
from riins_federated.separated_masters import SeparatedMasters
from riins_federated.types import Aid, EventKind, Reason, UseCommand

SECOND = 1_000_000_000
ONSET, END = 15.0, 35.0
AIDS = ("gps", "bds", "doppler")
SOON = {"separation": {"readmit_after": 5}}


@pytest.fixture(scope="module")
def v() -> Voyage:
    return voyage(start_ns=1_700_000_000 * SECOND)


@pytest.fixture(scope="module")
def clean(v: Voyage) -> list:
    return run(v, Navigator(config())).drain_settled()


def seconds(v: Voyage, stamp_ns: int) -> float:
    return (stamp_ns - v.initial.stamp_ns) / SECOND


def spoilt(v: Voyage, slope: float, name: str = "gps", step: float = 0.0) -> list[Aid]:
    """Aids with one that drifts to the north (or forward), m/s (m/s^2), from ONSET to END."""
    out = []
    for aid in v.aids:
        t = seconds(v, aid.stamp_ns)
        size = (step + slope * (t - ONSET)) * (aid.name == name and ONSET <= t < END) / (1.0 if name == "doppler" else 6.37e6)
        out.append(replace(aid, z=aid.z + np.array([size, 0.0, 0.0])))
    return out


def test_a_slow_ramp_is_isolated_taken_out_announced_and_taken_in_again(v: Voyage, clean: list) -> None:
    """Law 4: the deviation from the fault-free run is that of a run which never had the aid."""
    navigator = run(v, Navigator(config(**SOON)), aids=spoilt(v, 0.5))
    settled, judged = navigator.drain_settled(), [j for j in navigator.drain_judged() if j.name == "gps"]
    events = navigator.drain_events()
    found = next(e for e in events if e.state == SUBFILTER_CODE[HealthState.ISOLATED])
    assert (found.target, found.reason, found.kind) == ("gps", Reason.SEPARATION, EventKind.HEALTH)
    at = seconds(v, found.stamp_ns)
    assert ONSET + 2.0 < at < ONSET + 16.0
    out = [e for e in events if e.kind is EventKind.TAKEN_OUT]
    assert len(out) == 1 and out[0].target == "gps" and out[0].stamp_ns == found.stamp_ns
    verdict = next(j for j in judged if j.stamp_ns == found.stamp_ns)  # it went with the rest
    assert not verdict.accepted and verdict.reason is Reason.SEPARATION and verdict.nis > verdict.threshold
    assert not any(j.accepted for j in judged if at <= seconds(v, j.stamp_ns) < END)
    assert judged[-1].accepted and events[-1].text == "gps: probation -> healthy"
    before, after = settled[round(at) - 2], settled[round(at) - 1]
    assert after.reset_count == before.reset_count + 1 and after.reset[0] > 1.0
    without = run(v, Navigator(config()), aids=[a for a in v.aids if a.name != "gps" or seconds(v, a.stamp_ns) > 60.0]).drain_settled()
    apart = np.linalg.norm(errors(v, settled) - errors(v, without), axis=1)
    assert apart[round(at) - 1 : int(END) - 1].max() < 0.02  # no trace of the aid, but for another linearization
    counts = navigator.status().subfilters[0]
    assert counts.accepted == sum(j.accepted for j in judged) and counts.accepted + counts.rejected == len(judged)


@pytest.mark.parametrize("name", AIDS)
def test_a_leave_one_out_master_never_sees_its_aid(v: Voyage, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Bit for bit, on all that a navigator does with its structure, until another aid is rejected; once it is isolated leave-two-out goes on."""
    calls: list[tuple[str, tuple]] = []
    made: list[SeparatedMasters] = []
    original = integrated_filter.make_structure

    def noting(word, method):
        def call(*given):
            calls.append((word, tuple(np.copy(g) if isinstance(g, np.ndarray) else g for g in given)))
            return method(*given)

        return call

    def watched(*args):
        structure = original(*args)
        made.append((structure, structure.clone()))
        calls.clear()
        for word in ("predict", "judge", "add", "close", "shift"):
            setattr(structure, word, noting(word, getattr(structure, word)))
        return structure

    monkeypatch.setattr(integrated_filter, "make_structure", watched)
    aids = spoilt(v, 0.02 if name == "doppler" else 1.0, name)
    run(v, Navigator(config()), aids=aids)
    start = made[-1][1]
    index, whole, without = AIDS.index(name), start.clone(), start.clone()
    others = [i for i in range(3) if i != index]
    compared, alone = 0, start.clone()  # alone: with one aid only, the last
    for word, given_ in calls:
        for structure, left in ((whole, ()), (without, (index,)), (alone, (index, others[0]))):
            if word != "judge":
                getattr(structure, word)(*given_)
            elif given_[0] not in left:
                verdict = structure.judge(*given_)
                structure.take(given_[0], verdict)
                if structure is whole and given_[0] != index and not verdict.passed:
                    assert compared > 60
                    return
        np.testing.assert_array_equal(whole.without(index).x, without.x)
        np.testing.assert_array_equal(whole.without(index).P, without.P)
        if whole.isolated[index]:
            np.testing.assert_array_equal(whole.without(others[0]).P, alone.P)
        compared += 1
    assert whole.isolated[index] or name == "doppler"


@pytest.mark.parametrize("kind", ["fixed", "trace", "innovation"])
def test_fusion_reset_equals_the_information_form_for_any_shares(v: Voyage, kind: str) -> None:
    """Target 29 through the navigator."""
    short = replace(v, stamp=v.stamp[:3000], sequence=v.sequence[:3000], rate=v.rate[:3000], force=v.force[:3000])
    sharing = {"kind": kind, "shares": [0.15, 0.5, 0.05] if kind == "fixed" else []}
    gate = {"false_alarm_probability": 1e-15}
    one = run(short, Navigator(config(structure="information", isolation=gate))).drain_settled()
    other = run(short, Navigator(config(structure="fusion_reset", isolation=gate, sharing=sharing))).drain_settled()
    assert np.abs(errors(v, one) - errors(v, other)).max() < 1e-3
    assert np.degrees(max(abs(a.rph[2] - b.rph[2]) for a, b in zip(one, other, strict=True))) * 60.0 < 1e-4


def test_shares_that_leave_nothing_for_the_height_are_refused() -> None:
    with pytest.raises(SettingError, match="known height"):
        Navigator(config(structure="no_reset", sharing={"kind": "fixed", "shares": [0.5, 0.3, 0.2]}))


def test_gates_from_a_mean_time_between_false_alarms() -> None:
    """An aid's own word before that of section isolation, hours by its own period."""
    made = config(
        gps={"mean_time_between_false_alarms_h": 100.0}, bds={"false_alarm_probability": 1e-3}, isolation={"mean_time_between_false_alarms_h": 10.0}
    )
    gates = make_structure(made, np.eye(20), list(made.aid.values())).gates
    assert [gate.pfa for gate in gates] == pytest.approx([1.0 / 360_000.0, 1e-3, 0.5 / 36_000.0])
    assert {gate.pfa for gate in make_structure(config(), np.eye(20), list(made.aid.values())[2:]).gates} == {1e-5}
    with pytest.raises(SettingError, match='"gps" has a false-alarm probability and a mean time'):
        config(gps={"mean_time_between_false_alarms_h": 100.0, "false_alarm_probability": 1e-3})


TRUSTING_LITTLE = {"adaptive_noise": True, "further_test": "windowed_glr", "further_test_interval_h": 10.0}


@pytest.mark.parametrize("structure", ["separated", "no_reset", "partial"])
@settings(max_examples=3, deadline=None)
@given(seed=st.integers(0, 2**31))
def test_arrival_order_does_not_matter_to_any_structure(v: Voyage, structure: str, seed: int) -> None:
    """Law 1 and law 3 with a fault, adaptive noise and a further test: all of it goes back with the filter."""
    made = config(structure=structure, gps=TRUSTING_LITTLE, bds=TRUSTING_LITTLE, **SOON)
    aids = spoilt(v, 0.5)
    whole = run(v, Navigator(made), aids=aids)
    rng = np.random.default_rng(seed)
    waiting = sorted((aid.stamp_ns + int(rng.uniform(0, 1.9) * SECOND), i) for i, aid in enumerate(aids))
    navigator, start = Navigator(made), 0
    navigator.set_initial_state(v.initial)
    settled, judged, events = [], [], []
    while start < len(v.stamp):
        stop = min(start + int(rng.choice([1, 13, 60])), len(v.stamp))
        while waiting and waiting[0][0] <= v.stamp[stop - 1]:
            assert navigator.add_aid(aids[waiting.pop(0)[1]]) is Reason.NONE
        part = slice(start, stop)
        navigator.add_imu(v.stamp[part], v.sequence[part], v.rate[part], v.force[part])
        settled += navigator.drain_settled()
        judged += navigator.drain_judged()
        events += navigator.drain_events()
        start = stop
    for _, i in waiting:
        navigator.add_aid(aids[i])
    navigator.finish()
    same(settled + navigator.drain_settled(), whole.drain_settled())
    judged += navigator.drain_judged()
    assert [(j.stamp_ns, j.name, j.nis, j.accepted, j.reason) for j in judged] == [
        (j.stamp_ns, j.name, j.nis, j.accepted, j.reason) for j in whole.drain_judged()
    ]
    assert [e.text for e in events + navigator.drain_events()] == [e.text for e in whole.drain_events()]
    assert navigator.status().subfilters == whole.status().subfilters and navigator.rollbacks > 0


def test_the_further_test_isolates_through_the_health_machine(v: Voyage) -> None:
    """A step of two sigma of BDS passes the innovation test of one epoch again and again."""
    made = config(bds={"further_test": "windowed_glr", "further_test_interval_h": 100.0}, structure="information")
    events = run(v, Navigator(made), aids=spoilt(v, 0.0, "bds", step=8.0)).drain_events()
    found = [e for e in events if e.reason is Reason.INNOVATIONS]
    assert found[0].target == "bds" and ONSET < seconds(v, found[0].stamp_ns) < END
    assert found[0].text.endswith("isolated (innovations)")


def test_protection_levels_hold_and_are_honest_with_one_aid(v: Voyage, clean: list) -> None:
    error = np.linalg.norm(errors(v, clean), axis=1)
    assert all(e < s.protection_radius for e, s in zip(error, clean, strict=True))
    own = [np.sqrt(-2.0 * np.log(1e-5) * np.linalg.eigvalsh(s.P[:2, :2])[-1]) for s in clean]
    assert all(1.2 * one < s.protection_radius for one, s in zip(own[10:], clean[10:], strict=True))  # a fault of one aid is in it
    truth = v.trajectory.truth(np.array([seconds(v, s.stamp_ns) for s in clean])).C_nb
    heading = np.abs([(s.rph[2] - np.arctan2(C[1, 0], C[0, 0]) + np.pi) % (2.0 * np.pi) - np.pi for s, C in zip(clean, truth, strict=True)])
    assert all(h < s.protection_heading for h, s in zip(heading, clean, strict=True))
    alone = run(v, Navigator(config(bds={"enabled": False}, doppler={"enabled": False}))).drain_settled()
    inertial = run(v, Navigator(config(height={"period_s": 1.0})), aids=[]).drain_settled()
    assert alone[-1].P[0, 0] < 0.1 * inertial[-1].P[0, 0]
    assert alone[-1].protection_radius > inertial[-1].protection_radius > 5.0 * clean[-1].protection_radius


def test_the_receivers_are_checked_against_each_other(v: Voyage) -> None:
    quiet, loud = run(v, Navigator(config())).status(), None
    assert 0.0 < quiet.cross_check < quiet.cross_check_threshold == pytest.approx(-2.0 * np.log(1e-5))
    aids = [a for a in spoilt(v, 0.0, step=60.0) if seconds(v, a.stamp_ns) < END]
    loud = run(v, Navigator(config()), aids=aids).status()
    assert loud.cross_check > loud.cross_check_threshold
    assert run(v, Navigator(config(bds={"enabled": False}))).status().cross_check_threshold == 0.0


def test_what_an_excluded_aid_had_put_in_stays_and_is_watched(v: Voyage) -> None:
    """The operator's word is about what comes; what was fused before goes only if it is found faulty."""
    good, bad = Navigator(config()), Navigator(config())
    at = v.initial.stamp_ns + round(24.5 * SECOND)
    for navigator in (good, bad):
        assert navigator.set_use(UseCommand("gps", False, at)) == ""
    run(v, good)
    assert not any(e.kind is EventKind.TAKEN_OUT for e in good.drain_events()) and good.status().subfilters[0].separation_threshold > 0.0
    run(v, bad, aids=spoilt(v, 0.7))
    out = [e for e in bad.drain_events() if e.kind is EventKind.TAKEN_OUT]
    assert [e.target for e in out] == ["gps"]
    assert bad.status().subfilters[0].state == SUBFILTER_CODE[HealthState.EXCLUDED]
