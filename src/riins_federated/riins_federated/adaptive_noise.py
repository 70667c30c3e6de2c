"""How noisy an aid is now: its measurement covariance scaled by what its innovations show, untouched by a step or a ramp.

Lives here: `AdaptiveNoise`, one for each aid.
Does not live here: fault tests (riins_fdi), the filters (structures.py).
"""

from __future__ import annotations

import copy

import numpy as np

from .aiding import Measurement
from .types import Array

_MEDIAN = 0.4549364
"""Median of chi-square with one degree of freedom."""


class AdaptiveNoise:
    """Scale of the measurement noise from the median of squared differences of successive innovations.

    Parameters
    ----------
    window : differences in the median
    dead_band : a scale below it is taken as one, so that an aid that keeps its noise is weighted as configured
    limit : largest scale

    Notes
    -----
    A difference has the variance 2 R and next to nothing of the state's error, which hardly changes from one measurement to the next. A step spoils
    one difference of the window, a ramp adds its slope to each: neither becomes noise, so that the fault tests still see them. The mean square of
    the innovations (Mohamed and Schwarz 1999) would widen the gate for every slow fault.
    """

    def __init__(self, window: int = 60, dead_band: float = 1.5, limit: float = 100.0) -> None:
        self.window, self.dead_band, self.limit = window, dead_band, limit
        self.scale = 1.0
        self._last: Array | None = None
        self._squares: list[Array] = []

    def scaled(self, measurement: Measurement) -> Measurement:
        """The measurement with its noise as it is now."""
        return measurement if self.scale == 1.0 else Measurement(measurement.z, measurement.H, measurement.R * self.scale)

    def learn(self, innovation: Array, R: Array) -> None:
        """Take in an innovation (m,), fused or not, and the covariance R (m, m) its aid reports; one that is not finite breaks the sequence."""
        if not np.isfinite(innovation).all():
            self._last = None
            return
        if self._last is not None:
            self._squares = [*self._squares[1 - self.window :], (innovation - self._last) ** 2 / (2.0 * np.diag(R))]
            if len(self._squares) == self.window:
                scale = min(float(np.median(self._squares)) / _MEDIAN, self.limit)
                self.scale = scale if scale > self.dead_band else 1.0
        self._last = innovation

    def gap(self) -> None:
        """There was no measurement: the next innovation has no predecessor."""
        self._last = None

    def clone(self) -> AdaptiveNoise:
        """A copy that goes on independently."""
        return copy.copy(self)  # the list is replaced, never changed
