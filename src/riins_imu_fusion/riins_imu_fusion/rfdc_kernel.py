"""RFDC and IRFDC on one sample of the running fusion: the drifts found before are taken out, the filter sees what is left of them.

Lives here: the kernel around the step of riins_fdi.drift_filters, and the covariance of the fused sample. Compiled when one of the two is selected.
Does not live here: the step and its filters (riins_fdi), settings, memory and random numbers (rfdc.py), the fusion's loop (kernel.py).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from riins_core.jit import jit
from riins_fdi.drift_filters import bound, loop_step

F = NDArray[np.float64]

# elements of the settings
GAIN, PROCESS, MOST, VOTE, SMOOTH = 0, 1, 2, 3, 4
# the mean square that is said of a fused sample: said when the mean of late exceeds it or has fallen to a third of it, and then half as much again
_ABOVE, _FALLEN = 1.5, 3.0


class LoopState(NamedTuple):
    """Memory of one kind of sensor; drifts in the unit of `rfdc`, the root mean square of the sensors' noise."""

    x: F  # (n,), drift left
    P: F  # (n, n)
    D: F  # (n,), drift found so far
    alpha: F  # (n,), drift factor
    change: F  # (n,)
    cloud: F  # (particles, n)
    weights: F  # (particles,)
    mean: F  # (3, 3), mean of late of the fused sample's mean square
    said: F  # (3, 3), what is said of it
    seen: F  # (1,), samples in `mean`


@jit
def compensate(
    z: F, unit: float, V: F, votes: F, W: F, member: F, settings: F, kind: int, factor: bool, learning: bool, draws: F, st: LoopState, removed: F,
    spread: F,
) -> None:  # fmt: skip
    """One sample.

    Parameters
    ----------
    z : (n,), readings
    unit : of the drifts
    V, votes : (dof, n), parity matrix in white noise of unit variance; (n, n), see riins_fdi.drift.voting_rows
    W, member : (3, n), (n,), of the sensors fused
    settings : see GAIN ..., drifts in `unit`
    kind, factor, draws : as riins_fdi.drift_filters.loop has them
    learning : False: nothing can be learned from this sample
    removed, spread : (n,), (3, 3), written: taken out of the readings, and what the fused sample's mean square is said to have from it

    Notes
    -----
    The mean square is W (P + x x') W', by the filter, of the drift left, and (W D)(W D)': what D takes out of the fused value has been measured by
    nobody, it follows from the guess that few sensors drift. It is said in steps, for a consumer takes a change for another bias.
    """
    n, dof = z.shape[0], V.shape[0]
    x, P, D = st.x, st.P, st.D
    before, m = D.copy(), np.empty(n)
    for i in range(n):
        removed[i] = D[i] * unit * member[i]
        m[i] = z[i] / unit - D[i]
    if learning:
        R, scaled = np.ones(dof + n), V * unit
        R[dof:] = settings[VOTE] * settings[VOTE]
        loop_step(
            m, scaled, votes, settings[GAIN], settings[PROCESS], settings[MOST], R, kind, factor, draws, x, P, D, st.alpha, st.change, st.cloud,
            st.weights, np.empty((dof + n, n)), np.empty(dof + n), np.empty(dof), np.empty(n),
        )  # fmt: skip
    else:
        for i in range(n):
            P[i, i] += settings[PROCESS] * settings[PROCESS]
        bound(P, settings[MOST])
    st.seen[0] = min(st.seen[0] + 1.0, settings[SMOOTH])
    late, held = 0.0, 0.0
    for a in range(3):
        for b in range(3):
            s = 0.0
            for i in range(n):
                if W[a, i] == 0.0:
                    continue
                for j in range(n):
                    s += W[a, i] * (P[i, j] + x[i] * x[j] + before[i] * before[j]) * W[b, j]
            st.mean[a, b] += (s - st.mean[a, b]) / st.seen[0]
        late += st.mean[a, a]
        held += st.said[a, a]
    if late > held or late < held / (_ABOVE * _FALLEN):
        for a in range(3):
            for b in range(3):
                st.said[a, b] = _ABOVE * st.mean[a, b]
    for a in range(3):
        for b in range(3):
            spread[a, b] = st.said[a, b] * unit * unit
