"""Fault tests on the innovations of one aid, behind one interface: NIS, improved chi-square, averaged innovation, MEWMA, CUSUM, windowed GLR.

Lives here: the tests as objects with a small state that can be copied, fed one innovation or a block at a time, with the same answers bit for bit.
Does not live here: thresholds from the mean time between false alarms (innovation_thresholds), tests on the state (eraim), what follows (health).
"""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike, NDArray

from riins_core.jit import jit
from riins_fdi.innovation import nis_threshold
from riins_fdi.innovation_thresholds import averaged_threshold, improved_threshold, mewma_threshold
from riins_fdi.run_length import cusum_threshold, window_lengths

Array = NDArray[np.float64]

_REBASE = 4096
"""Innovations after which running sums are counted from zero again, so that they keep their digits over a voyage."""


class InnovationVerdict(NamedTuple):
    """What a test says of one innovation; it alarms when the statistic exceeds the threshold, or is not finite."""

    statistic: float
    threshold: float
    alarm: bool


class InnovationTest(ABC):
    """A test on the innovations of one aid, taken as white: where the filter does not model a correlated error, the tests that average collapse.

    Parameters
    ----------
    dof : components of the innovation
    threshold : of the statistic
    restart : begin anew after an alarm
    """

    def __init__(self, dof: int, threshold: float, restart: bool) -> None:
        if dof < 1:
            raise ValueError(f"the test needs at least one degree of freedom, not {dof}")
        self.dof = dof
        self.threshold = threshold
        self.restart = restart
        self._state: tuple[Any, ...] = ()  # arrays, of floats or counts

    def step(self, innovation: ArrayLike, S: ArrayLike | None = None) -> InnovationVerdict:
        """Judge one innovation.

        Parameters
        ----------
        innovation : (dof,), measured - predicted; standardized where S is None
        S : (dof, dof), its covariance

        Returns
        -------
        the verdict; an innovation that is not finite is an alarm and leaves the state alone

        Raises
        ------
        ValueError
            Another size than dof; S is not positive definite.
        """
        u = np.asarray(innovation, dtype=np.float64)
        if S is not None and np.isfinite(u).all():
            try:
                u = scipy.linalg.solve_triangular(np.linalg.cholesky(np.asarray(S, dtype=np.float64)), u, lower=True)
            except np.linalg.LinAlgError as error:
                raise ValueError("the innovation covariance is not positive definite") from error
        statistic, alarm = self.process(u[None, :])
        return InnovationVerdict(float(statistic[0]), self.threshold, bool(alarm[0]))

    def process(self, standardized: ArrayLike) -> tuple[Array, NDArray[np.bool_]]:
        """Judge a block of standardized innovations (n, dof): statistic (n,) and alarm (n,); how they are cut into blocks changes nothing."""
        u = np.ascontiguousarray(standardized, dtype=np.float64)
        if u.ndim != 2 or u.shape[1] != self.dof:
            raise ValueError(f"innovations of {self.dof} components are needed, not shape {u.shape}")
        statistic, alarm = np.empty(len(u)), np.empty(len(u), dtype=np.bool_)
        self._run(u, statistic, alarm)
        return statistic, alarm

    def reset(self) -> None:
        """Forget what was fed."""
        for part in self._state:
            part[...] = 0

    def clone(self) -> InnovationTest:
        """A copy that goes on independently."""
        other = copy.copy(self)
        other._state = tuple(part.copy() for part in self._state)
        return other

    @abstractmethod
    def _run(self, u: Array, statistic: Array, alarm: NDArray[np.bool_]) -> None:
        """Feed whitened innovations; statistic and alarm of each epoch are written."""


class Nis(InnovationTest):
    """Normalized innovation squared of one epoch: the chi-square test, and the global test of 002's ERAIM (see eraim).

    Parameters
    ----------
    dof : components of the innovation
    epochs : mean number of epochs between false alarms
    threshold : instead of the one that `epochs` gives
    """

    def __init__(self, dof: int, epochs: float = 1e5, *, threshold: float | None = None) -> None:
        super().__init__(dof, nis_threshold(1.0 / epochs, dof) if threshold is None else threshold, True)

    def _run(self, u: Array, statistic: Array, alarm: NDArray[np.bool_]) -> None:
        statistic[:] = 0.0
        for i in range(self.dof):  # component by component: the order of addition is not the block's
            statistic += u[:, i] ** 2
        statistic[np.isnan(statistic)] = np.inf
        alarm[:] = statistic > self.threshold


