"""Node `motion`: heave and attitude of a point of the ship at the rate of the navigator's state.

Lives here: parameters, subscription, publication, diagnostics.
Does not live here: heave and validity (motion.py, heave.py).
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn

from riins_msgs.msg import NavState, VesselMotion
from riins_nmea.messages import vessel_motion
from riins_nmea.motion import INVALID, VALID, Motion, MotionConfig, MotionEstimator
from riins_node import convert, fields, qos
from riins_node.parameters import declare
from riins_node.runner import AutostartLifecycleNode, run

_WORDS = {VALID: "heave valid", INVALID: "heave invalid"}


class MotionNode(AutostartLifecycleNode):
    """Motion of one point as a lifecycle node."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("motion", **kwargs)
        self._config = declare(self, MotionConfig, also=["autostart"])

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Publish, then subscribe."""
        self._estimator = MotionEstimator(self._config)
        self._motion: Motion | None = None
        self._sequence = 0
        override = qos.overridable()
        self._out = self.create_publisher(VesselMotion, "nav/motion", qos.navigation(), qos_overriding_options=override)
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", qos.navigation(), qos_overriding_options=override)
        self._input = self.create_subscription(NavState, "nav/state", self._on_state, qos.navigation(), qos_overriding_options=override)
        self._timer = self.create_timer(1.0, self._diagnose)
        self.get_logger().info(f"heave is valid {self._estimator.settling_s:.0f} s after the navigator begins, at the earliest")
        return TransitionCallbackReturn.SUCCESS

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Undo on_configure."""
        self.destroy_timer(self._timer)
        self.destroy_subscription(self._input)
        for publisher in (self._out, self._diagnostics):
            self.destroy_publisher(publisher)
        return TransitionCallbackReturn.SUCCESS

    def _on_state(self, message: Any) -> None:
        if not self.active:
            return
        motion = self._estimator.add(convert.read_nav_state(message))
        if motion is None:
            return
        if self._motion is not None and motion.heave_validity != self._motion.heave_validity:
            self.get_logger().info(f"at {motion.stamp_ns * 1e-9:.3f} s: {_WORDS.get(motion.heave_validity, 'heave doubtful')}")
        self._motion = motion
        self._out.publish(convert.fill(VesselMotion, vessel_motion(motion, self._sequence)))
        self._sequence += 1

    def _diagnose(self) -> None:
        if not self.active:
            return
        motion, estimator = self._motion, self._estimator
        values: dict[str, Any] = {
            "states": estimator.received,
            "states dropped": estimator.dropped,
            **{f"restarts: {k}": v for k, v in estimator.restarts.items()},
        }
        level, word = "warn", "no nav/state yet"
        if motion is not None:
            values |= {"heave [m]": f"{motion.heave:.3f}", "sigma [m]": f"{motion.sigma_heave:.3f}"}
            level, word = "ok" if motion.heave_validity == VALID else "warn", _WORDS.get(motion.heave_validity, "heave doubtful")
        status = [("motion", level, word, values)]
        self._diagnostics.publish(convert.fill(DiagnosticArray, fields.diagnostics(self.get_clock().now().nanoseconds, status)))


def main(args: Sequence[str] | None = None) -> int:
    """Entry point of `ros2 run riins_nmea motion`."""
    return run(MotionNode, args, "motion")


if __name__ == "__main__":
    sys.exit(main())
