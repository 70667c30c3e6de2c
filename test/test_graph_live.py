"""The graph as another stack sees it, over one live run of a short scenario.

Lives here: topics, types, frames, rates, QoS, covariances, diagnostics, fault isolation, the bridge, the example node.
Does not live here: the run itself (live_ship.py), live = offline = replay (test_graph_law_2.py), dying nodes (test_graph_losses.py), bad input.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pynmea2
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from harness import ns
from live_ship import DURATION, EXAMPLE, LATCHED, TOPICS
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy
from sensor_msgs.msg import NavSatFix, NavSatStatus

from riins_msgs.msg import NavState, SubfilterStatus, TriadFdi


def test_every_node_ends_with_status_0(run):
    assert run.statuses == dict.fromkeys(("imu_fusion", "navigator", "motion", "nmea", "recorder", "rimu", "gps", "bds", "doppler", "truth"), 0)


@pytest.mark.parametrize("topic", TOPICS)
def test_topic_has_its_type_rate_and_frame(run, topic):
    kind, rate, frame = TOPICS[topic]
    messages = run.messages[topic]
    assert all(isinstance(m, kind) for m in messages)
    # the settled topics begin and end max_delay from the run's ends; status comes at changes too
    assert len(messages) >= rate * (DURATION - 3.0)
    if topic not in ("/nav/subfilters", "/fdi/status", "/nav/innovations"):
        assert len(messages) <= rate * DURATION + 1
    if frame:
        assert {m.header.frame_id for m in messages} == {frame}
    stamps = [ns(m.header.stamp) for m in messages]
    assert stamps == sorted(stamps)
    assert run.start_ns <= stamps[0] and stamps[-1] <= run.start_ns + round(DURATION * 1e9)


def test_no_sample_is_lost_on_the_way(run):
    assert [m.sequence for m in run.messages["/rimu/raw"]] == list(range(1, 1551))
    raw = [ns(m.header.stamp) for m in run.messages["/rimu/raw"]]
    assert np.all(np.diff(raw) == 10_000_000) and raw[0] == run.start_ns + 10_000_000
    assert [ns(m.header.stamp) for m in run.messages["/imu/fused"]] == raw
    assert [ns(m.header.stamp) for m in run.messages["/nav/state"]] == raw
    assert np.all(np.diff([m.sequence for m in run.messages["/nav/state"]]) == 1)
    last = run.messages["/nav/subfilters"][-1]
    assert (last.imu_lost, last.imu_rejected, last.restarts) == (0, 0, 0)


def test_the_bridge_hears_the_navigator(run):
    """Sentences over UDP, read by a parser that is not ours, against the state of the same stamp; before the first state they say invalid."""
    states = {round(ns(m.header.stamp) * 1e-7): m for m in run.messages["/nav/state"]}
    motions = [ns(m.header.stamp) for m in run.messages["/nav/motion"]]
    assert motions == [ns(m.header.stamp) for m in run.messages["/nav/state"]]
    midnight = run.start_ns // 86_400_000_000_000 * 8_640_000

    def state_of(time_of_day):
        seconds = time_of_day.hour * 3600 + time_of_day.minute * 60 + time_of_day.second
        return states.get(midnight + seconds * 100 + time_of_day.microsecond // 10_000) or states.get(
            midnight + 8_640_000 + seconds * 100 + time_of_day.microsecond // 10_000
        )

    fixes = [pynmea2.parse(text, check=True) for text in run.bridge if "GGA" in text]
    valid = [fix for fix in fixes if fix.gps_qual]
    assert 14 <= len(valid) <= 16 and {fix.gps_qual for fix in valid} == {8}  # simulated
    for fix in valid:
        state = state_of(fix.timestamp)
        assert (fix.latitude, fix.longitude) == pytest.approx((state.latitude, state.longitude), abs=1e-7)
        assert float(fix.altitude) == pytest.approx(state.height, abs=0.006)
    assert len(fixes) > len(valid) and all(fix.lat == "" for fix in fixes if not fix.gps_qual)
    tilts = [tilt for tilt in (pynmea2.parse(text, check=True) for text in run.bridge if "PASHR" in text) if tilt.roll is not None]
    assert len(tilts) >= 150
    for tilt in tilts:
        state = state_of(tilt.timestamp)
        assert (tilt.roll, tilt.pitch) == pytest.approx((math.degrees(state.roll), math.degrees(state.pitch)), abs=0.006)
        assert math.remainder(tilt.true_heading - math.degrees(state.heading), 360.0) == pytest.approx(0.0, abs=0.006)
        assert tilt.heave is None  # not settled in 15 s


def test_qos_is_reliable_and_status_is_latched(run):
    for topic in TOPICS:
        assert run.qos[topic], topic
        for endpoint in run.qos[topic]:
            assert endpoint.qos_profile.reliability == ReliabilityPolicy.RELIABLE, topic
    for topic in set(LATCHED) - {"/riins/configuration"}:
        assert all(e.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL for e in run.qos[topic]), topic


def test_late_joiner_gets_what_is_latched(run):
    assert run.late["/nav/initial_state"][0].source == "scenario"
    assert run.late["/nav/origin"][0].latitude == pytest.approx(54.4, abs=1e-3)
    targets = {f.target for message in run.late["/truth/faults"] for f in message.faults}
    assert targets == {"gyro_2", "gps"}
    assert len(run.late["/fdi/status"][0].gyro.state) == 6


def test_one_publisher_a_topic(run):
    for topic in TOPICS:
        assert len(run.qos[topic]) == 1, topic


def test_navigation_is_right_in_ned_and_in_enu(run):
    """Frames of every output against the truth: a mix-up of axes or signs would show as metres or degrees."""
    truth = {ns(m.header.stamp): m for m in run.messages["/truth/state"]}
    odometry_truth = {ns(m.header.stamp): m for m in run.messages["/truth/odometry"]}
    origin = run.late["/nav/origin"][0]
    compared = 0
    for m in run.messages["/nav/odometry"]:
        stamp = ns(m.header.stamp)
        if stamp not in truth or stamp < run.start_ns + 5e9:
            continue
        compared += 1
        t, o = truth[stamp], odometry_truth[stamp]
        assert m.header.frame_id == "map" and m.child_frame_id == "base_link"
        # position: east, north, up of the origin on /nav/origin
        north, east = (t.latitude - origin.latitude) * 111_300.0, (t.longitude - origin.longitude) * 111_320.0 * math.cos(math.radians(54.4))
        assert m.pose.pose.position.x == pytest.approx(east, abs=6.0) and m.pose.pose.position.y == pytest.approx(north, abs=6.0)
        # attitude: ENU yaw is counter-clockwise from east; the truth's odometry says the same quaternion up to sign
        q = m.pose.pose.orientation
        yaw = math.atan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y**2 + q.z**2))
        assert math.remainder(math.pi / 2.0 - yaw - t.heading, 2.0 * math.pi) == pytest.approx(0.0, abs=math.radians(0.5))
        p = o.pose.pose.orientation
        assert abs(q.x * p.x + q.y * p.y + q.z * p.z + q.w * p.w) > 1.0 - 1e-4
        # twist: in base_link, forward and to port
        v = m.twist.twist.linear
        forward = t.velocity_north * math.cos(t.heading) + t.velocity_east * math.sin(t.heading)
        assert v.x == pytest.approx(forward, abs=0.4) and v.y == pytest.approx(o.twist.twist.linear.y, abs=0.3)
        assert m.twist.twist.angular.z == pytest.approx(-t.rate_z, abs=0.02)
    assert compared > 50


def test_imu_topics_follow_rep_145(run):
    raw = run.messages["/imu/data_raw"]
    assert all(m.orientation_covariance[0] == -1.0 for m in raw)
    force = np.array([[m.linear_acceleration.x, m.linear_acceleration.y, m.linear_acceleration.z] for m in raw])
    assert force[:, 2].mean() == pytest.approx(9.81, abs=0.1)  # +g on z: FLU
    full = run.messages["/imu/data"][-1]
    assert full.orientation_covariance[0] > 0.0
    assert math.hypot(full.orientation.x, full.orientation.y, full.orientation.z, full.orientation.w) == pytest.approx(1.0, abs=1e-9)
    for covariance in (raw[-1].angular_velocity_covariance, raw[-1].linear_acceleration_covariance, full.orientation_covariance):
        assert np.all(np.linalg.eigvalsh(np.reshape(covariance, (3, 3))) > 0.0)
    # the ship turns to starboard from 3 s on: FLU z is negative then
    turn = [
        m.angular_velocity.z for m in run.messages["/imu/data"] if ns(m.header.stamp) > run.start_ns + 5e9 and ns(m.header.stamp) < run.start_ns + 8e9
    ]
    assert np.mean(turn) < -math.radians(1.0)


def test_covariances_are_symmetric_positive_and_agree(run):
    for message in run.messages["/nav/covariance"]:
        p = np.reshape(message.covariance, (len(message.labels), -1))
        sigma = np.sqrt(np.diag(p))
        assert np.array_equal(p, p.T) and np.all(sigma[:15] > 0.0)
        used = sigma > 0.0  # a state that is switched off, such as a scale factor known exactly, has no variance
        assert np.linalg.eigvalsh((p / np.outer(sigma, sigma).clip(1e-300))[np.ix_(used, used)])[0] > 0.0 and not np.any(p[~used])
        assert message.labels[0].endswith("[m]") and len(set(message.labels)) == len(message.labels)
    settled = {ns(m.header.stamp): m for m in run.messages["/nav/settled"]}
    last = run.messages["/nav/covariance"][-1]
    state = settled[ns(last.header.stamp)]
    p = np.reshape(last.covariance, (len(last.labels), -1))
    assert math.sqrt(p[0, 0]) == pytest.approx(state.sigma_north, rel=1e-9) and math.sqrt(p[4, 4]) == pytest.approx(
        state.sigma_velocity_east, rel=1e-9
    )
    fix = run.messages["/nav/fix"][-1]
    assert fix.position_covariance_type == NavSatFix.COVARIANCE_TYPE_KNOWN and fix.status.status >= NavSatStatus.STATUS_FIX
    assert np.all(np.linalg.eigvalsh(np.reshape(fix.position_covariance, (3, 3))) > 0.0)
    odometry = run.messages["/nav/odometry"][-1]
    assert np.all(np.linalg.eigvalsh(np.reshape(odometry.pose.covariance, (6, 6))) > 0.0)


def test_gnss_services_are_told_apart(run):
    assert {m.status.service for m in run.messages["/gps/fix"]} == {NavSatStatus.SERVICE_GPS}
    assert {m.status.service for m in run.messages["/bds/fix"]} == {NavSatStatus.SERVICE_COMPASS}


def test_gyro_fault_is_isolated_and_never_fused_afterwards(run):
    isolated = [m for m in run.messages["/fdi/status"] if m.gyro.state[2] == TriadFdi.ISOLATED]
    since = ns(isolated[0].gyro.since[2])
    assert 4.0 < (since - run.start_ns) * 1e-9 < 5.0
    assert isolated[0].gyro.reason[2] == TriadFdi.REASON_PARITY
    assert all(m.gyro.state[i] in (TriadFdi.HEALTHY, TriadFdi.SUSPECT) for m in run.messages["/fdi/status"] for i in (0, 1, 3, 4, 5))
    assert all(not m.gyro_used & 0b100 for m in run.messages["/imu/fused"] if ns(m.header.stamp) >= since)
    assert all(m.gyro_used == 0b111111 for m in run.messages["/imu/fused"] if ns(m.header.stamp) < run.start_ns + 4e9)


def test_spoofed_gps_is_rejected_from_the_first_measurement_and_isolated(run):
    judged = [m for m in run.messages["/nav/innovations"] if m.subfilter == "gps"]
    for m in judged:
        t = (ns(m.header.stamp) - run.start_ns) * 1e-9
        if t < 5.99:
            assert m.accepted and m.statistic < m.threshold
        elif t < 12.99:
            assert not m.accepted and m.statistic > m.threshold
    states = [s.state for m in run.messages["/nav/subfilters"] for s in m.subfilters if s.name == "gps"]
    assert SubfilterStatus.ISOLATED in states
    assert run.summary["position_max_m"] < 8.0
    assert [c["target"] for c in run.summary["isolations"]] == ["gyro_2", "gps"]


def test_every_innovation_is_standardized(run):
    for m in run.messages["/nav/innovations"]:
        assert m.statistic == pytest.approx(float(np.dot(m.standardized, m.standardized)), rel=1e-9)
        assert len(m.innovation) == len(m.sigma) == len(m.standardized)


def test_diagnostics_name_every_node_and_the_fault(run):
    statuses: dict[str, list[Any]] = {}
    for message in run.messages["/diagnostics"]:
        for status in message.status:
            statuses.setdefault(status.name, []).append(status)
    for name in ("navigator", "navigator: gps", "navigator: bds", "navigator: doppler", "recorder: bag"):
        assert name in statuses, sorted(statuses)
    assert any(name.startswith("imu_fusion") for name in statuses)
    levels = {s.level for s in statuses["navigator: gps"]}
    assert DiagnosticStatus.OK in levels and DiagnosticStatus.WARN in levels
    assert all(v.key for s in statuses["navigator"] for v in s.values)


def test_validity_flags_and_mode(run):
    states = run.messages["/nav/state"]
    assert {m.mode for m in states[300:]} == {NavState.MODE_NAVIGATING}
    assert {m.position_validity for m in states[300:]} == {NavState.VALID}


def test_latency_is_measured(run):
    """Every quantile, in order; how large they are is for bench/live_soak.py to say, on a machine that does nothing else."""
    latency = run.summary["latency_ms"]
    assert 0.0 < latency["p50"] <= latency["p99"] <= latency["max"]


def test_node_of_another_stack_understands_the_graph(run):
    status, output = run.example
    lines = output.splitlines()
    assert status == 0 and len(lines) == 3, output
    latitude, longitude = map(float, lines[0].split()[:2])
    assert latitude == pytest.approx(54.4, abs=0.01) and longitude == pytest.approx(10.2, abs=0.01)
    assert "heading 3" in lines[0] and "kn" in lines[0]
    assert "riins" not in EXAMPLE.read_text().split('"""', 2)[2]