@jit
def _improved(
    u: Array, membership: Array, relief: float, threshold: float, restart: bool,
    previous: Array, largest: Array, counts: NDArray[np.int64], statistic: Array, alarm: NDArray[np.bool_],
) -> None:  # fmt: skip
    """`previous` (dof,) innovation, `largest` (N,) ring of eigenvalues, `counts` = [innovations since the start]."""
    kept = largest.shape[0]
    for k in range(u.shape[0]):
        aa, ab, bb = 0.0, 0.0, 0.0
        for i in range(u.shape[1]):
            aa += previous[i] * previous[i]
            ab += previous[i] * u[k, i]
            bb += u[k, i] * u[k, i]
        if not np.isfinite(bb):
            statistic[k], alarm[k] = np.inf, True
            continue
        previous[:] = u[k]
        counts[0] += 1
        statistic[k], alarm[k] = 0.0, False
        if counts[0] < 2:
            continue
        largest[counts[0] % kept] = 0.5 * (aa + bb) + np.sqrt(0.25 * (aa - bb) ** 2 + ab * ab)
        if counts[0] < kept + 1:
            continue
        mean, mu = 0.0, 0.0
        for value in largest:
            mean += value
            mu += min(max((value - membership[0]) / (membership[1] - membership[0]), 0.0), 1.0)
        statistic[k] = mean / kept / (1.0 - relief * mu / kept)
        alarm[k] = statistic[k] > threshold
        if alarm[k] and restart:
            counts[0] = 0


class ImprovedChiSquare(InnovationTest):
    """The improved chi-square test of 004: largest eigenvalue of the residual matrix, fuzzy threshold.

    Parameters
    ----------
    dof, epochs, threshold : as in `Nis`
    restart : begin anew after an alarm

    Notes
    -----
    R_k = [u_(k-1) u_k]', H = R'R (004 (17)-(18), n = 2), mean of its last N = 3 largest eigenvalues (004 (20)). The seed lost the fuzzy rule; as in
    errata.md T_eff = T (1 - 0.4 mu), mu the mean membership of the eigenvalues between 10 and 25. It is the statistic that is divided here, which
    is the same and leaves one threshold. 004 calls the statistic chi-square with m degrees of freedom; it is not: the threshold is calibrated.
    """

    kept = 3
    membership = (10.0, 25.0)
    relief = 0.4

    def __init__(self, dof: int, epochs: float = 1e5, *, restart: bool = True, threshold: float | None = None) -> None:
        if threshold is None:
            threshold = improved_threshold(epochs, dof, self.kept, self.membership, self.relief)
        super().__init__(dof, threshold, restart)
        self._state = (np.zeros(dof), np.zeros(self.kept), np.zeros(1, dtype=np.int64))

    def _run(self, u: Array, statistic: Array, alarm: NDArray[np.bool_]) -> None:
        previous, largest, counts = self._state
        _improved(u, np.array(self.membership), self.relief, self.threshold, self.restart, previous, largest, counts, statistic, alarm)


@jit
def _windowed(
    u: Array, lengths: NDArray[np.int64], threshold: float, restart: bool,
    sums: Array, counts: NDArray[np.int64], statistic: Array, alarm: NDArray[np.bool_],
) -> None:  # fmt: skip
    """`sums` (W + 1, dof) is a ring of running sums, `counts` = [innovations since the start]."""
    size, dof = sums.shape
    for k in range(u.shape[0]):
        finite = True
        for i in range(dof):
            finite = finite and np.isfinite(u[k, i])
        if not finite:
            statistic[k], alarm[k] = np.inf, True
            continue
        previous, now = counts[0] % size, (counts[0] + 1) % size
        for i in range(dof):
            sums[now, i] = sums[previous, i] + u[k, i]
        counts[0] += 1
        best = 0.0
        for length in lengths:
            if length > counts[0]:
                break
            then = (now - length) % size
            s = 0.0
            for i in range(dof):
                s += (sums[now, i] - sums[then, i]) ** 2
            best = max(best, s / length)
        statistic[k] = best
        alarm[k] = best > threshold
        if alarm[k] and restart:
            counts[0] = 0
            sums[:, :] = 0.0
        elif counts[0] % (_REBASE * size) == 0:  # a multiple of the ring, so that its places stay
            for i in range(dof):
                s = sums[now, i]
                for row in range(size):
                    sums[row, i] -= s


class WindowedInnovationGlr(InnovationTest):
    """Generalized likelihood ratio of a constant shift since 1 .. window epochs: max over w of |sum of the last w|^2 / w (Willsky and Jones 1976).

    Parameters
    ----------
    dof, epochs, threshold : as in `Nis`
    window : longest time a shift is looked for, epochs
    dense : test every length, otherwise about six an octave
    restart : begin anew after an alarm
    """

    def __init__(
        self, dof: int, epochs: float = 1e5, window: int = 60, *, dense: bool = False, restart: bool = True, threshold: float | None = None
    ) -> None:
        lengths = window_lengths(window, dense)
        super().__init__(dof, averaged_threshold(epochs, dof, lengths) if threshold is None else threshold, restart)
        self.lengths = lengths
        self._state = (np.zeros((int(lengths[-1]) + 1, dof)), np.zeros(1, dtype=np.int64))

    def _run(self, u: Array, statistic: Array, alarm: NDArray[np.bool_]) -> None:
        sums, counts = self._state
        _windowed(u, self.lengths, self.threshold, self.restart, sums, counts, statistic, alarm)


