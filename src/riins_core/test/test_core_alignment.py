"""Alignment at rest: coarse, 12/10/7 states (seed 001), raw redundant outputs (thesis ch. 3), observability, and refusals. Targets 45 to 48."""

import math

import numpy as np
import pytest

from riins_core.alignment.coarse import analytic, check_still, triad, wahba_static
from riins_core.alignment.observability import observability
from riins_core.alignment.redundant import AttitudeFilter, PairFilter, align_redundant, fuse_means, largest_nc
from riins_core.alignment.result import AlignmentError, attitude_error, bias_covariance, bounds, settled_after
from riins_core.alignment.stationary import ImuNoise, StationarySettings, align_stationary, mechanize, model
from riins_core.earth import earth_rate_n, gravity
from riins_core.imu_array import ImuArray, dodecahedron
from riins_core.rotation import dcm_from_euler, exp_so3
from riins_core.sensor_errors import ARCMIN, ARCSEC, DEG, DEG_PER_H, DEG_PER_SQRT_H, MICRO_G

LAT = math.radians(34.0)
IMU = ImuNoise(0.001 * DEG_PER_SQRT_H, 10 * MICRO_G, 0.01 * DEG_PER_H, 100 * MICRO_G)
"""Seed 001."""
ARRAY = ImuArray(dodecahedron())
DRIFT, BIAS, NOISE_G, NOISE_A = 0.02 * DEG_PER_H, 100 * MICRO_G, 0.01 * DEG_PER_H, 50 * MICRO_G
"""The thesis, one output a second."""


def at_rest(C, lat, seconds=600, imu=IMU, seed=None, bias=1.0):
    rate = np.tile(C.T @ earth_rate_n(lat) + bias * imu.bias_g, (seconds, 1))
    force = np.tile(C.T @ [0.0, 0.0, -gravity(lat, 0.0)] + bias * imu.bias_a, (seconds, 1))
    if seed is not None:
        rng = np.random.default_rng(seed)
        rate += imu.arw * rng.standard_normal(rate.shape)
        force += imu.vrw * rng.standard_normal(force.shape)
    return rate, force


@pytest.mark.parametrize("heading", [0.0, 100.0, 181.0, 359.0])
def test_coarse_is_exact_without_errors(heading):
    C = dcm_from_euler(0.1, -0.2, heading * DEG)
    rate, force = at_rest(C, LAT, 1, bias=0.0)
    for found in (analytic(force[0], rate[0], LAT), triad(force[0], rate[0], LAT), wahba_static(force[0], rate[0], LAT, 1e-3, 1e-8)):
        assert np.max(np.abs(attitude_error(found, C))) < 1e-9


def test_bias_covariance_is_what_biases_do():
    C = dcm_from_euler(0.2, -0.1, 1.0)
    rng = np.random.default_rng(5)
    errors = []
    for _ in range(400):
        rate = C.T @ earth_rate_n(LAT) + IMU.bias_g * rng.standard_normal(3)
        force = C.T @ [0.0, 0.0, -gravity(LAT, 0.0)] + IMU.bias_a * rng.standard_normal(3)
        errors.append(attitude_error(triad(force, rate, LAT), C))
    sigma = np.sqrt(np.diag(bias_covariance(LAT, C, IMU.bias_g**2 * np.eye(3), IMU.bias_a**2 * np.eye(3))))
    assert np.sqrt(np.mean(np.square(errors), axis=0)) / sigma == pytest.approx(1.0, abs=0.12)
    assert sigma[:2] == pytest.approx(bounds(LAT, IMU.bias_g, IMU.bias_a)[0])


