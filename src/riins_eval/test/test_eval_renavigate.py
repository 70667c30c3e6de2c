"""A recording navigated again: equal to the bit where the same samples go in, whatever their order, topics, namespace and commands."""

from __future__ import annotations

import numpy as np
import pytest
from eval_voyage import equal, near, rewrite
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from riins_bag.bag import BagError, BagReader, BagWriter, deserialize, message, schema_text, serialize
from riins_core.settings import SettingError, as_mapping
from riins_eval import bag_record, offline, renavigate
from riins_eval.renavigate import RAW_TOPICS
from riins_eval.run_configuration import RecordError, aid_topics
from riins_eval.score import score, score_bag
from riins_federated.types import Reason, UseCommand
from riins_imu_fusion.selection import Selection
from riins_node import fields


def test_navigating_the_bag_again_is_equal_to_the_bit(run, bag, tmp_path):
    again = offline.navigate(bag, tmp_path / "again")
    assert equal(again.record.settled, run.record.settled)
    assert np.array_equal(again.record.covariance, run.record.covariance)
    assert [(c.stamp_ns, c.target, c.state) for c in again.record.health] == [(c.stamp_ns, c.target, c.state) for c in run.record.health]
    assert again.score["samples"] == run.score["samples"]
    assert again.score["faults"][0]["epochs_fused"] == 0
    alone = score_bag(tmp_path / "again")  # what was copied is enough to score it alone; the twins are sailed again from its scenario
    assert alone["position_rms_m"] == pytest.approx(run.score["position_rms_m"])
    assert alone["oracle_ratio"] == pytest.approx(run.score["oracle_ratio"], rel=1e-6)
    with BagReader(tmp_path / "again") as reader:
        assert "/rimu/raw" not in reader.topics and "/truth/state" in reader.topics


def test_overrides_change_the_navigation_and_are_recorded(bag, tmp_path, run):
    alone = offline.navigate(bag, tmp_path / "log", overrides={"navigator": {"gps": {"enabled": False}, "bds": {"enabled": False}}})
    assert set(alone.score["nis_per_dof"]) == {"doppler"}
    assert alone.score["position_rms_m"] > run.score["position_rms_m"]
    assert set(score(bag_record.read_record(tmp_path / "log", twins=False))["nis_per_dof"]) == {"doppler"}
    with BagReader(tmp_path / "log") as reader:
        assert bag_record.read_configuration(reader).navigator.aid["gps"].enabled is False
    with pytest.raises(SettingError, match="did you mean"):
        offline.navigate(bag, overrides={"navigator": {"gsp": {"enabled": False}}})


def test_aids_by_other_names_are_read_from_their_topics(bag, tmp_path, run):
    """The same receivers declared under names and topics of their own: the same numbers to the bit; with a frame that is not theirs: none."""
    topics = {"/gps/fix": "/bow/fix", "/bds/fix": "/aft/position"}
    with BagReader(bag) as reader, BagWriter(tmp_path / "renamed", flush_period_s=0.0) as writer:
        known = bag_record.read_configuration(reader).navigator.aid
        for one in reader.messages((*RAW_TOPICS, "/riins/configuration")):
            writer.write(topics.get(one.topic, one.topic), one.msgtype, one.data, one.log_ns)
    bow, stern = (as_mapping(known[name]) for name in ("gps", "bds"))
    declared = {"aids": ["bow", "stern", "doppler"], "bow": bow, "stern": {**stern, "topic": "/aft/position", "frame": "bds_link"}}
    made = offline.navigate(tmp_path / "renamed", tmp_path / "again", overrides={"navigator": declared}).record
    assert equal(made.settled, run.record.settled) and set(made.judged) == {"bow", "stern", "doppler"}
    with BagReader(tmp_path / "again") as reader:
        assert reader.topics["/aft/position"].number == 30 and aid_topics(reader) == ["/bow/fix", "/aft/position", "/doppler/velocity"]
        assert list(bag_record.read_configuration(reader).navigator.aid) == ["bow", "stern", "doppler"]
    wrong = {**declared, "stern": {**declared["stern"], "frame": "other_link"}}
    refused = offline.navigate(tmp_path / "renamed", overrides={"navigator": wrong}).record
    assert "stern" not in refused.judged and (refused.samples.rejected, refused.samples.no_fix) == (28, 2)


DVL = """
std_msgs/Header header
uint8 velocity_mode
uint8 dvl_type
geometry_msgs/Vector3 velocity
float64[9] velocity_covar
float64 altitude
float64 course_gnd
float64 speed_gnd
uint8 num_good_beams
float32 sound_speed
bool beam_ranges_valid
bool beam_velocities_valid
geometry_msgs/Vector3[4] beam_unit_vec
float64[4] range
float32[4] range_covar
float32[4] beam_quality
float32[4] beam_velocity
float32[4] beam_velocity_covar
"""


