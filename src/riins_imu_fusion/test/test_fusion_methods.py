"""WLS, OPT, AOPT, OPTDC: identities, statistics, masks, blocks and roll-back."""

import numpy as np
import pytest

from riins_core import kalman
from riins_core.imu_array import CONFIGURATIONS, ImuArray
from riins_imu_fusion.adaptive import AdaptiveFusion, AdaptiveSettings, fade
from riins_imu_fusion.drift_compensated import CompensationSettings, DriftCompensatedFusion, drift_factor
from riins_imu_fusion.method import TriadModel
from riins_imu_fusion.methods import METHODS, make
from riins_imu_fusion.optimal import OptimalFusion
from riins_imu_fusion.wls import WeightedLeastSquares

ARRAY = ImuArray(CONFIGURATIONS["dodecahedron"])
SIGMA = np.array([1.0, 1.5, 0.8, 1.0, 2.0, 1.2])
TOLD = TriadModel(ARRAY, SIGMA, drift=[5.0, 0.1, 0.1, 3.0, 0.1, 0.1], walk=[0.3, 0.01, 0.01, 0.2, 0.01, 0.01], dt=0.05)


def simulate(model: TriadModel, m: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Truth (m, 3) and readings (m, n) drawn from the model."""
    rng = np.random.default_rng(seed)
    n = model.array.n
    truth = 10.0 * rng.standard_normal((m, 3))
    drift = np.sqrt(model.P) * rng.standard_normal(n) + np.cumsum(np.sqrt(model.Q) * rng.standard_normal((m, n)), axis=0)
    return truth, truth @ model.array.H.T + drift + np.sqrt(model.R) * rng.standard_normal((m, n))


def test_wls_is_the_weighted_estimate_of_any_subset() -> None:
    _, z = simulate(TOLD, 50, 1)
    for mask in (0b111111, 0b011011, 0b100111):
        out = WeightedLeastSquares(TriadModel(ARRAY, SIGMA)).process(z, mask)
        index = ARRAY.used(mask)
        H, Ri = ARRAY.H[index], np.diag(SIGMA[index] ** -2.0)
        P = np.linalg.inv(H.T @ Ri @ H)
        np.testing.assert_allclose(out.x, z[:, index] @ (P @ H.T @ Ri).T, rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(out.covariance, np.broadcast_to(P, (50, 3, 3)), rtol=1e-12)


def test_optimal_is_the_joint_estimate_of_drifts_and_an_unknown_input() -> None:
    """Lemma 2: the same as a filter on the readings themselves in which the input has no prior (variance 1e8)."""
    _, z = simulate(TOLD, 60, 2)
    out = OptimalFusion(TOLD).process(z)
    x, P = np.zeros(9), np.diag(np.r_[TOLD.P, 0.0, 0.0, 0.0])
    H = np.column_stack([np.eye(6), ARRAY.H])
    for k in range(60):
        P[np.arange(6), np.arange(6)] += TOLD.Q
        P[6:], P[:, 6:] = 0.0, 0.0
        P[6:, 6:] = 1e8 * np.eye(3)
        x[6:] = 0.0
        x, P, _ = kalman.update(x, P, z[k], H, np.diag(TOLD.R))
        np.testing.assert_allclose(out.x[k], x[6:], atol=2e-4)
        np.testing.assert_allclose(out.drift[k], x[:6], atol=2e-4)
        np.testing.assert_allclose(out.covariance[k], P[6:, 6:], rtol=1e-3, atol=1e-3)


def test_optimal_with_equal_models_is_least_squares() -> None:
    for walk in (0.0, 0.7):
        model = TriadModel(ARRAY, 1.0, drift=3.0, walk=walk)
        _, z = simulate(model, 500, 3)
        opt, wls = OptimalFusion(model).process(z), WeightedLeastSquares(model).process(z)
        np.testing.assert_allclose(opt.x, wls.x, atol=1e-9)
        np.testing.assert_allclose(opt.covariance, wls.covariance, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("name", ["wls", "opt", "optdc"])
def test_errors_are_as_large_as_the_covariance_says(name: str) -> None:
    nees = []
    for seed in range(200):
        truth, z = simulate(TOLD, 40, seed)
        out = make(name, TOLD).process(z)
        e = out.x[-1] - truth[-1]
        nees.append(e @ np.linalg.solve(out.covariance[-1], e))
    assert abs(np.mean(nees) - 3.0) < 4.0 * np.sqrt(6.0 / 200.0)  # chi-square with 3 degrees of freedom


def test_told_the_truth_optimal_beats_least_squares_and_told_wrongly_it_loses() -> None:
    wrong = TriadModel(ARRAY, SIGMA, np.sqrt(np.roll(TOLD.P, 1)), np.sqrt(np.roll(TOLD.Q, 1)))
    square = np.zeros(3)
    for seed in range(100):
        truth, z = simulate(TOLD, 100, seed)
        for i, method in enumerate((WeightedLeastSquares(TOLD), OptimalFusion(TOLD), OptimalFusion(wrong))):
            square[i] += np.sum((method.process(z).x - truth) ** 2)
    assert square[1] < 0.2 * square[0]
    assert square[2] > 1.1 * square[0]


def test_compensation_changes_readings_not_the_fused_output() -> None:
    _, z = simulate(TOLD, 3000, 5)
    opt = OptimalFusion(TOLD).process(z)
    for gain in (0.0, 5.0, 1000.0):
        out = DriftCompensatedFusion(TOLD, CompensationSettings(gain)).process(z)
        np.testing.assert_allclose(out.x, opt.x, atol=1e-8)
        np.testing.assert_allclose(out.drift, opt.drift, atol=1e-8)
        assert np.all(out.compensation[0] == 0.0)
        left = np.abs(out.drift[-1] - out.compensation[-1])[[0, 3]]
        assert np.all(left > np.abs(opt.drift[-1][[0, 3]]) - 1e-9) if gain == 0.0 else np.all(left < 0.2 * np.abs(opt.drift[-1][[0, 3]]))


def test_drift_factor_is_a_share_and_equal_where_nothing_is_known() -> None:
    alpha = np.empty(6)
    drift_factor(np.zeros(6), np.zeros(6), np.ones(6), alpha)
    np.testing.assert_allclose(alpha, 1.0 / 6.0)
    drift_factor(np.arange(6.0), np.ones(6), np.array([1.0, -1.0, 1.0, -2.0, 1.0, 1.0]), alpha)
    np.testing.assert_allclose(alpha, np.array([0.0, 1.0, 2.0, 6.0, 4.0, 5.0]) / 18.0)


def test_fading_multiplies_what_the_parity_sees_and_nothing_else() -> None:
    rng = np.random.default_rng(6)
    A = rng.standard_normal((6, 6))
    P0 = A @ A.T
    V = ARRAY.parity()
    P = P0.copy()
    fade(P, V, 7.0)
    np.testing.assert_allclose(P @ V.T, 7.0 * P0 @ V.T, rtol=1e-12, atol=1e-12)
    K = P0 @ V.T @ np.linalg.inv(V @ P0 @ V.T)
    hidden = np.eye(6) - K @ V
    np.testing.assert_allclose(hidden @ P @ hidden.T, hidden @ P0 @ hidden.T, atol=1e-12)


def test_adaptive_marks_the_drifting_sensor_untold_but_is_no_isolation() -> None:
    """One drift of 12 sigma, equal P and Q: found as the largest, a few per cent better than least squares, no more; the covariance stays bounded."""
    model = TriadModel(ARRAY, 1.0, drift=0.3, walk=0.05)
    better = []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        z = np.array([12.0, 0.0, 0.0, 0.0, 0.0, 0.0]) + rng.standard_normal((3000, 6))
        method = AdaptiveFusion(model)
        out = method.process(z)
        better.append(np.linalg.norm(out.x[-500:].mean(0)) / np.linalg.norm((z @ ARRAY.least_squares().T)[-500:].mean(0)))
        assert np.all(np.isfinite(out.x)) and np.sqrt(np.max(np.diagonal(out.covariance[-1]))) < 1000.0
        assert np.argmax(np.abs(out.drift[-1])) == 0
        assert np.all(method.process_noise >= 0.0)
    assert 0.9 < np.mean(better) < 1.0


def test_adaptive_without_new_information_is_the_optimal_filter() -> None:
    """b -> 1 with a long past, and no fading: Q stays what it was."""
    method = AdaptiveFusion(TOLD, AdaptiveSettings(forgetting=1.0 - 1e-9, softening=100.0))
    _, z = simulate(TOLD, 200, 7)
    method._state[3][1] = 1e12  # as if fed for ever: d_k = 1e-9
    np.testing.assert_allclose(method.process(z).x, OptimalFusion(TOLD).process(z).x, atol=1e-5)


@pytest.mark.parametrize("name", METHODS)
def test_blocks_masks_and_roll_back(name: str) -> None:
    """However samples are split, with sensors coming, going and failing: the same bits; a copy goes on alone."""
    _, z = simulate(TOLD, 300, 8)
    mask = np.full(300, 0b111111, dtype=np.uint64)
    mask[50:90] = 0b111101
    mask[120:130] = 0b000111  # no redundancy
    mask[140:142] = 0b000011  # no solution
    z[200, 2] = np.nan
    z[60, 1] = np.nan
    whole = make(name, TOLD).process(z, mask)
    method, parts, kept = make(name, TOLD), [], None
    for edge in ((0, 1), (1, 55), (55, 141), (141, 202), (202, 300)):
        if edge[0] == 141:
            kept = method.copy()
        parts.append(method.process(z[slice(*edge)], mask[slice(*edge)]))
    for i, array in enumerate(whole):
        assert np.array_equal(array, np.concatenate([part[i] for part in parts]), equal_nan=True)
    assert kept is not None
    again = kept.process(z[141:], mask[141:])
    assert np.array_equal(again.x, whole.x[141:], equal_nan=True)
    assert np.all(np.isnan(whole.x[140:142])) and np.all(np.isfinite(np.delete(whole.x, [140, 141], axis=0)))
    junk = z.copy()
    junk[50:90, 1] = 1e9  # a sensor that is not used has no say
    assert np.array_equal(make(name, TOLD).process(junk, mask).x, whole.x, equal_nan=True)
    method.reset()
    assert np.array_equal(method.process(z, mask).x, whole.x, equal_nan=True)


def test_refusals() -> None:
    with pytest.raises(ValueError, match='no fusion method "best"; there are wls, opt'):
        make("best", TOLD)
    with pytest.raises(ValueError, match="one value or 6"):
        TriadModel(ARRAY, [1.0, 2.0])
    with pytest.raises(ValueError, match="positive"):
        TriadModel(ARRAY, 0.0)
    with pytest.raises(ValueError, match=r"readings must be \(m, 6\)"):
        make("wls", TOLD).process(np.zeros((4, 5)))
