"""Sensor errors: units of data sheets, the drawn errors and what a sensor reads, in any split."""

import numpy as np
import pytest

from riins_core import sensor_errors as se
from riins_core.imu_array import dodecahedron
from riins_core.settings import SettingError, build

H = dodecahedron()


def test_units_of_data_sheets():
    gyro = se.GyroErrors(0.01, 0.003, 1800.0, 0.06, 0.002, 20.0, 1.0).si()
    assert gyro.constant == pytest.approx(4.8481368e-8)  # 0.01 deg/h
    assert gyro.markov == pytest.approx(0.3 * gyro.constant)
    assert gyro.markov_time == 1800.0
    assert gyro.random_walk * np.sqrt(3600.0) == pytest.approx(0.06 * se.DEG_PER_H)
    assert gyro.white == pytest.approx(0.002 * np.pi / 180 / 60)
    assert (gyro.scale, gyro.misalignment) == pytest.approx((20e-6, 2.908882e-4))
    accel = se.AccelErrors(bias_ug=50.0, vrw_ug_sqrt_hz=10.0, random_walk_ug_sqrt_h=60.0).si()
    assert accel.constant == pytest.approx(4.903325e-4)
    assert accel.white_sigma(0.01) == pytest.approx(10 * 9.80665e-6 * 10)  # 100 Hz samples: sqrt(1/dt)
    assert accel.random_walk == pytest.approx(9.80665e-6)
    assert accel.combined(np.sqrt(2.0)).constant == pytest.approx(accel.constant * np.sqrt(2.0))
    assert accel.combined(2.0).markov_time == accel.markov_time


def test_angle_random_walk_is_what_its_name_says():
    # the angle of one hour scatters by 0.1 deg
    errors = se.SensorErrors(se.GyroErrors(arw_deg_sqrt_h=0.1).si(), np.tile(H, (10, 1)), 1.0, 3, "gyro")
    angle = np.sum(errors.white(0, 3600), axis=0)
    assert np.std(angle) == pytest.approx(0.1 * se.DEG, rel=4.5 / np.sqrt(2 * 60))


def test_settings_are_checked():
    assert build(se.GyroErrors, {"arw_deg_sqrt_h": 1}).arw_deg_sqrt_h == 1.0
    with pytest.raises(SettingError, match="arw_deg_sqrt_h"):
        build(se.GyroErrors, {"arw_deg_sqrt_hz": 1.0})
    with pytest.raises(SettingError, match="must be in 0"):
        build(se.AccelErrors, {"bias_ug": -1.0})


def full_model(seed=1, name="gyro"):
    errors = se.GyroErrors(1.0, 2.0, 10.0, 50.0, 0.1, 300.0, 3.0).si()
    return se.SensorErrors(errors, H, 0.01, seed, name)


def test_measurement_is_the_sum_of_its_parts_and_bits_do_not_depend_on_the_split():
    model, rng = full_model(), np.random.default_rng(0)
    true = rng.normal(size=(200, 3))
    whole = model.measure(70, true)
    expected = (1 + model.scale) * (true @ model.axes.T) + model.bias(70, 200) + model.white(70, 200)
    np.testing.assert_allclose(whole, expected, atol=1e-14)
    parts = np.vstack([model.measure(70, true[:1]), model.measure(71, true[1:130]), model.measure(200, true[130:])])
    np.testing.assert_array_equal(parts, whole)
    np.testing.assert_array_equal(full_model().measure(70, true), whole)
    assert not np.any(full_model(seed=2).measure(70, true) == whole)
    assert not np.any(full_model(name="accel").bias(0, 3) == model.bias(0, 3))


def test_drawn_sizes():
    errors = se.GyroErrors(constant_drift_deg_h=2.0, scale_ppm=100.0, misalignment_arcmin=5.0).si()
    model = se.SensorErrors(errors, np.tile(H, (300, 1)), 0.01, 9, "gyro")
    n, tolerance = 1800, 4.5 / np.sqrt(2 * 1800)
    assert np.std(model.constant) / se.DEG_PER_H == pytest.approx(2.0, rel=tolerance)
    assert np.std(model.scale) == pytest.approx(1e-4, rel=tolerance)
    np.testing.assert_allclose(np.linalg.norm(model.axes, axis=1), 1.0, atol=1e-15)
    tilt = np.linalg.norm(model.axes - np.tile(H, (300, 1)), axis=1)
    assert np.sqrt(np.mean(tilt**2) / 2.0) / se.ARCMIN == pytest.approx(5.0, rel=4.5 / np.sqrt(4 * n))
    np.testing.assert_array_equal(model.bias(0, 2), np.tile(model.constant, (2, 1)))
    np.testing.assert_array_equal(model.white(0, 2), 0.0)


def test_perfect_sensors_read_the_truth():
    model = se.SensorErrors(se.InertialErrors(), H, 0.01, 1, "gyro")
    np.testing.assert_allclose(model.measure(0, np.eye(3)), H.T, atol=1e-16)
