"""Measurement and error models against finite differences and closed forms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fed_voyage import config

from riins_core.earth import radii_s
from riins_core.rotation import dcm_from_euler, exp_so3
from riins_federated.aiding import HeightModel, Pose, PositionModel, VelocityModel, noise, reported_covariance_ok, white_inflation
from riins_federated.config import NavigatorConfig
from riins_federated.error_filter import LABELS, N_ERROR, NavError, ProcessNoise, correct, initial_covariance, propagate, transition
from riins_federated.information_sharing import checked_shares
from riins_federated.types import Aid, InitialState


def nominal() -> tuple[np.ndarray, np.ndarray]:
    nav = np.zeros(16)
    nav[0:3] = 0.7, 2.1, 12.0
    nav[3:6] = 5.0, -3.0, 0.2
    nav[6:15] = dcm_from_euler(0.05, -0.03, 2.2).ravel()
    return nav, np.array([1e-6] * 3 + [1e-3] * 3 + [0.0] * 3 + [0.004, 0.001])


def pose(nav: np.ndarray, parameters: np.ndarray) -> Pose:
    return Pose(nav[0], nav[1], nav[2], nav[3:6], nav[6:15].reshape(3, 3), np.array([0.01, 0.02, -0.03]), parameters[9:11])


def spoiled(x: np.ndarray) -> Pose:
    """The pose a navigator with errors x computes where the truth is `nominal`."""
    nav, parameters = nominal()
    correct(nav, parameters, -x)  # computed = true + error
    return pose(nav, parameters)


@pytest.mark.parametrize("state", [s for s in NavError if s not in range(9, 18)], ids=lambda s: s.name)
def test_measurement_matrices_are_the_derivatives_of_the_innovation(state: NavError) -> None:
    models = config(gps={"use_height": True}, doppler={"use_down": True})
    aids = [
        (PositionModel(models.gps), Aid("gps", 0, np.array([0.7, 2.1, 12.0]), np.eye(3))),
        (VelocityModel(models.doppler), Aid("doppler", 0, np.array([4.0, 1.0, 0.1]), np.eye(3))),
    ]
    step = {"POS": 1.0, "VEL": 1e-3, "PHI": 1e-6, "LOG": 1e-6}[state.name[:3]]
    x = np.zeros(N_ERROR)
    x[state] = step
    for model, aid in aids:
        slope = (model.measurement(aid, spoiled(x)).z - model.measurement(aid, spoiled(-x)).z) / (2.0 * step)
        H = model.measurement(aid, spoiled(np.zeros(N_ERROR))).H
        assert slope == pytest.approx(H[:, state], abs=2e-5 * max(1.0, np.abs(H).max()))
    height = HeightModel(models.height)
    slope = (height.measurement(spoiled(x)).z - height.measurement(spoiled(-x)).z) / (2.0 * step)
    assert slope == pytest.approx(height.measurement(spoiled(x)).H[:, state], abs=1e-6)


def test_correction_undoes_the_error_it_estimates() -> None:
    nav, parameters = nominal()
    x = np.array([3.0, -2.0, 1.0, 0.1, -0.2, 0.05, 1e-4, -2e-4, 3e-4, *[1e-7] * 3, *[1e-4] * 3, *[0.0] * 3, 1e-3, 1e-4])
    r_m, r_n = radii_s(nav[0])
    wrong = nav.copy()
    wrong[0] += x[0] / (r_m + nav[2])
    wrong[1] += x[1] / ((r_n + nav[2]) * np.cos(nav[0]))
    wrong[2] -= x[2]
    wrong[3:6] += x[3:6]
    wrong[6:15] = (exp_so3(-x[6:9]) @ nav[6:15].reshape(3, 3)).ravel()
    correct(wrong, parameters, x)
    assert wrong[0:2] == pytest.approx(nav[0:2], abs=1e-11)
    assert wrong[2:15] == pytest.approx(nav[2:15], abs=1e-9)


def test_propagate_is_phi_p_phi_plus_q() -> None:
    rng = np.random.default_rng(0)
    nav, _ = nominal()
    sums = np.zeros(13)
    sums[0:3], sums[3:12], sums[12] = [0.3, -0.1, -9.8], nav[6:15], 1.0
    noise_model = ProcessNoise(NavigatorConfig())
    Phi, Qd = np.empty((N_ERROR, N_ERROR)), np.empty((N_ERROR, N_ERROR))
    transition(nav, sums, noise_model.density, noise_model.markov_rate, Phi, Qd)
    root = rng.normal(size=(N_ERROR, N_ERROR))
    x, P = rng.normal(size=N_ERROR), root @ root.T
    want_x, want_P = Phi @ x, Phi @ P @ Phi.T + 2.0 * Qd
    propagate(x, P, Phi, Qd, 2.0)
    assert x == pytest.approx(want_x, rel=1e-12, abs=1e-12)
    assert np.abs(P - want_P).max() < 1e-12 * np.abs(want_P).max()
    assert np.array_equal(P, P.T)


def test_transition_is_the_exponential_to_second_order_and_the_drift_enters_like_a_bias() -> None:
    nav, _ = nominal()
    noise_model = ProcessNoise(NavigatorConfig())
    matrices = []
    for T in (0.5, 1.0):
        sums = np.zeros(13)
        sums[0:3], sums[3:12], sums[12] = T * np.array([0.3, -0.1, -9.8]), T * nav[6:15], T
        Phi, Qd = np.empty((N_ERROR, N_ERROR)), np.empty((N_ERROR, N_ERROR))
        transition(nav, sums, noise_model.density, noise_model.markov_rate, Phi, Qd)
        matrices.append(Phi)
        assert np.array_equal(Qd, Qd.T) or np.abs(Qd - Qd.T).max() < 1e-18
        assert np.linalg.eigvalsh(Qd).min() > -1e-18
    half, whole = matrices
    size = np.array(
        [1.0] * 3 + [1e-2] * 3 + [1e-5] * 3 + [1e-8] * 3 + [1e-4] * 3 + [1e-8] * 3 + [1e-3, 1e-4]
    )  # of the errors, so that units do not matter
    apart = np.abs(half @ half - whole) * size / size[:, None]
    assert 0.0 < apart.max() < 1e-6  # third order in T
    assert half[6:9, 15:18] == pytest.approx(half[6:9, 9:12], rel=1e-3, abs=1e-9)


def test_markov_noise_is_worth_as_much_as_the_white_noise_that_replaces_it() -> None:
    sigma, tau, period, n = 2.0, 10.0, 5.0, 400
    r = np.exp(-period / tau)
    covariance = sigma**2 * r ** np.abs(np.subtract.outer(np.arange(n), np.arange(n)))
    of_the_mean = 1.0 / np.linalg.solve(covariance, np.ones(n)).sum()
    assert white_inflation(sigma, tau, period) / n == pytest.approx(of_the_mean, rel=0.02)


def test_reported_covariance() -> None:
    rows = slice(0, 2)
    assert reported_covariance_ok(np.zeros((3, 3)), rows)
    assert reported_covariance_ok(np.diag([1.0, 1.0, np.nan]), rows)
    assert not reported_covariance_ok(np.diag([1.0, np.nan, 1.0]), rows)
    assert reported_covariance_ok(np.array([[1.0, 1e-17, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]), rows)
    assert not reported_covariance_ok(np.diag([1.0, -1.0, 1.0]), rows)
    assert not reported_covariance_ok(np.array([[1.0, 0.5, 0.0], [0.1, 1.0, 0.0], [0.0, 0.0, 1.0]]), rows)
    assert noise(np.zeros((3, 3)), np.array([1.0, 2.0, 3.0]), 0.0) == pytest.approx(np.diag([1.0, 4.0, 9.0]))
    assert noise(np.diag([1e-6, 4.0, 9.0]), np.ones(3), 0.5) == pytest.approx(np.diag([0.25, 4.0, 9.0]))


def test_initial_covariance_takes_the_given_one_and_refuses_nonsense() -> None:
    third = np.ones(3)
    given = np.diag(np.arange(1.0, 16.0))
    given[6, 9] = given[9, 6] = 0.5
    state = InitialState(0, 0.7, 0.1, 0.0, 0 * third, 0 * third, third, third, third, covariance=given)
    P = initial_covariance(state, NavigatorConfig())
    assert P[:15, :15] == pytest.approx(given)
    assert len(LABELS) == N_ERROR and LABELS[NavError.PHI_D] == "phi_d [rad]"
    assert state.problem() == ""
    assert "finite" in replace(state, lat=np.nan).problem()
    assert "semidefinite" in replace(state, covariance=given - 5.0 * np.eye(15)).problem()
    assert "positive" in replace(state, covariance=None, sigma_position=0 * third).problem()
    assert "singular" in replace(state, lat=np.pi / 2).problem()


def test_shares_must_conserve_information() -> None:
    assert checked_shares([0.2, 0.3, 0.5]).sum() == pytest.approx(1.0)
    with pytest.raises(ValueError, match="sum to one"):
        checked_shares([0.5, 0.6])
    with pytest.raises(ValueError, match="positive"):
        checked_shares([1.5, -0.5])
