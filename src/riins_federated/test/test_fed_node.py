"""The node navigator in one process: commands that it accepts are published, so that a recording can be navigated again."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs ROS 2")
pytest.importorskip("riins_msgs.msg", reason="needs riins_msgs built by colcon and its environment")

import rclpy
from rclpy.executors import SingleThreadedExecutor

from riins_federated.node import NavigatorNode
from riins_msgs.msg import FusedImu, SensorUse
from riins_msgs.srv import SetSensorUse
from riins_node import convert, fields, qos

os.environ["ROS_DOMAIN_ID"] = str(100 + (os.getpid() + 40) % 80)
os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")

DT, START = 10_000_000, 1_700_000_000_000_000_000


def test_accepted_commands_are_published_with_the_stamp_that_holds() -> None:
    rclpy.init()
    node, other, executor = NavigatorNode(), rclpy.create_node("bench"), SingleThreadedExecutor()
    executor.add_node(node)
    executor.add_node(other)

    def until(condition: Callable[[], Any]) -> None:
        end = time.monotonic() + 10.0
        while not condition():
            assert time.monotonic() < end, "timed out"
            executor.spin_once(timeout_sec=0.02)

    def call(target: str, use: bool, stamp_ns: int = 0) -> bool:
        future = client.call_async(SetSensorUse.Request(target=target, use=use, effective=convert.to_stamp(stamp_ns)))
        until(future.done)
        return bool(future.result().success)

    try:
        node.start()
        client = other.create_client(SetSensorUse, "navigator/set_sensor_use")
        imu = other.create_publisher(FusedImu, "imu/fused", qos.imu())
        until(lambda: client.service_is_ready() and imu.get_subscription_count() == 1)
        zero, eye = np.zeros(3), np.eye(3)
        for k in range(1, 11):
            imu.publish(convert.fill(FusedImu, fields.fused_imu(START + k * DT, k, zero, np.array([0.0, 0.0, -9.8]), eye, eye, 63, 63, zero, zero)))
        until(lambda: node._navigator.status().imu_received == 10)
        assert call("gps", False) and call("bds", False, START + 5 * DT)
        assert not call("gyro_0", False) and not call("bds", False, START - 3_000_000_000)  # not of this node; too late
        assert call("gps", True, START + 900 * DT)
        heard: list[SensorUse] = []
        other.create_subscription(SensorUse, "nav/commands", heard.append, qos.latched(100))  # late, as a recorder may be
        until(lambda: len(heard) >= 3)
        assert [convert.read_sensor_use(m) for m in heard] == [
            {"name": "gps", "use": False, "stamp_ns": START + 10 * DT + 1},
            {"name": "bds", "use": False, "stamp_ns": START + 5 * DT},
            {"name": "gps", "use": True, "stamp_ns": START + 900 * DT},
        ]
    finally:
        executor.shutdown()
        other.destroy_node()
        node.destroy_node()
        rclpy.try_shutdown()
