"""Bags that other recorders wrote: rosbags in each compression mode, mcap without chunks, rosbag2 split into files."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
import yaml
from bag_helpers import RAW, make_bag, raw_fields
from mcap.writer import CompressionType, IndexType, Writer
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Rosbag2Writer

from riins_bag.bag import BagError, BagReader, schema_text, serialize, typestore
from riins_bag.recover import recover


@pytest.mark.parametrize("mode", [CompressionMode.NONE, CompressionMode.STORAGE, CompressionMode.MESSAGE, CompressionMode.FILE])
def test_bags_of_rosbags(tmp_path: Path, mode: CompressionMode) -> None:
    writer = Rosbag2Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP)
    writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        raw = writer.add_connection("/rimu/raw", RAW, typestore=typestore())
        for k in range(300):
            writer.write(raw, k, serialize(RAW, raw_fields(k)))
    if mode == CompressionMode.FILE:
        with pytest.raises(BagError, match=r"zstd -d|no \.mcap"):
            BagReader(tmp_path / "bag")
        return
    with BagReader(tmp_path / "bag") as bag:
        assert bag.topics == {"/rimu/raw": (RAW, 300)}
        assert [m.sequence for _, _, m in bag.read()] == bag.columns("/rimu/raw", ["sequence"])["sequence"].tolist() == list(range(300))


@pytest.mark.parametrize("compression", [CompressionType.NONE, CompressionType.ZSTD])
@pytest.mark.parametrize("index", [IndexType.ALL, IndexType.CHUNK])
def test_files_of_mcap(tmp_path: Path, compression: CompressionType, index: IndexType) -> None:
    file = tmp_path / "other.mcap"
    with file.open("wb") as stream:
        _write(Writer(stream, chunk_size=5000, compression=compression, index_types=index))
    with BagReader(file) as bag:
        assert [m.sequence for _, _, m in bag.read()] == list(range(300))
        np.testing.assert_array_equal(bag.columns("/rimu/raw")["gyro"][:, 0], np.arange(300))
        assert bag.span_ns("/rimu/raw") == (0, 299) and bag.qos("/rimu/raw") == ()


def test_a_file_without_chunks_is_rebuilt(tmp_path: Path) -> None:
    file = tmp_path / "plain.mcap"
    with file.open("wb") as stream:
        _write(Writer(stream, use_chunking=False))
    with pytest.raises(BagError, match=r"has no index.*riins bag recover"):
        BagReader(file)
    report = recover(file)
    assert report.complete and report.out == tmp_path / "plain_recovered"
    with BagReader(report.out) as bag:
        assert [m.sequence for _, _, m in bag.read()] == list(range(300))


def test_another_encoding_is_refused(tmp_path: Path) -> None:
    with (tmp_path / "web.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        writer.add_message(writer.register_channel("/web", "json", writer.register_schema("Web", "jsonschema", b"{}")), 1, b"{}", 1)
        writer.finish()
    with pytest.raises(BagError, match=r"/web .* encoded as 'json'"):
        BagReader(tmp_path / "web.mcap")


def test_a_bag_in_several_files_is_one(tmp_path: Path) -> None:
    first = make_bag(tmp_path / "bag", 200)
    second = make_bag(tmp_path / "more", 400)
    shutil.move(second / "more_0.mcap", first / "bag_1.mcap")
    metadata = yaml.safe_load((first / "metadata.yaml").read_text())
    metadata["rosbag2_bagfile_information"]["relative_file_paths"].append("bag_1.mcap")
    (first / "metadata.yaml").write_text(yaml.safe_dump(metadata))
    with BagReader(first) as bag:
        assert bag.topics["/rimu/raw"].number == 600 and bag.message_count == 200 + 400 + 2 + 4 + 6 + 12 + 2
        sequence = [m.sequence for _, _, m in bag.read(["/rimu/raw"])]
        assert sequence == sorted([*range(1, 201), *range(1, 401)]) == bag.columns("/rimu/raw")["sequence"].tolist()
    assert recover(first).complete


def _write(writer: Writer) -> None:
    writer.start("ros2")
    schema = writer.register_schema(RAW, "ros2msg", schema_text(RAW).encode())
    channel = writer.register_channel("/rimu/raw", "cdr", schema)
    for k in range(300):
        writer.add_message(channel, k, serialize(RAW, raw_fields(k)), k)
    writer.finish()
