"""Stochastic errors of single-axis inertial sensors: data sheet settings, and what a sensor with them reads.

Lives here: `GyroErrors`, `AccelErrors` (units of data sheets, in the key), `InertialErrors` (SI), `SensorErrors` (drawn for n sensors, addressed by
sample number). Does not live here: the random sequences (noise.py), faults (riins_sim.faults), error states of a filter (ins_error.py).
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .earth import STANDARD_GRAVITY
from .jit import jit
from .noise import GaussMarkov, RandomWalk, normal
from .settings import setting

__all__ = [
    "ARCMIN", "ARCSEC", "DEG", "DEG_PER_H", "DEG_PER_SQRT_H", "KNOT", "MICRO_G", "PPM", "AccelErrors", "GaussMarkov", "GyroErrors",
    "InertialErrors", "RandomWalk", "SensorErrors", "normal",
]  # fmt: skip

Array = NDArray[np.float64]

DEG = math.pi / 180.0
"""rad"""
ARCMIN = DEG / 60.0
"""rad"""
ARCSEC = DEG / 3600.0
"""rad"""
DEG_PER_H = DEG / 3600.0
"""rad/s"""
DEG_PER_SQRT_H = DEG / 60.0
"""rad/sqrt(s)"""
MICRO_G = 1e-6 * STANDARD_GRAVITY
"""m/s^2; per sqrt(Hz) also m/s/sqrt(s)"""
PPM = 1e-6
KNOT = 1852.0 / 3600.0
"""m/s"""


@dataclass(frozen=True)
class InertialErrors:
    """One-sigma errors of one kind of sensor in SI units; U stands for rad/s or m/s^2.

    Attributes
    ----------
    constant : bias of a run, U
    markov, markov_time : bias instability as a first-order Gauss-Markov process, U and s
    random_walk : random walk of the bias, U/sqrt(s)
    white : angle or velocity random walk, U/sqrt(Hz)
    scale : scale factor error
    misalignment : tilt of the sensing axis about each of two transverse axes, rad
    """

    constant: float = 0.0
    markov: float = 0.0
    markov_time: float = 3600.0
    random_walk: float = 0.0
    white: float = 0.0
    scale: float = 0.0
    misalignment: float = 0.0

    def white_sigma(self, dt: float) -> float:
        """Standard deviation of the white part of a mean over dt [s], U: density / sqrt(dt).

        The thesis' R of tables 5.1/5.2 equals (0.01 deg/sqrt h)^2 without the 1/dt; as used, per 50 ms sample, it is 0.0022 deg/sqrt h.
        """
        return self.white / math.sqrt(dt)

    def combined(self, factor: float) -> InertialErrors:
        """All sigmas times `factor`: sqrt(n / 3) turns errors of a fused triad into those of each of n sensors, errata 003."""
        names = ("constant", "markov", "random_walk", "white", "scale", "misalignment")
        return dataclasses.replace(self, **{name: factor * getattr(self, name) for name in names})


@dataclass(frozen=True)
class GyroErrors:
    """Errors of one gyro as its data sheet has them; one sigma each."""

    constant_drift_deg_h: float = setting(0.0, "constant drift, drawn once for each gyro", "deg/h", 0.0, 1e5)
    markov_drift_deg_h: float = setting(0.0, "bias instability as a Gauss-Markov process", "deg/h", 0.0, 1e5)
    markov_time_s: float = setting(3600.0, "correlation time of the Gauss-Markov drift", "s", 0.1, 1e7)
    random_walk_deg_h_sqrt_h: float = setting(0.0, "rate random walk", "deg/h/sqrt(h)", 0.0, 1e5)
    arw_deg_sqrt_h: float = setting(0.0, "angle random walk", "deg/sqrt(h)", 0.0, 1e3)
    scale_ppm: float = setting(0.0, "scale factor error", "ppm", 0.0, 1e5)
    misalignment_arcmin: float = setting(0.0, "tilt of the sensing axis about each transverse axis", "arcmin", 0.0, 600.0)

    def si(self) -> InertialErrors:
        """The same in SI units."""
        return InertialErrors(
            constant=self.constant_drift_deg_h * DEG_PER_H,
            markov=self.markov_drift_deg_h * DEG_PER_H,
            markov_time=self.markov_time_s,
            random_walk=self.random_walk_deg_h_sqrt_h * DEG_PER_H / 60.0,
            white=self.arw_deg_sqrt_h * DEG_PER_SQRT_H,
            scale=self.scale_ppm * PPM,
            misalignment=self.misalignment_arcmin * ARCMIN,
        )


@dataclass(frozen=True)
class AccelErrors:
    """Errors of one accelerometer as its data sheet has them; one sigma each."""

    bias_ug: float = setting(0.0, "constant bias, drawn once for each accelerometer", "ug", 0.0, 1e6)
    markov_bias_ug: float = setting(0.0, "bias instability as a Gauss-Markov process", "ug", 0.0, 1e6)
    markov_time_s: float = setting(3600.0, "correlation time of the Gauss-Markov bias", "s", 0.1, 1e7)
    random_walk_ug_sqrt_h: float = setting(0.0, "bias random walk", "ug/sqrt(h)", 0.0, 1e6)
    vrw_ug_sqrt_hz: float = setting(0.0, "velocity random walk", "ug/sqrt(Hz)", 0.0, 1e6)
    scale_ppm: float = setting(0.0, "scale factor error", "ppm", 0.0, 1e5)
    misalignment_arcmin: float = setting(0.0, "tilt of the sensing axis about each transverse axis", "arcmin", 0.0, 600.0)

    def si(self) -> InertialErrors:
        """The same in SI units."""
        return InertialErrors(
            constant=self.bias_ug * MICRO_G,
            markov=self.markov_bias_ug * MICRO_G,
            markov_time=self.markov_time_s,
            random_walk=self.random_walk_ug_sqrt_h * MICRO_G / 60.0,
            white=self.vrw_ug_sqrt_hz * MICRO_G,
            scale=self.scale_ppm * PPM,
            misalignment=self.misalignment_arcmin * ARCMIN,
        )


@jit
def _measure(axes: Array, gain: Array, true: Array, error: Array) -> None:
    for i in range(true.shape[0]):
        for j in range(axes.shape[0]):
            along = axes[j, 0] * true[i, 0] + axes[j, 1] * true[i, 1] + axes[j, 2] * true[i, 2]
            error[i, j] += gain[j] * along


class SensorErrors:
    """Errors drawn for n sensors of one kind, each a pure function of the sample number.

    Parameters
    ----------
    errors : one-sigma values of each sensor, SI
    H : (n, 3), nominal sensing axes
    dt : sample interval, s
    seed : of the run
    name : of the group ("gyro", "accel"); different names draw independently

    Attributes
    ----------
    constant : (n,), the biases drawn, U
    scale : (n,), the scale factor errors drawn
    axes : (n, 3), the true sensing axes, unit length
    """

    def __init__(self, errors: InertialErrors, H: ArrayLike, dt: float, seed: int, name: str) -> None:
        nominal = np.asarray(H, dtype=np.float64)
        n = nominal.shape[0]
        self.errors, self.n, self.dt, self.seed, self.name = errors, n, dt, seed, name
        self.constant: Array = errors.constant * normal(seed, f"{name}/constant", 0, 1, n)[0]
        self.scale: Array = errors.scale * normal(seed, f"{name}/scale", 0, 1, n)[0]
        tilt = normal(seed, f"{name}/misalignment", 0, 3, n).T
        tilt -= np.sum(tilt * nominal, axis=1, keepdims=True) * nominal  # the two transverse axes remain
        axes = nominal + errors.misalignment * tilt
        self.axes: Array = axes / np.linalg.norm(axes, axis=1, keepdims=True)
        self._gain = 1.0 + self.scale
        self._white = errors.white_sigma(dt)
        self._markov = GaussMarkov(errors.markov, errors.markov_time, dt, seed, f"{name}/markov", n) if errors.markov else None
        self._walk = RandomWalk(errors.random_walk * math.sqrt(dt), seed, f"{name}/walk", n) if errors.random_walk else None

    def bias(self, k0: int, m: int) -> Array:
        """Bias of samples k0 .. k0 + m - 1 (constant, Gauss-Markov and random walk), (m, n), U."""
        bias = np.tile(self.constant, (m, 1))
        if self._markov is not None:
            bias += self._markov.block(k0, m)
        if self._walk is not None:
            bias += self._walk.block(k0, m)
        return bias

    def white(self, k0: int, m: int) -> Array:
        """White noise of samples k0 .. k0 + m - 1, means over dt, (m, n), U."""
        if not self._white:
            return np.zeros((m, self.n))
        return self._white * normal(self.seed, f"{self.name}/white", k0, m, self.n)

    def measure(self, k0: int, true: Array) -> Array:
        """What the sensors read.

        Parameters
        ----------
        k0 : sample number of the first row
        true : (m, 3), true mean rate or specific force in the body frame, U

        Returns
        -------
        (m, n), (1 + scale) axes . true + bias + white noise; the same bits however the samples are split into calls
        """
        m = true.shape[0]
        reading = self.bias(k0, m)
        reading += self.white(k0, m)
        _measure(self.axes, self._gain, np.ascontiguousarray(true), reading)
        return reading
