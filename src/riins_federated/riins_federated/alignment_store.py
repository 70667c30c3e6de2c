"""What an alignment works on: samples, aids and states of a master up to a measurement time, with what isolated sensors had put in taken out.

Lives here: `AlignmentData`, `Window`.
Does not live here: what is made of it (alignment_methods.py, alignment_detect.py), when (aligner.py).
"""

from __future__ import annotations

import bisect
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from riins_core.alignment.inertial_frame import body_integrals

from .alignment_settings import MasterState
from .types import Aid, Array, Recall, UseCommand


@dataclass(frozen=True)
class Window:
    """Samples at equal intervals; a lost sample is held, as the navigator holds it.

    Attributes
    ----------
    rate, force : (m, 3), means over dt, rad/s, m/s^2, FRD
    dt : s
    edges : (k,) int64, ns, ends of the samples that came
    count : (k,) int64, samples of this window up to each of them
    noise : (2,), standard deviation of a sample's white noise as the fusion says, rad/s and m/s^2; 0: not known
    """

    rate: Array
    force: Array
    dt: float
    edges: NDArray[np.int64]
    count: NDArray[np.int64]
    noise: Array

    @property
    def end_ns(self) -> int:
        """End of the last sample."""
        return int(self.edges[-1])

    @property
    def length_s(self) -> float:
        """Length of the data, s."""
        return len(self.rate) * self.dt

    def index(self, stamp_ns: NDArray[np.int64]) -> NDArray[np.int64]:
        """Number of samples before stamps (j,), to the nearest end of one."""
        after = np.clip(np.searchsorted(self.edges, stamp_ns), 1, len(self.edges) - 1)
        nearer = np.abs(self.edges[after] - stamp_ns) > np.abs(self.edges[after - 1] - stamp_ns)
        return np.asarray(self.count[after - nearer.astype(np.int64)])


