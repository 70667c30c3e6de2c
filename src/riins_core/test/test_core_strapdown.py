"""Strapdown: closure with exact motion, closed forms (rest, Schuler, coning), pyins on the same increments, and bits that no split changes."""

import numpy as np
import pandas as pd
import pyins.strapdown
import pytest
from core_motion import Motion, Wave, coning, ship_in_waves
from hypothesis import given, settings
from hypothesis import strategies as st

from riins_core import earth
from riins_core import strapdown as sd
from riins_core.ins_error import difference
from riins_core.rotation import dcm_from_euler, euler_from_dcm

Z = np.zeros(3)
ARCSEC = np.pi / 180 / 3600


def start(motion, dt):
    """State at t = 0 with the increments of the sample before, as in the middle of a voyage."""
    nav = motion.state(0.0)[0][0]
    s = sd.StrapdownState(*nav[:3], nav[3:6], nav[6:15])
    rate, force = motion.means(0, 1, dt)
    s.dtheta_prev[:], s.dv_prev[:], s.nav[sd.DT_PREV] = rate[0] * dt, force[0] * dt, dt
    return s


def sail(s, motion, k, m, dt, slaved=True):
    rate, force = motion.means(k, m, dt)
    if slaved:
        truth = motion.state(np.arange(k, k + m) * dt)[0]
        args = (s.nav, s.dtheta_prev, s.dv_prev, rate, force, np.full(m, dt), Z, Z, s.sums)
        sd.strapdown_slaved(*args, truth[:, 2].copy(), truth[:, 5].copy())
    else:
        s.propagate(rate, force, np.full(m, dt), Z, Z)
    return difference(s.nav, motion.state((k + m - 1) * dt)[0][0])


def test_closure_in_waves():
    # 4.3 mm after 12 h was measured with this motion; half an hour keeps the test short
    motion, dt = ship_in_waves(), 0.01
    e = sail(start(motion, dt), motion, 1, 180000, dt)
    assert np.hypot(e[0], e[1]) < 1e-3
    assert np.max(np.abs(e[6:9])) < 1e-3 * ARCSEC
    assert np.max(np.abs(e[3:5])) < 1e-5


def test_closure_needs_exact_means():
    # the trapezoid of instantaneous samples in place of exact means: what the IMU outputs matters
    motion, dt, m = ship_in_waves(), 0.01, 30000
    exact = sail(start(motion, dt), motion, 1, m, dt)
    truth, rate, force = motion.state(np.arange(m + 1) * dt)
    rate, force = 0.5 * (rate[1:] + rate[:-1]), 0.5 * (force[1:] + force[:-1])
    s = start(motion, dt)
    args = (s.nav, s.dtheta_prev, s.dv_prev, rate, force, np.full(m, dt), Z, Z, s.sums)
    sd.strapdown_slaved(*args, truth[1:, 2].copy(), truth[1:, 5].copy())
    trapezoid = difference(s.nav, truth[-1])
    assert np.hypot(*trapezoid[:2]) > 30 * np.hypot(*exact[:2])


def test_free_vertical_channel_over_a_minute():
    motion, dt = ship_in_waves(3), 0.01
    e = sail(start(motion, dt), motion, 1, 6000, dt, slaved=False)
    assert np.max(np.abs(e[:3])) < 1e-4


def test_coning_is_corrected_by_the_previous_increment():
    motion, dt = coning(np.deg2rad(10.0), 0.5), 0.01
    m = 12000
    with_previous = abs(sail(start(motion, dt), motion, 1, m, dt)[8])
    s = start(motion, dt)
    rate, force = motion.means(1, m, dt)
    for i in range(m):
        s.forget_previous()
        s.propagate(rate[i : i + 1], force[i : i + 1], np.full(1, dt), Z, Z)
        s.nav[2], s.nav[5] = 0.0, 0.0
    without = abs(difference(s.nav, motion.state(m * dt)[0][0])[8])
    # uncorrected drift of classical coning: a^2 w (w dt)^2 / 12 for small a
    w = np.pi
    assert without == pytest.approx(np.deg2rad(10.0) ** 2 / 2 * w * (w * dt) ** 2 / 6 * m * dt, rel=0.03)
    assert with_previous < without / 1000


def test_error_falls_with_the_fourth_power_of_the_interval():
    motion = coning(np.deg2rad(10.0), 0.5)
    errors = []
    for dt in (0.04, 0.02):
        errors.append(abs(sail(start(motion, dt), motion, 1, round(60.0 / dt), dt)[8]))
    assert errors[0] / errors[1] == pytest.approx(16.0, rel=0.1)


