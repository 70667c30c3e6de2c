"""The filters of opt, aopt and optdc in the pipeline: what they begin with, for all sensors and for one that returns.

Lives here: `Drifts`, which makes and resets the memory that the loop works on, and what is removed from each sensor.
Does not live here: the filters (optimal.py, adaptive.py, drift_compensated.py), their place in the loop (corrections.py), glr_kf (compensation.py).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from riins_imu_fusion import compensation
from riins_imu_fusion import state as K
from riins_imu_fusion.config import FusionConfig
from riins_imu_fusion.corrections import OPT


class Drifts:
    """Begin of the filters.

    Parameters
    ----------
    config : settings

    Attributes
    ----------
    numbers : settings as the loop reads them, see state.Rules
    """

    def __init__(self, config: FusionConfig) -> None:
        self._models = config.drift_models()
        a, c = config.drift.adaptive, config.drift.compensation
        self.numbers = np.array([a.forgetting, a.softening, a.memory, c.gain / config.rate_hz])

    def fresh(self) -> K.DriftState:
        """Memory before the first sample."""
        state = K.DriftState.of(self._models[0].array.n)
        for kind in range(2):
            self.forget(state, kind)
        return state

    def forget(self, state: K.DriftState, kind: int) -> None:
        """A sensor leaves: its fault has moved the drifts of the others too, where no parity will ever show it."""
        model = self._models[kind]
        state.vec[kind] = 0.0
        state.vec[kind, (K.STEP, K.WALK)] = model.Q
        state.P[kind] = state.kept[kind] = np.diag(model.P)
        state.past[kind] = 0.0

    def begin(self, state: K.DriftState, kind: int, index: int) -> None:
        """A sensor comes back into use: what was known of its drift is forgotten."""
        model = self._models[kind]
        state.vec[kind, :, index] = 0.0
        state.vec[kind, (K.STEP, K.WALK), index] = model.Q[index]
        for P in (state.P[kind], state.kept[kind]):
            P[index, :] = 0.0
            P[:, index] = 0.0
            P[index, index] = model.P[index]


def removed(kind: int, fusion: int, state: K.State) -> NDArray[np.float64]:
    """Drift removed from each sensor after the last sample (n,)."""
    if fusion >= OPT:
        return np.asarray(state.drift.vec[kind, K.ESTIMATE] + state.drift.vec[kind, K.COMPENSATION])
    return compensation.drift(state.glr[kind])
