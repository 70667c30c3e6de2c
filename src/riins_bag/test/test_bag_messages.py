"""Messages in and out: one by one, in blocks, as columns; what is refused."""

from __future__ import annotations

import itertools
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from bag_helpers import DT_NS, EPOCH_NS, EVENT, NAV, RAW, innovation_fields, make_bag, raw_fields
from hypothesis import given, settings
from hypothesis import strategies as st

from riins_bag.bag import BagError, BagReader, BagWriter, deserialize, message, serialize, typestore
from riins_bag.cdr import Unpacker, pack
from riins_bag.excerpt import excerpt

FUSED = "riins_msgs/msg/FusedImu"


@settings(max_examples=30, deadline=None)
@given(n=st.integers(0, 9), m=st.integers(1, 20), frame=st.text("abc_é/", max_size=9), first=st.integers(0, 2**32 - 30))
def test_a_block_is_the_same_bytes_as_its_messages(n: int, m: int, frame: str, first: int) -> None:
    rng = np.random.default_rng(n * 100 + m)
    stamps, gyro = EPOCH_NS + DT_NS * np.arange(m), rng.standard_normal((m, n))
    common = {"accel": np.arange(float(n)), "gyro_valid": 2**63 + 5}
    block = {"header": {"stamp": stamps, "frame_id": frame}, "sequence": first + np.arange(m), "gyro": gyro, **common}
    rows = pack(typestore(), RAW, block, m)
    for k in range(m):
        one = {"header": {"stamp": int(stamps[k]), "frame_id": frame}, "sequence": first + k, "gyro": gyro[k], **common}
        assert rows[k].tobytes() == serialize(RAW, one)


def test_nested_messages_and_arrays_in_blocks() -> None:
    m, rng = 7, np.random.default_rng(1)
    rate, covariance = rng.standard_normal((m, 3)), rng.standard_normal((m, 9))
    rows = pack(typestore(), FUSED, {"angular_velocity": rate, "linear_acceleration": {"z": 9.8}, "angular_velocity_covariance": covariance}, m)
    for k in range(m):
        x, y, z = rate[k]
        one = {"angular_velocity": {"x": x, "y": y, "z": z}, "linear_acceleration": {"z": 9.8}, "angular_velocity_covariance": covariance[k]}
        assert rows[k].tobytes() == serialize(FUSED, one)


def test_bag_of_blocks_equals_bag_of_messages(tmp_path: Path) -> None:
    m = 1500
    k = np.arange(1, m + 1)
    stamps = EPOCH_NS + DT_NS * k
    fields = {"sequence": k, "gyro": k[:, None] + np.arange(6) / 16.0, "accel": -k[:, None] - np.arange(6) / 16.0, "gyro_valid": 63}
    with BagWriter(tmp_path / "blocks", flush_period_s=0.0) as bag:
        for begin in range(0, m, 400):
            part = {name: value[begin : begin + 400] if np.ndim(value) else value for name, value in fields.items()}
            bag.write_block("/rimu/raw", RAW, stamps[begin : begin + 400], part | {"accel_valid": 2**64 - 1}, frame_id="imu_link")
    one_by_one = make_bag(tmp_path / "single", m)
    with BagReader(tmp_path / "blocks") as blocks, BagReader(one_by_one) as single:
        assert [m.data for m in blocks.messages()] == [m.data for m in single.messages(["/rimu/raw"])]
        assert blocks.channels()["/rimu/raw"] == single.channels()["/rimu/raw"].__class__(
            **(vars(single.channels()["/rimu/raw"]) | {"id": 1, "schema_id": 1})
        )


def test_columns_equal_the_messages(tmp_path: Path) -> None:
    with BagReader(make_bag(tmp_path / "bag", 1000)) as bag:
        columns = bag.columns("/rimu/raw")
        assert columns["log_time"].tolist() == columns["header.stamp"].tolist() == [EPOCH_NS + k * DT_NS for k in range(1, 1001)]
        assert "header.frame_id" not in columns and set(columns["gyro.count"]) == {6}
        for k, (_, _, msg) in zip((0, 500, 999), [list(bag.read(["/rimu/raw"]))[i] for i in (0, 500, 999)], strict=True):
            np.testing.assert_array_equal(columns["gyro"][k], msg.gyro)
            assert columns["sequence"][k] == msg.sequence and columns["accel_valid"][k] == 2**64 - 1
        assert set(bag.columns("/rimu/raw", ["sequence"])) == {"log_time", "sequence"}


