"""What comes out of the fusion, as plain dataclasses.

Lives here: fused blocks, status, events, counters, reasons (values as in riins_msgs/TriadFdi).
Does not live here: settings (config.py), messages (node.py, riins_node), any computation.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from riins_fdi.health import HealthState
from riins_fdi.parity import Capability

Array = NDArray[np.float64]


class Reason(IntEnum):
    """Why a sensor's state changed, TriadFdi.REASON_*."""

    NONE = 0
    PARITY = 1
    STUCK = 2
    NOT_FINITE = 3
    SATURATED = 4
    INVALID = 5
    OPERATOR = 6
    RECOVERED = 7


REASON_WORDS = {
    Reason.PARITY: "parity test",
    Reason.STUCK: "value stuck",
    Reason.NOT_FINITE: "not finite",
    Reason.SATURATED: "saturated",
    Reason.INVALID: "flagged invalid",
    Reason.OPERATOR: "operator",
    Reason.RECOVERED: "consistent again",
}


@dataclass(frozen=True)
class Recall:
    """What a sensor has put into the integrals of the fused output from the onset of its fault until it was declared.

    Attributes
    ----------
    stamp_ns : of the sample at which it was declared, itself free of it
    kind, index : the sensor: gyro or accel, number
    onset_ns : estimated beginning of the fault
    angle : (3,), rad, body FRD at `stamp_ns`: the integrated attitude is C_nb exp([angle x]) instead of C_nb
    velocity : (3,), m/s, body FRD at `stamp_ns`: excess of the integrated velocity
    """

    stamp_ns: int
    kind: str
    index: int
    onset_ns: int
    angle: Array
    velocity: Array

    def text(self) -> str:
        """For the text of an event: age of the fault and size of what is recalled."""
        size = f"{math.degrees(float(np.linalg.norm(self.angle))) * 60.0:.2f} arcmin" if self.kind == "gyro" else ""
        size = size or f"{float(np.linalg.norm(self.velocity)):.3g} m/s"
        return f"since {(self.stamp_ns - self.onset_ns) * 1e-9:.1f} s; recalled {size}"


class FusedBlock(NamedTuple):
    """Fused samples; those rejected are not in it.

    Attributes
    ----------
    stamp_ns : (m,) int64, end of the interval each is the mean over
    sequence : (m,) uint32, of the sample it was made of
    rate : (m, 3), rad/s, body FRD
    force : (m, 3), m/s^2, specific force, body FRD
    gyro_used, accel_used : (m,) uint64, bit i set: sensor i entered this sample
    gyro_statistic, accel_statistic : (m,), parity test's statistic of the sensors tested (before any is left out); NaN without redundancy
    gyro_drift, accel_drift : (m, n), removed from each sensor
    gyro_excess, accel_excess : (m, 3, 3), covariance beyond that of the stated white noise: what is left of the drifts, noise as estimated; body FRD
    recalls : what is to be taken out of the integrals at some of these stamps
    """

    stamp_ns: NDArray[np.int64]
    sequence: NDArray[np.uint32]
    rate: Array
    force: Array
    gyro_used: NDArray[np.uint64]
    accel_used: NDArray[np.uint64]
    gyro_statistic: Array
    accel_statistic: Array
    gyro_drift: Array
    accel_drift: Array
    gyro_excess: Array
    accel_excess: Array
    recalls: tuple[Recall, ...] = ()

    def __len__(self) -> int:
        return int(self.stamp_ns.size)

    def recalled(self) -> tuple[Array, Array, NDArray[np.int64]]:
        """What is recalled at each sample, all sensors together: angle (m, 3), velocity (m, 3), earliest onset (m,) ns; zeros nearly everywhere."""
        m = len(self)
        angle, velocity, onset = np.zeros((m, 3)), np.zeros((m, 3)), np.zeros(m, np.int64)
        for one in self.recalls:
            k = int(np.flatnonzero(self.stamp_ns == one.stamp_ns)[0])  # stamps may go back within a block
            angle[k] += one.angle
            velocity[k] += one.velocity
            onset[k] = min(int(onset[k]) or one.onset_ns, one.onset_ns)
        return angle, velocity, onset


def join(blocks: Sequence[FusedBlock]) -> FusedBlock:
    """Blocks one after the other."""
    columns = {name: np.concatenate([getattr(block, name) for block in blocks]) for name in FusedBlock._fields[:-1]}
    return FusedBlock(**columns, recalls=tuple(one for block in blocks for one in block.recalls))


@dataclass(frozen=True)
class FdiEvent:
    """A change that somebody should hear of."""

    stamp_ns: int
    kind: str
    """gyro, accel, stream, restart or command"""
    index: int
    """sensor, or -1"""
    state: HealthState | None
    reason: int
    text: str


class Counters(NamedTuple):
    """received = fused + rejected_length + rejected_stamp + rejected_no_solution, always."""

    received: int
    fused: int
    lost: int
    """missing in the sequence numbers"""
    rejected_length: int
    rejected_stamp: int
    rejected_no_solution: int
    restarts: int
    commands_refused: int
    calibrations_refused: int = 0


@dataclass(frozen=True)
class TriadStatus:
    """State of one kind of sensor after a sample; fields as in riins_msgs/TriadFdi, stamps in ns.

    Attributes
    ----------
    parity : (dof,), rad/s or m/s^2
    bias, bias_sigma : (n,), bias with its drift and its standard deviation, as in known_bias; NaN: not known
    suspect : sensor the test points at, -1: none, or it cannot tell
    sigma : (n,), white noise of a sample as estimated while running, rad/s or m/s^2; NaN: not yet
    doubtful : a fault was seen, within the probation time, that could not be resolved
    used : bit i set: sensor i entered the sample
    left_out : (n, 8), samples each sensor in use was left out of, by Reason
    """

    parity: Array
    statistic: float
    threshold: float
    dof: int
    detected: bool
    suspect: int
    state: tuple[int, ...]
    reason: tuple[int, ...]
    since_ns: tuple[int, ...]
    drift: Array
    bias: Array
    bias_sigma: Array
    sigma: Array
    capability: Capability
    doubtful: bool
    used: int
    left_out: NDArray[np.int64]


@dataclass(frozen=True)
class FdiStatus:
    """State of the redundant IMU after the sample of `stamp_ns`."""

    stamp_ns: int
    gyro: TriadStatus
    accel: TriadStatus
    counters: Counters
    text: str
    """what changed, one line; empty when periodic"""


class CommandResult(NamedTuple):
    """Answer to a command."""

    success: bool
    effective_ns: int
    """measurement time from which it holds; a smaller stamp than any for the first sample"""
    message: str