@pytest.mark.parametrize(("before", "after"), [(0.01, 0.04), (0.04, 0.01)])
def test_change_of_sample_rate(before, after):
    # one sample after the change, from the truth: its coning and sculling come from a previous sample of another length
    motion = coning(np.deg2rad(10.0), 0.5)
    for k in (400, 444, 480):
        t = k * max(before, after)
        nav = motion.state(t)[0][0]
        errors = []
        for believed in (before, after):
            s = sd.StrapdownState(*nav[:3], nav[3:6], nav[6:15])
            rate, force = motion.means(round(t / before), 1, before)
            s.dtheta_prev[:], s.dv_prev[:], s.nav[sd.DT_PREV] = rate[0] * before, force[0] * before, believed
            errors.append(sail(s, motion, round(t / after) + 1, 1, after, slaved=False))
        right, unscaled = errors
        assert np.linalg.norm(unscaled[6:9]) > 8 * np.linalg.norm(right[6:9])
        assert np.linalg.norm(unscaled[3:6]) > 4 * np.linalg.norm(right[3:6])


def test_at_rest_nothing_moves():
    lat, h, c = 0.75, 40.0, dcm_from_euler(0.1, -0.05, 2.0)
    rate, force = c.T @ earth.earth_rate_n(lat), c.T @ [0.0, 0.0, -float(earth.gravity(lat, h))]
    s = sd.StrapdownState(lat, -0.3, h, Z, c)
    m = 60000
    s.propagate(np.tile(rate, (m, 1)), np.tile(force, (m, 1)), np.full(m, 0.02), Z, Z)
    still = sd.StrapdownState(lat, -0.3, h, Z, c)
    assert np.max(np.abs(difference(s.nav, still.nav))) < 2e-4  # rounding of 60000 steps, 5e-12 rad of tilt
    np.testing.assert_allclose(s.sums[sd.SUM_FORCE], [0, 0, -float(earth.gravity(lat, h)) * m * 0.02], rtol=1e-10, atol=1e-7)
    np.testing.assert_allclose(s.sums[sd.SUM_C_NB].reshape(3, 3), c * m * 0.02, atol=1e-7)
    assert s.sums[sd.SUM_DT] == pytest.approx(1200.0)


def test_schuler_oscillation_and_the_sign_of_biases():
    # an accelerometer that reads b too much along north: x = b R / g (1 - cos w_s t), w_s = sqrt(g / R)
    lat, b, dt = 0.0, 1e-3, 0.05
    g, r = float(earth.gravity(lat, 0.0)), float(earth.radii(lat)[0])
    for sign, subtracted in ((1.0, Z), (0.0, np.array([b, 0.0, 0.0]))):
        s = sd.StrapdownState(lat, 0.0, 0.0, Z, np.eye(3))
        m = round(2530.0 / dt)
        rate, force = np.tile(earth.earth_rate_n(lat), (m, 1)), np.tile([b, 0.0, -g], (m, 1))
        sd.strapdown_slaved(s.nav, s.dtheta_prev, s.dv_prev, rate, force, np.full(m, dt), Z, subtracted, s.sums, np.zeros(m), np.zeros(m))
        expected = sign * b * r / g * (1.0 - np.cos(np.sqrt(g / r) * m * dt))
        assert s.nav[0] * r == pytest.approx(expected, abs=5.0)  # of 1300 m; the Earth's rotation couples the rest


def test_gyro_bias_is_subtracted():
    motion, dt, b = ship_in_waves(7), 0.01, np.array([1e-3, -2e-3, 3e-3])
    rate, force = motion.means(1, 500, dt)
    clean, corrected = start(motion, dt), start(motion, dt)
    clean.propagate(rate, force, np.full(500, dt), Z, Z)
    corrected.propagate(rate + b, force, np.full(500, dt), b, Z)
    np.testing.assert_allclose(corrected.nav, clean.nav, rtol=1e-12, atol=1e-13)


@settings(max_examples=25, deadline=None)
@given(st.lists(st.integers(1, 80), min_size=1, max_size=12), st.integers(0, 1000))
def test_any_split_gives_the_same_bits(sizes, seed):
    rng = np.random.default_rng(seed)
    m = sum(sizes)
    rate, force = 0.2 * rng.normal(size=(m, 3)), rng.normal(size=(m, 3)) - [0, 0, 9.8]
    dt = rng.choice([0.01, 0.02], size=m)
    bias = 1e-3 * rng.normal(size=(2, 3))
    whole = sd.StrapdownState(0.5, 1.0, 10.0, [5.0, -3.0, 0.2], dcm_from_euler(0.1, 0.2, 5.0))
    split = whole.copy()
    whole.propagate(rate, force, dt, *bias)
    i = 0
    for size in sizes:
        split.propagate(rate[i : i + size], force[i : i + size], dt[i : i + size], *bias)
        i += size
    for name in ("nav", "dtheta_prev", "dv_prev", "sums"):
        np.testing.assert_array_equal(getattr(split, name), getattr(whole, name))


