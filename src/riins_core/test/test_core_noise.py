"""Addressed noise: published Philox vectors, bits that no split changes, and the statistics the sequences promise."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from riins_core import noise

few = settings(max_examples=25, deadline=None)
splits = st.lists(st.integers(1, 90), min_size=1, max_size=6)
starts = st.one_of(st.integers(0, 300), st.integers(0, noise.K_MAX - 1000))


def pieces(source, k0, sizes):
    out = []
    for size in sizes:
        out.append(source(k0, size))
        k0 += size
    return np.vstack(out)


@pytest.mark.parametrize(
    ("counter", "key", "words"),
    [  # Random123, kat_vectors, philox4x32 10
        ((0, 0, 0, 0), (0, 0), (0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8)),
        ((0xFFFFFFFF,) * 4, (0xFFFFFFFF,) * 2, (0x408F276D, 0x41C83B0E, 0xA20BC7C6, 0x6D5451FD)),
        ((0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344), (0xA4093822, 0x299F31D0), (0xD16CFE09, 0x94FDCCEB, 0x5001E420, 0x24126EA1)),
    ],
)
def test_philox_known_answers(counter, key, words):
    assert noise.philox4x32(*map(np.uint64, (*counter, *key))) == words


@few
@given(starts, splits, st.integers(1, 7), st.integers(0, 2**63 - 1))
def test_normal_has_the_same_bits_however_it_is_split(k0, sizes, width, seed):
    whole = noise.normal(seed, "gyro", k0, sum(sizes), width)
    np.testing.assert_array_equal(pieces(lambda k, m: noise.normal(seed, "gyro", k, m, width), k0, sizes), whole)
    np.testing.assert_array_equal(noise.normal(seed, "gyro", k0, sum(sizes), width + 3)[:, :width], whole)


@pytest.mark.parametrize(
    "source",
    [noise.GaussMarkov(2.0, 0.7, 0.01, 3, "m", 4).block, noise.GaussMarkov(2.0, 1e7, 0.01, 3, "m", 4).block, noise.RandomWalk(0.1, 3, "w", 4).block],
)
@few
@given(starts, splits)
def test_sequences_have_the_same_bits_however_they_are_split(source, k0, sizes):
    np.testing.assert_array_equal(pieces(source, k0, sizes), source(k0, sum(sizes)))


def test_normal_distribution():
    z = noise.normal(11, "distribution", 0, 400000, 5).ravel()
    n = z.size
    for power, mean, variance in ((1, 0.0, 1.0), (2, 1.0, 2.0), (3, 0.0, 15.0), (4, 3.0, 96.0), (6, 15.0, 10170.0)):
        assert abs(np.mean(z**power) - mean) < 4.5 * np.sqrt(variance / n), power
    assert stats.kstest(z, "norm").pvalue > 1e-4
    # the tail beyond the base layer of the ziggurat has its own code
    edges = np.array([3.0, 3.4, 3.6541528853610088, 4.0, 4.5, np.inf])
    expected = 2.0 * n * np.diff(stats.norm.cdf(edges))
    counted = np.histogram(np.abs(z), edges)[0]
    assert stats.chi2.sf(np.sum((counted - expected) ** 2 / expected), len(expected)) > 1e-4


def test_samples_columns_streams_and_seeds_are_independent():
    n = 200000
    z = noise.normal(5, "a", 0, n, 3)
    others = {
        "next sample": (z[1:, 0], z[:-1, 0]),
        "next column": (z[:, 0], z[:, 1]),
        "third column": (z[:, 0], z[:, 2]),
        "other stream": (z[:, 0], noise.normal(5, "b", 0, n, 1)[:, 0]),
        "other seed": (z[:, 0], noise.normal(6, "a", 0, n, 1)[:, 0]),
        "number and name": (z[:, 0], noise.normal(5, 7, 0, n, 1)[:, 0]),
        "squares": (z[1:, 0] ** 2, z[:-1, 0] ** 2),
    }
    for name, (a, b) in others.items():
        assert abs(np.corrcoef(a, b)[0, 1]) < 4.5 / np.sqrt(n), name


def test_gauss_markov_statistics():
    dt, tau, sigma = 0.1, 5.0, 2.0
    x = noise.GaussMarkov(sigma, tau, dt, 1, "gm", 400).block(12345, 3000)
    independent = 400 * 3000 * dt / (2 * tau)
    assert abs(np.mean(x)) < 4.5 * sigma / np.sqrt(independent)
    assert np.var(x) == pytest.approx(sigma**2, rel=4.5 * np.sqrt(2.0 / independent))
    for lag in (1, 10, 50, 64, 100, 200):
        assert np.mean(x[lag:] * x[:-lag]) / sigma**2 == pytest.approx(np.exp(-lag * dt / tau), abs=0.03)
    # the driving noise of the recursion is white, also across the knots every 64 samples
    phi = np.exp(-dt / tau)
    w = (x[1:] - phi * x[:-1]) / (sigma * np.sqrt(1 - phi**2))
    per_sample = np.mean(w**2, axis=1)
    assert np.max(np.abs(per_sample - 1.0)) < 5.5 * np.sqrt(2.0 / 400)
    for lag in (1, 2, 63, 64, 65):
        assert abs(np.mean(w[lag:] * w[:-lag])) < 4.5 / np.sqrt(w[lag:].size), lag


def test_gauss_markov_far_from_the_origin_and_of_long_memory():
    x = noise.GaussMarkov(1.0, 3600.0, 0.01, 2, "far", 4000)
    far = x.block(noise.K_MAX - 10, 10)
    assert np.var(far[0]) == pytest.approx(1.0, rel=0.1)
    one_hour = x.block(360000 + 777, 1)[0] * x.block(777, 1)[0]
    assert np.mean(one_hour) == pytest.approx(np.exp(-1.0), abs=4.5 / np.sqrt(4000))


def test_random_walk_statistics():
    walk = noise.RandomWalk(0.3, 4, "rw", 4000)
    np.testing.assert_array_equal(walk.block(0, 1), 0.0)
    for k in (1, 63, 64, 1000, 4321000):
        assert np.var(walk.block(k, 1)[0]) == pytest.approx(0.09 * k, rel=4.5 * np.sqrt(2.0 / 4000))
    steps = np.diff(walk.block(50, 300), axis=0)
    assert np.var(steps) == pytest.approx(0.09, rel=0.01)
    assert abs(np.mean(steps[1:] * steps[:-1])) / 0.09 < 4.5 / np.sqrt(steps[1:].size)


def test_sample_numbers_have_a_range():
    for source in (lambda k, m: noise.normal(0, 0, k, m, 1), noise.RandomWalk(1.0, 0, 0, 1).block):
        assert source(5, 0).shape == (0, 1)
        with pytest.raises(ValueError, match="outside"):
            source(-1, 2)
        with pytest.raises(ValueError, match="outside"):
            source(noise.K_MAX - 1, 2)
    with pytest.raises(ValueError, match="positive"):
        noise.GaussMarkov(1.0, 0.0, 0.1, 0, 0, 1)


def test_names_of_streams_are_stable():
    # a change here changes every recorded run
    assert noise.stream_id("gyro/white") == 4891116764381553566
    np.testing.assert_allclose(noise.normal(1, "gyro/white", 10, 1, 3)[0], [0.298974187316147, -2.0451269592373835, -1.1299877159119358])
    assert noise.GaussMarkov(1.0, 10.0, 0.01, 1, "gyro/markov", 1).block(1000, 1)[0, 0] == pytest.approx(-0.20803619, abs=1e-8)
