"""Adaptive optimal fusion (AOPT): the optimal filter estimates its own process noise (Sage-Husa) and tracks strongly (fading factor).

Lives here: `AdaptiveFusion` and `AdaptiveSettings`, with what was chosen where the thesis' figure 5.3 is lost.
Does not live here: the filter's step (optimal.py), noise estimation from autocovariances (noise_estimation.py).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from riins_core.jit import inner, jit
from riins_core.kalman import cholesky_into, update_joseph
from riins_core.settings import setting

from .method import Fused, FusionMethod, Table, TriadModel
from .optimal import parity_of
from .wls import weigh

Array = NDArray[np.float64]


@dataclass(frozen=True)
class AdaptiveSettings:
    """Settings of the adaptive optimal fusion."""

    forgetting: float = setting(0.995, "forgetting factor b of the process noise estimator; 0.97 and less wander", "", 0.9, 1.0 - 1e-9)
    softening: float = setting(1.0, "weakening factor beta of the strong tracking: larger is smoother, smaller tracks faster", "", 0.1, 100.0)
    memory: float = setting(0.95, "rho, weight of the past in the innovation covariance", "", 0.0, 1.0)


@jit
def fade(P: Array, V: Array, factor: float) -> None:
    """P + (factor - 1) P V' (V P V')^-1 V P in place: what the parity sees of P is multiplied by `factor`, the rest stays.

    Parameters
    ----------
    P : (n, n), covariance
    V : (dof, n)
    factor : lambda >= 1
    """
    n, dof = P.shape[0], V.shape[0]
    PV, M, L = np.zeros((n, dof)), np.zeros((dof, dof)), np.empty((dof, dof))
    for i in range(n):
        for r in range(dof):
            for j in range(n):
                PV[i, r] += P[i, j] * V[r, j]
    for r in range(dof):
        for s in range(dof):
            for j in range(n):
                M[r, s] += V[r, j] * PV[j, s]
    if not cholesky_into(M, L):  # nothing is uncertain: nothing to fade
        return
    for i in range(n):
        for r in range(dof):
            for s in range(r):
                PV[i, r] -= PV[i, s] * L[r, s]
            PV[i, r] /= L[r, r]
    for i in range(n):
        for j in range(n):
            for r in range(dof):
                P[i, j] += (factor - 1.0) * PV[i, r] * PV[j, r]


@inner
def carry(kept: Array, P: Array, V: Array) -> None:
    """Covariance of the error after an update by the gain K = P V' that the filter has used: (I - K V) kept (I - K V)' + K K', in place.

    Parameters
    ----------
    kept, P : (n, n), before the update; of the filter, after it
    V : (dof, n), in white noise of unit variance
    """
    n, dof = P.shape[0], V.shape[0]
    K, A, AP = np.zeros((n, dof)), np.eye(n), np.zeros((n, n))
    for i in range(n):
        for r in range(dof):
            for j in range(n):
                K[i, r] += P[i, j] * V[r, j]
            for j in range(n):
                A[i, j] -= K[i, r] * V[r, j]
    for i in range(n):
        for j in range(n):
            for k in range(n):
                AP[i, j] += A[i, k] * kept[k, j]
    for i in range(n):
        for j in range(i + 1):
            s = 0.0
            for k in range(n):
                s += AP[i, k] * A[j, k]
            for r in range(dof):
                s += K[i, r] * K[j, r]
            kept[i, j] = s
            kept[j, i] = s


@inner
def adaptive_step(
    d: Array, P: Array, Q: Array, past: Array, walk: Array, kept: Array, b: float, beta: float, rho: float, V: Array, RV: Array, z: Array,
    p: Array, dz: Array, S: Array, e: Array, before: Array, old: Array,
) -> None:  # fmt: skip
    """One sample z (n,); the rest as in `adaptive_block`, and room for (dof,), (dof,), (dof, dof), (dof,), (n,), (n,)."""
    n, dof = z.shape[0], V.shape[0]
    if dof > 0:
        parity_of(V, z, p)
        square, noise, seen = 0.0, 0.0, 0.0
        for r in range(dof):
            s = p[r]
            for i in range(n):
                s -= V[r, i] * d[i]
                for j in range(n):
                    seen += V[r, i] * P[i, j] * V[r, j]
            square += s * s
            noise += RV[r, r]
        past[0] = square if past[1] == 0.0 else (rho * past[0] + square) / (1.0 + rho)
        for i in range(n):
            before[i] = d[i]
            old[i] = P[i, i]
        if seen > 0.0 and past[0] - beta * noise > seen:
            fade(P, V, (past[0] - beta * noise) / seen)
    for i in range(n):
        P[i, i] += Q[i]
        kept[i, i] += walk[i]
    if dof > 0:
        update_joseph(d, P, p, V, RV, dz, S, e)
        carry(kept, P, V)
        weight = (1.0 - b) / (1.0 - b ** (past[1] + 1.0))
        for i in range(n):
            Q[i] = max(0.0, (1.0 - weight) * Q[i] + weight * ((d[i] - before[i]) ** 2 + P[i, i] - old[i]))
        past[1] += 1.0


@jit
def adaptive_block(
    d: Array, P: Array, Q: Array, past: Array, walk: Array, kept: Array, b: float, beta: float, rho: float, R: Array, V: Array, RV: Array,
    W: Array, z: Array, x: Array, cov: Array, drift: Array,
) -> None:  # fmt: skip
    """Samples one after the other.

    Parameters
    ----------
    d, P, Q : (n,), (n, n), (n,), drifts, their covariance, process noise, in place
    past : (2,), trace of the innovation covariance, samples so far, in place
    walk, kept : (n,), (n, n), variances of the walk as stated; covariance of the error of `d` by the stated walk and the gains used, in place
    b, beta, rho : see `AdaptiveSettings`
    R, V, RV, W, z, x, cov, drift : as in `optimal_block`; V in white noise of unit variance
    """
    n, dof = z.shape[1], V.shape[0]
    p, dz, S, e = np.empty(dof), np.empty(dof), np.empty((dof, dof)), np.empty(dof)
    before, old = np.empty(n), np.empty(n)
    for k in range(z.shape[0]):
        adaptive_step(d, P, Q, past, walk, kept, b, beta, rho, V, RV, z[k], p, dz, S, e, before, old)
        weigh(W, z[k], d, R, kept, x[k], cov[k])
        for i in range(n):
            drift[k, i] = d[i]


class AdaptiveFusion(FusionMethod):
    """AOPT, thesis 5.3: the filter of `OptimalFusion` whose Q is estimated as it goes, with a fading factor.

    Notes
    -----
    Printed: d_k = (1 - b) / (1 - b^(k+1)), lambda of (5-71)-(5-75). Figure 5.3, with the estimator itself, is lost. Chosen:

    - Sage and Husa's Q <- (1 - d_k) Q + d_k (K r r' K' + P_k - P_(k-1)), A = I, P_(k-1) before fading; in (5-75) the V0 on the right is the last one;
    - only the diagonal of Q is kept, not below zero. With the full matrix K r lies in the range of T' for ever, and the method is least squares;
    - lambda is applied to what the parity sees of P, not to all of P: fading all of it, as printed, multiplies the variance in range(H) each time
      with nothing to bring it down: 1e12 times the drift after 200 s, and with b = 0.97 the output diverges;
    - the coefficient gamma, never explained, is 1;
    - the covariance said is not P: the fading, whose innovation trace remembers two samples, answers to noise, so the estimated Q is half the
      noise of a sample even where nothing drifts, and P grows by it in range(H), to 30 sigma in 20 s. Said is the error of the gains that
      were used, with the walk of the model;
    - a model's equal Q is only where it begins: the first sample replaces it (d_0 = 1).

    Nobody tells it which sensor is bad: it marks those whose drift estimate moved. It is no isolation: the body error of one drift falls by a few
    per cent. The thesis' advantage comes from its P (5-114), which gives gyros 1 and 3 four times the variance of the others, and from fading that.
    """

    name = "aopt"
    title = "adaptive optimal fusion"

    def __init__(self, model: TriadModel, settings: AdaptiveSettings | None = None) -> None:
        self.settings = settings or AdaptiveSettings()
        super().__init__(model)

    def _begin(self) -> tuple[Array, ...]:
        return np.zeros(self.model.array.n), np.diag(self.model.P), self.model.Q.copy(), np.zeros(2), np.diag(self.model.P)

    def _run(self, table: Table, z: Array, out: Fused) -> None:
        s = self.settings
        V = np.linalg.solve(np.linalg.cholesky(table.R), table.V) if len(table.V) else table.V
        args = (V, np.eye(len(V)), table.W, z, out.x, out.covariance, out.drift)
        d, P, Q, past, kept = self._state
        adaptive_block(d, P, Q, past, self.model.Q, kept, s.forgetting, s.softening, s.memory, self.model.R, *args)

    @property
    def process_noise(self) -> Array:
        """(n,), Q as estimated, for one sample."""
        return self._state[2].copy()
