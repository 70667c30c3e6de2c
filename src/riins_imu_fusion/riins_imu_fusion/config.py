"""Settings of the fusion of redundant inertial sensors.

Lives here: `FusionConfig`; the node's ROS parameters and a scenario's `fusion` section are these.
Does not live here: how a scenario becomes a configuration (riins_eval.configure), ROS declaration (riins_node.parameters).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from riins_core import imu_array
from riins_core.frames import frd_to_flu
from riins_core.sensor_errors import ARCMIN, PPM
from riins_core.settings import SettingError, section, setting
from riins_fdi.health import HealthConfig
from riins_fdi.parity import MOST_RELATED, false_alarm_probability
from riins_imu_fusion.adaptive import AdaptiveSettings
from riins_imu_fusion.corrections import FUSION
from riins_imu_fusion.drift_compensated import CompensationSettings
from riins_imu_fusion.glr_kf import GlrSettings
from riins_imu_fusion.judges import PARITY_TESTS
from riins_imu_fusion.method import TriadModel
from riins_imu_fusion.noise_watch import NoiseSettings
from riins_imu_fusion.rfdc import RfdcSettings, too_few_or_many
from riins_imu_fusion.sequences import SEQUENTIAL_TESTS, SequenceSettings

KINDS = ("gyro", "accel")
"""The two triads, in the order of every array with a leading axis of 2."""


@dataclass(frozen=True)
class SensorHealth(HealthConfig):
    """Health settings of a sensor: at 8 sigma a slow fault fails one test now and then; three within seconds are no accident."""

    clear_count: int = setting(1, "passed tests in a row that clear a suspect", "", 1, 1_000_000)
    clear_s: float = setting(2.0, "and that reach at least this long beyond its last failed one", "s", 0.0, 1e6)


@dataclass(frozen=True)
class DriftSettings:
    """Drifts as opt, aopt and optdc expect them. Unequal values say which sensors are bad; with equal ones opt and optdc are least squares."""

    gyro_sigma: tuple[float, ...] = setting(
        (0.0,), "drift of a gyro at the start, 1 sigma: one value, or one for each; 0: its ordinary bias, else its noise", "rad/s", 0.0, 10.0
    )
    gyro_walk: tuple[float, ...] = setting((0.0,), "random walk of a gyro's drift, likewise; 0: 1e-4 of its noise", "rad/s/sqrt(s)", 0.0, 10.0)
    accel_sigma: tuple[float, ...] = setting((0.0,), "drift of an accelerometer at the start, likewise", "m/s^2", 0.0, 100.0)
    accel_walk: tuple[float, ...] = setting((0.0,), "random walk of an accelerometer's drift, likewise", "m/s^2/sqrt(s)", 0.0, 100.0)
    adaptive: AdaptiveSettings = section(AdaptiveSettings, "aopt")
    compensation: CompensationSettings = section(CompensationSettings, "optdc")
    rfdc: RfdcSettings = section(RfdcSettings, "rfdc and irfdc, which are told nothing of the above")


@dataclass(frozen=True)
class FusionConfig:
    """Everything the fusion needs to know before it starts. Default noise of one sensor: sqrt 2 times that of the ship paper's fused triad."""

    rate_hz: float = setting(100.0, "nominal sample rate", "Hz", 0.1, 100e3)
    method: str = setting("glr_kf", "how redundant samples are fused; ~/set_fusion_method changes it while running", choices=tuple(FUSION))
    parity_test: str = setting("glt", "test of each sample; likewise", choices=tuple(PARITY_TESTS))
    sequential_test: str = setting("none", "test over many samples beside it; likewise", choices=tuple(SEQUENTIAL_TESTS))
    adapt_noise: bool = setting(False, "thresholds and weights follow the noise as estimated while running; likewise")
    configuration: str = setting("dodecahedron", "geometry of the sensing axes", choices=tuple(imu_array.CONFIGURATIONS))
    geometry: tuple[float, ...] = setting((), "sensing axes as n unit vectors, row by row, FLU imu_link; empty: the configuration's", "", -1.0, 1.0)
    groups: tuple[int, ...] = setting((), "unit of each sensor, from 0; faults of several in one unit are one of all of it; empty: none", "", 0, 63)
    gyro_sigma: tuple[float, ...] = setting((8.2275e-6,), "white noise of one gyro sample: one value, or one for each", "rad/s", 1e-15, 100.0)
    accel_sigma: tuple[float, ...] = setting((1.3869e-3,), "white noise of one accelerometer sample, likewise", "m/s^2", 1e-12, 1000.0)
    gyro_bias_sigma: float = setting(0.0, "ordinary turn-on bias of a gyro, which must not alarm", "rad/s", 0.0, 10.0)
    accel_bias_sigma: float = setting(0.0, "ordinary turn-on bias of an accelerometer, which must not alarm", "m/s^2", 0.0, 100.0)
    gyro_scale_ppm: float = setting(0.0, "scale factor error of a gyro, 1 sigma, which must not alarm when the vehicle turns", "ppm", 0.0, 1e5)
    accel_scale_ppm: float = setting(0.0, "scale factor error of an accelerometer, 1 sigma, likewise when it accelerates", "ppm", 0.0, 1e5)
    gyro_misalignment_arcmin: float = setting(0.0, "tilt of a gyro's axis about each transverse axis, 1 sigma, likewise", "arcmin", 0.0, 600.0)
    accel_misalignment_arcmin: float = setting(0.0, "tilt of an accelerometer's axis, likewise", "arcmin", 0.0, 600.0)
    mean_time_between_false_alarms_h: float = setting(10.0, "of each triad, with one test a sample", "h", 1e-6, 1e9)
    false_alarm_probability: float = setting(0.0, "probability per sample and triad; 0: from the mean time between false alarms", "", 0.0, 0.5)
    health: SensorHealth = section(SensorHealth, "isolation, hold and probation of a sensor")
    glr: GlrSettings = section(GlrSettings, "when glr_kf believes in a drift, and how it is removed")
    drift: DriftSettings = section(DriftSettings, "what opt, aopt and optdc know of the drifts beforehand")
    sequence: SequenceSettings = section(SequenceSettings, "the test over many samples")
    noise: NoiseSettings = section(NoiseSettings, "estimation of the sensors' noise while running")
    probation_mean_limit: float = setting(1.0, "mean residual over the probation that prevents a return, in sigma of one residual", "", 0.01, 100.0)
    stuck_count: int = setting(10, "samples with one and the same value after which a sensor is taken as stuck; 0: never", "", 0, 1_000_000)
    gyro_limit: float = setting(0.0, "range of a gyro: at or beyond it the value is saturated; 0: none", "rad/s", 0.0, 1e4)
    accel_limit: float = setting(0.0, "range of an accelerometer: at or beyond it the value is saturated; 0: none", "m/s^2", 0.0, 1e6)
    recall_window_s: float = setting(60.0, "a fault is traced back at most this far to recall what it put in; 0: nothing is", "s", 0.0, 3600.0)
    recall_false_alarm_probability: float = setting(1e-3, "probability that a fault is found in the past of a sensor that had none", "", 1e-12, 0.5)
    max_delay_s: float = setting(2.0, "a stamp that jumps by more than this, back or forward, restarts the run", "s", 1e-3, 600.0)
    status_period_s: float = setting(0.1, "interval of the periodic status, measurement time", "s", 1e-3, 3600.0)

    def __post_init__(self) -> None:
        if self.health.probation_count != 1:
            raise SettingError('"health.probation_count" must be 1: the probation of a sensor is measured in time, by "health.probation_s"')
        if self.stuck_count == 1:
            raise SettingError('"stuck_count" must be 0 (never) or at least 2')
        n = self.array().n
        if self.parity_test == "direct_comparison" and n > MOST_RELATED:
            raise SettingError(f'"parity_test": direct_comparison takes at most {MOST_RELATED} sensors, not {n}')
        if self.method in ("rfdc", "irfdc") and (problem := too_few_or_many(self.method, n)):
            raise SettingError(f'"method": {problem}')
        if len(self.groups) not in (0, n):
            raise SettingError(f'"groups" must have 0 or {n} elements, not {len(self.groups)}')
        if self.groups and max(self.groups) >= n:
            raise SettingError(f'"groups" must be numbers below {n}')
        for kind in KINDS:
            for name, given in ((f"{kind}_sigma", self), (f"drift.{kind}_sigma", self.drift), (f"drift.{kind}_walk", self.drift)):
                length = len(getattr(given, name.rpartition(".")[2]))
                if length not in (1, n):
                    raise SettingError(f'"{name}" must have 1 or {n} elements, not {length}')

    def array(self) -> imu_array.ImuArray:
        """Geometry in body axes FRD, the same for gyros and accelerometers.

        Raises
        ------
        SettingError
            `geometry` is not n x 3, not of unit rows, or of rank below 3.
        """
        if not self.geometry:
            return imu_array.ImuArray(imu_array.CONFIGURATIONS[self.configuration])
        if len(self.geometry) % 3:
            raise SettingError(f'"geometry" must have three elements for each sensor, not {len(self.geometry)} in all')
        try:
            return imu_array.ImuArray(frd_to_flu(np.reshape(self.geometry, (-1, 3))))  # its own inverse
        except ValueError as error:
            raise SettingError(f'"geometry": {error}') from None

    def sigma(self) -> NDArray[np.float64]:
        """White noise of a sample, (2, n): gyros [rad/s], accelerometers [m/s^2]."""
        n = self.array().n
        return np.stack([np.broadcast_to(self.gyro_sigma, (n,)), np.broadcast_to(self.accel_sigma, (n,))])

    def total_sigma(self) -> NDArray[np.float64]:
        """Noise and ordinary bias together, (2, n): what the parity of healthy sensors is made of."""
        return np.hypot(self.sigma(), np.array([[self.gyro_bias_sigma], [self.accel_bias_sigma]]))

    def motion_errors(self) -> NDArray[np.float64]:
        """Standard deviations of scale factor and of the tilt of a sensing axis [rad], (2, 2): gyros, accelerometers."""
        ppm, arcmin = (self.gyro_scale_ppm, self.accel_scale_ppm), (self.gyro_misalignment_arcmin, self.accel_misalignment_arcmin)
        return np.stack([np.multiply(ppm, PPM), np.multiply(arcmin, ARCMIN)], axis=1)

    def drift_models(self) -> tuple[TriadModel, TriadModel]:
        """What opt, aopt and optdc know of the gyros and of the accelerometers beforehand."""
        array, sigma, made = self.array(), self.sigma(), []
        for k, kind in enumerate(KINDS):
            given, walk = (np.broadcast_to(getattr(self.drift, f"{kind}_{name}"), (array.n,)) for name in ("sigma", "walk"))
            bias = getattr(self, f"{kind}_bias_sigma")
            given = np.where(given > 0.0, given, bias or sigma[k])
            walk = np.where(walk > 0.0, walk, 1e-4 * sigma[k]) / math.sqrt(self.rate_hz)
            made.append(TriadModel(array, sigma[k], given, walk, 1.0 / self.rate_hz))
        return made[0], made[1]

    def pfa(self) -> float:
        """False-alarm probability per sample and triad."""
        return self.false_alarm_probability or false_alarm_probability(self.mean_time_between_false_alarms_h, self.rate_hz)

    def limits(self) -> NDArray[np.float64]:
        """Range limits (2,), infinite where there is none."""
        return np.array([self.gyro_limit or math.inf, self.accel_limit or math.inf])
