"""Alignment in waves and over stored data: vectors in the inertial frame, the filter that goes over the data again, refusals. Target 49 in small."""

import math

import numpy as np
import pytest
from core_motion import Motion, Wave

from riins_core.alignment.result import AlignmentError, attitude_error, bounds
from riins_core.alignment.stationary import ImuNoise, align_stationary
from riins_core.alignment.swaying import SwayingSettings, align_swaying, coarse
from riins_core.earth import radii
from riins_core.rotation import euler_from_dcm
from riins_core.sensor_errors import ARCMIN, ARCSEC, DEG, DEG_PER_H, DEG_PER_SQRT_H, MICRO_G

LAT, DT, M = math.radians(45.0), 0.1, 6000
IMU = ImuNoise(0.002 * DEG_PER_SQRT_H, 10 * MICRO_G, 0.01 * DEG_PER_H, 50 * MICRO_G)


def metres(north, east):
    r_m, r_n = (float(r) for r in radii(LAT))
    return north / r_m, east / (r_n * math.cos(LAT))


def moored(swing=0.0):
    n, e = metres(0.7, 0.7)
    return Motion(
        lat=Wave(LAT, 0.0, (n, 0.5 * n, swing * n), (0.7, 0.11, 0.02), (0.3, 1.0, 0.0)),
        lon=Wave(0.2, 0.0, (e, 0.5 * e), (0.6, 0.13), (2.0, 0.1)),
        h=Wave(0.0, 0.0, (1.0,), (0.65,), (1.1,)),
        roll=Wave(0.02, 0.0, (3 * DEG, 1 * DEG), (0.55, 0.8), (0.0, 1.0)),
        pitch=Wave(-0.01, 0.0, (2 * DEG,), (0.75,), (0.5,)),
        heading=Wave(250 * DEG, 0.0, (1 * DEG, 0.5 * DEG), (0.3, 0.05), (1.5, 0.2)),
    )


@pytest.fixture(scope="module")
def waves():
    motion = moored()
    rate, force = motion.means(1, M, DT)
    nav, _, _ = motion.state([0.0, M * DT])
    return rate, force, nav[0, 6:15].reshape(3, 3), nav[1, 6:15].reshape(3, 3)


def test_the_vectors_alone(waves):
    rate, force, first, _ = waves
    found = coarse(rate[: M // 2], force[: M // 2], DT, LAT)
    error = attitude_error(found.C, first)
    assert np.all(np.abs(error[:2]) < 2.0 * ARCSEC) and abs(error[2]) < 3.0 * ARCMIN and found.rms < 2.0


def test_target_49_in_waves_the_bound_is_reached(waves):
    rate, force, _, last = waves
    level, heading = bounds(LAT, IMU.bias_g, IMU.bias_a)
    errors, scaled = [], []
    for seed in range(6):
        rng = np.random.default_rng([seed, 49])
        noisy = rate + IMU.bias_g * rng.standard_normal(3) + IMU.arw / math.sqrt(DT) * rng.standard_normal(rate.shape)
        pushed = force + IMU.bias_a * rng.standard_normal(3) + IMU.vrw / math.sqrt(DT) * rng.standard_normal(rate.shape)
        found, _ = align_swaying(noisy, pushed, DT, LAT, IMU, SwayingSettings(passes=2 + (seed == 0)))
        errors.append(attitude_error(found.C_nb, last) / [level, level, heading])
        scaled.append(attitude_error(found.C_nb, last) / found.sigma)
    rms = np.sqrt(np.mean(np.square(errors), axis=0))
    assert np.all(rms[:2] <= 1.6) and rms[2] <= 1.5
    assert np.max(np.abs(scaled)) < 3.5
    with pytest.raises(AlignmentError, match="the base moves"):
        align_stationary(noisy, pushed, DT, LAT, IMU)


def test_without_errors_the_attitude_is_exact(waves):
    rate, force, _, last = waves
    found, history = align_swaying(rate, force, DT, LAT, IMU)
    error = attitude_error(found.C_nb, last)
    assert np.all(np.abs(error[:2]) < 1.0 * ARCSEC) and abs(error[2]) < 1.0 * ARCMIN
    assert history.refused == 0 and found.euler[2] == pytest.approx(float(euler_from_dcm(last)[2]), abs=1.0 * ARCMIN)


def test_what_is_not_moored_is_refused(waves):
    rate, force, _, _ = waves
    with pytest.raises(AlignmentError, match="under way"):
        align_swaying(*moored(swing=100.0).means(1, M, DT), DT, LAT, IMU)
    with pytest.raises(AlignmentError, match="wrong latitude"):
        align_swaying(rate, force, DT, LAT + 5.0 * DEG, IMU)
    with pytest.raises(AlignmentError, match="gyro bias of"):
        align_swaying(rate, force, DT, LAT + 1.5 * DEG, IMU)
    with pytest.raises(AlignmentError, match="beyond 85 deg"):
        align_swaying(rate, force, DT, 86.0 * DEG, IMU)
    with pytest.raises(AlignmentError, match="needs 300 s"):
        align_swaying(rate[:100], force[:100], DT, LAT, IMU)
    with pytest.raises(AlignmentError, match="not finite"):
        align_swaying(rate * np.nan, force, DT, LAT, IMU)
