"""`glr_kf`: any geometry, blocks, false alarms, one and two drifts, what parity cannot see, recall, cost."""

from __future__ import annotations

import itertools
import time

import numpy as np
import pytest

from riins_core.imu_array import CONFIGURATIONS, ImuArray
from riins_imu_fusion import glr_kf_state as G
from riins_imu_fusion.glr_kf import GlrKalman, GlrSettings, alarm_threshold
from riins_imu_fusion.method import TriadModel
from riins_imu_fusion.wls import WeightedLeastSquares

SIX = ImuArray(CONFIGURATIONS["dodecahedron"])


def cone(n: int) -> ImuArray:
    turn = 2.0 * np.pi * np.arange(n) / n
    return ImuArray(np.column_stack([np.sin(0.95) * np.cos(turn), np.sin(0.95) * np.sin(turn), np.full(n, np.cos(0.95))]))


def model(array: ImuArray = SIX, bias: float = 1.0) -> TriadModel:
    """Unit noise, 100 Hz."""
    return TriadModel(array, 1.0, bias, 0.0, 0.01)


def noise(m: int, seed: int, array: ImuArray = SIX) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return rng.standard_normal((m, array.n)) + rng.standard_normal(array.n)


def test_without_a_fault_it_is_least_squares_to_the_bit() -> None:
    z = noise(5000, 1)
    method = GlrKalman(model())
    assert np.array_equal(method.process(z).x, WeightedLeastSquares(model()).process(z).x)
    assert method.open == () and not method.doubtful


def test_the_calibration_prior_is_learned_and_its_covariance_is_honest() -> None:
    """The parity part of the biases is found, the part in the range of H stays unknown, and P says so."""
    errors, scale = [], []
    for seed in range(40):
        bias = np.random.default_rng(seed).standard_normal(6)
        z = np.random.default_rng(seed + 1000).standard_normal((2000, 6)) + bias
        method = GlrKalman(model())
        method.process(z)
        off = method.state.x - bias
        assert np.max(np.abs(SIX.parity() @ off)) < 0.12
        errors.append(off)
        scale.append(off @ np.linalg.solve(method.state.P, off))
    assert 5.0 < np.mean(scale) < 7.2  # chi-square with 6 degrees of freedom, 40 times
    W = SIX.least_squares()
    np.testing.assert_allclose(W @ method.state.P @ W.T, W @ W.T, atol=1e-9)  # range(H): the prior, untouched


@pytest.mark.parametrize("n", [5, 6, 9, 12])
def test_a_drift_is_found_removed_and_paid_back(n: int) -> None:
    array = SIX if n == 6 else cone(n)
    z = noise(9000, n, array)
    twin = GlrKalman(model(array)).process(z).x
    z[3000:, 1] += 3.0
    method = GlrKalman(model(array))
    out = method.process(z)
    assert method.open == (1,)
    induced = out.x - twin
    plain = array.least_squares()[:, 1] * 3.0
    assert np.linalg.norm(induced[8000:].mean(axis=0)) < 0.05 * np.linalg.norm(plain)
    # what went in before the detection is out again: the sum since the onset is that of the estimation error alone
    assert np.linalg.norm(induced[3000:4000].sum(axis=0)) < 0.06 * 1000 * np.linalg.norm(plain)
    late = GlrKalman(model(array), GlrSettings(recall_s=600.0)).process(z).x - twin
    assert np.linalg.norm(induced[3000:3600].sum(axis=0)) < np.linalg.norm(late[3000:3600].sum(axis=0))


def test_four_sensors_detect_and_change_nothing() -> None:
    array = cone(4)
    z = noise(4000, 4, array)
    z[2000:, 1] += 5.0
    method = GlrKalman(model(array))
    out = method.process(z)
    assert method.open == () and method.doubtful
    np.testing.assert_array_equal(out.x, WeightedLeastSquares(model(array)).process(z).x)


def test_a_slow_ramp_is_followed() -> None:
    """0.1 sigma a second: below one sigma for ten seconds; least squares would integrate all of it."""
    z = noise(12000, 7)
    twin = GlrKalman(model()).process(z).x
    ramp = 0.001 * np.maximum(np.arange(12000) - 3000, 0)
    z[:, 2] += ramp
    method = GlrKalman(model())
    out = method.process(z)
    assert method.open == (2,)
    assert abs(out.drift[-1, 2] - out.drift[2900, 2] - ramp[-1]) < 0.8
    assert np.linalg.norm((out.x - twin)[3000:].sum(axis=0)) < 0.1 * np.linalg.norm(SIX.least_squares()[:, 2]) * ramp.sum()


def test_two_drifts_one_after_the_other() -> None:
    for seed, (i, j) in enumerate(itertools.combinations(range(6), 2)):
        z = noise(5000, 20 + seed)
        z[1500:, i] += 3.0
        z[2500:, j] -= 3.0
        method = GlrKalman(model())
        out = method.process(z)
        assert method.open == (i, j)
        assert np.all(np.abs(out.covariance[-1]) < 10.0)


