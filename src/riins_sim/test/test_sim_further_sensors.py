"""Odometer, altimeter, star sensor: statistics of their errors, random access, faults, outages; what climbs."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sim_voyage import close

from riins_core.rotation import dcm_from_euler, log_so3, rotate
from riins_core.sensor_errors import ARCSEC
from riins_core.settings import SettingError, build
from riins_node import fields
from riins_sim.faults import Fault, FaultSchedule, FaultSettings, FaultType
from riins_sim.further_sensors import AltimeterSim, OdometerSim, StarTrackerSim
from riins_sim.scenario import ScenarioError
from riins_sim.trajectory import Trajectory

S = 1_000_000_000
SECTIONS = {
    "odometer": {"enabled": True, "period_s": 0.5, "sigma_mps": 0.05, "scale_ppm": 5000.0, "lever_arm_m": [0.0, 0.8, 0.3]},
    "altimeter": {"enabled": True, "sigma_m": 0.5, "bias_m": 4.0, "markov_sigma_m": 2.0, "markov_time_s": 50.0, "lever_arm_m": [1.0, 2.0, -3.0]},
    "star_tracker": {"enabled": True, "sigma_arcsec": [5.0, 7.0, 15.0], "misalignment_arcsec": 40.0, "max_rate_deg_s": 20.0},
}
KINDS = {"odometer": OdometerSim, "altimeter": AltimeterSim, "star_tracker": StarTrackerSim}
CLIMBS = {
    "car": (30.0, [{"climb_m": 25.0, "climb_deg": 4.0}, {"turn_deg": 60.0, "rate_deg_s": 5.0, "blend_s": 3.0}, {"climb_m": -40.0, "climb_deg": 6.0}]),
    "car backwards": (-20.0, [{"climb_m": 10.0, "climb_deg": 4.0}]),
    "aircraft": (200.0, [{"climb_m": 500.0, "climb_deg": 8.0}, {"turn_deg": -90.0, "rate_deg_s": 1.5}, {"climb_m": -400.0, "climb_deg": 5.0}]),
}


def _reading(block):
    """Values of a block, (m, n)."""
    for name in ("v_b", "rph", "h"):
        if hasattr(block, name):
            return np.reshape(getattr(block, name), (len(block.k), -1))
    raise AssertionError


def _climbing(voyage, name, **changes):
    speed, legs = CLIMBS[name]
    start = {"latitude_deg": 34.0, "longitude_deg": 108.0, "height_m": 1000.0, "speed_kn": speed, "heading_deg": 30.0}
    still = {"sea": {"significant_wave_height_m": 0.0}, "vessel": {"heel_rad_per_g": -1.0}}
    return voyage(duration_s=240.0, start=start, legs=[{"straight_s": 20.0}, *legs], **still, **changes)


@pytest.mark.parametrize("name", CLIMBS)
def test_increments_of_a_climb_close(voyage, name):
    distance, heading = close(Trajectory(_climbing(voyage, name)), 240.0)
    assert distance < 1e-3 and heading < 1e-3


@pytest.mark.parametrize("name", CLIMBS)
def test_a_climb_ends_at_its_height_and_the_nose_is_along_the_path(voyage, name):
    speed, legs = CLIMBS[name]
    trajectory = Trajectory(_climbing(voyage, name))
    truth = trajectory.truth(np.arange(0.05, 240.0, 0.1))
    assert truth.h[-1] == pytest.approx(1000.0 + sum(leg.get("climb_m", 0.0) for leg in legs), abs=1e-9)
    along = rotate(np.swapaxes(truth.C_nb, -1, -2), truth.v_n)
    assert along[:, 0] == pytest.approx(speed * 1852.0 / 3600.0, rel=1e-6)
    assert along[:, 1:] == pytest.approx(0.0, abs=1e-4)
    steepest = np.rad2deg(np.abs(np.arcsin(truth.C_nb[:, 2, 0])).max())
    assert steepest == pytest.approx(max(leg.get("climb_deg", 0.0) for leg in legs), rel=1e-6)
    h = 2e-3
    before, after = trajectory.truth(truth.t - h), trajectory.truth(truth.t + h)
    assert (after.h - before.h) / (2 * h) == pytest.approx(-truth.v_n[:, 2], abs=1e-5)
    assert log_so3(np.swapaxes(before.C_nb, -1, -2) @ after.C_nb) / (2 * h) == pytest.approx(truth.rate_nb_b, abs=3e-6)


def test_what_stands_still_does_not_climb(voyage):
    with pytest.raises(ScenarioError, match="nothing climbs that stands still"):
        voyage(legs=[{"speed_kn": 0.0, "acceleration_mps2": 0.1}, {"climb_m": 3.0, "climb_deg": 2.0}])
    with pytest.raises(ScenarioError, match="climb_m needs climb_deg"):
        voyage(legs=[{"climb_m": 3.0}])


def test_odometer_reads_the_speed_ahead_and_nothing_else(voyage):
    scenario = voyage(duration_s=8000.0, imu_rate_hz=10, **SECTIONS)
    odometer = OdometerSim(scenario)
    block = odometer.block(1, odometer.samples)
    truth = odometer.trajectory.truth(block.stamp_ns * 1e-9)
    ahead = rotate(np.swapaxes(truth.C_nb, -1, -2), truth.v_n)[:, 0] + np.cross(truth.rate_nb_b, [0.0, 0.8, 0.3])[:, 0]
    noise = block.v_b[:, 0] - (1.0 + odometer.true_scale) * ahead
    n = odometer.samples
    assert n == 16000 and abs(odometer.true_scale) > 1e-4
    assert noise.std() == pytest.approx(0.05, rel=5 / np.sqrt(2 * n)) and noise.mean() == pytest.approx(0.0, abs=5 * 0.05 / np.sqrt(n))
    assert np.all(block.v_b[:, 1:] == 0.0) and block.valid.all()
    assert np.sqrt(np.diag(block.covariance)) == pytest.approx([0.05, 0.1, 0.1])


def test_altimeter_errors(voyage):
    scenario = voyage(duration_s=20000.0, imu_rate_hz=10, **SECTIONS)
    altimeter = AltimeterSim(scenario)
    block = altimeter.block(1, altimeter.samples)
    truth = altimeter.trajectory.truth(block.stamp_ns * 1e-9)
    error = block.h - (truth.h - rotate(truth.C_nb, np.array([1.0, 2.0, -3.0]))[:, 2]) - altimeter.true_bias
    slow = 2.0 * np.sqrt(1.0 - np.exp(-1.0 / 50.0))
    assert np.diff(error).std() / np.sqrt(2) == pytest.approx(np.hypot(0.5, slow), rel=0.03)
    assert error.std() == pytest.approx(np.hypot(0.5, 2.0), rel=0.1)
    assert block.variance == 0.25
    biases = [AltimeterSim(scenario.with_seed(seed), altimeter.trajectory).true_bias for seed in range(300)]
    assert np.std(biases) == pytest.approx(4.0, rel=4 / np.sqrt(600))


def test_star_sensor_errors_and_what_its_message_says(voyage):
    scenario = voyage(duration_s=4000.0, imu_rate_hz=10, **SECTIONS)
    star = StarTrackerSim(scenario)
    block = star.block(1, star.samples)
    truth = star.trajectory.truth(block.stamp_ns * 1e-9)
    error = log_so3(np.swapaxes(truth.C_nb, -1, -2) @ dcm_from_euler(*block.rph.T)) / ARCSEC
    assert error.std(axis=0) == pytest.approx([5.0, 7.0, 15.0], rel=5 / np.sqrt(2 * star.samples))
    assert error.mean(axis=0) == pytest.approx(star.true_misalignment / ARCSEC, abs=1.0)
    assert np.linalg.norm(star.true_misalignment) > 5.0 * ARCSEC
    message = fields.attitude(7, block.rph[10], block.covariance)
    covariance = message["pose"]["covariance"].reshape(6, 6)
    assert np.trace(covariance[3:, 3:]) == pytest.approx(np.trace(block.covariance)) and not covariance[:3].any()
    assert covariance[5, 5] == pytest.approx((15.0 * ARCSEC) ** 2, rel=0.1)  # nearly level: about up
    yaw = 2.0 * np.arctan2(message["pose"]["pose"]["orientation"]["z"], message["pose"]["pose"]["orientation"]["w"])
    assert np.angle(np.exp(1j * (yaw + block.rph[10, 2] - 0.5 * np.pi))) == pytest.approx(0.0, abs=0.02)
    assert fields.height(7, 12.5, 0.25)["pose"]["covariance"][14] == 0.25


def test_stars_are_gone_behind_clouds_and_in_a_fast_turn(voyage):
    outages = [{"target": "star_tracker", "start_s": 5.0, "end_s": 8.0}, {"target": "odometer", "start_s": 1.0, "end_s": 2.0}]
    slow = {**SECTIONS, "star_tracker": {**SECTIONS["star_tracker"], "max_rate_deg_s": 0.7}}
    quiet = {"sea": {"significant_wave_height_m": 0.0}, "duration_s": 200.0, "outages": outages}
    star = StarTrackerSim(voyage(**quiet, **slow))
    gone = np.flatnonzero(~star.block(1, 200).valid) + 1
    assert gone[:3].tolist() == [5, 6, 7]
    turning = np.linalg.norm(star.trajectory.truth(gone[3:].astype(float)).rate_nb_b, axis=1)  # 1 deg/s from 60 s on
    assert turning.size > 60 and np.rad2deg(turning.min()) > 0.7
    assert np.flatnonzero(~OdometerSim(voyage(**quiet, **slow)).block(1, 8).valid).tolist() == [1, 2]


@given(st.integers(1, 350), st.lists(st.integers(1, 20), min_size=1, max_size=5), st.sampled_from(list(KINDS)))
@settings(max_examples=30, deadline=None)
def test_blocks_do_not_matter(further, k0, sizes, name):
    sensor, faults = further[name]
    sizes = [min(size, (390 - k0) // len(sizes)) for size in sizes]
    whole, k = sensor.block(k0, sum(sizes), faults), k0
    for size in sizes:
        part = sensor.block(k, size, faults)
        rows = slice(k - k0, k - k0 + size)
        assert np.array_equal(_reading(part), _reading(whole)[rows]) and np.array_equal(part.valid, whole.valid[rows])
        k += size


@pytest.fixture(scope="module")
def further(shared_trajectory):
    """The three sensors with faults of every shape."""
    import yaml
    from sim_voyage import BASE

    from riins_sim.scenario import from_yaml

    faults = [
        {"target": "odometer", "type": "scale", "size_percent": -20.0, "start_s": 20.0, "end_s": 60.0},
        {"target": "odometer", "type": "stuck", "start_s": 100.0, "end_s": 120.0},
        {"target": "altimeter", "type": "ramp", "slope_mps": 0.5, "start_s": 30.0},
        {"target": "altimeter", "type": "noise", "size_m": 5.0, "start_s": 80.0},
        {"target": "star_tracker", "type": "step", "axis": "heading", "size_arcmin": 3.0, "start_s": 40.0, "end_s": 90.0},
        {"target": "star_tracker", "type": "stuck", "start_s": 120.0, "end_s": 150.0},
        {"target": "star_tracker", "type": "dropout", "start_s": 200.0, "end_s": 210.0},
    ]
    scenario = from_yaml(yaml.safe_dump({**BASE, **SECTIONS, "faults": faults}))
    return {name: (kind(scenario, shared_trajectory), scenario.fault_schedule()) for name, kind in KINDS.items()}


def test_the_twin_is_equal_outside_the_faults(further):
    for name, (sensor, faults) in further.items():
        m = min(sensor.samples, 400)
        sick, twin = sensor.block(1, m, faults), sensor.block(1, m)
        inside = np.zeros(m, dtype=bool)
        for fault in faults.faults:
            if fault.target == name and fault.type != FaultType.DROPOUT:
                start = fault.start_ns + (fault.type == FaultType.RAMP)  # a ramp is nothing at its start
                inside |= (sick.stamp_ns >= start) & (sick.stamp_ns < (fault.end_ns or 2**62))
        differs = (_reading(sick) != _reading(twin)).any(axis=1)
        assert np.array_equal(differs, inside), name
    star, faults = further["star_tracker"]
    sick, twin = star.block(1, 220, faults), star.block(1, 220)
    assert (sick.rph - twin.rph)[39:89] == pytest.approx(np.tile([0.0, 0.0, 180.0 * ARCSEC], (50, 1)), abs=1e-12)
    assert np.all(sick.rph[119:149] == twin.rph[118]) and np.flatnonzero(~sick.valid).tolist() == list(range(199, 209))


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"target": "odometer", "type": "step", "size_m": 3.0}, "size_kn or size_mps"),
        ({"target": "odometer", "type": "step", "size_mps": 3.0, "axis": "starboard"}, "all, forward"),
        ({"target": "altimeter", "type": "scale", "size_percent": 3.0}, "no meaning for the height of altimeter"),
        ({"target": "altimeter", "type": "step", "size_m": 3.0, "axis": "down"}, "all, up"),
        ({"target": "star_tracker", "type": "ramp", "slope_mps": 3.0}, "slope_arcsec_s or slope_deg_s"),
        ({"target": "star_trakcer", "type": "dropout"}, 'did you mean "star_tracker"'),
    ],
)
def test_bad_faults(values, words):
    with pytest.raises(SettingError, match=words):
        build(FaultSettings, {**values, "start_s": 1.0})


def test_a_fault_of_all_axes_is_what_there_is():
    stamps = np.arange(1, 4, dtype=np.int64) * S
    for name, width, expected in (("odometer", 3, [2.0, 0.0, 0.0]), ("altimeter", 1, [2.0]), ("star_tracker", 3, [2.0, 2.0, 2.0])):
        values = np.zeros((3, width))
        assert FaultSchedule([Fault(name, FaultType.STEP, 2.0)]).apply_aid(name, stamps, 1, values, lambda t: None).all()
        assert values.tolist() == [expected] * 3
