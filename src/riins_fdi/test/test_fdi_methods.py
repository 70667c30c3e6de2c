"""The four parity tests through one interface, and the two-stage search: false alarms, isolation, ambiguity; targets 3, 4 and 7."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import chi2

from riins_core.imu_array import CONFIGURATIONS, ImuArray
from riins_core.sensor_errors import normal
from riins_fdi.methods import METHODS, DirectComparison, SingularValues, make
from riins_fdi.parity import fault_identifiers, parity_test
from riins_fdi.search import explain, pair_scores, single_scores

ARRAY = ImuArray(CONFIGURATIONS["dodecahedron"])
ALPHA = 1e-3


def skewed(n: int) -> ImuArray:
    """Axes on a spiral over the sphere."""
    z = (np.arange(n) + 0.5) / n
    turn = 2.4 * np.arange(n)
    r = np.sqrt(1.0 - z**2)
    return ImuArray(np.column_stack([r * np.cos(turn), r * np.sin(turn), z]))


def geometry(name: str) -> ImuArray:
    return skewed(int(name[6:])) if name.startswith("spiral") else ImuArray(CONFIGURATIONS[name])


@pytest.mark.parametrize("name", METHODS)
@pytest.mark.parametrize("shape", ["dodecahedron", "orthogonal", "spiral4", "spiral8"])
def test_false_alarms_of_the_family(name: str, shape: str) -> None:
    """Target 3 for every method, geometry and unequal noise: the threshold is for all the tests a method makes together."""
    array = geometry(shape)
    sigma = np.linspace(0.5, 2.0, array.n)
    method, epochs = make(name, array, sigma, ALPHA), 300_000
    m = normal(31, 0, 0, epochs, array.n) * sigma + np.array([3.0, -2.0, 5.0]) @ array.H.T
    alarms = sum(np.count_nonzero(method.statistic(part) > method.threshold) for part in np.array_split(m, 30))
    assert alarms / epochs == pytest.approx(ALPHA, rel=0.2)  # 300 expected, 3.5 sigma


@pytest.mark.parametrize("name", METHODS)
def test_a_step_points_at_its_sensor(name: str) -> None:
    method = make(name, ARRAY, 1.0, ALPHA)
    rng = np.random.default_rng(32)
    for sensor in range(6):
        z = rng.standard_normal((4000, 6))
        z[:, sensor] += 9.0
        alarm = method.statistic(z) > method.threshold
        named = method.isolate(z)
        assert np.mean(alarm & (named == sensor)) >= (0.85 if name == "direct_comparison" else 0.985)
        if name == "direct_comparison":  # an equation holds by chance: it names nobody rather than a wrong one
            assert np.mean(alarm & (named >= 0) & (named != sensor)) < 0.01


def test_sensors_out_of_use_do_not_matter() -> None:
    for name in METHODS:
        method = make(name, ARRAY, 1.0, ALPHA, mask=0b011111)
        m = np.random.default_rng(1).standard_normal(6)
        m[2] += 30.0
        values = []
        for rubbish in (0.0, 1e9, np.nan):
            m[5] = rubbish
            answer = method.diagnose(m)
            values.append((float(method.statistic(m)), int(method.isolate(m)), answer.alarm, answer.sensors))
        assert values[0] == values[1] == values[2] and values[0][1:] == (2, True, (2,))
        with pytest.raises(ValueError, match="no redundancy"):
            make(name, ARRAY, 1.0, ALPHA, mask=0b000111)
    with pytest.raises(ValueError, match="no method 'glr'"):
        make("glr", ARRAY, 1.0, ALPHA)


def test_svd_is_glt_in_other_coordinates() -> None:
    sigma = np.array([1.0, 2.0, 0.5, 1.5, 1.0, 3.0])
    svd, glt = make("svd", ARRAY, sigma, ALPHA), make("glt", ARRAY, sigma, ALPHA)
    assert isinstance(svd, SingularValues)
    m = np.random.default_rng(2).standard_normal((1000, 6)) * 3.0
    np.testing.assert_allclose(svd.statistic(m), glt.statistic(m), rtol=1e-10)
    np.testing.assert_allclose(svd.projector @ (ARRAY.H / sigma[:, None]), 0.0, atol=1e-12)
    equal = make("svd", ARRAY, 1.0, ALPHA)
    np.testing.assert_array_equal(equal.isolate(m), make("glt", ARRAY, 1.0, ALPHA).isolate(m))


def test_direct_comparison_is_table_4_2_for_large_faults() -> None:
    method = make("direct_comparison", ARRAY, 1.0, ALPHA)
    assert isinstance(method, DirectComparison)
    for word, failed in fault_identifiers(method.members, 6).items():
        m = ARRAY.H @ [0.3, -1.2, 0.7]
        for size, sensor in zip((1000.0, 370.0), failed, strict=False):
            m[sensor] += size
        answer = method.diagnose(m)
        assert method.word(m) == word and answer.sensors == failed and answer.alarm == bool(failed)
        assert int(method.isolate(m)) == (failed[0] if len(failed) == 1 else -1)


def test_small_faults_give_words_outside_the_table() -> None:
    """Errata: 0x0000 for soft faults does not happen; the words are in no table, and the equations still say who can be meant."""
    method = make("direct_comparison", ARRAY, 1.0, ALPHA)
    assert isinstance(method, DirectComparison)
    table = fault_identifiers(method.members, 6)
    rng, outside, zero, named, cases = np.random.default_rng(3), 0, 0, 0, 0
    while cases < 400:
        m = rng.standard_normal(6)
        m[0] += 7.0
        word = method.word(m)
        if word == 0x7FFF:
            continue  # missed
        cases += 1
        outside += word not in table
        zero += word == 0
        named += 0 in {s for e in method.diagnose(m).explanations for s in e.sensors}
    assert outside > 0.4 * cases and zero == 0
    assert named > 0.95 * cases


def two_faults(k: int, seed: int, low: float) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
    """Target 7: two of six sensors fail at once, the larger fault 20 sigma, random signs, size ratio low..1."""
    rng = np.random.default_rng(seed)
    z, who = rng.standard_normal((k, 6)), np.array([rng.permutation(6)[:2] for _ in range(k)])
    sign = rng.choice([-20.0, 20.0], (k, 2))
    z[np.arange(k), who[:, 0]] += sign[:, 0]
    z[np.arange(k), who[:, 1]] += sign[:, 1] * rng.uniform(low, 1.0, k)
    return z, np.sort(who, axis=1)


def test_two_unequal_faults() -> None:
    """Target 7: the most likely pair is the right one in at least .60 of the cases."""
    test = parity_test(ARRAY, 0b111111, 1.0, ALPHA)
    z, who = two_faults(20_000, 41, 0.3)
    pairs, scores = pair_scores(test, z)
    assert np.mean((pairs[scores.argmax(axis=1)] == who).all(axis=1)) >= 0.60


def test_search_reports_every_explanation() -> None:
    """The right pair is among those reported, and a pair is declared only where it alone is left: wrong in less than 1 %."""
    test = parity_test(ARRAY, 0b111111, 1.0, ALPHA)
    z, who = two_faults(1500, 42, 0.3)
    inside = wrong = 0
    for m, pair in zip(z, who, strict=True):
        answer = explain(test, m, keep=1e-2)
        true = tuple(pair.tolist())
        inside += any(set(e.sensors) <= set(true) for e in answer.explanations)
        wrong += bool(answer.sensors) and not set(answer.sensors) <= set(true)
        if answer.ambiguous:
            shares = [e.probability for e in answer.explanations]
            assert answer.sensors == () and shares == sorted(shares, reverse=True) and sum(shares) <= 1.0 + 1e-9
    assert inside / len(z) > 0.97 and wrong / len(z) < 0.01


def test_equal_faults_are_ambiguous() -> None:
    """Target 7: the thesis' own +2/-2 deg/h case; both the true pair and its double are reported, equally likely without noise."""
    test = parity_test(ARRAY, 0b111111, 1.0, ALPHA)
    for (i, j), sign in itertools.product(itertools.combinations(range(6), 2), (1.0, -1.0)):
        m = np.zeros(6)
        m[i], m[j] = 20.0, 20.0 * sign
        answer = explain(test, m)
        assert answer.ambiguous and answer.sensors == () and not answer.unexplained
        best, second = answer.explanations[:2]
        assert (i, j) in (best.sensors, second.sensors) and best.probability == pytest.approx(second.probability)
        assert max(abs(abs(s) - 20.0) for e in (best, second) if e.sensors == (i, j) for s in e.sizes) < 1e-9
    z, who = two_faults(2000, 43, 1.0)
    answers = [explain(test, m) for m in z]
    assert np.mean([a.ambiguous for a in answers]) > 0.99
    assert np.mean([tuple(w.tolist()) in [e.sensors for e in a.explanations] for a, w in zip(answers, who, strict=True)]) > 0.99


