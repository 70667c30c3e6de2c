"""Information form with leave-one-out masters and separation of solutions: the structure that measured best.

Lives here: `SeparatedMasters`: one exact filter for all aids and one for each set that leaves some out, isolation by their separation, re-admission.
Does not live here: the tests (riins_fdi.eraim), what structures share (structures.py), any navigation.
"""

from __future__ import annotations

import copy
import functools
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from riins_fdi.eraim import largest_horizontal, protection_levels, quantiles, separation_into, separations_into
from riins_fdi.innovation import nis_threshold

from .aiding import Measurement
from .inertial_evidence import InertialEvidence
from .stacked import Estimate, Rows
from .structure_settings import SolutionSeparation
from .structures import Gate, Layout, Replaced, Structure, Verdict, Watched, contiguous
from .types import Array


class _Apart(NamedTuple):
    """Two solutions compared over some states."""

    statistic: float
    dof: int

    def threshold(self, pfa: float) -> float:
        """Of the chi-square; 0 where nothing can be tested."""
        return nis_threshold(pfa, self.dof) if self.dof else 0.0

    def alarm(self, pfa: float) -> bool:
        """It exceeds the threshold, or is not a number."""
        return self.dof > 0 and not self.statistic <= self.threshold(pfa)


_SETTINGS, _LAYOUT, _GATE = SolutionSeparation(), Layout(), Gate()
_UNWATCHED = Watched(0.0, 0.0)