def test_beams_of_a_dvl_recorded_by_a_package_that_is_not_installed_are_navigated(bag, tmp_path, run):
    """The log's velocities as marine_acoustic_msgs/Dvl, whose definition is in the bag alone; one beam never sees the bottom."""
    kind, types = "marine_acoustic_msgs/msg/Dvl", get_typestore(Stores.ROS2_JAZZY)
    types.register(get_types_from_msg(DVL, kind))
    azimuth = np.radians([45.0, 135.0, 225.0, 315.0])
    along = np.column_stack([np.sin(np.pi / 6) * np.cos(azimuth), np.sin(np.pi / 6) * np.sin(azimuth), np.full(4, np.cos(np.pi / 6))])
    with BagReader(bag) as reader, BagWriter(tmp_path / "dvl", flush_period_s=0.0) as writer:
        log = as_mapping(bag_record.read_configuration(reader).navigator.aid["doppler"])
        writer.add_topic("/dvl/dvl", kind, schema=schema_text(kind, types), digest=types.hash_rihs01(kind))
        for one in reader.messages((*RAW_TOPICS, "/riins/configuration")):
            if one.topic != "/doppler/velocity":
                writer.write(one.topic, one.msgtype, one.data, one.log_ns)
        empty, vector = np.zeros(4), types.types["geometry_msgs/msg/Vector3"]
        for _, log_ns, msg in reader.read(("/doppler/velocity",)):
            v = msg.twist.twist.linear
            beams = along @ [v.x, -v.y, -v.z if np.isfinite(v.z) else 0.0]
            beams[2] = np.nan
            made = types.types[kind](
                msg.header, 1, 0, v, np.full(9, -1.0), 50.0, 0.0, 0.0, 3, 1500.0, True, True, np.array([vector(0.0, 0.0, 1.0)] * 4), empty,
                empty.astype(np.float32), empty.astype(np.float32), beams.astype(np.float32), np.full(4, -1.0, np.float32),
            )  # fmt: skip
            writer.write("/dvl/dvl", kind, bytes(types.serialize_cdr(made, kind)), log_ns)
    keep = ("misalignment_deg", "lever_arm_m", "period_s", "timeout_s")
    dvl = {"type": "beam_velocity", "sigma_mps": 0.1, **{name: log[name] for name in keep}}
    made = offline.navigate(tmp_path / "dvl", tmp_path / "again", overrides={"navigator": {"aids": ["gps", "bds", "dvl"], "dvl": dvl}})
    assert made.score["subfilters"]["dvl"]["accepted"] == 60 and made.score["position_rms_m"] < 6.0
    assert made.record.judged["dvl"].innovation.shape == (60, 3)


def test_order_of_arrival_does_not_matter(bag, tmp_path, run):
    """Law 1 from a bag: aids that arrive up to 1.9 s late, mixed among the samples, give the same result."""
    rng = np.random.default_rng(1)

    def late(one):
        delay = int(rng.uniform(0, 1.9e9)) if one.topic in ("/gps/fix", "/bds/fix", "/doppler/velocity") else 0
        return one.data, one.log_ns + delay

    rewrite(bag, tmp_path / "late", late)
    again = offline.navigate(tmp_path / "late")
    assert equal(again.record.settled, run.record.settled)
    assert again.score["samples"]["late"] == 0


def test_a_recording_made_in_a_namespace_is_read_without_it(bag, tmp_path, run):
    with BagReader(bag) as reader, BagWriter(tmp_path / "ship", flush_period_s=0.0) as one, BagWriter(tmp_path / "fleet", flush_period_s=0.0) as two:
        for topic, msgtype, data, log_ns in reader.messages():
            inside = topic if topic == "/riins/configuration" else f"/fleet/ship1{topic}"
            one.write(inside, msgtype, data, log_ns)
            two.write(inside, msgtype, data, log_ns)
            if topic != "/riins/configuration":
                two.write(f"/fleet/ship2{topic}", msgtype, data, log_ns)
    again = offline.navigate(tmp_path / "ship", tmp_path / "again")
    assert equal(again.record.settled, run.record.settled)
    with BagReader(tmp_path / "again") as reader:
        assert {"/nav/settled", "/gps/fix", "/truth/state"} <= set(reader.topics)
    chosen = bag_record.read_record(tmp_path / "fleet", twins=False, namespace="/fleet/ship2")
    assert near(score(chosen)["position_rms_m"], run.score["position_rms_m"]) == []
    with pytest.raises(BagError, match=r"fleet/ship1, fleet/ship2: choose one with --namespace"):
        bag_record.read_record(tmp_path / "fleet")
    with pytest.raises(BagError, match="nothing in the namespace fleet/ship3"):
        bag_record.read_record(tmp_path / "fleet", namespace="fleet/ship3")


