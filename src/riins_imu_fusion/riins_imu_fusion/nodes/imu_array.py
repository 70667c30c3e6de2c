"""Node `imu_array`: several ordinary IMUs in, one redundant IMU out.

Lives here: parameters, subscriptions, publications, diagnostics.
Does not live here: alignment (array_align.py), mounting (array_mounting.py), fault detection (imu_fusion). The wall clock decides "no IMU" alone.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from sensor_msgs.msg import Imu
from std_msgs.msg import String

from riins_core.frames import frd_to_flu
from riins_core.settings import setting
from riins_imu_fusion.array_align import ArrayAligner
from riins_imu_fusion.array_config import ArrayConfig
from riins_imu_fusion.array_mounting import MountingEstimator
from riins_imu_fusion.array_reporting import Changes, diagnosis, parameter_file, redundancy
from riins_msgs.msg import RedundantImu
from riins_node import convert, fields, qos
from riins_node.inputs import several_publishers
from riins_node.parameters import ParameterError, declare
from riins_node.runner import AutostartLifecycleNode, StartError, run


@dataclass(frozen=True)
class NodeConfig(ArrayConfig):
    """Parameters of the node: those of the array, and what it says when."""

    fusion_parameters_file: str = setting("", "write the parameters that imu_fusion needs for this array to this file; empty: to no file")
    imu_timeout_s: float = setting(1.0, "wall time without a sample after which the node says that there is no IMU", "s", 0.05, 100.0)


class ImuArrayNode(AutostartLifecycleNode):
    """Alignment of several IMUs as a lifecycle node."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("imu_array", **kwargs)
        self._config = declare(self, NodeConfig, also=["autostart"])

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Publish what is latched, then subscribe."""
        config = self._config
        if len({self.resolve_topic_name(topic) for topic in config.topics}) < config.n:  # imu and /imu: it would be taken for redundant
            raise ParameterError('parameter "topics" must be different topics')
        self._aligner = ArrayAligner(config)
        self._mounting = MountingEstimator(config) if config.n > 1 and config.mounting.estimate else None
        self._changes = Changes(self._aligner, self._mounting)
        self._heard = time.monotonic()
        text = parameter_file(config)
        if config.fusion_parameters_file:
            try:
                Path(config.fusion_parameters_file).write_text(text, encoding="utf-8")
            except OSError as error:
                raise StartError(f'"fusion_parameters_file" cannot be written: {error.strerror or error}') from None
        override = qos.overridable()
        self._out = self.create_publisher(RedundantImu, "rimu/raw", qos.imu(), qos_overriding_options=override)
        self._told = self.create_publisher(String, "rimu/fusion_parameters", qos.latched(), qos_overriding_options=override)
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", qos.navigation(), qos_overriding_options=override)
        self._told.publish(String(data=text))
        self._inputs = [
            self.create_subscription(Imu, topic, partial(self._on_imu, i), qos.imu(), qos_overriding_options=override)
            for i, topic in enumerate(config.topics)
        ]
        self._timer = self.create_timer(1.0, self._diagnose)
        self.get_logger().info(f"{redundancy(config.n)}; an output waits {self._aligner.hold_s:.3f} s at most")
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Begin to listen; the time-out for "no IMU" counts from here."""
        self._heard = time.monotonic()
        return super().on_activate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Undo on_configure."""
        self.destroy_timer(self._timer)
        for subscription in self._inputs:
            self.destroy_subscription(subscription)
        for publisher in (self._out, self._told, self._diagnostics):
            self.destroy_publisher(publisher)
        return TransitionCallbackReturn.SUCCESS

    def _on_imu(self, imu: int, message: Any) -> None:
        if not self.active:
            return
        self._heard = time.monotonic()
        reading = convert.read_imu(message)
        for sample in self._aligner.add(imu, reading["stamp_ns"], frd_to_flu(reading["rate"]), frd_to_flu(reading["force"])):
            if self._mounting is not None:
                self._mounting.add(sample)
                if self._config.mounting.apply:
                    sample = self._mounting.turned(sample)
            self._out.publish(convert.fill(RedundantImu, fields.redundant_imu(*sample)))

    def _diagnose(self) -> None:
        if not self.active:
            return
        for line in self._changes.drain():
            self.get_logger().info(line)
        statuses = diagnosis(self._aligner, self._mounting)
        if time.monotonic() - self._heard > self._config.imu_timeout_s:
            self.get_logger().warning("no IMU: nothing on any of the topics", throttle_duration_sec=10.0)
            statuses[0] = ("imu_array", "error", "no IMU: nothing on any of the topics", statuses[0][3])
        for line in several_publishers(self, [*self._config.topics, "rimu/raw"]):
            self.get_logger().warning(line, throttle_duration_sec=10.0)
            statuses.append(("imu_array: inputs", "error", line, {}))
        self._diagnostics.publish(convert.fill(DiagnosticArray, fields.diagnostics(self.get_clock().now().nanoseconds, statuses)))


def main(args: Sequence[str] | None = None) -> int:
    """Entry point of `ros2 run riins_imu_fusion imu_array`."""
    return run(ImuArrayNode, args, "imu_array")


if __name__ == "__main__":
    sys.exit(main())
