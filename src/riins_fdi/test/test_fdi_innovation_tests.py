"""Innovation tests: false alarms as often as asked, delays on a ramp in the order of target 41, blocks, copies, bad input; tests on the state."""

from __future__ import annotations

import numpy as np
import pytest

from riins_core import kalman
from riins_fdi.eraim import cross_check, eigen_into, eraim_statistic, protection_levels, quantiles, separation_into
from riins_fdi.innovation import nis_threshold
from riins_fdi.innovation_tests import INNOVATION_TESTS, ImprovedChiSquare, Mewma, Nis
from riins_fdi.innovation_thresholds import averaged_alarm_rate, improved_statistic, mewma_run_length

NAMES = sorted(INNOVATION_TESTS)
DOF = 3


@pytest.mark.parametrize("name", NAMES)
def test_false_alarms_come_as_often_as_asked(name: str) -> None:
    """Target 40: 600 h at 1 Hz, one alarm an hour."""
    epochs = 3600.0
    test = INNOVATION_TESTS[name](DOF, epochs)
    rng = np.random.default_rng(40)
    count = sum(int(test.process(rng.standard_normal((36_000, DOF)))[1].sum()) for _ in range(60))
    assert 0.5 * 600 <= count <= 2.0 * 600


@pytest.mark.parametrize("name", NAMES)
def test_blocks_steps_and_copies_change_nothing(name: str) -> None:
    u = np.random.default_rng(3).standard_normal((700, DOF)) + np.linspace(0.0, 1.0, 700)[:, None]
    whole, alarms = INNOVATION_TESTS[name](DOF, 1e4).process(u)
    assert alarms.any()
    test = INNOVATION_TESTS[name](DOF, 1e4)
    parts = [test.process(part)[0] for part in (u[:1], u[1:250])]
    copy = test.clone()
    stepped = np.array([test.step(row).statistic for row in u[250:]])
    np.testing.assert_array_equal(np.concatenate([*parts, stepped]), whole)
    np.testing.assert_array_equal(copy.process(u[250:])[0], stepped)
    copy.reset()
    np.testing.assert_array_equal(copy.process(u)[0], whole)


@pytest.mark.parametrize("name", NAMES)
def test_what_is_not_finite_is_an_alarm_and_leaves_the_state(name: str) -> None:
    u = np.random.default_rng(4).standard_normal((80, DOF))
    test, other = INNOVATION_TESTS[name](DOF, 1e5), INNOVATION_TESTS[name](DOF, 1e5)
    test.process(u[:40])
    assert test.step([0.0, np.nan, 0.0]).alarm and test.step([0.0, np.inf, 0.0], np.eye(DOF)).alarm
    other.process(u[:40])
    np.testing.assert_array_equal(test.process(u[40:])[0], other.process(u[40:])[0])
    with pytest.raises(ValueError, match="components"):
        test.process(np.zeros((2, DOF + 1)))
    with pytest.raises(ValueError, match="positive definite"):
        test.step(np.zeros(DOF), -np.eye(DOF))


def test_a_covariance_standardizes() -> None:
    S = np.array([[4.0, 1.0], [1.0, 9.0]])
    dz = np.array([3.0, -2.0])
    assert Nis(2, 1e4).step(dz, S).statistic == pytest.approx(dz @ np.linalg.solve(S, dz), rel=1e-12)


FOLLOW = 60.0
"""Time constant, epochs, with which a Kalman filter follows a faulty aid: what is left in the innovation of a ramp levels off."""


def mean_delay(name: str, slope: float, runs: int = 150) -> float:
    """Mean delay [epochs] on a ramp of `slope` sigma an epoch in the first component, 36000 epochs between false alarms."""
    test = INNOVATION_TESTS[name](DOF, 36_000.0)
    rng = np.random.default_rng(41)
    shift = slope * FOLLOW * -np.expm1(-np.arange(1, 401) / FOLLOW)
    delays = []
    for _ in range(runs):
        test.reset()
        u = rng.standard_normal((500, DOF))
        u[100:, 0] += shift
        alarm = test.process(u)[1][100:]
        delays.append(np.argmax(alarm) + 1.0 if alarm.any() else 400.0)
    return float(np.mean(delays))


def test_a_ramp_is_found_sooner_by_tests_over_many_epochs() -> None:
    """Target 41 at 10 h and 1 Hz; the slope costs the chi-square 58 epochs."""
    slope = 0.083
    chi_square = mean_delay("nis", slope)
    assert chi_square == pytest.approx(58.0, abs=4.0)
    assert 0.60 <= mean_delay("improved", slope) / chi_square <= 0.78
    for name in ("mewma", "averaged", "windowed_glr", "cusum"):
        assert 0.30 <= mean_delay(name, slope) / chi_square <= 0.48


def test_thresholds_agree_with_what_is_known() -> None:
    assert mewma_run_length(8.66, 2, 0.1) == pytest.approx(200.0, rel=0.03)  # Lowry et al. 1992: h = 8.66 for a run length of 200
    assert mewma_run_length(13.8, 2, 1.0) == pytest.approx(np.exp(6.9), rel=1e-3)  # weight 1 is the chi-square
    assert averaged_alarm_rate(20.0, 2, [1]) == pytest.approx(np.exp(-10.0), rel=1e-9)  # length 1 too
    u = np.random.default_rng(5).standard_normal((50, 2))
    test = ImprovedChiSquare(2, threshold=1e9)
    np.testing.assert_allclose(test.process(u)[0][3:], improved_statistic(u, test.kept, test.membership, test.relief), rtol=1e-12)
    with pytest.raises(ValueError):
        Mewma(2, 0.5)
    with pytest.raises(ValueError):
        Mewma(2, 1e4, 0.0)


