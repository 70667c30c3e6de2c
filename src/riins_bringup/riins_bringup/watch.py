"""The launcher's own node: sees which endpoints exist and feeds the monitor.

Lives here: `Watcher`, an rclpy node on its own thread and context.
Does not live here: what is done with the observations (monitor.py), starting and stopping (live.py).
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterable
from typing import Any

import rclpy
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions

from riins_bringup.graph import NodeSpec
from riins_bringup.monitor import Monitor, NavRow
from riins_eval.run_record import SENSOR_REASONS, SENSOR_STATES, SUBFILTER_REASONS, SUBFILTER_STATES
from riins_msgs.msg import FederatedStatus, InertialFdi, NavState

# deep, so that a busy terminal never makes the launcher report a loss that the navigator did not have
_QOS = QoSProfile(depth=2000)
_TRANSITIONS = {"configure": Transition.TRANSITION_CONFIGURE, "activate": Transition.TRANSITION_ACTIVATE}


class Watcher:
    """Observes one graph.

    Parameters
    ----------
    namespace : of the graph
    monitor : where observations go; None: only endpoints are looked at
    """

    def __init__(self, namespace: str = "", monitor: Monitor | None = None) -> None:
        self._context = rclpy.Context()
        # the launcher handles signals itself: it must outlive the nodes it stops
        rclpy.init(context=self._context, signal_handler_options=SignalHandlerOptions.NO)
        self.node = Node("riins_watch", namespace=namespace, context=self._context, start_parameter_services=False)
        self.monitor = monitor
        if monitor is not None:
            self._subscribe(NavState, "nav/state", self._nav_state)
            self._subscribe(NavState, "truth/state", self._truth_state)
            self._subscribe(InertialFdi, "fdi/status", self._fdi)
            self._subscribe(FederatedStatus, "nav/subfilters", self._subfilters)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._thread = threading.Thread(target=self._spin, name="riins_watch", daemon=True)
        self._thread.start()

    def __enter__(self) -> Watcher:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Leave the graph."""
        self._context.try_shutdown()
        self._thread.join(5.0)
        self.node.destroy_node()

    def missing(self, specs: Iterable[NodeSpec]) -> list[str]:
        """Endpoints that nodes should have and that are not there yet, one line each."""
        lines = []
        for spec in specs:
            for word, topics, seen in (
                ("subscribe to", spec.subscribes, self.node.get_subscriptions_info_by_topic),
                ("publish", spec.publishes, self.node.get_publishers_info_by_topic),
            ):
                lines += [f'node "{spec.name}" does not {word} {spec.topic(t)}' for t in topics if not _has(seen(spec.topic(t)), spec)]
        return lines

    def taken(self, specs: Iterable[NodeSpec], timeout: float) -> list[str]:
        """Topics that nodes, none of which runs yet, would publish and somebody publishes already, one line each; looks for `timeout` seconds."""
        topics, deadline = {spec.topic(name) for spec in specs for name in spec.publishes}, time.monotonic() + timeout
        while time.monotonic() < deadline:
            for topic in sorted(topics):
                if self.node.count_publishers(topic):
                    return [f"{topic} is already published"]
            time.sleep(0.05)
        return []

    def wait_for(self, specs: Iterable[NodeSpec], timeout: float, check: Callable[[], None] = lambda: None) -> list[str]:
        """Wait until every endpoint of the nodes exists.

        Parameters
        ----------
        specs : the nodes
        timeout : s
        check : called while waiting; may raise to give up

        Returns
        -------
        what is still missing after `timeout`, empty when all is there
        """
        specs, deadline = tuple(specs), time.monotonic() + timeout
        while (lines := self.missing(specs)) and time.monotonic() < deadline:
            check()
            time.sleep(0.05)
        return lines

    def transition(self, spec: NodeSpec, label: str, timeout: float, check: Callable[[], None] = lambda: None) -> bool:
        """Ask a lifecycle node for a transition, "configure" or "activate"; True when it was made.

        Parameters
        ----------
        spec : the node
        label : name of the transition
        timeout : s
        check : called while waiting; may raise to give up
        """
        client = self.node.create_client(ChangeState, f"{spec.topic(spec.name)}/change_state")
        deadline = time.monotonic() + timeout
        try:
            while not client.service_is_ready():
                if time.monotonic() > deadline:
                    return False
                check()
                time.sleep(0.02)
            future = client.call_async(ChangeState.Request(transition=Transition(id=_TRANSITIONS[label])))
            while not future.done():
                if time.monotonic() > deadline:
                    return False
                check()
                time.sleep(0.02)
            return bool(future.result().success)
        finally:
            self.node.destroy_client(client)

    def _subscribe(self, kind: Any, topic: str, callback: Callable[[Any, dict[str, int]], None]) -> None:
        def received(message: Any, info: dict[str, int]) -> None:
            self.monitor.arrived(topic, _arrival(info))  # type: ignore[union-attr]
            callback(message, info)

        self.node.create_subscription(kind, topic, received, _QOS)

    def _spin(self) -> None:
        try:
            self._executor.spin()
        except ExternalShutdownException:
            pass

    def _nav_state(self, message: NavState, info: dict[str, int]) -> None:
        self.monitor.nav_state(_row(message), _arrival(info))  # type: ignore[union-attr]

    def _truth_state(self, message: NavState, info: dict[str, int]) -> None:
        self.monitor.truth_state(_row(message))  # type: ignore[union-attr]

    def _fdi(self, message: InertialFdi, info: dict[str, int]) -> None:
        assert self.monitor is not None
        for kind, triad in (("gyro", message.gyro), ("accel", message.accel)):
            for i, state in enumerate(triad.state):
                reason = SENSOR_REASONS[triad.reason[i]] if i < len(triad.reason) else ""
                self.monitor.health(
                    _ns(triad.since[i] if i < len(triad.since) else message.header.stamp), f"{kind}_{i}", SENSOR_STATES[state], reason
                )
        rejected = message.rejected_length + message.rejected_stamp + message.rejected_no_solution
        self.monitor.imu_received(message.received, _arrival(info))
        self.monitor.counts(fused=message.fused, lost=message.lost, rejected=rejected, restarts=message.restarts)

    def _subfilters(self, message: FederatedStatus, info: dict[str, int]) -> None:
        assert self.monitor is not None
        for s in message.subfilters:
            self.monitor.health(_ns(s.since), s.name, SUBFILTER_STATES[s.state], SUBFILTER_REASONS[s.reason])
            values = {"accepted": s.accepted, "rejected": s.rejected, "late": s.late, "malformed": s.malformed}
            self.monitor.subfilter(s.name, {**values, "statistic": s.statistic, "threshold": s.threshold})
        late = sum(s.late for s in message.subfilters)
        self.monitor.counts(
            navigator_received=message.imu_received, navigator_lost=message.imu_lost, navigator_rejected=message.imu_rejected, late=late
        )


def _has(endpoints: Iterable[Any], spec: NodeSpec) -> bool:
    return any(e.node_name == spec.name and e.node_namespace == spec.full_namespace for e in endpoints)


def _arrival(info: dict[str, int]) -> int:
    """Wall time at which the middleware got the message (not when this busy process came to it); now where it does not say."""
    return info.get("received_timestamp") or time.time_ns()


def _ns(stamp: Any) -> int:
    return stamp.sec * 1_000_000_000 + stamp.nanosec


def _row(m: NavState) -> NavRow:
    validity = (m.position_validity, m.velocity_validity, m.heading_validity)
    place = (math.radians(m.latitude), math.radians(m.longitude), m.height)
    return NavRow(_ns(m.header.stamp), m.sequence, *place, m.velocity_north, m.velocity_east, m.heading, m.mode, validity, m.protection_radius)
