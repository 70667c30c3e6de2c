"""The Kalman filter: discretization, prediction, and one update that returns the standardized innovation.

Lives here: `predict`, `update` (Joseph form), `update_joseph` (kernel), van Loan's discretization, the information form.
Does not live here: models (ins_error.py), gates on the innovation (riins_fdi.innovation), fusion of filters (riins_federated.structures).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from .jit import jit

Array = NDArray[np.float64]


class NotPositiveDefinite(ValueError):
    """An innovation covariance or a covariance to invert is not positive definite."""


class Innovation(NamedTuple):
    """Innovation of an update.

    Attributes
    ----------
    z : (m,), measured - predicted
    S : (m, m), its covariance
    standardized : (m,), L^-1 z with S = L L': unit variance, independent where the filter is right
    nis : normalized innovation squared z' S^-1 z, chi-square with m degrees of freedom
    """

    z: Array
    S: Array
    standardized: Array
    nis: float


def innovation(x: Array, P: Array, z: Array, H: Array, R: Array) -> Innovation:
    """Innovation of a measurement z = H x + v that is not applied; parameters as in `update`."""
    dz = np.asarray(z - H @ x, dtype=np.float64)
    S = H @ P @ H.T + R
    standardized = scipy.linalg.solve_triangular(_cholesky(S, "innovation covariance"), dz, lower=True)
    return Innovation(dz, S, standardized, float(standardized @ standardized))


def predict(x: Array, P: Array, Phi: Array, Q: Array) -> tuple[Array, Array]:
    """Time update.

    Parameters
    ----------
    x, P : (n,), (n, n), state and covariance
    Phi : (n, n), transition
    Q : (n, n), covariance of the noise of the step

    Returns
    -------
    x, P : Phi x, Phi P Phi' + Q, symmetric
    """
    P = Phi @ P @ Phi.T + Q
    return Phi @ x, 0.5 * (P + P.T)


def update(x: Array, P: Array, z: Array, H: Array, R: Array) -> tuple[Array, Array, Innovation]:
    """Measurement update in Joseph form.

    Parameters
    ----------
    x, P : (n,), (n, n), state and covariance
    z : (m,), measurement of H x + v
    H : (m, n)
    R : (m, m), covariance of v

    Returns
    -------
    x, P : updated
    innovation : standardized once, here

    Raises
    ------
    NotPositiveDefinite
        The innovation covariance is not positive definite.

    Notes
    -----
    K = P H' S^-1, P = (I - K H) P (I - K H)' + K R K' (Bucy and Joseph 1968). 002 (9) prints the gain without P(-) H'.
    """
    nu = innovation(x, P, z, H, R)
    K = scipy.linalg.cho_solve((_cholesky(nu.S, "innovation covariance"), True), H @ P).T
    A = np.eye(x.size) - K @ H
    P = A @ P @ A.T + K @ R @ K.T
    return x + K @ nu.z, 0.5 * (P + P.T), nu


def van_loan(F: Array, Qc: Array, dt: float) -> tuple[Array, Array]:
    """Exact discretization of x' = F x + w.

    Parameters
    ----------
    F : (n, n)
    Qc : (n, n), spectral density of w, G q G'
    dt : step, s

    Returns
    -------
    Phi, Qd : exp(F dt) and the covariance of the noise over the step (van Loan 1978)
    """
    n = F.shape[0]
    M = np.zeros((2 * n, 2 * n))
    M[:n, :n] = -F * dt
    M[:n, n:] = Qc * dt
    M[n:, n:] = F.T * dt
    E = scipy.linalg.expm(M)
    Phi = E[n:, n:].T
    Qd = Phi @ E[:n, n:]
    return Phi, 0.5 * (Qd + Qd.T)


def to_information(x: Array, P: Array) -> tuple[Array, Array]:
    """Information vector and matrix (P^-1 x, P^-1) of a state and its covariance; its own inverse."""
    factor = (_cholesky(P, "covariance"), True)
    Y = scipy.linalg.cho_solve(factor, np.eye(P.shape[0]))
    return np.asarray(scipy.linalg.cho_solve(factor, x)), np.asarray(0.5 * (Y + Y.T))


def from_information(y: Array, Y: Array) -> tuple[Array, Array]:
    """State and covariance of an information vector and matrix."""
    return to_information(y, Y)


def information_increment(z: Array, H: Array, R: Array) -> tuple[Array, Array]:
    """What a measurement adds to (y, Y): H' R^-1 z and H' R^-1 H."""
    weighted = scipy.linalg.cho_solve((_cholesky(R, "measurement covariance"), True), H)
    return np.asarray(weighted.T @ z), np.asarray(H.T @ weighted)


@jit
def cholesky_into(S: Array, L: Array) -> bool:
    """Kernel: L L' = S, lower triangle of L (m, m) written; False where S is not positive definite (or not finite)."""
    m = S.shape[0]
    for i in range(m):
        for j in range(i + 1):
            s = S[i, j]
            for k in range(j):
                s -= L[i, k] * L[j, k]
            if i == j:
                if not (s > 0.0 and s < np.inf):
                    return False
                L[i, i] = math.sqrt(s)
            else:
                L[i, j] = s / L[j, j]
        for j in range(i + 1, m):
            L[i, j] = 0.0
    return True


