"""What each message holds, as nested dicts of plain values made of algorithm objects: one mapping for live nodes and offline bags.

Lives here: one function per message. A stamp is integer nanoseconds; where arrays come with a leading dimension m, the dict describes m messages
(riins_bag packs such a block at once). `convert.fill` makes a rclpy message of a dict, riins_bag.serialize the bytes of a recording.
Does not live here: anything that imports ROS (convert.py), the way back (readings.py), frame algebra (riins_core.frames).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from riins_core import frames
from riins_core.rotation import skew

Array = NDArray[np.float64]
Fields = dict[str, Any]

MAP, MAP_NED, BASE, IMU = "map", "map_ned", "base_link", "imu_link"
SERVICE = {"gps": 1, "bds": 4}  # sensor_msgs/NavSatStatus SERVICE_GPS, SERVICE_COMPASS
STATUS_FIX, STATUS_NO_FIX = 0, -1
COVARIANCE_UNKNOWN, COVARIANCE_KNOWN = 0, 3
LEVELS = {"ok": 0, "warn": 1, "error": 2, "stale": 3}  # diagnostic_msgs/DiagnosticStatus

POS, VEL, PHI, BG, BA = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 12), slice(12, 15)  # riins_core.ins_error.State

_POSE = np.ix_([0, 1, 2, 6, 7, 8], [0, 1, 2, 6, 7, 8])  # position and phi


def header(stamp_ns: Any, frame_id: str) -> Fields:
    """std_msgs/Header; `stamp_ns` int or (m,)."""
    return {"stamp": stamp_ns, "frame_id": frame_id}


def vector(v: ArrayLike) -> Fields:
    """geometry_msgs/Vector3 or Point of (3,) or (m, 3)."""
    v = np.asarray(v, np.float64)
    return {"x": v[..., 0], "y": v[..., 1], "z": v[..., 2]}


def quaternion(q: ArrayLike) -> Fields:
    """geometry_msgs/Quaternion of a scalar-last quaternion (4,) or (m, 4)."""
    q = np.asarray(q, np.float64)
    return {"x": q[..., 0], "y": q[..., 1], "z": q[..., 2], "w": q[..., 3]}


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
        "angular_velocity_covariance": _flat(frames.frd_to_flu_covariance(rate_covariance)),
        "linear_acceleration": vector(frames.frd_to_flu(force)),
        "linear_acceleration_covariance": _flat(frames.frd_to_flu_covariance(force_covariance)),
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
        "angular_velocity_covariance": _flat(frames.frd_to_flu_covariance(rate_covariance)),
        "linear_acceleration": vector(frames.frd_to_flu(force)),
        "linear_acceleration_covariance": _flat(frames.frd_to_flu_covariance(force_covariance)),
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
        "orientation_covariance": _flat(frames.ned_to_enu_covariance(solution.P[PHI, PHI])),
        "angular_velocity": vector(frames.frd_to_flu(solution.rate_b)),
        "angular_velocity_covariance": _flat(frames.frd_to_flu_covariance(zeros if rate_covariance is None else rate_covariance + P[BG, BG])),
        "linear_acceleration": vector(frames.frd_to_flu(solution.force_b)),
        "linear_acceleration_covariance": _flat(frames.frd_to_flu_covariance(zeros if force_covariance is None else force_covariance + P[BA, BA])),
    }


def nav_state(solution: Any, sequence: int) -> Fields:
    """riins_msgs/NavState of a riins_federated NavSolution."""
    position, velocity, heading = solution.validity
    roll, pitch, yaw = (float(angle) for angle in solution.rph)
    sigma_position, sigma_velocity = _sigmas(solution.P[POS, POS]), _sigmas(solution.P[VEL, VEL])
    sigma_euler = _sigmas(_euler_covariance(roll, pitch, yaw, solution.P[PHI, PHI]))
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
    return {"header": header(int(solution.stamp_ns), MAP_NED), "labels": list(labels), "covariance": _flat(solution.P)}


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
            "covariance": _flat(to_map @ P[_POSE] @ to_map.T),
        },
        "twist": {
            "twist": {"linear": vector(frames.frd_to_flu(C_bn @ v_n)), "angular": vector(frames.frd_to_flu(solution.rate_b))},
            "covariance": _flat(twist_covariance),
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
        "position_covariance": _flat(frames.ned_to_enu_covariance(covariance)),
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
        "covariance": np.zeros(0) if state.covariance is None else _flat(state.covariance),
        "source": str(state.source),
    }


def innovation(judged: Any) -> Fields:
    """riins_msgs/Innovation of a riins_federated Judged."""
    return {
        "header": header(int(judged.stamp_ns), "doppler_link" if judged.name == "doppler" else MAP_NED),
        "subfilter": judged.name,
        "innovation": np.asarray(judged.innovation, np.float64),
        "sigma": np.asarray(judged.sigma, np.float64),
        "standardized": np.asarray(judged.standardized, np.float64),
        "statistic": float(judged.nis),
        "threshold": float(judged.threshold),
        "accepted": bool(judged.accepted),
        "reason": int(judged.reason),
    }


def nav_event(event: Any) -> Fields:
    """riins_msgs/NavEvent of a riins_federated NavEvent."""
    return {
        "stamp": int(event.stamp_ns),
        "kind": int(event.kind),
        "target": event.target,
        "state": int(event.state or 0),
        "reason": int(event.reason),
        "text": event.text,
    }


def federated_status(report: Any, text: str = "", events: Iterable[Any] = ()) -> Fields:
    """riins_msgs/FederatedStatus of a riins_federated FederatedReport; `text`: what changed, one line; `events`: the last NavEvents."""
    counters = ("imu_received", "imu_lost", "imu_rejected", "restarts", "rollbacks")
    return {
        "header": header(int(report.stamp_ns), MAP_NED),
        "mode": int(report.mode),
        "subfilters": [_subfilter(sub) for sub in report.subfilters],
        **{name: int(getattr(report, name)) for name in counters},
        "events": [nav_event(event) for event in events],
        "text": text,
    }


def inertial_fdi(status: Any, text: str | None = None) -> Fields:
    """riins_msgs/InertialFdi of a riins_imu_fusion FdiStatus; `text`: what changed, one line, None: the status' own."""
    counters = ("received", "fused", "lost", "rejected_length", "rejected_stamp", "rejected_no_solution", "restarts")
    return {
        "header": header(int(status.stamp_ns), IMU),
        "gyro": _triad(status.gyro),
        "accel": _triad(status.accel),
        **{name: int(getattr(status.counters, name)) for name in counters},
        "text": status.text if text is None else text,
    }