def _system(seed: int) -> tuple[np.ndarray, ...]:
    rng = np.random.default_rng(seed)
    n, m = 6, 2
    A = rng.standard_normal((n, n))
    units = 10.0 ** rng.uniform(-5.0, 3.0, n)
    P = (A @ A.T + 0.1 * np.eye(n)) * np.outer(units, units)
    H = rng.standard_normal((m, n)) / units
    return rng.standard_normal(n) * units, P, rng.standard_normal(m) * 3.0, H, np.diag(rng.uniform(0.1, 2.0, m))


@pytest.mark.parametrize("seed", range(20))
def test_extended_raim_is_the_nis(seed: int) -> None:
    """Target 44."""
    x, P, z, H, R = _system(seed)
    assert eraim_statistic(x, P, z, H, R) == pytest.approx(kalman.innovation(x, P, z, H, R).nis, rel=1e-9)


HORIZONTAL = np.array([0, 1])


def _separated(x_all: np.ndarray, P_all: np.ndarray, x_loo: np.ndarray, P_loo: np.ndarray) -> tuple[float, int, np.ndarray]:
    """Statistic, degrees of freedom and covariance of the kernel."""
    D = np.empty((2, 2))
    return *separation_into(x_all, P_all, x_loo, P_loo, HORIZONTAL, D), D


def _level(x_all: np.ndarray, P_all: np.ndarray, x_loo: np.ndarray, P_loo: np.ndarray, risk: float) -> float:
    """Horizontal protection level at a false-alarm probability of 1 %."""
    return float(protection_levels(np.array([x_all, x_loo]), np.array([P_all, P_loo]), np.array([1]), HORIZONTAL, -1, *quantiles(0.01, risk, 1))[0])


def test_separation_has_the_covariance_it_says() -> None:
    """Two filters, one without the second aid: the statistic in matrices, mean 2, alarms as asked, and a level the error keeps to."""
    rng = np.random.default_rng(6)
    P0, R1, R2 = np.diag([400.0, 100.0]), np.array([[900.0, 300.0], [300.0, 900.0]]), np.diag([100.0, 100.0])
    root = np.linalg.cholesky(R1)
    statistics, beyond = [], 0
    for _ in range(2000):
        truth = rng.standard_normal(2) * np.sqrt(np.diag(P0))
        z1, z2 = truth + root @ rng.standard_normal(2), truth + 10.0 * rng.standard_normal(2)
        x1, P1, _ = kalman.update(np.zeros(2), P0, z1, np.eye(2), R1)
        x2, P2, _ = kalman.update(x1, P1, z2, np.eye(2), R2)
        statistic, dof, D = _separated(x2, P2, x1, P1)
        assert dof == 2 and pytest.approx(P1 - P2, rel=1e-9) == D
        assert statistic == pytest.approx((x2 - x1) @ np.linalg.solve(P1 - P2, x2 - x1), rel=1e-9)
        statistics.append(statistic)
        beyond += np.linalg.norm(x2 - truth) > _level(x2, P2, x1, P1, 0.01)
    assert np.mean(statistics) == pytest.approx(2.0, abs=0.15)
    assert 8 <= np.sum(np.array(statistics) > nis_threshold(0.01, 2)) <= 35 and beyond <= 20
    assert _separated(x1, P1, x1, P1)[:2] == (0.0, 0)  # nothing can be tested where one has just taken the place of the other
    assert np.isnan(_separated(np.array([np.nan, 0.0]), P2, x1, P1)[0])  # which passes no threshold
    with pytest.raises(ValueError):
        quantiles(0.01, 0.0, 1)
    # of one's own noise where nothing is apart, and never below what is found apart
    own = np.sqrt(-2.0 * np.log(0.01) * np.linalg.eigvalsh(P1)[-1])
    assert _level(x1, P1, x1, P1, 0.01) == pytest.approx(own)
    assert _level(np.add(x1, [500.0, 0.0]), P2, x1, P1, 0.01) == pytest.approx(500.0 + own)


def test_small_eigenvalues() -> None:
    rng = np.random.default_rng(8)
    for m in (1, 2, 7):
        A = rng.standard_normal((m, m))
        A = (A + A.T) * np.outer(10.0 ** -np.arange(m), 10.0 ** -np.arange(m))
        D, V = A.copy(), np.empty((m, m))
        eigen_into(D, V)
        assert (V * np.diag(D)) @ V.T == pytest.approx(A, abs=1e-15) and V.T @ V == pytest.approx(np.eye(m), abs=1e-13)
        assert np.sort(np.diag(D)) == pytest.approx(np.linalg.eigvalsh(A), abs=1e-14)


def test_one_satellite_system_against_another() -> None:
    R = 900.0 * np.eye(2)
    statistic, threshold, alarm = cross_check([300.0, 0.0], R, [0.0, 0.0], R, 1e-5)
    assert statistic == pytest.approx(50.0) and threshold == pytest.approx(-2.0 * np.log(1e-5)) and alarm
    assert not cross_check([30.0, 0.0], R, [0.0, 0.0], R, 1e-5)[2]
