"""Optimal fusion (OPT): a Kalman filter on the parity estimates each sensor's drift, least squares takes what is left.

Lives here: `OptimalFusion` and the step of its filter, which the adaptive and the drift-compensated methods share.
Does not live here: where P and Q come from: they name the bad sensors, so this is an oracle (methods that need no telling: glr_kf.py).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from riins_core.jit import inner, jit
from riins_core.kalman import update_joseph

from .method import Fused, FusionMethod, Table
from .wls import weigh

Array = NDArray[np.float64]


@inner
def parity_of(V: Array, z: Array, p: Array) -> None:
    """p = V z."""
    for r in range(V.shape[0]):
        s = 0.0
        for i in range(z.shape[0]):
            s += V[r, i] * z[i]
        p[r] = s


@inner
def optimal_step(d: Array, P: Array, Q: Array, V: Array, RV: Array, z: Array, p: Array, dz: Array, S: Array, e: Array) -> None:
    """One sample z (n,); the rest as in `optimal_block`, and room for (dof,), (dof,), (dof, dof), (dof,)."""
    for i in range(z.shape[0]):
        P[i, i] += Q[i]
    if V.shape[0] > 0:
        parity_of(V, z, p)
        update_joseph(d, P, p, V, RV, dz, S, e)


@jit
def optimal_block(d: Array, P: Array, Q: Array, R: Array, V: Array, RV: Array, W: Array, z: Array, x: Array, cov: Array, drift: Array) -> None:
    """Samples one after the other.

    Parameters
    ----------
    d, P : (n,), (n, n), drifts and their covariance, in place
    Q, R : (n,), variances of the walk and of the white noise
    V, RV, W : see `Table`
    z : (m, n), readings
    x, cov, drift : (m, 3), (m, 3, 3), (m, n), written
    """
    n, dof = z.shape[1], V.shape[0]
    p, dz, S, e = np.empty(dof), np.empty(dof), np.empty((dof, dof)), np.empty(dof)
    for k in range(z.shape[0]):
        optimal_step(d, P, Q, V, RV, z[k], p, dz, S, e)
        weigh(W, z[k], d, R, P, x[k], cov[k])
        for i in range(n):
            drift[k, i] = d[i]


class OptimalFusion(FusionMethod):
    """OPT, thesis 5.2.4: drifts d+ = d + w, T z = T d + T v, (5-63)-(5-70), then x = W (z - d), (5-50).

    Notes
    -----
    What is printed and what holds: (5-18) needs the inverse of T R T', not its transpose; (5-41) R T'; R in (5-66)-(5-70) is T R T'.
    It is an oracle: with equal P and equal Q it is exactly least squares (thesis 5.2.3), its whole advantage comes from being told which sensors are
    bad, and told wrongly it is worse than least squares. P grows without bound in range(H), where parity sees nothing: the covariance says so.
    """

    name = "opt"
    title = "optimal fusion, told which sensors drift"
    oracle = True

    def _begin(self) -> tuple[Array, ...]:
        return np.zeros(self.model.array.n), np.diag(self.model.P)

    def _run(self, table: Table, z: Array, out: Fused) -> None:
        d, P = self._state
        optimal_block(d, P, self.model.Q, self.model.R, table.V, table.R, table.W, z, out.x, out.covariance, out.drift)
