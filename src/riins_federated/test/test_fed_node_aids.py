"""The node navigator with declared aids: a ship with two GNSS receivers, a log and a compass from a parameter file alone, and wrong declarations."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs ROS 2")
pytest.importorskip("riins_msgs.msg", reason="needs riins_msgs built by colcon and its environment")

import rclpy
from geometry_msgs.msg import PoseWithCovarianceStamped, TwistWithCovarianceStamped
from rclpy.executors import SingleThreadedExecutor
from sensor_msgs.msg import NavSatFix

from riins_federated.node import NavigatorNode
from riins_msgs.msg import FusedImu, InitialState
from riins_node import convert, fields, qos
from riins_node.parameters import ParameterError, parameter_file

os.environ["ROS_DOMAIN_ID"] = str(100 + (os.getpid() + 55) % 80)
os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")

DT, START = 10_000_000, 1_700_000_000_000_000_000
SHIP = """
/**:
  ros__parameters:
    aids: [bow, stern, dvl, compass]
    bow.type: gnss_position
    bow.topic: gnss/bow
    stern: {type: gnss_position, topic: gnss/stern, lever_arm_m: [-30, 0, -15], delay_s: 0.1}
    dvl: {type: body_velocity, misalignment_deg: 0.0, frame: dvl_link}
    compass: {type: heading, sigma_deg: 1, deviation_deg: 2}
"""


@pytest.fixture
def started(tmp_path: Path):
    """Start rclpy with a parameter file of this text."""

    def start(text: str) -> None:
        file = tmp_path / "ship.yaml"
        file.write_text(text)
        rclpy.init(args=["--ros-args", "--params-file", str(file)])

    yield start
    rclpy.try_shutdown()


def test_a_ship_declared_in_a_parameter_file_is_navigated(started: Callable[[str], None]) -> None:
    started(SHIP)
    node, other, executor = NavigatorNode(), rclpy.create_node("bench"), SingleThreadedExecutor()
    executor.add_node(node)
    executor.add_node(other)
    assert node.get_parameter("compass.deviation_deg").value == 2.0 and not node.has_parameter("gps.sigma_m")
    assert "compass.sigma_deg" in parameter_file(node)

    def until(condition: Callable[[], Any]) -> None:
        end = time.monotonic() + 15.0
        while not condition():
            assert time.monotonic() < end, [
                (s.name, s.accepted, s.malformed, s.rejected, s.reason, s.statistic) for s in node._navigator.status().subfilters
            ]
            executor.spin_once(timeout_sec=0.02)

    def pose(stamp: int, **values: Any) -> dict[str, Any]:
        return {"header": fields.header(stamp, "compass_link"), "pose": values}

    try:
        node.start()
        topics = {
            "gnss/bow": NavSatFix,
            "gnss/stern": NavSatFix,
            "dvl/velocity": TwistWithCovarianceStamped,
            "compass/heading": PoseWithCovarianceStamped,
        }
        out = {topic: other.create_publisher(kind, topic, qos.aid()) for topic, kind in topics.items()}
        imu = other.create_publisher(FusedImu, "imu/fused", qos.imu())
        state = other.create_publisher(InitialState, "nav/initial_state", qos.latched())
        until(lambda: all(p.get_subscription_count() == 1 for p in (*out.values(), imu)))
        assert not node.get_subscriptions_info_by_topic("/gps/fix")
        zero, eye = np.zeros(3), np.eye(3)
        content = {"header": fields.header(START, "map_ned"), "latitude": 40.0, "longitude": 120.0, "roll": 0.0, "heading": np.pi / 2}
        sigmas = {"sigma_position": 10.0 * np.ones(3), "sigma_velocity": 0.1 * np.ones(3), "sigma_attitude": 0.01 * np.ones(3)}
        state.publish(convert.fill(InitialState, {**content, **sigmas}))
        east = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}  # FLU along ENU: heading 90 deg
        covariance = np.zeros(36)
        covariance[35] = 1e-4
        for second in (1, 2, 3):
            stamp = START + second * 1_000_000_000
            for topic, lon in (("gnss/bow", 120.0), ("gnss/stern", 120.0 - 30.0 / (6.39e6 * np.cos(np.radians(40.0))) * 180.0 / np.pi)):
                fix = {"header": fields.header(stamp, "gnss_link"), "latitude": 40.0, "longitude": lon, "status": {"status": 0}}
                out[topic].publish(convert.fill(NavSatFix, fix))
            frame = "dvl_link" if second != 2 else "base_link"
            out["dvl/velocity"].publish(convert.fill(TwistWithCovarianceStamped, fields.doppler(stamp, zero, 0.01 * eye, frame)))
            orientation = {"pose": {"orientation": east}, "covariance": covariance} if second != 3 else {"pose": {"orientation": {"w": 0.0}}}
            out["compass/heading"].publish(convert.fill(PoseWithCovarianceStamped, pose(stamp, **orientation)))
        until(lambda: node._navigator.status().subfilters[2].malformed == 1 and node._navigator.status().subfilters[3].malformed == 1)
        for k in range(1, 321):
            imu.publish(convert.fill(FusedImu, fields.fused_imu(START + k * DT, k, zero, np.array([0.0, 0.0, -9.8]), eye, eye, 63, 63, zero, zero)))
            if k % 20 == 0:
                executor.spin_once(timeout_sec=0.0)
        until(lambda: node._navigator.status().imu_received == 320)
        until(lambda: [s.accepted for s in node._navigator.status().subfilters] == [3, 3, 2, 2])
        assert [s.name for s in node._navigator.status().subfilters] == ["bow", "stern", "dvl", "compass"]
        assert node._navigator.status().subfilters[1].stamp_ns == START + 2_900_000_000  # its delay is off the stamp
        assert node._navigator.labels[-1] == "compass_deviation [rad]"
    finally:
        executor.shutdown()
        other.destroy_node()
        node.destroy_node()


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        ("aids: [gps, compass]", r'"aids" names "compass", but there is no "compass.type"'),
        ("aids: [gps, compass]\n    compass.type: hedding", r'"compass.type" must be one of .* \(did you mean "heading"\?\)'),
        ("aids: [gps, stern]\n    stern: {type: gnss_position, topic: gps/fix}", r'"stern" has the topic "gps/fix", which is that of "gps"'),
        (
            "aids: [gps, stern]\n    stern: {type: gnss_position, sigma_mm: [1.0, 1.0, 1.0]}",
            r'unknown parameter "stern.sigma_mm" \(did you mean "stern.sigma_m"',
        ),
        ("stern: {sigma_m: [1.0, 1.0, 1.0]}", 'unknown parameter "stern.sigma_m"'),
        (
            "aids: [gps, dvl]\n    dvl: {type: beam_velocity}",
            'aid "dvl" needs marine_acoustic_msgs/msg/Dvl, and marine_acoustic_msgs is not installed here',
        ),
        ("states: [gyro_scales]", r'"states" names "gyro_scales" \(did you mean "gyro_scale"'),
    ],
)
def test_a_wrong_declaration_ends_the_node_with_one_line(started: Callable[[str], None], lines: str, said: str) -> None:
    if "marine_acoustic_msgs" in said and _installed("marine_acoustic_msgs"):
        pytest.skip("marine_acoustic_msgs is installed")
    started(f"/**:\n  ros__parameters:\n    {lines}\n")
    with pytest.raises(ParameterError, match=said) as caught:
        NavigatorNode()
    assert "\n" not in str(caught.value)


def test_no_aids_at_all(started: Callable[[str], None]) -> None:
    started("/**:\n  ros__parameters:\n    aids: []\n")
    node = NavigatorNode()
    assert not node._aids and node.get_parameter("aids").value == []
    node.destroy_node()


def _installed(package: str) -> bool:
    from importlib.util import find_spec

    return find_spec(package) is not None
