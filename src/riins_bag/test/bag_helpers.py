"""Bags and messages for the tests of riins_bag.

Lives here: small recordings with known numbers.
Does not live here: any test.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from riins_bag.bag import BagWriter

RAW = "riins_msgs/msg/RedundantImu"
NAV = "riins_msgs/msg/NavState"
EVENT = "riins_msgs/msg/Innovation"
FIX = "sensor_msgs/msg/NavSatFix"
EPOCH_NS = 1_700_000_000_000_000_000
DT_NS = 10_000_000


def raw_fields(k: int, n: int = 6) -> dict[str, Any]:
    """RedundantImu of sample k with numbers that name it."""
    return {
        "header": {"stamp": EPOCH_NS + k * DT_NS, "frame_id": "imu_link"},
        "sequence": k,
        "gyro": k + np.arange(n) / 16.0,
        "accel": -k - np.arange(n) / 16.0,
        "gyro_valid": 2**n - 1,
        "accel_valid": 2**64 - 1,
    }


def innovation_fields(k: int, name: str) -> dict[str, Any]:
    """Innovation with one or three components by subfilter."""
    size = 1 if name == "height" else 3
    z = k + np.arange(size, dtype=float)
    return {
        "header": {"stamp": EPOCH_NS + k * DT_NS, "frame_id": "map_ned"},
        "subfilter": name,
        "innovation": z,
        "sigma": z + 1.0,
        "accepted": k % 2 == 0,
    }


def make_bag(path: Path, m: int = 2000, chunk_bytes: int = 8192, **options: Any) -> Path:
    """Bag of m raw samples (100 Hz), a fix and innovations every 100 samples, and a configuration."""
    with BagWriter(path, chunk_bytes=chunk_bytes, flush_period_s=0.0, **options) as bag:
        fill_bag(bag, m)
    return path


def fill_bag(bag: BagWriter, m: int) -> None:
    """Messages of `make_bag`, one by one."""
    bag.write_configuration("scenario: {name: test}\n", EPOCH_NS)
    for k in range(1, m + 1):
        stamp = EPOCH_NS + k * DT_NS
        bag.write_message("/rimu/raw", RAW, raw_fields(k), stamp)
        if k % 100 == 0:
            bag.write_message("/gps/fix", FIX, {"header": {"stamp": stamp, "frame_id": "gps_link"}, "latitude": k * 0.01}, stamp, "aid")
            for name in ("gps", "height", "doppler"):
                bag.write_message("/nav/innovations", EVENT, innovation_fields(k, name), stamp)
