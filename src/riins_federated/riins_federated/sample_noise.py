"""Noise of the samples themselves: what the fused IMU loses with a sensor or with a whole sample, as process noise of the error filter.

Lives here: `SampleNoise`, which gathers the covariances that come with the samples and says what they add to the configured model.
Does not live here: the configured model (state_blocks.inertial_density), where the covariances come from (riins_imu_fusion).
"""

from __future__ import annotations

import numpy as np

from riins_core.ins_error import BA, BG, PHI, VEL
from riins_core.jit import jit
from riins_core.sensor_errors import DEG_PER_H, MICRO_G

from .config import NavigatorConfig
from .state_blocks import inertial_density
from .types import Array

SUM, LAST, STEP = 0, 1, 2
_NEGLIGIBLE = 1e-9  # of the configured density: rounding of covariances that agree with it


class SampleNoise:
    """Gyro and accelerometer noise beyond the configured model, between two propagations of the covariance.

    Parameters
    ----------
    config : NavigatorConfig; its densities and bias sigmas are those of the whole set of sensors

    Notes
    -----
    White noise of covariance S over dt has the density S dt; where that exceeds the configured one, the excess is process noise of velocity or
    attitude. When S changes, other sensors are fused, and the fused bias steps: least squares over a subset and over the set differ by an
    error of covariance |S_new - S_old| (s_b / s_w)^2 with the sensors' bias and noise sigmas s_b, s_w, uncorrelated with the smaller one.
    """

    def __init__(self, config: NavigatorConfig) -> None:
        model, density = config.inertial, inertial_density(config.inertial)
        self._follow, self._steps = model.follow_covariance, model.bias_steps
        self._density = np.array([density[PHI][0], density[VEL][0]])
        self._model = self._density[:, None, None] * np.eye(3)
        self._bias = np.array([model.gyro_bias_deg_h * DEG_PER_H, model.accel_bias_ug * MICRO_G]) ** 2 / self._density

    @staticmethod
    def fresh() -> Array:
        """State of a run that begins: (2, 3, 3, 3), gyro and accelerometer; sum of S dt^2, last S, steps of S dt."""
        return np.zeros((2, 3, 3, 3))

    def gather(self, state: Array, rate_covariance: Array, force_covariance: Array, unknown: Array, dt: Array) -> None:
        """Take the samples of (m, 3, 3), (m, 3, 3), (m, 6), (m,); a covariance that is zero or not finite is not known: the configured one holds."""
        if self._follow:
            _gather(state[0], rate_covariance, dt, self._density[0])
            _gather(state[1], force_covariance, dt, self._density[1])
        _gather_unknown(state, unknown, dt)

    def add(self, state: Array, C_nb: Array, interval: float, Qd: Array) -> None:
        """Add what the interval's samples have beyond the model to the process noise Qd (n, n), and begin the next interval."""
        if not self._follow:
            for kind, white in enumerate((PHI, VEL)):
                if state[kind, SUM].any():
                    Qd[white, white] += C_nb @ state[kind, SUM] @ C_nb.T
            state[:, SUM] = 0.0
            return
        for kind, (white, bias) in enumerate(((PHI, BG), (VEL, BA))):
            small = _NEGLIGIBLE * self._density[kind]
            excess = state[kind, SUM] - self._model[kind] * interval
            if np.abs(excess).max() > small * interval:
                Qd[white, white] += C_nb @ _positive(excess) @ C_nb.T
            if self._steps and np.abs(state[kind, STEP]).max() > small:
                Qd[bias, bias] += self._bias[kind] * _positive(state[kind, STEP])
        state[:, SUM] = state[:, STEP] = 0.0


def _positive(matrix: Array) -> Array:
    """The part of a symmetric matrix with positive eigenvalues."""
    values, vectors = np.linalg.eigh(matrix)
    return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T)


@jit
def _gather_unknown(state: Array, unknown: Array, dt: Array) -> None:
    for k in range(len(dt)):
        if unknown[k, 0] > 0.0 or unknown[k, 3] > 0.0:
            for i in range(3):
                state[0, SUM, i, i] += unknown[k, i] * dt[k] * dt[k]
                state[1, SUM, i, i] += unknown[k, 3 + i] * dt[k] * dt[k]


@jit
def _gather(state: Array, covariance: Array, dt: Array, density: float) -> None:
    for k in range(len(dt)):
        S = covariance[k]
        trace = S[0, 0] + S[1, 1] + S[2, 2]
        if not (np.isfinite(trace) and trace > 0.0):
            for i in range(3):
                state[SUM, i, i] += density * dt[k]
            continue
        before = state[LAST, 0, 0] + state[LAST, 1, 1] + state[LAST, 2, 2]
        sign = 0.0 if before == 0.0 else (1.0 if trace >= before else -1.0)
        for i in range(3):
            for j in range(3):
                state[SUM, i, j] += S[i, j] * dt[k] * dt[k]
                state[STEP, i, j] += sign * (S[i, j] - state[LAST, i, j]) * dt[k]
                state[LAST, i, j] = S[i, j]