def test_columns_of_messages_with_different_lengths(tmp_path: Path) -> None:
    with BagReader(make_bag(tmp_path / "bag", 300)) as bag:
        columns = bag.columns("/nav/innovations", ["header", "subfilter", "innovation", "accepted"])
    assert columns["subfilter"].tolist() == ["gps", "height", "doppler"] * 3  # equal log times keep the order written
    assert columns["header.frame_id"].tolist() == ["map_ned"] * 9 and columns["accepted"].all()
    assert columns["innovation.count"].tolist() == [3, 1, 3] * 3
    np.testing.assert_array_equal(columns["innovation"][1], [100.0, np.nan, np.nan])
    np.testing.assert_array_equal(columns["innovation"][8], [300.0, 301.0, 302.0])


def test_windows_cover_everything_once(tmp_path: Path) -> None:
    with BagReader(make_bag(tmp_path / "bag", 1000)) as bag:
        whole = list(bag.messages())
        edges = [EPOCH_NS + DT_NS * k for k in (0, 1, 137, 138, 600, 1001)]
        parts = [message for a, b in itertools.pairwise(edges) for message in bag.messages(start_ns=a, stop_ns=b)]
        assert parts == whole and len(whole) == 1000 + 10 + 30 + 1
        pieces = [bag.columns("/rimu/raw", ["sequence"], a, b)["sequence"] for a, b in itertools.pairwise(edges)]
        assert [len(piece) for piece in pieces] == [0, 136, 1, 462, 401]
        np.testing.assert_array_equal(np.concatenate(pieces), np.arange(1, 1001))
        empty = bag.columns("/rimu/raw", None, 5, 6)
        assert set(empty) == set(bag.columns("/rimu/raw")) and all(len(column) == 0 for column in empty.values())


def test_messages_written_out_of_order_come_in_log_time_order(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    times = np.repeat(rng.permutation(800), 2)[:1200]
    with BagWriter(tmp_path / "bag", chunk_bytes=2000, flush_period_s=0.0) as bag:
        for k, t in enumerate(times):
            bag.write_message("/rimu/raw", RAW, raw_fields(k), int(t))
    with BagReader(tmp_path / "bag") as reader:
        order = np.argsort(times, kind="stable")
        assert [m.sequence for _, _, m in reader.read()] == order.tolist()
        assert reader.columns("/rimu/raw")["sequence"].tolist() == order.tolist()


def test_a_bag_is_read_by_its_own_definitions(tmp_path: Path) -> None:
    old = "uint32 sequence\nfloat64[] gyro\nstring remark\n"  # as if RedundantImu had been that once
    with BagWriter(tmp_path / "old") as bag:
        bag.add_topic("/rimu/raw", RAW, schema=old, digest="RIHS01_" + "0" * 64)
        bag.write("/rimu/raw", RAW, b"\0\1\0\0" + np.array([7, 0], "<u4").tobytes() + b"\3\0\0\0hi\0", 5)
    with BagReader(tmp_path / "old") as reader:
        msg = next(iter(reader.read()))[2]
        assert (msg.sequence, msg.remark, len(msg.gyro)) == (7, "hi", 0)
        assert reader.columns("/rimu/raw", ["sequence"])["sequence"].tolist() == [7]
    assert len(typestore().fielddefs[RAW][1]) == 6  # the installed definition is untouched


def test_message_takes_mappings_objects_and_defaults() -> None:
    other = SimpleNamespace(
        header=SimpleNamespace(stamp=SimpleNamespace(sec=3, nanosec=4), frame_id="f"), sequence=9, gyro=[1, 2], accel=(), accel_valid=1
    )
    msg = message(RAW, other)
    assert (msg.header.stamp.sec, msg.header.stamp.nanosec, msg.header.frame_id, msg.sequence, msg.gyro_valid) == (3, 4, "f", 9, 0)
    assert msg.gyro.dtype == np.float64 and message(RAW, msg) is msg
    again = deserialize(RAW, serialize(RAW, other))
    assert again.gyro.tolist() == [1.0, 2.0] and again.accel_valid == 1
    status = message("riins_msgs/msg/FederatedStatus", {"subfilters": [{"name": "gps", "beta": 0.5}, {}]})
    assert deserialize("riins_msgs/msg/FederatedStatus", serialize("riins_msgs/msg/FederatedStatus", status)).subfilters[0].beta == 0.5
    assert message(NAV, {}).latitude == 0.0 and len(message(FUSED, {}).angular_velocity_covariance) == 9


@pytest.mark.parametrize(
    ("fields", "words"),
    [({"gyros": []}, "no field gyros"), ({"gyro": ["x"]}, "RedundantImu"), ({"sequence": -1}, "RedundantImu"), ({"sequence": "a"}, "RedundantImu")],
)
def test_wrong_fields_are_named(fields: dict, words: str) -> None:
    with pytest.raises(BagError, match=words):
        serialize(RAW, fields)


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"gyros": 1}, "no field gyros"),
        ({"gyro": np.zeros((4, 6))}, "gyro must have shape"),
        ({"sequence": np.zeros((3, 1))}, "sequence must have shape"),
        ({"header": {"frame_id": np.zeros(3)}}, "one text for the whole block"),
        ({"header": 5.0}, "header is a std_msgs/msg/Header"),
    ],
)
def test_wrong_blocks_are_named(fields: dict, words: str) -> None:
    with pytest.raises(BagError, match=words):
        pack(typestore(), RAW, fields, 3)


