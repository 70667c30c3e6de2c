"""Kernels of the error filter for any assembled state: transition and process noise over an interval.

Lives here: `gather`, `between`, `transition`.
Does not live here: which states there are (state_blocks.py), measurement models (aids), the time update of the filters (stacked.py).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from riins_core.ins_error import N_STATES, fill_dynamics
from riins_core.jit import jit
from riins_core.rotation import exp_so3_into

from .types import Array

Rows = NDArray[np.int64]
N_COUPLED = 9
"""Position, velocity, attitude: the rows of the transition that are not diagonal."""


@jit
def gather(swing: Array, rate: Array, force: Array, dt: Array) -> None:
    """Add up rate dt and force dt of samples (m, 3), (m, 3), (m,) in swing (6,), for the scale factors."""
    for k in range(dt.shape[0]):
        for axis in range(3):
            swing[axis] += rate[k, axis] * dt[k]
            swing[3 + axis] += force[k, axis] * dt[k]


@jit
def between(nav: Array, before: Array, w: float) -> Array:
    """Nominal state (16,) at the share w of the way back from a sample to the one before: linear, attitude along the rotation between both."""
    out = nav + w * (before - nav)
    turn = np.empty((3, 3))  # C_now' C_before
    for i in range(3):
        for j in range(3):
            turn[i, j] = nav[6 + i] * before[6 + j] + nav[9 + i] * before[9 + j] + nav[12 + i] * before[12 + j]
    x, y, z = 0.5 * (turn[2, 1] - turn[1, 2]), 0.5 * (turn[0, 2] - turn[2, 0]), 0.5 * (turn[1, 0] - turn[0, 1])
    sine = math.sqrt(x * x + y * y + z * z)
    cosine = 0.5 * (turn[0, 0] + turn[1, 1] + turn[2, 2] - 1.0)
    scale = w * (math.atan2(sine, cosine) / sine if sine > 0.0 else 1.0)
    exp_so3_into(scale * x, scale * y, scale * z, turn)
    for i in range(3):
        for j in range(3):
            out[6 + 3 * i + j] = nav[6 + 3 * i] * turn[0, j] + nav[7 + 3 * i] * turn[1, j] + nav[8 + 3 * i] * turn[2, j]
    return out


@jit
def transition(nav: Array, sums: Array, swing: Array, density: Array, decay: Array, column: Rows, factor: Rows, Phi: Array, Qd: Array) -> None:
    """Transition matrix and process noise over the interval that `sums` has accumulated.

    Parameters
    ----------
    nav : (16,), nominal state at the end of the interval, as in riins_core.strapdown
    sums : (13,), sum of f^n dt, of C_nb dt, and of dt
    swing : (6,), sum of body rate dt and of specific force dt; looked at only where a state has a factor
    density, decay, column, factor : of StateModel
    Phi, Qd : (n, n), written

    Notes
    -----
    Second order in the interval for the rows of the INS: Phi = I + F T + (F T)^2 / 2 with specific force and attitude averaged over the interval,
    and Qd by the trapezoid rule, T/2 (Phi Q Phi' + Q). Waves turn the ship within the interval; the averages keep that. A Markov state is exact,
    exp(-T / tau), however long the interval. A scale factor takes mean attitude times mean rate: what both do together within an interval is lost.
    """
    n, m, T = density.shape[0], N_STATES + column.shape[0], sums[12]
    f_n = sums[0:3] / T
    C = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            C[i, j] = sums[3 + 3 * i + j] / T
    F = np.zeros((N_STATES, N_STATES))
    fill_dynamics(F, nav[0], nav[2], nav[3:6], f_n, C)
    A = np.zeros((N_COUPLED, m))  # F T
    for i in range(N_COUPLED):
        for j in range(N_STATES):
            A[i, j] = F[i, j] * T
        for j in range(N_STATES, m):
            by = factor[j - N_STATES]
            A[i, j] = A[i, column[j - N_STATES]] * (swing[by - 1] / T if by > 0 else 1.0)
    Phi[:, :] = 0.0
    Qd[:, :] = 0.0
    for j in range(n):
        kept = math.exp(-decay[j] * T)
        Phi[j, j] = kept
        Qd[j, j] = density[j] * (0.5 * (1.0 - kept * kept) / decay[j] if decay[j] > 0.0 else T)
    for i in range(N_COUPLED):
        for j in range(m):
            square = 0.0
            for k in range(N_COUPLED):
                square += A[i, k] * A[k, j]
            if j >= N_COUPLED:
                square -= A[i, j] * decay[j] * T
            value = A[i, j] + 0.5 * square
            Phi[i, j] = value if i != j else 1.0 + value
    for i in range(N_COUPLED):
        for j in range(i, m):
            total = 0.0
            if j < N_COUPLED:
                for k in range(m):
                    total += Phi[i, k] * density[k] * Phi[j, k]
                if i == j:
                    total += density[i]
            else:
                total = Phi[i, j] * density[j] * Phi[j, j]
            Qd[i, j] = 0.5 * T * total
            Qd[j, i] = Qd[i, j]
