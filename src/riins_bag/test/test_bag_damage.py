"""Bags that are missing, foreign, cut off or damaged, and what recovery gets back."""

from __future__ import annotations

import errno
import hashlib
import struct
import time
from pathlib import Path

import pytest
from bag_helpers import DT_NS, EPOCH_NS, RAW, fill_bag, make_bag, raw_fields
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.records import Chunk
from mcap.stream_reader import StreamReader
from rosbags.highlevel import AnyReader

from riins_bag.bag import BagError, BagReader, BagWriter
from riins_bag.chunks import MAGIC
from riins_bag.info import describe
from riins_bag.recover import recover


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    return (make_bag(tmp_path_factory.mktemp("whole") / "bag", 2000) / "bag_0.mcap").read_bytes()


def cut(path: Path, content: bytes) -> Path:
    path.mkdir(parents=True)
    (path / "bag_0.mcap").write_bytes(content)
    return path


@pytest.fixture(scope="module")
def chunk_ends(whole: bytes, tmp_path_factory: pytest.TempPathFactory) -> list[tuple[int, int]]:
    """Position behind each chunk record and raw samples up to there."""
    folder = tmp_path_factory.mktemp("ends")
    (folder / "x.mcap").write_bytes(whole)
    ends, samples = [], 0
    with (folder / "x.mcap").open("rb") as stream:
        for record in StreamReader(stream, emit_chunks=True).records:
            if isinstance(record, Chunk):
                with BagReader(folder / "x.mcap") as bag:
                    samples = len(bag.columns("/rimu/raw", ["sequence"], 0, record.message_end_time + 1)["sequence"])
                ends.append((stream.tell(), samples))
    return ends


def test_missing_foreign_and_empty(tmp_path: Path) -> None:
    with pytest.raises(BagError, match="no bag at"):
        BagReader(tmp_path / "nothing")
    with pytest.raises(BagError, match=r"no .mcap file in it"):
        BagReader(tmp_path)
    text = tmp_path / "notes.mcap"
    text.write_text("this is not a recording at all")
    for call in (BagReader, recover, describe):
        with pytest.raises(BagError, match="not an MCAP file"):
            call(text)
    (tmp_path / "old").mkdir()
    (tmp_path / "old" / "old_0.db3").write_bytes(b"SQLite format 3\0")
    for call in (BagReader, recover):
        for old in (tmp_path / "old", tmp_path / "old" / "old_0.db3"):
            with pytest.raises(BagError, match=f"{tmp_path / 'old'} is a sqlite3 bag; .*rosbags-convert"):
                call(old)
    lacking = make_bag(tmp_path / "lacking", 10)
    (lacking / "lacking_0.mcap").unlink()
    with pytest.raises(BagError, match=r"lacking_0.mcap"):
        BagReader(lacking)


def test_metadata_may_be_missing_or_broken(tmp_path: Path) -> None:
    bag = make_bag(tmp_path / "bag", 100)
    for spoil in ("not: [yaml", "other: 1", "rosbag2_bagfile_information: {version: 9, relative_file_paths: 7}"):
        (bag / "metadata.yaml").write_text(spoil)
        with BagReader(bag) as reader:
            assert reader.topics["/rimu/raw"] == (RAW, 100) and reader.metadata == {}
        assert not describe(bag).complete and "  metadata.yaml is damaged: `riins bag recover` makes one" in describe(bag).lines()
    (bag / "metadata.yaml").unlink()
    assert not describe(bag).complete and "  metadata.yaml is missing: `riins bag recover` makes one" in describe(bag).lines()


