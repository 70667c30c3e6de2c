"""What the filter assumes of the fused inertial triad: the settings section `inertial`.

Lives here: `InertialModel`.
Does not live here: the states that come of it (state_blocks.py), the other settings (config.py).
"""

from __future__ import annotations

from dataclasses import dataclass

from riins_core.settings import setting


@dataclass(frozen=True)
class InertialModel:
    """Error model of the fused triad, as the filter assumes it."""

    gyro_bias_deg_h: float = setting(0.01, "sigma of the constant gyro bias", "deg/h", 0.0, 1e5)
    gyro_markov_deg_h: float = setting(0.003, "sigma of the first-order Gauss-Markov gyro drift (gyro_markov); 0: none", "deg/h", 0.0, 1e5)
    gyro_markov_time_s: float = setting(3600.0, "correlation time of the Gauss-Markov gyro drift", "s", 1.0, 1e7)
    gyro_arw_deg_sqrt_h: float = setting(0.002, "angle random walk", "deg/sqrt(h)", 1e-9, 1e3)
    gyro_bias_walk_deg_h_sqrt_h: float = setting(0.0, "random walk of the gyro bias", "deg/h/sqrt(h)", 0.0, 1e5)
    gyro_scale_ppm: float = setting(50.0, "sigma of the gyro scale factors (gyro_scale); 0: none", "ppm", 0.0, 1e6)
    accel_bias_ug: float = setting(50.0, "sigma of the constant accelerometer bias", "ug", 0.0, 1e6)
    accel_markov_ug: float = setting(10.0, "sigma of the first-order Gauss-Markov accelerometer bias (accel_markov); 0: none", "ug", 0.0, 1e6)
    accel_markov_time_s: float = setting(3600.0, "correlation time of the Gauss-Markov accelerometer bias", "s", 1.0, 1e7)
    accel_vrw_ug_sqrt_hz: float = setting(10.0, "velocity random walk, as noise density", "ug/sqrt(Hz)", 1e-9, 1e6)
    follow_covariance: bool = setting(True, "where the covariance of fused samples exceeds this model, as after an isolation, it is believed")
    bias_steps: bool = setting(True, "the fused bias steps when other sensors are fused, as with wls; glr_kf has learned the biases and keeps it")
    accel_bias_walk_ug_sqrt_h: float = setting(0.0, "random walk of the accelerometer bias", "ug/sqrt(h)", 0.0, 1e6)
    accel_scale_ppm: float = setting(100.0, "sigma of the accelerometer scale factors (accel_scale); 0: none", "ppm", 0.0, 1e6)
