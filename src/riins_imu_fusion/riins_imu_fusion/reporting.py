"""What the fusion tells others: the fields of riins_msgs/InertialFdi and of diagnostics.

Lives here: `inertial_fdi`, `diagnosis`; live node and offline engine use the same.
Does not live here: anything that imports ROS (node.py), the status itself (pipeline.py).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from riins_fdi.health import HealthState
from riins_fdi.parity import Capability
from riins_imu_fusion.config import KINDS
from riins_imu_fusion.selection import CAUTION, Selection
from riins_imu_fusion.types import FdiStatus, Reason, TriadStatus

Fields = dict[str, Any]

_CAPABILITY = {
    Capability.ISOLATES: "a further fault can be isolated",
    Capability.DETECTS: "a further fault can be detected, not isolated",
    Capability.NEITHER: "no redundancy: a further fault is not seen",
    Capability.NO_SOLUTION: "no solution",
}


def inertial_fdi(status: FdiStatus, frame_id: str = "imu_link") -> Fields:
    """riins_msgs/InertialFdi as a nested dict of plain values, stamps in integer nanoseconds."""
    counters = status.counters
    return {
        "header": {"stamp": status.stamp_ns, "frame_id": frame_id},
        "gyro": _triad(status.gyro),
        "accel": _triad(status.accel),
        "received": counters.received,
        "fused": counters.fused,
        "lost": counters.lost,
        "rejected_length": counters.rejected_length,
        "rejected_stamp": counters.rejected_stamp,
        "rejected_no_solution": counters.rejected_no_solution,
        "restarts": counters.restarts,
        "text": status.text,
    }


def diagnosis(status: FdiStatus, alive: bool, selection: Selection) -> list[tuple[str, str, str, dict[str, Any]]]:
    """Statuses for diagnostic_msgs, (name, level, message, values): one for the stream and one for each triad.

    Parameters
    ----------
    status : state after the last sample
    alive : samples arrive (the node's wall clock decides)
    selection : methods in force
    """
    counters = status.counters._asdict()
    refused = {name: value for name, value in counters.items() if (name.startswith("rejected") or name in ("lost", "restarts")) and value}
    if not alive:
        level, message = "error", "no IMU: nothing on rimu/raw"
    elif Capability.NO_SOLUTION in (status.gyro.capability, status.accel.capability):
        level, message = "error", "no solution: too few usable axes"
    else:
        level, message = "ok", ", ".join(f"{name.replace('_', ' ')} {value}" for name, value in refused.items()) or "all samples fused"
    values: dict[str, Any] = {**counters, **selection._asdict()}
    if selection.fusion in CAUTION:
        values["caution"] = CAUTION[selection.fusion]
    reports = [("imu_fusion", level, message, values)]
    for kind, triad in zip(KINDS, (status.gyro, status.accel), strict=True):
        reports.append((f"imu_fusion: {kind}", *_diagnose_triad(kind, triad)))
    return reports


def _triad(triad: TriadStatus) -> Fields:
    return {
        "parity": triad.parity,
        "statistic": triad.statistic,
        "threshold": triad.threshold,
        "dof": triad.dof,
        "detected": triad.detected,
        "suspect": triad.suspect,
        "state": np.array(triad.state, np.uint8),
        "reason": np.array(triad.reason, np.uint8),
        "since": list(triad.since_ns),
        "drift": triad.drift,
        "bias": triad.bias,
        "bias_sigma": triad.bias_sigma,
        "sigma": triad.sigma,
        "capability": int(triad.capability),
    }


def _diagnose_triad(kind: str, triad: TriadStatus) -> tuple[str, str, dict[str, Any]]:
    values: dict[str, Any] = {
        "statistic": f"{triad.statistic:.3f}",
        "threshold": f"{triad.threshold:.3f}",
        "capability": _CAPABILITY[triad.capability],
        "used": " ".join(str(i) for i in range(len(triad.state)) if triad.used >> i & 1),
    }
    out = []
    for i, (state, reason) in enumerate(zip(triad.state, triad.reason, strict=True)):
        name, why = HealthState(state).name.lower(), Reason(reason).name.lower()
        values[f"{kind}_{i}"] = name if state == HealthState.HEALTHY else f"{name} ({why})"
        left = {Reason(r).name.lower(): int(count) for r, count in enumerate(triad.left_out[i]) if count}
        if np.isfinite(triad.sigma[i]):
            values[f"{kind}_{i} noise"] = f"{triad.sigma[i]:.3g}"
        if left:
            values[f"{kind}_{i} left out"] = ", ".join(f"{why} {count}" for why, count in left.items())
        if state not in (HealthState.HEALTHY, HealthState.COMPENSATED):
            out.append(f"{kind}_{i} {name}")
    if triad.capability is Capability.NO_SOLUTION:
        return "error", "no solution", values
    if triad.doubtful:
        return "warn", "; ".join(["doubtful: a fault is seen but not isolated", *out]), values
    if out or triad.capability is Capability.NEITHER:
        return "warn", "; ".join([*out, _CAPABILITY[triad.capability]]), values
    return "ok", f"all {len(triad.state)} healthy", values
