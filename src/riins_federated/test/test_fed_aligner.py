"""The navigator aligns itself: every method ends in a state that fits its covariance, every bad case in a failure, and the four laws hold."""

from __future__ import annotations

import functools
import re
from dataclasses import replace

import numpy as np
import pytest
from fed_alignment import SECOND, START, Ship, config, feed, ship
from test_fed_navigator import same

from riins_core.alignment.result import attitude_error
from riins_core.rotation import dcm_from_euler, euler_from_dcm
from riins_core.sensor_errors import DEG, DEG_PER_H
from riins_core.settings import SettingError
from riins_federated.alignment_settings import AlignCommand, AlignmentReport, MasterState, Phase
from riins_federated.alignment_settle import FULL, SettleWatch
from riins_federated.navigator import Navigator
from riins_federated.types import Aid, InitialState, Mode, Reason, Recall, UseCommand, Validity

WAVES = {"duration": 190.0, "stay": 1000.0, "rate": 25}
REST = {"duration": 70.0, "stay": 1000.0, "rate": 25, "waves": 0.0}
WAY = {"duration": 250.0, "speed": 8.0, "turn": True, "stay": 60.0, "rate": 25}


def scaled(s: Ship, initial: InitialState) -> np.ndarray:
    """Errors of attitude and velocity over their sigmas, (6,)."""
    truth = s.truth(initial.stamp_ns)
    phi = attitude_error(dcm_from_euler(*initial.rph), truth.C_nb[0])
    return np.concatenate([phi, initial.v_n - truth.v_n[0]]) / np.concatenate([initial.sigma_attitude, initial.sigma_velocity])


@functools.cache
def run(how: tuple, **alignment: object) -> tuple[Navigator, list[AlignmentReport], list]:
    """A navigator that has been through a voyage."""
    navigator = feed(Navigator(config(alignment)), ship(**dict(how)))
    return navigator, navigator.drain_alignment(), navigator.drain_settled()


def voyage(how: dict) -> tuple:
    return tuple(how.items())


GOOD = [
    ("auto", REST, {"method": "auto", "data_s": 60.0}, "stationary"),
    ("auto", WAVES, {"method": "auto", "data_s": 180.0}, "swaying"),
    ("auto", WAY, {"method": "auto", "data_s": 240.0}, "in_motion"),
    ("redundant", REST, {"method": "redundant"}, "redundant"),
    ("hot_start", REST, {"method": "hot_start", "heading": (60.05, 0.1)}, "hot_start"),
    ("known_heading", WAVES, {"method": "known_heading", "heading": (60.2, 0.2), "turned_deg": 0.2}, "known_heading"),
    ("known_heading", WAY, {"method": "known_heading", "heading": (60.2, 0.2)}, "known_heading"),
]


@pytest.mark.parametrize(("name", "how", "alignment", "method"), GOOD, ids=[f"{g[0]}-{g[3]}" for g in GOOD])
def test_a_method_ends_in_a_state_that_fits_its_covariance(name: str, how: dict, alignment: dict, method: str) -> None:
    navigator, reports, settled = run(voyage(how), **alignment)
    s, last = ship(**how), reports[-1]
    assert last.ended == "aligned" and last.method == method and last.initial is not None
    assert np.abs(scaled(s, last.initial)).max() < 4.0
    phases = [r.phase for r in reports]
    assert phases == sorted(phases) and phases[0] in (Phase.STANDBY, Phase.COARSE) and phases[-1] is Phase.NAVIGATING
    assert settled and navigator.status().mode is Mode.NAVIGATING
    truth = s.truth(settled[-1].stamp_ns)
    assert abs(attitude_error(settled[-1].C_nb, truth.C_nb[0])[2]) < 4.0 * np.sqrt(settled[-1].P[8, 8])
    assert settled[0].stamp_ns > last.stamp_ns - SECOND // 10  # nothing is given out before
    statuses = SettleWatch(navigator.config).take(reports, settled)
    assert statuses[-1].code == FULL and statuses[-1].settle_s == pytest.approx(last.elapsed_s + 1.0, abs=0.1)


def moored_at(latitude: float, **more: object) -> dict:
    return {"method": "swaying", "data_s": 120.0, "position": (latitude, 120.0, 5.0), **more}


def without_position(aids: list[Aid]) -> list[Aid]:
    return [a for a in aids if a.name == "doppler"]


