"""The node navigator publishes the inertial solution beside the corrected one: what the same calls give without ROS."""

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
from geometry_msgs.msg import TwistWithCovarianceStamped
from rclpy.executors import SingleThreadedExecutor

from riins_core.settings import build
from riins_federated.config import NavigatorConfig
from riins_federated.navigator import Navigator
from riins_federated.node import NavigatorNode
from riins_federated.types import Aid, InitialState
from riins_msgs.msg import FusedImu, NavState
from riins_msgs.msg import InitialState as InitialMessage
from riins_node import convert, fields, qos, readings

os.environ["ROS_DOMAIN_ID"] = str(100 + (os.getpid() + 20) % 80)
os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")

DT, START = 50_000_000, 1_700_000_000_000_000_000
SETTINGS = {"feedback_period_s": 100.0, "max_delay_s": 0.5, "doppler": {"period_s": 1.0}, "damping": {"aid": "doppler"}}
WORDS = ["feedback_period_s:=100.0", "max_delay_s:=0.5", "doppler.period_s:=1.0", "damping.aid:=doppler"]


def test_the_inertial_solution_is_published_as_it_is_without_ros() -> None:
    rclpy.init(args=["--ros-args", *(w for word in WORDS for w in ("-p", word))])
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
        heard: dict[str, list[NavState]] = {"nav/settled": [], "nav/inertial": []}
        for topic, into in heard.items():
            other.create_subscription(NavState, topic, into.append, qos.navigation())
        imu = other.create_publisher(FusedImu, "imu/fused", qos.imu())
        log = other.create_publisher(TwistWithCovarianceStamped, "doppler/velocity", qos.aid())
        initial = other.create_publisher(InitialMessage, "nav/initial_state", qos.latched())
        until(lambda: all(p.get_subscription_count() for p in (imu, log, initial)) and all(map(other.count_publishers, heard)))
        zero, one = np.zeros(3), np.ones(3)
        state = convert.fill(InitialMessage, fields.initial_state(InitialState(START, 0.7, 0.3, 0.0, one, zero, 3.0 * one, one, 1e-3 * one)))
        initial.publish(state)
        alone = Navigator(build(NavigatorConfig, SETTINGS))
        alone.set_initial_state(InitialState(**convert.read_initial_state(state)))
        force, noise = np.array([0.0, 0.0, -9.8]), 1e-10 * np.eye(3)
        for k in range(1, 101):
            stamp = START + k * DT
            if k % 20 == 0:
                speed = convert.fill(TwistWithCovarianceStamped, fields.doppler(stamp, zero, 1e-2 * np.eye(3), "doppler_link"))
                alone.add_aid(Aid("doppler", **readings.read_doppler(speed)))
                log.publish(speed)
            imu.publish(convert.fill(FusedImu, fields.fused_imu(stamp, k, zero, force, noise, noise, 63, 63, zero, zero)))
            alone.add_imu(np.array([stamp]), np.array([k]), zero[None], force[None], (), noise[None], noise[None])
            until(lambda: node._navigator.status().imu_received == k)  # noqa: B023
        expected = alone.drain_settled()
        until(lambda: len(heard["nav/inertial"]) >= len(expected) == 4)
        for want, settled, inertial in zip(expected, heard["nav/settled"], heard["nav/inertial"], strict=True):
            assert want.inertial is not None
            assert settled.sequence == inertial.sequence and settled.header == inertial.header
            assert [inertial.velocity_north, inertial.velocity_east] == want.inertial.v_n[:2].tolist()
            assert inertial.mode == NavState.MODE_COASTING and inertial.sigma_velocity_north > settled.sigma_velocity_north
    finally:
        executor.shutdown()
        other.destroy_node()
        node.destroy_node()
        rclpy.try_shutdown()
