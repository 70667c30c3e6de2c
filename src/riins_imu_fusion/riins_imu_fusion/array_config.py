"""Settings of an array of ordinary IMUs: where each is mounted, how noisy it is, how long it is waited for.

Lives here: `ArrayConfig`, `MountingConfig`, and what follows from them alone: geometry, noise of a resampled value, parameters for imu_fusion.
Does not live here: alignment in time (array_align.py), estimation of the mounting (array_mounting.py), ROS (array_node.py).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from riins_core.rotation import dcm_from_euler, dcm_from_quat, skew
from riins_core.settings import SettingError, section, setting

Array = NDArray[np.float64]

MOST_IMUS = 16
_PHASES = 64
"""Places of the output interval among the samples over which the noise is averaged."""


@dataclass(frozen=True)
class MountingConfig:
    """Estimation of mounting errors, bias differences and clock offsets from the gyros while moving."""

    estimate: bool = setting(True, "estimate mounting, bias and clock of each IMU against the first")
    apply: bool = setting(False, "turn the readings by the mounting estimate, as soon as it is known on all three axes")
    period_s: float = setting(0.1, "rates are averaged over this long before they are compared", "s", 0.01, 10.0)
    angle_sigma_deg: float = setting(2.0, "sigma of a mounting angle before anything is known", "deg", 1e-3, 30.0)
    bias_sigma: float = setting(0.05, "sigma of the difference of two gyro biases before anything is known", "rad/s", 1e-9, 10.0)
    bias_walk: float = setting(1e-5, "random walk of the difference of two gyro biases", "rad/s/sqrt(s)", 0.0, 1.0)
    clock_sigma_s: float = setting(0.01, "sigma of a clock offset beyond the one given; 0: the clocks are exact", "s", 0.0, 1.0)
    scale_sigma: float = setting(0.005, "sigma of the difference of two gyro scale factors before anything is known", "", 0.0, 0.1)
    known_deg: float = setting(0.2, "a mounting is known when no direction is more uncertain than this (one sigma)", "deg", 1e-4, 10.0)
    false_alarm_probability: float = setting(1e-4, "a comparison less probable than this is left out", "", 1e-12, 0.5)


@dataclass(frozen=True)
class ArrayConfig:
    """One to sixteen IMUs. A list has one element (or three, or four) for each IMU, in the order of `topics`, or is that of all."""

    topics: tuple[str, ...] = setting(("imu_0/raw", "imu_1/raw", "imu_2/raw"), "topics of the IMUs, sensor_msgs/Imu")
    rate_hz: float = setting(100.0, "rate of the samples that go out", "Hz", 0.1, 10e3)
    imu_rate_hz: tuple[float, ...] = setting((100.0,), "nominal rate of an IMU: one value, or one for each", "Hz", 0.1, 10e3)
    mounting_rpy_deg: tuple[float, ...] = setting((), "roll, pitch, yaw of each IMU in imu_link, as in a static transform (FLU); empty: 0", "deg")
    mounting_quaternion: tuple[float, ...] = setting((), "or: x, y, z, w of each IMU in imu_link (FLU)", "", -1.0, 1.0)
    lever_arm_m: tuple[float, ...] = setting((), "of each IMU in imu_link, forward, left, up, as in a static transform; empty: 0", "m", -1e3, 1e3)
    clock_offset_s: tuple[float, ...] = setting((0.0,), "stamp minus time of validity; half a sample for means over a sample", "s", -10.0, 10.0)
    gyro_sigma: tuple[float, ...] = setting((1e-3,), "white noise of a rate as it arrives: one value, or one for each IMU", "rad/s", 1e-15, 100.0)
    accel_sigma: tuple[float, ...] = setting((1e-2,), "white noise of a specific force as it arrives, likewise", "m/s^2", 1e-12, 1000.0)
    gyro_bias_sigma: float = setting(5e-3, "ordinary turn-on bias of a gyro, which must not alarm", "rad/s", 0.0, 10.0)
    accel_bias_sigma: float = setting(0.1, "ordinary turn-on bias of an accelerometer, which must not alarm", "m/s^2", 0.0, 100.0)
    gyro_scale_ppm: float = setting(0.0, "scale factor error of a gyro, 1 sigma, for the fault tests of imu_fusion", "ppm", 0.0, 1e5)
    accel_scale_ppm: float = setting(0.0, "scale factor error of an accelerometer, likewise", "ppm", 0.0, 1e5)
    gyro_misalignment_arcmin: float = setting(0.0, "tilt of a gyro's axis about each transverse axis, 1 sigma, likewise", "arcmin", 0.0, 600.0)
    accel_misalignment_arcmin: float = setting(0.0, "tilt of an accelerometer's axis, likewise", "arcmin", 0.0, 600.0)
    max_wait_s: float = setting(0.05, "an IMU is waited for at most this long beyond the bridge, by stamps of the others", "s", 0.0, 10.0)
    bridge: float = setting(2.5, "interpolated across at most this many nominal intervals of an IMU", "", 1.5, 100.0)
    max_jump_s: float = setting(2.0, "when all stamps go back by more than this the run restarts", "s", 1e-3, 600.0)
    stuck_count: int = setting(20, "equal values in a row after which an axis is taken as stuck; 0: never", "", 0, 1_000_000)
    mounting: MountingConfig = section(MountingConfig, "mounting errors")

    def __post_init__(self) -> None:
        if not 1 <= self.n <= MOST_IMUS or "" in self.topics or len(set(self.topics)) != self.n:
            raise SettingError(f'"topics" must be 1 to {MOST_IMUS} different names')
        for name in ("imu_rate_hz", "clock_offset_s", "gyro_sigma", "accel_sigma"):
            if len(getattr(self, name)) not in (1, self.n):
                raise SettingError(f'"{name}" must have 1 or {self.n} elements, not {len(getattr(self, name))}')
        for name, width in (("mounting_rpy_deg", 3), ("mounting_quaternion", 4), ("lever_arm_m", 3)):
            if len(getattr(self, name)) not in (0, width * self.n):
                raise SettingError(f'"{name}" must have 0 or {width * self.n} elements, not {len(getattr(self, name))}')
        if self.mounting_rpy_deg and self.mounting_quaternion:
            raise SettingError('"mounting_rpy_deg" and "mounting_quaternion" say the same: one of them must be empty')
        lengths = np.linalg.norm(np.reshape(self.mounting_quaternion, (-1, 4)), axis=1)
        if np.any(np.abs(lengths - 1.0) > 1e-3):
            raise SettingError('"mounting_quaternion" must be of unit length')
        if self.stuck_count == 1:
            raise SettingError('"stuck_count" must be 0 (never) or at least 2')

    @property
    def n(self) -> int:
        """Number of IMUs."""
        return len(self.topics)

    @property
    def period_ns(self) -> int:
        """Interval of the samples that go out."""
        return round(1e9 / self.rate_hz)

    def each(self, name: str) -> Array:
        """A setting for each IMU, (n,)."""
        return np.broadcast_to(np.asarray(getattr(self, name), np.float64), (self.n,))

    def rotations(self) -> Array:
        """C_i (n, 3, 3) turns the axes of IMU i into imu_link, FLU."""
        if self.mounting_quaternion:
            return dcm_from_quat(np.reshape(self.mounting_quaternion, (-1, 4)))
        rpy = np.radians(np.reshape(self.mounting_rpy_deg or (0.0,) * (3 * self.n), (-1, 3)))
        return dcm_from_euler(rpy[:, 0], rpy[:, 1], rpy[:, 2])  # the same product of turns in any right-handed axes

    def levers(self) -> Array:
        """Place of each IMU (n, 3) in its own axes, m."""
        arms = np.reshape(self.lever_arm_m or (0.0,) * (3 * self.n), (-1, 3))
        return np.einsum("nji,nj->ni", self.rotations(), arms)

    def geometry(self) -> Array:
        """Sensing axes (3 n, 3), unit vectors in imu_link FLU: x, y, z of the first IMU, of the second, ..."""
        return np.swapaxes(self.rotations(), 1, 2).reshape(-1, 3)

    def sigma(self) -> Array:
        """White noise of a value that goes out, (2, 3 n): gyros [rad/s], accelerometers [m/s^2].

        That of an accelerometer away from the common point has in it the noise of its own gyros, of whose difference the Euler force is made.
        """
        made = np.empty((2, self.n, 3))
        for i, lever in enumerate(self.levers()):
            mean, difference = noise_gains(self.each("imu_rate_hz")[i] / self.rate_hz)
            gyro, accel = self.each("gyro_sigma")[i], self.each("accel_sigma")[i]
            made[0, i] = gyro * math.sqrt(mean)
            euler = gyro * self.rate_hz * math.sqrt(difference) * np.linalg.norm(skew(lever), axis=1)
            made[1, i] = np.hypot(accel * math.sqrt(mean), euler)
        return made.reshape(2, -1)

    def fusion_parameters(self) -> dict[str, Any]:
        """Parameters of imu_fusion that go with this array; what is not here keeps its default."""
        gyro, accel = self.sigma()
        return {
            "rate_hz": self.rate_hz,
            "geometry": self.geometry().ravel().tolist(),
            "groups": [i for i in range(self.n) for _ in range(3)],
            "gyro_sigma": gyro.tolist(),
            "accel_sigma": accel.tolist(),
            "gyro_bias_sigma": self.gyro_bias_sigma,
            "accel_bias_sigma": self.accel_bias_sigma,
            "gyro_scale_ppm": self.gyro_scale_ppm,
            "accel_scale_ppm": self.accel_scale_ppm,
            "gyro_misalignment_arcmin": self.gyro_misalignment_arcmin,
            "accel_misalignment_arcmin": self.accel_misalignment_arcmin,
        }


def noise_gains(ratio: float) -> tuple[float, float]:
    """What averaging the linear interpolation does to white noise.

    Parameters
    ----------
    ratio : samples of the IMU to one output interval

    Returns
    -------
    mean : variance of the mean over an output interval, in that of a sample
    difference : variance of the difference of the interpolated values at its two ends, likewise

    Notes
    -----
    Both are averaged over the places the interval may have among the samples. Much faster IMU: 1 / ratio and 4/3; much slower: 2/3 and 2 ratio^2.
    """
    at = (np.arange(_PHASES) + 0.5)[:, None] / _PHASES
    k = np.arange(-1, math.ceil(ratio) + 3)
    begin, end = at - k, at + ratio - k
    mean = (_hat_integral(end) - _hat_integral(begin)) / ratio
    difference = _hat(end) - _hat(begin)
    return float(np.mean(np.sum(mean**2, axis=1))), float(np.mean(np.sum(difference**2, axis=1)))


def _hat(x: Array) -> Array:
    return np.maximum(0.0, 1.0 - np.abs(x))


def _hat_integral(x: Array) -> Array:
    x = np.clip(x, -1.0, 1.0)
    return np.where(x < 0.0, 0.5 * (1.0 + x) ** 2, 1.0 - 0.5 * (1.0 - x) ** 2)
