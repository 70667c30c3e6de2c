"""Reading of bags: messages in log-time order, deserialized messages, whole topics as columns.

Lives here: `BagReader`, tolerant of a missing metadata.yaml, strict with everything else.
Does not live here: chunks and their caching (files.py), unfinished files (recover.py), summaries for people (info.py).
"""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Collection, Iterator
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple

import numpy as np
import zstandard
from mcap.opcode import Opcode
from mcap.records import Channel, ChunkIndex, Schema
from numpy.typing import NDArray
from rosbags.typesys.store import Typestore

from riins_bag.cdr import Unpacker, layout
from riins_bag.chunks import MESSAGE, walk_chunk
from riins_bag.errors import BagError
from riins_bag.files import McapFile, locate
from riins_bag.qos import Qos, parse
from riins_bag.typesys import deserialize, store_of_schemas, type_hash, typestore
from riins_bag.writer import CONFIGURATION_TOPIC

FOREVER_NS = 2**63 - 1
RUN_TOPICS = ("/rimu/raw", "/imu/fused", "/nav/initial_state", "/nav/settled")
"""A recording that has one of them holds a run."""


class Message(NamedTuple):
    """One recorded message."""

    topic: str
    msgtype: str
    data: bytes
    log_ns: int


class Topic(NamedTuple):
    """Type of a topic and number of its messages."""

    msgtype: str
    number: int


