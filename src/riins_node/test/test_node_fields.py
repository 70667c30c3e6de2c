"""riins_node.fields, convert and readings: what goes into a message comes out again, live and offline, to the bit."""

from __future__ import annotations

import dataclasses
import importlib.util
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import TwistWithCovarianceStamped
from hypothesis import given, settings
from hypothesis import strategies as st
from nav_msgs.msg import Odometry
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.serialization import serialize_message
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from sensor_msgs.msg import Imu, NavSatFix

from riins_core import frames
from riins_core.rotation import dcm_from_euler, dcm_from_quat, euler_from_dcm, exp_so3
from riins_msgs.msg import (
    FaultArray,
    FederatedStatus,
    FusedImu,
    InertialFdi,
    InitialState,
    Innovation,
    NavCovariance,
    NavEvent,
    NavState,
    RedundantImu,
    SensorUse,
)
from riins_node import convert, fields, qos, readings

STAMP = 1_700_000_000_123_456_789
RNG = np.random.default_rng(7)
SPD = (lambda a: a @ a.T + np.eye(15))(RNG.normal(size=(15, 15)))


def solution(**changes: Any) -> Any:
    """A NavSolution as riins_federated makes it; the packages below that floor must not import it."""
    rph = np.array([0.05, -0.1, 5.9])
    values = {
        "stamp_ns": STAMP,
        "lat": 0.61,
        "lon": 2.1,
        "h": 12.5,
        "v_n": np.array([3.0, -4.0, 0.25]),
        "rph": rph,
        "C_nb": dcm_from_euler(*rph),
        "rate_b": np.array([0.01, -0.02, 0.03]),
        "force_b": np.array([0.1, 0.2, -9.8]),
        "bias_g": np.array([1e-7, 2e-7, -3e-7]),
        "bias_a": np.array([1e-4, -2e-4, 3e-4]),
        "P": SPD.copy(),
        "mode": 2,
        "validity": (0, 1, 2),
        "protection_radius": 33.0,
        "protection_heading": 0.01,
        "reset_count": 2,
        "reset": (1.0, 2.0, 3.0),
    }
    return SimpleNamespace(**{**values, **changes})


def initial() -> Any:
    """An InitialState as riins_federated makes it."""
    sigmas = {f"sigma_{name}": RNG.uniform(0.1, 1.0, 3) for name in ("position", "velocity", "attitude", "gyro_bias", "accel_bias")}
    rph = np.array([0.1, 0.2, 3.0])
    return SimpleNamespace(stamp_ns=STAMP, lat=0.5, lon=-2.0, h=3.0, v_n=RNG.normal(size=3), rph=rph, covariance=SPD, source="test", **sigmas)


@pytest.fixture(scope="module")
def typestore() -> Any:
    """Types of the recorded messages as another program knows them: rosbags with our .msg files."""
    store = get_typestore(Stores.ROS2_JAZZY)
    spec = importlib.util.find_spec("riins_msgs")
    assert spec is not None and spec.origin is not None
    share = Path(spec.origin).parents[4] / "share" / "riins_msgs" / "msg"
    types: dict[str, Any] = {}
    for file in sorted(share.glob("*.msg")):
        types.update(get_types_from_msg(file.read_text(), f"riins_msgs/msg/{file.stem}"))
    store.register(types)
    return store


def recorded(store: Any, msg: Any) -> Any:
    """The message as an offline reader sees it: sent over DDS, taken raw as the recorder does, deserialized by rosbags."""
    package, name = type(msg).__module__.partition(".")[0], type(msg).__name__
    node, taken = Node("through_dds"), []
    publisher = node.create_publisher(type(msg), "sent", qos.latched())
    node.create_subscription(type(msg), "sent", taken.append, qos.latched(), raw=True)
    publisher.publish(msg)
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    deadline = time.monotonic() + 10.0
    while not taken and time.monotonic() < deadline:
        executor.spin_once(timeout_sec=0.1)
    executor.shutdown()
    node.destroy_node()
    return store.deserialize_cdr(taken[0], f"{package}/msg/{name}")


def same(a: Any, b: Any) -> bool:
    """Equal to the bit, arrays, dicts and NaN included."""
    if isinstance(a, dict):
        return a.keys() == b.keys() and all(same(a[key], b[key]) for key in a)
    if isinstance(a, np.ndarray):
        return a.dtype == b.dtype and a.tobytes() == b.tobytes()
    return type(a) is type(b) and a == b


