"""Rebuilding of bags whose recorder was killed or whose file is damaged.

Lives here: `recover`, which copies every message of every complete chunk into a new bag, and its `RecoveryReport`.
Does not live here: reading of complete bags (reader.py).
"""

from __future__ import annotations

import io
import mmap
import os
import shutil
import struct
from collections import defaultdict
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Metadata, Schema

from riins_bag.chunks import MAGIC, decompress, walk_chunk
from riins_bag.errors import BagError
from riins_bag.files import not_mcap, other_storage
from riins_bag.qos import parse
from riins_bag.typesys import type_hash
from riins_bag.writer import BagWriter

_MESSAGE_HEAD = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time
_CHUNK_HEAD = struct.Struct("<BQQQQI")  # opcode, length, first and last log time, uncompressed size, checksum; then the compression's name


@dataclass
class RecoveryReport:
    """What a recovery found.

    Attributes
    ----------
    source, out : the damaged bag, and the new one (equal when it was replaced)
    complete : the source had its end and no damaged chunk, so that nothing was lost
    counts : messages recovered by topic
    start_ns, end_ns : log times of the first and last recovered message
    chunks, damaged_chunks : chunks copied, chunks that failed their checksum
    unknown_messages : messages whose channel was in a damaged chunk
    lost_bytes : bytes of the file(s) that belong to no complete record
    """

    source: Path
    out: Path
    complete: bool = False
    counts: dict[str, int] = field(default_factory=lambda: defaultdict(int))
    start_ns: int = 0
    end_ns: int = 0
    chunks: int = 0
    damaged_chunks: int = 0
    unknown_messages: int = 0
    lost_bytes: int = 0

    @property
    def message_count(self) -> int:
        """Messages recovered."""
        return sum(self.counts.values())

    @property
    def duration_s(self) -> float:
        """Seconds from the first to the last recovered message."""
        return (self.end_ns - self.start_ns) * 1e-9

    def lines(self) -> list[str]:
        """The report for people."""
        text = [f"recovered {self.message_count} messages, {self.duration_s:.3f} s, of {self.chunks} chunks into {self.out}"]
        text += [f"  {topic}: {count}" for topic, count in sorted(self.counts.items())]
        if self.complete:
            return [*text, "nothing was lost: the source was complete"]
        lost = [f"{self.lost_bytes} bytes that belong to no complete record"] if self.lost_bytes else []
        lost += [f"{self.damaged_chunks} damaged chunks"] if self.damaged_chunks else []
        lost += [f"{self.unknown_messages} messages without a definition"] if self.unknown_messages else []
        return [*text, f"lost: {', '.join(lost) or 'what was not yet written when the recorder stopped'}"]


def recover(path: str | os.PathLike[str], out: str | os.PathLike[str] | None = None, *, replace: bool = False) -> RecoveryReport:
    """Rebuild index and metadata of a bag from its complete chunks.

    Parameters
    ----------
    path : bag directory or .mcap file
    out : new bag directory, which must not exist; None: PATH_recovered
    replace : put the new bag in the place of the source (only for directories; `out` is then not given)

    Returns
    -------
    RecoveryReport

    Raises
    ------
    BagError
        No MCAP file there, nothing in it that can be recovered, `out` exists or cannot be written. The source is never changed then.
    """
    source = Path(path)
    if replace and (out is not None or not source.is_dir()):
        raise BagError("replacing needs a bag directory as source and no other name for the new one")
    files = _files(source)
    target = Path(out) if out is not None else source.with_name(f"{source.name.removesuffix('.mcap')}_recovered")
    if replace:
        target = source.with_name(f"{source.name}.recovering") / source.name
    if target.exists():
        raise BagError(f"{target} exists already; choose another name for the new bag or remove it")
    report = RecoveryReport(source, target)
    try:
        with BagWriter(target, flush_period_s=0.0, chunk_bytes=1024 * 1024) as writer:
            finished = [_copy(file, writer, report) for file in files]
        if not sum(report.counts.values()):
            raise BagError(f"{source} has no complete chunk: nothing can be recovered")
    except BaseException:
        shutil.rmtree(target.parent if replace else target, ignore_errors=True)
        raise
    report.start_ns, report.end_ns = writer.span_ns
    report.complete = all(finished) and not (report.damaged_chunks or report.unknown_messages or report.lost_bytes)
    report.counts = dict(report.counts)
    if replace:
        _replace(source, target)
        report.out = source
    return report


def _files(source: Path) -> list[Path]:
    if not source.exists():
        raise BagError(f"there is no bag at {source}")
    files = [source] if source.is_file() else sorted(source.glob("*.mcap"))
    if not files:
        raise BagError(other_storage(source))
    for file in files:
        with file.open("rb") as stream:
            if stream.read(len(MAGIC)) != MAGIC:
                raise BagError(not_mcap(file))
    return files


