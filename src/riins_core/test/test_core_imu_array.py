"""Redundant geometry: tables 2.1 to 2.3 of the thesis to 1e-4 (target 1), parity and least-squares identities, refused geometries."""

import numpy as np
import pytest
import scipy.integrate
from hypothesis import given, settings
from hypothesis import strategies as st

from riins_core import imu_array as ia

SIX = list(ia.CONFIGURATIONS)
# thesis table 2.1: n, theta_n, theta_n - theta_{n-1}
TABLE_2_1 = [
    (3, 1.0, 0.0), (4, 1.75, 0.75), (5, 2.35, 0.6), (6, 2.85, 0.5), (7, 3.2786, 0.4286), (8, 3.6536, 0.3750), (9, 3.9869, 0.3333),
    (10, 4.2869, 0.3), (11, 4.5596, 0.2727), (12, 4.8096, 0.25), (13, 5.0404, 0.2308), (14, 5.2547, 0.2143), (15, 5.4547, 0.2), (16, 5.6422, 0.1875),
]  # fmt: skip


def random_geometry(seed, n):
    h = np.random.default_rng(seed).normal(size=(n, 3))
    return h / np.linalg.norm(h, axis=1, keepdims=True)


def test_table_2_1():
    rows = ia.table_2_1(16)
    np.testing.assert_allclose([(r.n, r.theta, r.delta) for r in rows], TABLE_2_1, atol=1e-4)


def test_table_2_1_by_the_integral():
    # (2-27) integrated numerically for n = 7 and four survivors
    from math import comb

    t = np.linspace(0.0, 40.0, 400001)
    q = np.exp(-t)
    reliability = sum(comb(7, k) * q**k * (1 - q) ** (7 - k) for k in range(4, 8))
    assert ia.reliability(7, 4) == pytest.approx(3.0 * scipy.integrate.trapezoid(reliability, t), abs=1e-6)


@pytest.mark.parametrize(("survivors", "best"), [(3, 6), (4, 9), (5, 11)])
def test_best_number_of_sensors_depends_on_the_survivors(survivors, best):
    assert max(ia.table_2_1(16, survivors), key=lambda r: r.figure).n == best


def test_table_2_2():
    rows = {r.name: r for r in ia.table_2_2()}
    assert set(rows) == set(SIX)
    for row in rows.values():
        assert row.deviation < 1e-14
        assert row.accuracy_figure == pytest.approx(8.0, abs=1e-12)
        assert row.gdop == pytest.approx(np.sqrt(1.5), abs=1e-12)
    assert np.rad2deg(rows["cone1"].angle) == pytest.approx(54.7356, abs=1e-4)
    assert np.rad2deg(rows["cone2"].angle) == pytest.approx(35.2644, abs=1e-4)
    assert np.rad2deg(rows["dodecahedron"].angle) == pytest.approx(31.71747, abs=1e-5)
    printed = [[0.5257, 0, 0.8507], [-0.5257, 0, 0.8507], [0.8507, 0.5257, 0], [0.8507, -0.5257, 0], [0, 0.8507, 0.5257], [0, 0.8507, -0.5257]]
    np.testing.assert_allclose(rows["dodecahedron"].H, printed, atol=1e-4)
    # with the errata applied
    s, c = 0.8165, 0.5774
    np.testing.assert_allclose(rows["cone1"].H[:3], [[s, 0, c], [s / 2, 0.7071, c], [-s / 2, 0.7071, c]], atol=1e-4)
    np.testing.assert_allclose(rows["cone2"].H[[2, 4]], [[-0.5, -0.8660, 0], [-0.2887, 0.5, s]], atol=1e-4)


@pytest.mark.parametrize(("make", "angle"), [(ia.cone1, ia.CONE1_ANGLE), (ia.cone2, ia.CONE2_ANGLE)])
def test_cone_angles_make_the_accuracy_figure_largest(make, angle):
    grid = np.linspace(0.05, 1.5, 2901)
    figures = [ia.ImuArray(make(a)).accuracy_figure() for a in grid]
    assert grid[np.argmax(figures)] == pytest.approx(angle, abs=1e-3)
    assert max(figures) <= ia.ImuArray(make(angle)).accuracy_figure() + 1e-12
    if make is ia.cone2:  # the printed 35.7356 deg is not the maximum
        assert ia.ImuArray(make(np.deg2rad(35.7356))).accuracy_figure() < 8.0 - 1e-4


def test_table_2_3():
    rows = ia.table_2_3()
    np.testing.assert_allclose([r.coherence for r in rows], [1.0, 0.6667, 0.5774, 0.4472], atol=1e-4)
    assert [r.name for r in rows if r.best] == ["dodecahedron"]


def test_a_rounded_dodecahedron_angle_leaks_gravity_into_parity():
    s, c = np.sin(np.deg2rad(31.7)), np.cos(np.deg2rad(31.7))
    rounded = np.array([[s, 0, c], [-s, 0, c], [c, s, 0], [c, -s, 0], [0, c, s], [0, c, -s]])
    leak = np.linalg.norm(ia.ImuArray(ia.dodecahedron()).parity() @ rounded, axis=0)
    assert np.max(leak) == pytest.approx(431e-6, abs=5e-6)


