"""Earth: closed-form values, identities between the functions, kernels equal to the broadcasting versions."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from riins_core import earth

latitudes = st.floats(-1.55, 1.55)
heights = st.floats(-500.0, 20000.0)


def test_radii_at_equator_and_pole():
    r_m, r_n = earth.radii(np.array([0.0, np.pi / 2]))
    np.testing.assert_allclose(r_n, [earth.A, earth.A**2 / earth.B], rtol=1e-14)
    np.testing.assert_allclose(r_m, [earth.B**2 / earth.A, earth.A**2 / earth.B], rtol=1e-14)


def test_gravity_published_values():
    # NIMA TR8350.2: equator, pole, and 45 deg on the ellipsoid
    np.testing.assert_allclose(earth.gravity([0.0, np.pi / 2, np.pi / 4], 0.0), [9.7803253359, 9.8321849378, 9.8061977695], atol=2e-10)


@settings(max_examples=50, deadline=None)
@given(latitudes, heights)
def test_kernels_equal_broadcasting_versions(lat, h):
    np.testing.assert_allclose(earth.radii_s(lat), earth.radii(lat), rtol=1e-15)
    np.testing.assert_allclose(earth.gravity_s(lat, h), earth.gravity(lat, h), rtol=1e-15)


@settings(max_examples=50, deadline=None)
@given(latitudes, heights)
def test_gravity_gradient_is_the_derivative(lat, h):
    by_lat, by_h = earth.gravity_gradient_s(lat, h)
    e = 1e-4
    assert by_lat == pytest.approx(float(earth.gravity(lat + e, h) - earth.gravity(lat - e, h)) / (2 * e), abs=1e-8)
    assert by_h == pytest.approx(float(earth.gravity(lat, h + 100.0) - earth.gravity(lat, h - 100.0)) / 200.0, rel=1e-7)
    assert by_h == pytest.approx(-2.0 * float(earth.gravity(lat, h)) / earth.A, rel=0.02)


def test_parallel_shrinks_with_the_sine_of_latitude():
    # d/dL ((R_N + h) cos L) = -(R_M + h) sin L, on which the position error equations rest
    lat, h, e = np.linspace(-1.5, 1.5, 31), 1000.0, 1e-4

    def parallel(x):
        return (earth.radii(x)[1] + h) * np.cos(x)

    numeric = (parallel(lat + e) - parallel(lat - e)) / (2 * e)
    np.testing.assert_allclose(numeric, -(earth.radii(lat)[0] + h) * np.sin(lat), atol=0.05)


def test_earth_rate_and_transport_rate_of_an_eastward_ship_add():
    # going east at the speed of the ground turns n like a faster Earth: w_en = k w_ie for any latitude
    lat, h = 0.7, 30.0
    v_ground = earth.OMEGA_IE * (earth.radii(lat)[1] + h) * np.cos(lat)
    np.testing.assert_allclose(earth.transport_rate_n(lat, h, [0.0, v_ground, 0.0]), earth.earth_rate_n(lat), rtol=1e-12, atol=1e-20)
    assert earth.earth_rate_n(lat)[0] > 0.0  # the thesis' ch. 3 has the opposite sign


def test_shapes_broadcast():
    assert earth.transport_rate_n(np.zeros((4, 2)), 0.0, np.ones((4, 2, 3))).shape == (4, 2, 3)
    assert earth.earth_rate_n(np.zeros((5,))).shape == (5, 3)
