"""Rotations: group identities on random rotations (hypothesis) and agreement with SciPy as an independent implementation."""

import numpy as np
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from riins_core import rotation as r

angle = st.floats(-np.pi, np.pi)
component = st.floats(-5.0, 5.0).map(lambda x: x if abs(x) > 1e-12 else 0.0)
vector = arrays(np.float64, 3, elements=component)
few = settings(max_examples=50, deadline=None)


def unit_quaternion():
    return arrays(np.float64, 4, elements=st.floats(-1.0, 1.0)).filter(lambda q: np.linalg.norm(q) > 0.1).map(r.quat_normalize)


@few
@given(vector, vector)
def test_skew_is_the_cross_product(a, b):
    np.testing.assert_allclose(r.skew(a) @ b, np.cross(a, b), atol=1e-13)


@few
@given(angle, st.floats(-1.57, 1.57), st.floats(0.0, 6.283))
def test_euler_round_trip_and_scipy(roll, pitch, heading):
    c = r.dcm_from_euler(roll, pitch, heading)
    np.testing.assert_allclose(c, Rotation.from_euler("ZYX", [heading, pitch, roll]).as_matrix(), atol=1e-15)
    np.testing.assert_allclose(r.dcm_from_euler(*r.euler_from_dcm(c)), c, atol=1e-12)
    assert 0.0 <= r.euler_from_dcm(c)[2] < 2.0 * np.pi


def test_heading_is_clockwise_and_the_axes_are_frd():
    np.testing.assert_allclose(r.dcm_from_euler(0.0, 0.0, np.pi / 2) @ [1, 0, 0], [0, 1, 0], atol=1e-15)  # heading east: bow to the east
    np.testing.assert_allclose(r.dcm_from_euler(0.0, 0.1, 0.0) @ [1, 0, 0], [np.cos(0.1), 0, -np.sin(0.1)], atol=1e-15)  # pitch up: bow up
    np.testing.assert_allclose(r.dcm_from_euler(0.1, 0.0, 0.0) @ [0, 1, 0], [0, np.cos(0.1), np.sin(0.1)], atol=1e-15)  # roll: starboard down


def test_heading_quadrant_of_a_heeling_ship():
    # the thesis' (2-15) looks at c22, negative here although the heading is 30 deg
    c = r.dcm_from_euler(np.deg2rad(120.0), 0.0, np.deg2rad(30.0))
    assert c[1, 1] < 0.0
    np.testing.assert_allclose(np.rad2deg(r.euler_from_dcm(c)[2]), 30.0, atol=1e-12)


def test_a_tiny_negative_heading_stays_below_a_full_turn():
    assert r.euler_from_dcm(r.dcm_from_euler(0.0, 0.0, -1e-17))[2] < 2.0 * np.pi


@few
@given(vector)
def test_exponential(v):
    c = r.exp_so3(v)
    np.testing.assert_allclose(c @ c.T, np.eye(3), atol=1e-14)
    np.testing.assert_allclose(c, Rotation.from_rotvec(v).as_matrix(), atol=1e-14)
    np.testing.assert_allclose(r.dcm_from_quat(r.quat_from_rotvec(v)), c, atol=1e-14)
    out = np.empty((3, 3))
    r.exp_so3_into(*v, out)
    np.testing.assert_allclose(out, c, atol=1e-15)


@few
@given(vector, st.sampled_from([1e-9, 1e-5, 0.9e-4, 1.1e-4, 0.009, 0.011, 0.3, 3.0]))
def test_log_inverts_exp_at_every_size(v, size):
    assume(np.linalg.norm(v) > 1e-3)
    v = v / np.linalg.norm(v) * size
    np.testing.assert_allclose(r.log_so3(r.exp_so3(v)), v, rtol=1e-9, atol=1e-16)
    out = np.empty((3, 3))
    r.exp_so3_into(*v, out)
    np.testing.assert_allclose(out, Rotation.from_rotvec(v).as_matrix(), atol=5e-16)


def test_log_at_half_a_turn():
    for axis in np.vstack([np.eye(3), r.quat_normalize([[1.0, 2.0, -3.0]])]):
        v = np.pi * axis
        got = r.log_so3(r.exp_so3(v))
        np.testing.assert_allclose(np.abs(got @ axis), np.pi, atol=1e-7)  # either sign of the axis is right


@few
@given(unit_quaternion(), unit_quaternion(), vector)
def test_quaternion_algebra(p, q, v):
    cp, cq = r.dcm_from_quat(p), r.dcm_from_quat(q)
    np.testing.assert_allclose(r.dcm_from_quat(r.quat_multiply(p, q)), cp @ cq, atol=1e-13)
    np.testing.assert_allclose(r.dcm_from_quat(r.quat_conjugate(q)), cq.T, atol=1e-14)
    np.testing.assert_allclose(cq, Rotation.from_quat(q).as_matrix(), atol=1e-14)
    back = r.quat_from_dcm(cq)
    assert back[3] >= 0.0
    np.testing.assert_allclose(abs(back @ q), 1.0, atol=1e-14)
    np.testing.assert_allclose(r.rotate(cq, v), cq @ v, atol=1e-13)


@few
@given(unit_quaternion(), arrays(np.float64, (3, 3), elements=st.floats(-0.01, 0.01)))
def test_orthonormalize_gives_the_nearest_rotation(q, noise):
    c = r.dcm_from_quat(q)
    near = r.orthonormalize(c + noise)
    np.testing.assert_allclose(near @ near.T, np.eye(3), atol=1e-14)
    assert np.linalg.det(near) > 0.0
    assert np.linalg.norm(near - c - noise) <= np.linalg.norm(noise) + 1e-14


def test_leading_shapes():
    rng = np.random.default_rng(1)
    v = rng.normal(size=(4, 5, 3))
    c = r.exp_so3(v)
    assert c.shape == (4, 5, 3, 3)
    np.testing.assert_array_equal(c[2, 3], r.exp_so3(v[2, 3]))
    assert r.quat_from_dcm(c).shape == (4, 5, 4)
    np.testing.assert_allclose(r.quat_from_dcm(c)[1, 2], r.quat_from_dcm(c[1, 2]), atol=1e-16)
