"""Bias of each sensor: what the parities say of it, and what the navigator says of the part they cannot see.

Lives here: `KnownBias`, of one kind of sensor: the calibration in force, what is remembered of sensors that have left.
Does not live here: the filter on the parities (glr_kf*.py), when a calibration begins to hold (selection.Commands), who makes it (riins_federated).

With biases b of the sensors and c = W b of the fused output, b = x + H c: the parities give x, the navigator c, and neither the other. The fused
output keeps c in it, and the navigator goes on subtracting c: a sensor's bias is put together for reports, and for a sensor that returns: relative
to the output it comes back to, its bias is the one it had, less h'c of now. Nothing else depends on c, so it is counted once.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from riins_imu_fusion.glr_kf_state import ACTIVE, BASE_X, BASED, BEFORE, DOUBT, OPEN, USED, GlrRules, GlrState, X

Array = NDArray[np.float64]


class Calibration(NamedTuple):
    """Bias of the fused output of both kinds, axes (kind, ...): (2, 3), rad/s, m/s^2, FRD, and its covariance (2, 3, 3)."""

    bias: Array
    covariance: Array

    def problem(self) -> str:
        """Why it cannot be used, '' if it can."""
        if not (np.isfinite(self.bias).all() and np.isfinite(self.covariance).all()):
            return "it holds a value that is not finite"
        for P in self.covariance:
            scale = np.sqrt(np.abs(np.diagonal(P)))
            if not (np.diagonal(P) > 0.0).all() or np.linalg.eigvalsh(P / np.outer(scale, scale)).min() <= 0.0:
                return "a covariance is not positive definite"
        return ""


class KnownBias:
    """Biases of n sensors of one kind.

    Parameters
    ----------
    rules : of the filter on the parities
    """

    def __init__(self, rules: GlrRules) -> None:
        self._H, self._common = rules.H, rules.common
        self.fused: tuple[Array, Array] | None = None
        """bias (3,) of the fused output and its covariance; None: nobody has said"""
        n = len(rules.H)
        self._left = np.full(n, np.nan)
        self._left_fused = np.full((n, 3), np.nan)

    def forget(self) -> None:
        """The run begins anew."""
        self.fused = None
        self._left[:] = np.nan
        self._left_fused[:] = np.nan

    def leave(self, glr: GlrState, index: int) -> None:
        """Keep what is known of a sensor that leaves: as it was before its drift."""
        x = glr.vec[BEFORE] if glr.open[index] == OPEN else glr.vec[BASE_X] if glr.ints[DOUBT] else glr.vec[X]
        self._left[index] = x[index]
        self._left_fused[index] = self.fused[0] if self.fused else np.nan

    def returning(self) -> Array:
        """Expected bias (n,) relative to the fused output of each sensor if it came in now; how well is left to the prior."""
        if self.fused is None:
            return np.nan_to_num(self._left)
        moved = np.einsum("ia,ia->i", self._H, self._left_fused - self.fused[0])
        new = -self._H @ self.fused[0]
        return np.asarray(np.where(np.isfinite(self._left), self._left + np.nan_to_num(moved), new))

    def all(self, glr: GlrState) -> tuple[Array, Array]:
        """Bias and its standard deviation (n,), NaN where the filter does not know the sensor.

        Notes
        -----
        P holds the prior of the part in the range of H, H C0 H'; where the navigator says better, its covariance takes that place.
        """
        if glr.ints[BASED] == 0:
            unknown = np.full(len(self._H), np.nan)
            return unknown, unknown
        H, used = self._H, glr.vec[USED] > 0.0
        x = glr.x if glr.ints[ACTIVE] else glr.x - H @ (glr.W @ glr.x)
        c, C = self.fused if self.fused else (np.zeros(3), self._common)
        variance = np.maximum(np.diagonal(glr.P) + np.einsum("ia,ab,ib->i", H, C - self._common, H), 0.0)
        return np.where(used, x + H @ c, np.nan), np.where(used, np.sqrt(variance), np.nan)
