"""Horizontal damping: the oscillation is the one of the characteristic polynomial, and what is given out knows nothing of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fed_voyage import Voyage, config, run, voyage

from riins_core.earth import OMEGA_IE, gravity_s, radii_s
from riins_core.platform_error import Damping
from riins_core.settings import SettingError, build
from riins_federated.config import NavigatorConfig
from riins_federated.damping import SCHULER, Network
from riins_federated.navigator import Navigator
from riins_federated.types import Aid, InitialState, Mode, NavSolution, Validity

SECOND = 1_000_000_000
DAMPED = {"feedback_period_s": 1e6, "damping": {"aid": "doppler"}}


@pytest.fixture(scope="module")
def v() -> Voyage:
    return voyage()


def far(one: list[NavSolution], other: list[NavSolution]) -> tuple[float, float, float]:
    """Largest difference of two runs: position [m], velocity [m/s], angles [rad]."""
    assert len(one) == len(other) > 0
    position = [[a.lat - b.lat, (a.lon - b.lon) * np.cos(a.lat), (a.h - b.h) / 6.4e6] for a, b in zip(one, other, strict=True)]
    velocity = [a.v_n - b.v_n for a, b in zip(one, other, strict=True)]
    angle = [(a.rph - b.rph + np.pi) % (2.0 * np.pi) - np.pi for a, b in zip(one, other, strict=True)]
    return 6.4e6 * float(np.abs(position).max()), float(np.abs(velocity).max()), float(np.abs(angle).max())


def inertial(settled: list[NavSolution]) -> list[NavSolution]:
    found = [one.inertial for one in settled if one.inertial is not None]
    assert len(found) == len(settled)
    return found


def test_the_network_of_003() -> None:
    """H(0) = 1, the printed coefficients, and the poles that were asked for."""
    net, printed = Network.of(0.5, 1.5), Damping()
    assert net.k1 == pytest.approx(printed.k1, abs=5e-3) and net.k2 == pytest.approx(printed.k2, abs=5e-7)
    assert net.k3 == pytest.approx(printed.k3, abs=5e-7)
    for ratio, frequency in ((0.5, 1.5), (0.2, 1.1), (1.0, 3.0)):
        net = Network.of(ratio, frequency)
        assert net.k1 + net.k3 / net.k2 == pytest.approx(1.0, abs=1e-12)
        third = -net.k2 / frequency**2
        wanted = np.poly([third]), [1.0, 2.0 * ratio * frequency * SCHULER, (frequency * SCHULER) ** 2]
        made = [1.0, net.k2, net.k1 * SCHULER**2, net.k2 * SCHULER**2]
        assert np.allclose(np.polymul(*wanted), made, rtol=1e-12)


def test_a_step_of_the_network_is_exact_for_a_constant_difference() -> None:
    """However the time is cut, and a gap only lets the state decay."""
    net = Network.of(0.5, 1.5)
    one, many = np.zeros(2), np.zeros(2)
    apart = np.array([0.3, -1.0])
    whole = net.step(one, apart, 600.0, 600.0)
    parts = sum(net.step(many, apart, step, step) for step in (1.0, 99.0, 500.0))
    assert np.allclose(parts, whole, rtol=1e-12) and np.allclose(one, many, rtol=1e-12)
    before = one.copy()
    assert not net.step(one, apart, 300.0, 0.0).any() and np.allclose(one, before * np.exp(-net.k2 * 300.0), rtol=1e-12)


def still(hours: float, speed: tuple[float, float], **over: object) -> list[NavSolution]:
    """A ship at rest on the equator, 1 Hz, that begins with a wrong velocity north and east; a log every 10 s."""
    n = round(hours * 3600.0)
    stamps = np.arange(1, n + 1) * SECOND
    base = {"aids": ["doppler"], "states": [], "doppler": {"misalignment_deg": 0.0}, "feedback_period_s": 1e6, "settle_period_s": 10.0}
    navigator = Navigator(build(NavigatorConfig, {**base, "covariance_period_s": 10.0, "height": {"mean_m": 0.0, "period_s": 10.0}, **over}))
    sigma = np.array([1.0, 1.0, 0.1])
    v_n = np.array([*speed, 0.0])
    assert not navigator.set_initial_state(InitialState(0, 0.0, 0.0, 0.0, v_n, np.zeros(3), 10.0 * sigma, sigma, np.full(3, 1e-3)))
    for t in range(10, n + 1, 10):
        navigator.add_aid(Aid("doppler", t * SECOND, np.zeros(3), 1e-2 * np.eye(3)))
    rate, force = np.array([OMEGA_IE, 0.0, 0.0]), np.array([0.0, 0.0, -gravity_s(0.0, 0.0)])
    navigator.add_imu(stamps, np.arange(1, n + 1), np.tile(rate, (n, 1)), np.tile(force, (n, 1)))
    navigator.finish()
    assert all(j.accepted for j in navigator.drain_judged())
    return navigator.drain_settled()


@pytest.fixture(scope="module")
def oscillations() -> dict[bool, list[NavSolution]]:
    return {on: still(3.0, (1.0, -0.5), damping={"aid": "doppler" if on else ""}) for on in (False, True)}


def test_the_oscillation_is_that_of_the_characteristic_polynomial(oscillations) -> None:
    """V(s) = v0 s (s + k2) / (s^3 + k2 s^2 + k1 ws^2 s + k2 ws^2) in each channel; without damping v0 cos(ws t)."""
    radius_n, radius_e = radii_s(0.0)
    net = Network.of(0.5, 1.5)
    for axis, (v0, radius) in enumerate(((1.0, radius_n), (-0.5, radius_e))):
        ws = np.sqrt(gravity_s(0.0, 0.0) / radius)
        t = 10.0 * np.arange(1, 1081)
        damped, free = (np.array([one.v_n[axis] for one in inertial(oscillations[on])]) for on in (True, False))
        assert np.abs(free - v0 * np.cos(ws * t)).max() < 0.02 * abs(v0)
        polynomial = [1.0, net.k2, net.k1 * ws**2, net.k2 * ws**2]
        poles = np.roots(polynomial)
        oscillating = poles[poles.imag > 0.0][0]
        assert abs(oscillating) == pytest.approx(1.5 * ws, rel=0.01) and -oscillating.real / abs(oscillating) == pytest.approx(0.5, abs=0.01)
        residues = poles * (poles + net.k2) / np.polyval(np.polyder(polynomial), poles)
        wanted = v0 * (np.exp(np.outer(t, poles)) @ residues).real
        assert np.abs(damped - wanted).max() < 0.01 * abs(v0)
        assert np.abs(damped[-180:]).max() < 0.01 * abs(v0) < 0.5 * abs(v0) < np.abs(free[-180:]).max()


def test_the_output_of_hours_knows_nothing_of_it(oscillations) -> None:
    """What is left is that the filter is linear about another nominal state: beside an initial error of 1 m/s and 3 arcmin, a thousandth of sigma."""
    one, other = oscillations[True], oscillations[False]
    position, velocity, angle = far(one, other)
    sigma = np.sqrt(np.diag(other[-1].P))
    assert position < 1e-3 * sigma[0] and velocity < 1e-3 * sigma[3] and angle < 1e-3 * sigma[6:9].max()
    assert far(inertial(one), inertial(other))[0] > 300.0


@pytest.mark.parametrize(("lie", "limit"), [(0.0, 1e-6), (0.2, 1e-5)])
@pytest.mark.parametrize("structure", ["separated", "no_reset"])
def test_the_output_is_the_same_whatever_the_log_says(v: Voyage, lie: float, limit: float, structure: str) -> None:
    """The damping is a known control; the lie is one that the tests let pass. What is left is the linearization about another nominal state."""
    aids = [replace(aid, z=aid.z + np.array([lie, -lie, 0.0])) if aid.name == "doppler" else aid for aid in v.aids]
    gate = {"structure": structure, "isolation": {"false_alarm_probability": 1e-15}}
    with_it, without = (run(v, Navigator(config(**gate, **{**DAMPED, **over})), aids) for over in ({}, {"damping": {"aid": ""}}))
    one, other = with_it.drain_settled(), without.drain_settled()
    position, velocity, angle = far(one, other)
    assert position < limit and velocity < 0.1 * limit and angle < 0.03 * limit
    assert np.allclose(np.diag(one[-1].P), np.diag(other[-1].P), rtol=1e-4)
    assert far(inertial(one), inertial(other))[0] > 5e-3
    assert one[-1].reset_count == other[-1].reset_count == (1 if lie and structure == "separated" else 0)  # that lie is taken out
    assert [j.accepted for j in with_it.drain_judged()] == [j.accepted for j in without.drain_judged()]


def test_a_constant_error_of_the_log_does_not_stay_in_the_velocity() -> None:
    """H(0) = 1: what a log says wrongly all the time only tilts for a while."""
    net = Network.of(0.5, 1.5)
    state, out = np.zeros(2), []
    for _ in range(600):
        out.append(net.step(state, np.array([1.0, 0.0]), 10.0, 10.0)[0])
    assert 29.0 < out[0] < 30.5 and abs(out[-1]) < 1e-6  # (k1 - 1) times ten seconds, then nothing


def test_blocks_and_arrival_do_not_matter(v: Voyage) -> None:
    """Law 3, and law 1 with measurements up to 1.9 s late: the network goes back with the filter."""
    straight = run(v, Navigator(config(**DAMPED))).drain_settled()
    cut = run(v, Navigator(config(**DAMPED)), cuts=(1, 700, 701, 2345)).drain_settled()
    navigator = Navigator(config(**DAMPED))
    navigator.set_initial_state(v.initial)
    rng = np.random.default_rng(5)
    waiting = sorted((aid.stamp_ns + int(rng.uniform(0, 1.9) * SECOND), i) for i, aid in enumerate(v.aids))
    for part in np.split(np.arange(len(v.stamp)), range(40, len(v.stamp), 40)):
        while waiting and waiting[0][0] <= v.stamp[part[-1]]:
            navigator.add_aid(v.aids[waiting.pop(0)[1]])
        navigator.add_imu(v.stamp[part], v.sequence[part], v.rate[part], v.force[part])
    for _, i in waiting:
        navigator.add_aid(v.aids[i])
    navigator.finish()
    assert navigator.rollbacks > 10
    for other in (cut, navigator.drain_settled()):
        assert far(straight, other) == far(inertial(straight), inertial(other)) == (0.0, 0.0, 0.0)


def test_without_a_log_nothing_is_damped(v: Voyage) -> None:
    """Out, or rejected all the time: the uncorrected solution is the one that is not damped."""
    silent = [aid for aid in v.aids if aid.name != "doppler"]
    lying = [replace(aid, z=aid.z + 50.0) if aid.name == "doppler" else aid for aid in v.aids]
    for aids in (silent, lying):
        one, other = (run(v, Navigator(config(**{**DAMPED, **over})), aids).drain_settled() for over in ({}, {"damping": {"aid": ""}}))
        assert far(inertial(one), inertial(other)) == (0.0, 0.0, 0.0)


def test_the_uncorrected_solution_knows_how_far_it_is_off(v: Voyage) -> None:
    settled = run(v, Navigator(config(**{**DAMPED, "feedback_period_s": 30.0}))).drain_settled()
    last = settled[28]
    alone = last.inertial
    assert alone is not None and alone.mode is Mode.COASTING and alone.validity[0] is Validity.DOUBTFUL
    north = (alone.lat - last.lat) * radii_s(last.lat)[0]
    assert alone.P[0, 0] == pytest.approx(last.P[0, 0] + north**2, rel=1e-3) and alone.protection_radius > last.protection_radius
    assert far([settled[29]], inertial([settled[29]])) == (0.0, 0.0, 0.0)  # fed back
    assert run(v, Navigator(config())).drain_settled()[-1].inertial is None  # continuous feedback has no other solution


@pytest.mark.parametrize(
    ("over", "said"),
    [
        ({"aid": "dopler"}, 'names "dopler" (did you mean "doppler"?); the aids are gps, bds, doppler'),
        ({"aid": "gps"}, 'names "gps", a gnss_position: the level is damped by one of body_velocity, water_velocity'),
        ({"aid": "doppler", "frequency": 1.0}, '"damping.frequency" must be in 1.05 .. 5.0'),
        ({"aid": "doppler", "ratio": 0.0}, '"damping.ratio" must be in 0.05 .. 2.0'),
    ],
)
def test_settings_that_make_no_sense_are_refused(over: dict, said: str) -> None:
    with pytest.raises(SettingError, match="damping") as refused:
        build(NavigatorConfig, {"feedback_period_s": 14400.0, "damping": over})
    assert said in str(refused.value) and "\n" not in str(refused.value)


def test_damping_needs_something_to_damp_and_a_log_that_measures_often() -> None:
    with pytest.raises(SettingError, match="feedback_period_s"):
        build(NavigatorConfig, {"damping": {"aid": "doppler"}})
    with pytest.raises(SettingError, match="every 400 s"):
        build(NavigatorConfig, {"feedback_period_s": 1.0, "damping": {"aid": "doppler"}, "doppler": {"period_s": 400.0}})