def test_malformed_cdr_is_an_error_not_nonsense() -> None:
    data = serialize(RAW, raw_fields(1))
    for bad in (data[:-9], data[:40], b"\0\0" + data[2:], data + b"\0" * 8):
        with pytest.raises(BagError):
            Unpacker(typestore(), RAW).feed(np.frombuffer(bad, np.uint8)[None, :])
    with pytest.raises(BagError, match="malformed"):
        deserialize(RAW, data[:40])


def test_writer_refusals(tmp_path: Path) -> None:
    (tmp_path / "there").mkdir()
    with pytest.raises(BagError, match="exists already"):
        BagWriter(tmp_path / "there")
    (tmp_path / "file").write_text("")
    with pytest.raises(BagError, match="cannot write"):
        BagWriter(tmp_path / "file" / "bag")
    with BagWriter(tmp_path / "bag") as bag:
        bag.write_message("/a", EVENT, innovation_fields(1, "gps"), 1)
        with pytest.raises(BagError, match="is riins_msgs/msg/Innovation in this bag"):
            bag.write_message("/a", RAW, {}, 2)
        with pytest.raises(BagError, match="before 1970"):
            bag.write_message("/a", EVENT, {}, -1)
        with pytest.raises(BagError, match="no QoS profile is named"):
            bag.write_message("/b", EVENT, {}, 3, "quick")
    with pytest.raises(BagError, match="closed"):
        bag.write_message("/a", EVENT, {}, 3)


def test_excerpt_keeps_every_command_given_before_it(tmp_path: Path) -> None:
    second = 1_000_000_000
    with BagWriter(tmp_path / "bag", flush_period_s=0.0) as writer:
        for k in range(10):
            writer.write_message("/gps/fix", "sensor_msgs/msg/NavSatFix", {"header": {"stamp": EPOCH_NS + k * second}}, EPOCH_NS + k * second)
        for k, target in ((1, "gyro_1"), (2, "gps"), (7, "bds"), (9, "doppler")):
            command = {"header": {"stamp": EPOCH_NS + k * second}, "target": target}
            writer.write_message("/nav/commands", "riins_msgs/msg/SensorUse", command, EPOCH_NS + k * second)
    excerpt(tmp_path / "bag", tmp_path / "part", start_s=5.0, stop_s=8.0)
    with BagReader(tmp_path / "part") as part:
        assert [(m.target, m.use) for _, _, m in part.read(["/nav/commands"])] == [("gyro_1", False), ("gps", False), ("bds", False)]
        assert part.topics["/gps/fix"].number == 3


def test_excerpt_keeps_bytes_times_and_what_was_latched(tmp_path: Path) -> None:
    bag = make_bag(tmp_path / "bag", 1000)
    assert excerpt(bag, tmp_path / "part", ["/rimu/*", "/riins/configuration"], 2.0, 5.0) == 301
    with BagReader(bag) as whole, BagReader(tmp_path / "part") as part:
        assert part.configuration() == whole.configuration() and set(part.topics) == {"/rimu/raw", "/riins/configuration"}
        inside = list(whole.messages(["/rimu/raw"], EPOCH_NS + 200 * DT_NS, EPOCH_NS + 500 * DT_NS))
        assert list(part.messages(["/rimu/raw"])) == inside and part.qos("/rimu/raw") == whole.qos("/rimu/raw")
    with pytest.raises(BagError, match="has none of /nothing; it has /gps/fix"):
        excerpt(bag, tmp_path / "none", ["/nothing"])