@pytest.mark.parametrize("name", SIX)
def test_parity_of_the_configurations(name):
    array = ia.ImuArray(ia.CONFIGURATIONS[name])
    V = array.parity()
    assert V.shape == (3, 6)
    np.testing.assert_allclose(V @ array.H, 0.0, atol=1e-15)
    np.testing.assert_allclose(V @ V.T, np.eye(3), atol=1e-15)  # the thesis' (4-84) has 2 I
    np.testing.assert_allclose(V.T @ V, np.eye(6) - array.H @ array.least_squares(), atol=1e-15)


def test_parity_is_the_thesis_matrix_up_to_its_scale_and_basis():
    # (4-84) stands with the sensor order of (4-83)
    s, c = np.sin(ia.DODECAHEDRON_ANGLE), np.cos(ia.DODECAHEDRON_ANGLE)
    H = np.array([[c, s, 0], [c, -s, 0], [0, c, s], [0, c, -s], [s, 0, c], [-s, 0, c]])
    V = np.array([[0, 0, -c, c, s, s], [-s, -s, 0, 0, c, -c], [c, -c, -s, -s, 0, 0]]) / np.sqrt(2.0)
    mine = ia.ImuArray(H).parity()
    np.testing.assert_allclose(V.T @ V, mine.T @ mine, atol=1e-15)


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 10**6), st.integers(4, 12), st.integers(0, 2**12 - 1))
def test_parity_and_least_squares_of_any_geometry_and_mask(seed, n, bits):
    array = ia.ImuArray(random_geometry(seed, n))
    used = [i for i in range(n) if bits >> i & 1]
    if len(used) < 3 or np.linalg.svd(array.H[used], compute_uv=False)[-1] < 1e-3:
        return
    mask = bits & ((1 << n) - 1)
    V, W = array.parity(mask), array.least_squares(mask)
    m = len(used)
    assert V.shape == (m - 3, m)
    np.testing.assert_allclose(V @ V.T, np.eye(m - 3), atol=1e-13)
    np.testing.assert_allclose(V @ array.H[used], 0.0, atol=1e-13)
    np.testing.assert_array_equal(np.tril(V, -1), 0.0)  # Potter's form
    assert np.all(np.diag(V) > -1e-15)
    full = array.parity_full(mask)
    np.testing.assert_array_equal(full[:, used], V)
    unused = [i for i in range(n) if i not in used]
    assert not np.any(full[:, unused]) and not np.any(W[:, unused])
    np.testing.assert_allclose(W @ array.H, np.eye(3), atol=1e-9)
    booleans = [i in used for i in range(n)]
    np.testing.assert_array_equal(array.least_squares(booleans), W)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10**6))
def test_weighted_least_squares_has_the_covariance_it_states(seed):
    array = ia.ImuArray(random_geometry(seed, 6))
    sigma = np.random.default_rng(seed).uniform(0.5, 3.0, 6)
    W, P = array.least_squares(sigma=sigma), array.covariance(sigma=sigma)
    np.testing.assert_allclose(W @ np.diag(sigma**2) @ W.T, P, rtol=1e-8, atol=1e-10)
    equal = array.least_squares() @ np.diag(sigma**2) @ array.least_squares().T
    assert np.linalg.eigvalsh(equal - P)[0] > -1e-9 * np.trace(equal)  # Gauss-Markov: no unweighted estimate is better


def test_parity_is_echelon_where_a_sensor_has_no_redundancy():
    H = np.vstack([[0.0, 0.0, 1.0], [1, 0, 0], [1, 0, 0], [0, 1, 0], [0, 1, 0]])
    V = ia.ImuArray(H).parity()
    h = np.sqrt(0.5)
    np.testing.assert_allclose(V, [[0, h, -h, 0, 0], [0, 0, 0, h, -h]], atol=1e-15)


@pytest.mark.parametrize(
    ("H", "message"),
    [
        (np.eye(2), "n x 3"),
        (np.eye(3)[:2], "n x 3"),
        (np.ones(6), "n x 3"),
        (np.diag([1.0, 1.0, 1.00001]), "sensor 3 has length"),
        ([[1, 0, 0], [0, 1, 0], [np.sqrt(0.5), np.sqrt(0.5), 0]], "plane"),
        ([[1, 0, 0], [0, 1, 0], [0, 0, np.nan]], "not finite"),
    ],
)
def test_bad_geometry_is_refused(H, message):
    with pytest.raises(ValueError, match=message):
        ia.ImuArray(H)


def test_rows_are_renormalised_and_read_only():
    array = ia.ImuArray(np.round(ia.dodecahedron(), 7))
    np.testing.assert_allclose(np.linalg.norm(array.H, axis=1), 1.0, atol=1e-15)
    with pytest.raises(ValueError, match="read-only"):
        array.H[0, 0] = 2.0


def test_bad_masks_and_sigmas_are_refused():
    array = ia.ImuArray(ia.orthogonal())
    with pytest.raises(ValueError, match="do not span"):
        array.least_squares([True, True, True, True, False, False])
    with pytest.raises(ValueError, match="6 elements"):
        array.parity([True] * 5)
    with pytest.raises(ValueError, match="positive"):
        array.covariance(sigma=0.0)
    with pytest.raises(ValueError, match="survivors"):
        ia.reliability(3, 4)
