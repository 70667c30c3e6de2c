"""What a message says, as plain numbers in the frames of the algorithms: NED, FRD, radians, nanoseconds.

Lives here: one `read_*` function per message a consumer takes. They read attributes, so a rclpy message and a rosbags one give the same
numbers, bit for bit: live and offline use these functions alone (law 2 of the architecture).
Does not live here: anything that imports ROS, the way out (fields.py), judgement of the values (the algorithms).
"""

from __future__ import annotations

from typing import Any, TypedDict

import numpy as np
from numpy.typing import NDArray

from riins_core import frames
from riins_core.rotation import euler_from_dcm, quat_from_dcm

Array = NDArray[np.float64]
STATUS_FIX = 0
DVL_BOTTOM, DVL_WATER = 1, 2
"""Dvl.velocity_mode."""
DVL_BEAMS = 3
"""With fewer good beams there is no velocity vector."""


class RedundantImuSample(TypedDict):
    """gyro, accel: (n,) along the sensor axes, rad/s and m/s^2."""

    stamp_ns: int
    sequence: int
    gyro: Array
    accel: Array
    gyro_valid: int
    accel_valid: int


class FusedImuSample(TypedDict):
    """rate, force, angle_recall, velocity_recall: (3,) FRD, rad/s, m/s^2, rad, m/s; recall_onset_ns 0: nothing is recalled."""

    stamp_ns: int
    sequence: int
    rate: Array
    force: Array
    gyro_used: int
    accel_used: int
    angle_recall: Array
    velocity_recall: Array
    recall_onset_ns: int


class ImuReading(TypedDict):
    """rate, force: (3,) FRD, rad/s, m/s^2; their covariances (3, 3) FRD, zeros when unknown."""

    stamp_ns: int
    rate: Array
    force: Array
    rate_covariance: Array
    force_covariance: Array


class AidReading(TypedDict):
    """z, R, ok, frame as in riins_federated.types.Aid."""

    stamp_ns: int
    z: Array
    R: Array
    ok: bool
    frame: str


def to_ns(stamp: Any) -> int:
    """Integer nanoseconds of a builtin_interfaces/Time or Duration."""
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def read_redundant_imu(msg: Any) -> RedundantImuSample:
    """Read riins_msgs/RedundantImu; the axes are the sensors', no frame is turned."""
    return {
        "stamp_ns": to_ns(msg.header.stamp),
        "sequence": int(msg.sequence),
        "gyro": np.array(msg.gyro, np.float64),
        "accel": np.array(msg.accel, np.float64),
        "gyro_valid": int(msg.gyro_valid),
        "accel_valid": int(msg.accel_valid),
    }


def read_fused_imu(msg: Any) -> FusedImuSample:
    """Read riins_msgs/FusedImu: FLU becomes FRD."""
    return {
        "stamp_ns": to_ns(msg.header.stamp),
        "sequence": int(msg.sequence),
        "rate": frames.flu_to_frd(_vector(msg.angular_velocity)),
        "force": frames.flu_to_frd(_vector(msg.linear_acceleration)),
        "gyro_used": int(msg.gyro_used),
        "accel_used": int(msg.accel_used),
        "angle_recall": frames.flu_to_frd(_vector(msg.angle_recall)),
        "velocity_recall": frames.flu_to_frd(_vector(msg.velocity_recall)),
        "recall_onset_ns": to_ns(msg.recall_onset),
    }


def read_imu(msg: Any) -> ImuReading:
    """Read sensor_msgs/Imu, of which the orientation is not used: the axes of its own frame from FLU to FRD."""
    return {
        "stamp_ns": to_ns(msg.header.stamp),
        "rate": frames.flu_to_frd(_vector(msg.angular_velocity)),
        "force": frames.flu_to_frd(_vector(msg.linear_acceleration)),
        "rate_covariance": frames.flu_to_frd_covariance(_covariance(msg.angular_velocity_covariance)),
        "force_covariance": frames.flu_to_frd_covariance(_covariance(msg.linear_acceleration_covariance)),
    }


