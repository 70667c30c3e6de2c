"""The thesis' navigation schemes for a redundant IMU: WLS.NA (one joint filter), PO.NA (two filters), IPO.NA (two, with noise estimation).

Lives here: `NavigationScheme`: six gyros and six accelerometers in, navigation out, with 9 navigation errors and 12 sensor drifts; external fixes.
Does not live here: the ship's navigator and its aids (navigator.py), fusion without navigation (riins_imu_fusion, which this file alone imports).
"""

from __future__ import annotations

import copy
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from riins_core import ins_error
from riins_core.ins_error import correct_into, fill_dynamics
from riins_core.jit import jit
from riins_core.kalman import NotPositiveDefinite, cholesky_into, predict_into, update_joseph
from riins_core.strapdown import NAV_SIZE, strapdown_block
from riins_imu_fusion.method import TriadModel
from riins_imu_fusion.noise_estimation import NoiseEstimator

Array = NDArray[np.float64]

JOINT, PSEUDO, NONE = 0, 1, 2
_N = 9  # navigation errors; the drifts of gyros, then accelerometers, follow

SCHEMES = {
    "wls_na": (JOINT, False),
    "po_na": (PSEUDO, False),
    "ipo_na": (PSEUDO, True),
    "wls_na_without_parity": (NONE, False),
}
"""How the parity enters, and whether the noise is estimated, by name."""


class SchemeOutput(NamedTuple):
    """Output of m samples.

    Attributes
    ----------
    nav : (m, 16), navigation state after each sample, see riins_core.strapdown
    rate, force : (m, 3), what was navigated with: drifts taken out, least squares, body FRD
    """

    nav: Array
    rate: Array
    force: Array


class _Known(NamedTuple):
    """Arrays the kernel reads; leading axis 2: gyros, accelerometers."""

    V: Array  # (2, dof, n)
    W: Array  # (2, 3, n)
    R: Array  # (2, n)
    RV: Array  # (2, dof, dof)
    Q: Array  # (2, n)


class _Memory(NamedTuple):
    """Arrays the kernel changes."""

    nav: Array  # (16,)
    dtheta: Array  # (3,)
    dv: Array  # (3,)
    d: Array  # (2, n), drifts as estimated
    P: Array  # (9 + 2 n, 9 + 2 n): navigation errors computed - true, drifts true - estimated
    own: Array  # (2, n, n), P of the IMU's own filter


@jit
def _gain(P: Array, V: Array, RV: Array, K: Array) -> bool:
    """K = P V' (V P V' + RV)^-1 for the IMU's own filter, and its P (n, n) after the update, Joseph."""
    n, dof = P.shape[0], V.shape[0]
    PV, S, L = np.zeros((n, dof)), np.zeros((dof, dof)), np.empty((dof, dof))
    for i in range(n):
        for r in range(dof):
            for j in range(n):
                PV[i, r] += P[i, j] * V[r, j]
    for r in range(dof):
        for q in range(dof):
            S[r, q] = RV[r, q]
            for j in range(n):
                S[r, q] += V[r, j] * PV[j, q]
    if not cholesky_into(S, L):
        return False
    for i in range(n):
        for r in range(dof):
            s = PV[i, r]
            for q in range(r):
                s -= L[r, q] * K[i, q]
            K[i, r] = s / L[r, r]
        for r in range(dof - 1, -1, -1):
            s = K[i, r]
            for q in range(r + 1, dof):
                s -= L[q, r] * K[i, q]
            K[i, r] = s / L[r, r]
    return True


@jit
def _apply(P: Array, first: int, n: int, K: Array, V: Array, RV: Array) -> None:
    """P <- (I - K H) P (I - K H)' + K RV K' in place, for a gain K (n, dof) on rows first..first + n - 1 and H = V on the same columns."""
    size, dof = P.shape[0], V.shape[0]
    seen = np.empty(dof)
    for c in range(size):  # rows
        for r in range(dof):
            seen[r] = 0.0
            for j in range(n):
                seen[r] += V[r, j] * P[first + j, c]
        for i in range(n):
            for r in range(dof):
                P[first + i, c] -= K[i, r] * seen[r]
    for c in range(size):  # columns
        for r in range(dof):
            seen[r] = 0.0
            for j in range(n):
                seen[r] += V[r, j] * P[c, first + j]
        for i in range(n):
            for r in range(dof):
                P[c, first + i] -= K[i, r] * seen[r]
    for i in range(n):
        for j in range(n):
            s = 0.0
            for r in range(dof):
                for q in range(dof):
                    s += K[i, r] * RV[r, q] * K[j, q]
            P[first + i, first + j] += s


