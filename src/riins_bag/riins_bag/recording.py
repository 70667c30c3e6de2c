"""What the recorder and the player are told and what they do beside ROS.

Lives here: `RecorderConfig`, `PlayerConfig`, `RAW_TOPICS`, `AHEAD_TOPICS`, `selected`, `Spool` (the thread that writes), `Counter`.
Does not live here: subscriptions, publishers, QoS of rclpy (nodes/).
"""

from __future__ import annotations

import collections
import fnmatch
import threading
import time
from collections.abc import Collection, Sequence
from dataclasses import dataclass

from riins_bag.errors import BagError
from riins_bag.qos import Qos
from riins_bag.typesys import require
from riins_bag.writer import BagWriter
from riins_core.settings import setting

AHEAD_TOPICS = ("/nav/commands", "/nav/align", "/fdi/method")
"""Their messages say from which stamp they hold and may have been recorded behind it: they are played before the first sample."""
AIDS = ("gps", "bds", "doppler", "odometer", "altimeter", "star_tracker")
RAW_TOPICS = ("/rimu/raw", *(f"/{aid}/*" for aid in AIDS), "/nav/initial_state", "/master/*", "/truth/*", "/riins/configuration", *AHEAD_TOPICS)
TICK_S = 0.05  # how often the writing thread looks for messages
SPOOL_BYTES = 256 * 1024 * 1024  # what may wait for a slow disk


@dataclass(frozen=True)
class RecorderConfig:
    """Settings of the recorder node."""

    path: str = setting("", "bag directory to make; empty: riins_DATE_TIME in the working directory")
    topics: tuple[str, ...] = setting((), "topics to record, * and ? allowed; empty: every topic but hidden ones")
    exclude: tuple[str, ...] = setting((), "topics not to record, * and ? allowed")
    configuration_file: str = setting("", "text file that is written first, on /riins/configuration; empty: none")
    flush_period_s: float = setting(1.0, "longest time a message waits before it survives a kill of the recorder", "s", 0.1, 60.0)
    chunk_bytes: int = setting(65536, "size at which a chunk is closed", "byte", 1024, 64 * 1024 * 1024)
    compression_level: int = setting(1, "zstd level, 0: no compression", "", 0, 19)
    depth: int = setting(1000, "queue of each subscription", "messages", 1, 100000)
    discovery_period_s: float = setting(0.1, "time between looks for new topics", "s", 0.02, 10.0)


@dataclass(frozen=True)
class PlayerConfig:
    """Settings of the player node."""

    path: str = setting("", "bag directory or .mcap file")
    namespace: str = setting("", "namespace of the recorded topics, which are played without it; empty: as they are")
    rate: float = setting(1.0, "recorded time over wall time", "", 0.001, 1000.0)
    start_offset_s: float = setting(0.0, "where to begin, from the first message that is not latched", "s", 0.0)
    loop: bool = setting(False, "begin again at the end; stamps then go back, which consumers announce as a restart")
    topics: tuple[str, ...] = setting((), "topics to play, * and ? allowed; empty: what sensors, operators and truth published")
    publish_clock: bool = setting(False, "publish the log time on /clock, 100 times a second of recorded time")
    wait_for: tuple[str, ...] = setting((), "topics that must have a subscriber before the first message; empty: those of redundant IMUs")
    subscribers: tuple[int, ...] = setting((), "how many subscribers each of these topics must have, in their order; empty: one", "", 1, 100)
    wait_timeout_s: float = setting(0.0, "give up when they have none after this time; 0: wait for ever", "s", 0.0)
    depth: int = setting(400, "queue of each publisher whose recorded depth is not known", "messages", 1, 100000)


def selected(topic: str, include: Collection[str], exclude: Collection[str] = ()) -> bool:
    """Whether a topic is wanted; without `include` all but hidden ones (a part that begins with _)."""
    if any(fnmatch.fnmatchcase(topic, pattern) for pattern in exclude):
        return False
    if include:
        return any(fnmatch.fnmatchcase(topic, pattern) for pattern in include)
    return not any(part.startswith("_") for part in topic.split("/"))


class Counter:
    """Messages of one topic; losses are seen by the publisher's own numbering while there is only one publisher."""

    def __init__(self) -> None:
        self.received = 0
        self.lost = 0
        self._expected: int | None = None
        self._before = 0

    def take(self, number: int | None, single: bool) -> None:
        """Count a message with the publisher's number."""
        self.received += 1
        if number is None or not single:
            self._expected = None
            return
        if self._expected is not None and number > self._expected:
            self.lost += number - self._expected
        self._expected = number + 1

    def rate(self, period_s: float) -> float:
        """Messages per second since the last call, which was `period_s` ago."""
        fresh, self._before = self.received - self._before, self.received
        return fresh / period_s if period_s > 0.0 else 0.0


class Spool:
    """Takes messages without blocking and writes them in a thread.

    Parameters
    ----------
    writer : bag to write; the spool owns it from now on
    flush_period_s : longest time between a message and its being on disk
    limit_bytes : what may wait before the disk counts as too slow
    """

    def __init__(self, writer: BagWriter, flush_period_s: float, limit_bytes: int = SPOOL_BYTES) -> None:
        self.writer = writer
        self.failure: BagError | None = None
        self._period, self._limit = flush_period_s, limit_bytes
        self._queue: collections.deque[tuple[str, str, bytes, int, int, int | None]] = collections.deque()
        self._announced: dict[str, tuple[Qos, ...]] = {}
        self._in_bytes = 0  # written by the callers' thread alone
        self._out_bytes = 0  # written by the writing thread alone
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._work, name="bag writer", daemon=True)
        self._thread.start()

    @property
    def waiting_bytes(self) -> int:
        """Bytes taken and not yet written."""
        return self._in_bytes - self._out_bytes

    def announce(self, topic: str, msgtype: str, offers: Sequence[Qos]) -> None:
        """Tell the bag of a topic and its offered profiles before its first message.

        Raises
        ------
        BagError
            No definition of its type is found.
        """
        require(msgtype)
        self._announced.setdefault(topic, tuple(offers))

    def put(self, topic: str, msgtype: str, data: bytes, log_ns: int, publish_ns: int, sequence: int | None) -> None:
        """Queue one message; nothing is queued after a failure."""
        if self.failure is None:
            self._in_bytes += len(data)
            self._queue.append((topic, msgtype, data, log_ns, publish_ns, sequence))

    def close(self) -> None:
        """Write what is waiting and close the bag; a failure is kept in `failure`."""
        if self._stop.is_set():
            return
        self._stop.set()
        self._thread.join()
        if self.failure is None:
            try:
                self.writer.close()
            except BagError as error:
                self.failure = error
        if self.failure is not None:
            self.writer.abort()

    def _work(self) -> None:
        flushed = time.monotonic()
        try:
            while not self._stop.wait(TICK_S):
                if self.waiting_bytes > self._limit:
                    raise BagError(f"the disk of {self.writer.path} is too slow: {self.waiting_bytes} bytes are waiting")
                self._drain()
                if time.monotonic() - flushed >= self._period:
                    self.writer.flush()
                    flushed = time.monotonic()
            self._drain()
        except BagError as error:
            self.failure = error
            self._queue.clear()

    def _drain(self) -> None:
        queue, writer = self._queue, self.writer
        while queue:
            topic, msgtype, data, log_ns, publish_ns, sequence = queue.popleft()
            self._out_bytes += len(data)
            writer.write(topic, msgtype, data, log_ns, self._announced.get(topic), publish_ns=publish_ns, sequence=sequence)