@given(st.lists(st.floats(allow_nan=False, width=64), min_size=12, max_size=12), st.integers(0, 2**32 - 1), st.integers(0, 2**64 - 1))
@settings(max_examples=30, deadline=None)
def test_redundant_imu_to_the_bit(values: list[float], sequence: int, valid: int) -> None:
    gyro, accel = np.array(values[:6]), np.array(values[6:])
    back = convert.read_redundant_imu(convert.fill(RedundantImu, fields.redundant_imu(STAMP, sequence, gyro, accel, valid, 3)))
    assert same(dict(back), {"stamp_ns": STAMP, "sequence": sequence, "gyro": gyro, "accel": accel, "gyro_valid": valid, "accel_valid": 3})


@given(st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=6, max_size=6))
@settings(max_examples=30, deadline=None)
def test_fused_imu_to_the_bit_and_in_flu(values: list[float]) -> None:
    rate, force = np.array(values[:3]) + 0.0, np.array(values[3:]) + 0.0
    recalled = {"angle_recall": rate, "velocity_recall": force, "recall_onset_ns": STAMP - 7}
    msg = convert.fill(FusedImu, fields.fused_imu(STAMP, 9, rate, force, np.eye(3), 2 * np.eye(3), 63, 31, np.zeros(6), np.zeros(6), **recalled))
    assert (msg.angular_velocity.x, msg.angular_velocity.y, msg.angular_velocity.z) == (rate[0], -rate[1], -rate[2])
    assert msg.header.frame_id == "imu_link"
    back = convert.read_fused_imu(msg)
    assert (msg.angle_recall.x, msg.angle_recall.y, msg.velocity_recall.z) == (rate[0], -rate[1], -force[2])
    assert same(dict(back), {"stamp_ns": STAMP, "sequence": 9, "rate": rate, "force": force, "gyro_used": 63, "accel_used": 31, **recalled})


def test_live_and_recorded_give_the_same_numbers(ros: Callable[..., None], typestore: Any) -> None:
    ros()
    state = initial()
    cases: list[tuple[Any, Any, Any]] = [
        (RedundantImu, fields.redundant_imu(STAMP, 1, RNG.normal(size=6), RNG.normal(size=6), 63, 63), readings.read_redundant_imu),
        (FusedImu, fields.fused_imu(STAMP, 1, RNG.normal(size=3), RNG.normal(size=3), np.eye(3), np.eye(3), 1, 2), readings.read_fused_imu),
        (NavSatFix, fields.position_fix(STAMP, 0.6, 2.2, 5.0, SPD[:3, :3], "gps_link", 1), readings.read_position_aid),
        (NavSatFix, fields.position_fix(STAMP, 0.6, 2.2, 5.0, np.zeros((3, 3)), "gps_link", 1, has_fix=False), readings.read_position_aid),
        (TwistWithCovarianceStamped, fields.velocity(STAMP, RNG.normal(size=3), SPD[:3, :3]), readings.read_velocity),
        (TwistWithCovarianceStamped, fields.doppler(STAMP, np.array([5.0, 0.1, np.nan]), SPD[:3, :3]), readings.read_doppler),
        (InitialState, fields.initial_state(state), readings.read_initial_state),
        (NavState, fields.nav_state(solution(), 4), readings.read_nav_state),
    ]
    for msg_class, values, read in cases:
        msg = convert.fill(msg_class, values)
        assert same(read(msg), read(recorded(typestore, msg))), msg_class


def test_position_aid_back() -> None:
    covariance = np.array([[4.0, 0.5, 0.1], [0.5, 9.0, 0.2], [0.1, 0.2, 25.0]])
    msg = convert.fill(NavSatFix, fields.position_fix(STAMP, 0.6, -2.2, 5.0, covariance, "bds_link", fields.SERVICE["bds"]))
    assert (msg.position_covariance[0], msg.position_covariance[4], msg.position_covariance[8]) == (9.0, 4.0, 25.0)  # ENU
    assert (msg.status.service, msg.position_covariance_type) == (4, 3)
    back = convert.read_position_aid(msg)
    np.testing.assert_allclose(back["z"], [0.6, -2.2, 5.0], rtol=1e-15)
    assert np.array_equal(back["R"], covariance) and back["ok"]
    lost = convert.read_position_aid(
        convert.fill(NavSatFix, fields.position_fix(STAMP, 0.6, -2.2, 5.0, np.zeros((3, 3)), "bds_link", 4, has_fix=False))
    )
    assert not lost["ok"] and not lost["R"].any()