class AveragedInnovation(WindowedInnovationGlr):
    """Averaged innovation (AIME, Diesel and Luu 1995): the mean of the last `window` innovations, weighted, against its covariance.

    Parameters
    ----------
    dof, epochs, restart, threshold : as in `WindowedInnovationGlr`
    window : epochs averaged; nothing is said before so many were fed
    """

    def __init__(self, dof: int, epochs: float = 1e5, window: int = 20, *, restart: bool = True, threshold: float | None = None) -> None:
        lengths = np.array([window], dtype=np.int64)
        super().__init__(dof, epochs, window, restart=restart, threshold=averaged_threshold(epochs, dof, lengths) if threshold is None else threshold)
        self.lengths = lengths


@jit
def _mewma(
    u: Array, weight: float, threshold: float, restart: bool, mean: Array, statistic: Array, alarm: NDArray[np.bool_],
) -> None:  # fmt: skip
    for k in range(u.shape[0]):
        s = 0.0
        for i in range(u.shape[1]):
            s += u[k, i] * u[k, i]
        if not np.isfinite(s):
            statistic[k], alarm[k] = np.inf, True
            continue
        s = 0.0
        for i in range(u.shape[1]):
            mean[i] = weight * u[k, i] + (1.0 - weight) * mean[i]
            s += mean[i] * mean[i]
        statistic[k] = s * (2.0 - weight) / weight
        alarm[k] = statistic[k] > threshold
        if alarm[k] and restart:
            mean[:] = 0.0


class Mewma(InnovationTest):
    """Multivariate exponentially weighted moving average (Lowry et al. 1992), with the covariance it settles at.

    Parameters
    ----------
    dof, epochs, threshold : as in `Nis`
    weight : of the newest innovation, 0 < weight <= 1
    restart : begin anew after an alarm
    """

    def __init__(self, dof: int, epochs: float = 1e5, weight: float = 0.1, *, restart: bool = True, threshold: float | None = None) -> None:
        if not 0.0 < weight <= 1.0:
            raise ValueError(f"the weight of the newest innovation must be in (0, 1], not {weight}")
        super().__init__(dof, mewma_threshold(epochs, dof, weight) if threshold is None else threshold, restart)
        self.weight = weight
        self._state = (np.zeros(dof),)

    def _run(self, u: Array, statistic: Array, alarm: NDArray[np.bool_]) -> None:
        (mean,) = self._state
        _mewma(u, self.weight, self.threshold, self.restart, mean, statistic, alarm)


@jit
def _cusum(
    u: Array, reference: float, threshold: float, restart: bool, g: Array, statistic: Array, alarm: NDArray[np.bool_],
) -> None:  # fmt: skip
    for k in range(u.shape[0]):
        best = 0.0
        for i in range(u.shape[1]):
            if not np.isfinite(u[k, i]):
                best = np.inf
        if best == 0.0:
            for i in range(u.shape[1]):
                g[i, 0] = max(0.0, g[i, 0] + u[k, i] - reference)
                g[i, 1] = max(0.0, g[i, 1] - u[k, i] - reference)
                best = max(best, g[i, 0], g[i, 1])
        statistic[k] = best
        alarm[k] = best > threshold
        if alarm[k] and restart and best < np.inf:
            g[:] = 0.0


class InnovationCusum(InnovationTest):
    """Cumulative sums of each component, one up and one down (Page 1954).

    Parameters
    ----------
    dof, epochs, threshold : as in `Nis`
    shift : of a standardized component that the sums are made for
    restart : begin anew after an alarm
    """

    def __init__(self, dof: int, epochs: float = 1e5, shift: float = 1.0, *, restart: bool = True, threshold: float | None = None) -> None:
        if not shift > 0.0:
            raise ValueError("the shift must be positive")
        super().__init__(dof, cusum_threshold(epochs, 0.5 * shift, 2 * dof) if threshold is None else threshold, restart)
        self.reference = 0.5 * shift
        self._state = (np.zeros((dof, 2)),)

    def _run(self, u: Array, statistic: Array, alarm: NDArray[np.bool_]) -> None:
        (g,) = self._state
        _cusum(u, self.reference, self.threshold, self.restart, g, statistic, alarm)


INNOVATION_TESTS: dict[str, Callable[..., InnovationTest]] = {
    "nis": Nis,
    "improved": ImprovedChiSquare,
    "averaged": AveragedInnovation,
    "mewma": Mewma,
    "cusum": InnovationCusum,
    "windowed_glr": WindowedInnovationGlr,
}
"""The tests by name; each takes (dof, epochs between false alarms)."""