def fault(one: Any, start_at_ns: int = 0) -> Fields:
    """riins_msgs/Fault of a riins_sim Fault, whose times count from `start_at_ns`; no end is 0."""
    return {
        "target": one.target,
        "type": int(one.type),
        "size": float(one.size),
        "slope": float(one.slope),
        "axis": one.axis,
        "start": start_at_ns + int(one.start_ns),
        "end": 0 if one.end_ns is None else start_at_ns + int(one.end_ns),
    }


def fault_array(stamp_ns: int, faults: Iterable[Any], start_at_ns: int = 0) -> Fields:
    """riins_msgs/FaultArray of riins_sim faults."""
    return {"header": header(stamp_ns, ""), "faults": [fault(one, start_at_ns) for one in faults]}


def sensor_use(stamp_ns: int, target: str, use: bool) -> Fields:
    """riins_msgs/SensorUse, an accepted command; `stamp_ns`: from when on it holds, 0 or less: from the first sample on."""
    return {"header": header(max(int(stamp_ns), 0), ""), "target": target, "use": bool(use)}


def fusion_method(stamp_ns: int, selection: Any) -> Fields:
    """riins_msgs/FusionMethod of a riins_imu_fusion Selection; `stamp_ns`: from when on it holds, 0 or less: from the first sample on."""
    return {"header": header(max(int(stamp_ns), 0), ""), **selection._asdict()}


