"""A car that climbs, live: odometer, altimeter and star sensor as nodes, their messages as other stacks know them, a fault put in by service.

Lives here: one live run of nine processes, recorded, navigated again offline.
Does not live here: the ship's graph (test_graph_live.py), what the sensors read (riins_sim), how the navigator uses them (riins_federated).
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest
from geometry_msgs.msg import PoseWithCovarianceStamped, TwistWithCovarianceStamped
from harness import Listener, by_stamp, ns, own_domain, settled_distance, wait_until

from riins_bringup.graph import GraphSettings, build_graph
from riins_bringup.live import LiveRun
from riins_eval import bag_record, offline
from riins_msgs.msg import Fault, NavState
from riins_msgs.srv import InjectFault

CAR = """\
name: car
seed: 9
duration_s: 14.5
imu_rate_hz: 50
start: {latitude_deg: 34.0, longitude_deg: 108.0, height_m: 300.0, speed_kn: 30.0, heading_deg: 300.0}
legs: [{straight_s: 2.0}, {climb_m: 8.0, climb_deg: 5.0, blend_s: 3.0}]
vessel: {heel_rad_per_g: 0.0}
imu:
  gyro: {constant_drift_deg_h: 0.5, arw_deg_sqrt_h: 0.05}
  accel: {bias_ug: 200.0, vrw_ug_sqrt_hz: 50.0}
gps: {enabled: false}
bds: {sigma_m: [3.0, 3.0, 6.0]}
doppler: {enabled: false}
odometer: {enabled: true, sigma_mps: 0.05, scale_ppm: 1000.0}
altimeter: {enabled: true, sigma_m: 0.5, markov_sigma_m: 1.0}
star_tracker: {enabled: true, sigma_arcsec: [10.0, 10.0, 20.0], max_rate_deg_s: 10.0}
initial: {position_m: 3.0, height_m: 2.0, velocity_mps: 0.05, tilt_arcsec: 30.0, heading_arcmin: 3.0}
"""
TOPICS: dict[str, tuple[type, str]] = {
    "/odometer/velocity": (TwistWithCovarianceStamped, "odometer_link"),
    "/altimeter/height": (PoseWithCovarianceStamped, "altimeter_link"),
    "/star_tracker/attitude": (PoseWithCovarianceStamped, "map"),
    "/truth/state": (NavState, "map_ned"),
}
NODES = ("imu_fusion", "navigator", "recorder", "rimu", "bds", "odometer", "altimeter", "star_tracker", "truth")


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """The run with its bag; from about 5 s on the altimeter is 60 m too high."""
    directory = tmp_path_factory.mktemp("car")
    (directory / "car.yaml").write_text(CAR)
    with own_domain(directory):
        graph = build_graph(GraphSettings(scenario=str(directory / "car.yaml"), record=str(directory / "bag")))
        with Listener({topic: kind for topic, (kind, _) in TOPICS.items()}) as listener, LiveRun(graph, directory / "logs") as live:
            client = listener.node.create_client(InjectFault, "/altimeter/inject_fault")
            live.start()
            wait_until(lambda: len(listener.messages["/altimeter/height"]) >= 5, 60.0, "five heights")
            fault = Fault(target="altimeter", type=Fault.STEP, size=60.0)
            answer = client.call_async(InjectFault.Request(fault=fault))
            wait_until(answer.done, 10.0, "the service of the altimeter")
            wait_until(lambda: live.finished() or live.dead(), 60.0, "the end of the scenario")
            assert live.dead() is None, live.dead()
            yield directory / "bag", listener.messages, live.processes.stop(), answer.result(), live.graph.start_at_ns


def test_every_node_ends_with_status_0(run: Any) -> None:
    assert run[2] == dict.fromkeys(NODES, 0)


def test_messages_are_what_other_stacks_expect(run: Any) -> None:
    """Axes and signs against the truth: speed ahead in FLU, height above the ellipsoid, yaw counter-clockwise from east."""
    _, messages, _, _, start = run
    truth = {ns(m.header.stamp): m for m in messages["/truth/state"]}
    for topic, (_, frame) in TOPICS.items():
        assert len(messages[topic]) >= 12 and {m.header.frame_id for m in messages[topic]} == {frame}, topic
    for m in messages["/odometer/velocity"]:
        at = truth[ns(m.header.stamp)]
        speed = math.hypot(at.velocity_north, at.velocity_east, at.velocity_down)
        assert m.twist.twist.linear.x == pytest.approx(speed, abs=0.3) and m.twist.twist.linear.y == m.twist.twist.linear.z == 0.0
        assert m.twist.covariance[0] == pytest.approx(0.05**2) and m.twist.covariance[7] == pytest.approx(0.1**2)
    for m in messages["/star_tracker/attitude"]:
        at, q = truth[ns(m.header.stamp)], m.pose.pose.orientation
        yaw = math.atan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y**2 + q.z**2))
        assert math.remainder(math.pi / 2.0 - yaw - at.heading, 2.0 * math.pi) == pytest.approx(0.0, abs=1e-3)
        assert math.asin(2.0 * (q.w * q.y - q.z * q.x)) == pytest.approx(-at.pitch, abs=1e-3)  # FLU: nose up is negative about port
    climbing = [m.pitch for m in messages["/truth/state"]]
    assert max(climbing) == pytest.approx(math.radians(5.0), rel=1e-3)
    sound = [m for m in messages["/altimeter/height"] if ns(m.header.stamp) <= start + 4_500_000_000]
    for m in sound:
        assert m.pose.pose.position.z == pytest.approx(truth[ns(m.header.stamp)].height, abs=8.0) and m.pose.covariance[14] == 0.25


def test_a_fault_put_in_by_service_is_isolated_and_live_is_offline(run: Any, tmp_path: Path) -> None:
    """Law 2 with every aid, and with a fault that the scenario does not know."""
    bag, messages, _, answer, _ = run
    assert answer.success and messages["/altimeter/height"][-1].pose.pose.position.z > messages["/truth/state"][-1].height + 50.0
    record = bag_record.read_record(bag, twins=False)
    assert [(f.target, f.type) for f in record.faults] == [("altimeter", "step")]
    isolated = [c.target for c in record.health if c.state_name == "isolated"]
    assert isolated == ["altimeter"] and (record.samples.lost, record.samples.late) == (0, 0)
    again = offline.navigate(bag, tmp_path / "offline", record="nav").record
    live, computed = by_stamp(bag, "/nav/settled"), by_stamp(tmp_path / "offline", "/nav/settled")
    common = sorted(set(live) & set(computed))
    assert len(common) >= 11 and max(settled_distance(live[t], computed[t]) for t in common) <= 1e-9
    assert [c.target for c in again.health if c.state_name == "isolated"] == ["altimeter"]
    assert {name for name, judged in again.judged.items() if judged.accepted.any()} >= {"bds", "odometer", "altimeter", "star_tracker"}