@jit
def _scheme_block(mode: int, m: _Memory, known: _Known, dt: float, z: Array, nav_out: Array, rate_out: Array, force_out: Array) -> bool:
    """Samples z (2, k, n) one after the other; False: a covariance is not positive definite."""
    V, W, R, RV, Q = known.V, known.W, known.R, known.RV, known.Q
    nav, d, P, own = m.nav, m.d, m.P, m.own
    n, dof, size = d.shape[1], V.shape[1], P.shape[0]
    x, Phi, noise, F = np.zeros(size), np.eye(size), np.zeros((size, size)), np.zeros((15, 15))
    H, RR = np.zeros((2 * dof, size)), np.zeros((2 * dof, 2 * dof))
    for kind in range(2):
        for r in range(dof):
            for i in range(n):
                H[kind * dof + r, 9 + kind * n + i] = V[kind, r, i]
            for q in range(dof):
                RR[kind * dof + r, kind * dof + q] = RV[kind, r, q]
    p, dz, S, e = np.empty(2 * dof), np.empty(2 * dof), np.empty((2 * dof, 2 * dof)), np.empty(2 * dof)
    K, u = np.zeros((n, dof)), np.empty((2, 1, 3))
    fused = np.zeros((2, 3, 3))  # covariance of W v
    for kind in range(2):
        for a in range(3):
            for b in range(3):
                for i in range(n):
                    fused[kind, a, b] += W[kind, a, i] * R[kind, i] * W[kind, b, i]
    turn, sums, none, length = np.empty((3, 3)), np.zeros(13), np.zeros(3), np.full(1, dt)
    f_n = np.empty(3)
    for k in range(z.shape[1]):
        # parity: T (z - d) = T (drift left) + T v
        for kind in range(2):
            for i in range(n):
                P[9 + kind * n + i, 9 + kind * n + i] += Q[kind, i]
            for r in range(dof):
                s = 0.0
                for i in range(n):
                    s += V[kind, r, i] * (z[kind, k, i] - d[kind, i])
                p[kind * dof + r] = s
        if mode == 0:
            if not update_joseph(x, P, p, H, RR, dz, S, e):
                return False
            correct_into(nav, x, turn)
            for kind in range(2):
                for i in range(n):
                    d[kind, i] += x[9 + kind * n + i]
            x[:] = 0.0
        elif mode == 1:
            for kind in range(2):
                for i in range(n):
                    own[kind, i, i] += Q[kind, i]
                if not _gain(own[kind], V[kind], RV[kind], K):
                    return False
                _apply(own[kind], 0, n, K, V[kind], RV[kind])
                _apply(P, 9 + kind * n, n, K, V[kind], RV[kind])
                for i in range(n):
                    for r in range(dof):
                        d[kind, i] += K[i, r] * p[kind * dof + r]
        # what is navigated with
        for kind in range(2):
            for a in range(3):
                s = 0.0
                for i in range(n):
                    s += W[kind, a, i] * (z[kind, k, i] - d[kind, i])
                u[kind, 0, a] = s
        strapdown_block(nav, m.dtheta, m.dv, u[0], u[1], length, none, none, sums)
        # errors
        c = nav[6:15].copy().reshape((3, 3))
        for a in range(3):
            f_n[a] = c[a, 0] * u[1, 0, 0] + c[a, 1] * u[1, 0, 1] + c[a, 2] * u[1, 0, 2]
            rate_out[k, a] = u[0, 0, a]
            force_out[k, a] = u[1, 0, a]
        fill_dynamics(F, nav[0], nav[2], nav[3:6].copy(), f_n, c)
        for i in range(9):
            for j in range(9):
                Phi[i, j] = (1.0 if i == j else 0.0) + F[i, j] * dt
        for a in range(3):
            for i in range(n):
                sg, sa = 0.0, 0.0
                for b in range(3):
                    sg += F[6 + a, 9 + b] * W[0, b, i]
                    sa += F[3 + a, 12 + b] * W[1, b, i]
                Phi[6 + a, 9 + i] = sg * dt
                Phi[3 + a, 9 + n + i] = sa * dt
            for b in range(3):
                sg, sa = 0.0, 0.0
                for i in range(3):
                    for j in range(3):
                        sg += c[a, i] * fused[0, i, j] * c[b, j]
                        sa += c[a, i] * fused[1, i, j] * c[b, j]
                noise[6 + a, 6 + b] = sg * dt * dt
                noise[3 + a, 3 + b] = sa * dt * dt
        predict_into(x, P, Phi, noise)
        nav_out[k] = nav
    return True


