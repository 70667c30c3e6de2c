"""Parity tests and least-squares estimators of the sets of sensors that have been in use, made once for each set.

Lives here: `TableCache`, which fills the arrays the kernel reads when a sensor leaves or returns.
Does not live here: the test itself (riins_fdi.parity), which set is in use (pipeline.py).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from riins_core.imu_array import ImuArray
from riins_fdi.parity import ParityTest, parity_test
from riins_imu_fusion.judges import SVD, equations, rows_needed
from riins_imu_fusion.state import Tables

Array = NDArray[np.float64]

_FIRST_SLOTS = 16
_MOST_SLOTS = 8192
_MOST_BYTES = 1 << 28
"""Beyond it (large arrays with random dropouts) the cache is emptied."""


class TableCache:
    """Tables by kind and set of sensors.

    Parameters
    ----------
    array : geometry of n sensors
    sigma : (2, n), white noise of a sample
    total : (2, n), noise and ordinary bias together
    pfa : false-alarm probability per sample and triad
    parity_test : number of the parity test

    Attributes
    ----------
    tables : arrays for the kernel; replaced when they grow, so take them anew after `add`
    sigma, total : (2, n), noise in force
    """

    def __init__(self, array: ImuArray, sigma: Array, total: Array, pfa: float, parity_test: int = 0) -> None:
        self._array, self._stated = array, (sigma, total)
        self.change(sigma, total, pfa, parity_test)

    def change(self, sigma: Array, total: Array, pfa: float, parity_test: int) -> None:
        """Begin anew with other noise, thresholds or another test; parameters as above."""
        self.sigma, self.total, self._pfa, self._parity_test = sigma, total, pfa, parity_test
        self._rows = rows_needed(parity_test, self._array)
        self._tests: list[dict[int, ParityTest]] = [{}, {}]
        self._covariance: list[dict[int, Array]] = [{}, {}]
        self.tables = self._empty(_FIRST_SLOTS)
        self._most = max(_FIRST_SLOTS, min(_MOST_SLOTS, _FIRST_SLOTS * _MOST_BYTES // sum(array.nbytes for array in self.tables)))

    def add_test(self, kind: int, mask: int) -> None:
        """Complete the table of the sensors in `mask` with what the parity test needs: not every set that is fused is tested."""
        t = self.tables
        slot = int(np.flatnonzero(t.key[kind, : t.filled[kind]] == np.uint64(mask))[0])
        rows, members, level = equations(self._parity_test, self._array, mask, self.total[kind], self._pfa)
        t.rows[kind, slot] = 0.0
        t.members[kind, slot] = 0
        t.rows[kind, slot, : len(rows)] = rows
        t.members[kind, slot, : len(rows)] = members
        t.level[kind, slot] = level

    def threshold(self, kind: int, mask: int) -> float:
        """Threshold of the parity test's statistic with the sensors in `mask`; NaN without redundancy."""
        test = self.test(kind, mask)
        if not self._rows or test.dof < 1:
            return test.threshold
        t = self.tables
        slots = np.flatnonzero(t.key[kind, : t.filled[kind]] == np.uint64(mask))
        return float(t.level[kind, slots[0]]) if slots.size and t.level[kind, slots[0]] > 0.0 else float("nan")

    def add(self, kind: int, mask: int) -> None:
        """Make the table of the sensors in `mask`; a set that does not span three axes gets dof = -1."""
        slots = self.tables.key.shape[1]
        if self.tables.filled[kind] == slots:
            if 2 * slots > self._most:
                self._tests[kind].clear()
                self._covariance[kind].clear()
                self.tables.filled[kind] = 0
            else:
                self._grow(2 * slots)
        t = self.tables
        slot = int(t.filled[kind])
        test = self.test(kind, mask)
        t.key[kind, slot] = np.uint64(mask)
        t.dof[kind, slot] = test.dof
        t.gain[kind, slot] = test.gain
        t.pick[kind, slot] = np.where(test.gain > 0.0, self.total[kind] ** 2, 0.0) if self._parity_test == SVD else test.gain
        t.level[kind, slot] = -1.0
        t.isolable[kind, slot] = test.isolable
        t.whitened[kind, slot] = 0.0
        t.W[kind, slot] = 0.0
        t.reach[kind, slot] = 0.0
        t.V[kind, slot] = 0.0
        for i in range(self._array.n):
            t.member[kind, slot, i] = float(mask >> i & 1)
        if test.dof >= 0:
            t.whitened[kind, slot, : test.dof] = test.whitened
            if test.dof > 0:
                t.V[kind, slot, : test.dof] = self.white(kind, mask)
            t.W[kind, slot] = self._array.least_squares(mask, self.total[kind])
            covariance = self._array.covariance(mask, self.total[kind])
            t.reach[kind, slot] = 1.0 / (self.total[kind] ** 2 + np.sum(self._array.H @ covariance * self._array.H, axis=1))
            t.extra[kind, slot] = 0.0
            if self.sigma is not self._stated[0]:
                t.extra[kind, slot] = (t.W[kind, slot] * self.sigma[kind] ** 2) @ t.W[kind, slot].T - self.noise_covariance(kind, mask)
        t.filled[kind] += 1

    def test(self, kind: int, mask: int) -> ParityTest:
        """Parity test of the sensors in `mask`."""
        tests = self._tests[kind]
        if mask not in tests:
            tests[mask] = parity_test(self._array, mask, self.total[kind], self._pfa)
        return tests[mask]

    def white(self, kind: int, mask: int) -> Array:
        """Parity matrix (dof, n) of the sensors in `mask`, scaled to white noise of unit variance."""
        V = self.test(kind, mask).V
        return np.asarray(np.linalg.solve(np.linalg.cholesky((V * self.sigma[kind] ** 2) @ V.T), V))

    def noise_covariance(self, kind: int, mask: int) -> Array:
        """Covariance (3, 3) of a fused sample's white noise as stated, body FRD; NaN when the sensors do not span three axes."""
        kept = self._covariance[kind]
        if mask not in kept:
            if self.test(kind, mask).dof < 0:
                return np.full((3, 3), np.nan)
            sigma, total = self._stated
            w = self._array.least_squares(mask, total[kind])
            kept[mask] = (w * sigma[kind] ** 2) @ w.T
            kept[mask].flags.writeable = False
        return kept[mask]

    def _empty(self, slots: int) -> Tables:
        n, d = self._array.n, max(1, self._array.n - 3)
        return Tables(
            key=np.zeros((2, slots), np.uint64),
            filled=np.zeros(2, np.int64),
            dof=np.zeros((2, slots), np.int64),
            W=np.zeros((2, slots, 3, n)),
            whitened=np.zeros((2, slots, d, n)),
            gain=np.zeros((2, slots, n)),
            pick=np.zeros((2, slots, n)),
            rows=np.zeros((2, slots, self._rows, n)),
            members=np.zeros((2, slots, self._rows), np.uint64),
            level=np.zeros((2, slots)),
            isolable=np.zeros((2, slots, n), np.bool_),
            member=np.zeros((2, slots, n)),
            V=np.zeros((2, slots, d, n)),
            reach=np.zeros((2, slots, n)),
            extra=np.zeros((2, slots, 3, 3)),
        )

    def _grow(self, slots: int) -> None:
        old, self.tables = self.tables, self._empty(slots)
        for name in Tables._fields:
            source, target = getattr(old, name), getattr(self.tables, name)
            if name == "filled":
                target[:] = source
            else:
                target[:, : source.shape[1]] = source
