"""What comes out of the fusion, put together from the loop's arrays and the health machines.

Lives here: `Health`, kept until a machine changes, `triad_status`, `fused_block`.
Does not live here: what the fields mean (types.py), messages (reporting.py).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from riins_fdi.health import TRIAD_CODE, HealthMachine
from riins_imu_fusion import state as K
from riins_imu_fusion.tables import TableCache
from riins_imu_fusion.types import FusedBlock, Recall, TriadStatus

Array = NDArray[np.float64]


class Health(NamedTuple):
    """States of one kind of sensor."""

    state: tuple[int, ...]
    reason: tuple[int, ...]
    since_ns: tuple[int, ...]
    in_use: int


def health_of(machines: Sequence[HealthMachine]) -> Health:
    """States of the machines of one kind of sensor."""
    return Health(
        tuple(TRIAD_CODE[machine.state] for machine in machines),
        tuple(machine.reason for machine in machines),
        tuple(machine.since_ns for machine in machines),
        sum(1 << i for i, machine in enumerate(machines) if machine.in_use),
    )


def triad_status(
    kind: int, st: K.State, health: Health, cache: TableCache, drift: Array, bias: tuple[Array, Array], sigma: Array
) -> TriadStatus:  # fmt: skip
    """Status of gyros (kind 0) or accelerometers (1); `drift` as removed, `bias` and its sigma as known, `sigma` as estimated, (n,) each."""
    tested = int(st.key[kind]) if st.clock[K.HAVE] else (1 << len(health.state)) - 1
    test = cache.test(kind, tested)
    return TriadStatus(
        parity=test.V @ st.z[kind],
        statistic=float(st.statistic[kind]),
        threshold=cache.threshold(kind, tested),
        dof=max(0, test.dof),
        detected=int(st.alarm[kind]) != K.QUIET,
        suspect=int(st.suspect[kind]),
        state=health.state,
        reason=health.reason,
        since_ns=health.since_ns,
        drift=drift,
        bias=bias[0],
        bias_sigma=bias[1],
        sigma=sigma.copy(),
        capability=cache.test(kind, health.in_use & tested).capability,  # of what can serve the next sample
        doubtful=bool(st.doubt[kind]),
        used=int(st.used[kind]),
        left_out=st.left_out[kind].copy(),
    )


def fused_block(out: K.Output, m: int, recalls: tuple[Recall, ...]) -> FusedBlock:
    """The first m samples of the output."""
    (rate, force), (gyro_used, accel_used), (gyro_statistic, accel_statistic) = out.fused[:, :m], out.used[:, :m], out.statistic[:, :m]
    columns = (out.stamp[:m], out.sequence[:m], rate, force, gyro_used, accel_used, gyro_statistic, accel_statistic)
    (gyro_drift, accel_drift), (gyro_excess, accel_excess) = out.drift[:, :m], out.excess[:, :m]
    return FusedBlock(*columns, gyro_drift, accel_drift, gyro_excess, accel_excess, recalls)
