"""Metrics: identities and closed forms on made-up tracks."""

from __future__ import annotations

import numpy as np
import pytest

from riins_core.rotation import dcm_from_euler, euler_from_dcm, exp_so3
from riins_eval import metrics
from riins_eval.run_record import FaultInterval, HealthChange, Judged, SensorUse, Track

S = 1_000_000_000


def make_track(m: int, seed: int = 1) -> Track:
    """A plausible track of m epochs."""
    rng = np.random.default_rng(seed)
    rph = np.column_stack([rng.normal(0, 0.05, m), rng.normal(0, 0.03, m), rng.uniform(0, 2 * np.pi, m)])
    return Track(np.arange(1, m + 1) * S, 0.6 + rng.normal(0, 1e-4, m), 2.1 + rng.normal(0, 1e-4, m), np.zeros(m), rng.normal(0, 5, (m, 3)), rph)


def make_judged(stamps: list[int], accepted: list[bool]) -> Judged:
    """Three-component innovations of NIS 3."""
    k = len(stamps)
    ones = np.ones((k, 3))
    return Judged(np.array(stamps) * S, ones, ones, ones, np.full(k, 3.0), np.full(k, 25.0), np.array(accepted), np.where(accepted, 0, 1))


def test_rms_of_vectors_is_of_their_length_and_skips_unknown():
    error = np.array([[3.0, 4.0], [np.nan, 1.0], [0.0, 5.0]])
    assert metrics.rms(error) == pytest.approx(5.0)
    assert np.isnan(metrics.rms(np.array([np.nan])))


def test_position_error_is_computed_minus_true_in_metres():
    truth = make_track(5)
    moved = truth.take(np.arange(5))
    moved.lat = truth.lat + 10.0 / 6_360_000.0
    moved.h = truth.h + 2.0
    error = metrics.position_error(moved, truth)
    assert error[:, 0] == pytest.approx(10.0, rel=0.01)
    assert error[:, 1] == pytest.approx(0.0, abs=1e-9)
    assert error[:, 2] == pytest.approx(-2.0)


def test_attitude_error_has_the_sign_of_the_conventions():
    truth = make_track(40)
    phi = np.random.default_rng(2).normal(0, 1e-3, (40, 3))
    computed = exp_so3(-phi) @ dcm_from_euler(*truth.rph.T)
    track = truth.take(np.arange(40))
    track.rph = np.column_stack(euler_from_dcm(computed))
    assert metrics.attitude_error(track, truth) == pytest.approx(phi, abs=1e-12)
    level = truth.take(np.arange(40))
    level.rph = truth.rph * [0, 0, 1]
    turned = level.take(np.arange(40))
    turned.rph = level.rph + np.array([0, 0, 2e-3])
    assert metrics.heading_error(turned, level) == pytest.approx(2e-3)
    assert -metrics.attitude_error(turned, level)[:, 2] == pytest.approx(2e-3)


def test_nees_of_drawn_errors_is_chi_square():
    rng = np.random.default_rng(3)
    root = rng.normal(size=(7, 7)) * [1e2, 1e2, 1.0, 1.0, 1e-4, 1e-4, 1e-3]
    covariance = root.T @ root
    error = rng.multivariate_normal(np.zeros(7), covariance, 4000, method="cholesky")
    value = metrics.nees(error, np.broadcast_to(covariance, (4000, 7, 7)))
    assert value == pytest.approx(np.einsum("ki,ij,kj->k", error, np.linalg.inv(covariance), error), rel=1e-3)
    assert np.mean(value) / 7 == pytest.approx(1.0, abs=4 * np.sqrt(2 / 7 / 4000))


def test_nees_is_unknown_where_the_covariance_is_no_covariance():
    covariance = np.stack([np.eye(2), -np.eye(2), np.array([[1.0, 2.0], [2.0, 1.0]]), np.eye(2)])
    value = metrics.nees(np.array([[3.0, 4.0], [1, 1], [1, 1], [np.nan, 1]]), covariance)
    assert value[0] == pytest.approx(25.0)
    assert np.isnan(value[1:]).all()


def test_nees7_takes_its_block_of_the_full_covariance():
    truth = make_track(6)
    track = truth.take(np.arange(6))
    track.v_n = truth.v_n + np.array([0.2, 0.0, 9.9])
    full = np.broadcast_to(np.diag(np.r_[np.full(3, 4.0), np.full(3, 0.01), np.full(9, 1e-8)]), (6, 15, 15))
    assert metrics.nees7(track, truth, full) == pytest.approx(4.0)
    assert metrics.nees7(track, truth, metrics.reduce_covariance(full)) == pytest.approx(4.0)


