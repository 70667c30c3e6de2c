"""Writing of rosbag2 directories that `ros2 bag` reads: MCAP file and metadata.yaml.

Lives here: `BagWriter`.
Does not live here: the MCAP records (chunks.py), message types (typesys.py), the recorder's queue and thread (recording.py).
"""

from __future__ import annotations

import os
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
import yaml
from numpy.typing import ArrayLike

from riins_bag import cdr, qos
from riins_bag.chunks import ChunkWriter
from riins_bag.errors import BagError
from riins_bag.qos import Qos
from riins_bag.typesys import require, schema_text, serialize, type_hash

CONFIGURATION_TOPIC = "/riins/configuration"
STRING = "std_msgs/msg/String"
METADATA_VERSION = 9
ROS_DISTRO = "jazzy"
QosLike = str | Qos | Sequence[Qos] | None


@dataclass
class _Topic:
    channel: int
    name: str
    msgtype: str
    profiles: tuple[Qos, ...]
    digest: str
    count: int = 0


class BagWriter:
    """Writes one bag; a context manager that closes it.

    Parameters
    ----------
    path : directory to make; it must not exist
    flush_period_s : a chunk is closed at the latest when it is this old and a message comes (or `flush` is called); 0: by size only,
        which makes the file depend on its messages alone
    chunk_bytes : a chunk is closed when it is this large (uncompressed)
    level : zstd level; 0: no compression
    custom_data : words for the metadata's custom_data

    Raises
    ------
    BagError
        The path exists or cannot be written.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        *,
        flush_period_s: float = 1.0,
        chunk_bytes: int = 64 * 1024,
        level: int = 1,
        custom_data: Mapping[str, str] | None = None,
    ) -> None:
        self.path = Path(path)
        self.custom_data = dict(custom_data or {})
        self._period = flush_period_s
        self._opened: float | None = None  # when the chunk in progress got its first message
        self._topics: dict[str, _Topic] = {}
        self._schemas: dict[tuple[str, str], int] = {}
        self._closed = False
        if self.path.exists():
            raise BagError(f"{self.path} exists already; choose another name or remove it")
        self.file = self.path / f"{self.path.name}_0.mcap"
        try:
            self.path.mkdir(parents=True)
            self._stream = self.file.open("xb")
            self._writer = ChunkWriter(self._stream, "ros2", chunk_bytes, level)
            self._writer.add_metadata("rosbag2", {"ROS_DISTRO": ROS_DISTRO})
        except OSError as error:
            raise BagError(f"cannot write {self.path}: {error.strerror or error}") from None

    def add_topic(
        self, topic: str, msgtype: str, profiles: QosLike = None, *, schema: str | None = None, digest: str | None = None, encoding: str = "ros2msg"
    ) -> None:
        """Announce a topic before its first message; repeated calls do nothing.

        Parameters
        ----------
        topic, msgtype : names
        profiles : name of `qos.NAMED`, a Qos or several (one a publisher); None: by topic
        schema, digest, encoding : definition, RIHS01 hash and schema encoding to copy from another bag; None: of the installed type
        """
        known = self._topics.get(topic)
        if known:
            if known.msgtype != msgtype:
                raise BagError(f"topic {topic} is {known.msgtype} in this bag, not {msgtype}")
            return
        offers = _profiles(topic, profiles)
        text = schema_text(msgtype) if schema is None else schema
        hashed = type_hash(msgtype) if digest is None else digest
        number = self._schemas.get((msgtype, text))
        if number is None:
            number = self._schemas[msgtype, text] = self._writer.add_schema(msgtype, encoding, text.encode())
        channel = self._writer.add_channel(topic, "cdr", number, {"offered_qos_profiles": qos.dump(offers), "topic_type_hash": hashed})
        self._topics[topic] = _Topic(channel, topic, msgtype, offers, hashed)

    def write(
        self, topic: str, msgtype: str, data: bytes, stamp_ns: int, qos: QosLike = None, *, publish_ns: int | None = None, sequence: int | None = None
    ) -> None:
        """Append one serialized message.

        Parameters
        ----------
        topic, msgtype : names
        data : CDR with its encapsulation header
        stamp_ns : log time: receive time when live, stamp of the header when offline
        qos : see `add_topic`, used at the first message of the topic
        publish_ns : publish time; None: log time
        sequence : of the MCAP record; None: counts up by topic
        """
        entry = self._topics.get(topic)
        if entry is None or entry.msgtype != msgtype:
            self.add_topic(topic, msgtype, qos)
            entry = self._topics[topic]
        if stamp_ns < 0:
            raise BagError(f"a message on {topic} has a time before 1970 ({stamp_ns} ns): give the recording an epoch")
        number = entry.count if sequence is None else sequence
        self._guard(self._writer.add_message, entry.channel, stamp_ns, stamp_ns if publish_ns is None else publish_ns, data, number)
        entry.count += 1
        self._flush_if_due()

    def write_message(self, topic: str, msgtype: str, fields: Any, stamp_ns: int, qos: QosLike = None) -> None:
        """Append one message given as nested mapping of fields (see `typesys.message`), message object or rclpy message."""
        self.write(topic, msgtype, serialize(msgtype, fields), stamp_ns, qos)

    def write_block(
        self, topic: str, msgtype: str, stamp_ns: ArrayLike, fields: Mapping[str, Any], *, frame_id: str = "", qos: QosLike = None
    ) -> None:
        """Append m messages at once, a tenth of the cost of one by one.

        Parameters
        ----------
        topic, msgtype : names
        stamp_ns : (m,) int64, log times; also the header's stamps if `fields` has no header
        fields : arrays by field name, see `cdr.pack`; no lists of messages or texts
        frame_id : of the header if `fields` has none
        qos : see `add_topic`
        """
        times = np.asarray(stamp_ns, np.int64)
        if times.ndim != 1:
            raise BagError(f"stamps of a block must be (m,), not {times.shape}")
        if not len(times):
            return
        if times.min() < 0:
            raise BagError(f"a message on {topic} has a time before 1970: give the recording an epoch")
        store = require(msgtype)
        values = dict(fields)
        if "header" not in values and any(name == "header" for name, _ in store.fielddefs[msgtype][1]):
            values["header"] = {"stamp": times, "frame_id": frame_id}
        rows = cdr.pack(store, msgtype, values, len(times))
        self.add_topic(topic, msgtype, qos)
        entry = self._topics[topic]
        self._guard(self._writer.add_block, entry.channel, times, rows, entry.count)
        entry.count += len(times)
        self._flush_if_due()

    def write_configuration(self, text: str, stamp_ns: int) -> None:
        """Write the run's configuration (YAML) on /riins/configuration; by habit the first message of a bag."""
        self.write_message(CONFIGURATION_TOPIC, STRING, {"data": text}, stamp_ns, "latched")

    def add_metadata(self, name: str, data: Mapping[str, str]) -> None:
        """Write an MCAP metadata record."""
        self._guard(self._writer.add_metadata, name, data)

    def flush(self) -> None:
        """Close the chunk in progress: what was written survives a kill of this process."""
        self._guard(self._writer.close_chunk)
        self._opened = None

    @property
    def counts(self) -> dict[str, int]:
        """Messages written by topic."""
        return {topic.name: topic.count for topic in self._topics.values()}

    @property
    def bytes_written(self) -> int:
        """Size of the file so far, without the chunk in progress."""
        return self._writer.bytes_written

    @property
    def span_ns(self) -> tuple[int, int]:
        """Smallest and largest log time of the closed chunks; (0, 0) when empty."""
        return self._writer.start_ns or 0, self._writer.end_ns or 0

    def close(self) -> None:
        """Write index and metadata.yaml; a second call does nothing."""
        if self._closed:
            return
        self.flush()
        information = self._information()
        self.add_metadata("rosbag2", {"serialized_metadata": yaml.safe_dump(information, sort_keys=False)})
        self._guard(self._writer.finish)
        self._closed = True
        self._stream.close()
        temporary = self.path / "metadata.yaml.tmp"
        try:
            temporary.write_text(yaml.safe_dump({"rosbag2_bagfile_information": information}, sort_keys=False), encoding="utf-8")
            temporary.replace(self.path / "metadata.yaml")
        except OSError as error:
            raise BagError(f"cannot write {self.path / 'metadata.yaml'}: {error.strerror or error}") from None

    def abort(self) -> None:
        """Stop at once without an index: the bag then needs `riins bag recover`."""
        if not self._closed:
            self._closed = True
            try:
                self._stream.close()
            except OSError:
                pass  # what could not be written is lost already

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()

    def _flush_if_due(self) -> None:
        if not self._period:
            return
        if not self._writer.pending:
            self._opened = None
        elif self._opened is None:
            self._opened = time.monotonic()
        elif time.monotonic() - self._opened >= self._period:
            self.flush()

    def _guard(self, call: Any, *arguments: Any) -> None:
        if self._closed:
            raise BagError(f"{self.path} is closed")
        try:
            call(*arguments)
        except OSError as error:
            self.abort()
            cure = f"get what was written before by `riins bag recover {self.path}`"
            raise BagError(f"writing {self.path} failed: {error.strerror or error}; {cure}") from None

    def _information(self) -> dict[str, Any]:
        start, end = self.span_ns
        total = sum(topic.count for topic in self._topics.values())
        topics = [
            {
                "topic_metadata": {
                    "name": topic.name,
                    "type": topic.msgtype,
                    "serialization_format": "cdr",
                    "offered_qos_profiles": [profile.as_mapping() for profile in topic.profiles],
                    "type_description_hash": topic.digest,
                },
                "message_count": topic.count,
            }
            for topic in self._topics.values()
        ]
        return {
            "version": METADATA_VERSION,
            "storage_identifier": "mcap",
            "duration": {"nanoseconds": end - start},
            "starting_time": {"nanoseconds_since_epoch": start},
            "message_count": total,
            "topics_with_message_count": topics,
            "compression_format": "",  # MCAP compresses its chunks itself
            "compression_mode": "",
            "relative_file_paths": [self.file.name],
            "files": [
                {
                    "path": self.file.name,
                    "starting_time": {"nanoseconds_since_epoch": start},
                    "duration": {"nanoseconds": end - start},
                    "message_count": total,
                }
            ],
            "custom_data": self.custom_data or None,
            "ros_distro": ROS_DISTRO,
        }


def _profiles(topic: str, profiles: QosLike) -> tuple[Qos, ...]:
    if profiles is None:
        return (qos.of_topic(topic),)
    if isinstance(profiles, Qos):
        return (profiles,)
    if isinstance(profiles, str):
        if profiles not in qos.NAMED:
            raise BagError(f"no QoS profile is named {profiles!r}; known: {', '.join(qos.NAMED)}")
        return (qos.NAMED[profiles],)
    return tuple(profiles)
