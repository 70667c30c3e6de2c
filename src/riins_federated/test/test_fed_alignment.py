"""Alignment under way and from a saved heading: unknown heading, its own sigma, refusals."""

import functools
import math

import numpy as np
import pytest

from riins_core.alignment.result import AlignmentError, attitude_error
from riins_core.alignment.stationary import ImuNoise
from riins_core.alignment.stored import Aids
from riins_core.earth import earth_rate_n, gravity
from riins_core.rotation import dcm_from_euler, euler_from_dcm
from riins_core.sensor_errors import DEG, DEG_PER_H, DEG_PER_SQRT_H, MICRO_G
from riins_federated.alignment_hot_start import SavedHeading, hot_start
from riins_federated.alignment_in_motion import align_in_motion
from riins_sim import scenario as scenarios
from riins_sim.trajectory import Trajectory

LAT = math.radians(45.0)
IMU = ImuNoise(0.002 * DEG_PER_SQRT_H, 10 * MICRO_G, 0.01 * DEG_PER_H, 50 * MICRO_G)
DT, M = 0.1, 4000


@functools.cache
def voyage():
    ship = scenarios.Scenario(
        name="under_way",
        duration_s=M * DT + 1.0,
        imu_rate_hz=10,
        start=scenarios.StartSettings(latitude_deg=45.0, longitude_deg=10.0, heading_deg=130.0, speed_kn=10.0),
        legs=(scenarios.LegSettings(straight_s=150.0), scenarios.LegSettings(turn_deg=60.0, rate_deg_s=1.0)),
        sea=scenarios.SeaSettings(significant_wave_height_m=1.5, direction_deg=30.0),
    )
    path = Trajectory(ship)
    truth = path.truth(np.arange(0.0, M * DT + 0.5))
    return (*path.increments(1, M), truth)


def measured(seed, kind, sigma=0.05, imu=IMU):
    rate, force, truth = voyage()
    rng = np.random.default_rng([seed, 50])
    noisy = rate + imu.bias_g * rng.standard_normal(3) + imu.arw / math.sqrt(DT) * rng.standard_normal(rate.shape)
    pushed = force + imu.bias_a * rng.standard_normal(3) + imu.vrw / math.sqrt(DT) * rng.standard_normal(rate.shape)
    index = np.arange(10, M + 1, 10)
    v, C = truth.v_n[1:], truth.C_nb[1:]
    value = v if kind == "velocity" else np.einsum("kji,kj->ki", C, v)
    return noisy, pushed, Aids(kind, index, value + sigma * rng.standard_normal(value.shape), np.full(3, sigma)), truth


@pytest.mark.parametrize("kind", ["velocity", "log"])
def test_under_way_from_unknown_heading(kind):
    scaled = []
    for seed in range(5):
        rate, force, aids, truth = measured(seed, kind)
        place = (float(truth.lat[0]), float(truth.lon[0]), 0.0)
        found, history = align_in_motion(rate, force, DT, place, IMU, aids)
        scaled.append(attitude_error(found.C_nb, truth.C_nb[M // 10]) / found.sigma)
        assert found.sigma[2] < 0.4 * DEG and history.refused <= 1
    assert np.max(np.abs(scaled)) < 3.5 and np.mean(np.square(scaled)) < 2.0


def test_what_gives_no_heading_is_refused():
    rate, force, aids, truth = measured(1, "log")
    place = (float(truth.lat[0]), float(truth.lon[0]), 0.0)
    with pytest.raises(AlignmentError, match="wrong latitude"):
        align_in_motion(rate, force, DT, (place[0] + 20.0 * DEG, *place[1:]), IMU, aids)
    with pytest.raises(AlignmentError, match=r"bias of .* wrong latitude"):
        align_in_motion(rate, force, DT, (place[0] + 5.0 * DEG, *place[1:]), IMU, aids)
    with pytest.raises(AlignmentError, match="beyond 85 deg"):
        align_in_motion(rate, force, DT, (86.0 * DEG, *place[1:]), IMU, aids)
    with pytest.raises(AlignmentError, match="not enough"):
        align_in_motion(rate[:300], force[:300], DT, place, IMU, Aids("log", aids.index[:30], aids.value[:30], aids.sigma))
    with pytest.raises(AlignmentError, match="not finite"):
        align_in_motion(rate, force, DT, place, IMU, Aids("log", aids.index, aids.value * np.nan, aids.sigma))
    with pytest.raises(ValueError, match='"velocity" or "log"'):
        align_in_motion(rate, force, DT, place, IMU, Aids("place", aids.index, aids.value, aids.sigma))
    poor = ImuNoise(0.3 * DEG_PER_SQRT_H, 100 * MICRO_G, 10.0 * DEG_PER_H, 2000 * MICRO_G)
    C, rng = dcm_from_euler(0.0, 0.0, 1.0), np.random.default_rng(3)
    still = [C.T @ earth_rate_n(LAT) + poor.bias_g * np.ones(3), C.T @ [0.0, 0.0, -gravity(LAT, 0.0)] + poor.bias_a * np.ones(3)]
    shaken = [v + s / math.sqrt(DT) * rng.standard_normal((M, 3)) for v, s in zip(still, (poor.arw, poor.vrw), strict=True)]
    no_motion = Aids("velocity", aids.index, 0.05 * rng.standard_normal(aids.value.shape), aids.sigma)
    with pytest.raises(AlignmentError, match="do not give the heading"):
        align_in_motion(*shaken, DT, (LAT, 0.2, 0.0), poor, no_motion)


def test_hot_start_sharpens_and_refuses_a_ship_that_was_turned():
    C, rng = dcm_from_euler(0.02, -0.01, 200.0 * DEG), np.random.default_rng(8)
    seconds = 20
    rate = C.T @ earth_rate_n(LAT) + IMU.bias_g * rng.standard_normal(3) + IMU.arw * rng.standard_normal((seconds, 3))
    force = C.T @ [0.0, 0.0, -gravity(LAT, 0.0)] + IMU.bias_a * rng.standard_normal(3) + IMU.vrw * rng.standard_normal((seconds, 3))
    saved = SavedHeading(200.02 * DEG, 0.03 * DEG, 0.02 * DEG)
    found = hot_start(rate, force, 1.0, LAT, IMU, saved)
    assert abs(attitude_error(found.C_nb, C)[2]) < 0.1 * DEG and found.sigma[2] < 0.037 * DEG
    assert euler_from_dcm(found.C_nb)[0] == pytest.approx(0.02, abs=1e-4)
    with pytest.raises(AlignmentError, match="she was turned"):
        hot_start(rate, force, 1.0, LAT, IMU, SavedHeading(20.0 * DEG, 0.03 * DEG))
    with pytest.raises(AlignmentError, match="the base moves"):
        hot_start(rate + 0.01 * rng.standard_normal(rate.shape), force, 1.0, LAT, IMU, saved)
    with pytest.raises(AlignmentError, match="no standard deviation"):
        hot_start(rate, force, 1.0, LAT, IMU, SavedHeading(1.0, 0.0))
