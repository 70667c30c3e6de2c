"""CUSUM and windowed GLR: thresholds against exact values and simulation, delays, the right sensor, onset; targets 5 and 6."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from riins_core.imu_array import CONFIGURATIONS, ImuArray
from riins_core.sensor_errors import normal
from riins_fdi.parity import family_threshold, optimal_parity_vectors, parity_test
from riins_fdi.run_length import cusum_run_length, cusum_threshold, epochs_between_alarms, glr_alarm_rate, window_lengths
from riins_fdi.sequential import SEQUENTIAL, Cusum, WindowedGlr

ARRAY = ImuArray(CONFIGURATIONS["dodecahedron"])
TEST = parity_test(ARRAY, 0b111111, 1.0, 1e-4)
U = optimal_parity_vectors(ARRAY.parity())
EPOCHS = 1e4
ONSET = 150


def first_alarms(test: WindowedGlr | Cusum, slope: float, step: float, runs: int, length: int) -> tuple[np.ndarray, ...]:
    """Delay (1: at the first faulty epoch), whether the sensor is right, onset error and size error, of runs without an alarm before the onset."""
    rows = []
    for run in range(runs):
        z = normal(50, run, 0, ONSET + length, 6)
        sensor = run % 6
        z[ONSET:, sensor] += step + slope * np.arange(1, length + 1)
        fresh = test.clone()
        block = fresh.process(z)
        alarms = np.flatnonzero(block.alarm)
        assert alarms.size, "a fault nobody sees"
        if alarms[0] >= ONSET:
            k = alarms[0]
            rows.append((k - ONSET + 1, block.sensor[k] == sensor, block.onset[k] - ONSET, block.size[k] - step))
    assert len(rows) > 0.9 * runs
    return tuple(np.array(rows, dtype=float).T)


def test_cusum_run_length_of_the_literature() -> None:
    """Siegmund 1985, Montgomery: one-sided, k = 0.5: h = 4: 335.4, h = 5: 930.9 (two-sided 167.7 and 465.4)."""
    assert cusum_run_length(4.0, 0.5) == pytest.approx(335.4, abs=0.1)
    assert cusum_run_length(5.0, 0.5) == pytest.approx(930.9, abs=0.1)
    h = cusum_threshold(3.6e6, 0.25, 12)
    assert cusum_run_length(h, 0.25) == pytest.approx(12 * 3.6e6, rel=1e-4)


def test_glr_alarm_rate_at_any_rarity() -> None:
    """With windows of one epoch the rate is that of the family of single tests, which is known without sampling alarms."""
    for pfa in (1e-2, 2.8e-7, 1e-14):
        threshold = family_threshold(U, pfa) ** 2
        # neighbouring epochs of a cluster are other alarms here: at 1e-2 two of 100 lie beside one
        assert glr_alarm_rate(threshold, U, np.array([1])) == pytest.approx(pfa, rel=0.03)


@pytest.mark.parametrize("name", SEQUENTIAL)
def test_mean_time_between_false_alarms(name: str) -> None:
    test, epochs, alarms = SEQUENTIAL[name](TEST, EPOCHS), 800_000, 0
    for k0 in range(0, epochs, 200_000):
        alarms += int(np.count_nonzero(test.process(normal(51, 0, k0, 200_000, 6)).alarm))
    assert epochs / alarms == pytest.approx(EPOCHS, rel=0.3)  # 80 expected, 2.7 sigma


def test_ten_hours() -> None:
    assert epochs_between_alarms(10.0, 100.0) == 3.6e6
    lengths = window_lengths(100)
    assert lengths[0] == 1 and lengths[-1] == 100 and np.all(np.diff(lengths) > 0) and lengths.size < 32
    test = WindowedGlr(TEST, epochs_between_alarms(10.0, 100.0))
    assert glr_alarm_rate(test.threshold, U, test.lengths, 4000, seed=9) == pytest.approx(1.0 / 3.6e6, rel=0.1)
    with pytest.raises(ValueError, match="redundancy"):
        WindowedGlr(parity_test(ARRAY, 0b000111, 1.0, 1e-4))


@pytest.mark.parametrize("step, most", [(1.0, 50.0), (3.0, 8.0)])
def test_glr_delay_and_sensor(step: float, most: float) -> None:
    """Target 5: mean delay at 1e-4 alarms an epoch; one epoch alone would take 3043 and 65."""
    delay, right, onset, size = first_alarms(WindowedGlr(TEST, EPOCHS), 0.0, step, 200, 600)
    assert delay.mean() <= most and right.mean() >= 0.90
    assert abs(np.median(onset)) <= 2.0
    # an alarm comes early when noise helps: the size is overestimated, by less than the noise of its mean
    assert 0.0 <= size[right == 1.0].mean() <= 0.6 * step


def test_glr_on_a_ramp() -> None:
    """Target 6: 0.005 sigma an epoch is found in at most .45 of the time a single epoch takes at the same rate."""
    delay, _, _, _ = first_alarms(WindowedGlr(TEST, EPOCHS), 0.005, 0.0, 120, 2500)
    single = []
    for run in range(120):
        z = normal(50, run, 0, ONSET + 2500, 6)
        z[ONSET:, run % 6] += 0.005 * np.arange(1, 2501)
        single.append(np.flatnonzero(np.sum((z[ONSET:] @ TEST.whitened.T) ** 2, axis=1) > TEST.threshold)[0] + 1)
    assert delay.mean() <= 0.45 * np.mean(single)


def test_cusum_is_quickest_for_its_own_shift() -> None:
    slow, quick = Cusum(TEST, EPOCHS, shift=0.7), Cusum(TEST, EPOCHS, shift=2.1)
    small = [first_alarms(t, 0.0, 1.0, 150, 1500)[0].mean() for t in (slow, quick)]
    large = [first_alarms(t, 0.0, 3.0, 150, 300)[0].mean() for t in (slow, quick)]
    assert small[0] < small[1] and large[1] < large[0]
    _, right, onset, _ = first_alarms(slow, 0.0, 1.0, 150, 1500)
    assert right.mean() >= 0.90 and abs(np.median(onset)) <= 4.0


@pytest.mark.parametrize("name", SEQUENTIAL)
@pytest.mark.parametrize("restart", [True, False])
def test_blocks_do_not_matter(name: str, restart: bool) -> None:
    """Law 3: bit for bit, over a rebase of the running sums, alarms and restarts; a clone goes on alone."""
    z = normal(52, 0, 0, 9000, 6) + np.array([3.0, -2.0, 5.0]) @ ARRAY.H.T
    z[5000:5400, 2] += 4.0
    whole_test, parts_test = SEQUENTIAL[name](TEST, EPOCHS, restart=restart), SEQUENTIAL[name](TEST, EPOCHS, restart=restart)
    whole = whole_test.process(z)
    cuts = [0, 1, 2, 77, 4095, 4096, 5001, 5003, 8000, 9000]
    parts = [parts_test.process(z[a:b]) for a, b in itertools.pairwise(cuts)]
    for column, expected in enumerate(whole):
        np.testing.assert_array_equal(np.concatenate([p[column] for p in parts]), expected)
    assert whole.alarm[5000:5400].any()
    copy = whole_test.clone()
    first, _ = copy.process(z[:50]), copy.process(z[50:100])
    again = whole_test.process(z[:50])
    np.testing.assert_array_equal(first.statistic, again.statistic)


def test_running_sums_keep_their_digits() -> None:
    """A constant fault for 200 000 epochs: the statistic at the end is that of a test begun just before."""
    z = normal(53, 0, 0, 200_000, 6)
    z[:, 1] += 1e6
    long, short = WindowedGlr(TEST, threshold=np.inf), WindowedGlr(TEST, threshold=np.inf)
    end = long.process(z).statistic[-1]
    assert short.process(z[-100:]).statistic[-1] == pytest.approx(end, rel=1e-9)


def test_size_in_units_of_the_measurements_and_unused_sensors() -> None:
    sigma = np.array([1.0, 2.0, 0.5, 1.5, 1.0, 3.0])
    test = WindowedGlr(parity_test(ARRAY, 0b101111, sigma, 1e-4), EPOCHS)
    z = np.zeros((60, 6))
    z[20:, 1] = -40.0
    z[:, 4] = np.nan
    block = test.process(z)
    k = int(np.flatnonzero(block.alarm)[0])
    assert (block.sensor[k], block.onset[k]) == (1, 20) and block.size[k] == pytest.approx(-40.0)
    test.reset()
    assert test.process(z[:1]).onset[0] == 60
