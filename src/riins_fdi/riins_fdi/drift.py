"""Drift compensation in real time: RFDC and the thesis' improved IRFDC, with EKF, AEKF, AEKPF and PF (thesis 4.3).

Lives here: the loop that estimates each sensor's drift from parity and feeds it back, its drift factor, what it cannot see.
Does not live here: one filter step (drift_filters), the fusion of compensated sensors (riins_imu_fusion), the thesis' experiments (riins_eval).
"""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from riins_core.imu_array import ImuArray
from riins_core.noise import normal
from riins_core.settings import setting
from riins_fdi.drift_filters import AEKF, AEKPF, AEKPF_OPTIMAL, EKF, PF, loop
from riins_fdi.parity import parity_relations

Array = NDArray[np.float64]

FILTERS = {"ekf": EKF, "aekf": AEKF, "aekpf": AEKPF, "aekpf_optimal": AEKPF_OPTIMAL, "pf": PF}
"""Filters by name. aekpf: proposal as printed, N(estimate, whole covariance); aekpf_optimal: the locally optimal one (Doucet 2000), linearized."""

_CHUNK = 64  # samples whose random numbers are drawn at once


@dataclass(frozen=True)
class DriftConfig:
    """Settings of the compensation; U is the unit of the measurements (deg/h in the thesis)."""

    filter: str = setting("ekf", "filter that estimates what is left of the drifts", choices=tuple(FILTERS))
    drift_factor: bool = setting(True, "feed back with the drift factor of IRFDC; without it the loop is RFDC")
    gain: float = setting(40.0, "feedback gain K", "1/s", 0.0, 1e4)
    dt: float = setting(0.01, "sample interval; the thesis does not give it", "s", 1e-6, 10.0)
    sigma: float = setting(0.04, "noise of one sensor in one sample", "U", 1e-12, 1e12)
    process_sigma: float = setting(0.02, "random walk of a drift in one sample", "U", 1e-12, 1e12)
    vote_sigma: float = setting(0.01, "noise of the pseudo-measurements of (4-47), in units of U^2", "", 1e-12, 1e12)
    most: float = setting(5.0, "bound of the standard deviation of a drift", "U", 1e-12, 1e12)
    particles: int = setting(100, "particles of aekpf, aekpf_optimal and pf", "", 2, 100_000)
    seed: int = setting(1, "of the particles", "", 0, 2**31 - 1)


class DriftBlock(NamedTuple):
    """What the loop says at each sample of a block; (m, n) each."""

    compensated: Array
    """measurements without the drift, m - D, with D known before the sample"""
    compensation: Array
    """D after the sample: the drift found so far"""
    remaining: Array
    """the filter's estimate of the drift that is left"""
    factor: Array
    """drift factor of the feedback"""


class DriftReport(NamedTuple):
    """The compensation, and what is known of it."""

    compensation: Array
    """(n,), D = measured + H assumed"""
    measured: Array
    """(n,), part of D that parity measured"""
    assumed: Array
    """(3,), body rate that D takes out of the fused value; nothing measured it: it follows from the guess that few sensors drift"""
    unobservable: Array
    """(n, 3), orthonormal columns that span the range of H. The part of the true drifts in it is not compensated unless that guess is right,
    and stays in the body rate; only aiding from outside resolves it"""


def voting_rows(array: ImuArray, mask: int | None = None) -> Array:
    """Voting vector of each sensor: a parity relation without it, thesis (4-42) and (4-85).

    Parameters
    ----------
    array : n sensors
    mask : bit i set: sensor i is used; None: all

    Returns
    -------
    (n, n), row i a unit row r with r H = 0, r_i = 0, from as few relations as possible: three for a dodecahedron, each without two sensors,
    which are the rows of (4-85) over sqrt 2 in the order of (2-33); zeros for and at sensors that are not used

    Raises
    ------
    ValueError
        A sensor enters every relation: nothing can vote on it. The sensors do not span three axes, or are too many for `parity_relations`.
    """
    if mask is not None and mask != (1 << array.n) - 1:
        used = array.used(mask)
        rows = np.zeros((array.n, array.n))
        rows[np.ix_(used, used)] = voting_rows(ImuArray(array.H[used]))
        return rows
    relations, members = parity_relations(array)
    left, rows = set(range(array.n)), np.zeros((array.n, array.n))
    while left:
        best = max(range(len(members)), key=lambda j: (len(left - set(members[j])), -j))
        without = left - set(members[best])
        if not without:
            raise ValueError(f"sensors {sorted(i + 1 for i in left)} enter every parity relation")
        rows[sorted(without)] = relations[best]
        left -= without
    return rows