def test_simultaneous_unequal_pairs_are_told_and_equal_ones_never_named_wrongly() -> None:
    right = 0
    for seed, (i, j) in enumerate(itertools.combinations(range(6), 2)):
        sign = 1.0 if seed % 2 else -1.0
        z = noise(4000, 50 + seed)
        z[1500:, i] += 4.0
        z[1500:, j] += 2.0 * sign
        method = GlrKalman(model())
        method.process(z)
        assert set(method.open) <= {i, j}
        right += method.open == (i, j)
        z[1500:, j] += 2.0 * sign
        same = GlrKalman(model())
        same.process(z)
        assert set(same.open) <= {i, j}
        assert same.open == (i, j) or same.doubtful
    assert right >= 11


def test_a_drift_in_the_range_of_h_is_not_claimed() -> None:
    z = noise(5000, 9)
    twin = GlrKalman(model()).process(z)
    w0 = np.array([2.0, -1.0, 1.0])
    z[2000:] += SIX.H @ w0
    method = GlrKalman(model())
    out = method.process(z)
    assert method.open == () and not method.doubtful
    np.testing.assert_allclose((out.x - twin.x)[3000:].mean(axis=0), w0, atol=1e-9)
    assert np.all(np.diagonal(out.covariance[-1]) >= 0.5 - 1e-9)  # the prior's part in the range of H


def test_false_alarms_come_as_often_as_said() -> None:
    """100 000 batches at one alarm in 40 s; none of them opens a sensor."""
    settings = GlrSettings(mean_time_between_false_alarms_h=40.0 / 3600.0)
    method = GlrKalman(model(), settings)
    begun, last = 0, False
    rng = np.random.default_rng(3)
    for _ in range(40):
        z = rng.standard_normal((10000, 6))
        for k in range(0, 10000, 4):
            method.process(z[k : k + 4])
            begun += method.doubtful and not last
            last = method.doubtful
    assert method.open == ()
    assert 0.5 < begun / (400_000 * 0.01 / 40.0) < 1.5
    assert alarm_threshold(10.0, 25.0, 6) > alarm_threshold(1.0, 25.0, 6) > 20.0


def test_a_copy_goes_on_alone_and_blocks_change_nothing() -> None:
    z = noise(3000, 11)
    z[1000:, 4] += 3.0
    z[1500:1510, 0] = np.nan
    z[2000:, 5] = np.nan
    whole = GlrKalman(model()).process(z)
    for lengths in ([1] * 3000, [7] * 429, [999, 2001]):
        method, parts = GlrKalman(model()), []
        for a, b in itertools.pairwise(np.minimum(np.cumsum([0, *lengths]), 3000).tolist()):
            parts.append(method.process(z[a:b]))
            method = method.copy()
        for k, array in enumerate(whole):
            assert np.array_equal(array, np.concatenate([part[k] for part in parts]), equal_nan=True)


def test_an_isolated_sensor_is_forgotten_and_begins_anew() -> None:
    z = noise(6000, 12)
    method = GlrKalman(model())
    z[1000:, 3] += 3.0
    method.process(z[:2000])
    assert method.open == (3,)
    method.process(z[2000:4000], 0b110111)
    assert method.state.ints[G.DOF] == 2
    z[4000:, 3] -= 3.0
    out = method.process(z[4000:])
    assert method.open == () and abs(out.drift[-1, 3] - out.drift[-1].mean()) < 3.0


def test_a_drift_that_goes_is_closed() -> None:
    z = noise(12000, 14)
    z[2000:3000, 1] += 3.0
    method = GlrKalman(model(), GlrSettings(close_s=20.0))
    method.process(z[:2900])
    assert method.open == (1,)
    out = method.process(z[2900:])
    assert method.open == () and abs(out.drift[-1, 1] - out.drift[:50, 1].mean() + 3.0) < 0.5


def test_a_sensor_too_noisy_or_too_far_is_dead() -> None:
    for spoil, limit in ((lambda z: z + 3.0 * np.random.default_rng(1).standard_normal(len(z)), 50.0), (lambda z: z + 12.0, 10.0)):
        z = noise(6000, 15)
        z[2000:, 1] += 3.0
        z[3000:, 1] = spoil(z[3000:, 1])
        method = GlrKalman(model(), GlrSettings(drift_limit=limit))
        method.process(z[:3000])
        assert method.open == (1,) and not method.state.whole[G.DEAD].any()
        method.process(z[3000:])
        assert method.state.whole[G.DEAD].tolist() == [0, 1, 0, 0, 0, 0]


def test_cost() -> None:
    """Both triads of six, a sensor open: 5 us a sample demanded on a quiet machine; the bound leaves room for a busy one."""
    z = noise(24000, 13)
    z[1000:, 1] += 3.0
    method = GlrKalman(model())
    method.process(z[:4000])
    least = np.inf
    for k in range(4000, 24000, 4000):
        begin = time.process_time()
        method.process(z[k : k + 4000])
        least = min(least, time.process_time() - begin)
    assert 2.0 * least / 4000 < 15e-6
