"""Several Kalman filters of one model, worked by one kernel call: states (k, n) and covariances (k, n, n), any n.

Lives here: `Stack` and its kernels: time update, innovations, measurement update in Joseph form of chosen filters.
Does not live here: which filter takes what (structures.py, separated_masters.py). Each filter's numbers do not depend on its neighbours, to the bit.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from riins_core.jit import inner, jit
from riins_core.kalman import cholesky_into

from .types import Array

Rows = NDArray[np.int64]


class Estimate(NamedTuple):
    """State and covariance of one filter. x: (n,), P: (n, n)."""

    x: Array
    P: Array


class Innovations(NamedTuple):
    """Innovations of one measurement against k filters.

    z (k, m): measured - predicted, sigma (k, m), standardized (k, m) by the Cholesky factor, nis (k,): infinite where it cannot be judged;
    information (2,): trace of H' R^-1 H over the position and the velocity states.
    """

    z: Array
    sigma: Array
    standardized: Array
    nis: Array
    information: Array


@jit
def predict_stack(X: Array, P: Array, Phi: Array, Q: Array, scale: Array) -> None:
    """Kernel: x <- Phi x, P <- Phi P Phi' + scale Q for every filter whose scale (k,) is positive; Phi mostly zeros, P symmetric."""
    n = X.shape[1]
    count = np.zeros(n, np.int64)
    column = np.empty((n, n), np.int64)
    for i in range(n):
        for j in range(n):
            if Phi[i, j] != 0.0:
                column[i, count[i]] = j
                count[i] += 1
    y, T, W = np.empty(n), np.empty((n, n)), np.empty((n, n))
    for one in range(X.shape[0]):
        if not scale[one] > 0.0:
            continue
        for i in range(n):
            y[i] = 0.0
            T[i, :] = 0.0
            for c in range(count[i]):
                k = column[i, c]
                f = Phi[i, k]
                y[i] += f * X[one, k]
                for j in range(n):
                    T[i, j] += f * P[one, k, j]
        for i in range(n):
            X[one, i] = y[i]
            for j in range(n):
                W[j, i] = T[i, j]
        for i in range(n):
            for j in range(i + 1):
                T[i, j] = 0.5 * scale[one] * (Q[i, j] + Q[j, i])
            for c in range(count[i]):
                k = column[i, c]
                f = Phi[i, k]
                for j in range(i + 1):
                    T[i, j] += f * W[k, j]
        for i in range(n):
            for j in range(i + 1):
                P[one, i, j] = T[i, j]
                P[one, j, i] = T[i, j]


@inner
def innovation_into(X: Array, P: Array, one: int, z: Array, H: Array, R: Array, dz: Array, PH: Array, S: Array) -> None:
    """Kernel: of filter `one`, dz = z - H x, PH = H P (m, n) and S = H P H' + R written; H mostly zeros, P symmetric."""
    n, m = X.shape[1], z.shape[0]
    for a in range(m):
        s = z[a]
        PH[a, :] = 0.0
        for k in range(n):
            h = H[a, k]
            if h != 0.0:
                s -= h * X[one, k]
                for j in range(n):
                    PH[a, j] += h * P[one, k, j]
        dz[a] = s
    for a in range(m):
        for b in range(a + 1):
            s = 0.5 * (R[a, b] + R[b, a])
            for k in range(n):
                if H[b, k] != 0.0:
                    s += PH[a, k] * H[b, k]
            S[a, b] = s
            S[b, a] = s