class BagReader:
    """Reads a rosbag2 directory or a single .mcap file.

    Parameters
    ----------
    path : directory with metadata.yaml and .mcap file(s), the same without metadata.yaml, or one .mcap file
    namespace : its topics are read without it, all others but /riins/configuration are hidden; "": topics as recorded;
        None: as recorded where a run is among them, else the one namespace that holds a run

    Attributes
    ----------
    topics : dict of name -> (type, count)
    namespace : what was taken off the topics
    start_ns, end_ns : log time of the first and last message; 0 when there is none
    metadata : the bagfile information of metadata.yaml, {} when it is missing

    Raises
    ------
    BagError
        Nothing there, another format, or a recording that was cut off (the text then names `riins bag recover`); no such namespace, or several.
    """

    def __init__(self, path: str | os.PathLike[str], namespace: str | None = "") -> None:
        self.path = Path(path)
        self.metadata: dict[str, Any] = {}
        self._files: list[McapFile] = []
        self._store: Typestore | None = None
        try:
            files, self.metadata = locate(self.path)
            for file in files:
                self._files.append(McapFile(file, self.path))
            self.namespace = self._enter(namespace)
        except BaseException:
            self.close()
            raise
        self._compressed = self.metadata.get("compression_mode", "").lower() == "message"
        self.topics = self._count_topics()
        spans = [(f.starts.min(), f.ends.max()) for f in self._files if len(f.indexes)]
        self.start_ns = int(min(s for s, _ in spans)) if spans else 0
        self.end_ns = int(max(e for _, e in spans)) if spans else 0

    @property
    def message_count(self) -> int:
        """Number of messages."""
        return sum(topic.number for topic in self.topics.values())

    @property
    def duration_s(self) -> float:
        """Seconds between the first and the last message."""
        return (self.end_ns - self.start_ns) * 1e-9

    @property
    def size_bytes(self) -> int:
        """Size of the .mcap files."""
        return sum(file.path.stat().st_size for file in self._files)

    @property
    def typestore(self) -> Typestore:
        """Types of this bag: the installed ones, or the bag's own where their hashes differ."""
        if self._store is None:
            self._store = self._make_store()
        return self._store

    def schemas(self) -> dict[str, Schema]:
        """Schema records by type name."""
        return {schema.name: schema for file in self._files for schema in file.summary.schemas.values()}

    def channels(self) -> dict[str, Channel]:
        """Channel record of each topic (the first where a topic has several)."""
        found: dict[str, Channel] = {}
        for file in self._files:
            for channel in file.summary.channels.values():
                found.setdefault(channel.topic, channel)
        return found

    def qos(self, topic: str) -> tuple[Qos, ...]:
        """Offered QoS profiles as recorded; () when the recording does not say."""
        channel = self.channels().get(topic)
        return parse(channel.metadata.get("offered_qos_profiles", "")) if channel else ()

    def span_ns(self, topic: str) -> tuple[int, int]:
        """Log times of the first and last message of a topic, from the message indexes alone; (0, 0) when there is none."""
        first, last = FOREVER_NS, -1
        for _, file, index in self._chunks((topic,), 0, FOREVER_NS):
            if first <= index.message_start_time and index.message_end_time <= last:
                continue  # cannot widen the span
            data = np.frombuffer(b"" if index.message_index_offsets else file.load(index), np.uint8)
            for key, channel in file.summary.channels.items():
                if channel.topic == topic:
                    log, _ = file.entries(index, key, data)
                    first, last = min(first, int(log.min(initial=FOREVER_NS))), max(last, int(log.max(initial=-1)))
        return (first, last) if last >= 0 else (0, 0)

    def metadata_records(self) -> dict[str, dict[str, str]]:
        """MCAP metadata records; of several with one name the entries are joined, later ones win."""
        found: dict[str, dict[str, str]] = {}
        for file in self._files:
            for name, entries in file.metadata_records():
                found.setdefault(name, {}).update(entries)
        return found

    def configuration(self) -> str | None:
        """Text of the first message on /riins/configuration, None when there is none."""
        for _, _, message in self.read((CONFIGURATION_TOPIC,)):
            return str(message.data)
        return None

    def messages(self, topics: Collection[str] | None = None, start_ns: int | None = None, stop_ns: int | None = None) -> Iterator[Message]:
        """Raw messages in log-time order, equal times in the order written.

        Parameters
        ----------
        topics : names; None: all; one that is not in the bag gives nothing
        start_ns, stop_ns : log times, start <= t < stop

        Yields
        ------
        (topic, msgtype, data, log_ns)
        """
        begin, end = start_ns or 0, FOREVER_NS if stop_ns is None else stop_ns
        pending: list[tuple[int, int, int, int, Channel, bytes]] = []
        for number, file, index in self._chunks(topics, begin, end):
            # All chunks from here on start no earlier: what is older than this one's start is in its final order.
            ready = 0
            while ready < len(pending) and pending[ready][0] < index.message_start_time:
                ready += 1
            yield from (self._message(file_channel, data, log) for log, _, _, _, file_channel, data in pending[:ready])
            del pending[:ready]
            channels = file.summary.channels
            wanted = {key: channel for key, channel in channels.items() if topics is None or channel.topic in topics}
            data = file.load(index)
            for position, (opcode, first, last) in enumerate(walk_chunk(data)):
                if opcode != Opcode.MESSAGE:
                    continue
                _, _, key, _, log, _ = MESSAGE.unpack_from(data, first - 9)
                if key in wanted and begin <= log < end:
                    pending.append((log, number, index.chunk_start_offset, position, wanted[key], data[first + MESSAGE.size - 9 : last]))
            pending.sort(key=lambda entry: entry[:4])
        yield from (self._message(channel, data, log) for log, _, _, _, channel, data in pending)

    def read(self, topics: Collection[str] | None = None, start_ns: int | None = None, stop_ns: int | None = None) -> Iterator[tuple[str, int, Any]]:
        """Deserialized messages in log-time order: (topic, log_ns, message object)."""
        store = self.typestore
        for topic, msgtype, data, log_ns in self.messages(topics, start_ns, stop_ns):
            yield topic, log_ns, deserialize(msgtype, data, store)

    def columns(
        self, topic: str, fields: Collection[str] | None = None, start_ns: int | None = None, stop_ns: int | None = None
    ) -> dict[str, NDArray[Any]]:
        """One topic as arrays, without a Python object a message.

        Parameters
        ----------
        topic : name; not in the bag: BagError
        fields : dotted field names or their beginnings ("header.stamp", "gyro", "subfilters.0"); None: all but texts
        start_ns, stop_ns : log times, start <= t < stop

        Returns
        -------
        dict of arrays (m,) or (m, k) in log-time order: "log_time" int64 ns, the fields by dotted name; a Time is one int64 column in ns;
        sequences of different length are padded (NaN or 0) and NAME.count has the lengths
        """
        if topic not in self.topics:
            raise BagError(f"{self.path} has no topic {topic}; it has: {', '.join(sorted(self.topics)) or 'nothing'}")
        begin, end = start_ns or 0, FOREVER_NS if stop_ns is None else stop_ns
        msgtype = self.topics[topic].msgtype
        unpacker = Unpacker(self.typestore, msgtype, None if fields is None else tuple(fields))
        times: list[NDArray[np.int64]] = []
        places: list[NDArray[np.int64]] = []
        chunks = sorted(self._chunks((topic,), begin, end), key=lambda entry: (entry[0], entry[2].chunk_start_offset))
        for rank, (_, file, index) in enumerate(chunks):
            data = np.frombuffer(file.load(index), np.uint8)
            for key, channel in file.summary.channels.items():
                if channel.topic != topic:
                    continue
                log, offsets = file.entries(index, key, data)
                inside = (log >= begin) & (log < end)
                if not inside.all():
                    log, offsets = log[inside], offsets[inside]
                for row in self._feed(unpacker, data, offsets):
                    times.append(log[row])
                    places.append(offsets[row] + (rank << 33))  # an order of all messages as they are in the file
        if not unpacker.rows:
            return _empty_columns(self.typestore, msgtype, unpacker)
        log_time, place = np.concatenate(times), np.concatenate(places)
        columns = {"log_time": log_time} | _join_times(unpacker.columns())
        if np.any(np.diff(log_time) < 0) or np.any(np.diff(place) < 0):
            order = np.lexsort((place, log_time))
            columns = {name: column[order] for name, column in columns.items()}
        return columns

    def close(self) -> None:
        """Close the files."""
        for file in self._files:
            file.stream.close()

    def __enter__(self) -> BagReader:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()

    def _enter(self, namespace: str | None) -> str:
        names = {channel.topic for file in self._files for channel in file.summary.channels.values()}
        if namespace is None:
            found = namespaces(names)
            if len(found) > 1:
                raise BagError(f"{self.path} holds the runs of {', '.join(found)}: choose one with --namespace")
            namespace = found[0] if found else ""
        name = namespace.strip("/")
        if not name:
            return ""
        if not any(topic.startswith(f"/{name}/") for topic in names):
            raise BagError(f"{self.path} has nothing in the namespace {name}; it has: {', '.join(sorted(names)) or 'nothing'}")
        for file in self._files:
            channels = file.summary.channels
            inside = {key: channel for key, channel in channels.items() if channel.topic.startswith(f"/{name}/")}
            file.summary.channels = {key: channel for key, channel in channels.items() if channel.topic == CONFIGURATION_TOPIC} | {
                key: dataclasses.replace(channel, topic=channel.topic.removeprefix(f"/{name}")) for key, channel in inside.items()
            }
        return name

    def _count_topics(self) -> dict[str, Topic]:
        counts: dict[str, Topic] = {}
        for file in self._files:
            statistics = file.summary.statistics
            per_channel = statistics.channel_message_counts if statistics else {}
            for key, channel in file.summary.channels.items():
                if channel.message_encoding != "cdr":
                    raise BagError(f"topic {channel.topic} of {self.path} is encoded as {channel.message_encoding!r}; only ROS 2 bags (cdr) are read")
                schema = file.summary.schemas.get(channel.schema_id)
                before = counts.get(channel.topic, Topic(schema.name if schema else "", 0))
                counts[channel.topic] = Topic(before.msgtype, before.number + per_channel.get(key, 0))
        return counts

    def _make_store(self) -> Typestore:
        shared = typestore()
        for channel in self.channels().values():
            msgtype = self.topics[channel.topic].msgtype
            recorded = channel.metadata.get("topic_type_hash") or self._digest(channel.topic)
            try:
                same = not recorded or type_hash(msgtype, shared) == recorded
            except BagError:
                same = False
            if not same or msgtype not in shared.fielddefs:
                texts = {name: schema.data.decode() for name, schema in self.schemas().items() if schema.encoding == "ros2msg"}
                return store_of_schemas(texts)
        return shared

    def _digest(self, topic: str) -> str:
        names = (topic, f"/{self.namespace}{topic}")
        for entry in self.metadata.get("topics_with_message_count", []):
            if entry.get("topic_metadata", {}).get("name") in names:
                return str(entry["topic_metadata"].get("type_description_hash", ""))
        return ""

    def _chunks(self, topics: Collection[str] | None, begin: int, end: int) -> Iterator[tuple[int, McapFile, ChunkIndex]]:
        found: list[tuple[int, int, McapFile, ChunkIndex]] = []
        for number, file in enumerate(self._files):
            keys = {key for key, channel in file.summary.channels.items() if topics is None or channel.topic in topics}
            for place in np.nonzero((file.starts < end) & (file.ends >= begin))[0]:
                index = file.indexes[place]
                if not index.message_index_offsets or not keys.isdisjoint(index.message_index_offsets):
                    found.append((index.message_start_time, number, file, index))
        found.sort(key=lambda entry: (entry[0], entry[1], entry[3].chunk_start_offset))
        yield from ((number, file, index) for _, number, file, index in found)

    def _feed(self, unpacker: Unpacker, data: NDArray[np.uint8], offsets: NDArray[np.int64]) -> Iterator[NDArray[np.intp]]:
        """Feed the messages at `offsets` of a chunk; yields which of them were fed, in that order."""
        if self._compressed:
            for number, offset in enumerate(offsets):
                body = zstandard.ZstdDecompressor().decompress(_body(data, int(offset)).tobytes())
                unpacker.feed(np.frombuffer(body, np.uint8)[None, :])
                yield np.array([number])
            return
        lengths = np.zeros(len(offsets), np.int64)
        for byte in range(4):  # the record's 64-bit length; no chunk is larger than 4 GiB
            lengths |= data[offsets + 1 + byte].astype(np.int64) << (8 * byte)
        for length in dict.fromkeys(lengths.tolist()):
            fed = np.nonzero(lengths == length)[0]
            begin, size = offsets[fed], length + 9
            step = np.diff(begin)
            if len(begin) > 1 and step[0] >= size and np.all(step == step[0]):  # evenly spaced: a view will do
                rows = np.lib.stride_tricks.as_strided(data[begin[0] :], (len(begin), size), (int(step[0]), 1), writeable=False)
            else:
                rows = data[begin[:, None] + np.arange(size)]
            unpacker.feed(rows[:, MESSAGE.size :])
            yield fed

    def _message(self, channel: Channel, data: bytes, log_ns: int) -> Message:
        if self._compressed:
            data = zstandard.ZstdDecompressor().decompress(data)
        return Message(channel.topic, self.topics[channel.topic].msgtype, data, log_ns)