BAD = [
    (WAVES, {"method": "stationary"}, None, "the base moves"),
    (WAVES, {"method": "redundant"}, None, "the base moves"),
    (WAVES, moored_at(86.0), None, "beyond 85 deg"),
    (WAVES, moored_at(42.0), None, "wrong latitude or longitude"),
    (WAVES, moored_at(46.0), without_position, "wrong latitude"),
    (REST, {"method": "stationary", "data_s": 60.0, "position": (45.0, 120.0, 5.0)}, without_position, "wrong latitude"),
    (WAY, {"method": "swaying", "data_s": 120.0}, None, "under way"),
    (REST, {"method": "in_motion", "time_limit_s": 60.0}, lambda aids: [a for a in aids if a.name != "doppler"], "no velocity"),
    (REST, {"method": "auto", "time_limit_s": 40.0}, without_position, "no position"),
    (REST, {"method": "hot_start", "heading": (240.0, 0.1)}, None, "she was turned"),
    (REST, {"method": "hot_start", "time_limit_s": 40.0}, None, "no heading is known"),
    (WAVES, {"method": "known_heading", "heading": (240.0, 0.2)}, None, "she was turned"),
    (WAY, {"method": "known_heading", "heading": (150.0, 0.2)}, None, "do not fit|off the known|bias"),
    (REST, {"method": "transfer", "time_limit_s": 40.0}, None, "no state of the master"),
]


@pytest.mark.parametrize(("how", "alignment", "which", "why"), BAD, ids=[f"{b[1]['method']}: {b[3]}" for b in BAD])
def test_a_bad_case_ends_in_a_failure_and_in_no_heading(how: dict, alignment: dict, which, why: str) -> None:
    s = ship(**how)
    navigator = feed(Navigator(config(alignment)), s, which(s.aids) if which else None)
    reports = navigator.drain_alignment()
    assert reports[-1].ended == "failed" and reports[-1].phase is Phase.FAILED and re.search(why, reports[-1].text)
    assert np.isnan(reports[-1].rph).all() and navigator.head() is None and not navigator.drain_settled()
    assert navigator.status().mode is Mode.FAILED


def test_no_motion_for_poor_gyros_gives_no_heading() -> None:
    """What decides is the covariance: a good IMU needs no motion."""
    s = ship(**REST)
    poor = config({"method": "in_motion", "data_s": 40.0, "time_limit_s": 60.0})
    poor = replace(poor, inertial=replace(poor.inertial, gyro_bias_deg_h=10.0, gyro_arw_deg_sqrt_h=0.3))
    reports = feed(Navigator(poor), s).drain_alignment()
    assert reports[-1].ended == "failed" and "no heading within 60 s: the data do not give the heading" in reports[-1].text


def test_settings_that_cannot_be() -> None:
    for bad, words in (({"position": (1.0,)}, "latitude, longitude, height"),
                       ({"position": (200.0, 0.0, 0.0)}, "latitude in -90"),
                       ({"heading": (1.0, 0.0)}, "not 0"),
                       ({"heading": (4000.0, 1.0)}, "-360 .. 360"),
                       ({"heading": (1.0, 1e9)}, "0 .. 90")):  # fmt: skip
        with pytest.raises(SettingError, match=words):
            config(bad)
    navigator = Navigator(config({}))
    assert "no method" in navigator.align(AlignCommand(1, "magic")) and "finite" in navigator.align(AlignCommand(1, "auto", np.nan))


ALIGN = {"method": "auto", "data_s": 120.0}


def equal(a: list[AlignmentReport], b: list[AlignmentReport]) -> None:
    assert len(a) == len(b) > 100
    for x, y in zip(a, b, strict=True):
        assert (x.stamp_ns, x.phase, x.method, x.text, x.ended) == (y.stamp_ns, y.phase, y.method, y.text, y.ended)
        for name in ("rph", "sigma", "place"):
            assert np.array_equal(getattr(x, name), getattr(y, name), equal_nan=True), name


@pytest.mark.parametrize("cuts", ["one by one", "at random"])
def test_blocks_do_not_matter(cuts: str) -> None:
    s, (_, reports, settled) = ship(**WAVES), run(voyage(WAVES), **ALIGN)
    m = len(s.stamp)
    where = range(1, m) if cuts == "one by one" else np.unique(np.random.default_rng(5).integers(1, m, 40))
    other = feed(Navigator(config(ALIGN)), s, cuts=tuple(where))
    equal(other.drain_alignment(), reports)
    same(other.drain_settled(), settled)


