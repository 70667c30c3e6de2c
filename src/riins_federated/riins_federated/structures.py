"""Structures of a federated filter behind one interface, for any linear(ized) model: fusion-reset, partial feedback, no-reset.

Lives here: `Structure`, what all share (gates, adaptive noise), and `FederatedFilter`, whose retention makes it any of the three.
Does not live here: the information form with leave-one-out masters (separated_masters.py), shares (information_sharing.py), any navigation.
"""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from riins_fdi.eraim import protection_levels, quantiles
from riins_fdi.innovation import nis_threshold
from riins_fdi.innovation_tests import InnovationTest

from .adaptive_noise import AdaptiveNoise
from .aiding import Measurement
from .information_sharing import checked_shares, equal_shares, innovation_shares, trace_shares
from .stacked import Estimate, Innovations, Rows, Stack
from .types import Array


class Verdict(NamedTuple):
    """What became of one measurement."""

    statistic: float
    """NIS of the innovation below"""
    threshold: float
    """infinite without a gate"""
    passed: bool
    """no test failed"""
    fused: bool
    held: bool
    """left out only since the further test has alarmed lately"""
    alarm: bool
    """the further test has alarmed on it"""
    measurement: Measurement
    """with the noise by which it is weighted"""
    innovation: Array
    """(m,) against the filter that judges; against the one that rejects it where two do"""
    sigma: Array
    standardized: Array
    information: Array
    """(2,), trace of its information on position and velocity"""


class Layout(NamedTuple):
    """Which states are what.

    position: north and east, m. navigation: states whose separation is tested beside the position, as position, velocity and attitude: they tell
    which aid it is, and find it sooner; none: the position alone. heading: rad; None: there is none
    """

    position: tuple[int, int] = (0, 1)
    navigation: tuple[int, ...] = ()
    heading: int | None = None


class Replaced(NamedTuple):
    """What an aid had put in has been taken out of the master."""

    aid: int
    statistic: float
    threshold: float
    jump: Array
    """(n,), by which the estimate has changed"""


class Watched(NamedTuple):
    """Separation of an aid's leave-one-out master from the master: of the two statistics the one nearer to its threshold; 0 where none is."""

    statistic: float
    threshold: float


@dataclass(frozen=True)
class Gate:
    """How the measurements of one aid are judged.

    Attributes
    ----------
    pfa : false-alarm probability of the NIS, None: everything passes
    test : makes a further test on the innovations of one aid, given its number of components
    hold : epochs for which an aid is left out after that test's alarm; what it had put in before stays
    """

    pfa: float | None = 1e-5
    test: Callable[[int], InnovationTest] | None = None
    hold: int = 30


_GATE, _LAYOUT = Gate(), Layout()


