"""Messages about health and decisions, as nested dicts: innovations, events, states of sensors and subfilters, faults, commands, diagnostics.

Lives here: one function per message; riins_node.fields has them by the same names.
Does not live here: samples, aids and navigation states (fields.py), anything that imports ROS.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from riins_core import frames
from riins_node.message_parts import IMU, MAP_NED, Fields, flat, header, vector

LEVELS = {"ok": 0, "warn": 1, "error": 2, "stale": 3}  # diagnostic_msgs/DiagnosticStatus


def innovation(judged: Any) -> Fields:
    """riins_msgs/Innovation of a riins_federated Judged."""
    return {
        "header": header(int(judged.stamp_ns), judged.frame),
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
        "cross_check": float(report.cross_check),
        "cross_check_threshold": float(report.cross_check_threshold),
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
        "gyro_bias_covariance": flat(frames.frd_to_flu_covariance(calibration.gyro_covariance)),
        "accel_bias": vector(frames.frd_to_flu(calibration.accel_bias)),
        "accel_bias_covariance": flat(frames.frd_to_flu_covariance(calibration.accel_covariance)),
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
        "separation": float(sub.separation),
        "separation_threshold": float(sub.separation_threshold),
        "beta": float(sub.beta),
        "information_trace": np.asarray(sub.information_trace, np.float64),
        "accepted": int(sub.accepted),
        "rejected": int(sub.rejected),
        "late": int(sub.late),
        "malformed": int(sub.malformed),
        "no_fix": int(sub.no_fix),
    }