def namespaces(topics: Collection[str]) -> list[str]:
    """Namespaces in which topics of a run are; [] when there is none or a run stands outside of all."""
    found = {topic.removesuffix(word).strip("/") for topic in topics for word in RUN_TOPICS if topic.endswith(word)}
    return [] if "" in found else sorted(found)


def _body(data: NDArray[np.uint8], offset: int) -> NDArray[np.uint8]:
    length = int.from_bytes(data[offset + 1 : offset + 9].tobytes(), "little")
    return data[offset + MESSAGE.size : offset + 9 + length]


def _join_times(columns: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    joined: dict[str, NDArray[Any]] = {}
    for name, column in columns.items():
        base, _, last = name.rpartition(".")
        if last == "sec" and f"{base}.nanosec" in columns:
            joined[base] = column.astype(np.int64) * 1_000_000_000 + columns[f"{base}.nanosec"]
        elif not (last == "nanosec" and f"{base}.sec" in columns):
            joined[name] = column
    return joined


def _empty_columns(store: Typestore, msgtype: str, unpacker: Unpacker) -> dict[str, NDArray[Any]]:
    plan = layout(store, msgtype, lambda path, offset: 0)
    unpacker.feed(plan.template()[None, :])
    columns = {"log_time": np.zeros(1, np.int64)} | _join_times(unpacker.columns())
    return {name: column[:0] for name, column in columns.items()}
