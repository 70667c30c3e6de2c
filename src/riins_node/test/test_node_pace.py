"""riins_node.pace with a clock of the test: every sample once, in order, in bursts when late."""

from __future__ import annotations

import time
from collections.abc import Callable

import pytest
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from riins_node.pace import BURST, Pacer


class FakeClock:
    """Seconds that only the test moves."""

    def __init__(self) -> None:
        self.now = 1000.0

    def __call__(self) -> float:
        return self.now


def test_samples_due() -> None:
    clock = FakeClock()
    pacer = Pacer(None, 0, 4.0, clock)
    assert pacer.newest(10_000_000) == 0
    clock.now += 1.0001
    assert pacer.newest(10_000_000) == 400  # four times real time
    assert pacer.now_ns() - pacer.start_at_ns == pytest.approx(4.0004e9, rel=1e-9)
    clock.now -= 2.0
    assert pacer.newest(10_000_000) < 0


def test_start_at_lies_ahead_or_behind() -> None:
    clock = FakeClock()
    ahead = Pacer(None, time.time_ns() + 10_000_000_000, 1.0, clock)
    assert ahead.newest(1_000_000_000) == -10
    behind = Pacer(None, time.time_ns() - 10_500_000_000, 1.0, clock)
    assert behind.newest(1_000_000_000) == 10


def test_two_nodes_with_one_start_agree() -> None:
    start = time.time_ns() + 1_000_000_000
    first, second = Pacer(None, start), Pacer(None, start)
    assert first.start_at_ns == second.start_at_ns == start
    assert abs(first.now_ns() - second.now_ns()) < 50_000_000


def test_stream_never_drops_and_catches_up_in_bursts(ros: Callable[..., None]) -> None:
    ros()
    node, clock = Node("p"), FakeClock()
    calls: list[tuple[int, int]] = []
    stream = Pacer(node, 0, 1.0, clock).stream(10_000_000, lambda k0, m: calls.append((k0, m)))
    assert stream.fire() == 0
    for pause in (0.0101, 0.0101, 5.0, 0.0):
        clock.now += pause
        while stream.fire():
            pass
    numbers = [k for k0, m in calls for k in range(k0, k0 + m)]
    assert numbers == list(range(1, numbers[-1] + 1))
    assert numbers[-1] == 502
    assert max(m for _, m in calls) == BURST
    node.destroy_node()


def test_restarted_stream_goes_on_with_the_next_sample(ros: Callable[..., None]) -> None:
    ros()
    node, clock = Node("p"), FakeClock()
    pacer = Pacer(node, 0, 1.0, clock)
    clock.now += 3.005
    assert pacer.stream(10_000_000, lambda k0, m: None, k_start=-1).next_k == 301
    assert pacer.stream(10_000_000, lambda k0, m: None, k_start=17).next_k == 17
    node.destroy_node()


def test_timer_keeps_the_rate(ros: Callable[..., None]) -> None:
    ros()
    node = Node("p")
    late: list[float] = []
    count = 0

    def emit(k0: int, m: int) -> None:
        nonlocal count
        count += m
        late.append((pacer.now_ns() - pacer.start_at_ns) * 1e-9 - (k0 + m - 1) * 0.01)

    pacer = Pacer(node, 0, 1.0)
    pacer.stream(10_000_000, emit)
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    end = time.monotonic() + 1.0
    while time.monotonic() < end:
        executor.spin_once(timeout_sec=0.1)
    assert 85 <= count <= 101
    assert min(late) >= 0.0  # never before its time
    assert sorted(late)[len(late) // 2] < 0.005  # and not half a period late, as with a free-running timer
    executor.shutdown()
    node.destroy_node()
    assert rclpy.ok()
