"""The parity test within the compiled loop: its statistic, and who explains an alarm.

Lives here: kernels on the tables of one set of sensors.
Does not live here: the tests as objects (riins_fdi.methods), the tables (tables.py), what follows from an answer (samples.py, kernel.py).
"""

from __future__ import annotations

import numpy as np

from riins_core.jit import jit
from riins_fdi.parity import parity_vector, suspect, suspect_pair
from riins_imu_fusion.state import RESOLVED, UNRESOLVED, B, F


@jit
def quadratic(kind: int, slot: int, dof: int, whitened: F, z: F) -> float:
    """GLT statistic of the set of sensors in `slot`."""
    total = 0.0
    for r in range(dof):
        s = 0.0
        for i in range(z.shape[1]):
            s += whitened[kind, slot, r, i] * z[kind, i]
        total += s * s
    return total


@jit
def resolve(dof: int, statistic: float, whitened: F, gain: F, isolable: B, z: F, threshold: F) -> tuple[int, int, int, int]:
    """Who explains an alarm; arrays are those of one kind and slot.

    One sensor that explains the parity vector leaves; else two, if only one pair explains it. Otherwise the alarm is unresolved: the best
    pair (with five sensors, the best one) stays out of the sample, and nobody's health is judged by it. With four sensors all stay.

    Returns
    -------
    alarm : RESOLVED or UNRESOLVED
    first, second : sensors to leave out, -1: none
    pointed : sensor the test points at, -1: it cannot tell
    """
    p = np.empty(dof)
    parity_vector(whitened, dof, z, p)
    best, value = suspect(whitened, dof, gain, p)
    if dof < 2 or best < 0 or not isolable[best]:
        return UNRESOLVED, -1, -1, -1
    if statistic - value <= threshold[dof - 1]:
        return RESOLVED, best, -1, best
    if dof == 2:
        return UNRESOLVED, best, -1, best
    i, j, _, count = suspect_pair(whitened, dof, gain, p, statistic - threshold[dof - 2])
    unique = count == 1 and isolable[i] and isolable[j]
    return RESOLVED if unique else UNRESOLVED, i, j, best