def read_position_aid(msg: Any) -> AidReading:
    """Read sensor_msgs/NavSatFix.

    Returns
    -------
    z : latitude, longitude [rad], height [m]; R : (3, 3) NED m^2, zeros when unknown; ok : the sensor has a fix
    """
    known = int(msg.position_covariance_type) != 0
    covariance = np.array(msg.position_covariance, np.float64).reshape(3, 3) if known else np.zeros((3, 3))
    return {
        "stamp_ns": to_ns(msg.header.stamp),
        "z": np.array([np.radians(msg.latitude), np.radians(msg.longitude), msg.altitude], np.float64),
        "R": frames.enu_to_ned_covariance(covariance),
        "ok": int(msg.status.status) >= STATUS_FIX,
        "frame": str(msg.header.frame_id),
    }


def read_velocity(msg: Any) -> AidReading:
    """Read the GNSS velocity, geometry_msgs/TwistWithCovarianceStamped in ENU: z NED m/s, R (3, 3) NED, zeros when unknown."""
    return _aid(msg, frames.enu_to_ned(_vector(msg.twist.twist.linear)), frames.enu_to_ned_covariance(_linear_covariance(msg)))


def read_doppler(msg: Any) -> AidReading:
    """Read the log, geometry_msgs/TwistWithCovarianceStamped in FLU: z forward, starboard, down m/s (NaN stays), R (3, 3) FRD, zeros when unknown."""
    covariance = _linear_covariance(msg)
    if np.isnan(msg.twist.twist.linear.z):  # not measured; whatever its covariance says must not spread when the axes are turned
        covariance[2, :] = covariance[:, 2] = 0.0
    return _aid(msg, frames.flu_to_frd(_vector(msg.twist.twist.linear)), frames.flu_to_frd_covariance(covariance))


def read_odometer(msg: Any) -> AidReading:
    """Read wheels, geometry_msgs/TwistWithCovarianceStamped in FLU: z (1,) speed forward m/s, R (3, 3) FRD with what is said of the zeros."""
    return {**read_doppler(msg), "z": np.array([msg.twist.twist.linear.x], np.float64)}


def read_height(msg: Any) -> AidReading:
    """Read geometry_msgs/PoseWithCovarianceStamped of which the height is meant: z (1,) position.z in m, R (1, 1) of covariance[14]."""
    return _aid(msg, np.array([msg.pose.pose.position.z], np.float64), _pose_covariance(msg)[2:3, 2:3])


def read_heading(msg: Any) -> AidReading:
    """Read geometry_msgs/PoseWithCovarianceStamped of which the yaw in ENU is meant: z (1,) heading from north, R (1, 1) of covariance[35]."""
    heading = np.reshape(euler_from_dcm(_attitude(msg))[2], (1,)) if _quaternion_ok(msg) else np.full(1, np.nan)
    return _aid(msg, heading, _pose_covariance(msg)[5:6, 5:6])


def read_attitude(msg: Any) -> AidReading:
    """Read geometry_msgs/PoseWithCovarianceStamped of which the orientation of FLU axes in ENU is meant.

    Returns
    -------
    z : (4,), quaternion (x, y, z, w) from FRD to NED; R : (3, 3) of a small rotation about NED, rows 3 to 5 of the covariance
    """
    z = quat_from_dcm(_attitude(msg)) if _quaternion_ok(msg) else np.full(4, np.nan)
    return _aid(msg, z, frames.enu_to_ned_covariance(_pose_covariance(msg)[3:, 3:]))


def read_dvl_bottom(msg: Any) -> AidReading | None:
    """Read the velocity of marine_acoustic_msgs/Dvl over ground, whose axes are FRD: z (3,) m/s, R (3, 3); None: it was relative to the water."""
    return _dvl(msg) if int(msg.velocity_mode) == DVL_BOTTOM else None


