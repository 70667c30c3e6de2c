"""What the IMU says of the aids: means of the innovations against masters that take few of them.

Lives here: `InertialEvidence`, by which aids that lie together (GPS and BDS pulled by one spoofer) do not outvote the one that does not.
Does not live here: the masters, and what follows from the evidence (separated_masters.py).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from riins_fdi.innovation import nis_threshold

from .stacked import Rows
from .types import Array

CLIP = 6.0
"""Standardized innovations count up to this: one gross value must not speak for minutes."""


class InertialEvidence:
    """Exponential means of standardized innovations, of each master and aid.

    Parameters
    ----------
    masters, aids : how many
    memory : measurements after which an innovation counts 1/e

    Notes
    -----
    A mean m of white innovations with weights (1 - r) r^k has the covariance (1 - r) / (1 + r) I, so that m'm (1 + r) / (1 - r) is chi-square with
    as many degrees of freedom as the aid has components; sums over the aids of a master likewise. A master of aids that are pulled slowly has
    innovations whose mean is not zero as long as its IMU does not follow.
    """

    def __init__(self, masters: int, aids: int, memory: float) -> None:
        self._keep = float(np.exp(-1.0 / memory))
        self._mean: Array = np.zeros((masters, aids, 3))
        self._width: Rows = np.zeros(aids, np.int64)

    def learn(self, index: int, rows: Rows, standardized: Array) -> None:
        """Take standardized innovations (k, m) of an aid against the masters `rows`."""
        m = standardized.shape[1]
        if m > self._mean.shape[2]:  # four beams, or position and velocity at once
            self._mean = np.pad(self._mean, ((0, 0), (0, 0), (0, m - self._mean.shape[2])))
        self._width[index] = m
        clipped = np.minimum(np.maximum(standardized, -CLIP), CLIP)
        self._mean[rows, index, :m] = self._keep * self._mean[rows, index, :m] + (1.0 - self._keep) * clipped

    def ratio(self, row: int, aids: Sequence[int], pfa: float) -> float:
        """Statistic of a master over some of its aids, over its threshold; 0 before any innovation."""
        dof = int(self._width[list(aids)].sum())
        if dof == 0:
            return 0.0
        square = float(np.square(self._mean[row, list(aids)]).sum())
        return square * (1.0 + self._keep) / (1.0 - self._keep) / nis_threshold(pfa, dof)

    def copy(self, source: int, target: int) -> None:
        """A master becomes what another is."""
        self._mean[target] = self._mean[source]

    def snapshot(self) -> tuple[Array, Rows]:
        """Copies of everything."""
        return self._mean.copy(), self._width.copy()

    def restore(self, snapshot: tuple[Array, Rows]) -> None:
        """Go back to a snapshot, which stays usable."""
        mean, width = snapshot
        self._mean, self._width = mean.copy(), width.copy()