def test_the_model_is_the_jacobian_of_the_mechanization():
    C, seconds, small = dcm_from_euler(0.1, 0.05, 0.7), 60, 1e-6
    for states, coriolis in ((12, True), (7, False)):
        ends = []
        for i in range(4):
            rate, force = at_rest(C, LAT, seconds, bias=0.0)
            start = exp_so3(-small * np.eye(3)[i]) @ C if i < 3 else C.copy()
            v, path = np.zeros((1, 3)), np.zeros((1, 3, 3))
            mechanize(start, rate, force, 1.0, earth_rate_n(LAT), float(gravity(LAT, 0.0)), coriolis, states == 12, seconds, v, path)
            ends.append(np.concatenate([v[0], attitude_error(start, C)]))
        F, _, _ = model(states, LAT, C)
        axes = 3 if states == 12 else 2
        Phi, term = np.eye(states), np.eye(states)
        for k in range(1, 6):
            term = term @ F * seconds / k
            Phi = Phi + term
        for i in range(3):
            change = (ends[i] - ends[3]) / small
            assert change[:axes] == pytest.approx(Phi[:axes, axes + i], rel=1e-3, abs=1e-2)
            assert change[3:] == pytest.approx(Phi[axes : axes + 3, axes + i], abs=1e-5)


@pytest.mark.parametrize("states", [7, 10])
@pytest.mark.parametrize(("angle", "within"), [(5.0, 0.08), (10.0, 0.20)])
def test_target_45_one_correction_leaves_half_the_square(states, angle, within):
    settings = StationarySettings(states=states, restarts_s=())
    found, _ = align_stationary(*at_rest(np.eye(3), LAT, seed=1), 1.0, LAT, IMU, settings, start=exp_so3(-np.full(3, angle * DEG)))
    expected = (angle * DEG) ** 2 / 2.0 + bounds(LAT, 0.0, IMU.bias_a)[0]
    assert np.abs(attitude_error(found.C_nb, np.eye(3))[:2]) == pytest.approx(expected, rel=within)


@pytest.mark.parametrize("states", [7, 10, 12])
def test_target_46_restarts_reach_the_limit(states):
    limit = bounds(LAT, IMU.bias_g, IMU.bias_a)
    for angle in (1.0, 5.0, 10.0):
        found, _ = align_stationary(
            *at_rest(np.eye(3), LAT), 1.0, LAT, IMU, StationarySettings(states=states), start=exp_so3(-np.full(3, angle * DEG))
        )
        error = attitude_error(found.C_nb, np.eye(3))
        assert np.abs(error[:2]) == pytest.approx(limit[0], abs=2.0 * ARCSEC)
        assert error[2] == pytest.approx(limit[1] - math.tan(LAT) * limit[0], abs=0.25 * ARCMIN)


def test_unknown_heading_and_the_filters_own_sigma():
    errors, settings = [], StationarySettings(again=True)
    for seed in range(16):
        rng = np.random.default_rng([seed, 46])
        C = dcm_from_euler(*rng.normal(0.0, 0.05, 2), rng.uniform(0.0, 2.0 * np.pi))
        rate, force = at_rest(C, LAT, seed=seed, bias=0.0)
        rate, force = rate + IMU.bias_g * rng.standard_normal(3), force + IMU.bias_a * rng.standard_normal(3)
        found, history = align_stationary(rate, force, 1.0, LAT, IMU, settings)
        errors.append(attitude_error(found.C_nb, C) / found.sigma)
        assert len(history.t) == len(history.C_nb) == len(history.sigma)
    assert 0.6 < np.mean(np.square(errors)) < 1.5  # 48 values: +-2.5 sigma of their mean square


def test_rank_of_each_model():
    prior = {7: [0.1] * 2 + [0.17] * 3 + [IMU.bias_g] * 2, 10: [0.1] * 2 + [0.17] * 3 + [IMU.bias_a] * 2 + [IMU.bias_g] * 3}
    prior[12] = [0.1] * 3 + [0.17] * 3 + [IMU.bias_a] * 3 + [IMU.bias_g] * 3
    for states, rank in ((7, 7), (10, 7), (12, 9)):
        F, _, H = model(states, LAT, np.eye(3))
        seen = observability(F, H, np.array(prior[states]), np.full(len(H), 0.01), 600.0)
        assert (seen.states, seen.rank, seen.unseen.shape) == (states, rank, (states, states - rank))
        scaled = F * np.array(prior[states])[None, :] / np.array(prior[states])[:, None]
        assert np.max(np.abs(H * np.array(prior[states]) @ seen.unseen), initial=0.0) < 1e-9
        assert np.max(np.abs(H * np.array(prior[states]) @ scaled @ seen.unseen), initial=0.0) < 1e-9


