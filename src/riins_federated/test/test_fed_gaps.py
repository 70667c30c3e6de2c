"""Gaps in the IMU stream: what is put in, what it is said to be worth, and a navigator that goes on consistent with the truth.

Lives here: `gaps.Gaps`, and the navigator over gaps of a rolling ship.
Does not live here: a sensor that is lost for good (riins_imu_fusion), clocks that jump (test_fed_navigator.py).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fed_voyage import Voyage, config, run, voyage
from scipy.stats import chi2

from riins_core.earth import radii
from riins_core.rotation import dcm_from_euler, log_so3
from riins_federated.gaps import Filled, Gaps
from riins_federated.navigator import Navigator
from riins_federated.sample_noise import SampleNoise
from riins_federated.types import NavSolution

SECOND = 1_000_000_000
DT = 0.01


@pytest.fixture(scope="module")
def v() -> Voyage:
    return voyage(start_ns=1_700_000_000 * SECOND)


def rolling(period: float, seconds: float, phase: float) -> Filled:
    """A body whose rates and forces are sines: means over the samples."""
    end = DT * np.arange(1, round(seconds / DT) + 1)
    w = 2.0 * np.pi / period
    values = np.outer((np.cos(w * (end - DT) + phase) - np.cos(w * end + phase)) / (w * DT), [0.02, 0.01, 0.003, 0.5, 0.7, 0.2])
    zero = np.zeros((len(end), 3, 3))
    return Filled(np.round(end * 1e9).astype(np.int64), values[:, :3], values[:, 3:], zero, zero, np.full(len(end), DT), np.zeros((len(end), 6)))


def without(samples: Filled, first: int, n: int) -> Filled:
    """n samples missing from index `first` on."""
    kept = Filled(*(np.delete(column, np.s_[first : first + n], axis=0) for column in samples))
    kept.dt[first] += n * DT
    return kept


@pytest.mark.parametrize("n", [3, 20, 50])
def test_what_a_gap_hides_of_a_swell_has_the_variance_it_is_said_to_have(n: int) -> None:
    """Root mean square over the phase of the swell; where the gap is shorter than a third of a wave."""
    hidden, said = [], []
    for phase in np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False):
        whole = rolling(8.0, 60.0, phase)
        filled = Gaps().fill(*without(whole, 5000, n)[:6])
        assert len(filled.dt) == len(whole.dt) and filled.stamp_ns == pytest.approx(whole.stamp_ns, abs=2.0)
        assert np.flatnonzero(filled.unknown.any(axis=1)).tolist() == list(range(5000, 5000 + n))
        hidden.append(((filled.rate - whole.rate) * DT).sum(axis=0))
        said.append((filled.unknown[:, :3] * DT**2).sum(axis=0))
    ratio = np.mean(np.square(hidden), axis=0) / np.mean(said, axis=0)
    assert ratio == pytest.approx(np.ones(3), rel=0.2)


def test_a_stream_without_gaps_is_handed_on_as_it_is() -> None:
    whole = rolling(8.0, 10.0, 0.3)
    filled = Gaps().fill(*whole[:6])
    assert all(np.array_equal(a, b) for a, b in zip(filled, whole, strict=True))


def test_noise_of_a_gap_counts_also_where_covariances_are_not_followed() -> None:
    noise = SampleNoise(config(inertial={"follow_covariance": False}))
    state, Qd, zero = noise.fresh(), np.zeros((19, 19)), np.zeros((4, 3, 3))
    unknown = np.zeros((4, 6))
    unknown[1:3] = 2.0, 2.0, 2.0, 5.0, 5.0, 5.0
    noise.gather(state, zero, zero, unknown, np.full(4, 0.1))
    noise.add(state, np.eye(3), 0.4, Qd)
    assert np.diag(Qd)[3:9] == pytest.approx([0.1] * 3 + [0.04] * 3)


def error(v: Voyage, s: NavSolution) -> np.ndarray:
    """Position, velocity, attitude error, (9,), NED."""
    truth = v.trajectory.truth(np.array([(s.stamp_ns - v.initial.stamp_ns) * 1e-9]))
    r_m, r_n = radii(truth.lat[0])
    position = [(s.lat - truth.lat[0]) * r_m, (s.lon - truth.lon[0]) * r_n * np.cos(truth.lat[0]), truth.h[0] - s.h]
    attitude = -log_so3(dcm_from_euler(*s.rph) @ truth.C_nb[0].T)
    return np.concatenate([position, s.v_n - truth.v_n[0], attitude])


def gapped(v: Voyage, first: int, n: int) -> Voyage:
    """The voyage with samples missing."""
    columns = ("stamp", "sequence", "rate", "force")
    return replace(v, **{name: np.delete(getattr(v, name), np.s_[first : first + n], axis=0) for name in columns})


def over_gaps(v: Voyage, seconds: float) -> tuple[float, float, int]:
    """Mean NEES of nine states behind gaps and twenty seconds later, and measurements that were rejected."""
    n, at_end, later, blamed = round(seconds / DT), [], [], 0
    for first in np.linspace(1500, 3300, 16).astype(int):
        navigator = run(gapped(v, first, n), Navigator(config()))
        assert navigator.restarts == 0 and navigator.imu_lost == n
        settled = {round((s.stamp_ns - v.initial.stamp_ns) * 1e-9): s for s in navigator.drain_settled()}
        blamed += sum(not judged.accepted for judged in navigator.drain_judged())
        for when, out in ((int(np.ceil((first + n) * DT + 1e-6)), at_end), (int((first + n) * DT) + 20, later)):
            e, P = error(v, settled[when]), settled[when].P[:9, :9]
            out.append(e @ np.linalg.solve(P, e))
    return float(np.mean(at_end)), float(np.mean(later)), blamed


@pytest.mark.parametrize("seconds", [0.3, 1.0, 4.0])
def test_a_rolling_ship_stays_consistent_over_a_gap(v: Voyage, seconds: float) -> None:
    at_end, later, blamed = over_gaps(v, seconds)
    limit = chi2.ppf(0.999, 9 * 4) / 4  # the runs share aids and errors at the start: worth four, not sixteen
    assert at_end < limit and later < limit and blamed <= 1


def test_the_same_gaps_without_their_uncertainty_ruin_the_filter(v: Voyage, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Gaps, "variance", lambda self, gap: np.zeros(6))
    at_end, later, _ = over_gaps(v, 4.0)
    assert min(at_end, later) > 90.0


def test_a_gap_does_not_depend_on_blocks_nor_on_when_aids_come(v: Voyage) -> None:
    broken = gapped(v, 2000, 350)
    results = []
    for cuts in ((), (1, 1999, 2000, 2001, 2100), tuple(range(1900, 2100))):
        navigator = run(broken, Navigator(config()), cuts=cuts)
        results.append(navigator.drain_settled())
    late = Navigator(config())
    late.set_initial_state(v.initial)
    waiting = list(v.aids)
    for k in range(0, len(broken.stamp), 40):
        part = slice(k, k + 40)
        while waiting and waiting[0].stamp_ns <= broken.stamp[k] - SECOND // 2:  # those of the gap come before it ends
            late.add_aid(waiting.pop(0))
        late.add_imu(broken.stamp[part], broken.sequence[part], broken.rate[part], broken.force[part])
    for aid in waiting:
        late.add_aid(aid)
    late.finish()
    first = results[0]
    late_by = {s.stamp_ns: s for s in late.drain_settled()}
    for other in (*results[1:], list(late_by.values())):
        assert [(s.stamp_ns, s.lat, s.lon, *s.v_n, *s.rph) for s in other] == [(s.stamp_ns, s.lat, s.lon, *s.v_n, *s.rph) for s in first]


def test_a_clock_that_jumps_is_no_gap(v: Voyage) -> None:
    """The numbers go on: nothing is missing. Nor is a gap longer than `max_gap_s` bridged."""
    stamp = v.stamp.copy()
    stamp[3000:] += 5 * SECOND
    navigator = run(replace(v, stamp=stamp), Navigator(config()))
    assert navigator.restarts == 1 and navigator.imu_lost == 0
    assert run(gapped(v, 3000, 350), Navigator(config(max_gap_s=3.0))).restarts == 1
    assert run(gapped(v, 3000, 350), Navigator(config())).restarts == 0