def read_dvl_water(msg: Any) -> AidReading | None:
    """Read the velocity of marine_acoustic_msgs/Dvl through the water, as `read_dvl_bottom`; None: it was over ground."""
    return _dvl(msg) if int(msg.velocity_mode) == DVL_WATER else None


def read_dvl_beams(msg: Any) -> AidReading | None:
    """Read the beams of marine_acoustic_msgs/Dvl: z (4,) m/s along each, NaN: none, R (4, 4) diagonal, 0: unknown; None: not over ground."""
    if int(msg.velocity_mode) != DVL_BOTTOM:
        return None
    z = np.array(msg.beam_velocity, np.float64)
    variance = np.array(msg.beam_velocity_covar, np.float64)
    reading = _aid(msg, z, np.diag(np.where(variance == -1.0, 0.0, variance)))
    reading["ok"] = bool(msg.beam_velocities_valid) and bool(np.isfinite(z).any())
    return reading


def read_initial_state(msg: Any) -> dict[str, Any]:
    """Read riins_msgs/InitialState: the arguments of riins_federated.types.InitialState by name."""
    size = len(msg.covariance)
    covariance = None
    if size:
        side = round(size**0.5)
        covariance = np.array(msg.covariance, np.float64)
        covariance = covariance.reshape(side, side) if side * side == size else covariance  # a wrong length is refused by its consumer
    sigmas = ("sigma_position", "sigma_velocity", "sigma_attitude", "sigma_gyro_bias", "sigma_accel_bias")
    return {
        "stamp_ns": to_ns(msg.header.stamp),
        "lat": float(np.radians(msg.latitude)),
        "lon": float(np.radians(msg.longitude)),
        "h": float(msg.height),
        "v_n": np.array([msg.velocity_north, msg.velocity_east, msg.velocity_down], np.float64),
        "rph": np.array([msg.roll, msg.pitch, msg.heading], np.float64),
        **{name: np.array(getattr(msg, name), np.float64) for name in sigmas},
        "covariance": covariance,
        "source": str(msg.source),
    }


def read_nav_state(msg: Any) -> dict[str, Any]:
    """Read riins_msgs/NavState.

    Returns
    -------
    dict with stamp_ns, sequence, mode, validity (3,), lat, lon [rad], h [m], v_n (3,), rph (3,), rate_b (3,), bias_g (3,), bias_a (3,),
    sigma_position (3,), sigma_velocity (3,), sigma_rph (3,), protection_radius, protection_heading [rad] (NaN in older recordings),
    reset_count, reset (3,)
    """

    def triple(stem: str, suffixes: str) -> Array:
        return np.array([getattr(msg, f"{stem}{suffix}") for suffix in suffixes.split()], np.float64)

    return {
        "stamp_ns": to_ns(msg.header.stamp),
        "sequence": int(msg.sequence),
        "mode": int(msg.mode),
        "validity": (int(msg.position_validity), int(msg.velocity_validity), int(msg.heading_validity)),
        "lat": float(np.radians(msg.latitude)),
        "lon": float(np.radians(msg.longitude)),
        "h": float(msg.height),
        "v_n": triple("velocity_", "north east down"),
        "rph": triple("", "roll pitch heading"),
        "rate_b": triple("rate_", "x y z"),
        "bias_g": triple("gyro_bias_", "x y z"),
        "bias_a": triple("accel_bias_", "x y z"),
        "sigma_position": triple("sigma_", "north east down"),
        "sigma_velocity": triple("sigma_velocity_", "north east down"),
        "sigma_rph": triple("sigma_", "roll pitch heading"),
        "protection_radius": float(msg.protection_radius),
        "protection_heading": float(getattr(msg, "protection_heading", np.nan)),
        "reset_count": int(msg.reset_count),
        "reset": triple("reset_", "position velocity heading"),
    }


