"""The assembled error state: the kernels against matrix exponentials, every block's coupling, and the numbers of the state that used to be fixed."""

from __future__ import annotations

import numpy as np
import pytest
from fed_voyage import config, run, voyage

from riins_core.ins_error import BA, BG, N_STATES, PHI, VEL, error_dynamics
from riins_core.kalman import van_loan
from riins_core.rotation import dcm_from_euler, exp_so3
from riins_core.settings import SettingError
from riins_federated.error_filter import between, transition
from riins_federated.inertial_model import InertialModel
from riins_federated.integrated_filter import IntegratedFilter
from riins_federated.navigator import Navigator
from riins_federated.state_blocks import Block, StateModel

ALL = ("gyro_markov", "accel_markov", "gyro_scale", "accel_scale")
RATE, FORCE = np.array([0.02, -0.01, 0.03]), np.array([0.3, 0.5, -9.7])
C_NB = dcm_from_euler(0.05, -0.03, 2.2)
NAV = np.array([0.7, 2.1, 12.0, 5.0, -3.0, 0.2, *C_NB.ravel(), 0.01])


def interval(states: StateModel, T: float) -> tuple[np.ndarray, np.ndarray]:
    """Transition and process noise of an interval of steady motion."""
    sums, swing = np.r_[T * C_NB @ FORCE, T * C_NB.ravel(), T], T * np.r_[RATE, FORCE]
    Phi, Qd = np.empty((states.n, states.n)), np.empty((states.n, states.n))
    transition(NAV, sums, swing, states.density, states.decay, states.column, states.factor, Phi, Qd)
    return Phi, Qd


def continuous(states: StateModel) -> np.ndarray:
    """Dynamics of all states, written out here by hand."""
    F = np.zeros((states.n, states.n))
    F[:N_STATES, :N_STATES] = error_dynamics(NAV, C_NB @ FORCE, C_NB)
    for name, rows, entry in (
        ("gyro_markov", PHI, -C_NB),
        ("gyro_scale", PHI, -C_NB * RATE),
        ("accel_markov", VEL, C_NB),
        ("accel_scale", VEL, C_NB * FORCE),
    ):
        at = states.place(name)
        if at is not None:
            F[rows, at] = entry
    return F - np.diag(states.decay)


@pytest.mark.parametrize("names", [(), *((name,) for name in ALL), ALL, ALL[::-1]], ids=lambda names: "+".join(names) or "none")
def test_transition_is_the_matrix_exponential_to_second_order(names: tuple[str, ...]) -> None:
    model = InertialModel(gyro_markov_time_s=50.0, accel_markov_time_s=20.0, gyro_markov_deg_h=0.1, accel_markov_ug=30.0)
    states = StateModel(model, names, [Block("log.scale", ("log_scale [1]",), 1e-3), Block("log.current", ("a [m/s]", "b [m/s]"), 0.3, 15.0)])
    size = np.where(states.initial_sigma() > 0.0, states.initial_sigma(), 1.0)
    size[:N_STATES] = np.repeat([10.0, 0.1, 1e-4, 5e-8, 5e-4], 3)
    apart = []
    for T in (1.0, 0.5):
        Phi, Qd = interval(states, T)
        want, noise = van_loan(continuous(states), np.diag(states.density), T)
        apart.append(np.abs((Phi - want) * size / size[:, None]).max())
        assert np.abs(Qd - noise).max() < 2e-2 * np.abs(noise).max()
        markov = states.decay > 0.0
        assert np.diag(Phi)[markov] == pytest.approx(np.diag(want)[markov], rel=1e-12)
        assert np.diag(Qd)[markov] == pytest.approx(np.diag(noise)[markov], rel=1e-9)
        assert np.array_equal(Qd, Qd.T) and np.linalg.eigvalsh(Qd / np.outer(size, size)).min() > -1e-15
    assert apart[0] < 1e-4 and apart[1] < 0.2 * apart[0]  # third order in T: an eighth


@pytest.mark.parametrize("w", [0.0, 0.25, 1.0])
def test_between_two_samples_the_attitude_turns_evenly(w: float) -> None:
    before = NAV + np.r_[1e-6, -2e-6, 0.3, 0.1, 0.2, -0.3, np.zeros(10)]
    before[6:15] = (C_NB @ exp_so3(np.array([0.02, -0.03, 0.01]))).ravel()
    there = between(NAV, before, w)
    assert there[:6] == pytest.approx(NAV[:6] + w * (before[:6] - NAV[:6]), rel=1e-14)
    assert there[6:15].reshape(3, 3) == pytest.approx(C_NB @ exp_so3(w * np.array([0.02, -0.03, 0.01])), abs=1e-14)
    assert between(NAV, NAV, w) == pytest.approx(NAV, abs=1e-15)