def test_arrival_order_does_not_matter_within_max_delay() -> None:
    s, (_, reports, settled) = ship(**WAVES), run(voyage(WAVES), **ALIGN)
    rng = np.random.default_rng(6)
    arrivals = sorted((aid.stamp_ns + int(rng.uniform(0.0, 1.9) * SECOND), i) for i, aid in enumerate(s.aids))
    navigator, start = Navigator(config(ALIGN)), 0
    while start < len(s.stamp):
        part = slice(start, start + int(rng.choice([1, 5, 20])))
        start = part.stop
        while arrivals and arrivals[0][0] <= s.stamp[part][-1]:
            assert navigator.add_aid(s.aids[arrivals.pop(0)[1]]) is Reason.NONE
        navigator.add_imu(s.stamp[part], s.sequence[part], s.rate[part], s.force[part])
    for _, i in arrivals:
        navigator.add_aid(s.aids[i])
    navigator.finish()
    equal(navigator.drain_alignment(), reports)
    same(navigator.drain_settled(), settled)


def test_what_an_isolated_gyro_put_in_is_taken_out() -> None:
    """Law 4: a gyro drifts for 20 s of the alignment, is declared, and what it had put into angle and velocity is recalled."""
    s, (_, clean, _) = ship(**WAVES), run(voyage(WAVES), **ALIGN)
    first, stop = 60 * 25, 80 * 25
    ramp = np.linspace(0.0, 60.0 * DEG_PER_H, stop - first)
    rate = s.rate.copy()
    rate[first:stop, 1] += ramp
    # what an integration of it gains, in the body at the end
    truth = s.trajectory.truth((s.stamp[first:stop] - START) * 1e-9)
    C_end = truth.C_nb[-1]
    angles = np.cumsum(np.einsum("kij,k->ki", truth.C_nb[:, :, 1:2].reshape(-1, 3, 1), ramp) / 25.0, axis=0)
    velocity = np.sum(np.cross(angles, np.einsum("kij,kj->ki", truth.C_nb, s.force[first:stop])), axis=0) / 25.0
    recall = Recall(int(s.stamp[stop]), int(s.stamp[first - 1]), C_end.T @ angles[-1], C_end.T @ velocity)

    def aligned(*recalls: Recall) -> InitialState | None:
        sick = Ship.__new__(Ship)
        sick.__dict__.update(s.__dict__, rate=rate)
        navigator = feed(Navigator(config(ALIGN)), sick, recalls=recalls)
        reports = navigator.drain_alignment()
        assert not recalls or any("taken out of the stored data" in r.text for r in reports)
        return reports[-1].initial

    well, spoilt, good = aligned(recall), aligned(), clean[-1].initial
    assert well is not None and good is not None
    moved = attitude_error(dcm_from_euler(*well.rph), dcm_from_euler(*good.rph)) / good.sigma_attitude
    assert np.abs(moved).max() < 0.5
    assert spoilt is None or np.abs(scaled(s, spoilt)[:3]).max() > 4.0  # and it would have mattered


def test_a_fault_older_than_the_alignment_leaves_nothing_behind() -> None:
    """Its data up to the declaration are not used, and it takes so much longer."""
    s = ship(**WAVES)
    navigator = Navigator(config({"data_s": 120.0}, validity={"heading_deg": 3.0, "heading_invalid_deg": 5.0}))
    navigator.set_initial_state(given(s))
    assert not navigator.align(AlignCommand(START + 10 * SECOND + 1, "swaying"))
    recall = Recall(int(s.stamp[40 * 25]), START + 5 * SECOND, np.full(3, 1e-3), np.full(3, 0.1))
    sick = Ship.__new__(Ship)
    sick.__dict__.update(s.__dict__, rate=s.rate + 1e-3 * (s.stamp < s.stamp[40 * 25])[:, None])
    reports = feed(navigator, sick, recalls=[recall]).drain_alignment()
    assert any("the data so far are not used" in r.text for r in reports)
    last = reports[-1]
    assert last.ended == "aligned" and last.elapsed_s == pytest.approx(150.0, abs=1.5) and last.initial is not None
    assert np.abs(scaled(s, last.initial)[:3]).max() < 4.0


