"""Pacing of simulated sensors: which samples are due, by the wall clock, at any speed.

Lives here: `Pacer`. A sample is due when the wall clock passes `start_at + k period / rate`; none is ever dropped, late ones come in bursts.
Does not live here: what a sample holds. No algorithm looks at a clock; stamps are `start_at + k period` whatever the clock says.
"""

from __future__ import annotations

import time
from collections.abc import Callable

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.timer import Timer

BURST = 200  # samples per call while catching up, so that services and signals are still answered
SHORTEST_NS = 100_000  # of a timer; also what keeps a late stream from starving the others


class Pacer:
    """Measurement time against the wall clock.

    Parameters
    ----------
    node : whose executor runs the timers; None: no timers, only `now_ns` and `newest`
    start_at_ns : measurement time of sample 0, epoch nanoseconds; 0: now
    rate : measurement time over wall time
    clock : seconds, monotonic
    """

    def __init__(self, node: Node | None, start_at_ns: int = 0, rate: float = 1.0, clock: Callable[[], float] = time.monotonic) -> None:
        self._node = node
        self._clock = clock
        wall_ns = time.time_ns()
        self.start_at_ns = int(start_at_ns) if start_at_ns else wall_ns
        self.rate = float(rate)
        # A stepped wall clock must not drop or repeat samples: it is read once, the monotonic clock goes on from there.
        self._origin = clock() + (self.start_at_ns - wall_ns) * 1e-9

    def now_ns(self) -> int:
        """Measurement time now; before `start_at_ns` while the start lies ahead."""
        return self.start_at_ns + int((self._clock() - self._origin) * self.rate * 1e9)

    def newest(self, period_ns: int) -> int:
        """Number k of the newest sample of that period that is due; negative before the start."""
        return (self.now_ns() - self.start_at_ns) // period_ns

    def stream(self, period_ns: int, emit: Callable[[int, int], None], k_start: int = 1) -> Stream:
        """Call `emit(k0, m)` for the samples k0 .. k0 + m - 1 as they fall due, in order, without gaps.

        Parameters
        ----------
        period_ns : measurement time between samples
        emit : called from the executor
        k_start : first sample; negative: the next one that falls due (a node restarted in mid-run)

        Returns
        -------
        Stream
        """
        if self._node is None:
            raise ValueError("a Pacer without a node has no timers")
        first = k_start if k_start >= 0 else max(self.newest(period_ns) + 1, 1)
        return Stream(self, self._node, period_ns, emit, first)

    def wait_ns(self, k: int, period_ns: int) -> int:
        """Wall time until sample k is due [ns]; negative when it is late."""
        return int((self._origin + k * period_ns * 1e-9 / self.rate - self._clock()) * 1e9)


class Stream:
    """One paced sequence of samples; `next_k` is the first not yet emitted.

    The timer is set anew for each sample, to the very moment it falls due: a free-running timer would add half a period of latency.
    """

    def __init__(self, pacer: Pacer, node: Node, period_ns: int, emit: Callable[[int, int], None], k_start: int) -> None:
        self._pacer = pacer
        self._period_ns = period_ns
        self._emit = emit
        self.next_k = k_start
        self._timer: Timer = node.create_timer(self._wait_s(), self._fire, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def stop(self) -> None:
        """Emit nothing more."""
        self._timer.cancel()

    def fire(self) -> int:
        """Emit what is due, at most `BURST` samples; returns how many."""
        due = min(self._pacer.newest(self._period_ns) - self.next_k + 1, BURST)
        if due > 0:
            k0, self.next_k = self.next_k, self.next_k + due
            self._emit(k0, due)
        return max(due, 0)

    def _fire(self) -> None:
        self.fire()
        if not self._timer.is_canceled():
            self._timer.timer_period_ns = int(self._wait_s() * 1e9)
            self._timer.reset()

    def _wait_s(self) -> float:
        return max(self._pacer.wait_ns(self.next_k, self._period_ns), SHORTEST_NS) * 1e-9
