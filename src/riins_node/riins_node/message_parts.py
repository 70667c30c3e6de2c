"""What every message is made of: header, vectors, frames and constants of the standard messages.

Lives here: pieces that fields.py and status_fields.py share, as nested dicts.
Does not live here: whole messages, anything that imports ROS.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Fields = dict[str, Any]

MAP, MAP_NED, BASE, IMU = "map", "map_ned", "base_link", "imu_link"
SERVICE = {"gps": 1, "bds": 4}  # sensor_msgs/NavSatStatus SERVICE_GPS, SERVICE_COMPASS
STATUS_FIX, STATUS_NO_FIX = 0, -1
COVARIANCE_UNKNOWN, COVARIANCE_KNOWN = 0, 3


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


def flat(matrix: ArrayLike) -> Array:
    """Row-major covariance (n, n) or (m, n, n) as (n n,) or (m, n n)."""
    matrix = np.asarray(matrix, np.float64)
    return matrix.reshape(*matrix.shape[:-2], -1)