@jit
def predict_into(x: Array, P: Array, Phi: Array, Q: Array) -> None:
    """Kernel: `predict` in place."""
    n = x.shape[0]
    y = np.zeros(n)
    T = np.zeros((n, n))
    for i in range(n):
        for k in range(n):
            f = Phi[i, k]
            if f != 0.0:  # transition matrices are mostly zeros
                y[i] += f * x[k]
                for j in range(n):
                    T[i, j] += f * P[k, j]
    x[:] = y
    for i in range(n):
        for j in range(i + 1):
            s = 0.5 * (Q[i, j] + Q[j, i])
            for k in range(n):
                f = Phi[j, k]
                if f != 0.0:
                    s += T[i, k] * f
            P[i, j] = s
            P[j, i] = s


@jit
def update_joseph(x: Array, P: Array, z: Array, H: Array, R: Array, dz: Array, S: Array, standardized: Array) -> bool:
    """Kernel: `update` in place, for n states and m measurements.

    Parameters
    ----------
    x, P : (n,), (n, n), updated in place
    z, H, R : (m,), (m, n), (m, m)
    dz, S, standardized : (m,), (m, m), (m,), written: as in `Innovation`; nis = standardized . standardized

    Returns
    -------
    False where S is not positive definite: x and P are then left alone, standardized is zero
    """
    n, m = x.shape[0], z.shape[0]
    PH = np.zeros((n, m))
    for i in range(n):
        for a in range(m):
            s = 0.0
            for k in range(n):
                s += P[i, k] * H[a, k]
            PH[i, a] = s
    for a in range(m):
        s = z[a]
        for k in range(n):
            s -= H[a, k] * x[k]
        dz[a] = s
        standardized[a] = 0.0
        for b in range(m):
            s = R[a, b]
            for k in range(n):
                s += H[a, k] * PH[k, b]
            S[a, b] = s
    L = np.zeros((m, m))
    if not cholesky_into(S, L):
        return False
    for a in range(m):
        s = dz[a]
        for b in range(a):
            s -= L[a, b] * standardized[b]
        standardized[a] = s / L[a, a]
    K = np.empty((n, m))
    for i in range(n):  # K = PH S^-1: two triangular solves for each row
        for a in range(m):
            s = PH[i, a]
            for b in range(a):
                s -= L[a, b] * K[i, b]
            K[i, a] = s / L[a, a]
        for a in range(m - 1, -1, -1):
            s = K[i, a]
            for b in range(a + 1, m):
                s -= L[b, a] * K[i, b]
            K[i, a] = s / L[a, a]
    for i in range(n):
        for a in range(m):
            x[i] += K[i, a] * dz[a]
    # A P A' + K R K' with A = I - K H, P H' known: T = A P, then T A' = T - (T H') K'
    T = np.empty((n, n))
    for i in range(n):
        for j in range(n):
            s = P[i, j]
            for a in range(m):
                s -= K[i, a] * PH[j, a]
            T[i, j] = s
    U = np.empty((n, m))  # T H' - K R
    for i in range(n):
        for a in range(m):
            s = 0.0
            for k in range(n):
                s += T[i, k] * H[a, k]
            for b in range(m):
                s -= K[i, b] * R[b, a]
            U[i, a] = s
    for i in range(n):
        for j in range(i + 1):
            s = 0.5 * (T[i, j] + T[j, i])
            for a in range(m):
                s -= 0.5 * (U[i, a] * K[j, a] + U[j, a] * K[i, a])
            P[i, j] = s
            P[j, i] = s
    return True


def _cholesky(S: Array, what: str) -> Array:
    try:
        return np.asarray(scipy.linalg.cholesky(S, lower=True))
    except (np.linalg.LinAlgError, ValueError) as error:
        raise NotPositiveDefinite(f"the {what} is not positive definite") from error
