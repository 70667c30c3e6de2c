"""Whole units at fault: found among three, ambiguous among two, and never in place of a single sensor."""

from __future__ import annotations

import numpy as np
import pytest

from riins_core.imu_array import ImuArray
from riins_core.rotation import dcm_from_euler
from riins_fdi.groups import GroupTest

PFA = 1e-4
RNG = np.random.default_rng(7)


def triads(n: int) -> tuple[ImuArray, np.ndarray]:
    turns = [dcm_from_euler(*np.radians([10.0 * i, -7.0 * i, 40.0 * i])).T for i in range(n)]
    return ImuArray(np.vstack(turns)), np.repeat(np.arange(n), 3)


@pytest.mark.parametrize("n", [3, 4, 6])
def test_a_whole_unit_is_found_and_a_single_sensor_stays_single(n: int) -> None:
    array, group = triads(n)
    test, sigma = GroupTest(array, group, 0.1, PFA), 0.1
    whole, single = [], []
    for k in range(300):
        reading = array.H @ RNG.standard_normal(3) + sigma * RNG.standard_normal(3 * n)
        bad = reading.copy()
        bad[group == k % n] += 3.0 * np.array([1.0, -0.7, 0.8])
        whole.append(test.judge(bad).group == k % n)
        one = reading.copy()
        one[k % (3 * n)] += 3.0
        single.append(test.judge(one).sensor == k % (3 * n))
    assert np.mean(whole) >= 0.99 and np.mean(single) >= 0.99


def test_a_turned_unit_is_found_though_its_error_has_two_dimensions() -> None:
    array, group = triads(3)
    test = GroupTest(array, group, 0.05, PFA)
    found = []
    for _ in range(200):
        x = 9.8 * np.array([0.1, 0.2, 1.0]) + RNG.standard_normal(3)
        reading = array.H @ x + 0.05 * RNG.standard_normal(9)
        turned = dcm_from_euler(0.1, 0.15, 0.0)
        reading[3:6] = array.H[3:6] @ turned @ x + 0.05 * RNG.standard_normal(3)
        found.append(test.judge(reading).group)
    assert np.mean(np.array(found) == 1) >= 0.98


def test_two_units_only_detect() -> None:
    array, group = triads(2)
    finding = GroupTest(array, group, 0.1, PFA).judge(array.H @ [1.0, 2.0, 3.0] + np.array([2.0, -1.0, 1.5, 0, 0, 0]))
    assert finding.detected and finding.group == finding.sensor == -1


def test_false_alarms_and_false_groups_are_as_rare_as_said() -> None:
    array, group = triads(4)
    test = GroupTest(array, group, 0.2, 1e-2)
    findings = [test.judge(array.H @ [1.0, 2.0, 3.0] + 0.2 * RNG.standard_normal(12)) for _ in range(5000)]
    assert np.mean([f.detected for f in findings]) == pytest.approx(1e-2, abs=4e-3)


def test_two_units_at_fault_blame_nobody() -> None:
    array, group = triads(4)
    test, blamed = GroupTest(array, group, 0.1, PFA), 0
    for _ in range(100):
        reading = array.H @ [1.0, 2.0, 3.0] + 0.1 * RNG.standard_normal(12)
        reading[:6] += RNG.choice([-3.0, 3.0], 6)
        blamed += test.judge(reading).group >= 0
    assert blamed <= 2