class AlignmentData:
    """Everything from the beginning of an alignment on, in order of measurement time.

    Parameters
    ----------
    begin_ns : nothing before it is taken

    Attributes
    ----------
    floor_ns : nothing before it is used: `begin_ns`, or the stamp at which a sensor was isolated that had been faulty before that
    """

    def __init__(self, begin_ns: int) -> None:
        self.begin_ns = self.floor_ns = begin_ns
        self._stamp: NDArray[np.int64] = np.empty(0, np.int64)
        self._values: Array = np.empty((0, 8))  # rate, force, variance of the two
        self._size = 0
        self._aids: list[Aid] = []
        self._masters: list[MasterState] = []
        self._uses: list[UseCommand] = []
        self._recalls: list[Recall] = []

    def append(self, stamp_ns: NDArray[np.int64], rate: Array, force: Array, rate_covariance: Array, force_covariance: Array) -> None:
        """Add samples that follow the last one; arguments as of Navigator.add_imu."""
        first = int(np.searchsorted(stamp_ns, self.begin_ns, side="right"))
        n = len(stamp_ns) - first
        if n <= 0:
            return
        if self._size + n > len(self._stamp):
            room = max(2 * len(self._stamp), self._size + n, 4096)
            self._stamp = np.concatenate([self._stamp[: self._size], np.zeros(room - self._size, np.int64)])
            self._values = np.concatenate([self._values[: self._size], np.zeros((room - self._size, 8))])
        part = slice(self._size, self._size + n)
        self._stamp[part] = stamp_ns[first:]
        self._values[part, 0:3], self._values[part, 3:6] = rate[first:], force[first:]
        for column, covariance in ((6, rate_covariance), (7, force_covariance)):
            self._values[part, column] = (covariance[first:, 0, 0] + covariance[first:, 1, 1] + covariance[first:, 2, 2]) / 3.0
        self._size += n

    def add_aid(self, aid: Aid) -> None:
        """Add a measurement, whenever it arrives."""
        if aid.stamp_ns > self.begin_ns and aid.ok:
            bisect.insort(self._aids, aid, key=lambda known: (known.stamp_ns, known.name))

    def add_master(self, state: MasterState) -> None:
        """Add a state of the master, whenever it arrives."""
        if state.stamp_ns > self.begin_ns:
            bisect.insort(self._masters, state, key=lambda known: known.stamp_ns)

    def add_use(self, command: UseCommand) -> None:
        """An aid is excluded or restored from a measurement time on."""
        bisect.insort(self._uses, command, key=lambda known: known.stamp_ns)

    def add_recall(self, recall: Recall) -> None:
        """Keep what declared sensors have put in until it is settled."""
        if recall.stamp_ns > self.begin_ns:
            self._recalls.append(recall)

    def first_ns(self) -> int | None:
        """Stamp of the first sample."""
        return int(self._stamp[0]) if self._size else None

    def aids(self, names: tuple[str, ...], until_ns: int) -> list[Aid]:
        """Measurements of some aids up to a stamp that the operator has not excluded."""
        stop = bisect.bisect_right(self._aids, until_ns, key=lambda known: known.stamp_ns)
        return [aid for aid in self._aids[:stop] if aid.stamp_ns > self.floor_ns and aid.name in names and self._in_use(aid)]

    def _in_use(self, aid: Aid) -> bool:
        said = [command.use for command in self._uses if command.name == aid.name and command.stamp_ns <= aid.stamp_ns]
        return not said or said[-1]

    def masters(self, until_ns: int) -> list[MasterState]:
        """States of the master up to a stamp."""
        first, stop = (bisect.bisect_right(self._masters, t, key=lambda known: known.stamp_ns) for t in (self.floor_ns, until_ns))
        return self._masters[first:stop]

    def settle(self, until_ns: int) -> list[tuple[Recall, bool]]:
        """Take out of the samples what sensors declared up to a stamp have put in.

        Returns
        -------
        (recall, whether it could be) of each: it cannot where the fault began before the data, which then begin behind it
        """
        due = [recall for recall in self._recalls if recall.stamp_ns <= until_ns]
        self._recalls = self._recalls[len(due) :]
        out = []
        for recall in due:
            done = recall.onset_ns >= self.floor_ns and self._take_out(recall)
            if not done:
                self.floor_ns = recall.stamp_ns - 1
            out.append((recall, done))
        return out

    def _take_out(self, recall: Recall) -> bool:
        """Spread the recalled angle and velocity evenly over the time of the fault: their sums at its end are then right, whatever its shape."""
        begun = int(self._stamp[0]) if self._size else 0
        first, stop = (int(np.searchsorted(self._stamp[: self._size], t, side="right")) for t in (recall.onset_ns, recall.stamp_ns))
        if recall.onset_ns < begun or stop - first < 2:
            return False
        stamps, values = self._stamp[first - 1 : stop], self._values[first:stop]
        steps = np.diff(stamps) * 1e-9
        dt = float(np.mean(steps))
        C, u = body_integrals(values[:, 0:3], values[:, 3:6], dt, 1)
        m = len(values)
        angle, velocity = C[-1] @ recall.angle, C[-1] @ recall.velocity  # in the body before the fault
        pushed = np.diff(u, axis=0)
        # the recalled velocity holds what the specific force made of the wrong attitude; that goes with the rates
        velocity = velocity - np.cross(angle, np.sum(((np.arange(m) + 0.5) / m)[:, None] * pushed, axis=0))
        for columns, total in ((slice(0, 3), angle), (slice(3, 6), velocity)):
            values[:, columns] -= np.einsum("kji,j->ki", C[1:], total / (m * dt))
        return True

    def window(self, until_ns: int, since_ns: int = 0) -> Window | None:
        """Samples in (since_ns, until_ns] at equal intervals; None where there are fewer than two."""
        first, stop = (int(np.searchsorted(self._stamp[: self._size], t, side="right")) for t in (max(since_ns, self.floor_ns), until_ns))
        if stop - first < 2:
            return None
        stamps, values = self._stamp[first:stop], self._values[first:stop]
        steps = np.diff(stamps)
        step = float(np.median(steps))
        times = np.maximum(1, np.rint(steps / step)).astype(np.int64)
        times = np.concatenate([[1], times])
        count = np.cumsum(times)
        dt = float(stamps[-1] - stamps[0]) * 1e-9 / float(count[-1] - 1)
        held = np.repeat(values, times, axis=0)
        noise = np.sqrt(np.mean(held[:, 6:8], axis=0))
        return Window(np.ascontiguousarray(held[:, 0:3]), np.ascontiguousarray(held[:, 3:6]), dt, stamps.copy(), count, noise)
