"""Bad input to the running fusion and navigator: each is answered by a counted, reported rejection or an announced restart.

Lives here: NaN, wrong lengths, stamps that go back or jump, covariances that cannot be, late and duplicate aids, over real DDS.
Does not live here: dying processes (test_graph_losses.py), wrong parameters (test_graph_nodes.py), wrong files (riins_bringup/test).
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import TwistWithCovarianceStamped
from harness import Listener, ns, own_domain, short_scenario, wait_until
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import deserialize_message
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import NavSatFix, NavSatStatus

from riins_bag.bag import BagReader
from riins_bringup.graph import GraphSettings, build_graph
from riins_bringup.processes import Processes
from riins_bringup.watch import Watcher
from riins_eval import offline
from riins_msgs.msg import FederatedStatus, FusedImu, InertialFdi, InitialState, Innovation, NavState, RedundantImu, TriadFdi

INPUTS = {
    "/rimu/raw": RedundantImu,
    "/gps/fix": NavSatFix,
    "/bds/fix": NavSatFix,
    "/doppler/velocity": TwistWithCovarianceStamped,
    "/nav/initial_state": InitialState,
}
OUTPUTS = {
    "/imu/fused": FusedImu,
    "/fdi/status": InertialFdi,
    "/nav/state": NavState,
    "/nav/subfilters": FederatedStatus,
    "/nav/innovations": Innovation,
    "/diagnostics": DiagnosticArray,
}
PORTION_S = 1.0  # well inside the queues, however fast it is fed
Change = Callable[[str, float, Any], list[Any]]


class Ship:
    """Fusion and navigator as processes, fed by hand from a recording, second by second.

    Attributes
    ----------
    now : s since the start of the recording, all before it has been fed
    """

    def __init__(self, bag: Path, listener: Listener, processes: Processes) -> None:
        self.listener, self.processes = listener, processes
        self._context = rclpy.Context()
        rclpy.init(context=self._context, signal_handler_options=SignalHandlerOptions.NO)
        self.node = Node("sensors_by_hand", context=self._context)
        self._publishers = {
            topic: self.node.create_publisher(
                kind,
                topic,
                QoSProfile(depth=2000, durability=DurabilityPolicy.TRANSIENT_LOCAL if topic == "/nav/initial_state" else DurabilityPolicy.VOLATILE),
            )
            for topic, kind in INPUTS.items()
        }
        with BagReader(bag) as reader:
            recorded = [(m.topic, deserialize_message(bytes(m.data), INPUTS[m.topic])) for m in reader.messages(list(INPUTS))]
        self.start_ns = next(ns(m.header.stamp) for topic, m in recorded if topic == "/nav/initial_state")
        # aids before the IMU sample of the same time, as the offline engine has them
        self.recorded = sorted(recorded, key=lambda entry: (ns(entry[1].header.stamp), entry[0] == "/rimu/raw"))
        self.now = -1.0
        wait_until(lambda: all(p.get_subscription_count() for p in self._publishers.values()), 20.0, "matched endpoints")

    def close(self) -> None:
        self.node.destroy_node()
        self._context.try_shutdown()

    def feed(self, until: float, change: Change = lambda topic, t, message: [message], shift_s: float = 0.0, wait: bool = True) -> None:
        """Publish all with `now` < t <= until, changed; returns when the last IMU sample has come through the navigator, if told to wait."""
        while self.now < until - 1e-6:
            begin, end = self.now, min(self.now + PORTION_S, until)
            newest = 0
            for topic, original in self.recorded:
                t = (ns(original.header.stamp) - self.start_ns) * 1e-9
                if not begin + 1e-6 < t <= end + 1e-6:
                    continue
                for message in change(topic, t, copy.deepcopy(original)):
                    set_stamp(message, ns(message.header.stamp) + round(shift_s * 1e9))
                    if topic == "/rimu/raw":
                        newest = max(newest, ns(message.header.stamp))
                    self._publishers[topic].publish(message)
            self.now = end
            if newest and wait:
                self.wait_for_sample(newest)

    def wait_for_sample(self, stamp_ns: int) -> None:
        """Wait until the navigator has this IMU sample."""

        def arrived() -> bool:
            assert self.processes.exited() == [], "a node died of bad input"
            return any(ns(m.header.stamp) == stamp_ns for m in reversed(self.listener.messages["/nav/state"]))

        wait_until(arrived, 20.0, "the navigation state of the last sample")

    def fused_at(self, t: float) -> list[FusedImu]:
        return [m for m in self.listener.messages["/imu/fused"] if abs((ns(m.header.stamp) - self.start_ns) * 1e-9 - t) < 1e-6]

    @property
    def inertial(self) -> InertialFdi:
        return self.listener.last("/fdi/status")

    @property
    def federated(self) -> FederatedStatus:
        return self.listener.last("/nav/subfilters")

    def subfilter(self, name: str) -> Any:
        return next(s for s in self.federated.subfilters if s.name == name)


def set_stamp(message: Any, stamp_ns: int) -> None:
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, 1_000_000_000)


def at(topic: str, t: float, alter: Callable[[Any], list[Any] | None]) -> Change:
    """Alter the one message of a topic at time t; None from `alter` means the altered message alone."""

    def change(name: str, when: float, message: Any) -> list[Any]:
        if name != topic or abs(when - t) > 1e-6:
            return [message]
        result = alter(message)
        return [message] if result is None else result

    return change


@pytest.fixture(scope="module")
def recording(tmp_path_factory) -> Path:
    directory = tmp_path_factory.mktemp("recording")
    path = short_scenario(directory, duration_s="40.0", faults="[]")
    path.write_text("\n".join(line for line in path.read_text().splitlines() if not line.startswith("  - {target")))
    offline.sail(path, bag=directory / "bag", record="raw", twins=False)
    return directory


@pytest.fixture(scope="module")
def ship(recording) -> Iterator[Ship]:
    """Every test feeds the next seconds, so they follow one another in time; none depends on what another did wrong."""
    with own_domain(recording):
        nodes = build_graph(GraphSettings(scenario=str(recording / "short.yaml"))).of("consumer")
        with Listener(OUTPUTS, ("/fdi/status", "/nav/subfilters")) as listener, Processes(recording / "logs") as processes, Watcher() as watcher:
            processes.start(*nodes)
            assert watcher.wait_for(nodes, 120.0) == []
            made = Ship(recording / "bag", listener, processes)
            made.feed(3.0)
            yield made
            assert processes.exited() == [], "a node died of bad input"
            made.close()
            assert set(processes.stop().values()) == {0}


def test_nan_in_one_gyro_costs_that_gyro_alone_and_that_sample_alone(ship):
    t = round(ship.now + 0.5, 2)
    ship.feed(ship.now + 1.0, at("/rimu/raw", t, lambda m: m.gyro.__setitem__(1, math.nan)))
    (sample,) = ship.fused_at(t)
    assert sample.gyro_used == 0b111101 and sample.accel_used == 0b111111
    assert math.isfinite(sample.angular_velocity.x + sample.angular_velocity.y + sample.angular_velocity.z)
    statuses = [m for m in ship.listener.messages["/fdi/status"] if abs((ns(m.header.stamp) - ship.start_ns) * 1e-9 - t) < 0.02]
    assert any(m.gyro.reason[1] == TriadFdi.REASON_NOT_FINITE for m in statuses)
    assert all(math.isfinite(m.latitude) for m in ship.listener.messages["/nav/state"][-100:])
    assert ship.federated.imu_lost == 0


def test_wrong_number_of_axes_is_rejected_and_counted(ship):
    before, lost = ship.inertial.rejected_length, ship.federated.imu_lost
    t = round(ship.now + 0.5, 2)
    ship.feed(ship.now + 1.2, at("/rimu/raw", t, lambda m: setattr(m, "gyro", list(m.gyro)[:5])))
    assert ship.fused_at(t) == []
    assert ship.inertial.rejected_length == before + 1
    wait_until(lambda: ship.federated.imu_lost == lost + 1, 5.0, "the navigator to count the gap")


def test_stamp_that_goes_back_a_little_is_rejected_and_counted(ship):
    before, restarts = ship.inertial.rejected_stamp, ship.inertial.restarts
    t = round(ship.now + 0.5, 2)

    def again(message: RedundantImu) -> list[RedundantImu]:
        old = copy.deepcopy(message)
        set_stamp(old, ns(message.header.stamp) - 300_000_000)
        return [message, old, copy.deepcopy(message)]  # 0.3 s back, and the same stamp twice

    ship.feed(ship.now + 1.2, at("/rimu/raw", t, again))
    assert len(ship.fused_at(t)) == 1 and len(ship.fused_at(round(t - 0.3, 2))) == 1
    assert ship.inertial.rejected_stamp == before + 2 and ship.inertial.restarts == restarts
    stamps = [ns(m.header.stamp) for m in ship.listener.messages["/nav/state"]]
    assert stamps == sorted(set(stamps))


def judged(ship: Ship, name: str, t: float) -> list[Innovation]:
    return [
        m for m in ship.listener.messages["/nav/innovations"] if m.subfilter == name and abs((ns(m.header.stamp) - ship.start_ns) * 1e-9 - t) < 1e-6
    ]


def test_zero_covariance_means_unknown_the_configured_sigma_is_used_and_said_once(ship):
    first = math.floor(ship.now) + 1.0
    malformed = ship.subfilter("gps").malformed

    def zero(topic: str, t: float, message: Any) -> list[Any]:
        if topic == "/gps/fix":
            message.position_covariance = np.zeros(9)
        return [message]

    ship.feed(first + 1.5, zero)
    ship.feed(first + 4.2)  # settles them
    for t in (first, first + 1.0):
        (m,) = wait_until(lambda t=t: judged(ship, "gps", t), 5.0, "the innovation")
        assert m.accepted and 2.0 < m.sigma[0] < 8.0
    assert ship.subfilter("gps").malformed == malformed
    said = [line for line in ship.processes.log("navigator").read_text().splitlines() if "covariance" in line and "gps" in line]
    assert len(said) == 1, said


@pytest.mark.parametrize(
    ("count", "spoil"),
    [
        ("malformed", lambda m: setattr(m, "latitude", math.nan)),
        ("malformed", lambda m: setattr(m, "position_covariance", np.full(9, math.nan))),
        ("malformed", lambda m: setattr(m, "position_covariance", np.diag([-4.0, 4.0, 16.0]).ravel())),
        ("no_fix", lambda m: setattr(m.status, "status", NavSatStatus.STATUS_NO_FIX)),
    ],
    ids=["NaN position", "NaN covariance", "negative covariance", "no fix"],
)
def test_malformed_fix_is_counted_and_not_fused(ship, count, spoil):
    ship.feed(math.floor(ship.now) + 1.5)  # so that the spoilt one is the only fix of what follows
    t = ship.now + 0.5
    wait_until(lambda: ns(ship.federated.header.stamp) >= ship.start_ns + round((t - 1.0) * 1e9), 5.0, "a status that counts all fixes so far")
    before, used = getattr(ship.subfilter("gps"), count), ship.subfilter("gps").accepted
    ship.feed(t + 0.5, at("/gps/fix", t, spoil))
    wait_until(lambda: getattr(ship.subfilter("gps"), count) == before + 1, 5.0, "the fix to be counted")
    assert ship.subfilter("gps").accepted == used


def test_late_aid_is_worked_in_and_a_too_late_one_is_counted(ship):
    rollbacks, late = ship.federated.rollbacks, ship.subfilter("bds").late
    held: list[Any] = []
    t = math.floor(ship.now + 0.5) + 1.0

    def hold(topic: str, when: float, message: Any) -> list[Any]:
        if topic == "/bds/fix" and abs(when - t) < 1e-6:
            held.append(message)
            return []
        if topic == "/rimu/raw" and abs(when - t - 1.0) < 1e-6:  # one second late: inside max_delay
            ship._publishers["/bds/fix"].publish(held[0])
        if topic == "/rimu/raw" and abs(when - t - 3.5) < 1e-6:  # another three seconds late: beyond
            old = copy.deepcopy(held[0])
            set_stamp(old, ns(old.header.stamp) + 500_000_000)
            ship._publishers["/bds/fix"].publish(old)
        return [message]

    ship.feed(t + 3.0, hold)
    ship.feed(t + 5.0, hold)
    wait_until(lambda: ship.federated.rollbacks > rollbacks, 5.0, "a roll-back")
    wait_until(lambda: ship.subfilter("bds").late == late + 1, 5.0, "the late fix to be counted")
    (m,) = judged(ship, "bds", t)
    assert m.accepted
    assert ship.federated.restarts == 0


def test_stamp_that_jumps_beyond_max_delay_restarts_the_run_announced(ship):
    """The recording begins again 100 s earlier, as a looped player would have it."""
    ship.feed(ship.now + 0.5)
    count = len(ship.listener.messages["/nav/state"])
    ship.now = 0.0
    ship.feed(0.5, shift_s=-100.0, wait=False)
    wait_until(lambda: ship.inertial.restarts == 1 and ship.federated.restarts == 1, 10.0, "both nodes to count the restart")
    assert ship.federated.mode == NavState.MODE_WAITING
    ship.now = -1.0
    ship.feed(0.0, shift_s=-100.0)  # the initial state alone; the navigator has kept the samples since
    ship.now = 0.5
    ship.feed(2.0, shift_s=-100.0)
    assert any("restart" in m.text for m in ship.listener.messages["/fdi/status"])
    assert any("restart" in m.text for m in ship.listener.messages["/nav/subfilters"])
    after = [m for m in ship.listener.messages["/nav/state"][count:] if ns(m.header.stamp) < ship.start_ns]
    assert len(after) >= 100 and after[-1].mode == NavState.MODE_NAVIGATING
    assert after[-1].latitude == pytest.approx(54.4, abs=1e-3)


def test_every_rejection_is_in_the_diagnostics(ship):
    values: dict[str, dict[str, str]] = {}
    for message in ship.listener.messages["/diagnostics"]:
        for status in message.status:
            values.setdefault(status.name.split(":")[0], {}).update({v.key: v.value for v in status.values})
    for key in ("rejected_length", "rejected_stamp"):
        assert any(key in k.replace(" ", "_") and v not in ("0", "") for k, v in values["imu_fusion"].items()), (key, values["imu_fusion"])
    for key in ("malformed", "late", "restarts"):
        assert key in values["navigator"]
