"""Node `recorder`: every topic of the graph, as raw CDR, into a bag.

Lives here: discovery, raw subscriptions that match what is offered, diagnostics, a clean end.
Does not live here: the writing (recording.Spool, BagWriter) and the settings (recording.RecorderConfig).
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.executors import ExternalShutdownException
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from rclpy.subscription import Subscription

from riins_bag import qos
from riins_bag.bag import BagError, BagWriter
from riins_bag.nodes.profiles import from_profile, message_class, to_profile
from riins_bag.qos import Qos
from riins_bag.recording import Counter, RecorderConfig, Spool, selected
from riins_node.parameters import ParameterError, declare
from riins_node.runner import AutostartLifecycleNode, StartError, run


class Recorder(AutostartLifecycleNode):
    """Records while active; the bag is made on configure and closed on cleanup, shutdown or the end of the process."""

    def __init__(self) -> None:
        super().__init__("recorder")
        self.config = declare(self, RecorderConfig)
        self.path = Path(self.config.path or datetime.now().strftime("riins_%Y%m%d_%H%M%S"))
        self.spool: Spool | None = None
        self.status = 0
        self._subscribed: dict[str, tuple[Qos, Subscription, str]] = {}
        self._offered: dict[str, int] = {}
        self._counters: dict[str, Counter] = {}
        self._refused: set[str] = set()
        self._timers_made: list[Any] = []
        self._began = self._reported = time.monotonic()

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        if self.path.exists():
            raise ParameterError(f'parameter "path": {self.path} exists already; choose another name or remove it')
        try:
            text = Path(self.config.configuration_file).read_text(encoding="utf-8") if self.config.configuration_file else None
        except (OSError, UnicodeDecodeError) as error:
            raise ParameterError(f'parameter "configuration_file": {error}') from None
        try:
            writer = BagWriter(self.path, flush_period_s=0.0, chunk_bytes=self.config.chunk_bytes, level=self.config.compression_level)
            if text is not None:
                writer.write_configuration(text, time.time_ns())
                writer.flush()
        except BagError as error:
            raise StartError(str(error)) from None
        self.spool = Spool(writer, self.config.flush_period_s)
        self._began = self._reported = time.monotonic()
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self._timers_made = [
            self.create_timer(self.config.discovery_period_s, self._discover),
            self.create_timer(1.0, self._report),
            self.create_timer(0.1, self._check),
        ]
        self._discover()
        self.get_logger().info(f"recording into {self.path}")
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        for timer in self._timers_made:
            self.destroy_timer(timer)
        for _, subscription, _ in self._subscribed.values():
            self.destroy_subscription(subscription)
        self._timers_made.clear()
        self._subscribed.clear()
        self._offered.clear()
        self.destroy_publisher(self._diagnostics)
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        self.finish()
        return super().on_cleanup(state)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        self.finish()
        return super().on_shutdown(state)

    def destroy_node(self) -> None:
        """Close the bag, then the node: the runner calls this however the process ends."""
        self.finish()
        super().destroy_node()

    def finish(self) -> None:
        """Close the bag and say in one line where it is; a second call does nothing."""
        spool, self.spool = self.spool, None
        if spool is None:
            return
        spool.close()
        writer = spool.writer
        start, end = writer.span_ns
        lost = sum(counter.lost for counter in self._counters.values())
        words = f"{sum(writer.counts.values())} messages, {(end - start) * 1e-9:.1f} s, {writer.bytes_written / 1e6:.2f} MB, {lost} lost"
        if spool.failure is not None:
            self.status = 1
            print(f"recorder: error: {spool.failure}", file=sys.stderr, flush=True)
        else:
            print(f"recorder: {self.path}: {words}", flush=True)

    def _discover(self) -> None:
        for topic, types in self.get_topic_names_and_types():
            if topic in self._refused or not selected(topic, self.config.topics, self.config.exclude):
                continue
            number = self.count_publishers(topic)
            if number == self._offered.get(topic, 0):
                continue  # asking for the profiles costs ten times as much
            self._offered[topic] = number
            offers = [from_profile(info.qos_profile) for info in self.get_publishers_info_by_topic(topic)]
            if offers:
                self._subscribe(topic, types, offers)

    def _subscribe(self, topic: str, types: Sequence[str], offers: list[Qos]) -> None:
        wanted = qos.request(offers, self.config.depth)
        known = self._subscribed.get(topic)
        if known is not None:
            asked = known[0]
            if (asked.reliability, wanted.reliability) != ("reliable", "best_effort") and (asked.durability, wanted.durability) != (
                "transient_local",
                "volatile",
            ):
                return  # what is asked for matches the new publisher too
            self.get_logger().warning(f"{topic}: a publisher offers {wanted.reliability}, {wanted.durability}: subscribing anew")
            self.destroy_subscription(self._subscribed.pop(topic)[1])
        msgtype = known[2] if known else types[0]
        try:
            if len(types) > 1 and not known:
                self.get_logger().warning(f"{topic} has the types {', '.join(types)}: only {msgtype} is recorded")
            kind = message_class(msgtype)
            if self.spool is not None and known is None:
                self.spool.announce(topic, msgtype, offers)
        except (ImportError, BagError) as error:
            self._refused.add(topic)
            self.get_logger().warning(f"{topic} is not recorded: {error}")
            return
        callback = self._writer_of(topic, msgtype)
        self._subscribed[topic] = (wanted, self.create_subscription(kind, topic, callback, to_profile(wanted), raw=True), msgtype)

    def _writer_of(self, topic: str, msgtype: str) -> Callable[[bytes, dict[str, Any]], None]:
        counter = self._counters.setdefault(topic, Counter())

        def take(data: bytes, info: dict[str, Any]) -> None:
            if self.spool is None:
                return
            now = info.get("received_timestamp") or time.time_ns()
            number = info.get("publication_sequence_number")
            counter.take(number, self._offered.get(topic) == 1)
            self.spool.put(topic, msgtype, data, now, info.get("source_timestamp") or now, number)

        return take

    def _check(self) -> None:
        if self.spool is not None and self.spool.failure is not None:
            raise ExternalShutdownException  # `finish` says why; the status is 1

    def _report(self) -> None:
        if self.spool is None:
            return
        now = time.monotonic()
        elapsed, self._reported = now - self._reported, now
        lost = sum(counter.lost for counter in self._counters.values())
        values = {
            "bag": str(self.path),
            "duration_s": f"{now - self._began:.1f}",
            "messages": str(sum(counter.received for counter in self._counters.values())),
            "lost": str(lost),
            "bytes_written": str(self.spool.writer.bytes_written),
            "bytes_waiting": str(self.spool.waiting_bytes),
            "topics": str(len(self._subscribed)),
        }
        for topic, counter in sorted(self._counters.items()):
            values[f"rate_hz {topic}"] = f"{counter.rate(elapsed):.1f}"
            values[f"count {topic}"] = str(counter.received)
        level = DiagnosticStatus.WARN if lost else DiagnosticStatus.OK
        status = DiagnosticStatus(
            level=level,
            name="recorder: bag",
            message=f"recording, {lost} messages lost" if lost else "recording",
            hardware_id="",
            values=[KeyValue(key=key, value=value) for key, value in values.items()],
        )
        message = DiagnosticArray(status=[status])
        message.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(message)


def main(args: Sequence[str] | None = None) -> int:
    """Entry point of `ros2 run riins_bag recorder`; returns the exit status."""
    made: list[Recorder] = []

    def factory() -> Recorder:
        made.append(Recorder())
        return made[0]

    status = run(factory, args, "recorder")
    return max([status, *(node.status for node in made)])


if __name__ == "__main__":
    sys.exit(main())