def test_outcome_of_an_aid_fault():
    fault = FaultInterval("gps", "step", 25 * S, 65 * S)
    judged = make_judged([10, 20, 30, 40, 50, 60, 70], [True, True, True, False, False, False, True])
    health = [HealthChange(50 * S, "gps", 2, 1), HealthChange(70 * S, "gps", 0, 0)]
    outcome = metrics.fault_outcome(fault, [fault], health, judged)
    assert outcome.detected and outcome.isolated_right
    assert outcome.delay_s == pytest.approx(10.0)  # first faulty measurement at 30 s, first refused at 40 s
    assert metrics.epochs_accepted(judged, fault) == 1
    assert metrics.good_rejected(judged, [fault]) == 0
    assert metrics.good_rejected(judged, []) == 3
    assert metrics.false_isolations(health, [fault]) == []
    assert len(metrics.false_isolations(health, [])) == 1


def test_a_wrongly_isolated_neighbour_spoils_the_isolation():
    fault = FaultInterval("gyro_1", "ramp", 10 * S, 50 * S)
    right, wrong = HealthChange(20 * S, "gyro_1", 2, 1), HealthChange(30 * S, "gyro_4", 2, 1)
    other_kind, operator = HealthChange(30 * S, "accel_4", 2, 1), HealthChange(30 * S, "gyro_5", 2, 6)
    outcome = metrics.fault_outcome(fault, [fault], [right, wrong, other_kind, operator], None)
    assert outcome.isolated and not outcome.isolated_right and outcome.wrong == ("gyro_4",)
    assert metrics.fault_outcome(fault, [fault], [right, other_kind, operator], None).isolated_right
    assert [c.target for c in metrics.false_isolations([right, wrong, operator], [fault])] == ["gyro_4"]
    missed = metrics.fault_outcome(fault, [fault], [wrong], None)
    assert not missed.detected and missed.delay_s is None


def test_a_compensated_sensor_is_declared_and_a_healthy_one_compensated_is_a_false_alarm():
    fault = FaultInterval("gyro_1", "ramp", 10 * S, 50 * S)
    kept, gone, wrong = HealthChange(12 * S, "gyro_1", 4, 1), HealthChange(30 * S, "gyro_1", 2, 1), HealthChange(20 * S, "gyro_3", 4, 1)
    outcome = metrics.fault_outcome(fault, [fault], [kept, gone], None)
    assert outcome.isolated_right and outcome.compensated and outcome.delay_s == pytest.approx(2.0)
    assert metrics.declared_at(fault, [kept, gone]) == 12 * S and metrics.false_isolations([kept, gone], [fault]) == []
    outcome = metrics.fault_outcome(fault, [fault], [kept, wrong], None)
    assert not outcome.isolated_right and outcome.wrong == ("gyro_3",)
    assert [c.target for c in metrics.false_isolations([kept, wrong], [fault])] == ["gyro_3"]
    absent = HealthChange(20 * S, "gps", 4, 5)  # of an aid the same number says that it is silent
    assert metrics.false_isolations([absent], []) == [] and metrics.fault_outcome(fault, [fault], [kept, absent], None).isolated_right


def test_a_sensor_that_is_out_already_is_detected_at_once():
    fault = FaultInterval("accel_0", "step", 30 * S, 40 * S)
    outcome = metrics.fault_outcome(fault, [fault], [HealthChange(10 * S, "accel_0", 2, 1)], None)
    assert outcome.detected and outcome.isolated_right and outcome.delay_s == 0.0


def test_sensor_use_counts_samples_of_runs():
    stamps = np.arange(1, 1001) * 10_000_000
    gyro = np.full(1000, 0x3F, np.uint64)
    gyro[400:700] = 0x3D  # gyro 1 out for 300 samples
    use = SensorUse.from_samples(stamps, gyro, np.full(1000, 0x3F, np.uint64))
    assert use.count.tolist() == [400, 300, 300]
    assert use.samples_with("gyro_1", 0, stamps[-1] + 1) == 700
    assert use.samples_with("gyro_0", 0, stamps[-1] + 1) == 1000
    assert use.samples_with("accel_1", int(stamps[10]), int(stamps[20])) == 10
    assert use.samples_with("gyro_1", int(stamps[395]), int(stamps[705])) == 10
    halves = SensorUse.concatenate(
        [SensorUse.from_samples(stamps[:500], gyro[:500], gyro[:500]), SensorUse.from_samples(stamps[500:], gyro[500:], gyro[500:])]
    )
    assert halves.samples_with("gyro_1", int(stamps[395]), int(stamps[705])) == 10


def test_horizontal_distance_is_at_common_stamps():
    track = make_track(10)
    other = track.take(np.arange(3, 10))
    other.lon = other.lon + 1e-6
    assert metrics.horizontal_distance(track, other) == pytest.approx(6.38e6 * np.cos(0.6) * 1e-6, rel=0.01)
    assert len(metrics.horizontal_distance(track, other)) == 7
