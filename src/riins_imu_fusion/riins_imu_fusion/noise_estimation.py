"""Autocovariance least squares (ALS): the process and measurement noise of each sensor, from the parity vectors alone.

Lives here: `NoiseEstimator`, which is fed samples and asked for `NoiseEstimate`.
Does not live here: who uses the estimate (riins_federated.schemes), adaptive filters without it (adaptive.py).
"""

from __future__ import annotations

import copy
import itertools
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import nnls

from riins_core.imu_array import ImuArray
from riins_core.jit import inner, jit

Array = NDArray[np.float64]


class NoiseEstimate(NamedTuple):
    """Noise as estimated, U^2.

    Attributes
    ----------
    Q : (n,), variance of each sensor's drift step from one sample to the next
    R : (n,), variance of each sensor's white noise; one value for all unless `each` was asked for
    pairs : number of sample pairs behind the longest lag
    """

    Q: Array
    R: Array
    pairs: int


@inner
def autocovariance_step(s: Array, ring: Array, sums: Array, count: Array, gain: float, V: Array, z: Array) -> None:
    """One sample z (n,); the rest as in `autocovariance_block`."""
    lags, dof = ring.shape
    if count[0] == 0.0:
        for r in range(dof):
            s[r] = 0.0
            for i in range(z.shape[0]):
                s[r] += V[r, i] * z[i]
        count[0] = 1.0
        return
    now = int(count[0]) % lags
    for r in range(dof):
        p = 0.0
        for i in range(z.shape[0]):
            p += V[r, i] * z[i]
        ring[now, r] = p - s[r]
        s[r] += gain * ring[now, r]
    count[0] += 1.0
    if count[0] <= 1.0 + count[1]:
        return
    for j in range(lags):
        if count[0] - count[1] > 1.0 + j:
            count[2 + j] += 1.0
            then = now - j if now >= j else now - j + lags
            for r in range(dof):
                for q in range(dof):
                    sums[j, r, q] += ring[now, r] * ring[then, q]


@jit
def autocovariance_block(s: Array, ring: Array, sums: Array, count: Array, gain: float, V: Array, z: Array) -> None:
    """Samples one after the other through a filter of fixed gain, (6-44)-(6-46) in parity space, and the sums of products of its innovations.

    Parameters
    ----------
    s : (dof,), predicted parity, in place
    ring : (N, dof), last innovations, in place
    sums : (N, dof, dof), sums of r_(k+j) r_k', in place
    count : (2 + N,), samples of this unbroken run, samples to go until the start has faded, products in each lag; in place
    gain : of the filter, 0..1
    V, z : (dof, n), (m, n)
    """
    for k in range(z.shape[0]):
        autocovariance_step(s, ring, sums, count, gain, V, z[k])