def given(s: Ship, stamp_ns: int = START) -> InitialState:
    truth = s.truth(stamp_ns)
    rph = np.add([float(a[0]) for a in euler_from_dcm(truth.C_nb)], [1e-4, 0.0, 2e-3])
    five = np.full(3, 5.0)
    return InitialState(stamp_ns, float(truth.lat[0]), float(truth.lon[0]), 5.0, truth.v_n[0], rph, five, 0.1 + 0 * five, 3e-3 + 0 * five)


@pytest.mark.parametrize("cuts", [(), tuple(range(1, 190 * 25, 7))])
def test_aligning_again_while_navigating(cuts: tuple[int, ...]) -> None:
    """The state goes on until the new one takes its place; one that is given up changes nothing."""
    s = ship(**WAVES)
    navigator = Navigator(config({"data_s": 120.0}))
    navigator.set_initial_state(given(s))
    assert not navigator.align(AlignCommand(START + 10 * SECOND + 1, "swaying"))
    assert not navigator.align(AlignCommand(START + 165 * SECOND + 1, "swaying"))
    assert not navigator.align(AlignCommand(START + 175 * SECOND + 1, "cancel"))
    feed(navigator, s, cuts=cuts)
    reports, settled, events = navigator.drain_alignment(), navigator.drain_settled(), [e.text for e in navigator.drain_events()]
    assert [r.ended for r in reports if r.ended] == ["aligned", "cancelled"]
    found = next(r.initial for r in reports if r.initial)
    assert [e for e in events if "begins" in e] == [
        "navigation begins from the initial state of an unnamed source", "navigation begins again from the initial state of alignment (swaying)",
    ]  # fmt: skip
    counts = [x.reset_count for x in settled]
    at = next(i for i, x in enumerate(settled) if x.stamp_ns > found.stamp_ns)
    assert counts[at] > counts[at - 1] and len(settled) == 190 and {x.mode for x in settled} == {Mode.NAVIGATING}
    if cuts:
        other = Navigator(config({"data_s": 120.0}))
        other.set_initial_state(given(s))
        for command in (AlignCommand(START + 10 * SECOND + 1, "swaying"), AlignCommand(START + 165 * SECOND + 1, "swaying")):
            other.align(command)
        other.align(AlignCommand(START + 175 * SECOND + 1, "cancel"))
        feed(other, s)
        same(other.drain_settled(), settled)


def test_a_failure_while_navigating_leaves_the_state_alone() -> None:
    s = ship(**WAVES)
    plain, navigator = Navigator(config({})), Navigator(config({}))
    for one in (plain, navigator):
        one.set_initial_state(given(s))
    assert not navigator.align(AlignCommand(START + 10 * SECOND + 1, "stationary"))
    feed(plain, s)
    feed(navigator, s)
    assert "the base moves" in navigator.drain_alignment()[-1].text and navigator.status().mode is Mode.NAVIGATING
    same(navigator.drain_settled(), plain.drain_settled())
    assert "after its stamp" in navigator.align(AlignCommand(START + 20 * SECOND, "swaying"))


def test_a_given_state_ends_the_alignment() -> None:
    s = ship(**WAVES)
    for cuts in ((), tuple(range(1, 190 * 25, 11))):
        navigator = Navigator(config(ALIGN))
        navigator.set_initial_state(given(s, START + 50 * SECOND))
        feed(navigator, s, cuts=cuts)
        reports = navigator.drain_alignment()
        assert reports[-1].ended == "cancelled" and "an initial state was given" in reports[-1].text
        assert len(navigator.drain_settled()) == 140 and reports[-1].stamp_ns == START + 50 * SECOND


def test_an_excluded_aid_is_not_used() -> None:
    s = ship(**REST)
    navigator = Navigator(config({"method": "redundant", "time_limit_s": 30.0}))
    for name in ("gps", "bds"):
        assert not navigator.set_use(UseCommand(name, False, START))
    assert "no position" in feed(navigator, s).drain_alignment()[-1].text


