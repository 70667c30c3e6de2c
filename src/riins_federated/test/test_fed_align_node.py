"""The action Align over DDS: refused in one line, carried out with feedback, repeated while navigating, given up; its commands are recorded."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs ROS 2")
pytest.importorskip("riins_msgs.action", reason="needs riins_msgs built by colcon and its environment")

import rclpy
from action_msgs.msg import GoalStatus
from rclpy.action import ActionClient
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from sensor_msgs.msg import NavSatFix

from riins_core.earth import earth_rate_n, gravity
from riins_core.rotation import dcm_from_euler
from riins_core.sensor_errors import DEG
from riins_federated.alignment_saved import read_heading, write_heading
from riins_federated.alignment_settle import FULL
from riins_federated.node import NavigatorNode
from riins_msgs.action import Align
from riins_msgs.msg import AlignCommand, AlignmentStatus, FusedImu, NavState
from riins_node import alignment_fields, convert, fields, qos

os.environ["ROS_DOMAIN_ID"] = str(100 + (os.getpid() + 41) % 80)
os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")

DT, START, LAT = 100_000_000, 1_700_000_000_000_000_000, 40.0 * DEG
C_NB = dcm_from_euler(0.01, -0.02, 200.0 * DEG)


class Bench:
    """A navigator at rest and whoever talks to it, in one thread."""

    def __init__(self, **parameters: Any) -> None:
        # at ten samples a second a mean over a sample is all there is: the noise of a second, a tenth of it
        given = parameters | {"alignment.attempt_s": 5.0, "aids": ["gps"], "inertial.gyro_bias_deg_h": 0.01}
        self.node = NavigatorNode(parameter_overrides=[Parameter(name, value=value) for name, value in given.items()])
        self.other, self.executor = rclpy.create_node("bench"), SingleThreadedExecutor()
        for node in (self.node, self.other):
            self.executor.add_node(node)
        self.node.start()
        self.client = ActionClient(self.other, Align, "navigator/align")
        self.imu = self.other.create_publisher(FusedImu, "imu/fused", qos.imu())
        self.gps = self.other.create_publisher(NavSatFix, "gps/fix", qos.aid())
        self.states: list[Any] = []
        self.statuses: list[Any] = []
        self.other.create_subscription(NavState, "nav/state", self.states.append, qos.navigation())
        self.other.create_subscription(AlignmentStatus, "nav/alignment", self.statuses.append, qos.latched(100))
        self.feedback: list[Any] = []
        self.rng, self.k = np.random.default_rng(4), 0
        self.until(lambda: self.client.server_is_ready() and self.imu.get_subscription_count() and self.gps.get_subscription_count())

    def until(self, condition: Callable[[], Any]) -> None:
        end = time.monotonic() + 20.0
        while not condition():
            assert time.monotonic() < end, "timed out"
            self.executor.spin_once(timeout_sec=0.02)

    def sail(self, seconds: int) -> None:
        """Measurement time goes on at rest, with a fix a second."""
        zero, eye = np.zeros(3), np.zeros((3, 3))
        for _ in range(seconds):
            self.gps.publish(convert.fill(NavSatFix, fields.position_fix(START + (self.k + 10) * DT, LAT, 0.3, 0.0, 4.0 * np.eye(3), "gps_link")))
            self.until(lambda before=self.k: self.node._navigator.status().imu_received >= before)
            for _ in range(10):
                self.k += 1
                rate = C_NB.T @ earth_rate_n(LAT) + 1e-6 * self.rng.standard_normal(3)
                force = C_NB.T @ [0.0, 0.0, -gravity(LAT, 0.0)] + 1e-4 * self.rng.standard_normal(3)
                self.imu.publish(convert.fill(FusedImu, fields.fused_imu(START + self.k * DT, self.k, rate, force, eye, eye, 63, 63, zero, zero)))
        self.until(lambda: self.node._navigator.status().imu_received >= self.k)

    def goal(self, **wish: Any) -> Any:
        sent = self.client.send_goal_async(Align.Goal(**wish), feedback_callback=self.feedback.append)
        self.until(sent.done)
        assert sent.result().accepted
        return sent.result()

    def result(self, handle: Any) -> Any:
        got = handle.get_result_async()
        self.until(got.done)
        return got.result()

    def close(self) -> None:
        self.executor.shutdown()
        self.client.destroy()
        self.other.destroy_node()
        self.node.destroy_node()
        rclpy.try_shutdown()


@pytest.fixture
def bench(request):
    rclpy.init()
    made = Bench(**getattr(request, "param", {}))
    try:
        yield made
    finally:
        made.close()


def test_align_by_action(bench: Bench) -> None:
    refused = bench.result(bench.goal(method="redundant"))
    assert refused.status == GoalStatus.STATUS_ABORTED and refused.result.message == "there is no IMU sample yet"
    bench.sail(2)
    assert "no method" in bench.result(bench.goal(method="magic")).result.message
    assert "cancel the goal" in bench.result(bench.goal(method="cancel")).result.message

    first = bench.goal(method="redundant")
    bench.sail(16)
    found = bench.result(first)
    assert found.status == GoalStatus.STATUS_SUCCEEDED and found.result.success, found.result.message
    assert "aligned by redundant after 10 s" in found.result.message
    assert found.result.status.heading == pytest.approx(200.0 * DEG, abs=4.0 * found.result.status.sigma_heading)
    assert [f.feedback.status.phase for f in bench.feedback][-1] == AlignmentStatus.FINE and len(bench.feedback) >= 8
    modes = [s.mode for s in bench.states]
    assert NavState.MODE_ALIGNMENT in modes and modes[-1] == NavState.MODE_NAVIGATING
    assert all(s.heading_validity == 2 for s in bench.states if s.mode == NavState.MODE_ALIGNMENT)
    assert bench.statuses[-1].phase == AlignmentStatus.NAVIGATING and bench.statuses[-1].code == AlignmentStatus.CODE_FULL
    assert bench.statuses[-1].settle_time == pytest.approx(11.0, abs=1.1)  # with the first state given out

    again = bench.goal(method="stationary")  # while navigating, and given up
    bench.sail(4)
    cancelled = again.cancel_goal_async()
    bench.until(cancelled.done)
    given_up = bench.result(again)
    assert given_up.status == GoalStatus.STATUS_CANCELED and "gave it up" in given_up.result.message
    bench.sail(6)
    assert bench.states[-1].mode == NavState.MODE_NAVIGATING

    renewed = bench.goal(method="known_heading", heading=200.1 * DEG, sigma_heading=0.1 * DEG, time_limit=100.0)
    third = bench.goal(method="redundant")
    resets = bench.states[-1].reset_count
    bench.sail(16)
    assert "another one was commanded" in bench.result(renewed).result.message
    assert bench.result(third).result.success and bench.states[-1].reset_count > resets

    heard: list[Any] = []
    bench.other.create_subscription(AlignCommand, "nav/align", heard.append, qos.latched(100))  # late, as a recorder may be
    bench.until(lambda: len(heard) >= 5)
    assert [alignment_fields.read_align_command(m)["method"] for m in heard] == ["redundant", "stationary", "cancel", "known_heading", "redundant"]
    assert [alignment_fields.read_align_command(m)["stamp_ns"] % DT for m in heard] == [1, 1, 1, 1, 2]


HEADING_FILE = f"/tmp/riins_heading_{os.getpid()}.yaml"


@pytest.mark.parametrize("bench", [{"alignment.method": "hot_start", "alignment.heading_file": HEADING_FILE}], indirect=True)
def test_a_hot_start_reads_the_heading_that_was_kept_and_keeps_it(bench: Bench) -> None:
    """The file is no part of a recording: what it held goes into a command, so that a replay has it."""
    assert "no saved heading" in read_heading(HEADING_FILE)[1] and not write_heading(HEADING_FILE, 200.05 * DEG, 0.02 * DEG, START)
    try:
        bench.sail(66)
        heard: list[Any] = []
        bench.other.create_subscription(AlignCommand, "nav/align", heard.append, qos.latched(100))
        bench.until(lambda: bench.states and bench.states[-1].mode == NavState.MODE_NAVIGATING and heard and bench.statuses[-1].code == FULL)
        assert alignment_fields.read_align_command(heard[0])["heading"] == pytest.approx(200.05 * DEG)
        assert bench.statuses[-1].method == "hot_start" and bench.statuses[-1].sigma_heading < 0.6 * DEG
        kept, words = read_heading(HEADING_FILE)
        assert kept is not None and kept[0] != pytest.approx(200.05 * DEG, abs=1e-9) and "saved heading" in words
        assert kept[0] == pytest.approx(200.0 * DEG, abs=4.0 * kept[1])
        assert "cannot be kept" in write_heading("/proc/nowhere/heading.yaml", 1.0, 0.1, 0)
    finally:
        os.unlink(HEADING_FILE)
    with open(HEADING_FILE, "w") as broken:
        broken.write("heading_deg: north")
    assert "does not hold" in read_heading(HEADING_FILE)[1]
    os.unlink(HEADING_FILE)
