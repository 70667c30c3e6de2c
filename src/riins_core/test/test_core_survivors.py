"""Accuracy after isolation: identities of tight frames, the named choice and direction have the worst sigma, envelopes bound every choice."""

import itertools

import numpy as np
import pytest

from riins_core.imu_array import CONFIGURATIONS, ImuArray, dodecahedron, orthogonal
from riins_core.survivors import worst_case_after_isolation, worst_sigma_by_direction


def test_worst_case_of_the_configurations():
    rows = {name: worst_case_after_isolation(ImuArray(h)) for name, h in CONFIGURATIONS.items()}
    for table in rows.values():
        assert table[0].direction is None  # H'H = 2 I
        assert table[0].sigma_worst == pytest.approx(np.sqrt(0.5))
        assert table[1].sigma_worst == pytest.approx(1.0)  # any tight frame loses half of one direction's information
        assert table[1].gdop == pytest.approx(np.sqrt(2.0))
        assert table[1].alike == 6  # ... whichever sensor it is
        assert [r.choices for r in table] == [1, 6, 15, 20]
        assert all(a.gdop <= b.gdop for a, b in itertools.pairwise(table))
    assert [r.singular for r in rows["dodecahedron"]] == [0, 0, 0, 0]
    assert [r.singular for r in rows["orthogonal"]] == [0, 0, 3, 12]
    assert rows["orthogonal"][2].gdop == np.inf and rows["orthogonal"][2].accuracy_figure == 0.0
    assert rows["orthogonal"][2].sensors == (0, 1) and rows["orthogonal"][2].alike == 3  # both sensors of an axis
    np.testing.assert_allclose(rows["orthogonal"][2].direction, [1, 0, 0], atol=1e-12)
    assert min(rows, key=lambda n: rows[n][2].gdop) == "dodecahedron"
    assert rows["dodecahedron"][2].gdop == pytest.approx(np.sqrt(3.0))
    with pytest.raises(ValueError, match="isolate 4 of 6"):
        worst_case_after_isolation(ImuArray(dodecahedron()), (4,))


def test_the_named_choice_has_the_worst_sigma_along_the_named_direction():
    h = np.random.default_rng(4).normal(size=(7, 3))
    array = ImuArray(h / np.linalg.norm(h, axis=1, keepdims=True))
    for row in worst_case_after_isolation(array, (1, 2, 3)):
        left = [i not in row.sensors for i in range(7)]
        assert np.sqrt(row.direction @ array.covariance(left) @ row.direction) == pytest.approx(row.sigma_worst, rel=1e-9)
        assert row.alike == 1  # no symmetry in a drawn geometry
        every = [[i not in out for i in range(7)] for out in itertools.combinations(range(7), row.isolated)]
        assert row.accuracy_figure == pytest.approx(min(array.accuracy_figure(use) for use in every))
        assert row.gdop == pytest.approx(max(array.gdop(use) for use in every))
        assert worst_sigma_by_direction(array, [row.direction], row.isolated)[0] == pytest.approx(row.sigma_worst, rel=1e-9)


def test_sigma_by_direction_is_that_of_the_worst_choice_of_each_direction():
    array = ImuArray(dodecahedron())
    directions = np.random.default_rng(1).standard_normal((500, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    none, one, two = (worst_sigma_by_direction(array, directions, k) for k in (0, 1, 2))
    np.testing.assert_allclose(none, np.sqrt(0.5), atol=1e-12)  # H'H = 2 I: the same everywhere
    assert np.all(one >= none) and one.max() <= 1.0
    assert np.all(two >= one) and 1.3 < two.max() <= 1.345
    single = np.array([np.einsum("ki,ij,kj->k", directions, array.covariance(np.arange(6) != i), directions) for i in range(6)])
    np.testing.assert_allclose(one**2, single.max(axis=0), rtol=1e-12)
    assert np.all(np.isinf(worst_sigma_by_direction(ImuArray(orthogonal()), directions, 2)))
