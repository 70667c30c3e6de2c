"""The white noise of each sensor, estimated while the fusion runs: one window of samples after the other, each as long as its stamps say.

Lives here: what the loop gathers, and `NoiseWatch`, which makes an estimate of it at the end of a window.
Does not live here: the mathematics (noise_estimation.py), what the estimate is used for (pipeline.py).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from riins_core.imu_array import ImuArray
from riins_core.jit import inner
from riins_core.settings import setting
from riins_imu_fusion.noise_estimation import autocovariance_step, solve
from riins_imu_fusion.state import NoiseState

F = NDArray[np.float64]

GAIN, LAGS = 0.3, 6
"""Of the filter whose innovations are taken; lags whose autocovariances are used."""
RUN, OF = 512, 2048
"""Samples taken in, and of how many: a quarter of the time is a quarter of the cost, and a longer window makes up for it."""
LOUD = 1.5
"""Ratio of estimated to stated noise from which on it is said."""


@dataclass(frozen=True)
class NoiseSettings:
    """Estimation of the white noise of each sensor while the fusion runs; six sensors at least tell each one's."""

    window_s: float = setting(240.0, "a quarter of the samples of this time makes an estimate; 0: no estimation", "s", 0.0, 86400.0)
    most: float = setting(5.0, "an estimate is used up to this many times the stated noise, and down to one part in as many", "", 1.0, 1e3)
    least_change: float = setting(0.1, "an estimate is used when it differs by this part from what is in use", "", 0.0, 10.0)


@inner
def gather(kind: int, turn: int, valid: np.uint64, z: F, st: NoiseState) -> None:
    """Take in sample number `turn` (2, n) of a run; another set of sensors than the one worked with breaks it."""
    if turn == 0 or valid != st.key[kind]:
        st.number[kind, 0] = 0.0
    if valid == st.key[kind]:
        autocovariance_step(st.s[kind], st.ring[kind], st.sums[kind], st.number[kind], GAIN, st.V[kind], z[kind])


class NoiseWatch:
    """Windows and estimates of both kinds of sensor.

    Parameters
    ----------
    array : geometry
    settings : length of a window, what of an estimate is used
    stated : (2, n), noise of a sample as the configuration has it

    Attributes
    ----------
    stated : as given
    estimate : (2, n), standard deviations of the last window in which each could be estimated; NaN before
    sigma : (2, n), noise to be used when the estimate is wanted

    Notes
    -----
    Every sensor with a value that can be used is in it, isolated or not: one that is isolated because it is noisy must be heard to be let in again.
    Samples that alarm are in it too, for without them the noise would come out too small.
    """

    def __init__(self, array: ImuArray, settings: NoiseSettings, stated: F) -> None:
        self._array, self._settings, self.stated = array, settings, stated
        self.window_ns = round(settings.window_s * 1e9)
        self.reset()

    def reset(self) -> None:
        """Forget all estimates."""
        self.estimate = np.full(self.stated.shape, np.nan)
        self.sigma = self.stated

    def fresh(self) -> NoiseState:
        """Memory before the first sample, for all sensors."""
        n, d = self._array.n, max(1, self._array.n - 3)
        state = NoiseState(
            key=np.zeros(2, np.uint64),
            V=np.zeros((2, d, n)),
            s=np.zeros((2, d)),
            ring=np.zeros((2, LAGS, d)),
            sums=np.zeros((2, LAGS, d, d)),
            number=np.zeros((2, 2 + LAGS)),
        )
        state.number[:, 1] = np.ceil(np.log(1e-3) / np.log(1.0 - GAIN))
        for kind in range(2):
            self._begin(state, kind, (1 << n) - 1)
        return state

    def end(self, stamp_ns: int) -> int:
        """Stamp of the grid at which the window of a sample ends."""
        return stamp_ns - stamp_ns % self.window_ns + self.window_ns

    def close(self, state: NoiseState, valid: NDArray[np.uint64]) -> bool:
        """Estimate from what was gathered and begin another window; `valid` (2,): sensors usable now. True: `sigma` is another one."""
        changed = False
        for kind in range(2):
            mask = int(state.key[kind])
            used = self._array.used(mask) if mask else np.zeros(0, np.intp)
            dof = used.size - 3
            if dof > 0:
                try:
                    made = solve(state.V[kind, :dof], used, state.sums[kind, :, :dof, :dof], state.number[kind, 2:], GAIN, each=True)
                except (ValueError, np.linalg.LinAlgError):  # too few samples or sensors, or readings that do not vary
                    pass
                else:
                    self.estimate[kind, used] = np.sqrt(made.R[used])
                    changed |= self._take_over(kind)
            seen, now = state.number[kind, -1] > 0.0, int(valid[kind])
            state.sums[kind] = 0.0
            state.number[kind, 2:] = 0.0
            if now != mask and (not seen or now & mask == mask):  # not for an axis that is missing just now
                self._begin(state, kind, now)
        return changed

    def loud(self, kind: int) -> list[tuple[int, float]]:
        """Sensors whose noise is far above what was stated, and how many times."""
        ratio = self.estimate[kind] / self.stated[kind]
        return [(int(i), float(ratio[i])) for i in np.flatnonzero(ratio > LOUD)]

    def _take_over(self, kind: int) -> bool:
        stated, most = self.stated[kind], self._settings.most
        wanted = np.clip(self.estimate[kind], stated / most, stated * most)
        apart = np.abs(wanted / self.sigma[kind] - 1.0) > self._settings.least_change
        if not np.any(apart):
            return False
        self.sigma = self.sigma.copy()
        self.sigma[kind] = np.where(np.isfinite(wanted), wanted, self.sigma[kind])
        return True

    def _begin(self, state: NoiseState, kind: int, mask: int) -> None:
        state.key[kind] = np.uint64(mask)
        state.number[kind, 0] = 0.0
        state.V[kind] = 0.0
        try:
            V = self._array.parity_full(mask)
        except ValueError:
            state.key[kind] = np.uint64(0)
            return
        state.V[kind, : len(V)] = V
