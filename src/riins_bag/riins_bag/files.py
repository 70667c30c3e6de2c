"""The .mcap files of a bag: which they are, their summaries, their chunks.

Lives here: `locate` (files and metadata of a path), `McapFile` (summary, cached chunks, message indexes).
Does not live here: merging of files and topics (reader.py), files without an end (recover.py).
"""

from __future__ import annotations

import os
from collections import OrderedDict
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.records import Chunk, ChunkIndex
from mcap.summary import Summary
from numpy.typing import NDArray

from riins_bag.chunks import INDEX_DTYPE, MAGIC, MESSAGE, decompress, walk_chunk
from riins_bag.errors import BagError

CACHE_BYTES = 32 * 1024 * 1024  # of uncompressed chunks kept by each file
_SQLITE = b"SQLite format 3\0"
_INDEX_PREFIX = 9 + 2 + 4  # opcode, length, channel, bytes of the entries


def locate(path: Path) -> tuple[list[Path], dict[str, Any]]:
    """Files of a bag and the bagfile information of its metadata.yaml ({} when that is missing or unreadable).

    Raises
    ------
    BagError
        Nothing there, another storage format, a file that the metadata names is missing.
    """
    if not path.exists():
        raise BagError(f"there is no bag at {path}")
    if path.is_file():
        return [path], {}
    information: dict[str, Any] = {}
    yaml_file = path / "metadata.yaml"
    if yaml_file.is_file():
        try:
            information = dict(yaml.safe_load(yaml_file.read_text(encoding="utf-8"))["rosbag2_bagfile_information"])
            information["relative_file_paths"] = [str(name) for name in information["relative_file_paths"]]
        except (OSError, UnicodeDecodeError, yaml.YAMLError, KeyError, TypeError, ValueError):
            information = {}  # the .mcap has all that is needed
    found = sorted(path.glob("*.mcap"))
    if information.get("storage_identifier", "mcap") != "mcap":
        raise BagError(_sqlite(path))
    if str(information.get("compression_mode", "")).lower() == "file":
        raise BagError(f"{path} has files compressed as a whole; unpack them with `zstd -d` and `ros2 bag reindex`")
    listed = [path / Path(name).name for name in information.get("relative_file_paths", [])]
    missing = [file.name for file in listed if not file.is_file()]
    if missing:
        raise BagError(f"{path} lacks {', '.join(missing)}, which its metadata.yaml names")
    if not (listed or found):
        raise BagError(other_storage(path))
    return listed or found, information


def other_storage(path: Path) -> str:
    """One line about a directory without .mcap files: a sqlite3 bag and what to do with it, or no bag."""
    return _sqlite(path) if list(path.glob("*.db3")) else f"{path} is not a bag: there is no .mcap file in it"


def not_mcap(path: Path) -> str:
    """One line about a file that does not begin as MCAP does."""
    with path.open("rb") as stream:
        sqlite = stream.read(len(_SQLITE)) == _SQLITE
    return f"{path} is not an MCAP file" + (f"; {_sqlite(path.parent)}" if sqlite else "")


def _sqlite(path: Path) -> str:
    return f"{path} is a sqlite3 bag; make an MCAP of it: rosbags-convert --src {path} --dst NEW --dst-storage mcap"


