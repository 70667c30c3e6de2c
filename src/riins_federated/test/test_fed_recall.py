"""Law 4 in the navigator: what the fusion recalls leaves attitude and velocity, by measurement time, whatever the order of arrival."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fed_voyage import Voyage, config, run, voyage
from hypothesis import example, given, settings
from hypothesis import strategies as st
from test_fed_navigator import same

from riins_core.rotation import log_so3
from riins_federated.navigator import Navigator
from riins_federated.types import NavSolution, Reason, Recall

SECOND = 1_000_000_000
ONSET, DECLARED = 2500, 3000  # samples: 25 s and 30 s
ARCMIN = np.radians(1.0 / 60.0)


@pytest.fixture(scope="module")
def v() -> Voyage:
    return voyage(start_ns=1_700_000_000 * SECOND)


@pytest.fixture(scope="module")
def faulty(v: Voyage) -> tuple[Voyage, Recall]:
    """The voyage with a rate and a force that lie from `ONSET` up to `DECLARED`, in a turn, and the recall that belongs to it."""
    rate, force, lie = v.rate.copy(), v.force.copy(), np.array([2e-5, -3e-5, 4e-5])
    rate[ONSET:DECLARED] += lie
    force[ONSET:DECLARED] += [0.004, 0.0, 0.0]
    C, angle, velocity = np.eye(3), np.zeros(3), np.zeros(3)  # C: body at the sample to body at the end
    for k in range(DECLARED - 1, ONSET - 1, -1):
        turn = v.trajectory.truth(np.array([k * 0.01, (k + 1) * 0.01])).C_nb
        C = C @ turn[1].T @ turn[0]
        angle += C @ lie * 0.01
        velocity += C @ [0.004, 0.0, 0.0] * 0.01
    recall = Recall(int(v.stamp[DECLARED]), int(v.stamp[ONSET - 1]), angle, velocity)
    return replace(v, rate=rate, force=force), recall


def feed(v: Voyage, navigator: Navigator, recalls: list[Recall], cuts: tuple[int, ...] = ()) -> Navigator:
    """As `run`, with recalls beside the samples they belong to."""
    navigator.set_initial_state(v.initial)
    for aid in v.aids:
        navigator.add_aid(aid)
    for part in np.split(np.arange(len(v.stamp)), cuts):
        give(v, navigator, part, recalls)
    navigator.finish()
    return navigator


def give(v: Voyage, navigator: Navigator, part: np.ndarray, recalls: list[Recall]) -> None:
    mine = [recall for recall in recalls if v.stamp[part[0]] <= recall.stamp_ns <= v.stamp[part[-1]]] if len(part) else []
    navigator.add_imu(v.stamp[part], v.sequence[part], v.rate[part], v.force[part], mine)


@pytest.fixture(scope="module")
def recalled(faulty: tuple[Voyage, Recall]) -> list[NavSolution]:
    return feed(faulty[0], Navigator(config()), [faulty[1]]).drain_settled()


def apart(a: list[NavSolution], b: list[NavSolution], second: int) -> tuple[float, float]:
    """Angle [arcmin] and velocity [m/s] between two runs at the end of a second."""
    one, other = a[second - 1], b[second - 1]
    return float(np.linalg.norm(log_so3(one.C_nb @ other.C_nb.T))) / ARCMIN, float(np.linalg.norm(one.v_n - other.v_n))


def test_without_aids_the_fault_free_attitude_comes_back(v: Voyage, faulty: tuple[Voyage, Recall]) -> None:
    """Nothing but the strapdown between onset and declaration: the angle is exact, the velocity but for the tilt's share."""
    spoilt, recall = faulty
    alone = {"aids": [], "initial": v.initial}
    clean = run(replace(v, **alone), Navigator(config(height={"enabled": False}))).drain_settled()
    wrong = run(replace(spoilt, **alone), Navigator(config(height={"enabled": False}))).drain_settled()
    navigator = feed(replace(spoilt, **alone), Navigator(config(height={"enabled": False})), [recall])
    right = navigator.drain_settled()
    assert apart(wrong, clean, 31)[0] == pytest.approx(np.linalg.norm(recall.angle) / ARCMIN, rel=2e-3)
    assert apart(right, clean, 31)[0] < 2e-3 * np.linalg.norm(recall.angle) / ARCMIN
    # velocity: what 5 s of a tilt that grows to 1.8e-4 rad make of gravity is left
    assert apart(wrong, clean, 31)[1] > 0.018 and apart(right, clean, 31)[1] < 0.006
    texts = [e.text for e in navigator.drain_events() if "recalled" in e.text]
    angle, velocity = np.linalg.norm(recall.angle) / ARCMIN, np.linalg.norm(recall.velocity)
    assert texts == [f"recalled {angle:.2f} arcmin and {velocity:.3g} m/s of isolated inertial sensors since 5.0 s"]