@pytest.mark.parametrize("spoil", ["zeros", "opcode", "times", "offsets", "length"])
def test_damaged_message_index_names_the_cure(tmp_path: Path, whole: bytes, spoil: str) -> None:
    at, number = samples_index(whole)
    first = at + 15  # entry: log time, offset
    place, new = {
        "zeros": (slice(at, first + 16 * number), bytes(15 + 16 * number)),
        "opcode": (slice(at, at + 1), b"\x08"),
        "times": (slice(first, first + 8), bytes(8)),
        "offsets": (slice(first + 8, first + 16), b"\xff" * 8),
        "length": (slice(first - 4, first), struct.pack("<I", 17)),
    }[spoil]
    content = bytearray(whole)
    content[place] = new
    bag = cut(tmp_path / "bag", bytes(content))
    with pytest.raises(BagError, match=f"damaged message index.*riins bag recover {bag}"):
        describe(bag)
    assert recover(bag, tmp_path / "again").complete == (spoil != "zeros")
    with BagReader(tmp_path / "again") as reader:
        assert reader.columns("/rimu/raw", ["sequence"])["sequence"].tolist() == list(range(1, 2001))


def samples_index(content: bytes) -> tuple[int, int]:
    """Where the first message index with samples is, and how many entries it has."""
    position = len(MAGIC)
    while True:
        opcode, length = struct.unpack_from("<BQ", content, position)
        channel, size = struct.unpack_from("<HI", content, position + 9)
        if opcode == 7 and channel == 2 and size > 160:
            return position, size // 16
        position += 9 + length


@settings(max_examples=25, deadline=None)
@given(share=st.floats(0.0, 0.9999))
def test_a_cut_bag_says_recover_and_gives_back_every_complete_chunk(
    whole: bytes, chunk_ends: list[tuple[int, int]], tmp_path_factory: pytest.TempPathFactory, share: float
) -> None:
    folder = tmp_path_factory.mktemp("cut")
    size = int(share * len(whole))
    bag = cut(folder / "bag", whole[:size])
    with pytest.raises(BagError, match="riins bag recover" if size > 8 else "MCAP|recover"):
        BagReader(bag)
    expected = max([samples for end, samples in chunk_ends if end <= size], default=0)
    if not expected:
        with pytest.raises(BagError, match=r"nothing can be recovered|not an MCAP"):
            recover(bag)
        assert not (folder / "bag_recovered").exists()
        return
    report = recover(bag)
    assert not report.complete and report.counts["/rimu/raw"] == expected and (bag / "bag_0.mcap").read_bytes() == whole[:size]
    with BagReader(report.out) as got:
        assert [m.sequence for _, _, m in got.read(["/rimu/raw"])] == list(range(1, expected + 1))
        assert got.configuration() == "scenario: {name: test}\n"
    assert "lost" in report.lines()[-1]


def test_recovered_bag_is_as_good_as_the_original(tmp_path: Path) -> None:
    bag = make_bag(tmp_path / "bag", 600)
    report = recover(bag, tmp_path / "copy")
    assert report.complete and report.message_count == 600 + 6 + 18 + 1 and report.duration_s == pytest.approx(6.0)
    with BagReader(bag) as a, BagReader(tmp_path / "copy") as b:
        assert list(a.messages()) == list(b.messages()) and a.topics == b.topics
        assert {t: a.qos(t) for t in a.topics} == {t: b.qos(t) for t in b.topics}
        assert {s.name: s.data for s in a.schemas().values()} == {s.name: s.data for s in b.schemas().values()}
        assert {c.topic: c.metadata for c in a.channels().values()} == {c.topic: c.metadata for c in b.channels().values()}
    with AnyReader([tmp_path / "copy"]) as other:
        assert other.message_count == report.message_count


