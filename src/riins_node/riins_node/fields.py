"""What each message holds, as nested dicts of plain values made of algorithm objects: one mapping for live nodes and offline bags.

Lives here: one function per message. A stamp is integer nanoseconds; where arrays come with a leading dimension m, the dict describes m messages
(riins_bag packs such a block at once). `convert.fill` makes a rclpy message of a dict, riins_bag.serialize the bytes of a recording.
Does not live here: health and decisions (status_fields.py, had here by the same names), anything that imports ROS (convert.py), the way back
(readings.py), frame algebra (riins_core.frames).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from riins_core import frames
from riins_core.ins_error import BA, BG, PHI, POS, VEL
from riins_core.rotation import dcm_from_euler, skew
from riins_node.message_parts import (
    BASE,
    COVARIANCE_KNOWN,
    COVARIANCE_UNKNOWN,
    IMU,
    MAP,
    MAP_NED,
    SERVICE,
    STATUS_FIX,
    STATUS_NO_FIX,
    Array,
    Fields,
    flat,
    header,
    quaternion,
    vector,
)
from riins_node.status_fields import (
    diagnostics,
    fault,
    fault_array,
    federated_status,
    fusion_method,
    inertial_calibration,
    inertial_fdi,
    innovation,
    nav_event,
    sensor_use,
)

_POSE = np.ix_([0, 1, 2, 6, 7, 8], [0, 1, 2, 6, 7, 8])  # position and phi


def redundant_imu(stamp_ns: Any, sequence: Any, gyro: ArrayLike, accel: ArrayLike, gyro_valid: Any, accel_valid: Any, frame_id: str = IMU) -> Fields:
    """riins_msgs/RedundantImu.

    Parameters
    ----------
    stamp_ns, sequence : int, or (m,)
    gyro, accel : (n,) or (m, n), means along the sensor axes, rad/s, m/s^2
    gyro_valid, accel_valid : bit i set: sensor i reports itself valid; int, or (m,)
    """
    return {
        "header": header(stamp_ns, frame_id),
        "sequence": sequence,
        "gyro": np.asarray(gyro, np.float64),
        "accel": np.asarray(accel, np.float64),
        "gyro_valid": gyro_valid,
        "accel_valid": accel_valid,
    }


def fused_imu(
    stamp_ns: Any,
    sequence: Any,
    rate: ArrayLike,
    force: ArrayLike,
    rate_covariance: ArrayLike,
    force_covariance: ArrayLike,
    gyro_used: Any,
    accel_used: Any,
    gyro_drift: ArrayLike = (),
    accel_drift: ArrayLike = (),
    method: int = 0,
    angle_recall: ArrayLike = (0.0, 0.0, 0.0),
    velocity_recall: ArrayLike = (0.0, 0.0, 0.0),
    recall_onset_ns: Any = 0,
) -> Fields:
    """riins_msgs/FusedImu.

    Parameters
    ----------
    stamp_ns, sequence, gyro_used, accel_used : int, or (m,)
    rate, force : (3,) or (m, 3), FRD, rad/s, m/s^2
    rate_covariance, force_covariance : (3, 3) or (m, 3, 3), FRD
    gyro_drift, accel_drift : per sensor, what was removed
    angle_recall, velocity_recall, recall_onset_ns : (3,), (3,), int, or with m rows as `rate`; FRD, rad, m/s, ns; zeros: nothing
    """
    return {
        "header": header(stamp_ns, IMU),
        "sequence": sequence,
        "angular_velocity": vector(frames.frd_to_flu(rate)),
        "angular_velocity_covariance": flat(frames.frd_to_flu_covariance(rate_covariance)),
        "linear_acceleration": vector(frames.frd_to_flu(force)),
        "linear_acceleration_covariance": flat(frames.frd_to_flu_covariance(force_covariance)),
        "gyro_drift": np.asarray(gyro_drift, np.float64),
        "accel_drift": np.asarray(accel_drift, np.float64),
        "gyro_used": gyro_used,
        "accel_used": accel_used,
        "method": method,
        "angle_recall": vector(frames.frd_to_flu(angle_recall)),
        "velocity_recall": vector(frames.frd_to_flu(velocity_recall)),
        "recall_onset": recall_onset_ns,
    }


def imu_raw(stamp_ns: Any, rate: ArrayLike, force: ArrayLike, rate_covariance: ArrayLike, force_covariance: ArrayLike) -> Fields:
    """sensor_msgs/Imu without orientation (REP-145): orientation_covariance[0] = -1. Arguments as in `fused_imu`."""
    no_orientation = np.zeros(9)
    no_orientation[0] = -1.0
    return {
        "header": header(stamp_ns, IMU),
        "orientation": {"w": 1.0},
        "orientation_covariance": no_orientation,
        "angular_velocity": vector(frames.frd_to_flu(rate)),
        "angular_velocity_covariance": flat(frames.frd_to_flu_covariance(rate_covariance)),
        "linear_acceleration": vector(frames.frd_to_flu(force)),
        "linear_acceleration_covariance": flat(frames.frd_to_flu_covariance(force_covariance)),
    }


def imu(solution: Any, rate_covariance: ArrayLike | None = None, force_covariance: ArrayLike | None = None) -> Fields:
    """sensor_msgs/Imu with attitude: `base_link` in the local ENU axes, rate relative to them, specific force less bias.

    Parameters
    ----------
    solution : riins_federated NavSolution
    rate_covariance, force_covariance : (3, 3), FRD, of one sample's noise, to which that of the bias is added; None: unknown (zeros)
    """
    zeros, P = np.zeros((3, 3)), np.asarray(solution.P)
    return {
        "header": header(solution.stamp_ns, BASE),
        "orientation": quaternion(frames.attitude_to_enu(solution.C_nb)),
        "orientation_covariance": flat(frames.ned_to_enu_covariance(solution.P[PHI, PHI])),
        "angular_velocity": vector(frames.frd_to_flu(solution.rate_b)),
        "angular_velocity_covariance": flat(frames.frd_to_flu_covariance(zeros if rate_covariance is None else rate_covariance + P[BG, BG])),
        "linear_acceleration": vector(frames.frd_to_flu(solution.force_b)),
        "linear_acceleration_covariance": flat(frames.frd_to_flu_covariance(zeros if force_covariance is None else force_covariance + P[BA, BA])),
    }


def nav_state(solution: Any, sequence: int) -> Fields:
    """riins_msgs/NavState of a riins_federated NavSolution."""
    position, velocity, heading = solution.validity
    roll, pitch, yaw = (float(angle) for angle in solution.rph)
    sigma_position, sigma_velocity = sigmas(solution.P[POS, POS]), sigmas(solution.P[VEL, VEL])
    sigma_euler = sigmas(euler_covariance(roll, pitch, yaw, solution.P[PHI, PHI]))
    reset_position, reset_velocity, reset_heading = solution.reset
    names: list[tuple[str, Sequence[str], Iterable[float]]] = [
        ("velocity", ("north", "east", "down"), solution.v_n),
        ("rate", ("x", "y", "z"), solution.rate_b),
        ("gyro_bias", ("x", "y", "z"), solution.bias_g),
        ("accel_bias", ("x", "y", "z"), solution.bias_a),
        ("sigma", ("north", "east", "down"), sigma_position),
        ("sigma_velocity", ("north", "east", "down"), sigma_velocity),
        ("sigma", ("roll", "pitch", "heading"), sigma_euler),
    ]
    fields: Fields = {
        "header": header(int(solution.stamp_ns), MAP_NED),
        "sequence": sequence,
        "mode": int(solution.mode),
        "position_validity": int(position),
        "velocity_validity": int(velocity),
        "heading_validity": int(heading),
        "latitude": float(np.degrees(solution.lat)),
        "longitude": float(np.degrees(solution.lon)),
        "height": float(solution.h),
        "roll": roll,
        "pitch": pitch,
        "heading": yaw,
        "protection_radius": float(solution.protection_radius),
        "protection_heading": float(solution.protection_heading),
        "reset_count": int(solution.reset_count),
        "reset_position": float(reset_position),
        "reset_velocity": float(reset_velocity),
        "reset_heading": float(reset_heading),
    }
    for stem, suffixes, values in names:
        fields.update((f"{stem}_{suffix}", float(value)) for suffix, value in zip(suffixes, values, strict=True))
    return fields


def nav_covariance(solution: Any, labels: Sequence[str]) -> Fields:
    """riins_msgs/NavCovariance: the whole covariance of a NavSolution, with one label per state."""
    return {"header": header(int(solution.stamp_ns), MAP_NED), "labels": list(labels), "covariance": flat(solution.P)}


def odometry(solution: Any, local_frame: frames.LocalFrame, rate_covariance: ArrayLike | None = None) -> Fields:
    """nav_msgs/Odometry: `base_link` (FLU) in `map`, the ENU plane that touches the ellipsoid at the datum; twist in `base_link`.

    Parameters
    ----------
    solution : riins_federated NavSolution
    local_frame : at the datum
    rate_covariance : (3, 3), FRD, of one sample's noise; None: that of the gyro bias alone is given

    Notes
    -----
    Rotations of the pose covariance are about the fixed axes of `map`. The attitude error phi turns the other way round than the pose does
    (computed C_nb = (I - [phi x]) true C_nb), hence the minus sign of its cross-covariance with position.
    """
    P, C_bn = np.asarray(solution.P), np.asarray(solution.C_nb).T
    map_from_n = local_frame.vector(solution.lat, solution.lon, np.eye(3)).T
    to_map = np.zeros((6, 6))
    to_map[:3, :3], to_map[3:, 3:] = map_from_n, -map_from_n
    # v_b = C_bn v_n: its error is C_bn (dv + phi x v)
    v_n = np.asarray(solution.v_n, np.float64)
    to_body = np.hstack([C_bn, -C_bn @ skew(v_n)])
    twist_covariance = np.zeros((6, 6))
    twist_covariance[:3, :3] = frames.frd_to_flu_covariance(to_body @ P[3:9, 3:9] @ to_body.T)
    twist_covariance[3:, 3:] = frames.frd_to_flu_covariance(P[BG, BG] + (0.0 if rate_covariance is None else np.asarray(rate_covariance)))
    return {
        "header": header(int(solution.stamp_ns), MAP),
        "child_frame_id": BASE,
        "pose": {
            "pose": {
                "position": vector(local_frame.to_enu(solution.lat, solution.lon, solution.h)),
                "orientation": quaternion(local_frame.attitude(solution.lat, solution.lon, solution.C_nb)),
            },
            "covariance": flat(to_map @ P[_POSE] @ to_map.T),
        },
        "twist": {
            "twist": {"linear": vector(frames.frd_to_flu(C_bn @ v_n)), "angular": vector(frames.frd_to_flu(solution.rate_b))},
            "covariance": flat(twist_covariance),
        },
    }


def position_fix(stamp_ns: Any, lat: Any, lon: Any, h: Any, covariance: ArrayLike, frame_id: str, service: int = 0, has_fix: bool = True) -> Fields:
    """sensor_msgs/NavSatFix.

    Parameters
    ----------
    stamp_ns, lat, lon, h : int ns, rad, rad, m above the ellipsoid; or (m,) each
    covariance : (3, 3) or (m, 3, 3), NED, m^2; all zeros: unknown
    frame_id : of the antenna
    service : NavSatStatus.SERVICE_*, see `SERVICE`
    has_fix : False: STATUS_NO_FIX
    """
    covariance = np.asarray(covariance, np.float64)
    return {
        "header": header(stamp_ns, frame_id),
        "status": {"status": STATUS_FIX if has_fix else STATUS_NO_FIX, "service": service},
        "latitude": np.degrees(lat),
        "longitude": np.degrees(lon),
        "altitude": h,
        "position_covariance": flat(frames.ned_to_enu_covariance(covariance)),
        "position_covariance_type": COVARIANCE_KNOWN if covariance.any() else COVARIANCE_UNKNOWN,
    }


def nav_fix(solution: Any) -> Fields:
    """sensor_msgs/NavSatFix of a NavSolution, at `base_link`; STATUS_NO_FIX while the position is invalid."""
    return position_fix(
        int(solution.stamp_ns), solution.lat, solution.lon, solution.h, solution.P[POS, POS], BASE, 0, has_fix=int(solution.validity[0]) != 2
    )


def origin(stamp_ns: int, lat: float, lon: float, h: float) -> Fields:
    """sensor_msgs/NavSatFix of the origin of `map` [rad, rad, m]; exact by definition, so its covariance is unknown (zeros)."""
    return position_fix(stamp_ns, lat, lon, h, np.zeros((3, 3)), MAP)


def velocity(stamp_ns: Any, v_n: ArrayLike, covariance: ArrayLike) -> Fields:
    """geometry_msgs/TwistWithCovarianceStamped in ENU, frame `map`: `v_n` (3,) or (m, 3) NED m/s, covariance (3, 3) NED."""
    return _twist(stamp_ns, MAP, frames.ned_to_enu(v_n), frames.ned_to_enu_covariance(covariance))


def doppler(stamp_ns: Any, v_b: ArrayLike, covariance: ArrayLike, frame_id: str = "doppler_link") -> Fields:
    """geometry_msgs/TwistWithCovarianceStamped of a log, FLU: `v_b` (3,) or (m, 3) FRD m/s, a NaN third is not measured; covariance (3, 3) FRD."""
    return _twist(stamp_ns, frame_id, frames.frd_to_flu(v_b), frames.frd_to_flu_covariance(covariance))


def height(stamp_ns: Any, h: Any, variance: float, frame_id: str = "altimeter_link") -> Fields:
    """geometry_msgs/PoseWithCovarianceStamped of a height: `h` float or (m,) in m above the ellipsoid is position.z; nothing else in it is meant."""
    h = np.asarray(h, np.float64)
    whole = np.zeros((6, 6))
    whole[2, 2] = variance
    position = {"x": np.zeros_like(h), "y": np.zeros_like(h), "z": h}
    return {"header": header(stamp_ns, frame_id), "pose": {"pose": {"position": position, "orientation": {"w": 1.0}}, "covariance": flat(whole)}}


def attitude(stamp_ns: Any, rph: ArrayLike, covariance: ArrayLike) -> Fields:
    """geometry_msgs/PoseWithCovarianceStamped of a star sensor: the orientation of its FLU axes in local ENU; nothing else in it is meant.

    Parameters
    ----------
    stamp_ns : int, or (m,)
    rph : (3,) or (m, 3), roll, pitch, heading, rad
    covariance : (3, 3), of small rotations about forward, starboard, down; the message has it about the fixed axes of ENU
    """
    C_nb = dcm_from_euler(*np.moveaxis(np.asarray(rph, np.float64), -1, 0))
    whole = np.zeros((*C_nb.shape[:-2], 6, 6))
    whole[..., 3:, 3:] = frames.ned_to_enu_covariance(C_nb @ np.asarray(covariance) @ np.swapaxes(C_nb, -1, -2))
    return {"header": header(stamp_ns, MAP), "pose": {"pose": {"orientation": quaternion(frames.attitude_to_enu(C_nb))}, "covariance": flat(whole)}}


def initial_state(state: Any) -> Fields:
    """riins_msgs/InitialState of an object with the attributes of riins_federated.types.InitialState."""
    position = {"latitude": float(np.degrees(state.lat)), "longitude": float(np.degrees(state.lon)), "height": float(state.h)}
    speed = {f"velocity_{axis}": float(v) for axis, v in zip(("north", "east", "down"), state.v_n, strict=True)}
    attitude = {name: float(angle) for name, angle in zip(("roll", "pitch", "heading"), state.rph, strict=True)}
    sigmas = ("sigma_position", "sigma_velocity", "sigma_attitude", "sigma_gyro_bias", "sigma_accel_bias")
    return {
        "header": header(int(state.stamp_ns), MAP_NED),
        **position,
        **speed,
        **attitude,
        **{name: np.asarray(getattr(state, name), np.float64) for name in sigmas},
        "covariance": np.zeros(0) if state.covariance is None else flat(state.covariance),
        "source": str(state.source),
    }


def _twist(stamp_ns: Any, frame_id: str, linear: Array, covariance: Array) -> Fields:
    whole = np.zeros((*covariance.shape[:-2], 6, 6))
    whole[..., :3, :3] = covariance
    return {"header": header(stamp_ns, frame_id), "twist": {"twist": {"linear": vector(linear)}, "covariance": flat(whole)}}


def sigmas(covariance: Array) -> Array:
    """Square roots (.., n) of the diagonals of covariances (.., n, n)."""
    return np.asarray(np.sqrt(np.maximum(np.diagonal(covariance, axis1=-2, axis2=-1), 0.0)))


def euler_covariance(roll: ArrayLike, pitch: ArrayLike, heading: ArrayLike, phi: Array) -> Array:
    """Covariance (.., 3, 3) of the errors of roll, pitch, heading from that of phi (computed C_nb = (I - [phi x]) true C_nb), to first order."""
    cosine, sine = np.cos(heading), np.sin(heading)
    zero, one = np.zeros_like(cosine), np.ones_like(cosine)
    rows = [
        [cosine / np.cos(pitch), sine / np.cos(pitch), zero],
        [-sine, cosine, zero],
        [cosine * np.tan(pitch), sine * np.tan(pitch), one],
    ]
    jacobian = -np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
    return np.asarray(jacobian @ phi @ np.swapaxes(jacobian, -1, -2))


__all__ = [
    "BASE",
    "COVARIANCE_KNOWN",
    "COVARIANCE_UNKNOWN",
    "Fields",
    "IMU",
    "MAP",
    "MAP_NED",
    "SERVICE",
    "STATUS_FIX",
    "STATUS_NO_FIX",
    "attitude",
    "diagnostics",
    "doppler",
    "euler_covariance",
    "fault",
    "fault_array",
    "federated_status",
    "fused_imu",
    "height",
    "fusion_method",
    "header",
    "imu",
    "imu_raw",
    "inertial_calibration",
    "inertial_fdi",
    "initial_state",
    "innovation",
    "nav_covariance",
    "nav_event",
    "nav_fix",
    "nav_state",
    "odometry",
    "origin",
    "position_fix",
    "quaternion",
    "redundant_imu",
    "sensor_use",
    "sigmas",
    "vector",
    "velocity",
]
