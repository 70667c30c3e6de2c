"""Weighted least squares (WLS) of any subset of n sensors.

Lives here: `WeightedLeastSquares`, the kernel that turns readings and drift estimates into a fused triad with its covariance.
Does not live here: estimating drifts (optimal.py and the methods built on it).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from riins_core.jit import inner, jit

from .method import Fused, FusionMethod, Table

Array = NDArray[np.float64]


@inner
def weigh(W: Array, z: Array, drift: Array, R: Array, P: Array, x: Array, covariance: Array) -> None:
    """One sample: x = W (z - drift), covariance = W (diag R + P) W'.

    Parameters
    ----------
    W : (3, n), weighted least squares
    z, drift : (n,), readings and estimated drifts
    R : (n,), variances of the white noise
    P : (n, n), covariance of the error of `drift`. An estimate made of parities T z is uncorrelated with W v, thesis (5-39): the two parts add
    x, covariance : (3,), (3, 3), written
    """
    n = z.shape[0]
    for a in range(3):
        s = 0.0
        for i in range(n):
            if W[a, i] != 0.0:
                s += W[a, i] * (z[i] - drift[i])
        x[a] = s
    for a in range(3):
        for b in range(a + 1):
            s = 0.0
            for i in range(n):
                if W[a, i] != 0.0:
                    s += W[a, i] * R[i] * W[b, i]
                    for j in range(n):
                        s += W[a, i] * P[i, j] * W[b, j]
            covariance[a, b] = s
            covariance[b, a] = s


@jit
def wls_block(P: Array, Q: Array, R: Array, W: Array, z: Array, x: Array, covariance: Array) -> None:
    """Samples one after the other; P (n, n) grows by the walk at each."""
    none = np.zeros(z.shape[1])
    for k in range(z.shape[0]):
        for i in range(z.shape[1]):
            P[i, i] += Q[i]
        weigh(W, z[k], none, R, P, x[k], covariance[k])


class WeightedLeastSquares(FusionMethod):
    """Weighted least squares, thesis (5-7): x = (H' R^-1 H)^-1 H' R^-1 m.

    It leaves every drift in; the covariance says so (drift and walk of the model are in it).
    """

    name = "wls"
    title = "weighted least squares"

    def _begin(self) -> tuple[Array, ...]:
        return (np.diag(self.model.P),)

    def _run(self, table: Table, z: Array, out: Fused) -> None:
        (P,) = self._state
        wls_block(P, self.model.Q, self.model.R, table.W, z, out.x, out.covariance)
