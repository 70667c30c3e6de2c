"""Node `nmea`: the navigation state out as NMEA 0183, sentences in as aids.

Lives here: parameters, subscriptions, publications, the thread's hand-over, diagnostics. The wall clock decides "no state" alone.
Does not live here: sentences (sentences.py), when they are due (schedule.py), judgement of what comes in (aids.py), sockets (links.py).
"""

from __future__ import annotations

import dataclasses
import math
import sys
import time
from collections import deque
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseWithCovarianceStamped, TwistWithCovarianceStamped
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from sensor_msgs.msg import NavSatFix

from riins_msgs.msg import AlignmentStatus, FederatedStatus, NavState, SubfilterStatus, VesselMotion
from riins_nmea import messages, sentences
from riins_nmea.aids import AidReader, Lines, Reading
from riins_nmea.config import NmeaConfig
from riins_nmea.links import LinkError, Receiver, Sender, SerialLines, parse_link
from riins_nmea.reporting import diagnosis, diagnosis_out
from riins_nmea.schedule import Schedule
from riins_node import convert, fields, qos
from riins_node.parameters import ParameterError, declare
from riins_node.runner import AutostartLifecycleNode, StartError, run

FUSED = (SubfilterStatus.HEALTHY, SubfilterStatus.SUSPECT)
_STATUS_AGE_NS = 5_000_000_000  # the navigator repeats it every second
_ALIGNMENT_AGE_S = 5.0
_TYPES: dict[str, tuple[type, Callable[[Reading, str], fields.Fields]]] = {
    "position": (NavSatFix, messages.nav_sat_fix),
    "velocity": (TwistWithCovarianceStamped, messages.ground_velocity),
    "log": (TwistWithCovarianceStamped, messages.body_velocity),
    "water_log": (TwistWithCovarianceStamped, messages.body_velocity),
    "heading": (PoseWithCovarianceStamped, messages.heading_pose),
}