def test_a_change_of_method_in_the_bag_is_obeyed_at_its_stamp(bag, tmp_path, run):
    """Laws 1 and 2: what was selected live is selected again, wherever the recorder heard of it; what the caller overrides stays."""
    at = int(run.record.origin_ns + 30_000_000_000)
    with BagReader(bag) as reader, BagWriter(tmp_path / "told", flush_period_s=0.0) as writer:
        assert reader.topics["/fdi/method"].number == 1  # as a live run has it
        for one in reader.messages([t for t in (*RAW_TOPICS, "/riins/configuration") if t != "/fdi/method"]):
            writer.write(one.topic, one.msgtype, one.data, one.log_ns)
        start = offline.navigate(bag).record
        for stamp, chosen, log_ns in (
            (0, Selection("wls", "glt", "none", False), at), (at, Selection("irfdc", "svd", "cusum", False), at + 5_000_000_000)
        ):  # fmt: skip
            writer.write_message("/fdi/method", "riins_msgs/msg/FusionMethod", fields.fusion_method(stamp, chosen), log_ns)
    told = offline.navigate(tmp_path / "told", tmp_path / "again", record="all")
    assert not [n for n in told.record.notes if "refused" in n] and not equal(told.record.settled, start.settled)
    with BagReader(tmp_path / "again") as reader:
        columns = reader.columns("/imu/fused", ("header.stamp", "gyro_drift"))
        estimated, after = np.any(columns["gyro_drift"] != 0.0, axis=1), columns["header.stamp"].astype(np.int64) > at
        assert not estimated[~after].any() and estimated[after].mean() > 0.99 and reader.topics["/fdi/method"].number == 2
    assert equal(offline.navigate(tmp_path / "again").record.settled, told.record.settled)  # a run with a switch is reproduced
    overrides = {"fusion": {"method": "wls", "parity_test": "glt", "sequential_test": "none"}}
    kept = offline.navigate(tmp_path / "told", tmp_path / "kept", record="raw", overrides=overrides)
    assert equal(offline.navigate(tmp_path / "kept").record.settled, kept.record.settled)  # the bag says what was used, not what was told
    plain = offline.navigate(bag, overrides={"fusion": {"method": "wls"}})
    assert equal(kept.record.settled, plain.record.settled)


def test_commands_of_the_bag_are_obeyed_at_their_stamp(bag, tmp_path, run, monkeypatch):
    """Law 1: what the operator said live is in the bag with the stamp it held from, whenever the recorder heard of it."""

    def at(seconds):
        return int(run.record.origin_ns + round(seconds * 1e9))

    commands = [("accel_1", False, 0), ("gps", False, at(40.0)), ("gyro_2", False, at(40.005)), ("gps", True, at(48.0)), ("gyro_2", True, at(50.0))]
    # the recorder hears of the second and third 1 s after their stamps, in the window after the one in which they hold
    heard = [at(0.0), at(41.0), at(41.2), at(48.2), at(45.0)]
    monkeypatch.setattr(renavigate, "WINDOW_NS", 40_500_000_000)
    with BagReader(bag) as reader, BagWriter(tmp_path / "told", flush_period_s=0.0) as writer:
        for one in reader.messages((*RAW_TOPICS, "/riins/configuration")):
            writer.write(one.topic, one.msgtype, one.data, one.log_ns)
        for (target, use, stamp), log_ns in zip(commands, heard, strict=True):
            writer.write_message("/nav/commands", "riins_msgs/msg/SensorUse", fields.sensor_use(stamp, target, use), log_ns)
    told = offline.navigate(tmp_path / "told", tmp_path / "again", record="all")

    first = renavigate._Run._obey

    def directly(self, part):
        if not hasattr(self, "given"):
            self.given = True
            for target, use, stamp in commands:
                if target == "gps":
                    assert self.lane.navigator.set_use(UseCommand(target, use, stamp)) == ""
                else:
                    assert self.pipeline.set_sensor_use(target, use, stamp).success
        first(self, part)

    monkeypatch.setattr(renavigate._Run, "_obey", directly)
    direct = offline.navigate(bag)
    assert equal(told.record.settled, direct.record.settled) and not equal(told.record.settled, run.record.settled)
    assert np.array_equal(told.record.covariance, direct.record.covariance)
    assert told.record.health == direct.record.health and not [n for n in told.record.notes if "refused" in n]
    gps = told.record.judged["gps"]
    refused = gps.reason == Reason.OPERATOR
    assert (gps.stamp_ns[refused][0], refused.sum()) == (at(40.0), 8) and not gps.accepted[refused].any()
    used = told.record.use
    assert used.samples_with("gyro_2", at(39.995), at(40.005)) == 1 and used.samples_with("gyro_2", at(40.005), at(50.0)) == 0
    assert used.samples_with("accel_1", at(0.0), at(61.0)) == 0
    with BagReader(tmp_path / "again") as reader:
        assert reader.topics["/nav/commands"].number == len(commands)
    monkeypatch.undo()
    assert equal(offline.navigate(tmp_path / "again").record.settled, direct.record.settled)


