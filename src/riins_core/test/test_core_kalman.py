"""Kalman filter: closed forms, equivalence of the Joseph, information and kernel forms, and refusal of what is not positive definite."""

import numpy as np
import pytest
import scipy.stats
from hypothesis import given, settings
from hypothesis import strategies as st

from riins_core import kalman

few = settings(max_examples=40, deadline=None)
sizes = st.tuples(st.integers(0, 10**6), st.integers(1, 8), st.integers(1, 4))


def problem(seed, n, m):
    rng = np.random.default_rng(seed)
    a, b = rng.normal(size=(n, n)), rng.normal(size=(m, m))
    P, R = a @ a.T + 0.1 * np.eye(n), b @ b.T + 0.1 * np.eye(m)
    return rng.normal(size=n), P, rng.normal(size=m), rng.normal(size=(m, n)), R


def test_scalar_update():
    x, P, nu = kalman.update(np.array([1.0]), np.array([[4.0]]), np.array([4.0]), np.eye(1), np.array([[12.0]]))
    assert (x[0], P[0, 0]) == pytest.approx((1.75, 3.0))
    assert (nu.z[0], nu.S[0, 0], nu.standardized[0], nu.nis) == pytest.approx((3.0, 16.0, 0.75, 0.5625))


@few
@given(sizes)
def test_update_equals_the_textbook_and_the_information_form(size):
    x, P, z, H, R = problem(*size)
    x1, P1, nu = kalman.update(x, P, z, H, R)
    S = H @ P @ H.T + R
    K = P @ H.T @ np.linalg.inv(S)
    np.testing.assert_allclose(x1, x + K @ (z - H @ x), rtol=1e-8, atol=1e-8)
    np.testing.assert_allclose(P1, P - K @ S @ K.T, rtol=1e-7, atol=1e-8)
    np.testing.assert_array_equal(P1, P1.T)
    assert nu.nis == pytest.approx((z - H @ x) @ np.linalg.solve(S, z - H @ x), rel=1e-8)
    assert nu.nis == pytest.approx(nu.standardized @ nu.standardized)
    y, Y = kalman.to_information(x, P)
    dy, dY = kalman.information_increment(z, H, R)
    x2, P2 = kalman.from_information(y + dy, Y + dY)
    np.testing.assert_allclose(x2, x1, rtol=1e-6, atol=1e-7)
    np.testing.assert_allclose(P2, P1, rtol=1e-6, atol=1e-7)