class NmeaNode(AutostartLifecycleNode):
    """The bridge as a lifecycle node."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("nmea", **kwargs)
        self._config = declare(self, NmeaConfig, also=["autostart"])
        self._lines = SerialLines()
        self._receiver: Receiver | None = None
        self._senders: list[Sender] = []
        self._arrived: deque[tuple[str, bytes, bool, int]] = deque()
        self._bell = self.create_guard_condition(self._take_in)

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Open the links, publish, then subscribe."""
        config = self._config
        if not config.outputs and not config.inputs:
            raise ParameterError('nothing to do: give "outputs" (udp://HOST:PORT, serial:///dev/NAME?baud=N) or "inputs"')
        self._lines, self._senders = SerialLines(), []
        self._parts: dict[str, Lines] = {}
        try:
            self._reader = AidReader(config) if config.inputs else None
            for text in config.outputs:
                self._senders.append(Sender(parse_link(text, output=True), self._lines))
            if config.inputs:
                self._receiver = Receiver([parse_link(text, output=False) for text in config.inputs], self._lines, self._arrive)
        except (LinkError, ImportError) as error:
            self._close()
            raise StartError(str(error) if isinstance(error, LinkError) else "pynmeagps is missing: pip install pynmeagps") from None
        self._connect(config)
        return TransitionCallbackReturn.SUCCESS

    def _connect(self, config: NmeaConfig) -> None:
        override = qos.overridable()
        self._form = sentences.Form(**{field.name: getattr(config, field.name) for field in dataclasses.fields(sentences.Form)})
        self._schedule = Schedule(dataclasses.asdict(config.rate_hz), config.heave_wait_s)
        self._pictures: dict[int, sentences.Picture] = {}
        self._motion_heard, self._status = False, (0, False)
        self._aligning = (-math.inf, 0)
        self._water: tuple[int, tuple[float, float]] | None = None
        self._heard, self._newest_ns = time.monotonic(), 0
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", qos.navigation(), qos_overriding_options=override)
        self._aids: dict[str, tuple[Any, type, Callable[[Reading, str], fields.Fields], str]] = {}
        for aid in config.wanted:
            settings, (kind, make) = getattr(config, aid), _TYPES[aid]
            frame = getattr(settings, "frame_id", fields.MAP)
            publisher = self.create_publisher(kind, settings.topic, qos.aid(), qos_overriding_options=override)
            self._aids[aid] = (publisher, kind, make, frame)
        take = partial(self.create_subscription, qos_overriding_options=override)
        self._ends: list[Any] = []
        if config.outputs:
            self._ends = [
                take(NavState, "nav/state", self._on_state, qos.navigation()),
                take(VesselMotion, "nav/motion", self._on_motion, qos.navigation()),
                take(FederatedStatus, "nav/subfilters", self._on_status, qos.latched()),
                take(AlignmentStatus, "nav/alignment", self._on_alignment, qos.latched()),
            ]
        self._clocks = [self.create_timer(1.0, self._diagnose), self.create_timer(0.05, self._watch)]

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """The time-out for "no state" counts from here."""
        self._heard = time.monotonic()
        return super().on_activate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Undo on_configure."""
        self._close()
        for timer in self._clocks:
            self.destroy_timer(timer)
        for subscription in self._ends:
            self.destroy_subscription(subscription)
        for publisher in (self._diagnostics, *(one[0] for one in self._aids.values())):
            self.destroy_publisher(publisher)
        return TransitionCallbackReturn.SUCCESS

    def destroy_node(self) -> None:
        """Close sockets and lines with the node."""
        self._close()
        super().destroy_node()

    def _close(self) -> None:
        if self._receiver is not None:
            self._receiver.close()
            self._receiver = None
        for sender in self._senders:
            sender.close()
        self._lines.close()

    # ---- out ----

    def _on_state(self, message: Any) -> None:
        if not self.active:
            return
        self._heard = time.monotonic()
        stamp = self._newest_ns = convert.to_ns(message.header.stamp)
        names = self._schedule.due(stamp)
        if names:
            gnss = self._status[1] and abs(stamp - self._status[0]) <= _STATUS_AGE_NS
            near = self._water is not None and abs(stamp - self._water[0]) <= self._config.max_age_s * 1e9
            now = sentences.picture(
                convert.read_nav_state(message), self._config.reference_point_m, gnss, None, self._water[1] if near and self._water else None
            )
            if "pashr" in names and self._motion_heard:
                names.remove("pashr")
                self._schedule.wait(stamp)
                self._pictures[stamp] = now
            self._send(now, names)
        self._send_waiting()

    def _on_motion(self, message: Any) -> None:
        if self.active:
            self._motion_heard = True
            valid = message.heave_validity != VesselMotion.INVALID
            self._schedule.motion(convert.to_ns(message.header.stamp), message.heave if valid else None)
            self._send_waiting()

    def _on_status(self, message: Any) -> None:
        fused = any(sub.name in self._config.gnss_aids and sub.state in FUSED for sub in message.subfilters)
        self._status = (convert.to_ns(message.header.stamp), fused)

    def _on_alignment(self, message: Any) -> None:
        under_way = message.phase in (AlignmentStatus.COARSE, AlignmentStatus.FINE)
        self._aligning = (time.monotonic(), message.code if under_way else 0)

    def _send_waiting(self) -> None:
        for stamp, heave in self._schedule.ready(self._newest_ns):
            self._send(dataclasses.replace(self._pictures.pop(stamp), heave=heave), ["pashr"])

    def _send(self, now: sentences.Picture, names: Sequence[str]) -> None:
        lines = [sentences.SENTENCES[name](now, self._form) for name in names]
        for sender in self._senders:
            sender.send(lines)

    def _watch(self) -> None:
        """Without a state for too long, sentences that say so go out at their rates; their time is that of now."""
        silent = time.monotonic() - self._heard
        if self.active and self._senders and silent > self._config.state_timeout_s:
            now = self._newest_ns + round(silent * 1e9) if self._newest_ns else self.get_clock().now().nanoseconds
            heard, code = self._aligning
            aligning = code if time.monotonic() - heard <= _ALIGNMENT_AGE_S else 0
            self._send(sentences.Picture(now, aligning=aligning), self._schedule.due(now))

    # ---- in ----

    def _arrive(self, source: str, data: bytes, end: bool) -> None:
        """In the receiver's thread: keep the time of arrival, wake the executor."""
        self._arrived.append((source, data, end, self.get_clock().now().nanoseconds))
        self._bell.trigger()

    def _take_in(self) -> None:
        while self._arrived:
            source, data, end, arrival_ns = self._arrived.popleft()
            if self.active and self._reader is not None:
                for line in self._parts.setdefault(source, Lines()).feed(data, end):
                    for reading in self._reader.read(line, arrival_ns):
                        self._publish(reading)

    def _publish(self, reading: Reading) -> None:
        if reading.aid == "water_log":
            self._water = (reading.stamp_ns, (float(reading.z[0]), float(reading.z[1])))
        publisher, kind, make, frame = self._aids[reading.aid]
        publisher.publish(convert.fill(kind, make(reading, frame)))

    def _diagnose(self) -> None:
        if not self.active:
            return
        statuses = [diagnosis_out(sender, time.monotonic() - self._heard > self._config.state_timeout_s) for sender in self._senders]
        if self._reader is not None:
            problems: list[str] = self._receiver.problems if self._receiver is not None else []
            statuses += diagnosis(self._reader, problems, sum(part.too_long for part in self._parts.values()))
        for name, level, text, _ in statuses:
            if level != "ok":
                self.get_logger().warning(f"{name}: {text}", throttle_duration_sec=10.0)
        self._diagnostics.publish(convert.fill(DiagnosticArray, fields.diagnostics(self.get_clock().now().nanoseconds, statuses)))


def main(args: Sequence[str] | None = None) -> int:
    """Entry point of `ros2 run riins_nmea nmea`."""
    return run(NmeaNode, args, "nmea")


if __name__ == "__main__":
    sys.exit(main())
