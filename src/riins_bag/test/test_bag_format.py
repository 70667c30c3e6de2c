"""What other people's readers see: rosbag2 directory, metadata version 9, MCAP, schemas, type hashes, QoS."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import yaml
from bag_helpers import DT_NS, EPOCH_NS, FIX, NAV, RAW, make_bag
from mcap.reader import make_reader
from mcap.records import Chunk
from mcap.stream_reader import StreamReader
from rosbags.highlevel import AnyReader
from rosbags.interfaces import QosDurability, QosReliability

from riins_bag.bag import BagError, BagReader, BagWriter, Qos, schema_text, type_hash, typestore
from riins_bag.typesys import definition_files


def test_rosbags_reads_it_without_our_code_or_types(tmp_path: Path) -> None:
    bag = make_bag(tmp_path / "bag", 500)
    with AnyReader([bag]) as reader:  # no default_typestore: the types come from the schemas in the file
        topics = reader.topics
        assert topics["/rimu/raw"].msgtype == RAW and topics["/rimu/raw"].msgcount == 500
        raw = [c for c in reader.connections if c.topic == "/rimu/raw"]
        seen = [(t, reader.deserialize(data, c.msgtype)) for c, t, data in reader.messages(raw)]
        assert [t for t, _ in seen] == [EPOCH_NS + k * DT_NS for k in range(1, 501)]
        assert [m.sequence for _, m in seen] == list(range(1, 501))
        np.testing.assert_array_equal(seen[41][1].gyro, 42 + np.arange(6) / 16.0)
        assert seen[0][1].accel_valid == 2**64 - 1 and seen[0][1].header.frame_id == "imu_link"
        latched = next(c for c in reader.connections if c.topic == "/riins/configuration")
        assert latched.ext.offered_qos_profiles[0].durability == QosDurability.TRANSIENT_LOCAL
        assert raw[0].ext.offered_qos_profiles[0].reliability == QosReliability.RELIABLE and raw[0].ext.offered_qos_profiles[0].depth == 400
        assert raw[0].digest == type_hash(RAW)


def test_mcap_reads_it_with_every_checksum_verified(tmp_path: Path) -> None:
    bag = make_bag(tmp_path / "bag", 500)
    with (bag / "bag_0.mcap").open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        assert reader.get_header().profile == "ros2"
        summary = reader.get_summary()
        assert summary is not None and summary.statistics is not None
        assert summary.statistics.message_count == 500 + 5 + 15 + 1
        assert {s.encoding for s in summary.schemas.values()} == {"ros2msg"} and {c.message_encoding for c in summary.channels.values()} == {"cdr"}
        times = [message.log_time for _, _, message in reader.iter_messages()]
        assert len(times) == 521 and times == sorted(times)
        assert sum(1 for _ in reader.iter_messages(["/gps/fix"])) == 5  # uses the message indexes
        stream.seek(0)
        records = list(StreamReader(stream, validate_crcs=True, emit_chunks=True).records)
    chunks = [record for record in records if isinstance(record, Chunk)]
    assert len(chunks) > 5 and {chunk.compression for chunk in chunks} == {"zstd"}
    assert all(chunk.uncompressed_size < 8192 + 4096 for chunk in chunks)


def test_metadata_is_version_9_as_ros2_bag_writes_it(tmp_path: Path) -> None:
    bag = make_bag(tmp_path / "bag", 300, custom_data={"vessel": "test"})
    info = yaml.safe_load((bag / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert list(info) == [
        "version", "storage_identifier", "duration", "starting_time", "message_count", "topics_with_message_count", "compression_format",
        "compression_mode", "relative_file_paths", "files", "custom_data", "ros_distro",
    ]  # fmt: skip
    assert (info["version"], info["storage_identifier"], info["ros_distro"]) == (9, "mcap", "jazzy")
    assert (info["compression_format"], info["compression_mode"]) == ("", "")  # MCAP compresses inside: ros2 bag must not unpack
    assert info["duration"]["nanoseconds"] == 300 * DT_NS and info["starting_time"]["nanoseconds_since_epoch"] == EPOCH_NS
    assert info["files"][0] == {
        "path": "bag_0.mcap",
        "starting_time": info["starting_time"],
        "duration": info["duration"],
        "message_count": info["message_count"],
    }
    assert info["relative_file_paths"] == ["bag_0.mcap"] and info["custom_data"] == {"vessel": "test"}
    raw = next(t for t in info["topics_with_message_count"] if t["topic_metadata"]["name"] == "/rimu/raw")
    assert raw["message_count"] == 300 and raw["topic_metadata"]["type_description_hash"].startswith("RIHS01_")
    profile = raw["topic_metadata"]["offered_qos_profiles"][0]
    assert (profile["history"], profile["depth"], profile["reliability"], profile["durability"]) == ("keep_last", 400, "reliable", "volatile")
    assert profile["deadline"] == {"sec": 9223372036, "nsec": 854775807} and profile["avoid_ros_namespace_conventions"] is False


def test_several_profiles_of_one_topic_survive(tmp_path: Path) -> None:
    offers = (Qos("best_effort", "volatile"), Qos("reliable", "transient_local", "keep_last", 3))
    with BagWriter(tmp_path / "bag") as bag:
        bag.write_message("/a", "std_msgs/msg/String", {"data": "x"}, 5, offers)
    with BagReader(tmp_path / "bag") as reader:
        assert reader.qos("/a") == offers
    with AnyReader([tmp_path / "bag"]) as other:
        assert len(other.connections[0].ext.offered_qos_profiles) == 2 and other.message_count == 1


def test_own_schemas_keep_units_and_embed_dependencies() -> None:
    text = schema_text(RAW)
    assert "rad/s" in text  # the comments of the .msg file
    assert f"{'=' * 80}\nMSG: std_msgs/Header\n" in text and "MSG: builtin_interfaces/Time\n" in text
    nested = schema_text("riins_msgs/msg/FederatedStatus")
    assert "MSG: riins_msgs/SubfilterStatus\n" in nested and "information-sharing" in nested


@pytest.mark.parametrize("name", ["RedundantImu", "FusedImu", "NavState", "InertialFdi", "FederatedStatus", "InitialState", "FaultArray"])
def test_type_hash_is_that_of_rosidl(name: str) -> None:
    generated = definition_files("riins_msgs")[f"riins_msgs/msg/{name}"].with_suffix(".json")
    if not generated.is_file():
        pytest.skip("riins_msgs is not built")
    hashes = {entry["type_name"]: entry["hash_string"] for entry in json.loads(generated.read_text())["type_hashes"]}
    assert type_hash(f"riins_msgs/msg/{name}") == hashes[f"riins_msgs/msg/{name}"]


def test_every_own_message_has_a_definition_that_hashes() -> None:
    own = [name for name in typestore().fielddefs if name.startswith("riins_msgs/")]
    assert NAV in own and len(own) >= 13
    assert len({type_hash(name) for name in own}) == len(own)
    with pytest.raises(BagError, match="build or source the workspace"):
        type_hash("nobody_msgs/msg/Nothing")


def test_the_same_messages_give_the_same_bytes(tmp_path: Path) -> None:
    first, second = make_bag(tmp_path / "one" / "bag", 300), make_bag(tmp_path / "two" / "bag", 300)
    assert (first / "bag_0.mcap").read_bytes() == (second / "bag_0.mcap").read_bytes()


def test_empty_and_standard_bags(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "empty"):
        pass
    with BagReader(tmp_path / "empty") as reader:
        assert reader.topics == {} and reader.duration_s == 0.0 and list(reader.messages()) == []
    with AnyReader([tmp_path / "empty"]) as other:
        assert other.message_count == 0
    with BagWriter(tmp_path / "fix") as bag:
        bag.write_message("/gps/fix", FIX, {"latitude": 54.5}, 7)
    with BagReader(tmp_path / "fix" / "fix_0.mcap") as reader:  # one file of a bag, without metadata
        assert next(iter(reader.read()))[2].latitude == 54.5