class NoiseEstimator:
    """ALS, thesis 6.4.1, in parity space.

    Parameters
    ----------
    array : geometry of n sensors
    lags : N, autocovariances of lags 0..N-1 are used; the thesis takes 10
    gain : of the filter whose innovations are taken, 0..1; any gives an unbiased estimate, one near the optimal filter's the sharpest
    each : estimate the white noise of each sensor, instead of one for all

    Notes
    -----
    Model: parities p = T d + T v with drifts d+ = d + w. A filter s+ = s + g r, r = p - s, has errors e+ = a e + T w - g T v, a = 1 - g, and

        P = (Q_p + g^2 R_p) / (1 - a^2),  E r_k r_k' = P + R_p,  E r_(k+j) r_k' = a^j P - a^(j-1) g R_p,

    Q_p = sum q_i v_i v_i', R_p = sum r_i v_i v_i': linear in q_i, r_i, least squares with q_i, r_i >= 0, rows weighted by the innovation covariance.
    Wrong in the thesis: (6-59)-(6-61) end in - H ... A K R, not A-bar K R; (6-66)/(6-69) need the Kronecker sum and the block of Q; its 12-state
    model is not observable from parity (rank 3 of 6 in each triad). In parity space it is, and for six sensors the six v_i v_i' are independent
    (condition 2.24 on the dodecahedron), so each q_i is found. A constant drift is no process noise: there the right answer is about 0.
    """

    def __init__(self, array: ImuArray, lags: int = 10, gain: float = 0.3, each: bool = False) -> None:
        if lags < 2 or not 0.0 < gain < 1.0:
            raise ValueError("needs at least two lags and a gain between 0 and 1")
        self.array, self.lags, self.gain, self.each = array, lags, gain, each
        self._key = 0
        self._V = np.zeros((0, array.n))
        self._start()

    def _start(self) -> None:
        dof = len(self._V)
        fade = np.ceil(np.log(1e-3) / np.log(1.0 - self.gain))
        self._s, self._ring, self._sums = np.zeros(dof), np.zeros((self.lags, dof)), np.zeros((self.lags, dof, dof))
        self._count = np.zeros(2 + self.lags)
        self._count[1] = fade

    def copy(self) -> Self:
        """Independent object in the same state."""
        other = copy.copy(self)
        for name in ("_s", "_ring", "_sums", "_count"):
            setattr(other, name, getattr(self, name).copy())
        return other

    def restart(self) -> None:
        """Begin a new unbroken run (after a gap or a change of the sensors' calibration); what was gathered stays."""
        self._count[0] = 0.0

    def process(self, readings: ArrayLike, mask: int | None = None) -> None:
        """Gather a block.

        Parameters
        ----------
        readings : (m, n), one sample after the other without a gap, U; samples with a value that is not finite break the run
        mask : bit i set: sensor i is used, the same for the block; None: all. Another set of sensors begins from nothing

        Raises
        ------
        ValueError
            The sensors do not span three axes, or have no redundancy.
        """
        key = (1 << self.array.n) - 1 if mask is None else int(mask)
        if key != self._key:
            V = self.array.parity_full(key)
            if not len(V):
                raise ValueError("sensors without redundancy have no parity")
            self._key, self._V = key, V
            self._start()
        used = self.array.used(key)
        z = np.zeros((len(np.asarray(readings)), self.array.n))
        z[:, used] = np.asarray(readings, dtype=np.float64)[:, used]
        good = np.all(np.isfinite(z), axis=1)
        edge = [0, *(np.flatnonzero(good[1:] != good[:-1]) + 1).tolist(), len(z)]
        for start, stop in itertools.pairwise(edge):
            if stop > start and not good[start]:
                self.restart()
            elif stop > start:
                autocovariance_block(self._s, self._ring, self._sums, self._count, self.gain, self._V, z[start:stop])

    def estimate(self) -> NoiseEstimate:
        """Estimate from everything gathered so far; NaN where sensors are not used.

        Raises
        ------
        ValueError
            Fewer than 100 pairs of samples, or sensors that cannot be told apart: n (n + 1) / 2 products of parities are fewer than the unknowns.
        """
        used = self.array.used(self._key) if self._key else np.zeros(0, np.intp)
        return solve(self._V, used, self._sums, self._count[2:], self.gain, self.each)


def solve(V: Array, used: NDArray[np.intp], sums: Array, products: Array, gain: float, each: bool) -> NoiseEstimate:
    """Least squares of the autocovariances, see `NoiseEstimator`.

    Parameters
    ----------
    V : (dof, n), parity matrix with V V' = I
    used : sensors in it
    sums, products : (N, dof, dof), (N,), sums of r_(k+j) r_k' and their number
    gain : of the filter
    each : white noise of each sensor, instead of one for all

    Raises
    ------
    ValueError
        As `NoiseEstimator.estimate`.
    """
    pairs = int(products[-1])
    if pairs < 100:
        raise ValueError("noise can be estimated from 100 pairs of samples on")
    cov = sums / products[:, None, None]
    cov[0] = 0.5 * (cov[0] + cov[0].T)
    dyads = np.array([np.outer(v, v) for v in V[:, used].T])
    white = dyads if each else np.sum(dyads, axis=0)[None]
    inverse = np.linalg.inv(np.linalg.cholesky(cov[0]))
    rows, right = [], []
    a, g = 1.0 - gain, gain
    upper = np.triu_indices(len(V))
    for j in range(len(products)):
        p = a**j / (1.0 - a * a)
        r = g * g * p + (1.0 if j == 0 else -(a ** (j - 1)) * g)
        weight = np.where(upper[0] == upper[1], 1.0, np.sqrt(2.0)) * (np.sqrt(0.5) if j == 0 else 1.0)
        parts = np.concatenate([p * dyads, r * white])
        rows.append(weight[:, None] * (inverse @ parts @ inverse.T)[:, upper[0], upper[1]].T)
        seen = inverse @ (0.5 * (cov[j] + cov[j].T)) @ inverse.T
        right.append(weight * seen[upper])
    A, b = np.concatenate(rows), np.concatenate(right)
    scale = np.linalg.norm(A, axis=0)
    if np.linalg.matrix_rank(A / scale, tol=1e-6) < A.shape[1]:
        raise ValueError("these sensors cannot be told apart by their parities")
    solution = nnls(A / scale, b)[0] / scale
    Q, R = np.full(V.shape[1], np.nan), np.full(V.shape[1], np.nan)
    Q[used] = solution[: used.size]
    R[used] = solution[used.size :]
    return NoiseEstimate(Q, R, pairs)
