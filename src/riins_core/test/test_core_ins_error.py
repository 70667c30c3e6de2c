"""Error dynamics: F against finite differences of the strapdown itself, every column; corrections and differences."""

import numpy as np
import pytest
import scipy.linalg
from core_motion import Motion, Wave, ship_in_waves
from hypothesis import given, settings
from hypothesis import strategies as st

from riins_core import earth
from riins_core import ins_error as ie
from riins_core.rotation import dcm_from_euler, euler_from_dcm
from riins_core.strapdown import StrapdownState, strapdown_block

STEP = np.array([1e3] * 3 + [1.0] * 3 + [1e-4] * 3 + [1e-4] * 3 + [1e-3] * 3)  # perturbation of each state


def test_every_column_of_the_dynamics():
    # a fast, climbing, rolling vehicle, so that no term is small
    wave = ship_in_waves(1, lat=0.9, speed=150.0)
    motion = Motion(wave.lat, wave.lon, Wave(3000.0, 20.0, (0.0,), (1.0,), (0.0,)), wave.roll, wave.pitch, wave.heading)
    dt, m = 0.01, 100
    rate, force = motion.means(1, m, dt)
    middle, _, f = motion.state((np.arange(m) + 0.5) * dt)
    Phi = np.eye(15)
    for nav, f_b in zip(middle, f, strict=True):
        Phi = scipy.linalg.expm(ie.error_dynamics(nav, nav[6:15].reshape(3, 3) @ f_b) * dt) @ Phi

    nav0 = np.zeros(16)
    nav0[:15] = motion.state(0.0)[0][0]

    def run(x):
        nav = nav0.copy()
        ie.correct(nav, -x)  # start with the error x
        strapdown_block(nav, np.zeros(3), np.zeros(3), rate + x[9:12], force + x[12:15], np.full(m, dt), np.zeros(3), np.zeros(3), np.zeros(13))
        return nav

    clean = run(np.zeros(15))
    numeric = np.empty((9, 15))
    for j in range(15):
        x = np.zeros(15)
        x[j] = STEP[j]
        numeric[:, j] = (ie.difference(run(x), clean) - ie.difference(run(-x), clean)) / (2 * STEP[j])
    change = np.abs(Phi[:9] - np.eye(15)[:9])
    for j in range(15):
        # relative to the largest change of the column, for biases of the triad; position, velocity and attitude rows apart
        columns = slice(j, j + 1) if j < 9 else slice(9 + (j - 9) // 3 * 3, 12 + (j - 9) // 3 * 3)
        for rows in (ie.POS, ie.VEL, ie.PHI):
            error = np.max(np.abs(numeric[rows, j] - Phi[rows, j]))
            assert error <= 1e-4 * np.max(change[rows, columns]) + 1e-13, (ie.State(j).name, rows)


def test_named_elements():
    # the elements the thesis has wrong, at a place and speed where they are easy to write down
    lat, h, v = 0.6, 100.0, np.array([10.0, 5.0, 0.0])
    r_n = float(earth.radii(lat)[1]) + h
    F = np.zeros((20, 20))
    F[15:, :] = 7.0
    g = float(earth.gravity(lat, h))
    ie.fill_dynamics(F, lat, h, v, np.array([0.0, 0.0, -g]), np.eye(3))
    S = ie.State
    assert F[S.PHI_D, S.VEL_E] == pytest.approx(-np.tan(lat) / r_n)
    assert F[S.PHI_N, S.POS_D] == pytest.approx(v[1] / r_n**2)  # by dD = -dh
    assert F[S.VEL_D, S.POS_D] == pytest.approx(2 * g / earth.A, rel=0.01)  # downward unstable
    assert F[S.VEL_N, S.PHI_E] == pytest.approx(g)  # nose-up error of the platform seen as acceleration
    assert F[S.VEL_E, S.PHI_N] == pytest.approx(-g)
    np.testing.assert_array_equal(F[9:15, :15], 0.0)
    np.testing.assert_array_equal(F[15:], 7.0)
    np.testing.assert_array_equal(F[ie.PHI, ie.BG], -np.eye(3))
    np.testing.assert_array_equal(F[ie.VEL, ie.BA], np.eye(3))


def test_fill_dynamics_overwrites_what_was_there():
    F = np.full((15, 15), np.nan)
    ie.fill_dynamics(F, 0.3, 0.0, np.ones(3), np.ones(3), np.eye(3))
    assert np.all(np.isfinite(F))


def test_schuler_mode_is_an_eigenvalue():
    nav = np.zeros(16)
    nav[0] = 0.7
    nav[6:15] = np.eye(3).ravel()
    g, r = float(earth.gravity(0.7, 0.0)), float(earth.radii(0.7)[0])
    F = ie.error_dynamics(nav, [0.0, 0.0, -g])
    horizontal = [0, 1, 3, 4, 6, 7, 8]
    frequencies = np.abs(np.linalg.eigvals(F[np.ix_(horizontal, horizontal)]).imag)
    foucault = earth.OMEGA_IE * np.sin(0.7)  # splits the Schuler frequency
    np.testing.assert_allclose(np.max(frequencies), np.sqrt(g / r) + foucault, rtol=2e-3)
    assert np.min(np.abs(frequencies - earth.OMEGA_IE)) < 1e-3 * earth.OMEGA_IE  # the 24 h mode


def test_heading_error_sign():
    nav = StrapdownState(0.5, 1.0, 0.0, [1.0, 2.0, 0.0], dcm_from_euler(0.02, 0.01, 1.0)).nav
    wrong = nav.copy()
    x = np.zeros(15)
    x[ie.State.PHI_D] = 1e-3
    ie.correct(wrong, -x)
    change = float(euler_from_dcm(wrong[6:15].reshape(3, 3))[2]) - 1.0
    assert change == pytest.approx(-1e-3, rel=0.01)  # computed - true heading = -phi_D
    computed = (np.eye(3) - np.array([[0, -1e-3, 0], [1e-3, 0, 0], [0, 0, 0]])) @ nav[6:15].reshape(3, 3)
    np.testing.assert_allclose(wrong[6:15].reshape(3, 3), computed, atol=1e-6)


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 10**6), st.floats(-1.2, 1.2))
def test_correct_removes_the_difference(seed, lat):
    rng = np.random.default_rng(seed)
    true = StrapdownState(lat, -np.pi + 1e-7, 20.0, rng.normal(size=3), dcm_from_euler(*rng.uniform(-1, 1, 3))).nav
    x = rng.normal(size=9) * np.array([30.0] * 3 + [1.0] * 3 + [0.01] * 3)
    nav = true.copy()
    ie.correct(nav, -x)
    e = ie.difference(nav, true)
    np.testing.assert_allclose(e, x, rtol=1e-3, atol=1e-3)
    np.testing.assert_allclose(e[6:9], x[6:9], rtol=1e-8, atol=1e-12)
    ie.correct(nav, e)
    np.testing.assert_allclose(nav[3:15], true[3:15], atol=1e-12)
    np.testing.assert_allclose(ie.difference(nav, true)[:3], 0.0, atol=1e-3)


def test_difference_of_equal_states_is_zero():
    nav = StrapdownState(0.5, 1.0, 0.0, [1.0, 2.0, 0.0], dcm_from_euler(0.02, 0.01, 1.0)).nav
    np.testing.assert_allclose(ie.difference(nav, nav), 0.0, atol=1e-15)


def test_correct_refuses_another_layout():
    with pytest.raises(ValueError, match="16 elements"):
        ie.correct(np.zeros(15), np.zeros(15))


def test_noise_input_follows_the_biases():
    # white noise enters where a bias does
    nav = StrapdownState(0.5, 1.0, 0.0, [1.0, 2.0, 0.0], dcm_from_euler(0.02, 0.01, 1.0)).nav
    F, G = ie.error_dynamics(nav, [0.0, 0.0, -9.8]), ie.noise_input(nav[6:15].reshape(3, 3))
    np.testing.assert_array_equal(G, F[:, 9:15])
