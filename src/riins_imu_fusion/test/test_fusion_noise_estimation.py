"""Autocovariance least squares in parity space: target 14, honesty on constant drifts, subsets, blocks."""

import numpy as np
import pytest

from riins_core.imu_array import CONFIGURATIONS, ImuArray
from riins_imu_fusion.noise_estimation import NoiseEstimator

ARRAY = ImuArray(CONFIGURATIONS["dodecahedron"])
Q = np.array([10.0, 1.0, 10.0, 1.0, 1.0, 1.0])
R = 4.0


def readings(seed: int, m: int = 5000, q: np.ndarray = Q, r: float = R) -> np.ndarray:
    rng = np.random.default_rng(seed)
    body = np.cumsum(rng.standard_normal((m, 3)), axis=0)
    return body @ ARRAY.H.T + np.cumsum(np.sqrt(q) * rng.standard_normal((m, 6)), axis=0) + np.sqrt(r) * rng.standard_normal((m, 6))


@pytest.mark.parametrize("each", [False, True])
def test_process_noise_of_the_dominant_sensors_and_measurement_noise(each: bool) -> None:
    """Target 14."""
    made = []
    for seed in range(10):
        estimator = NoiseEstimator(ARRAY, gain=0.5, each=each)
        estimator.process(readings(seed))
        estimate = estimator.estimate()
        made.append(np.r_[estimate.Q / Q, estimate.R / R])
    ratio = np.array(made)
    assert np.all(np.abs(ratio[:, [0, 2]] - 1.0) < 0.25)
    assert np.all((ratio[:, 6:] > 0.5) & (ratio[:, 6:] < 2.0))
    np.testing.assert_allclose(ratio.mean(0), 1.0, atol=0.25)


@pytest.mark.parametrize("gain", [0.1, 0.3, 0.7])
def test_any_gain_is_unbiased(gain: float) -> None:
    made = []
    for seed in range(6):
        estimator = NoiseEstimator(ARRAY, gain=gain)
        estimator.process(readings(100 + seed, 20000, q=np.full(6, 4.0)))
        made.append(np.r_[estimator.estimate().Q / 4.0, estimator.estimate().R / R])
    np.testing.assert_allclose(np.mean(made, axis=0), 1.0, atol=0.2)


def test_a_constant_drift_is_no_process_noise() -> None:
    estimator = NoiseEstimator(ARRAY, gain=0.1)
    estimator.process(readings(3, 4000, q=np.zeros(6)) + np.array([30.0, 0.0, -30.0, 0.0, 0.0, 0.0]))
    estimate = estimator.estimate()
    assert np.max(estimate.Q) < 0.01 * R
    np.testing.assert_allclose(estimate.R, R, rtol=0.1)


def test_any_split_into_blocks_gives_the_same_bits_and_a_copy_goes_on_alone() -> None:
    z = readings(4, 1000)
    z[400] = np.nan
    whole, parts = NoiseEstimator(ARRAY), NoiseEstimator(ARRAY)
    whole.process(z)
    for block in np.split(z, [1, 300, 399, 401, 650]):
        kept = parts.copy()
        parts.process(block)
    kept.process(z[650:])
    for one in (parts, kept):
        for a, b in zip(whole.estimate(), one.estimate(), strict=True):
            assert np.array_equal(a, b)


def test_subsets_and_refusals() -> None:
    estimator = NoiseEstimator(ARRAY, gain=0.5)
    z = readings(5, 20000)
    z[:, 1] = np.nan  # not used
    estimator.process(z, 0b111101)
    with pytest.raises(ValueError, match="cannot be told apart"):  # two parities make three products, five sensors have six unknowns
        estimator.estimate()
    with pytest.raises(ValueError, match="no parity"):
        estimator.process(z, 0b011001)
    with pytest.raises(ValueError, match="100 pairs"):
        NoiseEstimator(ARRAY).estimate()