def inertial_calibration(calibration: Any) -> Fields:
    """riins_msgs/InertialCalibration of a riins_federated Calibration."""
    return {
        "header": header(calibration.effective_ns, IMU),
        "estimated": calibration.estimated_ns,
        "gyro_bias": vector(frames.frd_to_flu(calibration.gyro_bias)),
        "gyro_bias_covariance": _flat(frames.frd_to_flu_covariance(calibration.gyro_covariance)),
        "accel_bias": vector(frames.frd_to_flu(calibration.accel_bias)),
        "accel_bias_covariance": _flat(frames.frd_to_flu_covariance(calibration.accel_covariance)),
    }


def diagnostics(stamp_ns: int, statuses: Iterable[tuple[str, str, str, Mapping[str, Any]]], hardware_id: str = "riins") -> Fields:
    """diagnostic_msgs/DiagnosticArray of (name, level, message, values); level is one of `LEVELS`."""
    return {
        "header": header(stamp_ns, ""),
        "status": [
            {
                "level": bytes([LEVELS[level]]),
                "name": name,
                "message": message,
                "hardware_id": hardware_id,
                "values": [{"key": str(key), "value": str(value)} for key, value in values.items()],
            }
            for name, level, message, values in statuses
        ],
    }


def _twist(stamp_ns: Any, frame_id: str, linear: Array, covariance: Array) -> Fields:
    whole = np.zeros((*covariance.shape[:-2], 6, 6))
    whole[..., :3, :3] = covariance
    return {"header": header(stamp_ns, frame_id), "twist": {"twist": {"linear": vector(linear)}, "covariance": _flat(whole)}}


def _triad(triad: Any) -> Fields:
    return {
        "parity": np.asarray(triad.parity, np.float64),
        "statistic": float(triad.statistic),
        "threshold": float(triad.threshold),
        "dof": int(triad.dof),
        "detected": bool(triad.detected),
        "suspect": int(triad.suspect),
        "state": [int(state) for state in triad.state],
        "reason": [int(reason) for reason in triad.reason],
        "since": [int(since) for since in triad.since_ns],
        "drift": np.asarray(triad.drift, np.float64),
        "capability": int(triad.capability),
    }


def _subfilter(sub: Any) -> Fields:
    return {
        "name": sub.name,
        "state": int(sub.state),
        "reason": int(sub.reason),
        "stamp": int(sub.stamp_ns),
        "since": int(sub.since_ns),
        "statistic": float(sub.statistic),
        "threshold": float(sub.threshold),
        "beta": float(sub.beta),
        "information_trace": np.asarray(sub.information_trace, np.float64),
        "accepted": int(sub.accepted),
        "rejected": int(sub.rejected),
        "late": int(sub.late),
        "malformed": int(sub.malformed),
        "no_fix": int(sub.no_fix),
    }


def _flat(matrix: ArrayLike) -> Array:
    matrix = np.asarray(matrix, np.float64)
    return matrix.reshape(*matrix.shape[:-2], -1)


def _sigmas(covariance: Array) -> Array:
    return np.asarray(np.sqrt(np.maximum(np.diagonal(covariance), 0.0)))


def _euler_covariance(roll: float, pitch: float, heading: float, phi: Array) -> Array:
    """Covariance of the errors of roll, pitch, heading from that of phi (computed C_nb = (I - [phi x]) true C_nb), to first order."""
    cosine, sine = np.cos(heading), np.sin(heading)
    jacobian = -np.array(
        [
            [cosine / np.cos(pitch), sine / np.cos(pitch), 0.0],
            [-sine, cosine, 0.0],
            [cosine * np.tan(pitch), sine * np.tan(pitch), 1.0],
        ]
    )
    return np.asarray(jacobian @ phi @ jacobian.T)