def test_copy_is_independent():
    s = sd.StrapdownState(0.5, 1.0, 10.0, [1.0, 2.0, 3.0], np.eye(3))
    other = s.copy()
    other.propagate(np.ones((1, 3)), np.ones((1, 3)), np.full(1, 0.1), Z, Z)
    np.testing.assert_array_equal(s.nav, sd.StrapdownState(0.5, 1.0, 10.0, [1.0, 2.0, 3.0], np.eye(3)).nav)
    assert not np.any(s.sums) and not np.any(s.dtheta_prev)
    s.v_n[0] = 9.0
    assert s.nav[sd.V_N] == 9.0
    np.testing.assert_array_equal(s.c_nb, np.eye(3))


def test_attitude_stays_orthonormal():
    rng = np.random.default_rng(2)
    s, m = sd.StrapdownState(0.5, 1.0, 10.0, Z, dcm_from_euler(0.1, 0.2, 5.0)), 300000
    s.propagate(rng.normal(size=(m, 3)), np.tile([0.0, 0.0, -9.8], (m, 1)), np.full(m, 0.01), Z, Z)
    np.testing.assert_allclose(s.c_nb @ s.c_nb.T, np.eye(3), atol=1e-15)
    assert np.linalg.det(s.c_nb) == pytest.approx(1.0)


def test_longitude_stays_in_its_range():
    for lon, v_e in ((np.pi - 1e-8, 100.0), (-np.pi + 1e-8, -100.0)):
        s = sd.StrapdownState(0.0, lon, 0.0, [0.0, v_e, 0.0], np.eye(3))
        g = float(earth.gravity(0.0, 0.0))
        s.propagate(np.zeros((100, 3)), np.tile([0.0, 0.0, -g], (100, 1)), np.full(100, 0.01), Z, Z)
        assert abs(s.nav[sd.LON]) <= np.pi
        assert np.sign(s.nav[sd.LON]) == -np.sign(lon)


def test_sums_are_the_integrals_of_force_and_attitude():
    motion, dt, m = ship_in_waves(9), 0.01, 500
    s = start(motion, dt)
    sail(s, motion, 1, m, dt)
    t = (np.arange(m) + 0.5) * dt
    nav, _, force = motion.state(t)
    c = nav[:, 6:15].reshape(-1, 3, 3)
    np.testing.assert_allclose(s.sums[sd.SUM_FORCE], np.einsum("kij,kj->i", c, force) * dt, atol=1e-4)
    np.testing.assert_allclose(s.sums[sd.SUM_C_NB].reshape(3, 3), c.sum(0) * dt, atol=1e-4)
    assert s.sums[sd.SUM_DT] == pytest.approx(m * dt)


def test_pyins_on_the_same_increments():
    # an independent implementation (pyins 1.0, MIT): Coriolis term of first order, no 1/6 term; at height zero both gravities agree
    wave = ship_in_waves(11)
    motion = Motion(wave.lat, wave.lon, Wave(0.0, 0.0, (0.0,), (1.0,), (0.0,)), wave.roll, wave.pitch, wave.heading)
    dt, m = 0.01, 30000
    rate, force = motion.means(0, m + 1, dt)
    index = np.arange(m + 1) * dt
    columns = ["gyro_x", "gyro_y", "gyro_z", "accel_x", "accel_y", "accel_z"]
    imu = pd.DataFrame(np.hstack([rate, force]) * dt, index=index, columns=columns)
    nav = motion.state(0.0)[0][0]
    rph = np.rad2deg(np.array(euler_from_dcm(nav[6:15].reshape(3, 3))).ravel())
    names = ["lat", "lon", "alt", "VN", "VE", "VD", "roll", "pitch", "heading"]
    pva = pd.Series([*np.rad2deg(nav[:2]), *nav[2:6], *rph], index=names)
    integrator = pyins.strapdown.Integrator(pva, with_altitude=False)
    theirs = integrator.integrate(pyins.strapdown.compute_increments_from_imu(imu, "increment")).iloc[-1]
    c_nb = dcm_from_euler(*np.deg2rad(theirs[["roll", "pitch", "heading"]]))
    other = sd.StrapdownState(*np.deg2rad([theirs.lat, theirs.lon]), theirs.alt, theirs[["VN", "VE", "VD"]], c_nb)
    s = start(motion, dt)
    truth = sail(s, motion, 1, m, dt)
    e = difference(s.nav, other.nav)
    assert np.hypot(e[0], e[1]) < 0.02
    assert np.max(np.abs(e[3:5])) < 1e-3
    assert np.max(np.abs(e[6:9])) < 0.01 * ARCSEC
    assert np.linalg.norm(truth[:2]) < np.linalg.norm(difference(other.nav, motion.state(m * dt)[0][0])[:2])