def test_with_aids_the_deviation_from_the_fault_free_twin_shrinks(v: Voyage, faulty: tuple[Voyage, Recall], recalled: list[NavSolution]) -> None:
    clean, wrong = run(v, Navigator(config())).drain_settled(), run(faulty[0], Navigator(config())).drain_settled()
    assert apart(recalled, clean, 31)[0] < 0.3 * apart(wrong, clean, 31)[0]
    heading = [abs(s[40].rph[2] - clean[40].rph[2]) / ARCMIN for s in (wrong, recalled)]
    assert heading[1] < 0.2 * heading[0]


def test_a_recall_beyond_one_sigma_is_a_reset(faulty: tuple[Voyage, Recall]) -> None:
    spoilt, recall = faulty
    large = replace(recall, angle=np.array([0.0, 0.0, 0.02]))
    settled = feed(spoilt, Navigator(config()), [large]).drain_settled()
    before, after = settled[29], settled[30]
    assert after.reset_count > before.reset_count
    assert abs(after.reset[2]) == pytest.approx(0.02, rel=0.01)


@settings(max_examples=6, deadline=None)
@given(cuts=st.lists(st.one_of(st.integers(1, 5999), st.integers(DECLARED - 2, DECLARED + 2)), max_size=12, unique=True))
def test_blocks_do_not_matter(faulty: tuple[Voyage, Recall], recalled: list[NavSolution], cuts: list[int]) -> None:
    same(feed(faulty[0], Navigator(config()), [faulty[1]], tuple(sorted(cuts))).drain_settled(), recalled)


@settings(max_examples=6, deadline=None)
@given(seed=st.integers(0, 2**31))
@example(seed=186)  # an aid so late that the filter goes back beyond the event of the recall, which was handed out
def test_late_aids_roll_back_over_a_recall(faulty: tuple[Voyage, Recall], recalled: list[NavSolution], seed: int) -> None:
    """Law 1: aids up to 1.9 s late, one of them at the very stamp of the recall."""
    spoilt, recall = faulty
    rng = np.random.default_rng(seed)
    waiting = sorted((aid.stamp_ns + int(rng.uniform(0.5, 1.9) * SECOND), i) for i, aid in enumerate(spoilt.aids))
    navigator, settled, events, start = Navigator(config()), [], [], 0
    navigator.set_initial_state(spoilt.initial)
    while start < len(spoilt.stamp):
        stop = min(start + int(rng.choice([1, 7, 40])), len(spoilt.stamp))
        while waiting and waiting[0][0] <= spoilt.stamp[stop - 1]:
            assert navigator.add_aid(spoilt.aids[waiting.pop(0)[1]]) is Reason.NONE
        give(spoilt, navigator, np.arange(start, stop), [recall])
        settled += navigator.drain_settled()
        events += navigator.drain_events()
        start = stop
    for _, i in waiting:
        navigator.add_aid(spoilt.aids[i])
    navigator.finish()
    same(settled + navigator.drain_settled(), recalled)
    events += navigator.drain_events()
    assert navigator.rollbacks > 0 and sum(e.text.startswith("recalled") for e in events) == 1


def test_what_entered_before_the_run_is_not_taken_out(v: Voyage, faulty: tuple[Voyage, Recall]) -> None:
    """A run that begins after the onset has not integrated all of it."""
    early = replace(faulty[1], onset_ns=v.initial.stamp_ns - 1)
    navigator = feed(v, Navigator(config()), [early])
    assert apart(navigator.drain_settled(), run(v, Navigator(config())).drain_settled(), 31)[0] < 1e-6
    assert any(e.text.startswith("not recalled, it began before the run") for e in navigator.drain_events())


def test_recalls_across_a_restart_go_with_their_samples(v: Voyage, faulty: tuple[Voyage, Recall], recalled: list[NavSolution]) -> None:
    """One block with a jump in it: the second leg is navigated as if it were alone."""
    spoilt, recall = faulty
    jump, half = 500 * SECOND, 1000
    navigator = Navigator(config())
    navigator.set_initial_state(v.initial)
    navigator.set_initial_state(replace(v.initial, stamp_ns=v.initial.stamp_ns + jump))
    for aid in v.aids:
        navigator.add_aid(replace(aid, stamp_ns=aid.stamp_ns + jump))
    later = replace(recall, stamp_ns=recall.stamp_ns + jump, onset_ns=recall.onset_ns + jump)
    first = Recall(int(v.stamp[half - 1]), int(v.stamp[half - 2]), recall.angle, recall.velocity)
    columns = [np.concatenate([column[:half], after]) for column, after in (
        (v.stamp, spoilt.stamp + jump), (v.sequence, spoilt.sequence), (v.rate, spoilt.rate), (v.force, spoilt.force))]  # fmt: skip
    navigator.add_imu(*columns, [first, later])
    navigator.finish()
    settled = navigator.drain_settled()
    assert navigator.restarts == 1
    assert [(s.lat, *s.rph) for s in settled[-60:]] == [(s.lat, *s.rph) for s in recalled]