def _copy(file: Path, writer: BagWriter, report: RecoveryReport) -> bool:
    """Copy the messages of one file; returns whether it had its proper end."""
    copier = _Copier(writer, report)
    with file.open("rb") as stream:
        size = stream.seek(0, os.SEEK_END)
        places, good, skipped = _places(stream, size)
        # Definitions stand in the chunks and, where the end is there, again behind them: those survive a damaged chunk.
        for opcode, begin, end in places:
            if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                copier.take(opcode, _read(stream, begin, end))
        for opcode, begin, end in places:
            if opcode in (Opcode.CHUNK, Opcode.MESSAGE, Opcode.METADATA):
                copier.take(opcode, _read(stream, begin, end))
        stream.seek(good)
        finished = bool(places) and places[-1][0] == Opcode.FOOTER and stream.read() == MAGIC
    report.lost_bytes += skipped + (0 if finished else size - good)
    return finished


def _places(stream: IO[bytes], size: int) -> tuple[list[tuple[int, int, int]], int, int]:
    """Complete top-level records (opcode, begin, end), the position behind the last of them, and the bytes between that are no records."""
    places: list[tuple[int, int, int]] = []
    position, skipped = len(MAGIC), 0
    while position + 9 <= size and not (places and places[-1][0] == Opcode.FOOTER):
        opcode, length = struct.unpack("<BQ", _read(stream, position, position + 9))
        if opcode == 0 or position + 9 + length > size:
            chunk = _next_chunk(stream, position, size)
            if chunk is None:
                break
            skipped += chunk - position
            position = chunk
            continue
        places.append((opcode, position + 9, position + 9 + length))
        position += 9 + length
    return places, position, skipped


def _next_chunk(stream: IO[bytes], begin: int, size: int) -> int | None:
    """Position of the next complete compressed chunk, known by the name of its compression and by lengths that agree."""
    with mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data:
        for name in (b"zstd", b"lz4"):
            word = struct.pack("<I", len(name)) + name
            found = data.find(word, begin + _CHUNK_HEAD.size)
            while found >= 0:
                position = found - _CHUNK_HEAD.size
                opcode, length, *_ = _CHUNK_HEAD.unpack_from(data, position)
                inner = int.from_bytes(data[found + len(word) : found + len(word) + 8], "little")
                if opcode == Opcode.CHUNK and position + 9 + length <= size and length == _CHUNK_HEAD.size - 9 + len(word) + 8 + inner:
                    return position
                found = data.find(word, found + 1)
    return None


def _read(stream: IO[bytes], begin: int, end: int) -> bytes:
    stream.seek(begin)
    return stream.read(end - begin)


class _Copier:
    """Takes records in file order and writes their messages."""

    def __init__(self, writer: BagWriter, report: RecoveryReport) -> None:
        self.writer, self.report = writer, report
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        self.announced: set[int] = set()

    def take(self, opcode: int, content: bytes) -> None:
        """Take one record: remember a definition, copy metadata, a message or the messages of a chunk."""
        try:
            if opcode == Opcode.CHUNK:
                data = decompress(Chunk.read(ReadDataStream(io.BytesIO(content))))
                places = list(walk_chunk(data))
            elif opcode == Opcode.SCHEMA:
                schema = Schema.read(ReadDataStream(io.BytesIO(content)))
                self.schemas.setdefault(schema.id, schema)
            elif opcode == Opcode.CHANNEL:
                channel = Channel.read(ReadDataStream(io.BytesIO(content)))
                self.channels.setdefault(channel.id, channel)
        except (BagError, McapError, UnicodeDecodeError, struct.error):
            self.report.damaged_chunks += 1
            return
        if opcode == Opcode.MESSAGE:
            self._message(content)
        elif opcode == Opcode.METADATA:
            metadata = Metadata.read(ReadDataStream(io.BytesIO(content)))
            if metadata.name != "rosbag2":  # the writer makes its own
                self.writer.add_metadata(metadata.name, metadata.metadata)
        elif opcode == Opcode.CHUNK:
            self.report.chunks += 1
            for inner, begin, end in places:
                self.take(inner, data[begin:end])

    def _message(self, content: bytes) -> None:
        key, sequence, log_ns, publish_ns = _MESSAGE_HEAD.unpack_from(content)
        channel = self.channels.get(key)
        schema = self.schemas.get(channel.schema_id) if channel else None
        if channel is None or schema is None or channel.message_encoding != "cdr":
            self.report.unknown_messages += 1
            return
        if key not in self.announced:
            self._announce(channel, schema)
        data = content[_MESSAGE_HEAD.size :]
        self.writer.write(channel.topic, schema.name, data, log_ns, publish_ns=publish_ns, sequence=sequence)
        self.report.counts[channel.topic] += 1

    def _announce(self, channel: Channel, schema: Schema) -> None:
        digest = channel.metadata.get("topic_type_hash")
        if digest is None:
            try:
                digest = type_hash(schema.name)
            except BagError:
                digest = ""
        offers = parse(channel.metadata.get("offered_qos_profiles", ""))
        self.writer.add_topic(channel.topic, schema.name, offers, schema=schema.data.decode(), digest=digest, encoding=schema.encoding)
        self.announced.add(channel.id)


def _replace(source: Path, target: Path) -> None:
    aside = source.with_name(f"{source.name}.damaged")
    try:
        source.rename(aside)
        target.rename(source)
        target.parent.rmdir()
        shutil.rmtree(aside)
    except OSError as error:
        raise BagError(f"replacing {source} failed ({error}); the old files are in {aside}, the new ones in {target}") from None
