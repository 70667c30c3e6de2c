"""Cars and aircraft offline: the shipped ones keep what they promise, and a recording of every aid is navigated to the same bits."""

from __future__ import annotations

import numpy as np
import pytest

from riins_bag.bag import BagReader
from riins_eval import offline
from riins_eval.configure import navigator_config
from riins_eval.score import verdict
from riins_eval.simulated_aids import SimulatedAids
from riins_sim import suite
from riins_sim.scenario import from_yaml
from riins_sim.trajectory import Trajectory

EVERYTHING = """
name: everything
seed: 5
duration_s: 60.5
imu_rate_hz: 50
start: {latitude_deg: 34, longitude_deg: 108, height_m: 300, speed_kn: 40, heading_deg: 30}
legs: [{straight_s: 5}, {climb_m: 20, climb_deg: 4}, {turn_deg: 30, rate_deg_s: 3, blend_s: 4}]
vessel: {heel_rad_per_g: 0.0}
imu:
  gyro: {constant_drift_deg_h: 0.05, arw_deg_sqrt_h: 0.01}
  accel: {bias_ug: 100.0, vrw_ug_sqrt_hz: 30.0}
gps: {sigma_m: [3.0, 3.0, 6.0], lever_arm_m: [1.0, 0.5, -1.0]}
bds: {enabled: false}
doppler: {sigma_kn: [0.2, 0.2, 0.2], scale_ppm: 500.0}
odometer: {enabled: true, period_s: 0.5, sigma_mps: 0.05, scale_ppm: 2000.0}
altimeter: {enabled: true, sigma_m: 1.0, markov_sigma_m: 2.0}
star_tracker: {enabled: true, misalignment_arcsec: 20.0, max_rate_deg_s: 2.5}
initial: {position_m: 3.0, height_m: 3.0, velocity_mps: 0.05, tilt_arcsec: 20.0, heading_arcmin: 3.0}
outages: [{target: star_tracker, start_s: 0.0, end_s: 12.0}]
faults:
  - {target: star_tracker, type: step, axis: heading, size_deg: 1.0, start_s: 15.0, end_s: 20.0}
  - {target: altimeter, type: step, size_m: 80.0, start_s: 40.0, end_s: 46.0}
  - {target: odometer, type: scale, size_percent: 40.0, start_s: 44.0, end_s: 50.0}
navigator:
  aids: [gps, gps_velocity, doppler, odometer, altimeter, star_tracker]
  gps_velocity: {type: gnss_velocity, topic: gps/velocity, lever_arm_m: [1.0, 0.5, -1.0], period_s: 1.0, timeout_s: 3.5}
"""


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """The car with every aid, recorded."""
    path = tmp_path_factory.mktemp("everything") / "bag"
    return offline.sail(from_yaml(EVERYTHING), bag=path, record="all"), path


def test_a_recording_of_every_aid_is_navigated_to_the_same_bits(run, tmp_path):
    result, path = run
    with BagReader(path) as reader:
        assert {f"/{topic}" for name in suite.enabled(from_yaml(EVERYTHING)) for topic in suite.TOPICS[name]} <= set(reader.topics)
        assert reader.topics["/star_tracker/attitude"].number == result.record.judged["star_tracker"].stamp_ns.size
    again = offline.navigate(path, tmp_path / "again").record
    for name in ("stamp_ns", "lat", "lon", "h", "v_n", "rph"):
        assert np.array_equal(getattr(again.settled, name), getattr(result.record.settled, name)), name
    with BagReader(tmp_path / "again") as reader:
        assert {"/odometer/velocity", "/altimeter/height", "/star_tracker/attitude", "/gps/velocity"} <= set(reader.topics)


def test_a_fault_of_each_aid_is_isolated_and_nothing_else(run):
    result, _ = run
    score = result.score
    assert [(f["target"], f["isolated_right"], f["wrongly_isolated"], f["epochs_fused"]) for f in score["faults"]] == [
        (name, True, [], 0) for name in ("star_tracker", "altimeter", "odometer")
    ]
    assert score["false_isolations"] == 0 and score["position_rms_m"] < 4.0 and score["tilt_rms_arcmin"] < 1.0
    assert score["twin_deviation_max_m"] < 5.0 and score["oracle_ratio"]["position"] < 2.0


def test_measurements_do_not_depend_on_the_block():
    scenario = from_yaml(EVERYTHING)
    aids = SimulatedAids(scenario, Trajectory(scenario), navigator_config(scenario), 10**18)
    faults = scenario.fault_schedule()
    whole = aids.read(aids.between(0, 60_000_000_000, faults))
    cut = [a for first in range(0, 60, 3) for a in aids.read(aids.between(first * 10**9, (first + 3) * 10**9, faults))]
    assert [(a.name, a.stamp_ns, a.ok) for a in whole] == [(a.name, a.stamp_ns, a.ok) for a in cut] and len(whole) > 350
    assert all(np.array_equal(a.z, b.z) and np.array_equal(a.R, b.R) for a, b in zip(whole, cut, strict=True))
    lying = {a.name for a in whole if aids.lies(a, faults.faults)}
    assert lying == {"star_tracker", "altimeter", "odometer"}


@pytest.mark.parametrize("name", ["vehicle", "aircraft"])
def test_shipped_scenarios_keep_what_they_promise(name):
    result = offline.sail(name, twins=False)
    assert verdict(result.score, result.expect) == []