class SeparatedMasters(Structure):
    """Subfilters send information increments, in their factors (z, H, R); each master is the exact filter of the aids it takes.

    Parameters
    ----------
    x0, P0 : (n,), (n, n)
    n_aids : aids
    settings : SolutionSeparation; `left_out` is no more than there are aids
    layout, gate, adaptive : as in `Structure`
    kinds : of each aid; aids of one kind may fail together, of one cause; none: each is its own

    Attributes
    ----------
    isolated : of each aid, since it was found by separation

    Notes
    -----
    A measurement is judged by the master and by the leave-one-out master of its aid, and fused by all masters that take the aid, or by none:
    only then is P_loo - P_all the covariance of the difference.
    A faulty aid parts the solutions without the others too. To blame is the one without which the least is parted among the rest, as the masters
    that leave out two tell (with `left_out` 1: the one that is parted most). Every master that took it is replaced by the one without it, whose
    history never saw it.
    Where that one is not kept (`left_out` too small) the smallest set that is kept and does not hold the aid takes its place: a compromise,
    since it has seen an aid that it should leave out, and the two can only part again by what comes later.
    An isolated aid is fused by a candidate beside the master for `readmit_after` measurements; it is taken in again if the two have not parted, which
    counts the errors that successive innovations share, as a mean of innovations would not.
    """

    def __init__(
        self, x0: Array, P0: Array, n_aids: int, settings: SolutionSeparation = _SETTINGS, *, layout: Layout = _LAYOUT,
        gate: Gate | Sequence[Gate] = _GATE, adaptive: bool | Sequence[bool] = False, kinds: Sequence[str] = (),
    ) -> None:  # fmt: skip
        self.settings = settings
        self.kinds = tuple(kinds) or tuple(f"{i}" for i in range(n_aids))
        everything = (1 << n_aids) - 1
        sets = (s for s in range(everything + 1) if n_aids - s.bit_count() <= settings.left_out)
        self._sets = sorted(sets, key=lambda s: (-s.bit_count(), s))
        self._row = {s: row for row, s in enumerate(self._sets)}
        masters = len(self._sets)
        super().__init__(x0, P0, masters + (n_aids if settings.left_out else 0), n_aids, layout, gate, adaptive)
        self._takes = [np.array([row for row, s in enumerate(self._sets) if s >> i & 1]) for i in range(n_aids)]
        self._without = [self._row.get(everything & ~(1 << i), -1) for i in range(n_aids)]
        self._by = [np.array([0, row] if row >= 0 else [0]) for row in self._without]
        self._slot = [masters + i for i in range(n_aids)]  # of the candidates
        self._scale = np.append(np.ones(masters), np.zeros(len(self._stack.X) - masters))
        self._states = np.array(layout.navigation or layout.position)
        self._position = np.array(layout.position)
        self._unseen = quantiles(settings.false_alarm_probability, 0.5, len(self._states))[0]
        # the IMU's word on each aid: by the master that takes it alone and the one that takes all others
        few = [r for r, s in enumerate(self._sets) if s.bit_count() in (1, n_aids - 1)]
        self._few = [np.array([r for r in few if self._sets[r] >> i & 1], np.int64) for i in range(n_aids)]
        self._alone = [self._row.get(1 << i, -1) for i in range(n_aids)]
        self._evidence = InertialEvidence(masters, n_aids, settings.evidence_memory)
        self.isolated = [False] * n_aids
        self._watched = [_UNWATCHED] * n_aids
        self._good = [0] * n_aids
        self._failed = [0] * n_aids
        self._heard: list[bool | None] = [None] * n_aids  # passed, failed, or nothing since the last close

    def without(self, index: int) -> Estimate:
        """The leave-one-out master of an aid; KeyError where none is kept."""
        if self._without[index] < 0:
            raise KeyError(index)
        return self._stack[self._without[index]]

    def predict(self, Phi: Array, Qd: Array) -> None:
        """As in `Structure`."""
        self._stack.predict(Phi, Qd, self._scale)

    def judge(self, index: int, measurement: Measurement) -> Verdict:
        """As in `Structure`: by the master and by the leave-one-out master of the aid."""
        verdict = super().judge(index, measurement)
        if len(self._few[index]):
            used = verdict.measurement
            self._evidence.learn(index, self._few[index], self._stack.judge(self._few[index], used.z, used.H, used.R).standardized)
        again = self._failed[index] + 1 if not verdict.alarm else max(self._failed[index] + 1, self.settings.confirm_after)
        self._failed[index] = 0 if verdict.passed else again
        return verdict

    def take(self, index: int, verdict: Verdict, use: bool = True) -> bool:
        """As in `Structure`; what an isolated aid measures goes to its candidate."""
        self._heard[index] = verdict.passed
        if not verdict.passed:
            return False
        z, H, R = verdict.measurement.z, verdict.measurement.H, verdict.measurement.R
        if self.isolated[index]:
            slot = self._slot[index]
            if self._scale[slot]:
                self._stack.update(np.array([slot]), z, H, R)
            return False
        if use:
            self._stack.update(self._with_candidates(self._takes[index]), z, H, R)
        return use

    def add(self, measurement: Measurement) -> None:
        """As in `Structure`: in every master."""
        z, H, R = contiguous(measurement)
        self._stack.update(np.flatnonzero(self._scale), z, H, R)

    def close(self) -> list[Replaced]:
        """As in `Structure`: step the candidates, and test every aid in use; where one is to blame, then the rest anew."""
        if not self.settings.left_out or all(heard is None for heard in self._heard):
            return []
        self._readmit()
        self._heard = [None] * len(self._heard)
        found = []
        while replaced := self._separate():
            found += replaced
        return found

    def separated(self, index: int) -> bool:
        """As in `Structure`."""
        return self.isolated[index]

    def watched(self, index: int) -> Watched:
        """As in `Structure`."""
        return self._watched[index]

    def protection(self, integrity_risk: float) -> tuple[float, float]:
        """As in `Structure`: of noise, and of a fault of any one aid that the separation does not show. A solution without the aid that holds the
        position alone is inertial, and the level as large as its error may be."""
        rows = [row for row, isolated in zip(self._without, self.isolated, strict=True) if row >= 0 and not isolated]
        quantile = quantiles(0.5, integrity_risk, 1)[1]
        heading = -1 if self.layout.heading is None else int(self.layout.heading)
        level = protection_levels(self._stack.X, self._stack.P, np.array(rows, np.int64), self._position, heading, self._unseen, quantile)
        return float(level[0]), float(level[1])

    def clone(self) -> SeparatedMasters:
        """As in `Structure`."""
        other = super().clone()
        assert isinstance(other, SeparatedMasters)
        other._evidence = copy.copy(self._evidence)
        other._evidence.restore(self._evidence.snapshot())
        return other

    def snapshot(self) -> tuple[Any, ...]:
        """As in `Structure`."""
        lists = tuple(self.isolated), tuple(self._watched), tuple(self._good), tuple(self._failed)
        return super().snapshot(), self._scale.copy(), self._evidence.snapshot(), lists

    def restore(self, snapshot: tuple[Any, ...]) -> None:
        """As in `Structure`."""
        common, scale, evidence, lists = snapshot
        super().restore(common)
        self._scale = scale.copy()
        self._evidence.restore(evidence)
        self.isolated, self._watched, self._good, self._failed = (list(part) for part in lists)
        self._heard = [None] * len(self.isolated)

    def _judges(self, index: int) -> Rows:
        return self._by[index]

    def _with_candidates(self, rows: Rows) -> Rows:
        if not any(self.isolated):
            return rows
        using = np.flatnonzero(self._scale[len(self._sets) :])
        return np.concatenate([rows, len(self._sets) + using])

    def _against(self, one: int, other: int, states: Rows) -> _Apart:
        X, P = self._stack.X, self._stack.P
        return _Apart(*separation_into(X[one], P[one], X[other], P[other], states, np.empty((len(states), len(states)))))

    def _apart(self, using: Sequence[int], states: Rows) -> dict[int, _Apart]:
        """The master against the leave-one-out master of each aid."""
        rows = np.array([self._without[i] for i in using], np.int64)
        statistic, dof = np.empty(len(rows)), np.empty(len(rows), np.int64)
        separations_into(self._stack.X, self._stack.P, rows, states, statistic, dof)
        return {i: _Apart(*one) for i, one in zip(using, zip(statistic.tolist(), dof.tolist(), strict=True), strict=True)}

    def _separate(self) -> list[Replaced]:
        """Test every aid in use, and isolate who is to blame."""
        using = [i for i, isolated in enumerate(self.isolated) if not isolated]
        both = len(self.layout.navigation) > 0
        found = self._apart(using, self._position)
        whole = self._apart(using, self._states) if both else found
        self._watched = [self._nearest(i, found[i], whole[i]) if i in found else _UNWATCHED for i in range(len(self.isolated))]
        alarms = [i for i in using if found[i].alarm(self._pfa(i)) or whole[i].alarm(self._pfa(i))]
        if not alarms or len(using) < 2:
            return []  # the last aid: nothing but its gate can tell
        left = {i: -np.inf if self._failing(i) else self._left(i, using) for i in using}
        blamed = min(using, key=lambda i: (left[i], -whole[i].statistic))
        doubt = self.settings.left_out > 1 and any(left[i] < left[blamed] + self.settings.margin for i in using if i != blamed)
        if blamed not in alarms or doubt:
            return []  # a fault parts other aids' solutions too: wait until it is plain whose it is
        bad = self._liars(blamed, [i for i in using if i != blamed])
        if not bad or not self._bearable(bad):
            return []
        made = []
        for index in bad:
            before, (statistic, threshold) = self.x.copy(), self._watched[index]
            self._isolate(index)
            made.append(Replaced(index, statistic, threshold, self.x - before))
        return made

    def _liars(self, blamed: int, rest: Sequence[int]) -> list[int]:
        """Whom to isolate when the vote is against one aid; nobody where the others may have one cause and nothing tells the two apart.

        One spoofer pulls every satellite receiver: their agreement is one voice, not a majority. The IMU decides, or that one of the kind has been
        found faulty before.
        """
        pfa = self.settings.evidence_false_alarm_probability
        kind, kinds = self.kinds[blamed], {self.kinds[i] for i in rest}
        if len(kinds) != 1 or kind in kinds:
            return [blamed]
        others = self._evidence.ratio(self._without[blamed], rest, pfa) > 1.0
        alone = self._alone[blamed]
        if alone >= 0 and self._evidence.ratio(alone, [blamed], pfa) > 1.0:
            return [blamed]
        known = {self.kinds[i] for i, isolated in enumerate(self.isolated) if isolated}
        if others or known & kinds:
            return list(rest)
        return [blamed] if kind in known else []

    def _nearest(self, index: int, *found: _Apart) -> Watched:
        pfa = self._pfa(index)
        seen = [Watched(one.statistic, one.threshold(pfa)) for one in found if one.dof]
        return max(seen, key=lambda w: w.statistic / w.threshold, default=_UNWATCHED)

    def _bearable(self, aids: Sequence[int]) -> bool:
        """The master without them still knows where it is: it may take the master's place."""
        left = functools.reduce(lambda s, i: s & ~(1 << i), aids, self._sets[0])
        if left not in self._row:
            return False
        a, b = self.layout.position
        one, other = (largest_horizontal(P[a, a], P[b, b], P[a, b]) for P in (self._stack[self._row[left]].P, self.P))
        return bool(one <= self.settings.worst**2 * other)

    def _failing(self, index: int) -> bool:
        return self._failed[index] >= self.settings.confirm_after

    def _pfa(self, index: int) -> float:
        return self.settings.confirm_false_alarm_probability if self._failing(index) else self.settings.false_alarm_probability

    def _left(self, index: int, using: Sequence[int]) -> float:
        """What is still parted among the other aids when this one is left out; 0 where no masters are kept that could tell."""
        without = self._sets[self._without[index]]
        pairs = [self._row.get(without & ~(1 << j)) for j in using if j != index]
        return max((self._against(self._without[index], row, self._states).statistic for row in pairs if row is not None), default=0.0)

    def _isolate(self, index: int) -> None:
        bit = 1 << index
        for row, s in enumerate(self._sets):
            if s & bit:
                kept = min((k for k in self._sets if not k & bit and k & s == s & ~bit), key=int.bit_count)
                self._stack.copy(self._row[kept], row)
                self._evidence.copy(self._row[kept], row)
        self.isolated[index] = True
        self._good = [0] * len(self._good)
        self._scale[len(self._sets) :] = 0.0  # no candidate goes on: they too may have seen it

    def _readmit(self) -> None:
        """Step the candidates of isolated aids."""
        for i, isolated in enumerate(self.isolated):
            heard, slot = self._heard[i], self._slot[i]
            if not isolated or heard is None:
                continue
            if not heard:
                self._scale[slot], self._good[i] = 0.0, 0
            elif not self._scale[slot]:  # the master as it is now; from the next measurement on the aid makes the difference
                self._stack.copy(0, slot)
                self._scale[slot], self._good[i] = 1.0, 0
            else:
                self._good[i] += 1
                if self._good[i] >= self.settings.readmit_after:
                    found = self._against(slot, 0, self._position)
                    self.isolated[i] = not found.dof or found.alarm(self.settings.readmit_false_alarm_probability)
                    self._scale[slot], self._good[i] = 0.0, 0
