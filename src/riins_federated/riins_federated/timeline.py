"""Order by measurement time: the IMU buffer, the aids that wait, and the journal of what is not settled yet.

Lives here: `ImuBuffer`, `EventQueue`, `Journal`, `Due`, `Checkpoint`, all of them integer nanoseconds and no navigation.
Does not live here: the filter and its roll-back (navigator.py).
"""

from __future__ import annotations

import bisect
from collections import Counter
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .gaps import Filled
from .types import Array


def to_ns(seconds: float) -> int:
    """Integer nanoseconds."""
    return round(seconds * 1e9)


def next_due(due: int, period: int, stamp_ns: int) -> int:
    """First stamp of the grid after `stamp_ns`."""
    return due + period * ((stamp_ns - due) // period + 1)


class Due(NamedTuple):
    """Stamps at which something recurs, or the periods."""

    covariance: int
    height: int
    settle: int
    feedback: int

    def first(self) -> int:
        """The earliest."""
        return min(self)

    def after(self, stamp_ns: int) -> Due:
        """The first stamps after a beginning, of periods of which 0 means never."""
        return Due(*(stamp_ns + period if period else NEVER_NS for period in self))


@dataclass(frozen=True)
class Checkpoint:
    """A moment to go back to: samples and queue items worked, results noted, what was due, and the filter."""

    stamp_ns: int
    sample: int
    cursor: int
    journal: int
    due: Due
    filter: tuple[object, ...]


NEVER_NS = 2**62
SOON_NS = 60_000_000_000
"""A measurement that is stamped further ahead of the newest IMU sample at its arrival has another clock's stamp."""
MONTH_NS = 30 * 86_400_000_000_000
"""A command may be for later, and one of a recording that is played comes before its samples; beyond this it has another clock's stamp."""
_COLUMNS = ("stamp", "rate", "force", "rate_covariance", "force_covariance", "dt", "unknown")


class ImuBuffer:
    """IMU samples from the oldest checkpoint to the newest arrival.

    Attributes
    ----------
    stamp : (m,) int64, ns
    rate, force : (m, 3), FRD
    rate_covariance, force_covariance : (m, 3, 3), FRD, zero where not known
    dt : (m,), s, since the sample before
    unknown : (m, 6), what a sample put into a gap does not know, see `gaps.Filled`
    """

    def __init__(self) -> None:
        self.clear()

    def clear(self) -> None:
        """Forget every sample."""
        self.stamp: NDArray[np.int64] = np.empty(0, np.int64)
        self.rate: Array = np.empty((0, 3))
        self.force: Array = np.empty((0, 3))
        self.rate_covariance: Array = np.empty((0, 3, 3))
        self.force_covariance: Array = np.empty((0, 3, 3))
        self.dt: Array = np.empty(0)
        self.unknown: Array = np.empty((0, 6))

    def __len__(self) -> int:
        return len(self.stamp)

    def append(self, samples: Filled) -> None:
        """Add samples that follow the last one."""
        for name, values in zip(_COLUMNS, samples, strict=True):
            setattr(self, name, np.concatenate([getattr(self, name), values]))

    def drop(self, n: int) -> None:
        """Forget the oldest n samples."""
        if n > 0:
            for name in _COLUMNS:
                setattr(self, name, getattr(self, name)[n:])


class Timed(NamedTuple):
    """An item of the event queue, ordered by stamp, then rank (a fixed order of the sources)."""

    stamp_ns: int
    rank: int
    item: Any


class EventQueue:
    """Everything that happens at a measurement time, in an order that does not depend on arrival.

    Attributes
    ----------
    cursor : number of the first item that is not yet worked, counted from the beginning of the run
    """

    def __init__(self) -> None:
        self._items: list[Timed] = []
        self._keys: set[tuple[int, int]] = set()
        self._number: Counter[int] = Counter()
        self._dropped = 0
        self.cursor = 0

    def number(self, rank: int) -> int:
        """Items of a source."""
        return self._number[rank]

    def add(self, stamp_ns: int, rank: int, item: Any) -> bool:
        """Insert; False if that source already has an item of that stamp."""
        if (stamp_ns, rank) in self._keys:
            return False
        bisect.insort(self._items, Timed(stamp_ns, rank, item), key=lambda t: t[:2])
        self._keys.add((stamp_ns, rank))
        self._number[rank] += 1
        return True

    def head_ns(self) -> int:
        """Stamp of the first item that is not yet worked; NEVER_NS when there is none."""
        index = self.cursor - self._dropped
        return self._items[index].stamp_ns if index < len(self._items) else NEVER_NS

    def take(self) -> Timed:
        """The first item that is not yet worked, which now is."""
        self.cursor += 1
        return self._items[self.cursor - 1 - self._dropped]

    def waiting(self) -> list[Timed]:
        """What is not yet worked."""
        return self._items[self.cursor - self._dropped :]

    def drop(self, cursor: int) -> None:
        """Forget the items before a cursor."""
        n = cursor - self._dropped
        self._forget(self._items[:n])
        del self._items[:n]
        self._dropped = cursor

    def cut(self, stamp_ns: int) -> list[Timed]:
        """Take out what is later than a stamp and not yet worked."""
        n = max(bisect.bisect_right(self._items, stamp_ns, key=lambda t: t.stamp_ns), self.cursor - self._dropped)
        out = self._items[n:]
        del self._items[n:]
        self._forget(out)
        return out

    def _forget(self, items: list[Timed]) -> None:
        self._keys.difference_update((t.stamp_ns, t.rank) for t in items)
        self._number.subtract(t.rank for t in items)


class Journal:
    """Results in the order of measurement time; the tail can be taken back, the head is handed out once it is settled.

    A filter that goes back beyond what was handed out (its checkpoints are further apart than results) finds the same results again, since they
    are settled: those are not noted a second time.
    """

    def __init__(self) -> None:
        self._entries: list[tuple[int, Any]] = []
        self._given = 0
        self._again = 0

    def __len__(self) -> int:
        """Length since the beginning of the run, what was handed out included."""
        return self._given - self._again + len(self._entries)

    def add(self, stamp_ns: int, entry: Any) -> None:
        """Note a result."""
        if self._again:
            self._again -= 1
        else:
            self._entries.append((stamp_ns, entry))

    def truncate(self, length: int) -> None:
        """Take back what was noted after the journal had this length."""
        self._again = max(0, self._given - length)
        del self._entries[max(0, length - self._given) :]

    def take(self, until_ns: int) -> list[Any]:
        """Hand out what is not later than a stamp."""
        n = bisect.bisect_right(self._entries, until_ns, key=lambda entry: entry[0])
        out = [entry for _, entry in self._entries[:n]]
        del self._entries[:n]
        self._given += n
        return out
