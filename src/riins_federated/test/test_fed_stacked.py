"""Kernels of stacked filters against the same written in matrices, and each filter alone to the bit."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from riins_core import kalman
from riins_federated.stacked import Stack


def drawn(seed: int, n: int, k: int, m: int):
    """A stack of k different filters of n states, a sparse transition, noise, and a measurement of m components."""
    rng = np.random.default_rng(seed)
    stack = Stack(np.zeros(n), np.eye(n), k)
    stack.X[:] = rng.normal(size=(k, n))
    root = rng.normal(size=(k, n, n))
    stack.P[:] = root @ root.transpose(0, 2, 1)
    Phi = np.eye(n) + rng.normal(size=(n, n)) * (rng.uniform(size=(n, n)) < 0.3)
    square = rng.normal(size=(n, n))
    H = rng.normal(size=(m, n)) * (rng.uniform(size=(m, n)) < 0.5)
    noise = rng.normal(size=(m, m))
    return stack, Phi, square @ square.T, (rng.normal(size=m), H, noise @ noise.T + np.eye(m))


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10**6), n=st.integers(7, 24), k=st.integers(1, 5), m=st.integers(1, 4))
def test_kernels_are_the_filter_in_matrices(seed: int, n: int, k: int, m: int) -> None:
    stack, Phi, Q, measured = drawn(seed, n, k, m)
    scale = np.linspace(0.5, 2.0, k)
    before = stack.snapshot()
    stack.predict(Phi, Q, scale)
    for i in range(k):
        x, P = kalman.predict(before[0][i], before[1][i], Phi, scale[i] * Q)
        assert stack[i].x == pytest.approx(x, rel=1e-12, abs=1e-12)
        assert np.abs(stack[i].P - P).max() < 1e-12 * np.abs(P).max() and np.array_equal(stack[i].P, stack[i].P.T)
    rows, (z, H, R) = np.arange(k)[::-1], measured
    found = stack.judge(rows, z, H, R)
    for r, i in enumerate(rows):
        one = kalman.innovation(*stack[i], z, H, R)
        assert found.z[r] == pytest.approx(one.z, rel=1e-9, abs=1e-9) and found.nis[r] == pytest.approx(one.nis, rel=1e-7)
        assert found.sigma[r] == pytest.approx(np.sqrt(np.diag(one.S)), rel=1e-9)
        assert found.standardized[r] == pytest.approx(one.standardized, rel=1e-6, abs=1e-7)
    information = H[:, :6].T @ np.linalg.solve(R, H[:, :6])
    assert found.information == pytest.approx([np.trace(information[:3, :3]), np.trace(information[3:, 3:])], rel=1e-8)
    before = stack.snapshot()
    stack.update(rows[:-1], z, H, R)
    for i in rows[:-1]:
        x, P, _ = kalman.update(before[0][i], before[1][i], z, H, R)
        assert stack[i].x == pytest.approx(x, rel=1e-8, abs=1e-8) and np.abs(stack[i].P - P).max() < 1e-9 * np.abs(P).max()
    assert np.array_equal(stack[rows[-1]].P, before[1][rows[-1]])  # was not asked for


@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_a_filter_does_not_depend_on_its_neighbours(seed: int) -> None:
    stack, Phi, Q, (z, H, R) = drawn(seed, 19, 5, 2)
    alone = Stack(np.zeros(19), np.eye(19), 1)
    alone.X[0], alone.P[0] = stack[3]
    for one, scale, rows in ((stack, np.array([1.0, 0.0, 2.0, 1.0, 1.0]), np.array([0, 3, 4])), (alone, np.ones(1), np.array([0]))):
        one.predict(Phi, Q, scale)
        one.update(rows, z, H, R)
    assert np.array_equal(stack[3].x, alone[0].x) and np.array_equal(stack[3].P, alone[0].P)


def test_what_cannot_be_judged_is_infinite_and_changes_nothing() -> None:
    stack, _, _, (z, H, R) = drawn(1, 8, 2, 2)
    before = stack.snapshot()
    rows = np.arange(2)
    for wrong in ((np.array([np.nan, 0.0]), H, R), (z, H, R - 1e6 * np.eye(2))):
        assert np.isinf(stack.judge(rows, *wrong).nis).all()
    stack.update(rows, z, H, R - 1e6 * np.eye(2))
    assert np.array_equal(stack.X, before[0]) and np.array_equal(stack.P, before[1])
