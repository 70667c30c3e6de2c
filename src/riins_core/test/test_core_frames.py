"""Frames: the ROS boundary (REP-103) and the local tangent plane, as properties and by hand-made cases."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from riins_core import earth, frames
from riins_core.rotation import dcm_from_euler, dcm_from_quat, rotate

few = settings(max_examples=50, deadline=None)
vector = arrays(np.float64, 3, elements=st.floats(-1e3, 1e3))
latitude, longitude, height = st.floats(-1.5, 1.5), st.floats(-np.pi, np.pi), st.floats(-100.0, 9000.0)
attitude = st.tuples(st.floats(-3.0, 3.0), st.floats(-1.5, 1.5), st.floats(0.0, 6.28)).map(lambda a: dcm_from_euler(*a))


@few
@given(vector)
def test_axes_are_their_own_inverse(v):
    np.testing.assert_array_equal(frames.frd_to_flu(frames.frd_to_flu(v)), v)
    np.testing.assert_array_equal(frames.ned_to_enu(frames.enu_to_ned(v)), v)
    np.testing.assert_array_equal(frames.frd_to_flu(v), frames.FLU_FROM_FRD @ v)
    np.testing.assert_array_equal(frames.ned_to_enu(v), frames.ENU_FROM_NED @ v)
    assert np.linalg.det(frames.ENU_FROM_NED) == np.linalg.det(frames.FLU_FROM_FRD) == 1.0


@few
@given(vector, arrays(np.float64, (3, 3), elements=st.floats(-10.0, 10.0)))
def test_covariances_follow_their_vectors(v, a):
    P = a @ a.T
    assert np.isclose(frames.ned_to_enu(v) @ frames.ned_to_enu_covariance(P) @ frames.ned_to_enu(v), v @ P @ v, rtol=1e-9, atol=1e-9)
    assert np.isclose(frames.frd_to_flu(v) @ frames.frd_to_flu_covariance(P) @ frames.frd_to_flu(v), v @ P @ v, rtol=1e-9, atol=1e-9)


def test_headings_become_ros_yaw():
    for heading, yaw in ((0.0, 90.0), (90.0, 0.0), (180.0, -90.0), (270.0, 180.0)):
        q = frames.attitude_to_enu(dcm_from_euler(0.0, 0.0, np.deg2rad(heading)))
        got = np.rad2deg(2.0 * np.arctan2(q[2], q[3]))
        assert np.isclose(np.cos(np.deg2rad(got - yaw)), 1.0), heading
        np.testing.assert_allclose(q[:2], 0.0, atol=1e-15)


def test_bow_up_is_negative_pitch_about_the_ros_y_axis():
    q = frames.attitude_to_enu(dcm_from_euler(0.0, 0.1, np.pi / 2))  # bow to the east
    np.testing.assert_allclose(dcm_from_quat(q) @ [1, 0, 0], [np.cos(0.1), 0.0, np.sin(0.1)], atol=1e-15)
    np.testing.assert_allclose(dcm_from_quat(q) @ [0, 1, 0], [0, 1, 0], atol=1e-15)  # port is north


@few
@given(attitude, vector)
def test_attitude_round_trip_and_vectors(c_nb, v):
    q = frames.attitude_to_enu(c_nb)
    np.testing.assert_allclose(frames.attitude_from_enu(q), c_nb, atol=1e-14)
    np.testing.assert_allclose(rotate(dcm_from_quat(q), frames.frd_to_flu(v)), frames.ned_to_enu(rotate(c_nb, v)), atol=1e-10)


@few
@given(st.floats(-np.pi / 2, np.pi / 2), longitude, st.floats(-1e4, 3e7))
def test_ecef_round_trip_everywhere(lat, lon, h):
    r = frames.ecef_from_geodetic(lat, lon, h)
    lat1, lon1, h1 = frames.geodetic_from_ecef(r)
    np.testing.assert_allclose(frames.ecef_from_geodetic(lat1, lon1, h1), r, atol=2e-8)
    assert abs(lat1 - lat) < 1e-14
    assert abs(h1 - h) < 2e-8


def test_ecef_axes():
    np.testing.assert_allclose(frames.ecef_from_geodetic(0.0, 0.0, 10.0), [earth.A + 10.0, 0.0, 0.0])
    np.testing.assert_allclose(frames.ecef_from_geodetic(0.0, np.pi / 2, 0.0), [0.0, earth.A, 0.0], atol=1e-9)
    np.testing.assert_allclose(frames.ecef_from_geodetic(np.pi / 2, 0.3, 5.0), [0.0, 0.0, earth.B + 5.0], atol=1e-8)


@few
@given(latitude, longitude, height, st.floats(-0.05, 0.05), st.floats(-0.05, 0.05), attitude)
def test_local_frame_round_trip(lat, lon, h, dlat, dlon, c_nb):
    local = frames.LocalFrame(lat, lon, h)
    place = (np.clip(lat + dlat, -1.55, 1.55), frames.wrap_longitude(lon + dlon), h + 30.0)
    np.testing.assert_allclose(local.to_enu(lat, lon, h), 0.0, atol=1e-8)
    back = local.to_geodetic(local.to_enu(*place))
    np.testing.assert_allclose(frames.ned_difference(*back, *place), 0.0, atol=1e-7)
    q = local.attitude(place[0], place[1], c_nb)
    np.testing.assert_allclose(local.c_nb(place[0], place[1], q), c_nb, atol=1e-13)


def test_local_frame_velocity_is_the_derivative_of_position():
    local, e = frames.LocalFrame(0.9, 3.1, 20.0), 1e-7
    lat, lon, h = 0.93, -3.12, 50.0  # across the seam at 180 deg
    r_m, r_n = earth.radii(lat)
    v = np.array([3.0, -4.0, 1.0])

    def position(t):
        return local.to_enu(lat + v[0] / (r_m + h) * t, lon + v[1] / (r_n + h) / np.cos(lat) * t, h - v[2] * t)

    numeric = (position(1e4 * e) - position(-1e4 * e)) / (2e4 * e)
    np.testing.assert_allclose(local.vector(lat, lon, v), numeric, atol=1e-5)
    P = np.diag([1.0, 4.0, 9.0])
    c = np.linalg.eigvalsh(local.covariance(lat, lon, P))
    np.testing.assert_allclose(c, [1.0, 4.0, 9.0])
    # the same attitude and the same vector
    c_nb = dcm_from_euler(0.1, -0.2, 4.0)
    turned = rotate(dcm_from_quat(local.attitude(lat, lon, c_nb)), frames.frd_to_flu(c_nb.T @ v))
    np.testing.assert_allclose(turned, local.vector(lat, lon, v), atol=1e-12)


def test_at_the_datum_the_local_frame_is_plain_enu():
    local, c_nb = frames.LocalFrame(-0.6, 2.6, 0.0), dcm_from_euler(0.02, 0.01, 1.0)
    np.testing.assert_allclose(local.vector(-0.6, 2.6, [1.0, 2.0, 3.0]), [2.0, 1.0, -3.0], atol=1e-14)
    np.testing.assert_allclose(local.attitude(-0.6, 2.6, c_nb), frames.attitude_to_enu(c_nb), atol=1e-14)
    np.testing.assert_allclose(local.to_enu(-0.6 + 1e-6, 2.6, 0.0)[:2], [0.0, 1e-6 * float(earth.radii(-0.6)[0])], atol=1e-5)


@pytest.mark.parametrize("datum", [(2.0, 0.0, 0.0), (float("nan"), 0.0, 0.0), (0.0, float("inf"), 0.0)])
def test_bad_datum_is_refused(datum):
    with pytest.raises(ValueError, match="not a place"):
        frames.LocalFrame(*datum)


@few
@given(latitude, longitude, height, vector)
def test_ned_difference_and_offset(lat, lon, h, d):
    moved = frames.ned_offset(lat, lon, h, d)
    assert abs(moved[1]) <= np.pi
    np.testing.assert_allclose(frames.ned_difference(*moved, lat, lon, h), d, atol=1e-8)


def test_ned_difference_agrees_with_the_tangent_plane_and_the_seam():
    lat, lon, h = 0.8, np.pi - 1e-7, 10.0
    other = (lat + 2e-6, -np.pi + 2e-6, h + 3.0)
    enu = frames.LocalFrame(lat, lon, h).to_enu(*other)
    np.testing.assert_allclose(frames.ned_to_enu(frames.ned_difference(*other, lat, lon, h)), enu, atol=1e-4)
    assert frames.ned_difference(np.zeros(4), 0.0, 0.0, 0.0, 0.0, np.zeros(4)).shape == (4, 3)


def test_a_nan_of_an_unmeasured_axis_does_not_spread() -> None:
    P = np.diag([4.0, 9.0, np.nan])
    P[0, 1] = P[1, 0] = 1.0
    assert frames.enu_to_ned_covariance(P)[:2, :2] == pytest.approx(np.array([[9.0, 1.0], [1.0, 4.0]]))
    assert frames.flu_to_frd_covariance(P)[:2, :2] == pytest.approx(np.array([[4.0, -1.0], [-1.0, 9.0]]))
