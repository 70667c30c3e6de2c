"""Bookkeeping of a live run: latency, rates, losses, health changes, errors against truth.

Lives here: `Monitor`, fed with plain values in any order of arrival, and its `snapshot` and `summary`.
Does not live here: ROS (watch.py feeds it), drawing (table.py), decisions about the run (live.py).
"""

from __future__ import annotations

import math
import threading
from collections import OrderedDict, deque
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from riins_core.frames import ned_difference

MODES = ("waiting", "alignment", "navigating", "coasting", "failed")
RUNNING = (2, 3)
"""Modes of a newest state; while aligning it is the settled one."""
VALIDITIES = ("valid", "doubtful", "invalid")
_REMEMBERED = 2048
_RATE_WINDOW = 5_000_000_000


class NavRow(NamedTuple):
    """What the monitor needs of a NavState: rad, m, m/s, NED; indices of mode and validity."""

    stamp_ns: int
    sequence: int
    latitude: float
    longitude: float
    height: float
    velocity_north: float
    velocity_east: float
    heading: float
    mode: int = 0
    validity: tuple[int, int, int] = (0, 0, 0)
    protection_radius: float = math.nan


class Change(NamedTuple):
    """A sensor or subfilter that changed its state of health."""

    stamp_ns: int
    target: str
    state: str
    reason: str


@dataclass
class Spread:
    """Running root mean square and maximum."""

    count: int = 0
    total: float = 0.0
    largest: float = 0.0
    last: float = math.nan

    def add(self, value: float) -> None:
        """Take one more value."""
        self.count += 1
        self.total += value * value
        self.largest = max(self.largest, abs(value))
        self.last = value

    @property
    def rms(self) -> float:
        """Root mean square; NaN before the first value."""
        return math.sqrt(self.total / self.count) if self.count else math.nan


@dataclass
class Snapshot:
    """What the live table shows at one moment."""

    elapsed_s: float = 0.0
    nav: NavRow | None = None
    error_m: float = math.nan
    velocity_error_mps: float = math.nan
    heading_error_arcmin: float = math.nan
    health: dict[str, tuple[str, str]] = field(default_factory=dict)
    subfilters: dict[str, dict[str, Any]] = field(default_factory=dict)
    rates_hz: dict[str, float] = field(default_factory=dict)
    latency_ms: dict[str, float] = field(default_factory=dict)
    samples: dict[str, int] = field(default_factory=dict)
    changes: list[Change] = field(default_factory=list)


