"""Three IMUs as sensor_msgs/Imu -> imu_array -> imu_fusion over DDS in one process, with one IMU at fault; start and bad parameters."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

pytest.importorskip("rclpy", reason="needs ROS 2")
pytest.importorskip("riins_msgs.msg", reason="needs riins_msgs built by colcon and its environment")

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.executors import SingleThreadedExecutor
from sensor_msgs.msg import Imu
from std_msgs.msg import String

from riins_core.rotation import dcm_from_euler
from riins_imu_fusion.node import ImuFusionNode
from riins_imu_fusion.nodes.imu_array import ImuArrayNode, main
from riins_msgs.msg import FusedImu, RedundantImu
from riins_node import convert, qos

os.environ["ROS_DOMAIN_ID"] = str(100 + (os.getpid() + 20) % 80)
os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")

DT, START = 10_000_000, 1_700_000_000_000_000_000
RATE, FORCE = np.array([0.05, -0.1, 0.2]), np.array([0.3, -0.5, 9.8])
RPY = ((0.0, 0.0, 0.0), (0.0, 0.0, 90.0), (180.0, 0.0, 30.0))
ARMS = ((0.0, 0.0, 0.0), (0.5, -0.2, 0.1), (-0.3, 0.4, 0.0))
NOISE = (1e-3, 1e-2)


def flat(rows: tuple[tuple[float, ...], ...]) -> str:
    return str([value for row in rows for value in row])


@pytest.fixture
def graph(tmp_path: Path) -> Iterator[tuple[Any, ...]]:
    file = tmp_path / "fusion.yaml"
    first, second = rclpy.Context(), rclpy.Context()
    words = ["-p", f"mounting_rpy_deg:={flat(RPY)}", "-p", f"lever_arm_m:={flat(ARMS)}", "-p", "clock_offset_s:=[0.0, 0.02, -0.01]"]
    rclpy.init(args=["--ros-args", *words, "-p", f"fusion_parameters_file:={file}"], context=first)
    array = ImuArrayNode(context=first)
    array.start()
    rclpy.init(args=["--ros-args", "--params-file", str(file), "-p", "method:=wls"], context=second)
    fusion, other = ImuFusionNode(context=second), rclpy.create_node("bench", context=second)
    fusion.start()
    executors = [SingleThreadedExecutor(context=first), SingleThreadedExecutor(context=second)]
    executors[0].add_node(array)
    executors[1].add_node(fusion)
    executors[1].add_node(other)

    def until(condition: Callable[[], Any], seconds: float = 20.0) -> None:
        end = time.monotonic() + seconds
        while not condition():
            assert time.monotonic() < end, "timed out"
            for executor in executors:
                executor.spin_once(timeout_sec=0.005)

    yield array, fusion, other, until, file
    for executor in executors:
        executor.shutdown()
    for node in (array, fusion, other):
        node.destroy_node()
    for context in (first, second):
        rclpy.try_shutdown(context=context)


def test_three_imus_one_at_fault(graph: tuple[Any, ...]) -> None:
    """The fused output is right throughout, the whole IMU is out, and nothing is fused after it is declared."""
    array, fusion, other, until, file = graph
    fused: list[FusedImu] = []
    raw: list[RedundantImu] = []
    seen: dict[str, Any] = {}
    other.create_subscription(FusedImu, "imu/fused", fused.append, qos.imu())
    other.create_subscription(RedundantImu, "rimu/raw", raw.append, qos.imu())
    other.create_subscription(String, "rimu/fusion_parameters", lambda m: seen.update(parameters=m.data), qos.latched())
    other.create_subscription(DiagnosticArray, "/diagnostics", lambda m: seen.update({s.name: s for s in m.status}), qos.navigation())
    out = [other.create_publisher(Imu, f"imu_{i}/raw", qos.imu()) for i in range(3)]
    until(lambda: all(p.get_subscription_count() == 1 for p in out) and other.count_publishers("imu/fused") and "parameters" in seen)
    until(lambda: array._out.get_subscription_count() == 2)
    assert yaml.safe_load(seen["parameters"]) == yaml.safe_load(file.read_text()) and fusion._pipeline.n == 9

    rng = np.random.default_rng(4)
    C = [dcm_from_euler(*np.radians(rpy)) for rpy in RPY]
    for k in range(1, 301):
        for i, offset in enumerate((0, 20_000_000, -10_000_000)):
            rate = C[i].T @ RATE + NOISE[0] * rng.standard_normal(3)
            force = C[i].T @ (FORCE + np.cross(RATE, np.cross(RATE, ARMS[i]))) + NOISE[1] * rng.standard_normal(3)
            if i == 1 and k > 150:
                rate, force = rate + np.array([0.2, -0.15, 0.1]), force + np.array([3.0, 2.0, -2.5])
            message = Imu()
            message.header.stamp = convert.to_stamp(START + k * DT + 1_000_000 * i + offset)
            message.angular_velocity.x, message.angular_velocity.y, message.angular_velocity.z = rate.tolist()
            message.linear_acceleration.x, message.linear_acceleration.y, message.linear_acceleration.z = force.tolist()
            out[i].publish(message)
        if k % 50 == 0:
            until(lambda: sum(s.received for s in array._aligner.streams) == 3 * k)  # noqa: B023
    until(lambda: len(raw) >= 295 and len(fused) == len(raw))
    assert all(m.gyro_valid == m.accel_valid == 511 and len(m.gyro) == 9 for m in raw) and np.all(np.diff([m.sequence for m in raw]) == 1)

    stamp = np.array([(convert.to_ns(m.header.stamp) - START) // DT for m in fused])
    rate = np.array([[m.angular_velocity.x, m.angular_velocity.y, m.angular_velocity.z] for m in fused])
    force = np.array([[m.linear_acceleration.x, m.linear_acceleration.y, m.linear_acceleration.z] for m in fused])
    np.testing.assert_allclose(rate, np.tile(RATE, (len(rate), 1)), atol=0.01)  # also at the onset: 5 sigma of one IMU's bias
    np.testing.assert_allclose(force, np.tile(FORCE, (len(force), 1)), atol=0.15)
    used = np.array([[m.gyro_used, m.accel_used] for m in fused])
    assert np.all(used[stamp < 149] == 511) and np.all(used[stamp > 152] == 0b111000111)
    until(lambda: "imu_fusion: gyro" in seen and "gyro_3 isolated; gyro_4 isolated; gyro_5 isolated" in seen["imu_fusion: gyro"].message)
    until(lambda: "imu_array" in seen)
    assert seen["imu_array"].message.startswith("3 IMUs") and seen["imu_array: imu_1/raw"].message == "aligned"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["topics:=['a', 'a']"], "different names"),
        (["topics:=[a, /a]"], "different topics"),
        (["topics:=[]"], "1 to 16 different names"),
        (["lever_arm_m:=[1.0]"], "0 or 9 elements"),
        (["topcs:=['a']"], 'did you mean "topics"?'),
        (["fusion_parameters_file:=/no/such/folder/f.yaml"], "cannot be written"),
    ],
)
def test_bad_parameters_end_in_one_line(words: list[str], message: str, capfd: pytest.CaptureFixture[str]) -> None:
    status = main(["--ros-args", *(word for one in words for word in ("-p", one))])
    lines = [line for line in capfd.readouterr().err.splitlines() if line.startswith("imu_array: error:")]
    assert status in (1, 2) and len(lines) == 1 and message in lines[0]