def outputs(euler, lat, seed, seconds, bias_g, bias_a):
    C, rng = dcm_from_euler(*euler), np.random.default_rng(seed)
    gyro = ARRAY.H @ C.T @ earth_rate_n(lat) + bias_g + NOISE_G * rng.standard_normal((seconds, 6))
    accel = ARRAY.H @ C.T @ [0.0, 0.0, -gravity(lat, 0.0)] + bias_a + NOISE_A * rng.standard_normal((seconds, 6))
    return gyro, accel, C


def test_target_47_the_thesis_filter_with_its_largest_nc():
    lat, sign = math.radians(45.0), np.array([1.0, -1.0] * 3)
    errors = []
    for seed in range(20):
        gyro, accel, _ = outputs((0.0, 0.0, 0.5 * np.pi), lat, seed, 60, -DRIFT * sign, BIAS * sign)
        start = np.array([10 * ARCMIN, 10 * ARCMIN, 91 * DEG])
        filtered = PairFilter(lat, start, np.array([10 * ARCMIN, 10 * ARCMIN, DEG]), NOISE_G, NOISE_A)
        for k in range(60):
            filtered.update(gyro[k], accel[k])
        errors.append(np.abs(filtered.x - [0.0, 0.0, 0.5 * np.pi]))
    level, heading = np.mean(errors, axis=0)[:2] / ARCSEC, np.mean(errors, axis=0)[2] / ARCMIN
    assert level == pytest.approx(39.0, abs=3.0) and heading == pytest.approx(12.3, abs=1.5)
    assert largest_nc(lat, DRIFT, BIAS) == pytest.approx((39.23 * ARCSEC, 12.3 * ARCMIN), rel=2e-3)


def test_target_48_all_sensors_reach_the_bound_at_every_heading():
    lat, errors, squares = math.radians(45.0), [], []
    for seed in range(200):
        rng = np.random.default_rng([seed, 48])
        euler = (*rng.normal(0.0, 0.02, 2), rng.uniform(0.0, 2.0 * np.pi))
        gyro, accel, C = outputs(euler, lat, seed, 10, DRIFT * rng.standard_normal(6), BIAS * rng.standard_normal(6))
        found = align_redundant(gyro, accel, 1.0, lat, (ARRAY, ARRAY), (NOISE_G, NOISE_A), (DRIFT, BIAS))
        errors.append(attitude_error(found.C_nb, C))
        squares.append((errors[-1] / found.sigma) ** 2)
        if seed < 10:
            filtered = AttitudeFilter(lat, (ARRAY, ARRAY), NOISE_G, NOISE_A, (DRIFT, BIAS))
            for k in range(10):
                filtered.update(gyro[k], accel[k])
            again = filtered.result(10.0)
            assert attitude_error(again.C_nb, found.C_nb) == pytest.approx(0.0, abs=0.01 * ARCMIN)
            assert again.sigma == pytest.approx(found.sigma, rel=0.01)
    rms = np.sqrt(np.mean(np.square(errors), axis=0))
    assert np.all(rms[:2] <= 1.15 * 14.6 * ARCSEC) and rms[2] <= 1.15 * 4.57 * ARCMIN
    assert 0.8 < np.mean(squares) < 1.2


def test_common_bias_and_masks():
    lat, common = math.radians(45.0), 10.0
    rng = np.random.default_rng(7)
    plain, told, pairs = [], [], []
    for _ in range(300):
        z = rng.standard_normal(6) + common * rng.standard_normal()
        plain.append(fuse_means(z, ARRAY, 0.1, 1.0)[0])
        told.append(fuse_means(z, ARRAY, 0.1, 1.0, common)[0])
        pairs.append(np.array([z[0] - z[1], z[2] - z[3], z[4] - z[5]]) / (2.0 * ARRAY.H[0, 0]))
    plain, told, pairs = (np.sqrt(np.mean(np.square(v))) for v in (plain, told, pairs))
    assert told < 0.3 * plain and told < 0.99 * pairs
    _, P, biases = fuse_means(np.zeros(6), ARRAY, 0.1, 1.0, mask=0b110111)
    assert biases[3] == 0.0 and np.trace(P) > np.trace(fuse_means(np.zeros(6), ARRAY, 0.1, 1.0)[1])
    gyro, accel, C = outputs((0.0, 0.0, 1.0), lat, 1, 10, np.array([0, 0, 1, 0, 0, 0.0]), np.zeros(6))  # gyro 3 is off by 1 rad/s
    found = align_redundant(gyro, accel, 1.0, lat, (ARRAY, ARRAY), (NOISE_G, NOISE_A), (DRIFT, BIAS), masks=(0b111011, None))
    assert abs(attitude_error(found.C_nb, C)[2]) < 5.0 * found.sigma[2]


