"""How each IMU is really mounted, from its gyros against those of the first one while the vehicle turns.

Lives here: `MountingEstimator`: angles, bias, clock and scale factors of each IMU with their covariance, and readings turned by the angles.
Does not live here: settings (array_config.py), alignment in time (array_align.py), fault detection (the fusion).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from riins_core.kalman import update
from riins_core.rotation import exp_so3, skew
from riins_fdi.innovation import nis_threshold
from riins_imu_fusion.array_align import AlignedSample
from riins_imu_fusion.array_config import ArrayConfig

Array = NDArray[np.float64]

ANGLE, BIAS, CLOCK, SCALE = slice(0, 3), slice(3, 6), 6, slice(7, 10)
N_STATE = 10
_MEMORY = 1.0 / 200.0
"""Weight of a new comparison in the mean misfit."""


class Mounting(NamedTuple):
    """What is known of one IMU against the first; vectors in imu_link, FLU, one sigma each.

    Attributes
    ----------
    angle, angle_sigma : (3,), rad, rotation vector: the IMU's axes are those given, turned by this
    worst_sigma : rad, of the direction about which the angle is known least: with turns about one axis alone this never falls
    directions : directions of the angle that are known, 0 .. 3
    known : all three are
    bias, bias_sigma : (3,), rad/s, gyro bias less that of the first
    clock, clock_sigma : s, clock offset beyond the one given, less that of the first
    scale, scale_sigma : (3,), gyro scale factor errors along its own axes, less those of the first
    used, left_out : comparisons
    misfit : mean square of the innovations in the variance expected; the sigmas have it in them where it is above 1
    """

    angle: Array
    angle_sigma: Array
    worst_sigma: float
    directions: int
    known: bool
    bias: Array
    bias_sigma: Array
    clock: float
    clock_sigma: float
    scale: Array
    scale_sigma: Array
    used: int
    left_out: int
    misfit: float


class _Against:
    """Kalman filter of one IMU against the first: ANGLE as Gibbs vector, BIAS, CLOCK, SCALE."""

    def __init__(self, config: ArrayConfig, imu: int, axes: Array) -> None:
        c = config.mounting
        sigma = [math.radians(c.angle_sigma_deg)] * 3 + [c.bias_sigma] * 3 + [c.clock_sigma_s] + [c.scale_sigma] * 3
        self.axes = axes
        self.x, self.P = np.zeros(N_STATE), np.diag(np.square(sigma))
        density = config.each("gyro_sigma") ** 2 / config.each("imu_rate_hz")
        self.R = (density[0] + density[imu]) / c.period_s * np.eye(3)
        self.walk = c.bias_walk**2
        self.gate = nis_threshold(c.false_alarm_probability, 3)
        self.known = math.radians(c.known_deg)
        self.used, self.left_out, self.misfit = 0, 0, 1.0
        self.turn: Array | None = None  # of readings, when it is known

    def compare(self, own: Array, first: Array, change: Array, seconds: float) -> None:
        """Rates (3,) of both and their mean rate of change, imu_link; `seconds` since the last comparison."""
        middle = 0.5 * (own + first)
        H = np.zeros((3, N_STATE))
        H[:, ANGLE], H[:, BIAS], H[:, CLOCK] = skew(middle), np.eye(3), -change
        H[:, SCALE] = self.axes * (middle @ self.axes)
        self.P[BIAS, BIAS] += self.walk * seconds * np.eye(3)
        x, P, innovation = update(self.x, self.P, own - first, H, self.R)
        nis = innovation.nis / 3.0
        loose = max(1.0, self.misfit)
        self.misfit += _MEMORY * (min(nis, 10.0 * loose) - self.misfit)
        if innovation.nis > self.gate * loose:
            self.left_out += 1
            return
        self.x, self.P = x, P
        self.used += 1

    def result(self) -> Mounting:
        P = self.P * max(1.0, self.misfit)
        sigma = np.sqrt(np.diagonal(P))
        spread = np.sqrt(np.linalg.eigvalsh(P[ANGLE, ANGLE]))
        directions = int(np.sum(spread <= self.known))
        length = float(np.linalg.norm(self.x[ANGLE]))
        angle = self.x[ANGLE] * (2.0 * math.atan(0.5 * length) / length if length > 0.0 else 1.0)
        return Mounting(
            angle, sigma[ANGLE], float(spread[-1]), directions, directions == 3, self.x[BIAS].copy(), sigma[BIAS], float(self.x[CLOCK]),
            float(sigma[CLOCK]), self.x[SCALE].copy(), sigma[SCALE], self.used, self.left_out, self.misfit,
        )  # fmt: skip


class MountingEstimator:
    """Mounting of IMUs 1 .. n - 1 against IMU 0, whose own mounting is taken as it is given.

    Parameters
    ----------
    config : settings of the array

    Notes
    -----
    With C_i the mounting given and exp(theta) C_i the real one, both rates in imu_link differ by w_i - w_0 = -g x (w_i + w_0) / 2 exactly, with
    the Gibbs vector g = 2 tan(|theta| / 2) theta / |theta| (Cayley): the filter is linear in it whatever its size. Differences of bias,
    clock (times the angular acceleration) and scale factor go beside it. With the mean of both rates in the model, noise does not
    correlate with itself. A turn about one axis says nothing of the angle about that axis; two axes, at different times, are needed.
    Specific forces take no part: their biases are larger than what a small angle makes of gravity. Whether the accelerometers sit
    as the gyros of the same IMU do is for its maker to say.
    """

    def __init__(self, config: ArrayConfig) -> None:
        self._config = config
        self._axes = config.rotations()  # columns are the sensing axes
        self._pairs = [_Against(config, i, self._axes[i]) for i in range(1, config.n)]
        self._length = max(1, round(config.mounting.period_s * 1e9 / config.period_ns))  # samples
        self._all = (1 << 3 * config.n) - 1
        self._block = -1
        self._sum, self._count = np.zeros((config.n, 3)), np.zeros(config.n, np.int64)
        self._means: list[tuple[int, Array]] = []  # the last three blocks, NaN for an IMU that was not valid throughout

    def add(self, sample: AlignedSample) -> None:
        """Take a sample of the array, in order."""
        block = sample.stamp_ns // self._config.period_ns // self._length
        if block != self._block:
            self._close()
            self._block = block
            self._sum[:], self._count[:] = 0.0, 0
        self._sum += sample.gyro.reshape(-1, 3)
        if sample.gyro_valid == self._all:
            self._count += 1
        else:
            self._count += [sample.gyro_valid >> (3 * i) & 7 == 7 for i in range(self._config.n)]

    def _close(self) -> None:
        whole = self._count == self._length
        mean = np.where(whole[:, None], np.einsum("nij,nj->ni", self._axes, self._sum / self._length), np.nan)
        self._means = [*self._means[-2:], (self._block, mean)]
        if len(self._means) < 3 or self._means[2][0] != self._means[0][0] + 2:
            return
        (_, before), (_, now), (_, after) = self._means
        seconds = self._length * self._config.period_ns * 1e-9
        for i, pair in enumerate(self._pairs, 1):
            change = 0.25 * (after[i] + after[0] - before[i] - before[0]) / seconds
            if np.isfinite(change).all() and np.isfinite(now[[0, i]]).all():
                pair.compare(now[i], now[0], change, seconds)
                found = pair.result()
                pair.turn = self._axes[i].T @ exp_so3(found.angle) @ self._axes[i] if found.known else None

    def result(self, imu: int) -> Mounting:
        """What is known of IMU 1 .. n - 1."""
        return self._pairs[imu - 1].result()

    def turned(self, sample: AlignedSample) -> AlignedSample:
        """The sample as if every IMU whose mounting is known were mounted as given; a triad with an axis missing is then not valid."""
        gyro, accel, valid = sample.gyro.copy(), sample.accel.copy(), [sample.gyro_valid, sample.accel_valid]
        for i, pair in enumerate(self._pairs, 1):
            if pair.turn is None:
                continue
            for k, values in enumerate((gyro, accel)):
                mine = 7 << (3 * i)
                whole = valid[k] & mine == mine
                values[3 * i : 3 * i + 3] = pair.turn @ values[3 * i : 3 * i + 3] if whole else 0.0
                if not whole:
                    valid[k] &= ~mine
        return sample._replace(gyro=gyro, accel=accel, gyro_valid=valid[0], accel_valid=valid[1])