def test_recovery_never_overwrites_unless_asked(tmp_path: Path, whole: bytes) -> None:
    bag = cut(tmp_path / "bag", whole[: len(whole) // 2])
    before = hashlib.sha256((bag / "bag_0.mcap").read_bytes()).digest()
    recover(bag)
    for target in (None, bag, tmp_path / "bag_recovered"):
        with pytest.raises(BagError, match="exists already"):
            recover(bag, target)
    assert hashlib.sha256((bag / "bag_0.mcap").read_bytes()).digest() == before
    with pytest.raises(BagError, match="replacing"):
        recover(bag, tmp_path / "x", replace=True)
    report = recover(bag, replace=True)
    assert report.out == bag and sorted(p.name for p in tmp_path.iterdir()) == ["bag", "bag_recovered"]
    assert describe(bag).complete and sorted(p.name for p in bag.iterdir()) == ["bag_0.mcap", "metadata.yaml"]


def test_a_damaged_chunk_costs_only_itself(tmp_path: Path) -> None:
    bag = make_bag(tmp_path / "bag", 2000)
    with BagReader(bag) as reader:
        index = reader._files[0].indexes[5]
        inside = len(reader.columns("/rimu/raw", ["sequence"], index.message_start_time, index.message_end_time + 1)["sequence"])
    content = bytearray((bag / "bag_0.mcap").read_bytes())
    content[index.chunk_start_offset + index.chunk_length // 2] ^= 0x55
    (bag / "bag_0.mcap").write_bytes(content)
    with BagReader(bag) as reader, pytest.raises(BagError, match=r"damaged at byte \d+ .*riins bag recover"):
        list(reader.messages())
    report = recover(bag)
    assert report.damaged_chunks == 1 and not report.complete and "1 damaged chunks" in report.lines()[-1]
    assert 2000 - inside <= report.counts["/rimu/raw"] < 2000


def test_definitions_lost_with_the_first_chunk_are_found_in_the_summary(tmp_path: Path) -> None:
    bag = make_bag(tmp_path / "bag", 1000)
    with BagReader(bag) as reader:
        index = min(reader._files[0].indexes, key=lambda i: i.chunk_start_offset)
    content = bytearray((bag / "bag_0.mcap").read_bytes())
    content[index.chunk_start_offset + 200] ^= 0x55
    (bag / "bag_0.mcap").write_bytes(content)
    report = recover(bag)
    assert report.damaged_chunks == 1 and report.unknown_messages == 0 and report.counts["/rimu/raw"] > 900


def test_what_was_flushed_survives_and_time_flushes(tmp_path: Path) -> None:
    bag = BagWriter(tmp_path / "bag", flush_period_s=0.05)
    for k in range(1, 21):
        bag.write_message("/rimu/raw", RAW, raw_fields(k), EPOCH_NS + k * DT_NS)
        time.sleep(0.01)
    bag.flush()
    bag.write_message("/rimu/raw", RAW, raw_fields(21), EPOCH_NS + 21 * DT_NS)  # in memory only
    report = recover(tmp_path / "bag")  # as after kill -9: nothing was closed
    assert report.counts == {"/rimu/raw": 20} and report.chunks >= 3
    bag.close()
    with BagReader(tmp_path / "bag") as reader:
        assert reader.topics["/rimu/raw"].number == 21


def test_a_full_disk_is_one_clear_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bag = BagWriter(tmp_path / "bag", chunk_bytes=4096)
    fill_bag(bag, 300)

    def full(data: bytes) -> int:
        raise OSError(errno.ENOSPC, "No space left on device")

    class Full:
        write = staticmethod(full)
        close = bag._stream.close
        flush = bag._stream.flush

    monkeypatch.setattr(bag._writer, "stream", Full())
    with pytest.raises(BagError, match=r"No space left on device.*riins bag recover"):
        fill_bag(bag, 300)
    assert recover(tmp_path / "bag").counts["/rimu/raw"] > 250


def test_describe_counts_gaps_and_restarts(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as bag:
        for place, k in enumerate([*range(1, 51), *range(61, 101), *range(103, 121), *range(5, 25)]):
            bag.write_message("/rimu/raw", RAW, raw_fields(k), EPOCH_NS + place * DT_NS)
    info = describe(tmp_path / "bag")
    gaps = info.imu[0]
    assert (gaps.received, gaps.lost, gaps.gaps, gaps.largest, gaps.restarts) == (128, 12, 2, 10, 1)
    assert gaps.largest_at_s == pytest.approx(0.49) and not info.self_contained and info.complete
    topic = info.topics[0]
    assert topic.count == 128 and topic.rate_hz == pytest.approx(100.0) and (topic.reliability, topic.durability) == ("reliable", "volatile")
    assert info.as_mapping()["imu"][0]["lost"] == 12 and "12 lost in 2 gaps" in "\n".join(info.lines())