@few
@given(sizes)
def test_kernels_equal_the_plain_functions(size):
    x, P, z, H, R = problem(*size)
    n, m = x.size, z.size
    rng = np.random.default_rng(size[0])
    Phi, Q = rng.normal(size=(n, n)) * (rng.random((n, n)) < 0.5), 0.1 * np.eye(n)
    x1, P1 = kalman.predict(x, P, Phi, Q)
    x2, P2, _ = kalman.update(x1, P1, z, H, R)
    nu = kalman.innovation(x1, P1, z, H, R)
    xk, Pk = x.copy(), P.copy()
    dz, S, standardized = np.empty(m), np.empty((m, m)), np.empty(m)
    kalman.predict_into(xk, Pk, Phi, Q)
    np.testing.assert_allclose(xk, x1, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(Pk, P1, rtol=1e-12, atol=1e-12)
    assert kalman.update_joseph(xk, Pk, z, H, R, dz, S, standardized)
    np.testing.assert_allclose(xk, x2, rtol=1e-8, atol=1e-9)
    np.testing.assert_allclose(Pk, P2, rtol=1e-8, atol=1e-9)
    np.testing.assert_array_equal(Pk, Pk.T)
    np.testing.assert_allclose(dz, nu.z, atol=1e-12)
    np.testing.assert_allclose(S, nu.S, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(standardized, nu.standardized, rtol=1e-9, atol=1e-10)


@few
@given(st.integers(0, 10**6))
def test_scalar_measurements_one_by_one_equal_the_vector(seed):
    x, P, z, H, _ = problem(seed, 6, 3)
    R = np.diag([0.5, 1.0, 2.0])
    x1, P1, _ = kalman.update(x, P, z, H, R)
    for i in range(3):
        x, P, _ = kalman.update(x, P, z[i : i + 1], H[i : i + 1], R[i : i + 1, i : i + 1])
    np.testing.assert_allclose(x, x1, rtol=1e-7, atol=1e-8)
    np.testing.assert_allclose(P, P1, rtol=1e-7, atol=1e-8)


@pytest.mark.parametrize("kernel", [False, True])
def test_joseph_form_survives_an_exact_measurement_of_a_huge_covariance(kernel):
    # P - K S K' goes negative here
    n = 6
    P, H, R = 1e10 * np.ones((n, n)) + np.diag(np.arange(1.0, n + 1)), np.ones((1, n)), np.array([[1e-6]])
    x = np.zeros(n)
    for _ in range(5):
        if kernel:
            assert kalman.update_joseph(x, P, np.ones(1), H, R, np.empty(1), np.empty((1, 1)), np.empty(1))
        else:
            x, P, _ = kalman.update(x, P, np.ones(1), H, R)
    assert np.linalg.eigvalsh(P)[0] > 0.0


def test_constant_measured_often_is_the_mean():
    rng = np.random.default_rng(3)
    z = 5.0 + rng.normal(size=400)
    x, P = np.zeros(1), np.array([[1e8]])
    for value in z:
        x, P, _ = kalman.update(x, P, np.array([value]), np.eye(1), np.eye(1))
    assert x[0] == pytest.approx(np.mean(z), abs=1e-6)
    assert P[0, 0] == pytest.approx(1 / 400, rel=1e-6)


def test_innovations_of_the_right_model_are_white_and_of_unit_variance():
    # random walk seen in noise, at the closed-form steady state P = (q + sqrt(q^2 + 4 q r)) / 2 of the prediction
    q, r, n = 0.04, 1.0, 20000
    rng = np.random.default_rng(4)
    truth = np.cumsum(np.sqrt(q) * rng.normal(size=n))
    z = truth + np.sqrt(r) * rng.normal(size=n)
    x, P = np.zeros(1), np.array([[1.0]])
    H, R, Q = np.eye(1), np.array([[r]]), np.array([[q]])
    s = np.empty(n)
    for k in range(n):
        x, P = kalman.predict(x, P, np.eye(1), Q)
        prior = P[0, 0]
        x, P, nu = kalman.update(x, P, z[k : k + 1], H, R)
        s[k] = nu.standardized[0]
    assert prior == pytest.approx((q + np.sqrt(q * q + 4 * q * r)) / 2, rel=1e-9)
    assert np.sum(s**2) == pytest.approx(n, abs=4.5 * np.sqrt(2 * n))
    assert abs(np.mean(s[1:] * s[:-1])) < 4.5 / np.sqrt(n)
    assert scipy.stats.kstest(s, "norm").pvalue > 1e-4


def test_van_loan_closed_forms():
    # double integrator driven by white acceleration, and a Gauss-Markov process
    q, dt, tau = 0.3, 0.7, 2.0
    Phi, Q = kalman.van_loan(np.array([[0.0, 1.0], [0.0, 0.0]]), np.diag([0.0, q]), dt)
    np.testing.assert_allclose(Phi, [[1.0, dt], [0.0, 1.0]], atol=1e-15)
    np.testing.assert_allclose(Q, q * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]]), rtol=1e-13)
    Phi, Q = kalman.van_loan(np.array([[-1 / tau]]), np.array([[2.0 / tau]]), dt)
    assert Phi[0, 0] == pytest.approx(np.exp(-dt / tau))
    assert Q[0, 0] == pytest.approx(1.0 - np.exp(-2 * dt / tau))


@few
@given(st.integers(0, 10**6), st.integers(1, 6))
def test_van_loan_two_half_steps_are_one(seed, n):
    rng = np.random.default_rng(seed)
    F, g = rng.normal(size=(n, n)), rng.normal(size=(n, n))
    Phi, Q = kalman.van_loan(F, g @ g.T, 0.4)
    half, q = kalman.van_loan(F, g @ g.T, 0.2)
    np.testing.assert_allclose(half @ half, Phi, rtol=1e-9, atol=1e-10)
    np.testing.assert_allclose(half @ q @ half.T + q, Q, rtol=1e-8, atol=1e-9)


@pytest.mark.parametrize("bad", [-1.0, np.nan, np.inf])
def test_what_is_not_positive_definite_is_refused(bad):
    x, P, z, H, R = np.zeros(2), np.eye(2), np.zeros(1), np.array([[1.0, 0.0]]), np.array([[bad - 1.0]])
    with pytest.raises(kalman.NotPositiveDefinite, match="innovation covariance"):
        kalman.update(x, P, z, H, R)
    x0, P0, standardized = np.array([3.0, 4.0]), np.eye(2), np.ones(1)
    assert not kalman.update_joseph(x0, P0, z, H, R, np.empty(1), np.empty((1, 1)), standardized)
    np.testing.assert_array_equal(x0, [3.0, 4.0])
    np.testing.assert_array_equal(P0, np.eye(2))
    assert standardized[0] == 0.0
    with pytest.raises(kalman.NotPositiveDefinite, match="the covariance"):
        kalman.to_information(x, np.diag([1.0, bad]))