def read_fault(msg: Any, start_at_ns: int = 0) -> dict[str, Any]:
    """Read riins_msgs/Fault: the arguments of riins_sim.faults.Fault by name, times counted from `start_at_ns`.

    A start of zero (from the next sample on) is given back as None; an end of zero (until cleared) as None.
    """
    start, end = to_ns(msg.start), to_ns(msg.end)
    return {
        "target": str(msg.target),
        "type": int(msg.type),
        "size": float(msg.size),
        "slope": float(msg.slope),
        "axis": str(msg.axis) or "all",
        "start_ns": start - start_at_ns if start else None,
        "end_ns": end - start_at_ns if end else None,
    }


def read_sensor_use(msg: Any) -> dict[str, Any]:
    """Read riins_msgs/SensorUse: the arguments of riins_federated.types.UseCommand by name; a stamp of zero holds from the first sample on."""
    return {"name": str(msg.target), "use": bool(msg.use), "stamp_ns": to_ns(msg.header.stamp)}


def is_for_fusion(target: str) -> bool:
    """Whether the target of a SensorUse is a sensor of the redundant IMU (imu_fusion), not a subfilter (navigator)."""
    return target.startswith(("gyro_", "accel_"))


def read_fusion_method(msg: Any) -> dict[str, Any]:
    """Read riins_msgs/FusionMethod: the arguments of FusionPipeline.set_method by name; a stamp of zero holds from the next sample on."""
    names = {name: str(getattr(msg, name)) for name in ("fusion", "parity_test", "sequential_test")}
    return {**names, "adapt_noise": bool(msg.adapt_noise), "effective_ns": to_ns(msg.header.stamp)}


def read_inertial_calibration(msg: Any) -> dict[str, Any]:
    """Read riins_msgs/InertialCalibration: the arguments of FusionPipeline.add_calibration by name, FRD."""
    biases = {f"{kind}_bias": frames.frd_to_flu(_vector(getattr(msg, f"{kind}_bias"))) for kind in ("gyro", "accel")}  # its own inverse
    given = {kind: np.array(getattr(msg, f"{kind}_bias_covariance"), np.float64).reshape(3, 3) for kind in ("gyro", "accel")}
    covariances = {f"{kind}_covariance": frames.frd_to_flu_covariance(P) for kind, P in given.items()}
    return {"effective_ns": to_ns(msg.header.stamp), **biases, **covariances}


def _aid(msg: Any, z: Array, R: Array) -> AidReading:
    return {"stamp_ns": to_ns(msg.header.stamp), "z": z, "R": R, "ok": True, "frame": str(msg.header.frame_id)}


def _dvl(msg: Any) -> AidReading:
    reading = _aid(msg, _vector(msg.velocity), _covariance(msg.velocity_covar))
    reading["ok"] = int(msg.num_good_beams) >= DVL_BEAMS
    return reading


def _pose_covariance(msg: Any) -> Array:
    covariance = np.array(msg.pose.covariance, np.float64).reshape(6, 6)
    return np.zeros((6, 6)) if covariance[0, 0] == -1.0 else covariance


def _orientation(msg: Any) -> Array:
    q = msg.pose.pose.orientation
    return np.array([q.x, q.y, q.z, q.w], np.float64)


def _quaternion_ok(msg: Any) -> bool:
    q = _orientation(msg)
    return bool(0.5 < float(q @ q) < 2.0)  # rounding, not rubbish


def _attitude(msg: Any) -> Array:
    return frames.attitude_from_enu(_orientation(msg))


def _vector(v: Any) -> Array:
    return np.array([v.x, v.y, v.z], np.float64)


def _covariance(values: Any) -> Array:
    covariance = np.array(values, np.float64).reshape(3, 3)
    return np.zeros((3, 3)) if covariance[0, 0] == -1.0 else covariance


def _linear_covariance(msg: Any) -> Array:
    covariance = np.array(msg.twist.covariance, np.float64).reshape(6, 6)[:3, :3]
    return np.zeros((3, 3)) if covariance[0, 0] == -1.0 else covariance
