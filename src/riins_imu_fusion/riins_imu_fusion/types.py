"""What comes out of the fusion, as plain dataclasses.

Lives here: fused blocks, status, events, counters, reasons (values as in riins_msgs/TriadFdi).
Does not live here: settings (config.py), messages (node.py, riins_node), any computation.
"""

from __future__ import annotations

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


class FusedBlock(NamedTuple):
    """Fused samples; those rejected are not in it.

    Attributes
    ----------
    stamp_ns : (m,) int64, end of the interval each is the mean over
    sequence : (m,) uint32, of the sample it was made of
    rate : (m, 3), rad/s, body FRD
    force : (m, 3), m/s^2, specific force, body FRD
    gyro_used, accel_used : (m,) uint64, bit i set: sensor i entered this sample
    gyro_statistic, accel_statistic : (m,), GLT statistic of the sensors tested (before any is left out); NaN without redundancy
    """

    stamp_ns: NDArray[np.int64]
    sequence: NDArray[np.uint32]
    rate: Array
    force: Array
    gyro_used: NDArray[np.uint64]
    accel_used: NDArray[np.uint64]
    gyro_statistic: Array
    accel_statistic: Array

    def __len__(self) -> int:
        return int(self.stamp_ns.size)


@dataclass(frozen=True)
class FdiEvent:
    """A change that somebody should hear of."""

    stamp_ns: int
    kind: str
    """gyro, accel, stream or command"""
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


@dataclass(frozen=True)
class TriadStatus:
    """State of one kind of sensor after a sample; fields as in riins_msgs/TriadFdi, stamps in ns.

    Attributes
    ----------
    parity : (dof,), rad/s or m/s^2
    suspect : sensor the test points at, -1: none, or it cannot tell
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
