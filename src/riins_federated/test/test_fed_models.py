"""Error states, noise and initial covariance against closed forms; the aids have test_fed_aids.py."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from fed_voyage import config

from riins_core.earth import radii_s
from riins_core.ins_error import State
from riins_core.rotation import dcm_from_euler, exp_so3
from riins_federated.aiding import noise, reported_covariance_ok, white_inflation
from riins_federated.aids import make
from riins_federated.alignment_saved import read_heading
from riins_federated.information_sharing import checked_shares
from riins_federated.state_blocks import StateModel
from riins_federated.types import InitialState

MODELS = config(gps={"use_height": True}, doppler={"use_down": True, "scale_ppm": 1000.0}, inertial={"gyro_markov_deg_h": 0.01})
STATES = StateModel(MODELS.inertial, MODELS.states, make("doppler", MODELS.aid["doppler"]).blocks())


def nominal() -> tuple[np.ndarray, np.ndarray]:
    nav = np.zeros(16)
    nav[0:3] = 0.7, 2.1, 12.0
    nav[3:6] = 5.0, -3.0, 0.2
    nav[6:15] = dcm_from_euler(0.05, -0.03, 2.2).ravel()
    return nav, np.array([1e-6] * 3 + [1e-3] * 3 + [0.0] * 3 + [0.004, 0.001])


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
    STATES.correct(wrong, parameters, x)
    assert wrong[0:2] == pytest.approx(nav[0:2], abs=1e-11)
    assert wrong[2:15] == pytest.approx(nav[2:15], abs=1e-9)


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
    P = STATES.initial_covariance(state)
    assert P[:15, :15] == pytest.approx(given)
    assert len(STATES.labels) == STATES.n == 20 and STATES.labels[State.PHI_D] == "phi_d [rad]"
    assert P[STATES.places["doppler.scale"], STATES.places["doppler.scale"]] == pytest.approx(1e-6)
    assert state.problem() == ""
    assert "finite" in replace(state, lat=np.nan).problem()
    wrong = given.copy()
    wrong[6, 9] = wrong[9, 6] = 20.0
    assert "semidefinite" in replace(state, covariance=wrong).problem()
    assert "negative variance" in replace(state, covariance=np.diag([*np.ones(14), -1e-14])).problem()  # in SI, where a bias is small
    assert "positive" in replace(state, covariance=None, sigma_position=0 * third).problem()
    assert "singular" in replace(state, lat=np.pi / 2).problem()
    assert "longitude" in replace(state, lon=10.0).problem() and "height" in replace(state, h=-1e6).problem()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("heading_deg: .nan\nsigma_deg: 0.1", "holds heading_deg nan (-360 .. 360 is wanted)"),
        ("heading_deg: 4000\nsigma_deg: 0.1", "holds heading_deg 4000 (-360 .. 360 is wanted)"),
        ("heading_deg: 10\nsigma_deg: -0.1", "sigma_deg -0.1 (0 .. 90, not 0)"),
        ("heading_deg: 10\nsigma_deg: .inf", "sigma_deg inf"),
        ("[10, 0.1]", "does not hold heading_deg and sigma_deg"),
        ("heading_deg: [", "does not hold heading_deg and sigma_deg"),
    ],
)
def test_a_saved_heading_that_is_none_is_refused_in_one_line(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "heading.yaml").write_text(text)
    found, words = read_heading(tmp_path / "heading.yaml")
    assert found is None and said in words and "\n" not in words


def test_shares_must_conserve_information() -> None:
    assert checked_shares([0.2, 0.3, 0.5]).sum() == pytest.approx(1.0)
    with pytest.raises(ValueError, match="sum to one"):
        checked_shares([0.5, 0.6])
    with pytest.raises(ValueError, match="positive"):
        checked_shares([1.5, -0.5])
