"""Structures of a federated filter behind one interface, for any linear(ized) model: fusion-reset, partial feedback, no-reset.

Lives here: `Structure`, what it shares (gates, adaptive noise), and `FederatedFilter`, whose retention makes it any of the three.
Does not live here: the information form with leave-one-out masters (separated_masters.py), shares (information_sharing.py), any navigation.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from riins_core.jit import jit
from riins_core.kalman import cholesky_into, predict_into, update_joseph
from riins_fdi.innovation import nis_threshold
from riins_fdi.innovation_tests import InnovationTest

from .adaptive_noise import AdaptiveNoise
from .aiding import Measurement
from .information_sharing import checked_shares, equal_shares, innovation_shares, trace_shares
from .types import Array


class Verdict(NamedTuple):
    """What became of one measurement."""

    statistic: float
    """NIS against the filter that judges"""
    threshold: float
    """infinite without a gate"""
    passed: bool
    """no test failed"""
    fused: bool
    held: bool
    """left out only since the further test has alarmed lately"""


@dataclass(frozen=True)
class Gate:
    """How measurements are judged.

    Attributes
    ----------
    pfa : false-alarm probability of the NIS, None: everything passes
    test : makes a further test on the innovations of one aid, given its number of components
    hold : epochs for which an aid is left out after that test's alarm; what it had put in before stays
    """

    pfa: float | None = 1e-5
    test: Callable[[int], InnovationTest] | None = None
    hold: int = 30


@jit
def innovation_into(x: Array, P: Array, z: Array, H: Array, R: Array, standardized: Array) -> float:
    """Kernel: standardized innovation (m,) written, NIS returned; infinite where its covariance is not positive definite or z not finite."""
    n, m = x.shape[0], z.shape[0]
    S = np.empty((m, m))
    for a in range(m):
        for b in range(a + 1):
            s = 0.5 * (R[a, b] + R[b, a])
            for i in range(n):
                if H[a, i] != 0.0:
                    for j in range(n):
                        s += H[a, i] * P[i, j] * H[b, j]
            S[a, b] = s
            S[b, a] = s
    L = np.zeros((m, m))
    for a in range(m):
        standardized[a] = np.inf
    if not cholesky_into(S, L):
        return np.inf
    nis = 0.0
    for a in range(m):
        s = z[a]
        for i in range(n):
            s -= H[a, i] * x[i]
        for b in range(a):
            s -= L[a, b] * standardized[b]
        standardized[a] = s / L[a, a]
        nis += standardized[a] ** 2
    return nis if nis < np.inf else np.inf  # not a number is infinite too


class Estimate:
    """State and covariance of one Kalman filter, changed in place by kernels. x: (n,), P: (n, n)."""

    __slots__ = ("P", "x")

    def __init__(self, x: Array, P: Array) -> None:
        self.x, self.P = np.array(x, dtype=np.float64), np.array(P, dtype=np.float64)

    def predict(self, Phi: Array, Qd: Array) -> None:
        """Time update."""
        predict_into(self.x, self.P, Phi, Qd)

    def nis(self, measurement: Measurement) -> tuple[float, Array]:
        """NIS and standardized innovation of a measurement that is not applied."""
        standardized = np.empty(len(measurement.z))
        return innovation_into(self.x, self.P, measurement.z, measurement.H, measurement.R, standardized), standardized

    def update(self, measurement: Measurement) -> None:
        """Measurement update."""
        m = len(measurement.z)
        update_joseph(self.x, self.P, measurement.z, measurement.H, measurement.R, np.empty(m), np.empty((m, m)), np.empty(m))

    def copy(self) -> Estimate:
        """A copy that goes on independently."""
        return Estimate(self.x, self.P)


class Structure:
    """What all structures share. One epoch: predict, judge every aid against the prediction, fuse those that pass.

    Parameters
    ----------
    n_aids : aids, in a fixed order
    gate : how they are judged
    adaptive : scale each aid's noise by what its innovations show
    """

    def __init__(self, n_aids: int, gate: Gate, adaptive: bool) -> None:
        self.gate = gate
        self._tests: list[InnovationTest | None] = [None] * n_aids
        self._held = [0] * n_aids
        self._noise = [AdaptiveNoise() for _ in range(n_aids)] if adaptive else None

    @property
    def x(self) -> Array:
        """Fused state (n,)."""
        raise NotImplementedError

    @property
    def P(self) -> Array:
        """Its covariance (n, n)."""
        raise NotImplementedError

    def epoch(self, Phi: Array, Qd: Array, aids: Sequence[Measurement | None]) -> list[Verdict | None]:
        """Advance to the next epoch and take in what was measured there.

        Parameters
        ----------
        Phi, Qd : (n, n), transition and process noise since the last epoch
        aids : one measurement of each aid, None where there is none

        Returns
        -------
        one verdict for each measurement; nothing depends on the order of the aids but their numbers
        """
        raise NotImplementedError

    def shift(self, dx: Array) -> None:
        """Subtract dx (n,): it has been fed back into the nominal state."""
        raise NotImplementedError

    def clone(self) -> Structure:
        """A copy that goes on independently."""
        other = copy.copy(self)
        other._tests = [test.clone() if test else None for test in self._tests]
        other._held = self._held.copy()
        other._noise = [noise.clone() for noise in self._noise] if self._noise else None
        return other

    def _present(self, aids: Sequence[Measurement | None]) -> list[Measurement | None]:
        if self._noise is None:
            return list(aids)
        present: list[Measurement | None] = []
        for noise, measurement in zip(self._noise, aids, strict=True):
            if measurement is None:
                noise.gap()
            present.append(None if measurement is None else noise.scaled(measurement))
        return present

    def _threshold(self, measurement: Measurement) -> float:
        return np.inf if self.gate.pfa is None else nis_threshold(self.gate.pfa, len(measurement.z))

    def _judge(self, index: int, reported: Measurement, measurement: Measurement, by: Estimate) -> tuple[float, float, bool, bool]:
        """NIS, threshold, whether both tests pass, and whether it is only held."""
        statistic, standardized = by.nis(measurement)
        threshold = self._threshold(measurement)
        passed, held = statistic <= threshold and statistic < np.inf, False
        if self._noise is not None:
            self._noise[index].learn(measurement.z - measurement.H @ by.x, reported.R)
        if self.gate.test is not None:
            test = self._tests[index]
            if test is None:
                test = self._tests[index] = self.gate.test(len(measurement.z))
            if self._held[index]:
                self._held[index] -= 1
                passed, held = False, passed
            elif test.step(standardized).alarm:
                self._held[index] = self.gate.hold
                test.reset()
                passed = False
        return statistic, threshold, passed, held


class FederatedFilter(Structure):
    """Local filters, one for each aid, and a master that fuses them (Carlson 1990); the retention says how much of itself a local filter keeps.

    Parameters
    ----------
    x0, P0 : (n,), (n, n)
    n_aids : local filters
    retention : alpha of 002 figure 4. 0: fusion-reset. 1: no-reset. Between: after each fusion a local filter keeps alpha of its information and
        gets (1 - alpha) beta of the fused one, so that the sum stays what was fused: none is made, none lost
    beta : (n_aids,), shares; None: equal
    sharing : "fixed", "trace" or "innovation": the last two change the shares at every fusion
    gate, adaptive : as in `Structure`

    Notes
    -----
    Local filters begin with P0 / beta and carry the process noise Q / beta. Fusion-reset equals the centralized filter for any shares, constant or
    not (the tests hold it to that); no-reset is an upper bound that loses a few per cent and keeps a fault in one local filter. Zero-reset, in which
    the local filters send what they gained and begin again without information, is the information form and not offered twice.
    """

    def __init__(
        self, x0: Array, P0: Array, n_aids: int, *, retention: float = 0.0, beta: Array | None = None, sharing: str = "fixed",
        gate: Gate = Gate(), adaptive: bool = False,
    ) -> None:  # fmt: skip
        super().__init__(n_aids, gate, adaptive)
        if not 0.0 <= retention <= 1.0:
            raise ValueError(f"the retention must be in [0, 1], not {retention}")
        if sharing not in ("fixed", "trace", "innovation"):
            raise ValueError(f"the sharing must be fixed, trace or innovation, not {sharing!r}")
        self.retention, self.sharing = retention, sharing
        self.beta = equal_shares(n_aids) if beta is None else checked_shares(beta)
        self._fused = Estimate(x0, P0)
        self._local = [Estimate(x0, P0 / share) for share in self.beta]
        self._traces = np.ones((2, n_aids))  # of the innovations: expected, found

    @property
    def x(self) -> Array:
        """Fused state (n,)."""
        return self._fused.x

    @property
    def P(self) -> Array:
        """Its covariance (n, n)."""
        return self._fused.P

    def epoch(self, Phi: Array, Qd: Array, aids: Sequence[Measurement | None]) -> list[Verdict | None]:
        """As in `Structure`. Judged by the fused prediction in fusion-reset, by the local filter's own otherwise."""
        for local, share in zip(self._local, self.beta, strict=True):
            local.predict(Phi, Qd / share)
        self._fused.predict(Phi, Qd)
        verdicts: list[Verdict | None] = []
        for i, (reported, measurement) in enumerate(zip(aids, self._present(aids), strict=True)):
            if reported is None or measurement is None:
                verdicts.append(None)
                continue
            statistic, threshold, passed, held = self._judge(i, reported, measurement, self._local[i] if self.retention else self._fused)
            self._count(i, measurement)
            if passed:
                self._local[i].update(measurement)
            verdicts.append(Verdict(statistic, threshold, passed, passed, held))
        if self.retention or any(verdict and verdict.fused for verdict in verdicts):
            self._fuse()
        return verdicts

    def shift(self, dx: Array) -> None:
        """As in `Structure`."""
        for one in (self._fused, *self._local):
            one.x -= dx

    def clone(self) -> FederatedFilter:
        """As in `Structure`."""
        other = super().clone()
        assert isinstance(other, FederatedFilter)
        other._fused = self._fused.copy()
        other._local = [local.copy() for local in self._local]
        other.beta, other._traces = self.beta.copy(), self._traces.copy()
        return other

    def _fuse(self) -> None:
        n = len(self.x)
        scale = np.sqrt(np.diag(self._fused.P))  # states differ by many powers of ten: unit diagonal; a state without variance stays as it is
        on = np.flatnonzero(scale > 0.0)
        cut, scale = np.ix_(on, on), scale[on]
        informations = [np.linalg.inv(local.P[cut] / np.outer(scale, scale)) for local in self._local]
        vectors = [Y @ (local.x[on] / scale) for Y, local in zip(informations, self._local, strict=True)]
        Y, y = np.sum(informations, axis=0), np.sum(vectors, axis=0)
        P = np.linalg.inv(Y)
        self._fused.P[:] = 0.0
        self._fused.P[cut] = 0.5 * (P + P.T) * np.outer(scale, scale)
        self._fused.x = np.zeros(n)
        self._fused.x[on] = P @ y * scale
        if self.sharing == "trace":
            self.beta = trace_shares([np.linalg.inv(one) for one in informations])
        elif self.sharing == "innovation":
            self.beta = innovation_shares(*self._traces)
        for i, local in enumerate(self._local):
            if self.retention == 0.0:
                local.x, local.P = self._fused.x.copy(), self._fused.P / self.beta[i]
            elif self.retention < 1.0:
                share = (1.0 - self.retention) * self.beta[i]
                kept = np.linalg.inv(self.retention * informations[i] + share * Y)
                local.x[on] = kept @ (self.retention * vectors[i] + share * y) * scale
                local.P[cut] = 0.5 * (kept + kept.T) * np.outer(scale, scale)

    def _count(self, index: int, measurement: Measurement) -> None:
        """Traces of the innovation covariance, expected and found, over the last twenty epochs or so."""
        if self.sharing == "innovation":
            innovation = measurement.z - measurement.H @ self._fused.x
            unit = np.trace(measurement.R)
            expected = np.trace(measurement.H @ self._fused.P @ measurement.H.T) / unit + 1.0
            self._traces[:, index] += 0.05 * (np.array([expected, min(float(innovation @ innovation) / unit, 1e6)]) - self._traces[:, index])
