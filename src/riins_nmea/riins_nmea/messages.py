"""Fields of the messages this package publishes, as nested dicts that `riins_node.convert.fill` takes.

Lives here: `vessel_motion`, `nav_sat_fix`, `ground_velocity`, `body_velocity`, `heading_pose`.
Does not live here: the values (motion.py, aids.py), anything that imports ROS.
"""

from __future__ import annotations

import math

import numpy as np

from riins_node import fields

from .aids import Reading
from .motion import Motion

SERVICES = {"GP": 1, "GL": 2, "GB": 4, "BD": 4, "GA": 8, "GN": 15}
"""sensor_msgs/NavSatStatus SERVICE_* by talker."""


def vessel_motion(motion: Motion, sequence: int) -> fields.Fields:
    """riins_msgs/VesselMotion."""
    names = ("roll", "pitch", "heading")
    return {
        "header": fields.header(motion.stamp_ns, fields.MAP_NED),
        "sequence": sequence,
        "attitude_validity": motion.attitude_validity,
        "heading_validity": motion.heading_validity,
        "heave_validity": motion.heave_validity,
        **dict(zip(names, motion.rph, strict=True)),
        **{f"{name}_rate": rate for name, rate in zip(names, motion.rph_rate, strict=True)},
        "heave": motion.heave,
        "heave_velocity": motion.heave_velocity,
        **{f"sigma_{name}": sigma for name, sigma in zip(names, motion.sigma_rph, strict=True)},
        "sigma_heave": motion.sigma_heave,
        "sigma_heave_velocity": motion.sigma_heave_velocity,
    }


def nav_sat_fix(reading: Reading, frame_id: str) -> fields.Fields:
    """sensor_msgs/NavSatFix; STATUS_NO_FIX without a position."""
    lat, lon, h = reading.z
    return fields.position_fix(reading.stamp_ns, lat, lon, h, np.diag(reading.sigma**2), frame_id, SERVICES.get(reading.talker, 0), reading.ok)


def ground_velocity(reading: Reading, frame_id: str) -> fields.Fields:
    """geometry_msgs/TwistWithCovarianceStamped, ENU; the vertical component is not measured (NaN)."""
    return {**(made := fields.velocity(reading.stamp_ns, reading.z, np.diag(reading.sigma**2))), "header": {**made["header"], "frame_id": frame_id}}


def body_velocity(reading: Reading, frame_id: str) -> fields.Fields:
    """geometry_msgs/TwistWithCovarianceStamped, FLU; the vertical component is not measured (NaN)."""
    return fields.doppler(reading.stamp_ns, reading.z, np.diag(reading.sigma**2), frame_id)


def heading_pose(reading: Reading, frame_id: str) -> fields.Fields:
    """geometry_msgs/PoseWithCovarianceStamped: heading as yaw about up from east, covariance[35]; nothing else of the pose is known."""
    half = 0.5 * (0.5 * math.pi - float(reading.z[0]))
    covariance = np.zeros(36)
    covariance[35] = float(reading.sigma[0]) ** 2
    return {
        "header": fields.header(reading.stamp_ns, frame_id),
        "pose": {"pose": {"orientation": {"z": math.sin(half), "w": math.cos(half)}}, "covariance": covariance},
    }
