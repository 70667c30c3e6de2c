"""What is in a bag, for people and for `riins bag info`.

Lives here: `describe` and `BagInfo`.
Does not live here: printing in colour (riins_bringup), scoring (riins_eval).
"""

from __future__ import annotations

import os
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from riins_bag.reader import BagReader

REDUNDANT_IMU = "riins_msgs/msg/RedundantImu"


@dataclass(frozen=True)
class TopicInfo:
    """One topic of a bag; `rate_hz` is the mean over its own first and last message, 0 with fewer than two."""

    name: str
    msgtype: str
    count: int
    rate_hz: float
    reliability: str
    durability: str


@dataclass(frozen=True)
class SequenceGaps:
    """Numbering of a RedundantImu topic: samples that are missing, where the largest gap is, restarts of the count."""

    topic: str
    received: int
    lost: int
    gaps: int
    largest: int
    largest_at_s: float
    restarts: int


@dataclass(frozen=True)
class BagInfo:
    """Summary of a bag.

    Attributes
    ----------
    complete : it has its metadata.yaml, so that `ros2 bag` opens it
    damaged_metadata : there is a metadata.yaml, which cannot be read
    self_contained : it carries /riins/configuration, so that it can be navigated and scored alone
    """

    path: Path
    complete: bool
    damaged_metadata: bool
    self_contained: bool
    start_ns: int
    duration_s: float
    size_bytes: int
    message_count: int
    topics: tuple[TopicInfo, ...]
    imu: tuple[SequenceGaps, ...]

    def as_mapping(self) -> dict[str, Any]:
        """Plain mapping for JSON."""
        return asdict(self) | {"path": str(self.path)}

    def lines(self) -> list[str]:
        """The summary as text."""
        text = [f"{self.path}: {self.message_count} messages, {self.duration_s:.3f} s, {self.size_bytes / 1e6:.3f} MB"]
        text += [f"  {t.name:<28} {t.msgtype:<45} {t.count:>9} {t.rate_hz:9.2f} Hz  {t.reliability}, {t.durability}" for t in self.topics]
        for gaps in self.imu:
            where = f", largest {gaps.largest} at {gaps.largest_at_s:.3f} s" if gaps.lost else ""
            text.append(f"  {gaps.topic}: {gaps.received} samples, {gaps.lost} lost in {gaps.gaps} gaps{where}, {gaps.restarts} restarts")
        if not self.complete:
            text.append(f"  metadata.yaml {'is damaged' if self.damaged_metadata else 'is missing'}: `riins bag recover` makes one")
        if not self.self_contained:
            text.append("  no /riins/configuration: navigating it needs the geometry and parameters from elsewhere")
        return text


def describe(path: str | os.PathLike[str]) -> BagInfo:
    """Summarize a bag.

    Parameters
    ----------
    path : bag directory or .mcap file

    Returns
    -------
    BagInfo

    Raises
    ------
    BagError
        As `BagReader`.
    """
    with BagReader(path) as bag:
        topics, imu = [], []
        for name, (msgtype, count) in sorted(bag.topics.items()):
            first, last = bag.span_ns(name)
            rate = (count - 1) / ((last - first) * 1e-9) if count > 1 and last > first else 0.0
            offers = bag.qos(name)
            words = (offers[0].reliability, offers[0].durability) if offers else ("unknown", "unknown")
            topics.append(TopicInfo(name, msgtype, count, rate, *words))
            if msgtype == REDUNDANT_IMU and count:
                imu.append(_gaps(bag, name))
        return BagInfo(
            path=Path(path),
            complete=bool(bag.metadata),
            damaged_metadata=not bag.metadata and (bag.path / "metadata.yaml").exists(),
            self_contained="/riins/configuration" in bag.topics,
            start_ns=bag.start_ns,
            duration_s=bag.duration_s,
            size_bytes=bag.size_bytes,
            message_count=bag.message_count,
            topics=tuple(topics),
            imu=tuple(imu),
        )


def _gaps(bag: BagReader, topic: str) -> SequenceGaps:
    columns = bag.columns(topic, ("sequence",))
    steps = np.diff(columns["sequence"].astype(np.int64))
    missing = np.where(steps > 1, steps - 1, 0)
    place = int(np.argmax(missing)) if len(missing) else 0
    return SequenceGaps(
        topic=topic,
        received=len(columns["sequence"]),
        lost=int(missing.sum()),
        gaps=int(np.count_nonzero(missing)),
        largest=int(missing[place]) if len(missing) else 0,
        largest_at_s=float(columns["log_time"][place] - bag.start_ns) * 1e-9 if len(missing) else 0.0,
        restarts=int(np.count_nonzero(steps <= 0)),
    )