def test_a_sensor_isolated_in_mid_alignment_leaves_nothing_behind():
    lat, masks = math.radians(45.0), (0b111011, None)
    gyro, accel, C = outputs((0.01, 0.0, 2.0), lat, 4, 40, np.zeros(6), np.zeros(6))
    gyro[5:, 2] += 50.0 * DEG_PER_H
    whole, fresh = (AttitudeFilter(lat, (ARRAY, ARRAY), NOISE_G, NOISE_A, (DRIFT, BIAS)) for _ in range(2))
    fresh.isolate(masks)
    for k in range(40):
        if k == 20:
            assert abs(attitude_error(whole.C_nb, C)[2]) > 60.0 * ARCMIN
            whole.isolate(masks)
        whole.update(gyro[k], accel[k])
        if k >= 20:
            fresh.update(gyro[k], accel[k])
    assert np.array_equal(whole.C_nb, fresh.C_nb)
    assert abs(attitude_error(whole.C_nb, C)[2]) < 3.5 * whole.result(40.0).sigma[2] < 60.0 * ARCMIN
    with pytest.raises(ValueError, match="do not span"):
        whole.isolate((0b000011, None))


def test_settle_report():
    t, sigma = np.arange(1.0, 6.0), np.array([9.0, 4.0, 6.0, 3.0, 2.0])
    assert [settled_after(t, sigma, limit) for limit in (18.0, 12.0, 11.0, 3.0)] == [1.0, 2.0, 4.0, math.inf]


def test_a_base_that_is_not_at_rest_is_refused():
    C = dcm_from_euler(0.02, 0.01, 2.0)
    for seed in range(20):
        rate, force = at_rest(C, LAT, 60, seed=seed)
        check_still(rate, force, 1.0, LAT, IMU.arw, IMU.vrw, IMU.bias_g, IMU.bias_a)
    sway = 0.001 * np.sin(np.arange(60.0))[:, None]
    with pytest.raises(AlignmentError, match="the base moves: the rate"):
        align_stationary(rate + sway, force, 1.0, LAT, IMU)
    with pytest.raises(AlignmentError, match="the base moves: the force"):
        align_stationary(rate, force + 10.0 * sway, 1.0, LAT, IMU)
    with pytest.raises(AlignmentError, match="times the Earth rate"):
        align_stationary(rate + C.T @ [0.0, 0.0, 1e-4], force, 1.0, LAT, IMU)
    with pytest.raises(AlignmentError, match=r"say latitude 34\.0 deg, not 36\.0"):
        align_stationary(rate, force * float(gravity(LAT + 2 * DEG, 0.0) / gravity(LAT, 0.0)), 1.0, LAT + 2.0 * DEG, IMU)
    with pytest.raises(AlignmentError, match="beyond 85 deg"):
        align_stationary(rate, force, 1.0, 86.0 * DEG, IMU)
    with pytest.raises(AlignmentError, match="not finite"):
        align_stationary(rate * np.nan, force, 1.0, LAT, IMU)
    with pytest.raises(AlignmentError, match="not enough"):
        align_stationary(rate[:1], force[:1], 1.0, LAT, IMU)
    with pytest.raises(AlignmentError, match="7, 10 or 12 states"):
        align_stationary(rate, force, 1.0, LAT, IMU, StationarySettings(states=9))
    with pytest.raises(AlignmentError, match="parallel"):
        triad(force[0], 1e-4 * force[0], LAT)
