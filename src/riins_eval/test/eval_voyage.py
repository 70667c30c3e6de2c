"""A minute's voyage for the tests of riins_eval, and what two runs of it are compared with."""

from __future__ import annotations

import numpy as np
import pytest

from riins_bag.bag import BagReader, BagWriter
from riins_eval.run_record import Track

VOYAGE = """
name: short
description: A minute with a lying GPS and a gyro that steps away.
duration_s: 60
start: {latitude_deg: 40, longitude_deg: 121, speed_kn: 8, heading_deg: 30}
legs: [{straight_s: 20}, {turn_deg: 40, rate_deg_s: 2}]
sea: {significant_wave_height_m: 1.0, peak_period_s: 6}
imu: {gyro: {constant_drift_deg_h: 0.02, arw_deg_sqrt_h: 0.003}, accel: {bias_ug: 50, vrw_ug_sqrt_hz: 15}}
gps: {period_s: 1, sigma_m: [2, 2, 4], lever_arm_m: [-5, 1, -8]}
bds: {period_s: 2, sigma_m: [4, 4, 8]}
doppler: {period_s: 1, lever_arm_m: [10, 0, 2], misalignment_deg: 0.1}
initial: {position_m: 3, tilt_arcsec: 20, heading_arcmin: 3}
faults:
  - {target: gps, type: step, axis: north, size_m: 80, start_s: 25, end_s: 35}
  - {target: gyro_4, type: step, size_deg_h: 200, start_s: 20, end_s: 40}
outages: [{target: bds, start_s: 10, end_s: 14}]
scoring: {from_s: 10}
expect: {isolated: [gps, gyro_4], false_isolations: {max: 0}, position_rms_m: {max: 6}}
"""


def equal(a: Track, b: Track) -> bool:
    """Bit for bit."""
    return all(np.array_equal(getattr(a, f), getattr(b, f)) for f in ("stamp_ns", "lat", "lon", "h", "v_n", "rph"))


def near(a, b, where: str = "") -> list[str]:
    """Places at which two JSON values differ by more than 1e-6."""
    if isinstance(a, dict) and isinstance(b, dict) and a.keys() == b.keys():
        return [place for key in a for place in near(a[key], b[key], f"{where}.{key}")]
    if isinstance(a, list) and isinstance(b, list) and len(a) == len(b):
        return [place for i, (x, y) in enumerate(zip(a, b, strict=True)) for place in near(x, y, f"{where}[{i}]")]
    if isinstance(a, float) and isinstance(b, float):
        return [] if a == pytest.approx(b, rel=1e-6, abs=1e-9) else [f"{where}: {a} {b}"]
    return [] if a == b and type(a) is type(b) else [f"{where}: {a} {b}"]


def rewrite(source, target, change) -> None:
    """A copy of a bag whose messages went through `change(topic, msgtype, message) -> message or None`."""
    with BagReader(source) as reader, BagWriter(target, flush_period_s=0.0) as writer:
        for one in reader.messages():
            if one.topic.startswith(("/nav/", "/fdi/", "/imu/", "/evaluation/")) and one.topic != "/nav/initial_state":
                continue
            made = change(one)
            if made is not None:
                writer.write(one.topic, one.msgtype, *made)