class Monitor:
    """Everything observed in one run; safe to feed in one thread and read in another.

    Parameters
    ----------
    start_at_ns : measurement time of the run's start; 0: the first NavState's
    wall_stamps : stamps are wall-clock times at this rate, so latency is arrival minus due time
    rate : times real time
    score_from_s : errors count from this long after the start [s]
    """

    def __init__(self, start_at_ns: int = 0, wall_stamps: bool = False, rate: float = 1.0, score_from_s: float = 0.0) -> None:
        self.start_at_ns = start_at_ns
        self._wall = wall_stamps and rate == 1.0
        self._score_from_ns = round(score_from_s * 1e9)
        self._lock = threading.Lock()
        self._nav: NavRow | None = None
        self._last_arrival = 0
        self._nav_count = self._nav_lost = 0
        self._latency: list[float] = []
        self._arrivals: dict[str, deque[int]] = {}
        self._received: deque[tuple[int, int]] = deque(maxlen=128)
        self._nav_by_stamp: OrderedDict[int, NavRow] = OrderedDict()
        self._truth_by_stamp: OrderedDict[int, NavRow] = OrderedDict()
        self._position, self._velocity, self._heading = Spread(), Spread(), Spread()
        self._now = (math.nan, math.nan, math.nan)
        self._health: dict[str, tuple[str, str]] = {}
        self._subfilters: dict[str, dict[str, Any]] = {}
        self._counts: dict[str, int] = {}
        self._changes: list[Change] = []

    @property
    def newest_ns(self) -> int:
        """Stamp of the newest NavState; 0 before the first."""
        with self._lock:
            return self._nav.stamp_ns if self._nav else 0

    @property
    def last_arrival_ns(self) -> int:
        """Wall time at which the last NavState came; 0 before the first."""
        with self._lock:
            return self._last_arrival

    def arrived(self, topic: str, arrival_ns: int) -> None:
        """A message of a topic came at this wall time; for the rates."""
        with self._lock:
            times = self._arrivals.setdefault(topic, deque(maxlen=_REMEMBERED))
            times.append(arrival_ns)

    def nav_state(self, row: NavRow, arrival_ns: int) -> None:
        """A NavState came at this wall time [ns]."""
        with self._lock:
            if self.start_at_ns == 0:
                self.start_at_ns = row.stamp_ns
            if self._nav is not None and row.sequence > self._nav.sequence:
                self._nav_lost += row.sequence - self._nav.sequence - 1
            if self._wall and row.mode in RUNNING:
                self._latency.append((arrival_ns - row.stamp_ns) * 1e-6)
            self._nav_count += 1
            self._nav, self._last_arrival = row, arrival_ns
            _remember(self._nav_by_stamp, row)
            self._compare(row.stamp_ns)

    def truth_state(self, row: NavRow) -> None:
        """The true state came; compared with the NavState of the same stamp, whichever comes first."""
        with self._lock:
            _remember(self._truth_by_stamp, row)
            self._compare(row.stamp_ns)

    def health(self, stamp_ns: int, target: str, state: str, reason: str) -> None:
        """State of health of a sensor or subfilter, by name; a change of state is remembered."""
        with self._lock:
            before = self._health.get(target, ("healthy", ""))[0]
            if state != before and not {state, before} <= {"healthy", "suspect"}:  # one doubtful sample is not news
                self._changes.append(Change(stamp_ns, target, state, reason))
            self._health[target] = (state, reason)

    def subfilter(self, name: str, values: dict[str, Any]) -> None:
        """Counters and statistic of a subfilter."""
        with self._lock:
            self._subfilters[name] = values

    def imu_received(self, count: int, arrival_ns: int) -> None:
        """Samples the fusion has received in all, reported at this wall time; for their rate."""
        with self._lock:
            self._counts["received"] = count
            self._received.append((arrival_ns, count))

    def counts(self, **values: int) -> None:
        """Newest counters of samples, by name."""
        with self._lock:
            self._counts.update(values)

    def _compare(self, stamp_ns: int) -> None:
        nav, truth = self._nav_by_stamp.get(stamp_ns), self._truth_by_stamp.get(stamp_ns)
        if nav is None or truth is None or nav.mode not in RUNNING:
            return
        d = ned_difference(nav.latitude, nav.longitude, nav.height, truth.latitude, truth.longitude, truth.height)
        position = math.hypot(d[0], d[1])
        velocity = math.hypot(nav.velocity_north - truth.velocity_north, nav.velocity_east - truth.velocity_east)
        heading = math.degrees(math.remainder(nav.heading - truth.heading, 2.0 * math.pi)) * 60.0
        self._now = (position, velocity, heading)
        if stamp_ns - self.start_at_ns >= self._score_from_ns:
            self._position.add(position)
            self._velocity.add(velocity)
            self._heading.add(heading)

    def snapshot(self, now_ns: int) -> Snapshot:
        """What is known at wall time `now_ns`."""
        with self._lock:
            rates = {topic: _rate(times, now_ns) for topic, times in self._arrivals.items()}
            rates["imu samples"] = _slope([r for r in self._received if r[0] > now_ns - _RATE_WINDOW])
            elapsed = (self._nav.stamp_ns - self.start_at_ns) * 1e-9 if self._nav else 0.0
            latency, samples, changes = self._latency_figures(recent=1000), self._samples(), self._changes[-6:]
            return Snapshot(elapsed, self._nav, *self._now, dict(self._health), dict(self._subfilters), rates, latency, samples, changes)

    def changes_since(self, index: int) -> list[Change]:
        """Health changes from number `index` on."""
        with self._lock:
            return self._changes[index:]

    def summary(self) -> dict[str, Any]:
        """Figures of the whole run, JSON-ready (None where nothing was observed)."""
        with self._lock:
            start = self.start_at_ns
            return {
                "duration_s": (self._nav.stamp_ns - start) * 1e-9 if self._nav else 0.0,
                "mode": MODES[self._nav.mode] if self._nav else None,
                "position_rms_m": _number(self._position.rms),
                "position_max_m": _number(self._position.largest if self._position.count else math.nan),
                "velocity_rms_mps": _number(self._velocity.rms),
                "heading_rms_arcmin": _number(self._heading.rms),
                "latency_ms": {k: _number(v) for k, v in self._latency_figures().items()} if self._latency else None,
                "samples": self._samples(),
                "isolations": [
                    {"target": c.target, "at_s": (c.stamp_ns - start) * 1e-9, "reason": c.reason} for c in self._changes if c.state == "isolated"
                ],
                "changes": [{"target": c.target, "at_s": (c.stamp_ns - start) * 1e-9, "state": c.state, "reason": c.reason} for c in self._changes],
            }

    def _samples(self) -> dict[str, int]:
        return {**self._counts, "nav_states": self._nav_count, "nav_states_lost": self._nav_lost}

    def _latency_figures(self, recent: int = 0) -> dict[str, float]:
        if not self._latency:
            return {}
        p50, p99, largest = np.percentile(self._latency[-recent:], (50, 99, 100))
        return {"p50": float(p50), "p99": float(p99), "max": float(largest)}


def _remember(rows: OrderedDict[int, NavRow], row: NavRow) -> None:
    rows[row.stamp_ns] = row
    if len(rows) > _REMEMBERED:
        rows.popitem(last=False)


def _rate(times: deque[int], now_ns: int) -> float:
    """Messages a second over the last seconds of wall time."""
    recent = [t for t in times if t > now_ns - _RATE_WINDOW]
    if len(recent) < 2 or recent[-1] == recent[0]:
        return len(recent) / (_RATE_WINDOW * 1e-9)
    return (len(recent) - 1) / ((recent[-1] - recent[0]) * 1e-9)


def _slope(reports: list[tuple[int, int]]) -> float:
    """Counts a second between the first and the last report."""
    if len(reports) < 2 or reports[-1][0] == reports[0][0]:
        return 0.0
    return (reports[-1][1] - reports[0][1]) / ((reports[-1][0] - reports[0][0]) * 1e-9)


def _number(value: float) -> float | None:
    return None if math.isnan(value) else float(value)