class Structure(ABC):
    """What all structures share.

    Parameters
    ----------
    x0, P0 : (n,), (n, n)
    filters : filters in the stack
    n_aids : aids, in a fixed order
    layout : which states are what
    gate : how they are judged; one for all, or one for each
    adaptive : scale the noise of an aid by what its innovations show; one for all, or one for each

    Notes
    -----
    One epoch is `predict`, then `judge` and `take` for each measurement, then `close`; `epoch` does all of it. `add` takes what all believe.
    """

    def __init__(
        self, x0: Array, P0: Array, filters: int, n_aids: int, layout: Layout, gate: Gate | Sequence[Gate], adaptive: bool | Sequence[bool]
    ) -> None:
        self.layout = layout
        self.gates = [gate] * n_aids if isinstance(gate, Gate) else list(gate)
        self._stack = Stack(x0, P0, filters)
        self._tests: list[InnovationTest | None] = [None] * n_aids
        self._held = [0] * n_aids
        wanted = [adaptive] * n_aids if isinstance(adaptive, bool) else adaptive
        self._noise = [AdaptiveNoise() if one else None for one in wanted]
        self.beta: Array = equal_shares(n_aids)

    @property
    def x(self) -> Array:
        """Fused state (n,), a view."""
        return self._stack.X[0]

    @property
    def P(self) -> Array:
        """Its covariance (n, n), a view."""
        return self._stack.P[0]

    @abstractmethod
    def predict(self, Phi: Array, Qd: Array) -> None:
        """Advance by one interval with transition and process noise (n, n)."""

    def judge(self, index: int, measurement: Measurement) -> Verdict:
        """Judge a measurement of aid `index` against the state as it is; nothing is fused."""
        noise = self._noise[index]
        reported = contiguous(measurement)
        used = reported if noise is None else noise.scaled(reported)
        found = self._stack.judge(self._judges(index), used.z, used.H, used.R)
        gate = self.gates[index]
        threshold = np.inf if gate.pfa is None else nis_threshold(gate.pfa, len(used.z))
        nis = found.nis.tolist()
        rejecting = [i for i, one in enumerate(nis) if not (one <= threshold and one < np.inf)]
        # one statistic is reported with its innovation: the first filter's, unless another one alone rejects
        by = max(rejecting, key=nis.__getitem__) if rejecting and 0 not in rejecting else 0
        statistic, passed, held, alarm = nis[by], not rejecting, False, False
        if noise is not None:
            noise.learn(found.z[0], reported.R)
        if gate.test is not None:
            passed, held, alarm = self._further(index, gate, found, threshold, passed)
        return Verdict(
            statistic, threshold, passed, False, held, alarm, used, found.z[by], found.sigma[by], found.standardized[by], found.information
        )

    @abstractmethod
    def take(self, index: int, verdict: Verdict, use: bool = True) -> bool:
        """Fuse a measurement that was judged, if it passed and may be used; whether it was."""

    @abstractmethod
    def add(self, measurement: Measurement) -> None:
        """Fuse what is not an aid's and not judged, such as the known mean height, in every filter that is to know it."""

    def close(self) -> list[Replaced]:
        """End of the epoch: fuse local filters, look at what the solutions say of each other; aids whose share in the master was taken out."""
        return []

    def epoch(self, Phi: Array, Qd: Array, aids: Sequence[Measurement | None]) -> list[Verdict | None]:
        """Advance to the next epoch and take in what was measured there.

        Parameters
        ----------
        Phi, Qd : (n, n), transition and process noise since the last epoch
        aids : one measurement of each aid, None where there is none

        Returns
        -------
        one verdict for each measurement, all against the prediction; nothing depends on the order of the aids but their numbers
        """
        self.predict(Phi, Qd)
        verdicts: list[Verdict | None] = []
        for index, measurement in enumerate(aids):
            if measurement is None:
                self.gap(index)
            verdicts.append(None if measurement is None else self.judge(index, measurement))
        for index, verdict in enumerate(verdicts):
            if verdict is not None:
                verdicts[index] = verdict._replace(fused=self.take(index, verdict))
        self.close()
        return verdicts

    def gap(self, index: int) -> None:
        """A measurement of an aid is missing."""
        noise = self._noise[index]
        if noise is not None:
            noise.gap()

    def separated(self, index: int) -> bool:
        """An aid is kept out since its leave-one-out master took the place of the master."""
        return False

    def watched(self, index: int) -> Watched:
        """How far the solution without an aid is from the master."""
        return Watched(0.0, 0.0)

    def protection(self, integrity_risk: float) -> tuple[float, float]:
        """Protection level of the horizontal position [m] and of the heading [rad]; here of noise alone, since no solution tells of a fault."""
        quantile = quantiles(0.5, integrity_risk, 1)[1]
        heading = -1 if self.layout.heading is None else int(self.layout.heading)
        level = protection_levels(self._stack.X, self._stack.P, np.empty(0, np.int64), np.array(self.layout.position), heading, quantile, quantile)
        return float(level[0]), float(level[1])

    def shift(self, dx: Array) -> None:
        """Subtract dx (n,): it has been fed back into the nominal state."""
        self._stack.X -= dx

    def clone(self) -> Structure:
        """A copy that goes on independently."""
        other = copy.copy(self)
        other._stack = copy.copy(self._stack)
        other._stack.X, other._stack.P = self._stack.X.copy(), self._stack.P.copy()
        other.restore(self.snapshot())
        return other

    def snapshot(self) -> tuple[Any, ...]:
        """All that `restore` needs."""
        tests = tuple(test.clone() if test else None for test in self._tests)
        return self._stack.snapshot(), tests, tuple(self._held), tuple(noise.clone() if noise else None for noise in self._noise), self.beta

    def restore(self, snapshot: tuple[Any, ...]) -> None:
        """Go back to a snapshot, which stays usable."""
        stack, tests, held, noise, self.beta = snapshot
        self._stack.restore(stack)
        self._tests = [test.clone() if test else None for test in tests]
        self._held = list(held)
        self._noise = [one.clone() if one else None for one in noise]

    @abstractmethod
    def _judges(self, index: int) -> Rows:
        """Filters that a measurement of an aid is judged by, the one whose word is reported first."""

    def _further(self, index: int, gate: Gate, found: Innovations, threshold: float, passed: bool) -> tuple[bool, bool, bool]:
        """Whether it passes the further test as well, is only held, or alarms."""
        test = self._tests[index]
        if test is None and gate.test is not None:
            test = self._tests[index] = gate.test(found.z.shape[1])
        assert test is not None
        if self._held[index]:
            self._held[index] -= 1
            return False, passed, False
        if test.step(found.standardized[0]).alarm:
            self._held[index] = gate.hold
            test.reset()
            return False, False, bool(found.nis[0] <= threshold)
        return passed, False, False


