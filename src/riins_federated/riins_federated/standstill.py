"""Whether the vehicle stands, by the IMU alone: within a window its rates and forces vary no more than their noise does.

Lives here: `Standstill`, which makes measurements for the aids of type zero_velocity that are to be detected.
Does not live here: what such a measurement is worth (aids/zero_velocity.py), when it is worked (ordered_run.py).
"""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
from numpy.typing import NDArray

from riins_core.ins_error import PHI, VEL
from riins_core.jit import jit
from riins_fdi.innovation import nis_threshold

from .config import NavigatorConfig
from .state_blocks import inertial_density
from .types import Aid, Array

WHOLE = 0.95
"""A window with fewer of its samples says nothing."""


class Standstill:
    """Detector of standing still, window by window of measurement time.

    Parameters
    ----------
    config : its aids of type zero_velocity with `detect`, and the noise of section inertial

    Notes
    -----
    Sum of the squared deviations from the window's mean over the white noise of a sample, rates and forces together: chi-square with 6 (m - 1)
    degrees of freedom for a vehicle that stands, its threshold that of `miss_probability`. Steady motion without vibration looks the same: it is for
    the innovation test of the aid to refuse that, which it can while something else tells the velocity.
    """

    def __init__(self, config: NavigatorConfig) -> None:
        self._aids = [(name, s) for name, s in config.aid.items() if s.enabled and getattr(s, "detect", False)]
        density = inertial_density(config.inertial)
        self._density = np.repeat([density[PHI][0], density[VEL][0]], 3)
        self.new_run()

    def new_run(self) -> None:
        """Forget the windows under way."""
        self._state: list[Array] = [np.zeros(20) for _ in self._aids]  # origin (6,), sums (6,), sums of squares (6,), samples, seconds
        self._window: list[int | None] = [None] * len(self._aids)
        self._last = [0] * len(self._aids)

    def take(self, stamp_ns: NDArray[np.int64], rate: Array, force: Array, dt: Array) -> list[Aid]:
        """Take samples (m,), (m, 3), (m, 3), (m,); returns what the windows that end with or before them have shown, in order of stamp."""
        found: list[Aid] = []
        for i, (name, settings) in enumerate(self._aids):
            length = round(settings.period_s * 1e9)
            windows = (stamp_ns - 1) // length
            edges = [0, *(np.flatnonzero(np.diff(windows)) + 1).tolist(), len(stamp_ns)]
            for a, b in itertools.pairwise(edges):
                if self._window[i] not in (None, int(windows[a])):
                    found += self._close(i, name, settings)
                self._window[i] = int(windows[a])
                _add(self._state[i], rate[a:b], force[a:b], dt[a:b])
                self._last[i] = int(stamp_ns[b - 1])
                if self._last[i] % length == 0:
                    found += self._close(i, name, settings)
        return sorted(found, key=lambda aid: aid.stamp_ns)

    def _close(self, i: int, name: str, settings: Any) -> list[Aid]:
        state, self._state[i], self._window[i] = self._state[i], np.zeros(20), None
        samples, seconds = int(state[18]), float(state[19])
        if samples < 2 or seconds < WHOLE * settings.period_s:
            return []
        scatter = state[12:18] - state[6:12] ** 2 / samples
        variance = settings.vibration**2 * self._density * samples / seconds
        standing = float(np.sum(scatter / variance)) <= nis_threshold(settings.miss_probability, 6 * (samples - 1))
        return [Aid(name, self._last[i], np.zeros(3), np.zeros((3, 3)))] if standing else []


@jit
def _add(state: Array, rate: Array, force: Array, dt: Array) -> None:
    for k in range(dt.shape[0]):
        for axis in range(6):
            value = rate[k, axis] if axis < 3 else force[k, axis - 3]
            if state[18] == 0.0:
                state[axis] = value  # deviations from the first sample: gravity must not swamp them
            value -= state[axis]
            state[6 + axis] += value
            state[12 + axis] += value * value
        state[18] += 1.0
        state[19] += dt[k]
