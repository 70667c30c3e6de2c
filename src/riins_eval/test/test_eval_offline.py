"""A short voyage offline: score, twins, oracle, what is recorded."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from eval_voyage import equal

from riins_bag.bag import BagReader
from riins_core.settings import SettingError
from riins_eval import configure, metrics, offline
from riins_eval.run_configuration import RecordError
from riins_eval.score import score_bag, verdict
from riins_sim.faults import FaultSchedule, FaultSettings
from riins_sim.scenario import load
from riins_sim.sensors import RedundantImuSim


def test_the_voyage_is_scored(run):
    result = run.score
    assert verdict(result, run.expect) == []
    assert result["samples"] == {"received": 6000, "lost": 0, "late": 0, "rejected": 0, "no_fix": 2}  # two fixes of BDS in its outage
    step, spoof = result["faults"]
    assert (step["target"], step["detected"], step["epochs_fused"]) == ("gyro_4", True, 0) and step["delay_s"] < 0.5
    assert (spoof["target"], spoof["delay_s"], spoof["epochs_fused"]) == ("gps", 0.0, 0)
    assert 0.3 < result["nis_per_dof"]["doppler"] < 2.0
    assert 0.5 < result["oracle_ratio"]["position"] < 2.0
    assert 0.0 < result["twin_deviation_max_m"] < 5.0
    assert result["realtime_factor"] > 1.0
    assert len(run.record.settled) == 60 and np.isfinite(run.record.truth.lat).all()


def test_the_twin_is_the_voyage_without_faults_and_the_oracle_never_sees_them(run, scenario):
    clean = offline.sail(dataclasses.replace(scenario, faults=()), twins=True)
    assert equal(clean.record.settled, run.record.twin)
    assert clean.score["twin_deviation_max_m"] == 0.0
    assert clean.score["oracle_ratio"] == {"position": 1.0, "velocity": 1.0, "heading": 1.0}
    before = run.record.settled.stamp_ns < run.record.faults[0].start_ns
    assert equal(run.record.settled.take(before), run.record.oracle.take(before))
    # with the GPS silent in the same 10 s and the gyro flagged, an honest run is the oracle
    assert np.abs(metrics.position_error(run.record.oracle, run.record.twin)).max() < 3.0
    assert not equal(run.record.oracle, run.record.twin)


def test_without_twins_their_numbers_are_null_and_nothing_else_changes(run, scenario):
    alone = offline.sail(scenario, twins=False)
    assert equal(alone.record.settled, run.record.settled)
    assert alone.score["twin_deviation_max_m"] is None and alone.score["oracle_ratio"]["position"] is None
    other = offline.sail(scenario, seed=5, twins=False)
    assert not np.array_equal(other.record.settled.lat, run.record.settled.lat)


def test_the_block_length_does_not_matter(run, scenario, monkeypatch):
    monkeypatch.setattr(offline, "CHUNK_S", 3.7)
    assert equal(offline.sail(scenario, twins=False).record.settled, run.record.settled)


def test_the_bag_has_the_topics_of_the_live_graph(bag):
    with BagReader(bag) as reader:
        counts = {topic: number for topic, (_, number) in reader.topics.items()}
        assert counts["/rimu/raw"] == counts["/imu/fused"] == 6000
        assert counts["/nav/settled"] == counts["/nav/covariance"] == counts["/nav/odometry"] == counts["/nav/fix"] == 60
        assert counts["/gps/fix"] == 60 and counts["/gps/velocity"] == 60 and counts["/bds/fix"] == 30 and counts["/bds/velocity"] == 28
        assert counts["/truth/state"] == 601
        assert counts["/riins/configuration"] == counts["/nav/initial_state"] == counts["/truth/faults"] == 1
        first = next(iter(reader.messages()))
        assert first.topic == "/riins/configuration"
        for topic, log_ns, msg in reader.read(
            ("/nav/settled", "/gps/fix", "/doppler/velocity", "/imu/fused"), stop_ns=reader.start_ns + 2_000_000_000
        ):
            assert msg.header.stamp.sec * 10**9 + msg.header.stamp.nanosec == log_ns, topic


@pytest.mark.parametrize(("record", "has", "lacks"), [("nav", "/nav/settled", "/rimu/raw"), ("raw", "/rimu/raw", "/nav/settled")])
def test_what_is_recorded_can_be_chosen(scenario, tmp_path, record, has, lacks):
    short = dataclasses.replace(scenario, duration_s=15.0, faults=(), expect={})
    offline.sail(short, bag=tmp_path / record, record=record, twins=False)
    with BagReader(tmp_path / record) as reader:
        assert has in reader.topics and lacks not in reader.topics and "/truth/state" in reader.topics and "/riins/configuration" in reader.topics
    if record == "raw":
        with pytest.raises(RecordError, match="riins navigate"):
            score_bag(tmp_path / record)
    with pytest.raises(ValueError, match="record must be"):
        offline.sail(short, bag=tmp_path / "x", record="everything")


def test_faults_of_the_oracle_are_hidden_in_their_interval_only(scenario):
    imu = RedundantImuSim(scenario)
    schedule = FaultSchedule([f.fault() for f in scenario.faults])
    raw = imu.block(1990, 20, schedule)
    hidden = offline._hide(raw, schedule.only(["gyro", "accel"]).faults)
    bit = (hidden.gyro_valid >> np.uint64(4)) & np.uint64(1)
    assert bit.tolist() == [1] * 10 + [0] * 10
    assert (hidden.accel_valid == raw.accel_valid).all()


def test_an_imu_that_is_not_the_one_of_the_fusion_and_a_run_without_a_sample_are_told(scenario):
    with pytest.raises(SettingError, match=r'"fusion.geometry" has 3 axes, the simulated IMU \(dodecahedron\) has 6'):
        offline.sail(dataclasses.replace(scenario, faults=(), fusion={"geometry": [1, 0, 0, 0, 1, 0, 0, 0, 1]}))
    gone = [FaultSettings(f"gyro_{i}", "dropout", 0.0) for i in range(4)]
    with pytest.raises(RecordError, match="never started: 0 of 200 samples"):
        offline.sail(dataclasses.replace(scenario, duration_s=2.0, faults=tuple(gone), expect={}), twins=False)


def test_output_correction_holds_for_hours():
    """Target 32 at 10 Hz: fed back every hour, or never but height and vertical velocity, which would run away."""
    calm = dataclasses.replace(load("voyage_12h"), imu_rate_hz=10.0, duration_s=10800.0, faults=(), outages=())
    rms, error = {}, {}
    for period in (3600.0, 1e6):
        navigator = configure.merged(calm.navigator, {"feedback_period_s": period})
        result = offline.sail(dataclasses.replace(calm, navigator=navigator), twins=False)
        found, record = result.score, result.record
        error[period] = metrics.position_error(record.settled, record.truth)[:, :2]
        rms[period] = np.array([found[name] for name in ("position_rms_m", "velocity_rms_mps", "heading_rms_arcmin")])
    assert np.all(np.abs(rms[1e6] / rms[3600.0] - 1.0) < 0.002)
    assert np.abs(error[1e6] - error[3600.0]).max() < 0.2