def test_the_24_states_of_002_and_names_that_are_none() -> None:
    states = StateModel(InertialModel(), ("gyro_markov", "gyro_scale", "accel_scale"))
    assert states.n == 24 and states.labels[15] == "gm_x [rad/s]" and states.labels[23] == "sa_z [1]"
    assert StateModel(InertialModel(gyro_markov_deg_h=0.0), ("gyro_markov",)).n == N_STATES
    with pytest.raises(SettingError, match=r'"gyro_scal".*did you mean "gyro_scale"'):
        StateModel(InertialModel(), ("gyro_scal",))
    with pytest.raises(SettingError, match="twice"):
        StateModel(InertialModel(), ("gyro_scale", "gyro_scale"))


def test_estimated_errors_leave_the_samples() -> None:
    states = StateModel(InertialModel(), ALL)
    rng = np.random.default_rng(1)
    x = np.r_[np.zeros(9), 1e-6 * rng.normal(size=3), 1e-3 * rng.normal(size=3), np.zeros(12)]
    for name, scale in zip(ALL, (1e-6, 1e-3, 1e-3, 1e-3), strict=True):
        x[states.places[name]] = scale * rng.normal(size=3)
    errors = {name: x[states.places[name]] for name in ALL}
    parameters = np.zeros(states.n - 9)
    states.correct(NAV.copy(), parameters, x)
    measured = (1.0 + errors["gyro_scale"]) * RATE + x[BG] + errors["gyro_markov"]
    assert states.rate(parameters, measured) == pytest.approx(RATE, rel=1e-14)
    measured = (1.0 + errors["accel_scale"]) * FORCE + x[BA] + errors["accel_markov"]
    assert states.force(parameters, measured) == pytest.approx(FORCE, rel=1e-14)


# Of the navigator whose twenty states were written out by hand: lat, lon, h, v_n, rph, gyro and accelerometer bias, body rate, specific force
OLD = np.array([
    0.6981274283371293, 2.0944516542491254, 5.293765704625247, -2.4460317308212813, 4.513269534257777, -0.20162724531856588, 0.003761832294098226,
    0.0004119176864376895, 2.0956522255052255, -3.6390616037646414e-09, 8.90044382511552e-09, -1.021398156241856e-10, -0.0003984446636107583,
    0.0002684292369257791, 3.317322253723787e-05, -0.009419410638774686, -0.0006243290437628285, 0.00034187425468232236, -0.020287852817360084,
    -0.16795292065743664, -9.598138505922558,
])  # fmt: skip
OLD_SIGMA = np.array([
    0.703905044006079, 0.5553570023633975, 0.9202452949477069, 0.01811421141933473, 0.016257160506998408, 0.008863211163597532,
    6.676181044134886e-05, 5.963077707607686e-05, 0.0019200029167973501, 1.6960774831551178e-07, 1.6961326621549724e-07, 1.6979993514244045e-07,
    0.0005759060070914694, 0.000578239737517309, 0.0002532838004429004, 9.692752565574708e-08, 9.692854755120539e-08, 9.696269133918788e-08,
    0.003366497070650346, 0.000495650244637987,
])  # fmt: skip


def test_the_default_states_give_the_numbers_of_the_state_that_used_to_be_fixed(monkeypatch: pytest.MonkeyPatch) -> None:
    # it was linear about the nominal state, not about the estimate
    monkeypatch.setattr(IntegratedFilter, "_estimated", lambda self, pose: (pose, self._running().parameters, None))
    monkeypatch.setattr(IntegratedFilter, "_middle", lambda self: (self._running().nav, self._running().sums))
    inertial = {"gyro_markov_deg_h": 0.02, "gyro_bias_walk_deg_h_sqrt_h": 0.01, "accel_bias_walk_ug_sqrt_h": 5.0}
    receiver, log = {"use_height": True, "markov_sigma_m": 1.0}, {"scale_ppm": 500.0, "use_down": True}
    # without feedback: what is fed back of a Markov process fades now, as it did not then
    settings = config(inertial=inertial, doppler=log, gps=receiver, feedback_period_s=1000.0)
    s = run(voyage(), Navigator(settings)).drain_settled()[-1]
    now = np.concatenate([[s.lat, s.lon, s.h], s.v_n, s.rph, s.bias_g, s.bias_a, s.rate_b, s.force_b])
    sigma = np.sqrt(np.diag(s.P))
    assert sigma == pytest.approx(OLD_SIGMA, rel=1e-9)
    unit = np.r_[sigma[:15], sigma[9:15]]
    unit[0:2] /= 6.4e6
    assert np.abs((now - OLD) / unit).max() < 1e-9