def test_a_command_that_cannot_be_obeyed_is_noted(bag, tmp_path, run):
    with BagReader(bag) as reader, BagWriter(tmp_path / "told", flush_period_s=0.0) as writer:
        for one in reader.messages((*RAW_TOPICS, "/riins/configuration")):
            writer.write(one.topic, one.msgtype, one.data, one.log_ns)
        for target in ("sonar", "gyro_9"):
            writer.write_message("/nav/commands", "riins_msgs/msg/SensorUse", fields.sensor_use(reader.start_ns, target, False), reader.start_ns)
    told = offline.navigate(tmp_path / "told")
    assert [n.split(": ")[1].split('"')[1] for n in told.record.notes if n.startswith("Command")] == ["sonar", "gyro_9"]
    assert equal(told.record.settled, run.record.settled)


def test_what_came_too_late_is_late_again(bag, tmp_path):
    def late(one):
        return one.data, one.log_ns + (3_000_000_000 if one.topic == "/doppler/velocity" else 0)

    rewrite(bag, tmp_path / "late", late)
    result = offline.navigate(tmp_path / "late").score
    # the last three arrive when no later sample has been seen that far ahead
    assert 54 <= result["samples"]["late"] <= 60
    assert result["subfilters"].get("doppler", {"accepted": 0})["accepted"] <= 6


def test_what_another_clock_has_stamped_is_refused_and_counted(bag, tmp_path):
    def ahead(one):
        if one.topic != "/doppler/velocity":
            return one.data, one.log_ns
        message = deserialize(one.msgtype, one.data)
        message.header.stamp.sec += 3600
        return serialize(one.msgtype, message), one.log_ns

    rewrite(bag, tmp_path / "ahead", ahead)
    result = offline.navigate(tmp_path / "ahead").score
    assert result["samples"]["late"] == 60 and not result["subfilters"].get("doppler", {"accepted": 0})["accepted"]


def test_malformed_samples_are_counted(bag, tmp_path):
    store = {}

    def spoil(one):
        if one.topic != "/rimu/raw":
            return one.data, one.log_ns
        k = store["k"] = store.get("k", 0) + 1
        if k in (700, 701):  # five gyros
            msg = deserialize(one.msgtype, one.data)
            made = {f: getattr(msg, f) for f in ("header", "sequence", "accel", "gyro_valid", "accel_valid")}
            return serialize(one.msgtype, message(one.msgtype, {**made, "gyro": msg.gyro[:5]})), one.log_ns
        return None if 900 <= k < 910 else (one.data, one.log_ns)

    rewrite(bag, tmp_path / "spoiled", spoil)
    result = offline.navigate(tmp_path / "spoiled").score
    assert result["samples"] == {"received": 5990, "lost": 10, "late": 0, "rejected": 2, "no_fix": 2}
    assert result["position_rms_m"] < 6.0


def test_a_bag_without_what_is_needed_says_so(bag, tmp_path):
    for missing, words in (("/riins/configuration", "configuration"), ("/rimu/raw", "nothing to navigate"), ("/nav/initial_state", "never start")):
        target = tmp_path / missing.strip("/").replace("/", "_")
        rewrite(bag, target, lambda one, missing=missing: None if one.topic == missing else (one.data, one.log_ns))
        with pytest.raises(RecordError, match=words):
            offline.navigate(target)


def test_a_run_with_one_ordinary_imu_says_how_it_is_navigated_again(tmp_path):
    with BagWriter(tmp_path / "plain", flush_period_s=0.0) as writer:
        content = fields.imu_raw(10**18, np.zeros(3), np.array([0.0, 0.0, -9.8]), np.eye(3), np.eye(3))
        writer.write_message("/imu/data_raw", "sensor_msgs/msg/Imu", content, 10**18)
    with pytest.raises(RecordError, match=r"only /imu/data_raw of one IMU: play it .* imu_topic_type imu"):
        offline.navigate(tmp_path / "plain")