class NavigationScheme:
    """One of the schemes of thesis chapter 6, closed loop.

    Parameters
    ----------
    name : of `SCHEMES`
    nav : (16,), navigation state at the start, see riins_core.strapdown
    gyro, accel : the sensors, of the same number and sample interval
    estimate_every : IPO.NA: samples between two noise estimates
    lags, gain : IPO.NA: see `NoiseEstimator`; the thesis takes 10 lags

    Raises
    ------
    ValueError
        There is no such scheme, or the two kinds of sensors do not go together.

    Notes
    -----
    States: navigation errors x (computed - true: position, velocity, attitude) and drifts left e (true - estimated). A sample is worked in as

        e += w;  p = T (z - d);  x += K_x p, d += K_d p;  u = W (z - d);  x+ = Phi x + N W (e + v),  N = (-C for gyros, +C for accelerometers)

    and the schemes differ in the gain only. WLS.NA, figure 6.1, is the joint filter (6-33)-(6-35). PO.NA, figure 6.3, has K_x = 0 and takes K_d from
    the IMU's own filter, whose covariance never hears of external information; e then follows (6-38), carried exactly. IPO.NA, figure 6.4, is PO.NA
    with Q and R of ALS.

    Errors of the thesis: (6-37)-(6-41) mix two signs and (6-40) lacks A: with e = X - Xhat, e+ = (I - K T C)(A e + w) - K T v, and the parity
    innovation is + T C e. F as in `riins_core.ins_error`. PO.NA has an advantage over WLS.NA only when WLS.NA drops its parity rows, which is
    a scheme of its own here. The printed Q is a random walk of 55 deg/h in 150 s: with it no scheme remembers for long what a fix has taught it.
    """

    def __init__(
        self, name: str, nav: Array, gyro: TriadModel, accel: TriadModel, estimate_every: int = 200, lags: int = 10, gain: float = 0.5
    ) -> None:
        if name not in SCHEMES:
            raise ValueError(f'there is no scheme "{name}"; there are {", ".join(SCHEMES)}')
        if gyro.array.n != accel.array.n or gyro.dt != accel.dt:
            raise ValueError("gyros and accelerometers must be of the same number and sample interval")
        self.name, self.dt, self._every = name, gyro.dt, estimate_every
        self._mode, adaptive = SCHEMES[name]
        self._models = (gyro, accel)
        n = gyro.array.n
        P = np.zeros((_N + 2 * n, _N + 2 * n))
        P[np.arange(_N, _N + 2 * n), np.arange(_N, _N + 2 * n)] = np.r_[gyro.P, accel.P]
        own = np.stack([np.diag(gyro.P), np.diag(accel.P)])
        start = np.zeros(NAV_SIZE)
        start[:15] = nav[:15]
        self._memory = _Memory(start, np.zeros(3), np.zeros(3), np.zeros((2, n)), P, own)
        self._known = self._make_known(np.stack([gyro.R, accel.R]), np.stack([gyro.Q, accel.Q]))
        self._estimators = tuple(NoiseEstimator(model.array, lags, gain) for model in self._models) if adaptive else ()
        self._samples = 0

    def _make_known(self, R: Array, Q: Array) -> _Known:
        V = np.stack([model.array.parity() for model in self._models])
        W = np.stack([model.array.least_squares(None, np.sqrt(r)) for model, r in zip(self._models, R, strict=True)])
        return _Known(V, W, R, np.stack([(v * r) @ v.T for v, r in zip(V, R, strict=True)]), Q)

    def copy(self) -> Self:
        """Independent object in the same state."""
        other = copy.copy(self)
        other._memory = _Memory(*(array.copy() for array in self._memory))
        other._estimators = tuple(one.copy() for one in self._estimators)
        return other

    @property
    def drift(self) -> Array:
        """(2, n), drifts as estimated, gyros [rad/s] and accelerometers [m/s^2]."""
        return self._memory.d.copy()

    @property
    def covariance(self) -> Array:
        """(9 + 2 n, 9 + 2 n), of the navigation errors and the drifts left."""
        return self._memory.P.copy()

    @property
    def noise(self) -> tuple[Array, Array]:
        """Q and R (2, n) in use, per sample."""
        return self._known.Q.copy(), self._known.R.copy()

    def process(self, gyro: ArrayLike, accel: ArrayLike) -> SchemeOutput:
        """Navigate through a block.

        Parameters
        ----------
        gyro, accel : (m, n), readings [rad/s], [m/s^2], all finite

        Raises
        ------
        ValueError
            The readings are not finite, or not of this size.
        NotPositiveDefinite
            The filter has broken down.
        """
        z = np.ascontiguousarray(np.stack([gyro, accel]), dtype=np.float64)
        if z.ndim != 3 or z.shape[2] != self._memory.d.shape[1] or not np.all(np.isfinite(z)):
            raise ValueError("readings must be finite and one for each sensor")
        m = z.shape[1]
        out = SchemeOutput(np.empty((m, NAV_SIZE)), np.empty((m, 3)), np.empty((m, 3)))
        k = 0
        while k < m:
            stop = min(m, k + self._every - self._samples % self._every) if self._estimators else m
            part = np.ascontiguousarray(z[:, k:stop])
            if not _scheme_block(self._mode, self._memory, self._known, self.dt, part, *(array[k:stop] for array in out)):
                raise NotPositiveDefinite("the innovation covariance is not positive definite")
            for estimator, readings in zip(self._estimators, part, strict=False):
                estimator.process(readings)
            self._samples += stop - k
            if self._estimators and self._samples % self._every == 0:
                self._take_estimates()
            k = stop
        return out

    def _take_estimates(self) -> None:
        try:
            made = [estimator.estimate() for estimator in self._estimators]
        except ValueError:  # too few samples yet
            return
        self._known = self._make_known(np.stack([one.R for one in made]), np.stack([one.Q for one in made]))

    def fix(self, measured: Array, sigma: ArrayLike) -> None:
        """External information at the last sample's time; navigation and drifts are corrected at once.

        Parameters
        ----------
        measured : (>= 15,), latitude, longitude, height, velocity NED, C_nb row-major
        sigma : (9,), standard deviations of position NED [m], velocity [m/s], attitude [rad]; inf: not measured

        Raises
        ------
        ValueError
            A standard deviation is not positive.
        NotPositiveDefinite
            The filter has broken down.
        """
        spread = np.asarray(sigma, dtype=np.float64)
        if spread.shape != (_N,) or not np.all(spread > 0.0):
            raise ValueError("needs nine positive standard deviations")
        rows = np.flatnonzero(np.isfinite(spread))
        memory = self._memory
        x, H, q = np.zeros(len(memory.P)), np.zeros((rows.size, len(memory.P))), rows.size
        H[np.arange(q), rows] = 1.0
        z = ins_error.difference(memory.nav, np.asarray(measured, dtype=np.float64))[rows]
        if not update_joseph(x, memory.P, z, H, np.diag(spread[rows] ** 2), np.empty(q), np.empty((q, q)), np.empty(q)):
            raise NotPositiveDefinite("the innovation covariance is not positive definite")
        ins_error.correct(memory.nav, x)
        memory.d[...] += x[_N:].reshape(memory.d.shape)