class DriftCompensator:
    """Estimates the drifts of all sensors and takes them out, without thresholds.

    Parameters
    ----------
    array : geometry
    config : settings

    Notes
    -----
    State d, what is left of the drifts: d <- d + u dt with u = -K alpha d^ (the thesis' (4-53) lacks u). Measurements z = [V (m - D); 0] against
    [V d; (c_i d) d_i], c_i the voting row of sensor i: the second part holds when one sensor drifts, and is what attributes a drift to a sensor,
    for parity has n - 3 dimensions and drift n. D accumulates K alpha d^ dt; (4-64)/(4-65) lack dt, without which K = 40 diverges.
    Drift factor (4-66)-(4-72) with |D d^| in (4-70); the fading of (4-50) inflates P without bound in the range of H, so P is bounded by `most`.

    What it cannot do (errata): a drift in the range of H, d = H w, leaves no trace in parity and stays in the body rate: `report` names those
    patterns, and what part of the compensation was not measured. Attribution is a guess by sparsity, right the less often the more sensors vary
    at a time, and wrong guesses leave parity clean: the loop must not be trusted to say that it succeeded.
    """

    def __init__(self, array: ImuArray, config: DriftConfig | None = None) -> None:
        self.config = c = config or DriftConfig()
        self.array = array
        self.V = array.parity()
        if len(self.V) < 1:
            raise ValueError("three sensors have no redundancy")
        self.votes = voting_rows(array)
        n, particles = array.n, c.particles if FILTERS[c.filter] >= AEKPF else 1
        self._k = 0
        self._x = np.zeros(n)
        self._p = np.eye(n) * c.process_sigma**2
        self._d = np.zeros(n)
        self._alpha = np.full(n, 1.0 / n if c.drift_factor else 1.0)
        self._change = np.zeros(n)
        self._cloud = np.zeros((particles, n))
        self._weights = np.full(particles, 1.0 / particles)
        self._numbers = particles * n + 1 if FILTERS[c.filter] >= AEKPF else 0

    @property
    def compensation(self) -> Array:
        """D, (n,): drift found so far."""
        return self._d.copy()

    def process(self, m: ArrayLike) -> DriftBlock:
        """Feed measurements (m, n); the result does not depend on how they are cut into blocks."""
        z = np.ascontiguousarray(np.atleast_2d(np.asarray(m, dtype=np.float64)))
        c, out = self.config, DriftBlock(*(np.empty_like(z) for _ in range(4)))
        settings = np.array([c.gain, c.dt, c.sigma, c.process_sigma, c.vote_sigma, c.most])
        for start in range(0, len(z), _CHUNK):
            some = slice(start, min(start + _CHUNK, len(z)))
            count = some.stop - start
            draws = normal(c.seed, "drift particles", self._k, count, self._numbers) if self._numbers else np.zeros((count, 0))
            loop(
                z[some], self.V, self.votes, settings, FILTERS[c.filter], c.drift_factor, draws, self._x, self._p, self._d,
                self._alpha, self._change, self._cloud, self._weights, *(a[some] for a in out),
            )  # fmt: skip
            self._k += count
        return out

    def clone(self) -> DriftCompensator:
        """A copy that goes on independently."""
        other = copy.copy(self)
        for name in ("_x", "_p", "_d", "_alpha", "_change", "_cloud", "_weights"):
            setattr(other, name, getattr(self, name).copy())
        return other

    def report(self) -> DriftReport:
        """What has been compensated, and how much of it anybody measured."""
        q, r = np.linalg.qr(self.array.H)
        return DriftReport(self._d.copy(), self.V.T @ (self.V @ self._d), self.array.least_squares() @ self._d, q * np.sign(np.diag(r)))
