"""The master filter: what the subfilters' information becomes.

Lives here: `InformationMaster` (subfilters send information increments, the master holds the exact centralized solution) and
`FusionReset` (Carlson's local filters, fused and reset after every measurement).
Does not live here: measurement models, fault tests (local_filter.py), ordering by time (navigator.py).
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from riins_core import kalman

from .aiding import Measurement
from .error_filter import propagate
from .information_sharing import checked_shares, equal_shares
from .types import Array


class Master(Protocol):
    """What the navigator asks of a structure. x: (n,), P: (n, n), of the fused error state."""

    x: Array
    P: Array
    beta: Array

    def predict(self, Phi: Array, Qd: Array) -> None:
        """Advance by one interval."""

    def update(self, index: int, measurement: Measurement) -> None:
        """Take in what subfilter `index` measured."""

    def shift(self, dx: Array) -> None:
        """Subtract dx from the estimate: it has been fed back into the nominal state."""

    def snapshot(self) -> tuple[Array, ...]:
        """Copies of the state, for roll-back."""

    def restore(self, snapshot: tuple[Array, ...]) -> None:
        """Go back to a snapshot."""


class InformationMaster:
    """Centralized filter fed with information increments (H' R^-1 z, H' R^-1 H) of the subfilters.

    An increment is carried in its factors (z, H, R), so that the covariance form can be updated without ever inverting P:
    the same algebra, better conditioned. One subfilter's increment can be left out or taken back without touching the others'.
    """

    def __init__(self, P0: Array, n_subfilters: int) -> None:
        self.x = np.zeros(len(P0))
        self.P = P0.copy()
        self.beta = equal_shares(n_subfilters)

    def predict(self, Phi: Array, Qd: Array) -> None:
        """Advance by one interval."""
        propagate(self.x, self.P, Phi, Qd, 1.0)

    def update(self, index: int, measurement: Measurement) -> None:
        """Take in what subfilter `index` measured."""
        self.x, self.P, _ = kalman.update(self.x, self.P, measurement.z, measurement.H, measurement.R)

    def shift(self, dx: Array) -> None:
        """Subtract what has been fed back."""
        self.x = self.x - dx

    def snapshot(self) -> tuple[Array, ...]:
        """Copies of the state."""
        return self.x.copy(), self.P.copy()

    def restore(self, snapshot: tuple[Array, ...]) -> None:
        """Go back to a snapshot."""
        self.x, self.P = (part.copy() for part in snapshot)


class FusionReset:
    """Federated filter in fusion-reset form: local covariances P / beta and process noise Q / beta, fused and reset at each update.

    Equal to the centralized filter for any constant beta (Carlson 1990), a property the tests hold; seed 003's figure 2. Slower than
    `InformationMaster` by the inversions, and never better: it is here to be compared.
    """

    def __init__(self, P0: Array, n_subfilters: int, beta: ArrayLike | None = None) -> None:
        self.beta = equal_shares(n_subfilters) if beta is None else checked_shares(beta)
        self.local_x = np.zeros((n_subfilters, len(P0)))
        self.local_P = P0 / self.beta[:, None, None]
        self.x = np.zeros(len(P0))
        self.P = P0.copy()

    def predict(self, Phi: Array, Qd: Array) -> None:
        """Advance every local filter; between resets the fused covariance is beta P of any of them."""
        for i, share in enumerate(self.beta):
            propagate(self.local_x[i], self.local_P[i], Phi, Qd, 1.0 / share)
        self.x = self.local_x[0].copy()
        self.P = self.local_P[0] * self.beta[0]

    def update(self, index: int, measurement: Measurement) -> None:
        """Update local filter `index`, fuse all of them, and reset them to the fused state."""
        self.local_x[index], self.local_P[index], _ = kalman.update(
            self.local_x[index], self.local_P[index], measurement.z, measurement.H, measurement.R
        )
        self._fuse_and_reset()

    def shift(self, dx: Array) -> None:
        """Subtract what has been fed back, in every local filter."""
        self.local_x -= dx
        self.x = self.x - dx

    def snapshot(self) -> tuple[Array, ...]:
        """Copies of the state."""
        return self.local_x.copy(), self.local_P.copy(), self.x.copy(), self.P.copy()

    def restore(self, snapshot: tuple[Array, ...]) -> None:
        """Go back to a snapshot."""
        self.local_x, self.local_P, self.x, self.P = (part.copy() for part in snapshot)

    def _fuse_and_reset(self) -> None:
        # States switched off have no variance and no information; the rest is scaled to unit diagonal, as their units differ by 1e8.
        on = np.diag(self.P) > 0.0
        scale = np.sqrt(np.diag(self.P)[on])
        total = np.zeros((on.sum(), on.sum()))
        vector = np.zeros(on.sum())
        for x, P in zip(self.local_x, self.local_P, strict=True):
            information = np.linalg.inv(P[np.ix_(on, on)] / np.outer(scale, scale))
            total += information
            vector += information @ (x[on] / scale)
        fused = np.linalg.inv(total)
        self.P = np.zeros_like(self.P)
        self.P[np.ix_(on, on)] = 0.5 * (fused + fused.T) * np.outer(scale, scale)
        self.x = np.zeros(len(self.P))
        self.x[on] = fused @ vector * scale
        self.local_x[:] = self.x
        self.local_P[:] = self.P / self.beta[:, None, None]