def test_velocities_back() -> None:
    covariance = np.array([[4.0, 0.5, 0.1], [0.5, 9.0, 0.2], [0.1, 0.2, 25.0]])
    v = np.array([1.0, -2.0, 3.0])
    msg = convert.fill(TwistWithCovarianceStamped, fields.velocity(STAMP, v, covariance))
    assert (msg.twist.twist.linear.x, msg.twist.twist.linear.z, msg.header.frame_id) == (-2.0, -3.0, "map")
    back = convert.read_velocity(msg)
    assert np.array_equal(back["z"], v) and np.array_equal(back["R"], covariance)
    log = convert.fill(TwistWithCovarianceStamped, fields.doppler(STAMP, np.array([1.0, -2.0, np.nan]), covariance))
    assert (log.twist.twist.linear.y, log.header.frame_id) == (2.0, "doppler_link")
    back = convert.read_doppler(log)
    horizontal = covariance * np.array([[1, 1, 0], [1, 1, 0], [0, 0, 0]])
    assert np.array_equal(back["z"], [1.0, -2.0, np.nan], equal_nan=True) and np.array_equal(back["R"], horizontal)
    log.twist.covariance[14] = np.nan
    assert np.array_equal(convert.read_doppler(log)["R"], horizontal)
    whole = convert.fill(TwistWithCovarianceStamped, fields.doppler(STAMP, v, covariance))
    assert np.array_equal(convert.read_doppler(whole)["z"], v) and np.array_equal(convert.read_doppler(whole)["R"], covariance)
    log.twist.covariance[0] = -1.0
    assert not convert.read_doppler(log)["R"].any()


def test_initial_state_back() -> None:
    state = initial()
    back = convert.read_initial_state(convert.fill(InitialState, fields.initial_state(state)))
    for name, value in vars(state).items():
        if name in ("lat", "lon"):
            assert back[name] == pytest.approx(value, rel=1e-15)
        else:
            assert np.array_equal(back[name], value), name
    state.covariance = None
    assert convert.read_initial_state(convert.fill(InitialState, fields.initial_state(state)))["covariance"] is None


def test_nav_state_back() -> None:
    one = solution()
    back = convert.read_nav_state(convert.fill(NavState, fields.nav_state(one, 17)))
    assert (back["stamp_ns"], back["sequence"], back["mode"], back["validity"], back["reset_count"]) == (STAMP, 17, 2, (0, 1, 2), 2)
    for name in ("v_n", "rph", "rate_b", "bias_g", "bias_a"):
        assert np.array_equal(back[name], getattr(one, name)), name
    assert back["lat"] == pytest.approx(one.lat, rel=1e-15)
    np.testing.assert_allclose(back["sigma_position"], np.sqrt(np.diag(one.P)[:3]))


def test_sigmas_of_euler_angles_against_samples() -> None:
    phi = SPD[6:9, 6:9] * 1e-8
    P = SPD.copy()
    P[6:9, 6:9] = phi
    rph = np.array([0.3, 0.4, 2.0])
    msg = fields.nav_state(solution(rph=rph, C_nb=dcm_from_euler(*rph), P=P), 0)
    draws = RNG.multivariate_normal(np.zeros(3), phi, size=20_000)
    computed = np.stack(euler_from_dcm(exp_so3(-draws) @ dcm_from_euler(*rph)), axis=-1)  # (I - [phi x]) C_nb
    np.testing.assert_allclose([msg["sigma_roll"], msg["sigma_pitch"], msg["sigma_heading"]], (computed - rph).std(axis=0), rtol=0.03)


