"""Parity tests and least-squares estimators of the sets of sensors that have been in use, made once for each set.

Lives here: `TableCache`, which fills the arrays the kernel reads when a sensor leaves or returns.
Does not live here: the test itself (riins_fdi.parity), which set is in use (pipeline.py).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from riins_core.imu_array import ImuArray
from riins_fdi.parity import ParityTest, parity_test
from riins_imu_fusion.state import Tables

Array = NDArray[np.float64]

_FIRST_SLOTS = 16
_MOST_SLOTS = 8192
"""Beyond it (large arrays with random dropouts) the cache is emptied."""


class TableCache:
    """Tables by kind and set of sensors.

    Parameters
    ----------
    array : geometry of n sensors
    sigma : (2, n), white noise of a sample
    total : (2, n), noise and ordinary bias together
    pfa : false-alarm probability per sample and triad

    Attributes
    ----------
    tables : arrays for the kernel; replaced when they grow, so take them anew after `add`
    """

    def __init__(self, array: ImuArray, sigma: Array, total: Array, pfa: float) -> None:
        self._array, self._sigma, self._total, self._pfa = array, sigma, total, pfa
        self._tests: list[dict[int, ParityTest]] = [{}, {}]
        self._covariance: list[dict[int, Array]] = [{}, {}]
        self.tables = self._empty(_FIRST_SLOTS)

    def add(self, kind: int, mask: int) -> None:
        """Make the table of the sensors in `mask`; a set that does not span three axes gets dof = -1."""
        slots = self.tables.key.shape[1]
        if self.tables.filled[kind] == slots:
            if slots >= _MOST_SLOTS:
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
                t.V[kind, slot, : test.dof] = np.linalg.solve(np.linalg.cholesky((test.V * self._sigma[kind] ** 2) @ test.V.T), test.V)
            t.W[kind, slot] = self._array.least_squares(mask, self._total[kind])
            covariance = self._array.covariance(mask, self._total[kind])
            t.reach[kind, slot] = 1.0 / (self._total[kind] ** 2 + np.sum(self._array.H @ covariance * self._array.H, axis=1))
        t.filled[kind] += 1

    def test(self, kind: int, mask: int) -> ParityTest:
        """Parity test of the sensors in `mask`."""
        tests = self._tests[kind]
        if mask not in tests:
            tests[mask] = parity_test(self._array, mask, self._total[kind], self._pfa)
        return tests[mask]

    def noise_covariance(self, kind: int, mask: int) -> Array:
        """Covariance (3, 3) of a fused sample's white noise, body FRD; NaN when the sensors do not span three axes."""
        kept = self._covariance[kind]
        if mask not in kept:
            if self.test(kind, mask).dof < 0:
                return np.full((3, 3), np.nan)
            w = self._array.least_squares(mask, self._total[kind])
            kept[mask] = (w * self._sigma[kind] ** 2) @ w.T
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
            isolable=np.zeros((2, slots, n), np.bool_),
            member=np.zeros((2, slots, n)),
            V=np.zeros((2, slots, d, n)),
            reach=np.zeros((2, slots, n)),
        )

    def _grow(self, slots: int) -> None:
        old, self.tables = self.tables, self._empty(slots)
        for name in Tables._fields:
            source, target = getattr(old, name), getattr(self.tables, name)
            if name == "filled":
                target[:] = source
            else:
                target[:, : source.shape[1]] = source
