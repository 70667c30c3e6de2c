"""Sensors: statistics of their errors, random access, fault-free twin, geometry."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from riins_core.earth import radii
from riins_core.rotation import rotate
from riins_core.sensor_errors import DEG_PER_H, DEG_PER_SQRT_H, KNOT, MICRO_G
from riins_sim.faults import Fault, FaultSchedule, FaultType
from riins_sim.sensors import DopplerSim, PositionSim, RedundantImuSim
from riins_sim.trajectory import Trajectory

S = 1_000_000_000


def _metres(block, truth):
    """Error of a position block against the truth of the antenna, (m, 3), north, east, down."""
    r_m, r_n = radii(truth.lat)
    return np.stack([(block.lat - truth.lat) * r_m, (block.lon - truth.lon) * r_n * np.cos(truth.lat), truth.h - block.h], -1)


def test_a_perfect_imu_reads_the_projection(voyage):
    imu = RedundantImuSim(voyage(imu={"gyro": {}, "accel": {}}))
    block = imu.block(500, 50)
    rate, force = imu.trajectory.increments(500, 50)
    assert block.gyro == pytest.approx(rate @ imu.array.H.T, abs=1e-15)
    assert block.accel == pytest.approx(force @ imu.array.H.T, abs=1e-14)
    assert block.gyro @ imu.array.least_squares().T == pytest.approx(rate, abs=1e-15)
    assert np.all(block.gyro_valid == 63) and block.gyro_valid.dtype == np.uint64
    assert np.array_equal(block.k, np.arange(500, 550)) and block.stamp_ns[0] == 5 * S


def test_noise_of_the_imu_is_the_data_sheets(voyage):
    imu = RedundantImuSim(voyage())
    rate, force = imu.trajectory.increments(1, 40000)
    block = imu.block(1, 40000)
    gyro, accel = block.gyro - rate @ imu.array.H.T, block.accel - force @ imu.array.H.T
    tolerance = 5.0 / np.sqrt(2 * 40000)  # 5 sigma of a standard deviation
    assert np.diff(gyro, axis=0).std(axis=0) / np.sqrt(2) == pytest.approx(np.full(6, 0.003 * DEG_PER_SQRT_H / 0.1), rel=tolerance * 1.3)
    assert np.diff(accel, axis=0).std(axis=0) / np.sqrt(2) == pytest.approx(np.full(6, 20.0 * MICRO_G / 0.1), rel=tolerance * 1.3)
    # Allan deviation of averages over 1 s: white noise still rules, ARW / sqrt(1 s)
    means = accel.reshape(400, 100, 6).mean(axis=1)
    allan = np.sqrt(0.5 * np.mean(np.diff(means, axis=0) ** 2))
    assert allan == pytest.approx(20.0 * MICRO_G, rel=0.1)
    correlation = np.corrcoef(np.hstack([np.diff(gyro, axis=0), np.diff(accel, axis=0)]).T)
    assert np.max(np.abs(correlation - np.eye(12))) < 5.0 * 1.25 / np.sqrt(40000)


def test_drift_of_the_imu_is_a_constant_and_a_markov_process(voyage):
    """Over many seeds: the variance of the drift, and its correlation after one correlation time."""
    start, later, accel = [], [], []
    trajectory = Trajectory(voyage(duration_s=120.0))
    for seed in range(60):
        imu = RedundantImuSim(voyage(duration_s=120.0).with_seed(seed), trajectory)
        start.append(imu.true_bias(0)[0] - imu.gyro_errors.constant)
        later.append(imu.true_bias(10000)[0] - imu.gyro_errors.constant)
        accel.append(imu.true_bias(5)[1])
        assert np.array_equal(imu.true_bias(77)[1], imu.accel_errors.constant)  # the accelerometers have no Markov part
    start, later = np.ravel(start) / (0.01 * DEG_PER_H), np.ravel(later) / (0.01 * DEG_PER_H)
    n = start.size  # 360
    assert np.mean(start**2) == pytest.approx(1.0, abs=4 * np.sqrt(2 / n))
    assert np.mean(later**2) == pytest.approx(1.0, abs=4 * np.sqrt(2 / n))
    assert np.mean(start * later) == pytest.approx(np.exp(-1.0), abs=4 / np.sqrt(n))  # 100 s at tau = 100 s
    assert np.ravel(accel).std() == pytest.approx(100.0 * MICRO_G, rel=4 / np.sqrt(2 * n))


def test_saturation(voyage):
    imu = RedundantImuSim(voyage(imu={"gyro_range_deg_s": 1.0, "accel_range_g": 1.5}))
    faults = FaultSchedule([Fault("gyro_3", FaultType.STEP, 1.0), Fault("accel_0", FaultType.STEP, -50.0)])
    block = imu.block(1, 10, faults)
    assert np.all(block.gyro[:, 3] == np.deg2rad(1.0)) and np.all(block.accel[:, 0] == -1.5 * 9.80665)


@given(st.integers(1, 3000), st.lists(st.integers(1, 40), min_size=1, max_size=6))
@settings(max_examples=25, deadline=None)
def test_imu_blocks_do_not_matter(shared_imu, k0, sizes):
    imu, faults = shared_imu
    whole = imu.block(k0, sum(sizes), faults)
    k = k0
    for size in sizes:
        part = imu.block(k, size, faults)
        rows = slice(k - k0, k - k0 + size)
        for name in ("k", "stamp_ns", "gyro", "accel", "gyro_valid", "accel_valid"):
            assert np.array_equal(getattr(part, name), getattr(whole, name)[rows]), name
        k += size


@given(st.integers(1, 350), st.lists(st.integers(1, 20), min_size=1, max_size=5), st.sampled_from(["gps", "doppler"]))
@settings(max_examples=25, deadline=None)
def test_aid_blocks_do_not_matter(shared_aids, k0, sizes, name):
    aid, faults = shared_aids[name]
    sizes = [min(s, (400 - k0) // len(sizes)) for s in sizes]
    whole = aid.block(k0, sum(sizes), faults)
    k = k0
    for size in sizes:
        part = aid.block(k, size, faults)
        rows = slice(k - k0, k - k0 + size)
        for field in ("k", "stamp_ns", "lat", "lon", "h", "v_n", "has_fix") if name == "gps" else ("k", "stamp_ns", "v_b", "valid"):
            assert np.array_equal(getattr(part, field), getattr(whole, field)[rows], equal_nan=field not in ("has_fix", "valid", "k")), field
        k += size


def test_fault_free_twin_is_equal_outside_faults(voyage):
    faults = [
        {"target": "gyro_2", "type": "ramp", "slope_deg_h_s": 2.0, "start_s": 3.0, "end_s": 6.0},
        {"target": "accel_1", "type": "stuck", "start_s": 4.0, "end_s": 5.0},
        {"target": "gps", "type": "step", "size_m": 60.0, "start_s": 4.0, "end_s": 8.0},
        {"target": "doppler", "type": "noise", "size_kn": 1.0, "start_s": 4.0, "end_s": 8.0},
    ]
    scenario = voyage(duration_s=12.0, faults=faults)
    schedule = scenario.fault_schedule()
    imu = RedundantImuSim(scenario)
    sick, twin = imu.block(1, 1200, schedule), imu.block(1, 1200)
    t = sick.stamp_ns * 1e-9
    touched = np.zeros((1200, 6), dtype=bool)
    touched[:, 2] = (t > 3.0) & (t < 6.0)  # the ramp is 0 at its start
    assert np.array_equal(sick.gyro != twin.gyro, touched)
    touched = np.zeros((1200, 6), dtype=bool)
    touched[:, 1] = (t >= 4.0) & (t < 5.0)
    assert np.array_equal(sick.accel != twin.accel, touched)
    assert np.all(sick.accel[touched] == twin.accel[398, 1])  # sample 399, t = 3.99 s
    gps = PositionSim(scenario, "gps", imu.trajectory)
    sick, twin = gps.block(1, 12, schedule), gps.block(1, 12)
    inside = (sick.stamp_ns >= 4 * S) & (sick.stamp_ns < 8 * S)
    assert np.array_equal(sick.lat != twin.lat, inside)
    shift = _metres(sick, gps.trajectory.truth(sick.stamp_ns * 1e-9)) - _metres(twin, gps.trajectory.truth(sick.stamp_ns * 1e-9))
    assert shift[inside, :2] == pytest.approx(60.0, abs=1e-3) and np.all(shift[:, 2] == 0.0)
    log = DopplerSim(scenario, imu.trajectory)
    sick, twin = log.block(1, 12, schedule), log.block(1, 12)
    assert np.array_equal((sick.v_b != twin.v_b).any(axis=1), inside)


def test_gps_errors_and_lever_arm(voyage):
    scenario = voyage(duration_s=20000.0, imu_rate_hz=10, gps={"velocity_sigma_mps": 0.01})
    gps = PositionSim(scenario, "gps")
    block = gps.block(1, gps.samples)
    truth = gps.trajectory.truth(block.stamp_ns * 1e-9)
    lever = rotate(truth.C_nb, np.array([-8.0, 2.0, -12.0]))
    error = _metres(block, truth) - lever
    n = gps.samples
    assert n == 20000
    white = np.diff(error, axis=0).std(axis=0) / np.sqrt(2)
    slow = np.sqrt(1.0 - np.exp(-1.0 / 30.0))  # what the Markov part of sigma 1 m adds to a difference over 1 s
    assert white == pytest.approx(np.sqrt(np.array([2.0, 3.0, 4.0]) ** 2 + np.array([slow, slow, 0.0]) ** 2), rel=6 / np.sqrt(2 * n))
    assert error.std(axis=0) == pytest.approx(np.sqrt(np.diag(block.covariance)), rel=0.05)
    assert np.diag(block.covariance) == pytest.approx([5.0, 10.0, 16.0])
    assert error.mean(axis=0) == pytest.approx(0.0, abs=5 * np.sqrt(60.0 / 20000) + 0.1)
    velocity = np.diff(lever, axis=0)[:, :2]  # the antenna moves with the roll, as its velocity must say
    mean = 0.5 * (block.v_n[1:] + block.v_n[:-1] - truth.v_n[1:] - truth.v_n[:-1])[:, :2]
    assert np.corrcoef(velocity.ravel(), mean.ravel())[0, 1] > 0.9


def test_outage_is_no_fix_in_the_twin_too(voyage):
    scenario = voyage(duration_s=30.0, outages=[{"target": "gps", "start_s": 5.0, "end_s": 9.0}, {"target": "doppler", "start_s": 2.0, "end_s": 4.0}])
    gps, log = PositionSim(scenario, "gps"), DopplerSim(scenario)
    block = gps.block(1, 30)
    assert np.array_equal(np.flatnonzero(~block.has_fix) + 1, [5, 6, 7, 8])
    assert np.all(np.isnan(block.lat[~block.has_fix])) and np.all(np.isfinite(block.lat[block.has_fix]))
    assert np.array_equal(np.flatnonzero(~log.block(1, 30).valid) + 1, [2, 3])
    dropped = gps.block(1, 30, FaultSchedule([Fault("gps", FaultType.DROPOUT, start_ns=20 * S)]))
    assert np.array_equal(np.flatnonzero(~dropped.has_fix) + 1, [5, 6, 7, 8, *range(20, 31)])


def test_doppler_measures_at_its_place_along_its_own_axes(voyage):
    scenario = voyage(duration_s=20000.0, imu_rate_hz=10, legs=[], doppler={"sigma_kn": [0.1, 0.2, 0.3], "period_s": 2.0})
    log = DopplerSim(scenario)
    block = log.block(1, log.samples)
    truth = log.trajectory.truth(block.stamp_ns * 1e-9)
    v_b = rotate(np.swapaxes(truth.C_nb, -1, -2), truth.v_n) + np.cross(truth.rate_nb_b, [15.0, 0.0, 3.0])
    a, s = log.true_misalignment, log.true_scale
    assert a != 0.0 and s != 0.0
    # a log turned to starboard sees a ship that goes straight ahead slip to port
    expected = (1 + s) * np.stack([v_b[:, 0] * np.cos(a) + v_b[:, 1] * np.sin(a), v_b[:, 1] * np.cos(a) - v_b[:, 0] * np.sin(a), v_b[:, 2]], -1)
    noise = block.v_b - expected
    n = log.samples
    assert noise.std(axis=0) / KNOT == pytest.approx([0.1, 0.2, 0.3], rel=5 / np.sqrt(2 * n))
    assert noise.mean(axis=0) / KNOT == pytest.approx(0.0, abs=5 * 0.3 / np.sqrt(n))
    assert np.sqrt(np.diag(block.covariance)) / KNOT == pytest.approx([0.1, 0.2, 0.3])


def test_doppler_draws_its_constants_by_seed(voyage):
    trajectory = Trajectory(voyage(duration_s=5.0))
    drawn = [DopplerSim(voyage(duration_s=5.0).with_seed(seed), trajectory) for seed in range(300)]
    angles = np.rad2deg([d.true_misalignment for d in drawn])
    assert np.std(angles) == pytest.approx(0.5, rel=4 / np.sqrt(600))
    assert np.std([d.true_scale for d in drawn]) == pytest.approx(1e-3, rel=4 / np.sqrt(600))


def test_stamps_of_an_odd_rate(voyage):
    imu = RedundantImuSim(voyage(imu_rate_hz=300, duration_s=10.0))
    stamps = imu.stamp_ns(np.arange(0, 3001))
    assert stamps[3000] == 10 * S and stamps[1] == 3_333_333 and stamps[2] == 6_666_667
    # a stuck fault finds the sample before its onset, also where stamps are rounded
    faults = FaultSchedule([Fault("gyro_0", FaultType.STUCK, start_ns=int(stamps[700]))])
    clean = imu.block(690, 20)
    stuck = imu.block(690, 20, faults)
    assert np.all(stuck.gyro[10:, 0] == clean.gyro[9, 0]) and np.array_equal(stuck.gyro[:10], clean.gyro[:10])


def test_outside_the_voyage(voyage):
    scenario = voyage(duration_s=10.0)
    gps = PositionSim(scenario, "gps")
    assert gps.samples == 10
    for k0, m in ((0, 1), (10, 2)):
        with pytest.raises(ValueError, match="outside the voyage"):
            gps.block(k0, m)
    assert gps.block(1, 0).lat.shape == (0,)
    assert RedundantImuSim(scenario).block(1, 0).gyro.shape == (0, 6)