class McapFile:
    """One complete and indexed .mcap file.

    Parameters
    ----------
    path : the file
    bag : the bag it belongs to, for messages

    Attributes
    ----------
    indexes : chunk indexes by start time; starts, ends : their log times, (chunks,) uint64

    Raises
    ------
    BagError
        Not MCAP, cut off, or without index; the text says what to do.
    """

    def __init__(self, path: Path, bag: Path) -> None:
        self.path, self.bag = path, bag
        try:
            self.stream = path.open("rb")
        except OSError as error:
            raise BagError(f"cannot read {path}: {error.strerror or error}") from None
        try:
            self.summary = self._read_summary()
        except BaseException:
            self.stream.close()
            raise
        self.indexes = sorted(self.summary.chunk_indexes, key=lambda index: (index.message_start_time, index.chunk_start_offset))
        self.starts = np.array([index.message_start_time for index in self.indexes], np.uint64)
        self.ends = np.array([index.message_end_time for index in self.indexes], np.uint64)
        self._cache: OrderedDict[int, bytes] = OrderedDict()
        self._cached = 0

    def metadata_records(self) -> list[tuple[str, dict[str, str]]]:
        """MCAP metadata records in file order: (name, entries)."""
        self.stream.seek(0)
        return [(record.name, record.metadata) for record in SeekingReader(self.stream).iter_metadata()]

    def load(self, index: ChunkIndex) -> bytes:
        """Uncompressed records of a chunk."""
        key = index.chunk_start_offset
        if key in self._cache:
            self._cache.move_to_end(key)
            return self._cache[key]
        self.stream.seek(index.chunk_start_offset + 9)
        try:
            data = decompress(Chunk.read(ReadDataStream(self.stream)))
        except (BagError, McapError, UnicodeDecodeError) as error:
            reason = str(error) or type(error).__name__
            raise BagError(f"{self.path} is damaged at byte {index.chunk_start_offset} ({reason}): run `riins bag recover {self.bag}`") from None
        self._cache[key] = data
        self._cached += len(data)
        while self._cached > CACHE_BYTES and len(self._cache) > 1:
            self._cached -= len(self._cache.popitem(last=False)[1])
        return data

    def entries(self, index: ChunkIndex, key: int, data: NDArray[np.uint8]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Log times and offsets of one channel's messages in a chunk, from the message index or, without one, by walking."""
        offset = index.message_index_offsets.get(key)
        if offset is not None:
            entries = self._index_entries(offset, index, key, data)
        elif index.message_index_offsets:
            entries = np.empty(0, INDEX_DTYPE)
        else:
            raw = data.tobytes()
            heads = [(MESSAGE.unpack_from(raw, first - 9), first - 9) for opcode, first, _ in walk_chunk(raw) if opcode == Opcode.MESSAGE]
            entries = np.array([(head[4], at) for head, at in heads if head[2] == key], INDEX_DTYPE)
        return entries["log_time"].astype(np.int64), entries["offset"].astype(np.int64)

    def _index_entries(self, offset: int, index: ChunkIndex, key: int, data: NDArray[np.uint8]) -> NDArray[Any]:
        """One MessageIndex record, which has no checksum: its entries must lie in the chunk's time and, where `data` is given, on messages."""
        self.stream.seek(offset)
        head = self.stream.read(_INDEX_PREFIX)
        body = self.stream.read(int.from_bytes(head[11:15], "little"))
        good = head[:1] == Opcode.MESSAGE_INDEX.to_bytes() and int.from_bytes(head[9:11], "little") == key and not len(body) % INDEX_DTYPE.itemsize
        entries = np.frombuffer(body if good else b"", INDEX_DTYPE)
        good = good and bool(np.all((entries["log_time"] >= index.message_start_time) & (entries["log_time"] <= index.message_end_time)))
        if good and len(data) and len(entries):
            at = entries["offset"].astype(np.int64)
            inside = at.min() >= 0 and at.max() + MESSAGE.size <= len(data)
            good = bool(inside and np.all(data[at] == Opcode.MESSAGE) and np.all(data[at + 9] == key & 255))
        if not good:
            raise BagError(f"{self.path} has a damaged message index at byte {offset}: run `riins bag recover {self.bag}`")
        return entries

    def _read_summary(self) -> Summary:
        stream, path = self.stream, self.path
        size = stream.seek(0, os.SEEK_END)
        stream.seek(0)
        if stream.read(len(MAGIC)) != MAGIC[:size]:
            raise BagError(not_mcap(path))
        cut = BagError(f"{path} is not complete (its recorder was killed, or the file was cut off): run `riins bag recover {self.bag}`")
        if size < 2 * len(MAGIC):
            raise cut
        stream.seek(-len(MAGIC), os.SEEK_END)
        if stream.read(len(MAGIC)) != MAGIC:
            raise cut
        stream.seek(0)
        try:
            summary = SeekingReader(stream).get_summary()
        except (McapError, ValueError, OSError) as error:
            reason = str(error) or type(error).__name__
            raise BagError(f"{path} has a damaged index ({reason}): run `riins bag recover {self.bag}`") from None
        if summary is None or (summary.statistics and summary.statistics.message_count and not summary.chunk_indexes):
            raise BagError(f"{path} has no index: run `riins bag recover {self.bag}`, which makes one")
        return summary
