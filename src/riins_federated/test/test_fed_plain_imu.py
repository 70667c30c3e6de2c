"""An ordinary IMU in place of the fused one: numbers and means, and the node navigating on sensor_msgs/Imu alone."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from riins_federated.plain_imu import PlainImu

DT, START = 10_000_000, 1_700_000_000_000_000_000
ZERO = np.zeros(3)


def test_numbers_count_what_is_missing() -> None:
    stream = PlainImu(100.0, False, 2.0)
    steps = [0, 1, 2, 5, 6.3, 6.9, 8]  # of the period: three are missing; jitter is not a loss
    assert [stream.take(START + round(s * DT), ZERO, ZERO).sequence for s in steps] == [1, 2, 3, 6, 7, 8, 9]
    unknown = PlainImu(0.0, False, 2.0)
    assert [unknown.take(START + round(s * DT), ZERO, ZERO).sequence for s in steps] == [1, 2, 3, 4, 5, 6, 7]


def test_instants_become_means_by_the_trapezoid_rule() -> None:
    """The sum over the stream is the trapezoidal integral, with gaps, whatever is rejected in between."""
    rng, stream = np.random.default_rng(1), PlainImu(100.0, True, 2.0)
    at = np.cumsum(rng.integers(1, 4, 50)) * DT
    values = rng.standard_normal((50, 3))
    total, last = np.zeros(3), at[0]
    for k in range(50):
        sample = stream.take(START + int(at[k]), values[k], 2.0 * values[k])
        total += (at[k] - last) * sample.rate
        last = at[k]
        stream.take(START + int(at[k]) - DT, np.full(3, 9e9), ZERO)  # a stamp back
        stream.take(START + int(at[k]) + 1, np.full(3, np.nan), ZERO)
    np.testing.assert_allclose(total, np.sum(0.5 * np.diff(at)[:, None] * (values[1:] + values[:-1]), axis=0), rtol=1e-9)
    mean = PlainImu(100.0, False, 2.0)
    mean.take(START, values[0], ZERO)
    assert np.array_equal(mean.take(START + DT, values[1], ZERO).rate, values[1])


@pytest.mark.parametrize("jump_s", [-50.0, 50.0])
def test_a_jump_begins_anew(jump_s: float) -> None:
    stream, one = PlainImu(100.0, True, 2.0), np.ones(3)
    for k in range(5):
        stream.take(START + k * DT, one, one)
    first = stream.take(START + round(jump_s * 1e9), 3.0 * one, one)
    assert first.sequence == 1 and np.array_equal(first.rate, 3.0 * one)
    assert np.array_equal(stream.take(START + round(jump_s * 1e9) + DT, one, one).rate, 2.0 * one)


def test_the_navigator_takes_an_ordinary_imu() -> None:
    """At rest on the Earth with GPS: it navigates, its noise is that of the messages, losses are counted. Without any node of ours beside it."""
    rclpy = pytest.importorskip("rclpy", reason="needs ROS 2")
    pytest.importorskip("riins_msgs.msg", reason="needs riins_msgs built by colcon and its environment")
    from rclpy.executors import SingleThreadedExecutor
    from sensor_msgs.msg import Imu, NavSatFix

    from riins_core.earth import gravity
    from riins_federated.node import NavigatorNode
    from riins_federated.types import InitialState
    from riins_msgs.msg import InitialState as InitialMessage
    from riins_msgs.msg import NavState
    from riins_node import convert, fields, qos

    os.environ["ROS_DOMAIN_ID"] = str(100 + (os.getpid() + 60) % 80)
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    words = ["imu_topic_type:=imu", "imu_rate_hz:=50.0", "gps.period_s:=1.0", "settle_period_s:=1.0"]
    rclpy.init(args=["--ros-args", *(w for word in words for w in ("-p", word))])
    node, other, executor = NavigatorNode(), rclpy.create_node("bench"), SingleThreadedExecutor()
    executor.add_node(node)
    executor.add_node(other)

    def until(condition: Callable[[], Any]) -> None:
        end = time.monotonic() + 20.0
        while not condition():
            assert time.monotonic() < end, "timed out"
            executor.spin_once(timeout_sec=0.02)

    try:
        node.start()
        settled: list[NavState] = []
        other.create_subscription(NavState, "nav/settled", settled.append, qos.navigation())
        imu = other.create_publisher(Imu, "imu/data_raw", qos.imu())
        gps = other.create_publisher(NavSatFix, "gps/fix", qos.aid())
        initial = other.create_publisher(InitialMessage, "nav/initial_state", qos.latched())
        until(lambda: all(p.get_subscription_count() for p in (imu, gps, initial)) and other.count_publishers("nav/settled"))
        lat, lon, sigma, one = 0.7, 0.3, (1e-3, 2e-2), np.ones(3)
        start = InitialState(START, lat, lon, 0.0, ZERO, ZERO, 3.0 * one, 0.1 * one, np.radians(0.1) * one, 1e-4 * one, 1e-2 * one)
        initial.publish(convert.fill(InitialMessage, fields.initial_state(start)))
        rng, weight = np.random.default_rng(2), float(gravity(lat, 0.0))
        for k in range(1, 601):
            stamp = START + 20_000_000 * k
            if k not in (100, 101):
                rate, force = sigma[0] * rng.standard_normal(3), np.array([0.0, 0.0, -weight]) + sigma[1] * rng.standard_normal(3)
                imu.publish(convert.fill(Imu, fields.imu_raw(stamp, rate, force, sigma[0] ** 2 * np.eye(3), sigma[1] ** 2 * np.eye(3))))
            if k % 50 == 0:
                gps.publish(convert.fill(NavSatFix, fields.position_fix(stamp, lat, lon, 0.0, 4.0 * np.eye(3), "gps_link")))
                until(lambda: node._navigator.status().imu_received == k - 2 * (k >= 100))  # noqa: B023
        until(lambda: len(settled) >= 9)
        status, last = node._navigator.status(), convert.read_nav_state(settled[-1])
        assert (status.imu_received, status.imu_lost, status.imu_rejected) == (598, 2, 0) and status.subfilters[0].accepted >= 10
        assert abs(last["lat"] - lat) * 6.4e6 < 5.0 and np.all(np.abs(last["v_n"][:2]) < 0.3) and np.all(np.abs(last["rph"][:2]) < np.radians(1.0))
        walk = sigma[0] * np.sqrt(0.02 * 9.0)  # angle random walk of the messages' noise since the start
        assert last["sigma_rph"][2] == pytest.approx(np.hypot(np.radians(0.1), walk), rel=0.3)
    finally:
        executor.shutdown()
        other.destroy_node()
        node.destroy_node()
        rclpy.try_shutdown()
