"""A reference at 1 Hz brought to every IMU sample: against the trajectory of the simulation it was thinned from."""

from __future__ import annotations

import numpy as np
import pytest

from riins_core.rotation import euler_from_dcm
from riins_eval import metrics
from riins_eval.reference import RecordedMotion
from riins_eval.run_record import Track
from riins_sim.scenario import from_yaml
from riins_sim.trajectory import Trajectory

VOYAGE = """
name: waves
duration_s: 40
start: {latitude_deg: 33, longitude_deg: 35, speed_kn: 5, heading_deg: 80}
legs: [{straight_s: 5}, {turn_deg: 60, rate_deg_s: 3}]
sea: {significant_wave_height_m: 1.5, peak_period_s: 6}
"""


def sample_reference(trajectory: Trajectory, t: np.ndarray) -> np.ndarray:
    """Rows of the common layout."""
    truth = trajectory.truth(t)
    return np.column_stack([t, truth.lat, truth.lon, truth.h, truth.v_n, *euler_from_dcm(truth.C_nb)])


def as_track(truth) -> Track:
    return Track((truth.t * 1e9).astype(np.int64), truth.lat, truth.lon, truth.h, truth.v_n, np.column_stack(euler_from_dcm(truth.C_nb)))


@pytest.fixture(scope="module")
def trajectory() -> Trajectory:
    return Trajectory(from_yaml(VOYAGE))


@pytest.fixture(scope="module")
def motion(trajectory) -> RecordedMotion:
    rate, force = trajectory.increments(1, trajectory.samples)
    t = np.arange(1, trajectory.samples + 1) * 0.01
    keep = np.ones(len(t), dtype=bool)
    keep[1500:1503] = False  # a loss of three samples
    reference = sample_reference(trajectory, np.arange(0.37, 40.0, 1.0))
    return RecordedMotion(t[keep] + 100.0, rate[keep], force[keep], reference + np.r_[100.0, np.zeros(9)], 0.01)


def test_it_follows_the_motion_between_the_epochs(trajectory, motion):
    t = np.arange(0.5, 39.0, 0.01)
    t = t[(t < 14.3) | (t > 16.4)]  # the lost samples are interpolated, there it is a little worse
    made, true = as_track(motion.truth(t - 0.01)), as_track(trajectory.truth(t))
    assert np.abs(metrics.position_error(made, true)).max() < 2e-4
    assert np.abs(made.v_n - true.v_n).max() < 2e-4
    assert np.abs(metrics.attitude_error(made, true)).max() < 2e-6
    assert motion.truth(t - 0.01).rate_nb_b == pytest.approx(trajectory.truth(t).rate_nb_b, abs=5e-3)  # a mean over 10 ms against a value


def test_lost_samples_keep_their_numbers_and_cost_little(trajectory, motion):
    assert motion.samples == 3999 and len(motion.number) == 3997
    assert motion.number[1500] == 1503
    t = np.arange(14.0, 17.0, 0.01)
    made, true = as_track(motion.truth(t - 0.01)), as_track(trajectory.truth(t))
    assert np.abs(metrics.position_error(made, true)).max() < 5e-3


def test_beyond_the_reference_nothing_is_made_up(motion):
    assert motion.origin == pytest.approx(100.01)
    assert motion.known == (pytest.approx(0.36), pytest.approx(39.36))
    truth = motion.truth(np.array([0.0, 0.1, 5.0, 39.9, 45.0]))
    assert np.isfinite(truth.lat).tolist() == [False, False, True, False, False]
    assert np.isnan(truth.C_nb[0]).all() and np.isnan(truth.v_n[4]).all()


def test_rows_that_are_not_known_are_bridged_and_long_gaps_are_not(trajectory):
    rate, force = trajectory.increments(1, trajectory.samples)
    t = np.arange(1, trajectory.samples + 1) * 0.01
    reference = sample_reference(trajectory, np.array([0.0, 1.0, 2.0, 3.0, 38.0, 39.0]))
    reference[1, 9] = np.nan
    motion = RecordedMotion(t, rate, force, reference, 0.01)
    made = motion.truth(np.array([0.99, 1.49, 20.0, 38.5]))
    assert np.isfinite(made.lat).tolist() == [True, True, False, True]
    assert np.abs(metrics.position_error(as_track(made).take([0, 1, 3]), as_track(trajectory.truth(made.t[[0, 1, 3]] + 0.01)))).max() < 1e-3
