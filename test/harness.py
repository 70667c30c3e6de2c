"""What the whole-system tests share: an own domain, a listener as another stack would be one, a short scenario, comparison of runs.

Lives here: helpers; every test module starts its own graphs with them.
Does not live here: tests, and anything of riins that a listener of another stack would not have.
"""

from __future__ import annotations

import contextlib
import math
import os
import socket
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import domain_coordinator
import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.signals import SignalHandlerOptions

from riins_bag.bag import BagReader
from riins_bringup.processes import node_environment

SHORT = """\
name: short
description: Fifteen seconds at 7 kn with a turn; GPS is spoofed and a gyro fails.
seed: 11
duration_s: 15.5
imu_rate_hz: 100
start: {latitude_deg: 54.4, longitude_deg: 10.2, height_m: 40.0, speed_kn: 7.0, heading_deg: 350.0}
legs:
  - {straight_s: 3.0}
  - {turn_deg: 20.0, rate_deg_s: 3.0}
sea: {significant_wave_height_m: 1.0, peak_period_s: 6.0, direction_deg: 250.0}
imu:
  gyro: {constant_drift_deg_h: 0.05, arw_deg_sqrt_h: 0.005}
  accel: {bias_ug: 100.0, vrw_ug_sqrt_hz: 20.0}
gps: {period_s: 1.0, sigma_m: [2.0, 2.0, 4.0], lever_arm_m: [-8.0, 1.5, -12.0]}
bds: {period_s: 1.0, sigma_m: [4.0, 4.0, 8.0], lever_arm_m: [-8.0, -1.5, -12.0]}
doppler: {period_s: 1.0, sigma_kn: [0.1, 0.1, 0.1], misalignment_deg: 0.1, lever_arm_m: [15.0, 0.0, 3.0]}
initial: {position_m: 5.0, height_m: 2.0, velocity_mps: 0.1, tilt_arcsec: 30.0, heading_arcmin: 6.0}
faults:
  - {target: gyro_2, type: step, size_deg_h: 3600.0, start_s: 4.0}
  - {target: gps, type: step, axis: north, size_m: 200.0, start_s: 6.0, end_s: 13.0}
scoring: {from_s: 5.0}
"""
"""A scenario in which something of everything happens."""


@contextlib.contextmanager
def own_domain(directory: Path) -> Iterator[int]:
    """A ROS domain nobody else has, loopback discovery; the environment is put back afterwards."""
    before = dict(os.environ)
    with domain_coordinator.domain_id() as number:
        os.environ.update(node_environment(directory))
        os.environ["ROS_DOMAIN_ID"] = str(number)
        try:
            yield number
        finally:
            os.environ.clear()
            os.environ.update(before)


def short_scenario(directory: Path, **changes: str) -> Path:
    """Write the short scenario; `changes` replace `key: value` lines that begin with the key."""
    lines = [f"{line.split(':')[0]}: {changes[line.split(':')[0]]}" if line.split(":")[0] in changes else line for line in SHORT.splitlines()]
    path = directory / "short.yaml"
    path.write_text("\n".join(lines) + "\n")
    return path


class Listener:
    """A node of another stack that keeps every message of some topics.

    Parameters
    ----------
    topics : message class by topic
    latched : topics whose last message a late joiner must get
    """

    def __init__(self, topics: Mapping[str, type], latched: tuple[str, ...] = ()) -> None:
        self._context = rclpy.Context()
        rclpy.init(context=self._context, signal_handler_options=SignalHandlerOptions.NO)
        self.node = Node("another_stack", context=self._context)
        self.messages: dict[str, list[Any]] = {topic: [] for topic in topics}
        for topic, kind in topics.items():
            durability = DurabilityPolicy.TRANSIENT_LOCAL if topic in latched else DurabilityPolicy.VOLATILE
            self.node.create_subscription(kind, topic, self.messages[topic].append, QoSProfile(depth=4000, durability=durability))
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._thread = threading.Thread(target=self._spin, daemon=True)
        self._thread.start()

    def __enter__(self) -> Listener:
        return self

    def __exit__(self, *_: object) -> None:
        self._context.try_shutdown()
        self._thread.join(5.0)
        self.node.destroy_node()

    def _spin(self) -> None:
        with contextlib.suppress(ExternalShutdownException):
            self._executor.spin()

    def last(self, topic: str) -> Any:
        """Newest message of a topic."""
        return self.messages[topic][-1]

    def publishers(self, topic: str) -> list[Any]:
        """Publishing endpoints of a topic."""
        return list(self.node.get_publishers_info_by_topic(topic))


def wait_until(condition: Callable[[], Any], timeout: float, what: str) -> Any:
    """Wait for a condition; its value. Fails with `what` when it does not come."""
    deadline = time.monotonic() + timeout
    while not (value := condition()):
        assert time.monotonic() < deadline, f"waited {timeout:g} s for {what}"
        time.sleep(0.02)
    return value


class Bridge:
    """A UDP port that keeps every datagram that comes, as a bridge system would listen; `port` is its number."""

    def __init__(self) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self._socket.settimeout(0.2)
        self.port = self._socket.getsockname()[1]
        self.heard: list[str] = []
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()

    def _listen(self) -> None:
        while not self._ending.is_set():
            with contextlib.suppress(TimeoutError):
                self.heard.append(self._socket.recv(2000).decode("ascii"))

    def close(self) -> None:
        """Listen no more."""
        self._ending.set()
        self._thread.join(5.0)
        self._socket.close()


def ns(stamp: Any) -> int:
    """Nanoseconds of a ROS time."""
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def by_stamp(bag: Path, topic: str) -> dict[int, Any]:
    """Messages of a topic of a bag by header stamp."""
    with BagReader(bag) as reader:
        return {ns(message.header.stamp): message for _, _, message in reader.read([topic])}


SETTLED_ANGLES_DEG = ("latitude", "longitude")


def settled_distance(a: Any, b: Any) -> float:
    """Law 2: largest |a - b| / max(1, |b|) of the fields of two settled states, SI units."""
    worst = 0.0
    for name in type(a).get_fields_and_field_types() if hasattr(type(a), "get_fields_and_field_types") else vars(a):
        if name in ("header", "sequence") or name.startswith("__"):
            continue
        x, y = float(getattr(a, name)), float(getattr(b, name))
        if name in SETTLED_ANGLES_DEG:
            x, y = math.radians(x), math.radians(y)
        if not (math.isnan(x) and math.isnan(y)):
            worst = max(worst, abs(x - y) / max(1.0, abs(y)))
    return worst