def contiguous(measurement: Measurement) -> Measurement:
    """The measurement as the kernels take it."""
    return Measurement(
        np.ascontiguousarray(measurement.z, dtype=np.float64),
        np.ascontiguousarray(measurement.H, dtype=np.float64),
        np.ascontiguousarray(measurement.R, dtype=np.float64),
    )


class FederatedFilter(Structure):
    """Local filters, one for each aid, and a master that fuses them (Carlson 1990); the retention says how much of itself a local filter keeps.

    Parameters
    ----------
    x0, P0 : (n,), (n, n)
    n_aids : local filters
    retention : alpha of 002 figure 4. 0: fusion-reset. 1: no-reset. Between: after each fusion a local filter keeps alpha of its information and
        gets (1 - alpha) beta of the fused one, so that the sum stays what was fused: none is made, none lost
    beta : (n_aids,), shares; None: equal. With `common` (n_aids + 1,)
    sharing : "fixed", "trace" or "innovation": the last two change the shares at every fusion
    common : one more local filter, for what is not an aid's
    layout, gate, adaptive : as in `Structure`

    Notes
    -----
    Local filters begin with P0 / beta and carry the process noise Q / beta. Fusion-reset equals the centralized filter for any shares, constant or
    not (the tests hold it to that); no-reset is an upper bound that loses a few per cent and keeps a fault in one local filter. Zero-reset, in which
    the local filters send what they gained and begin again without information, is the information form and not offered twice.
    """

    def __init__(
        self, x0: Array, P0: Array, n_aids: int, *, retention: float = 0.0, beta: Array | None = None, sharing: str = "fixed", common: bool = False,
        layout: Layout = _LAYOUT, gate: Gate | Sequence[Gate] = _GATE, adaptive: bool | Sequence[bool] = False,
    ) -> None:  # fmt: skip
        locals_ = n_aids + common
        super().__init__(x0, P0, locals_ + 1, n_aids, layout, gate, adaptive)
        if not 0.0 <= retention <= 1.0:
            raise ValueError(f"the retention must be in [0, 1], not {retention}")
        if sharing not in ("fixed", "trace", "innovation"):
            raise ValueError(f"the sharing must be fixed, trace or innovation, not {sharing!r}")
        self.retention, self.sharing = retention, sharing
        self.beta = equal_shares(locals_) if beta is None else checked_shares(beta)
        if len(self.beta) != locals_:
            raise ValueError(f"{locals_} local filters need as many shares, not {len(self.beta)}")
        self._stack.P[1:] /= self.beta[:, None, None]
        self._traces = np.ones((2, locals_))  # of the innovations: expected, found
        self._news = False

    @property
    def local(self) -> list[Estimate]:
        """The local filters."""
        return [self._stack[1 + i] for i in range(len(self.beta))]

    def predict(self, Phi: Array, Qd: Array) -> None:
        """As in `Structure`."""
        self._stack.predict(Phi, Qd, np.append(1.0, 1.0 / self.beta))

    def take(self, index: int, verdict: Verdict, use: bool = True) -> bool:
        """As in `Structure`; into the local filter of the aid."""
        self._count(index, verdict.measurement)
        if not (use and verdict.passed):
            return False
        self._into(index, verdict.measurement)
        return True

    def add(self, measurement: Measurement) -> None:
        """As in `Structure`; into the local filter for it."""
        if len(self.beta) == len(self.gates):
            raise ValueError("there is no local filter for what is not an aid's")
        self._into(len(self.gates), contiguous(measurement))

    def close(self) -> list[Replaced]:
        """As in `Structure`."""
        if self.retention or self._news:
            self._fuse()
        return []

    def clone(self) -> FederatedFilter:
        """As in `Structure`."""
        other = super().clone()
        assert isinstance(other, FederatedFilter)
        return other

    def snapshot(self) -> tuple[Any, ...]:
        """As in `Structure`."""
        return super().snapshot(), self._traces.copy()

    def restore(self, snapshot: tuple[Any, ...]) -> None:
        """As in `Structure`."""
        common, traces = snapshot
        super().restore(common)
        self._traces = traces.copy()

    def _judges(self, index: int) -> Rows:
        """The fused filter in fusion-reset, the local filter of the aid otherwise."""
        return np.array([1 + index if self.retention else 0])

    def _into(self, index: int, measurement: Measurement) -> None:
        self._stack.update(np.array([1 + index]), measurement.z, measurement.H, measurement.R)
        self._news = True

    def _fuse(self) -> None:
        self._news = False
        X, P = self._stack.X, self._stack.P
        scale = np.sqrt(np.diag(P[0]))  # states differ by many powers of ten: unit diagonal; a state without variance stays as it is
        on = np.flatnonzero(scale > 0.0)
        cut, scale = np.ix_(on, on), scale[on]
        informations = [np.linalg.inv(one.P[cut] / np.outer(scale, scale)) for one in self.local]
        vectors = [Y @ (one.x[on] / scale) for Y, one in zip(informations, self.local, strict=True)]
        Y, y = np.sum(informations, axis=0), np.sum(vectors, axis=0)
        fused = np.linalg.inv(Y)
        P[0] = 0.0
        P[0][cut] = 0.5 * (fused + fused.T) * np.outer(scale, scale)
        X[0] = 0.0
        X[0, on] = fused @ y * scale
        if self.sharing == "trace":
            self.beta = trace_shares([np.linalg.inv(one) for one in informations])
        elif self.sharing == "innovation":
            self.beta = innovation_shares(*self._traces)
        for i, local in enumerate(self.local):
            if self.retention == 0.0:
                local.x[:], local.P[:] = X[0], P[0] / self.beta[i]
            elif self.retention < 1.0:
                share = (1.0 - self.retention) * self.beta[i]
                kept = np.linalg.inv(self.retention * informations[i] + share * Y)
                local.x[on] = kept @ (self.retention * vectors[i] + share * y) * scale
                local.P[cut] = 0.5 * (kept + kept.T) * np.outer(scale, scale)

    def _count(self, index: int, measurement: Measurement) -> None:
        """Traces of the innovation covariance, expected and found, over the last twenty epochs or so."""
        if self.sharing == "innovation":
            innovation = measurement.z - measurement.H @ self.x
            unit = np.trace(measurement.R)
            expected = np.trace(measurement.H @ self.P @ measurement.H.T) / unit + 1.0
            self._traces[:, index] += 0.05 * (np.array([expected, min(float(innovation @ innovation) / unit, 1e6)]) - self._traces[:, index])
