"""Node `navigator`: messages in, one call to the Navigator, messages out.

Lives here: subscriptions, publications and services; message fields are made in riins_node.fields.
Does not live here: any navigation (navigator.py). The wall clock decides one thing only: that there is no IMU.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from dataclasses import astuple
from functools import partial
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Odometry
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from sensor_msgs.msg import Imu, NavSatFix

from riins_core.frames import LocalFrame, flu_to_frd_covariance
from riins_msgs import msg, srv
from riins_node import convert, fields, qos
from riins_node.inputs import message_class, several_publishers
from riins_node.parameters import declare
from riins_node.runner import AutostartLifecycleNode, run

from .aid_inputs import AidInput, inputs
from .calibration import Calibrator
from .config import NodeConfig
from .navigator import Navigator
from .nodes.align_action import AlignPart
from .plain_imu import PlainImu
from .reporting import Grid, diagnosis, what_changed
from .types import Array, FederatedReport, InitialState, NavEvent, NavSolution, Reason, Recall, UseCommand

OUTPUTS: dict[str, tuple[type, Any]] = {
    "nav/state": (msg.NavState, qos.navigation),
    "nav/settled": (msg.NavState, qos.navigation),
    "nav/inertial": (msg.NavState, qos.navigation),
    "nav/covariance": (msg.NavCovariance, qos.navigation),
    "nav/innovations": (msg.Innovation, qos.navigation),
    "nav/odometry": (Odometry, qos.navigation),
    "nav/fix": (NavSatFix, qos.navigation),
    "nav/origin": (NavSatFix, qos.latched),
    "nav/initial_state": (msg.InitialState, qos.latched),
    "nav/subfilters": (msg.FederatedStatus, qos.latched),
    "nav/commands": (msg.SensorUse, partial(qos.latched, 100)),
    "nav/calibration": (msg.InertialCalibration, qos.latched),
    "imu/data": (Imu, qos.navigation),
    "/diagnostics": (DiagnosticArray, qos.navigation),
}
EVENTS_KEPT = 10
"""In every FederatedStatus."""


class NavigatorNode(AutostartLifecycleNode):
    """The federated navigator as a lifecycle node."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("navigator", **kwargs)
        self._settings = declare(self, NodeConfig, also=["autostart"])
        self._fused = self._settings.imu_topic_type == "fused"
        self._imu_topic = "imu/fused" if self._fused else "imu/data_raw"
        self._aids = [(source, message_class(source.input.message, f'aid "{source.name}"')) for source in inputs(self._settings.aid)]
        self._inputs: list[Any] = []
        self._told: set[tuple[Any, ...]] = set()  # commands we have published, which come back

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Compile, publish, subscribe, in this order: a sample must not wait for the compiler."""
        settings = self._settings
        Navigator.warm_up()
        self._navigator, self._calibrator = Navigator(settings), Calibrator(settings)
        self._datum = (*np.radians(settings.datum[:2]).tolist(), settings.datum[2]) if settings.datum else None
        self._frame: LocalFrame | None = None
        self._state_grid, self._odometry_grid, self._second = Grid(settings.state_period_s), Grid(settings.odometry_period_s), Grid(1.0)
        self._report: FederatedReport | None = None
        self._events: list[NavEvent] = []
        self._news = False
        self._without_covariance: set[str] = set()
        self._sequence = self._settled_sequence = self._refused = 0
        self._last_wall = time.monotonic()
        self._plain = PlainImu(settings.imu_rate_hz, settings.imu_values == "instant", settings.max_delay_s)
        self._published = {
            name: self.create_publisher(kind, name, profile(), qos_overriding_options=qos.overridable()) for name, (kind, profile) in OUTPUTS.items()
        }
        take = partial(self.create_subscription, qos_overriding_options=qos.overridable())
        self._inputs = [
            take(msg.FusedImu, "imu/fused", self._on_imu, qos.imu()) if self._fused else take(Imu, "imu/data_raw", self._on_plain_imu, qos.imu()),
            take(msg.InitialState, "nav/initial_state", self._on_initial_state, qos.latched(10)),
            take(msg.SensorUse, "nav/commands", self._on_command, qos.latched(100)),
            *(take(kind, source.topic, partial(self._on_aid, source), qos.aid()) for source, kind in self._aids),
        ]
        self._offered = [
            self.create_service(srv.SetInitialState, "~/set_initial_state", self._set_initial_state),
            self.create_service(srv.SetSensorUse, "~/set_sensor_use", self._set_sensor_use),
        ]
        self._align = AlignPart(self, self._navigator, settings)
        self._watch = self.create_timer(0.5, self._watch_inputs)
        return TransitionCallbackReturn.SUCCESS

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Undo on_configure."""
        self._align.destroy()
        for subscription in self._inputs:
            self.destroy_subscription(subscription)
        for service in self._offered:
            self.destroy_service(service)
        for publisher in self._published.values():
            self.destroy_publisher(publisher)
        self.destroy_timer(self._watch)
        self._inputs = []
        return TransitionCallbackReturn.SUCCESS

    def _publish(self, name: str, content: dict[str, Any]) -> None:
        self._published[name].publish(convert.fill(OUTPUTS[name][0], content))

    # ---- input ----

    def _on_imu(self, message: Any) -> None:
        if not self.active:
            return
        self._last_wall = time.monotonic()
        sample = convert.read_fused_imu(message)
        stamp, onset = sample["stamp_ns"], sample["recall_onset_ns"]
        recalls = [Recall(stamp, onset, sample["angle_recall"], sample["velocity_recall"])] if onset else []
        noise = _frd(message.angular_velocity_covariance), _frd(message.linear_acceleration_covariance)
        self._navigator.add_imu(
            np.array([stamp]), np.array([sample["sequence"]]), sample["rate"][None], sample["force"][None], recalls, noise[0][None], noise[1][None]
        )
        solution = self._navigator.head()
        if solution is not None and solution.stamp_ns == sample["stamp_ns"]:
            self._publish_head(solution, *noise)
        self._publish_settled()
        self._publish_status(sample["stamp_ns"])

    def _on_plain_imu(self, message: Any) -> None:
        """An ordinary IMU: what it says becomes what the fusion would say of it."""
        if not self.active:
            return
        reading = convert.read_imu(message)
        sequence, rate, force = self._plain.take(reading["stamp_ns"], reading["rate"], reading["force"])
        covariances = reading["rate_covariance"], reading["force_covariance"]
        self._on_imu(convert.fill(msg.FusedImu, fields.fused_imu(reading["stamp_ns"], sequence, rate, force, *covariances, 7, 7)))

    def _on_aid(self, source: AidInput, message: Any) -> None:
        aid, name = source.read(message) if self.active else None, source.name
        if aid is None:
            return
        if not aid.R.any() and name not in self._without_covariance:
            self._without_covariance.add(name)
            self.get_logger().warning(f"{name} reports no covariance: its configured sigma is used")
        reason = self._navigator.add_aid(aid, self._navigator.newest_ns)
        if reason not in (Reason.NONE, Reason.NO_FIX):
            self.get_logger().warning(f"{name}: measurement dropped ({reason.name.lower()})", throttle_duration_sec=10.0)

    def _on_initial_state(self, message: Any) -> None:
        if self.active:
            problem = self._navigator.set_initial_state(InitialState(**convert.read_initial_state(message)))
            if problem:
                self._refused += 1
                self.get_logger().warning(f"initial state refused: {problem}")

    def _on_command(self, message: Any) -> None:
        """A command of a recording that is played."""
        command = UseCommand(**convert.read_sensor_use(message))
        if self.active and astuple(command) not in self._told and not convert.is_for_fusion(command.name):
            problem = self._navigator.set_use(command)
            if problem:
                self.get_logger().warning(f"command to {message.target} refused: {problem}")

    def _set_initial_state(self, request: Any, response: Any) -> Any:
        response.message = self._navigator.set_initial_state(InitialState(**convert.read_initial_state(request.state)))
        response.success = not response.message
        if response.success:
            self._published["nav/initial_state"].publish(request.state)  # so that a recording can be navigated again
        return response

    def _set_sensor_use(self, request: Any, response: Any) -> Any:
        stamp = convert.to_ns(request.effective) or self._navigator.status().stamp_ns + 1
        command = UseCommand(request.target, request.use, stamp)
        response.message = self._navigator.set_use(command)
        response.success = not response.message
        if response.success:
            self._told.add(astuple(command))
            told = convert.fill(msg.SensorUse, fields.sensor_use(stamp, request.target, request.use))
            self._published["nav/commands"].publish(told)  # so that a recording can be navigated again
        return response

    # ---- output ----

    def _publish_head(self, solution: NavSolution, rate_covariance: Array, force_covariance: Array) -> None:
        if self._frame is None:
            datum = self._datum or (solution.lat, solution.lon, solution.h)
            self._frame = LocalFrame(*datum)
            self._publish("nav/origin", fields.origin(solution.stamp_ns, *datum))
        if self._state_grid.due(solution.stamp_ns):
            self._publish("nav/state", fields.nav_state(solution, self._sequence))
            self._publish("imu/data", fields.imu(solution, rate_covariance, force_covariance))
            self._sequence += 1
        if self._odometry_grid.due(solution.stamp_ns):
            self._publish("nav/odometry", fields.odometry(solution, self._frame, rate_covariance))
            self._publish("nav/fix", fields.nav_fix(solution))

    def _publish_settled(self) -> None:
        for judged in self._navigator.drain_judged():
            self._publish("nav/innovations", fields.innovation(judged))
        solutions = self._navigator.drain_settled()
        for aligning in self._align.take(solutions):
            self._publish("nav/state", fields.nav_state(aligning, self._sequence))
            self._sequence += 1
        for settled in solutions:
            self._publish("nav/settled", fields.nav_state(settled, self._settled_sequence))
            if settled.inertial is not None:
                self._publish("nav/inertial", fields.nav_state(settled.inertial, self._settled_sequence))
            self._publish("nav/covariance", fields.nav_covariance(settled, self._navigator.labels))
            self._settled_sequence += 1
            for calibration in self._calibrator.take([settled]):
                self._publish("nav/calibration", fields.inertial_calibration(calibration))
        news = self._navigator.drain_events()
        self._events = [*self._events, *news][-EVENTS_KEPT:]
        self._news = bool(news)
        for event in news:
            self.get_logger().info(f"at {event.stamp_ns * 1e-9:.3f} s: {event.text}")

    def _publish_status(self, stamp_ns: int) -> None:
        report = self._navigator.status()
        changed = what_changed(self._report, report)
        if changed is None and not self._news and not self._second.due(stamp_ns):
            return
        self._report = report
        self._publish("nav/subfilters", fields.federated_status(report, changed or "", self._events))
        if self._second.now(stamp_ns):
            self._publish("/diagnostics", fields.diagnostics(stamp_ns, diagnosis(report, self._refused, self._navigator.commands_refused)))

    def _watch_inputs(self) -> None:
        if not self.active:
            return
        problems = several_publishers(self, [self._imu_topic, *{source.topic: None for source, _ in self._aids}])
        if time.monotonic() - self._last_wall > self._settings.imu_timeout_s:
            problems.append(f"no IMU: nothing on {self._imu_topic}")
        for line in problems:
            self.get_logger().warning(line, throttle_duration_sec=10.0)
        if problems:
            stamp = self.get_clock().now().nanoseconds
            self._publish("/diagnostics", fields.diagnostics(stamp, [("navigator: inputs", "error", line, {}) for line in problems]))


def _frd(covariance: Any) -> Array:
    return flu_to_frd_covariance(np.reshape(covariance, (3, 3)))


def main(args: Sequence[str] | None = None) -> int:
    """Entry point of `ros2 run riins_federated navigator`."""
    return run(NavigatorNode, args, "navigator")


if __name__ == "__main__":
    sys.exit(main())