def test_odometry_against_samples() -> None:
    """Pose and twist covariance of a ship far from the datum, against drawn errors."""
    P = SPD * 1e-6
    one = solution(P=P)
    local = frames.LocalFrame(0.55, 2.0, 0.0)
    msg = convert.fill(Odometry, fields.odometry(one, local))
    assert (msg.header.frame_id, msg.child_frame_id) == ("map", "base_link")
    position = np.array([msg.pose.pose.position.x, msg.pose.pose.position.y, msg.pose.pose.position.z])
    np.testing.assert_allclose(position, local.to_enu(one.lat, one.lon, one.h))
    speed = np.array([msg.twist.twist.linear.x, msg.twist.twist.linear.y, msg.twist.twist.linear.z])
    np.testing.assert_allclose(np.linalg.norm(speed), np.linalg.norm(one.v_n))
    np.testing.assert_allclose(frames.flu_to_frd(speed), one.C_nb.T @ one.v_n, atol=1e-12)
    q = msg.pose.pose.orientation
    true = dcm_from_quat([q.x, q.y, q.z, q.w])
    draws = RNG.multivariate_normal(np.zeros(15), P, size=20_000)
    lat, lon, h = frames.ned_offset(one.lat, one.lon, one.h, draws[:, :3])
    d_position = local.to_enu(lat, lon, h) - position
    computed = exp_so3(-draws[:, 6:9]) @ one.C_nb
    attitude = dcm_from_quat(local.attitude(one.lat, one.lon, computed))
    turned = attitude @ true.T
    d_attitude = np.stack([turned[:, 2, 1], turned[:, 0, 2], turned[:, 1, 0]], axis=-1)
    sampled = np.cov(np.hstack([d_position, d_attitude]).T)
    given_covariance = np.reshape(msg.pose.covariance, (6, 6))
    scale = np.sqrt(np.outer(np.diag(given_covariance), np.diag(given_covariance)))
    assert np.abs((sampled - given_covariance) / scale).max() < 0.05
    d_speed = frames.frd_to_flu(np.einsum("mji,mj->mi", computed, one.v_n + draws[:, 3:6])) - speed
    linear = np.reshape(msg.twist.covariance, (6, 6))[:3, :3]
    assert np.abs((np.cov(d_speed.T) - linear) / np.sqrt(np.outer(np.diag(linear), np.diag(linear)))).max() < 0.05


def test_imu_obeys_rep_145() -> None:
    raw = convert.fill(Imu, fields.imu_raw(STAMP, np.zeros(3), np.array([0.0, 0.0, -9.8]), np.eye(3), np.eye(3)))
    assert raw.orientation_covariance[0] == -1.0
    assert raw.linear_acceleration.z == 9.8  # +g at rest
    level = solution(C_nb=np.eye(3), force_b=np.array([0.0, 0.0, -9.8]))  # heading north
    msg = convert.fill(Imu, fields.imu(level))
    assert (msg.orientation.x, msg.orientation.y) == pytest.approx((0.0, 0.0))
    assert (msg.orientation.z, msg.orientation.w) == pytest.approx((np.sqrt(0.5), np.sqrt(0.5)))  # yaw +90 deg: x points north
    assert msg.linear_acceleration.z == 9.8
    np.testing.assert_allclose(np.reshape(msg.orientation_covariance, (3, 3))[0, 0], SPD[7, 7])


