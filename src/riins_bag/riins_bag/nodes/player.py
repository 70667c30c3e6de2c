"""Node `player`: plays the raw topics of a bag into the graph, paced by log time.

Lives here: publishers as recorded, the wait for subscribers, pacing, /clock.
Does not live here: reading (BagReader) and the settings (recording.PlayerConfig).
"""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Sequence
from typing import Any

from rclpy.duration import Duration
from rclpy.executors import ExternalShutdownException
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from rosgraph_msgs.msg import Clock

from riins_bag import qos
from riins_bag.bag import BagError, BagReader, type_hash
from riins_bag.info import REDUNDANT_IMU
from riins_bag.nodes.profiles import message_class, to_profile
from riins_bag.recording import AHEAD_TOPICS, RAW_TOPICS, PlayerConfig, selected
from riins_core.settings import nearest
from riins_node.parameters import ParameterError, declare
from riins_node.runner import AutostartLifecycleNode, StartError, run

CLOCK_PERIOD_NS = 10_000_000  # recorded time between two messages on /clock
REMIND_S = 5.0
HEAD_START_S = 0.3  # of commands, which come on another topic than the samples: nothing but time puts the two in order
ACKNOWLEDGE_S = 5.0  # how long slow subscribers are waited for at the end


class Player(AutostartLifecycleNode):
    """Plays, while active, in a thread of its own, so that the executor stays free for services and signals."""

    def __init__(self) -> None:
        super().__init__("player")
        self.config = declare(self, PlayerConfig)
        self.trouble: Exception | None = None
        self.played = 0
        self._stop, self._done = threading.Event(), threading.Event()
        self._thread: threading.Thread | None = None
        self._bag: BagReader | None = None

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        self.bag = self._bag = self._open()
        self.topics = self._choose()
        self.wait_for = self._waited()
        self._senders = {topic: self._sender(topic) for topic in self.topics}
        self._clock_sender = self.create_publisher(Clock, "/clock", 10) if self.config.publish_clock else None
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        self._stop.clear()
        self._done.clear()
        self._thread = threading.Thread(target=self._work, name="player", daemon=True)
        self._thread.start()
        self._timer = self.create_timer(0.05, self._check)
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        self._halt()
        self.destroy_timer(self._timer)
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        for sender in [*self._senders.values(), *([self._clock_sender] if self._clock_sender else [])]:
            self.destroy_publisher(sender)
        self.bag.close()
        return super().on_cleanup(state)

    def destroy_node(self) -> None:
        """Stop playing, then destroy the node."""
        self._halt()
        if self._bag is not None:
            self._bag.close()
        super().destroy_node()

    def _halt(self) -> None:
        self._stop.set()
        if self._thread is not None:
            self._thread.join()
            self._thread = None

    def _open(self) -> BagReader:
        if not self.config.path:
            raise ParameterError('parameter "path" is missing: the bag directory to play')
        try:
            return BagReader(self.config.path, self.config.namespace)
        except BagError as error:
            raise ParameterError(f'parameter "path": {error}') from None

    def _choose(self) -> list[str]:
        patterns = self.config.topics or RAW_TOPICS
        chosen = sorted(topic for topic in self.bag.topics if selected(topic, patterns))
        if not chosen:
            raise ParameterError(
                f'parameter "topics": {self.config.path} has none of {", ".join(patterns)}; it has {", ".join(sorted(self.bag.topics))}'
            )
        # What is latched may stand long before the first sample, as the recorder starts first: playing begins with the sample.
        self._latched = [topic for topic in chosen if any(offer.durability == "transient_local" for offer in self.bag.qos(topic))]
        self._ahead = [topic for topic in chosen if topic in AHEAD_TOPICS]
        timed = set(chosen) - {*self._latched, *self._ahead}
        firsts = [self.bag.span_ns(topic)[0] for topic in timed if self.bag.topics[topic].number]
        self._begin_ns = min(firsts, default=self.bag.start_ns)
        length_s = (self.bag.end_ns - self._begin_ns) * 1e-9
        if self.config.start_offset_s > length_s:
            raise ParameterError(f'parameter "start_offset_s" is behind the end of the bag ({length_s:.3f} s)')
        return chosen

    def _waited(self) -> dict[str, int]:
        """Subscribers that a topic must have."""
        for topic in self.config.wait_for:
            if topic not in self.topics:
                raise ParameterError(f'parameter "wait_for": {topic} is not played{nearest(topic, self.topics)}')
        waited = self.config.wait_for or tuple(topic for topic in self.topics if self.bag.topics[topic].msgtype == REDUNDANT_IMU)
        numbers = self.config.subscribers or (1,) * len(waited)
        if len(numbers) != len(waited):
            raise ParameterError(f'parameter "subscribers" must have one number for each of {", ".join(waited)}, not {len(numbers)}')
        return dict(zip(waited, numbers, strict=True))

    def _sender(self, topic: str) -> Any:
        msgtype = self.bag.topics[topic].msgtype
        recorded = self.bag.channels()[topic].metadata.get("topic_type_hash", "")
        try:
            if recorded and recorded != type_hash(msgtype):
                raise StartError(f"{topic}: the definition of {msgtype} in the bag differs from the installed one")
            return self.create_publisher(message_class(msgtype), topic, to_profile(qos.replay(self.bag.qos(topic), self.config.depth)))
        except (ImportError, BagError) as error:
            raise StartError(f"{topic} cannot be played: {error}") from None

    def _work(self) -> None:
        try:
            if self._wait():
                self._play()
        except Exception as error:
            if self.context.ok():  # else a signal took the context away while this thread was publishing
                self.trouble = error  # handed to the executor's thread, which ends the process
        self._done.set()

    def _wait(self) -> bool:
        begin = reminded = time.monotonic()
        while not self._stop.wait(0.02):
            counts = {topic: self._senders[topic].get_subscription_count() for topic in self.wait_for}
            missing = [f"{topic} ({counts[topic]} of {number})" for topic, number in self.wait_for.items() if counts[topic] < number]
            if not missing:
                return True
            now = time.monotonic()
            if self.config.wait_timeout_s and now - begin > self.config.wait_timeout_s:
                raise StartError(f"not enough subscribers on {', '.join(missing)} after {self.config.wait_timeout_s:g} s")
            if now - reminded > REMIND_S:
                reminded = now
                self.get_logger().info(f"waiting for subscribers on {', '.join(missing)}")
        return False

    def _play(self) -> None:
        begin_ns = self._begin_ns + round(self.config.start_offset_s * 1e9)
        self.get_logger().info(f"playing {len(self.topics)} topics of {self.config.path} at rate {self.config.rate:g}")
        self._play_latched(begin_ns)
        while self._play_once(begin_ns) and self.config.loop:
            self.get_logger().info("end of the bag: beginning again")
        end = time.monotonic() + ACKNOWLEDGE_S
        for sender in self._senders.values():
            left = end - time.monotonic()
            if left > 0.0 and not self._stop.is_set():
                sender.wait_for_all_acked(Duration(seconds=left))
        self.get_logger().info(f"played {self.played} messages")

    def _play_latched(self, begin_ns: int) -> None:
        """Give late joiners' topics the message that held at the beginning, and those that hold from a stamp on all of them."""
        last = {message.topic: message.data for message in self.bag.messages(set(self._latched) - set(self._ahead), stop_ns=begin_ns)}
        for topic, data in last.items():
            self._senders[topic].publish(data)
        for message in self.bag.messages(self._ahead):
            self._senders[message.topic].publish(message.data)
        if self._ahead:
            self._stop.wait(HEAD_START_S)

    def _play_once(self, begin_ns: int) -> bool:
        origin = time.monotonic()
        clock_ns = 0
        for topic, _, data, log_ns in self.bag.messages(set(self.topics) - set(self._ahead), begin_ns):
            ahead = origin + (log_ns - begin_ns) * 1e-9 / self.config.rate - time.monotonic()
            if (ahead > 0.0 and self._stop.wait(ahead)) or self._stop.is_set():
                return False
            if self._clock_sender is not None and log_ns - clock_ns >= CLOCK_PERIOD_NS:
                clock_ns = log_ns
                message = Clock()
                message.clock.sec, message.clock.nanosec = divmod(log_ns, 1_000_000_000)
                self._clock_sender.publish(message)
            self._senders[topic].publish(data)
            self.played += 1
        return True

    def _check(self) -> None:
        if self._done.is_set():
            raise ExternalShutdownException


def main(args: Sequence[str] | None = None) -> int:
    """Entry point of `ros2 run riins_bag player`; returns the exit status."""
    made: list[Player] = []

    def factory() -> Player:
        made.append(Player())
        return made[0]

    status = run(factory, args, "player")
    for trouble in [node.trouble for node in made if node.trouble is not None and not status]:
        print(f"player: error: {trouble}", file=sys.stderr, flush=True)
        status = 1
    return status


if __name__ == "__main__":
    sys.exit(main())
