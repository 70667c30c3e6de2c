"""Information form with leave-one-out masters and separation of solutions: the structure that measured best.

Lives here: `SeparatedMasters`: one exact filter for all aids and one for each set that leaves some out, isolation by their separation, re-admission.
Does not live here: the tests (riins_fdi.eraim), what structures share (structures.py), any navigation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from riins_fdi.eraim import Separation, protection_level, solution_separation

from .aiding import Measurement
from .structures import Estimate, Gate, Structure, Verdict
from .types import Array


@dataclass(frozen=True)
class SeparationSettings:
    """How an aid is isolated by the separation of solutions, and taken in again.

    Attributes
    ----------
    rows : states compared, the horizontal position
    navigation : states compared as well, position, velocity and attitude: they tell which aid it is, and find it sooner; none: only `rows`
    pfa : of one test: 1e-5 is a threshold of 23.0 with two degrees of freedom, 3e-7 one of 30
    margin : by which what is still parted without the aid to blame must be below that without any other: 10 is a likelihood of 150 to 1
    confirm_after, confirm_pfa : an aid that has failed so many NIS tests in a row is tested with this pfa: what it put in before goes too
    worst : an aid is not isolated when the sigma of `rows` would grow by more than this factor: without the last position there is only its gate
    left_out : masters for every set that leaves out up to so many aids: 0 the plain information form without this test, 1 leave-one-out masters.
        With 2, another aid may fail too and its leave-one-out master is still one that never saw the first
    readmit_after : consecutive epochs that an isolated aid must pass its NIS
    readmit_p : probability that a good aid fails the test at their end and begins again
    """

    rows: tuple[int, ...] = (0, 1)
    navigation: tuple[int, ...] = ()
    pfa: float = 1e-5
    margin: float = 10.0
    confirm_after: int = 3
    confirm_pfa: float = 1e-2
    worst: float = 10.0
    left_out: int = 2
    readmit_after: int = 30
    readmit_p: float = 0.1


class SeparatedMasters(Structure):
    """Subfilters send information increments, in their factors (z, H, R); each master is the exact filter of the aids it takes.

    Parameters
    ----------
    x0, P0 : (n,), (n, n)
    n_aids : aids
    settings : SeparationSettings
    gate, adaptive : as in `Structure`

    Attributes
    ----------
    isolated : of each aid, since it was found by separation
    separation : of each aid's leave-one-out master from the master, at the last epoch

    Notes
    -----
    A measurement is judged by the master and by the leave-one-out master of its aid, and fused by all masters that take the aid, or by none:
    only then is P_loo - P_all the covariance of the difference.
    A faulty aid parts the solutions without the others too. To blame is the one without which the least is parted among the rest, as the masters
    that leave out two tell (with `left_out` 1: the one that is parted most). Every master that took it is replaced by the one without it, whose
    history never saw it.
    Where that one is not kept (`left_out` too small) the smallest set that is kept and does not hold the aid takes its place: a compromise,
    since it has seen an aid that it should leave out, and the two can only part again by what comes later.
    An isolated aid is fused by a candidate beside the master for `readmit_after` epochs; it is taken in again if the two have not parted, which
    counts the errors that successive innovations share, as a mean of innovations would not.
    """

    def __init__(
        self, x0: Array, P0: Array, n_aids: int, settings: SeparationSettings = SeparationSettings(), *,
        gate: Gate = Gate(), adaptive: bool = False,  # noqa: B008
    ) -> None:  # fmt: skip
        super().__init__(n_aids, gate, adaptive)
        self.settings = settings
        self._all = (1 << n_aids) - 1
        sets = (s for s in range(self._all + 1) if n_aids - s.bit_count() <= settings.left_out)
        self._masters = {s: Estimate(x0, P0) for s in sorted(sets, key=lambda s: (-s.bit_count(), s))}
        self.isolated = [False] * n_aids
        self.separation: list[Separation | None] = [None] * n_aids
        self._candidate: list[Estimate | None] = [None] * n_aids
        self._good = [0] * n_aids
        self._failed = [0] * n_aids

    @property
    def x(self) -> Array:
        """State of the master (n,)."""
        return self._masters[self._all].x

    @property
    def P(self) -> Array:
        """Its covariance (n, n)."""
        return self._masters[self._all].P

    def without(self, index: int) -> Estimate:
        """The leave-one-out master of an aid; KeyError where none is kept."""
        return self._masters[self._all & ~(1 << index)]

    def protection(self, integrity_risk: float) -> float:
        """Horizontal protection level [m] over the aids in use; infinite where none is tested."""
        levels = [
            protection_level(found, self._part(self.without(i).P), integrity_risk)
            for i, found in enumerate(self.separation)
            if found is not None and not self.isolated[i]
        ]
        return max(levels, default=np.inf)

    def epoch(self, Phi: Array, Qd: Array, aids: Sequence[Measurement | None]) -> list[Verdict | None]:
        """As in `Structure`; the verdict is the master's."""
        for one in (*self._masters.values(), *(c for c in self._candidate if c is not None)):
            one.predict(Phi, Qd)
        present = self._present(aids)
        verdicts: list[Verdict | None] = [
            None if r is None or m is None else self._verdict(i, r, m) for i, (r, m) in enumerate(zip(aids, present, strict=True))
        ]
        for i, (verdict, measurement) in enumerate(zip(verdicts, present, strict=True)):
            if verdict is not None and measurement is not None and verdict.fused:
                for s, master in self._masters.items():
                    if s >> i & 1:
                        master.update(measurement)
        if self.settings.left_out:
            self._readmit(present, verdicts)
            self._separate()
        return verdicts

    def shift(self, dx: Array) -> None:
        """As in `Structure`."""
        for one in (*self._masters.values(), *(c for c in self._candidate if c is not None)):
            one.x -= dx

    def clone(self) -> SeparatedMasters:
        """As in `Structure`."""
        other = super().clone()
        assert isinstance(other, SeparatedMasters)
        other._masters = {s: one.copy() for s, one in self._masters.items()}
        other._candidate = [c.copy() if c is not None else None for c in self._candidate]
        other.isolated, other.separation, other._good = self.isolated.copy(), self.separation.copy(), self._good.copy()
        other._failed = self._failed.copy()
        return other

    def _verdict(self, index: int, reported: Measurement, measurement: Measurement) -> Verdict:
        """Judge by the master and by the leave-one-out master of the aid."""
        statistic, threshold, passed, held = self._judge(index, reported, measurement, self._masters[self._all])
        if self.settings.left_out:
            other = self.without(index).nis(measurement)[0]
            statistic, passed, held = max(statistic, other), passed and other <= threshold, held and other <= threshold
        self._failed[index] = 0 if passed else self._failed[index] + 1
        return Verdict(statistic, threshold, passed, passed and not self.isolated[index], held)

    def _part(self, matrix: Array) -> Array:
        rows = list(self.settings.rows)
        return matrix[np.ix_(rows, rows)]

    def _against(self, one: Estimate, other: Estimate, pfa: float, rows: tuple[int, ...]) -> Separation:
        part = np.array(rows)
        cut = part[:, None], part
        return solution_separation(one.x[part], one.P[cut], other.x[part], other.P[cut], pfa)

    def _separate(self) -> None:
        """Test every aid in use, and isolate the one to blame; then the rest anew."""
        master, states = self._masters[self._all], self.settings.navigation or self.settings.rows
        while True:
            using = [i for i, isolated in enumerate(self.isolated) if not isolated]
            found = {i: self._against(master, self.without(i), self._pfa(i), self.settings.rows) for i in using}
            whole = {i: self._against(master, self.without(i), self._pfa(i), states) for i in using} if self.settings.navigation else found
            self.separation = [found.get(i) for i in range(len(self.isolated))]
            alarms = [i for i in using if found[i].alarm or whole[i].alarm]
            if not alarms:
                return
            left = {i: -np.inf if self._failing(i) else self._left(i, using, states) for i in using}
            blamed = min(using, key=lambda i: (left[i], -whole[i].statistic))
            doubt = self.settings.left_out > 1 and any(left[i] < left[blamed] + self.settings.margin for i in using if i != blamed)
            if blamed not in alarms or doubt or not self._bearable(blamed):
                return  # a fault parts other aids' solutions too: wait until it is plain whose it is
            self._isolate(blamed)
            master = self._masters[self._all]

    def _bearable(self, index: int) -> bool:
        """The leave-one-out master still knows where it is: it may take the master's place."""
        return bool(np.linalg.eigvalsh(self._part(self.without(index).P))[-1] <= self.settings.worst**2 * np.linalg.eigvalsh(self._part(self.P))[-1])

    def _failing(self, index: int) -> bool:
        return self._failed[index] >= self.settings.confirm_after

    def _pfa(self, index: int) -> float:
        return self.settings.confirm_pfa if self._failing(index) else self.settings.pfa

    def _left(self, index: int, using: Sequence[int], states: tuple[int, ...]) -> float:
        """What is still parted among the other aids when this one is left out; 0 where no masters are kept that could tell."""
        without = self._all & ~(1 << index)
        pairs = [without & ~(1 << j) for j in using if j != index]
        return max((self._against(self._masters[without], self._masters[s], 0.5, states).statistic for s in pairs if s in self._masters), default=0.0)

    def _isolate(self, index: int) -> None:
        bit = 1 << index
        for s in [s for s in self._masters if s & bit]:
            kept = min((k for k in self._masters if not k & bit and k & s == s & ~bit), key=int.bit_count)
            self._masters[s] = self._masters[kept].copy()
        self.isolated[index], self._candidate[index], self._good[index] = True, None, 0
        self._candidate = [None] * len(self._candidate)  # they too may have seen it
        self._good = [0] * len(self._good)

    def _readmit(self, present: Sequence[Measurement | None], verdicts: Sequence[Verdict | None]) -> None:
        """Step the candidates of isolated aids."""
        master = self._masters[self._all]
        for i, isolated in enumerate(self.isolated):
            verdict = verdicts[i]
            if not isolated or verdict is None:
                continue
            if not verdict.passed:
                self._candidate[i], self._good[i] = None, 0
                continue
            candidate = self._candidate[i]
            if candidate is None:  # the master as it is now; from the next epoch on the aid makes the difference
                self._candidate[i], self._good[i] = master.copy(), 0
                continue
            for j, (measurement, other) in enumerate(zip(present, verdicts, strict=True)):
                if measurement is not None and other is not None and (other.fused or j == i):
                    candidate.update(measurement)
            self._good[i] += 1
            if self._good[i] >= self.settings.readmit_after:
                found = self._against(candidate, master, self.settings.readmit_p, self.settings.rows)
                if found.dof and not found.alarm:
                    self.isolated[i] = False
                self._candidate[i], self._good[i] = None, 0