def test_a_jump_of_the_imu_stamp_begins_it_anew() -> None:
    s = ship(**REST)
    navigator = Navigator(config({"method": "redundant", "data_s": 20.0}))
    half = len(s.stamp) // 2
    later = 100 * SECOND
    for aid in s.aids:
        if aid.stamp_ns <= s.stamp[half]:
            navigator.add_aid(aid)
    navigator.add_imu(s.stamp[: half // 4], s.sequence[: half // 4], s.rate[: half // 4], s.force[: half // 4])
    for aid in s.aids:
        navigator.add_aid(replace(aid, stamp_ns=aid.stamp_ns + later))
    navigator.add_imu(s.stamp + later, s.sequence, s.rate, s.force)
    reports = navigator.drain_alignment()
    assert [r.ended for r in reports if r.ended] == ["cancelled", "aligned"] and "the IMU stamp jumped" in next(r.text for r in reports if r.ended)
    assert reports[-1].initial is not None and reports[-1].initial.stamp_ns > START + later


def test_transfer_from_a_master() -> None:
    """The mounting differs by half a degree; the master's velocity finds the levels, a turn helps the heading."""
    s = ship(**WAY)
    mounted = dcm_from_euler(0.4 * DEG, -0.3 * DEG, 0.3 * DEG)
    rng = np.random.default_rng(2)
    navigator = Navigator(config({"method": "transfer", "data_s": 120.0, "mounting_deg": 0.4, "master_lever_arm_m": (3.0, 1.0, -1.0)}))
    for t in range(1, 240):
        truth = s.truth(START + t * SECOND)
        C = truth.C_nb[0]
        v = truth.v_n[0] + C @ np.cross(truth.rate_nb_b[0], [3.0, 1.0, -1.0]) + 0.02 * rng.standard_normal(3)
        sigma = np.full(3, 2.0), np.full(3, 0.02), np.full(3, 0.02 * DEG)
        state = MasterState(START + t * SECOND, float(truth.lat[0]), float(truth.lon[0]), 5.0, v, C @ mounted, *sigma)
        assert navigator.add_master(state) is Reason.NONE
    bad = ({"valid": False}, Reason.NO_FIX), ({"v_n": np.full(3, np.nan)}, Reason.NOT_FINITE), ({"lat": 200.0 * DEG}, Reason.NOT_FINITE)
    for wrong, reason in (*bad, ({"sigma_position": np.zeros(3)}, Reason.COVARIANCE)):
        assert navigator.add_master(replace(state, **wrong)) is reason
    feed(navigator, s)
    reports = navigator.drain_alignment()
    last = reports[-1]
    assert last.ended == "aligned" and last.initial is not None, [r.text for r in reports if r.text]
    assert np.abs(scaled(s, last.initial)).max() < 4.0 and np.max(last.initial.sigma_attitude[:2]) < 0.05 * DEG
    assert navigator.drain_settled()[-1].validity[2] is Validity.VALID


def declared(s: Ship, lever: tuple[float, float, float]) -> list[Aid]:
    """A compass that reads 5 deg too much and a GNSS velocity at an antenna of a ship, once a second."""
    rng, aids = np.random.default_rng(9), []
    for t in range(1, int((s.stamp[-1] - START) // SECOND)):
        truth = s.truth(START + t * SECOND)
        heading = float(euler_from_dcm(truth.C_nb)[2][0]) + 5.0 * DEG + 0.2 * DEG * rng.standard_normal()
        v = truth.v_n[0] + truth.C_nb[0] @ np.cross(truth.rate_nb_b[0], lever) + 0.05 * rng.standard_normal(3)
        aids += [Aid("compass", START + t * SECOND, np.array([heading]), np.array([[(0.2 * DEG) ** 2]]))]
        aids += [Aid("receiver", START + t * SECOND, v, 0.05**2 * np.eye(3))]
    return aids


@pytest.mark.parametrize("method", ["in_motion", "known_heading"])
def test_declared_aids_serve(method: str) -> None:
    """A heading sensor gives the known heading, GNSS velocity takes the place of the log, at its lever arm."""
    s, lever = ship(**WAY), (-8.0, 1.0, -10.0)
    more = {
        "aids": ["gps", "compass", "receiver"],
        "compass": {"type": "heading", "offset_deg": 5.0},
        "receiver": {"type": "gnss_velocity", "lever_arm_m": lever},
    }
    base = config({"method": method, "data_s": 150.0}, **more)
    fixes = [a for a in s.aids if a.name == "gps"]
    navigator = feed(Navigator(base), s, sorted([*fixes, *declared(s, lever)], key=lambda a: a.stamp_ns))
    reports = navigator.drain_alignment()
    last = reports[-1]
    assert last.ended == "aligned" and last.initial is not None, [r.text for r in reports if r.text]
    assert np.abs(scaled(s, last.initial)).max() < 4.0
    assert last.initial.sigma_attitude[2] < (0.6 if method == "in_motion" else 0.2) * DEG