def test_three_faults_are_unexplained_with_more_sensors() -> None:
    array = skewed(9)
    test = parity_test(array, (1 << 9) - 1, 1.0, ALPHA)
    m = np.zeros(9)
    m[[0, 3, 7]] = 60.0, -90.0, 75.0
    answer = explain(test, m)
    assert answer.unexplained and answer.sensors == ()
    m[7] = 0.0
    assert explain(test, m).sensors == (0, 3)
    sizes = explain(test, m).explanations[0].sizes
    np.testing.assert_allclose(sizes, (60.0, -90.0), atol=1e-9)


def test_scores_are_what_leaves_the_statistic() -> None:
    sigma = np.array([1.0, 2.0, 0.5, 1.5, 1.0, 3.0])
    full = parity_test(ARRAY, 0b111111, sigma, ALPHA)
    z = np.random.default_rng(5).standard_normal((10, 6)) * 4.0
    glt = make("glt", ARRAY, sigma, ALPHA)
    pairs, scores = pair_scores(full, z)
    for row, (i, j) in enumerate(pairs):
        without = make("glt", ARRAY, sigma, ALPHA, mask=0b111111 & ~(1 << i) & ~(1 << j))
        np.testing.assert_allclose(glt.statistic(z) - scores[:, row], without.statistic(z), atol=1e-9)
    for i in range(6):
        without = make("glt", ARRAY, sigma, ALPHA, mask=0b111111 & ~(1 << i))
        np.testing.assert_allclose(glt.statistic(z) - single_scores(full, z)[:, i], without.statistic(z), atol=1e-9)


def test_four_sensors_only_detect() -> None:
    test = parity_test(ARRAY, 0b001111, 1.0, ALPHA)
    m = np.array([50.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    answer = explain(test, m)
    assert answer.alarm and answer.sensors == () and len(answer.explanations) == 4
    assert answer.statistic > chi2.isf(ALPHA, 1)