def test_status_messages() -> None:
    sub = SimpleNamespace(
        name="gps", state=2, reason=1, stamp_ns=STAMP, since_ns=5, statistic=20.0, threshold=9.0, beta=0.5, information_trace=(1.0, 2.0),
        accepted=1, rejected=2, late=3, malformed=4, no_fix=6, separation=7.0, separation_threshold=23.0,
    )  # fmt: skip
    report = SimpleNamespace(
        stamp_ns=STAMP, mode=2, subfilters=(sub,), imu_received=9, imu_lost=1, imu_rejected=2, restarts=0, rollbacks=3,
        cross_check=1.5, cross_check_threshold=23.0,
    )  # fmt: skip
    event = SimpleNamespace(stamp_ns=STAMP, kind=0, target="gps", state=2, reason=1, text="gps: suspect -> isolated (nis)")
    other = SimpleNamespace(stamp_ns=7, kind=1, target="", state=None, reason=0, text="navigation begins")
    msg = convert.fill(FederatedStatus, fields.federated_status(report, "gps isolated", [event, other]))
    first, second = msg.events
    assert (convert.to_ns(first.stamp), first.target, first.state, first.reason, first.text) == (STAMP, "gps", 2, 1, event.text)
    assert (first.kind, second.kind, second.target, second.state) == (NavEvent.HEALTH, NavEvent.BEGUN, "", 0)
    assert (msg.subfilters[0].name, msg.subfilters[0].since.nanosec, list(msg.subfilters[0].information_trace)) == ("gps", 5, [1.0, 2.0])
    assert (msg.subfilters[0].malformed, msg.subfilters[0].no_fix) == (4, 6)
    assert (msg.subfilters[0].separation, msg.subfilters[0].separation_threshold, msg.cross_check) == (7.0, 23.0, 1.5)
    assert (msg.imu_received, msg.rollbacks, msg.text) == (9, 3, "gps isolated")
    triad = SimpleNamespace(
        parity=np.ones(3), statistic=1.0, threshold=2.0, dof=3, detected=False, suspect=-1, state=(0, 2), reason=(0, 1), since_ns=(0, STAMP),
        drift=np.zeros(2), capability=0,
    )  # fmt: skip
    names = ("received", "fused", "lost", "rejected_length", "rejected_stamp", "rejected_no_solution", "restarts")
    counters = SimpleNamespace(**{name: number for number, name in enumerate(names)})
    fdi = convert.fill(InertialFdi, fields.inertial_fdi(SimpleNamespace(stamp_ns=STAMP, gyro=triad, accel=triad, counters=counters, text="")))
    assert (list(fdi.gyro.state), fdi.gyro.suspect, convert.to_ns(fdi.gyro.since[1]), fdi.restarts) == ([0, 2], -1, STAMP, 6)
    judged = SimpleNamespace(
        stamp_ns=STAMP,
        name="doppler",
        innovation=np.ones(2),
        sigma=np.ones(2),
        standardized=np.ones(2),
        nis=2.0,
        threshold=9.0,
        accepted=True,
        reason=0,
        frame="log_link",
    )
    assert convert.fill(Innovation, fields.innovation(judged)).header.frame_id == "log_link"
    covariance = convert.fill(NavCovariance, fields.nav_covariance(solution(), [f"s{i} [m]" for i in range(15)]))
    assert np.array_equal(np.reshape(covariance.covariance, (15, 15)), SPD)
    array = convert.fill(DiagnosticArray, fields.diagnostics(STAMP, [("imu_fusion: gyros", "warn", "gyro_1 isolated", {"lost": 3})]))
    assert (array.status[0].level, array.status[0].values[0].value) == (b"\x01", "3")
    assert not convert.fill(NavSatFix, fields.nav_fix(solution())).status.status
    assert convert.fill(NavSatFix, fields.nav_fix(solution(validity=(2, 0, 0)))).status.status == -1
    assert convert.fill(NavSatFix, fields.origin(STAMP, 0.5, 1.0, 2.0)).position_covariance_type == 0


def test_fault_back() -> None:
    @dataclasses.dataclass(frozen=True)
    class Fault:
        target: str
        type: int
        size: float
        slope: float
        axis: str
        start_ns: int
        end_ns: int | None

    for fault in (Fault("gps", 0, 300.0, 0.0, "north", 30, None), Fault("gyro_2", 1, 0.0, 1e-6, "all", 60, 90)):
        msg = convert.fill(FaultArray, fields.fault_array(STAMP, [fault], 1_000_000))
        assert convert.read_fault(msg.faults[0], 1_000_000) == dataclasses.asdict(fault)


def test_sensor_use_back() -> None:
    for stamp, seen in ((STAMP, STAMP), (-(2**63), 0)):  # below zero: it held before the first sample, whatever its stamp
        msg = convert.fill(SensorUse, fields.sensor_use(stamp, "gyro_2", False))
        assert convert.read_sensor_use(msg) == {"name": "gyro_2", "use": False, "stamp_ns": seen}
    assert convert.read_sensor_use(convert.fill(SensorUse, fields.sensor_use(STAMP, "gps", True)))["use"] is True


def test_fill_makes_exact_types() -> None:
    msg = convert.fill(NavState, {"latitude": 5, "sequence": np.float64(3.0), "mode": np.uint8(2)})
    assert (type(msg.latitude), type(msg.sequence), type(msg.mode)) == (float, int, int)
    assert serialize_message(msg) == serialize_message(NavState(latitude=5.0, sequence=3, mode=2))
    with pytest.raises(ValueError, match="has no field lattitude"):
        convert.fill(NavState, {"lattitude": 5.0})
    with pytest.raises(ValueError, match="9 elements"):
        convert.fill(FusedImu, {"angular_velocity_covariance": np.zeros(8)})


def test_stamps() -> None:
    for ns in (0, 1, 999_999_999, 1_000_000_000, STAMP, -1):
        assert convert.to_ns(convert.to_stamp(ns)) == ns