@jit
def judge_stack(
    X: Array, P: Array, rows: Rows, z: Array, H: Array, R: Array,
    dz: Array, sigma: Array, standardized: Array, nis: Array, information: Array,
) -> None:  # fmt: skip
    """Kernel: fields of `Innovations` written, for the filters `rows`."""
    n, m = X.shape[1], z.shape[0]
    S, L, PH = np.empty((m, m)), np.zeros((m, m)), np.empty((m, n))
    for r in range(rows.shape[0]):
        one = rows[r]
        innovation_into(X, P, one, z, H, R, dz[r], PH, S)
        for a in range(m):
            standardized[r, a] = np.inf
            sigma[r, a] = np.sqrt(S[a, a]) if S[a, a] > 0.0 else 0.0
        nis[r] = np.inf
        if not cholesky_into(S, L):
            continue
        total = 0.0
        for a in range(m):
            s = dz[r, a]
            for b in range(a):
                s -= L[a, b] * standardized[r, b]
            standardized[r, a] = s / L[a, a]
            total += standardized[r, a] ** 2
        nis[r] = total if total < np.inf else np.inf  # not a number is infinite too
    information[:] = 0.0
    if cholesky_into(R, L):
        u = np.empty(m)
        for k in range(min(n, 6)):
            for a in range(m):
                s = H[a, k]
                for b in range(a):
                    s -= L[a, b] * u[b]
                u[a] = s / L[a, a]
                information[k // 3] += u[a] * u[a]


@jit
def update_stack(X: Array, P: Array, rows: Rows, z: Array, H: Array, R: Array) -> None:
    """Kernel: measurement update of the filters `rows`; one whose innovation covariance is not positive definite is left alone."""
    n, m = X.shape[1], z.shape[0]
    S, L = np.empty((m, m)), np.zeros((m, m))
    PH, K, U = np.empty((m, n)), np.empty((m, n)), np.empty((m, n))
    T, u = np.empty((n, n)), np.empty(m)
    for r in range(rows.shape[0]):
        one = rows[r]
        innovation_into(X, P, one, z, H, R, u, PH, S)
        if not cholesky_into(S, L):
            continue
        for a in range(m):  # K' = S^-1 (P H')': two triangular solves
            for j in range(n):
                K[a, j] = PH[a, j]
            for b in range(a):
                for j in range(n):
                    K[a, j] -= L[a, b] * K[b, j]
            for j in range(n):
                K[a, j] /= L[a, a]
        for a in range(m - 1, -1, -1):
            for b in range(a + 1, m):
                for j in range(n):
                    K[a, j] -= L[b, a] * K[b, j]
            for j in range(n):
                K[a, j] /= L[a, a]
        for a in range(m):
            for j in range(n):
                X[one, j] += K[a, j] * u[a]
        # Joseph: A P A' + K R K' with A = I - K H; T = A P, then T - U K' with U = T H' - K R
        for i in range(n):
            for j in range(n):
                T[i, j] = P[one, i, j]
            for a in range(m):
                for j in range(n):
                    T[i, j] -= K[a, i] * PH[a, j]
            for a in range(m):
                s = 0.0
                for k in range(n):
                    if H[a, k] != 0.0:
                        s += T[i, k] * H[a, k]
                for b in range(m):
                    s -= K[b, i] * R[b, a]
                U[a, i] = s
        for i in range(n):
            for a in range(m):
                for j in range(n):
                    T[i, j] -= U[a, i] * K[a, j]
        for i in range(n):
            for j in range(i + 1):
                s = 0.5 * (T[i, j] + T[j, i])
                P[one, i, j] = s
                P[one, j, i] = s


class Stack:
    """k filters that begin alike.

    Parameters
    ----------
    x0, P0 : (n,), (n, n)
    k : filters

    Attributes
    ----------
    X, P : (k, n), (k, n, n), changed in place
    """

    __slots__ = ("P", "X")

    def __init__(self, x0: Array, P0: Array, k: int) -> None:
        self.X: Array = np.repeat(np.array(x0, dtype=np.float64)[None], k, axis=0)
        self.P: Array = np.repeat(np.array(P0, dtype=np.float64)[None], k, axis=0)

    def __getitem__(self, one: int) -> Estimate:
        """Views of one filter."""
        return Estimate(self.X[one], self.P[one])

    def predict(self, Phi: Array, Q: Array, scale: Array) -> None:
        """Time update of the filters whose factor (k,) of the process noise is positive."""
        predict_stack(self.X, self.P, Phi, Q, scale)

    def judge(self, rows: Rows, z: Array, H: Array, R: Array) -> Innovations:
        """Innovations against the filters `rows` of a measurement that is not applied."""
        k, m = len(rows), len(z)
        out = Innovations(np.empty((k, m)), np.empty((k, m)), np.empty((k, m)), np.empty(k), np.empty(2))
        judge_stack(self.X, self.P, rows, z, H, R, *out)
        return out

    def update(self, rows: Rows, z: Array, H: Array, R: Array) -> None:
        """Measurement update of the filters `rows`."""
        update_stack(self.X, self.P, rows, z, H, R)

    def copy(self, source: int, target: int) -> None:
        """One filter becomes what another is."""
        self.X[target], self.P[target] = self.X[source], self.P[source]

    def snapshot(self) -> tuple[Any, ...]:
        """Copies of everything."""
        return self.X.copy(), self.P.copy()

    def restore(self, snapshot: tuple[Any, ...]) -> None:
        """Go back to a snapshot, which stays usable."""
        self.X[:], self.P[:] = snapshot
