"""What the array of IMUs tells others: diagnostics, changes in one line, the parameter file for imu_fusion.

Lives here: `diagnosis`, `Changes`, `parameter_file`.
Does not live here: anything that imports ROS (nodes/imu_array.py), the counts themselves (array_align.py).
"""

from __future__ import annotations

import math
from typing import Any

import yaml

from riins_imu_fusion.array_align import ArrayAligner
from riins_imu_fusion.array_config import ArrayConfig
from riins_imu_fusion.array_mounting import Mounting, MountingEstimator

Status = tuple[str, str, str, dict[str, Any]]


def redundancy(imus: int) -> str:
    """What so many IMUs can do about a fault, in words."""
    if imus < 2:
        return "one IMU, no redundancy: a fault is not seen" if imus else "no IMU"
    return "two IMUs: a fault is detected, not isolated" if imus == 2 else f"{imus} IMUs: a fault is isolated, also one of a whole IMU"


def parameter_file(config: ArrayConfig, node: str = "/imu_fusion") -> str:
    """Text of a ROS parameter file that makes `imu_fusion` fit the array."""
    return yaml.safe_dump({node: {"ros__parameters": config.fusion_parameters()}}, default_flow_style=None, sort_keys=False, width=1000)


def diagnosis(aligner: ArrayAligner, mounting: MountingEstimator | None) -> list[Status]:
    """Statuses for diagnostic_msgs, (name, level, message, values): one for the array and one for each IMU."""
    config = aligner.config
    alive = [stream.received > 0 and not stream.out for stream in aligner.streams]
    level = "error" if not any(alive) else "warn" if not all(alive) or sum(alive) < 2 else "ok"
    values: dict[str, Any] = {"restarts": aligner.restarts, "intervals without a valid IMU": aligner.empty}
    reports: list[Status] = [("imu_array", level, redundancy(sum(alive)), values)]
    for i, (topic, stream) in enumerate(zip(config.topics, aligner.streams, strict=True)):
        counts = {cause.value: count for cause, count in stream.counts.items() if count}
        absent = "its clock is out of step" if stream.out_of_step else "silent"
        words = "never heard" if not stream.received else absent if stream.out else "aligned"
        known = {} if mounting is None or i == 0 else _mounting(mounting.result(i))
        values = {"received": stream.received, "outputs": stream.used, **counts, **known}
        reports.append((f"imu_array: {topic}", "ok" if alive[i] else "error", words, values))
    return reports


class Changes:
    """IMUs that fall silent and return, and mountings that become known, each told once.

    Parameters
    ----------
    aligner, mounting : watched; None: no mounting is estimated
    """

    def __init__(self, aligner: ArrayAligner, mounting: MountingEstimator | None) -> None:
        self._aligner, self._mounting = aligner, mounting
        self._out = [False] * aligner.config.n
        self._known = [False] * aligner.config.n
        self._restarts = 0

    def drain(self) -> list[str]:
        """Lines since the last call."""
        lines = []
        if self._aligner.restarts != self._restarts:
            self._restarts = self._aligner.restarts
            lines.append("all stamps went back: the array starts anew")
        for i, (topic, stream) in enumerate(zip(self._aligner.config.topics, self._aligner.streams, strict=True)):
            if stream.out != self._out[i]:
                self._out[i] = stream.out
                gone = "left out: its clock is out of step" if stream.out_of_step else "silent"
                lines.append(f"{topic} {gone}" if stream.out else f"{topic} is back")
            if self._mounting is not None and i > 0:
                found = self._mounting.result(i)
                if found.known and not self._known[i]:
                    lines.append(f"{topic} is turned by {_degrees(found.angle)} deg against {self._aligner.config.topics[0]}")
                self._known[i] = found.known
        return lines


def _mounting(found: Mounting) -> dict[str, str]:
    words = "known" if found.known else f"{found.directions} of 3 directions: it takes turns about two axes"
    return {
        "mounting": words,
        "mounting angle [deg]": f"{_degrees(found.angle)} +- {_degrees(found.angle_sigma)}",
        "gyro bias against the first [rad/s]": " ".join(f"{value:+.2e}" for value in found.bias),
        "clock against the first [ms]": f"{1e3 * found.clock:+.2f} +- {1e3 * found.clock_sigma:.2f}",
        "comparisons": f"{found.used}, {found.left_out} left out, misfit {found.misfit:.2f}",
    }


def _degrees(angles: Any) -> str:
    return " ".join(f"{math.degrees(angle):+.3f}" for angle in angles)
