"""Node `imu_fusion`: redundant samples in, one call to the FusionPipeline, fused samples and health out.

Lives here: parameters, subscription, publications, service, diagnostics.
Does not live here: any mathematics (pipeline.py) or message layout (riins_node.fields, reporting.py). The wall clock decides "no IMU" alone.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from sensor_msgs.msg import Imu

from riins_core.settings import setting
from riins_imu_fusion.config import FusionConfig
from riins_imu_fusion.pipeline import FusionPipeline
from riins_imu_fusion.reporting import diagnosis, inertial_fdi
from riins_imu_fusion.types import FusedBlock
from riins_msgs.msg import FusedImu, FusionMethod, InertialCalibration, InertialFdi, RedundantImu, SensorUse
from riins_msgs.srv import SetFusionMethod, SetSensorUse
from riins_node import convert, fields, qos
from riins_node.inputs import several_publishers
from riins_node.parameters import declare
from riins_node.runner import AutostartLifecycleNode, run

OUTPUTS: dict[str, tuple[type, Any]] = {
    "imu/fused": (FusedImu, qos.imu),
    "imu/data_raw": (Imu, qos.imu),
    "fdi/status": (InertialFdi, qos.latched),
    "nav/commands": (SensorUse, partial(qos.latched, 100)),
    "fdi/method": (FusionMethod, partial(qos.latched, 100)),
    "/diagnostics": (DiagnosticArray, qos.navigation),
}


BY_SERVICE = ("method", "parity_test", "sequential_test", "adapt_noise")
"""Parameters that say what the node starts with; while it runs a service changes it."""


@dataclass(frozen=True)
class NodeConfig(FusionConfig):
    """Parameters of the node: those of the fusion, and when it says that there is no IMU."""

    imu_timeout_s: float = setting(1.0, "wall time without a sample after which the node says that there is no IMU", "s", 0.05, 100.0)


class ImuFusionNode(AutostartLifecycleNode):
    """The fusion of redundant inertial sensors as a lifecycle node."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("imu_fusion", **kwargs)
        self._config = declare(self, NodeConfig, also=["autostart"], services=dict.fromkeys(BY_SERVICE, "~/set_fusion_method"))

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Compile, publish, subscribe, in this order: a sample must not wait for the compiler."""
        self._pipeline = FusionPipeline(self._config, statuses=True)
        self._pipeline.warm_up()
        self._heard = time.monotonic()
        self._published = {
            name: self.create_publisher(kind, name, profile(), qos_overriding_options=qos.overridable()) for name, (kind, profile) in OUTPUTS.items()
        }
        self._input = self.create_subscription(RedundantImu, "rimu/raw", self._on_sample, qos.imu(), qos_overriding_options=qos.overridable())
        self._told: set[tuple[Any, ...]] = set()  # what we have published, which comes back
        self._commands = self.create_subscription(
            SensorUse, "nav/commands", self._on_command, qos.latched(100), qos_overriding_options=qos.overridable()
        )
        self._methods = self.create_subscription(
            FusionMethod, "fdi/method", self._on_method, qos.latched(100), qos_overriding_options=qos.overridable()
        )
        self._calibrations = self.create_subscription(
            InertialCalibration, "nav/calibration", self._on_calibration, qos.latched(), qos_overriding_options=qos.overridable()
        )
        self._offered = [
            self.create_service(SetSensorUse, "~/set_sensor_use", self._set_sensor_use),
            self.create_service(SetFusionMethod, "~/set_fusion_method", self._set_fusion_method),
        ]
        self._tell_method(0)
        self._timer = self.create_timer(1.0, self._diagnose)
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Begin to listen; the time-out for "no IMU" counts from here."""
        self._heard = time.monotonic()
        return super().on_activate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Undo on_configure."""
        self.destroy_timer(self._timer)
        for service in self._offered:
            self.destroy_service(service)
        self.destroy_subscription(self._input)
        self.destroy_subscription(self._commands)
        self.destroy_subscription(self._methods)
        self.destroy_subscription(self._calibrations)
        for publisher in self._published.values():
            self.destroy_publisher(publisher)
        return TransitionCallbackReturn.SUCCESS

    def _publish(self, name: str, content: dict[str, Any]) -> None:
        self._published[name].publish(convert.fill(OUTPUTS[name][0], content))

    def _on_sample(self, message: Any) -> None:
        if not self.active:
            return
        self._heard = time.monotonic()
        sample = convert.read_redundant_imu(message)
        gyro, accel = sample["gyro"], sample["accel"]
        if gyro.size == accel.size == self._pipeline.n:
            block = self._pipeline.process(
                [sample["stamp_ns"]], [sample["sequence"]], gyro[None], accel[None], [sample["gyro_valid"]], [sample["accel_valid"]]
            )
            if len(block):
                self._publish_fused(block)
        else:
            self._pipeline.reject_length(sample["stamp_ns"], sample["sequence"], gyro.size, accel.size)
        self._report()

    def _publish_fused(self, block: FusedBlock) -> None:
        stamp_ns, gyro_used, accel_used = int(block.stamp_ns[0]), int(block.gyro_used[0]), int(block.accel_used[0])
        rate_covariance = self._pipeline.rate_covariance(gyro_used) + block.gyro_excess[0]
        force_covariance = self._pipeline.force_covariance(accel_used) + block.accel_excess[0]
        rate, force, gyro_drift, accel_drift = block.rate[0], block.force[0], block.gyro_drift[0], block.accel_drift[0]
        angle, velocity, onset = (recalled[0] for recalled in block.recalled())
        fused = fields.fused_imu(
            stamp_ns, int(block.sequence[0]), rate, force, rate_covariance, force_covariance, gyro_used, accel_used, gyro_drift, accel_drift,
            angle_recall=angle, velocity_recall=velocity, recall_onset_ns=int(onset),
        )  # fmt: skip
        self._publish("imu/fused", fused)
        self._publish("imu/data_raw", fields.imu_raw(stamp_ns, rate, force, rate_covariance, force_covariance))

    def _report(self) -> None:
        for status in self._pipeline.drain_statuses():
            self._publish("fdi/status", inertial_fdi(status))
        for event in self._pipeline.drain_events():
            self.get_logger().info(f"at {event.stamp_ns * 1e-9:.3f} s: {event.text}")

    def _on_command(self, message: Any) -> None:
        """A command of a recording that is played."""
        command = (message.target, message.use, convert.to_ns(message.header.stamp))
        if self.active and command not in self._told and convert.is_for_fusion(message.target):
            result = self._pipeline.set_sensor_use(*command)
            if not result.success:
                self.get_logger().warning(f"command refused: {result.message}")

    def _set_sensor_use(self, request: Any, response: Any) -> Any:
        result = self._pipeline.set_sensor_use(request.target, request.use, convert.to_ns(request.effective))
        response.success, response.message = result.success, result.message
        if result.success:
            self._told.add((request.target, request.use, result.effective_ns))
            self._publish("nav/commands", fields.sensor_use(result.effective_ns, request.target, request.use))  # for navigating a recording again
        return response

    def _on_method(self, message: Any) -> None:
        """A selection of a recording that is played."""
        selection = convert.read_fusion_method(message)
        if self.active and tuple(selection.values()) not in self._told:
            result = self._pipeline.set_method(**selection)
            if not result.success:
                self.get_logger().warning(f"selection refused: {result.message}")

    def _on_calibration(self, message: Any) -> None:
        if self.active:
            self._pipeline.add_calibration(**convert.read_inertial_calibration(message))

    def _set_fusion_method(self, request: Any, response: Any) -> Any:
        result = self._pipeline.set_method(
            request.fusion, request.parity_test, request.sequential_test, request.adapt_noise, convert.to_ns(request.effective)
        )
        response.success, response.message = result.success, result.message
        if result.success:
            self._tell_method(result.effective_ns)
        return response

    def _tell_method(self, stamp_ns: int) -> None:
        """Publish what is selected from a stamp on, so that a recording can be navigated again."""
        selected = self._pipeline.selected(stamp_ns)
        self._told.add((*selected, stamp_ns))
        self._publish("fdi/method", fields.fusion_method(stamp_ns, selected))

    def _diagnose(self) -> None:
        if not self.active:
            return
        alive = time.monotonic() - self._heard <= self._config.imu_timeout_s
        if not alive:
            self.get_logger().warning("no IMU: nothing on rimu/raw", throttle_duration_sec=10.0)
        statuses = diagnosis(self._pipeline.status(), alive, self._pipeline.selected())
        for line in several_publishers(self, ["rimu/raw"]):
            self.get_logger().warning(line, throttle_duration_sec=10.0)
            statuses.append(("imu_fusion: inputs", "error", line, {}))
        self._publish("/diagnostics", fields.diagnostics(self.get_clock().now().nanoseconds, statuses))


def main(args: Sequence[str] | None = None) -> int:
    """Entry point of `ros2 run riins_imu_fusion imu_fusion`."""
    return run(ImuFusionNode, args, "imu_fusion")


if __name__ == "__main__":
    sys.exit(main())
