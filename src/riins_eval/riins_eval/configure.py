"""From a scenario to the settings of the fusion and of the navigator, the same for the live graph and the offline engine.

Lives here: `fusion_config`, `navigator_config`, `configuration_text`; a scenario's `fusion` and `navigator` sections have the last word.
Does not live here: the settings classes (riins_imu_fusion.pipeline, riins_federated.config), the graph (riins_bringup.graph).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import yaml

from riins_core.earth import STANDARD_GRAVITY
from riins_core.imu_array import CONFIGURATIONS
from riins_core.sensor_errors import KNOT
from riins_core.settings import SettingError, as_mapping, build
from riins_federated.aids import DEFAULT_AIDS
from riins_federated.config import NavigatorConfig
from riins_imu_fusion.config import FusionConfig
from riins_sim.scenario import Scenario

ABSENT_AFTER = 3.5
"""An aid is absent after this many of its intervals."""
MISALIGNMENT_MARGIN = 2.0
"""The filter's sigma of the log's mounting yaw over the scenario's: the truth is drawn from the latter, the filter may not count on it."""


_SENSORS = ("gps", "bds", "doppler", "odometer", "altimeter", "star_tracker")
CONSTANT_S = 1e7
"""Correlation time of what does not change."""


def merged(base: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """Nested mapping with the values of `over` in place of those of `base`."""
    result = dict(base)
    for key, value in over.items():
        inner = result.get(key)
        result[key] = merged(inner, value) if isinstance(inner, Mapping) and isinstance(value, Mapping) else value
    return result


def redeclared(base: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """Settings of a navigator with those of `over` in their place; sections of aids that a new list no longer names are left out."""
    result = merged(base, over)
    names = over.get("aids")
    if isinstance(names, list | tuple):
        gone = {name for name in base.get("aids", DEFAULT_AIDS) if name not in names and name not in over}
        result = {key: value for key, value in result.items() if key not in gone}
    return result


def navigator_config(scenario: Scenario) -> NavigatorConfig:
    """Settings of the navigator that know the sensors of a scenario as their data sheets do.

    Parameters
    ----------
    scenario : Scenario; its `navigator` section overrides

    Returns
    -------
    NavigatorConfig

    Raises
    ------
    SettingError
        The scenario's `navigator` section names an unknown setting, or one out of range.
    """
    n = CONFIGURATIONS[scenario.imu.configuration].shape[0]
    surface = not scenario.altimeter.enabled and not any(leg.climb_m for leg in scenario.legs)  # a ship keeps her mean height
    fused = math.sqrt(3.0 / n)  # H'H = n/3 I: n equal sensors make a triad this much better
    gyro, accel, log = scenario.imu.gyro, scenario.imu.accel, scenario.doppler
    settings: dict[str, Any] = {
        "inertial": {
            "gyro_bias_deg_h": gyro.constant_drift_deg_h * fused,
            "gyro_markov_deg_h": gyro.markov_drift_deg_h * fused,
            "gyro_markov_time_s": gyro.markov_time_s,
            "gyro_arw_deg_sqrt_h": max(gyro.arw_deg_sqrt_h * fused, 1e-6),
            "gyro_bias_walk_deg_h_sqrt_h": gyro.random_walk_deg_h_sqrt_h * fused,
            "accel_bias_ug": math.hypot(accel.bias_ug, accel.markov_bias_ug) * fused,
            "accel_vrw_ug_sqrt_hz": max(accel.vrw_ug_sqrt_hz * fused, 1e-3),
            "accel_bias_walk_ug_sqrt_h": accel.random_walk_ug_sqrt_h * fused,
            "bias_steps": fusion_config(scenario).method != "glr_kf",
        },
        "doppler": {
            "enabled": log.enabled,
            "sigma_mps": [s * KNOT for s in log.sigma_kn],
            "misalignment_deg": min(MISALIGNMENT_MARGIN * log.misalignment_deg, 90.0),
            "scale_ppm": log.scale_ppm,
            "use_down": not surface,
            "lever_arm_m": list(log.lever_arm_m),
            "period_s": log.period_s,
            "timeout_s": ABSENT_AFTER * log.period_s,
        },
        "height": {"enabled": surface, "mean_m": scenario.start.height_m},
    }
    aids = ["gps", "bds", "doppler"]
    for name in ("gps", "bds"):
        receiver = getattr(scenario, name)
        settings[name] = {
            "enabled": receiver.enabled,
            "sigma_m": list(receiver.sigma_m),
            "markov_sigma_m": receiver.markov_sigma_m,
            "markov_time_s": receiver.markov_time_s,
            "use_height": not surface,
            "lever_arm_m": list(receiver.lever_arm_m),
            "period_s": receiver.period_s,
            "timeout_s": ABSENT_AFTER * receiver.period_s,
        }
    further = _further_aids(scenario)
    settings |= {"aids": [*aids, *further], **further}
    return build(NavigatorConfig, redeclared(settings, scenario.navigator), ("navigator",))


def _further_aids(scenario: Scenario) -> dict[str, dict[str, Any]]:
    """Sections of the aids that a scenario has beside receivers and log."""
    found: dict[str, dict[str, Any]] = {}
    if (wheels := scenario.odometer).enabled:
        found["odometer"] = {
            "type": "odometer", "sigma_mps": wheels.sigma_mps, "sideways_mps": wheels.sideways_sigma_mps, "down_mps": wheels.down_sigma_mps,
            "scale_ppm": wheels.scale_ppm, "misalignment_deg": 0.0, "lever_arm_m": list(wheels.lever_arm_m), "axle_m": [0.0, 0.0, 0.0],
        }  # fmt: skip
    if (barometer := scenario.altimeter).enabled:
        slow = math.hypot(barometer.bias_m, barometer.markov_sigma_m)
        found["altimeter"] = {
            "type": "height", "sigma_m": barometer.sigma_m, "markov_sigma_m": slow, "markov_state": True,
            "markov_time_s": barometer.markov_time_s if barometer.markov_sigma_m else CONSTANT_S, "lever_arm_m": list(barometer.lever_arm_m),
        }  # fmt: skip
    if (stars := scenario.star_tracker).enabled:
        found["star_tracker"] = {
            "type": "attitude", "sigma_deg": [s / 3600.0 for s in stars.sigma_arcsec], "misalignment_deg": stars.misalignment_arcsec / 3600.0,
        }  # fmt: skip
    for name, section in found.items():
        period_s = getattr(scenario, name).period_s
        section |= {"period_s": period_s, "timeout_s": ABSENT_AFTER * period_s}
    return found


def fusion_config(scenario: Scenario) -> FusionConfig:
    """Settings of the fusion that know the redundant IMU of a scenario as its data sheet does.

    Parameters
    ----------
    scenario : Scenario; its `fusion` section overrides

    Returns
    -------
    FusionConfig

    Raises
    ------
    SettingError
        The scenario's `fusion` section names an unknown setting, or one out of range.
    """
    imu, dt = scenario.imu, 1.0 / scenario.imu_rate_hz
    gyro, accel = imu.gyro.si(), imu.accel.si()
    settings: dict[str, Any] = {
        "rate_hz": float(scenario.imu_rate_hz),
        "configuration": imu.configuration,
        "gyro_sigma": [max(gyro.white_sigma(dt), 1e-12)],
        "accel_sigma": [max(accel.white_sigma(dt), 1e-9)],
        "gyro_bias_sigma": math.hypot(gyro.constant, gyro.markov),
        "accel_bias_sigma": math.hypot(accel.constant, accel.markov),
        "gyro_scale_ppm": imu.gyro.scale_ppm,
        "accel_scale_ppm": imu.accel.scale_ppm,
        "gyro_misalignment_arcmin": imu.gyro.misalignment_arcmin,
        "accel_misalignment_arcmin": imu.accel.misalignment_arcmin,
        "gyro_limit": math.radians(imu.gyro_range_deg_s),
        "accel_limit": imu.accel_range_g * STANDARD_GRAVITY,
    }
    return build(FusionConfig, merged(settings, scenario.fusion), ("fusion",))


def simulated_fusion_config(scenario: Scenario) -> FusionConfig:
    """The same for an IMU that is simulated, whose axes are those of the scenario's configuration.

    Raises
    ------
    SettingError
        As `fusion_config`, or the fusion has another number of axes.
    """
    config, simulated = fusion_config(scenario), CONFIGURATIONS[scenario.imu.configuration].shape[0]
    if config.array().n != simulated:
        raise SettingError(f'"fusion.geometry" has {config.array().n} axes, the simulated IMU ({scenario.imu.configuration}) has {simulated}')
    return config


def configuration_text(scenario: Scenario, start_at_ns: int = 0, fusion: FusionConfig | None = None, navigator: NavigatorConfig | None = None) -> str:
    """What `/riins/configuration` says, so that a bag can be navigated and scored with nothing else at hand.

    Parameters
    ----------
    scenario : Scenario
    start_at_ns : measurement time of sample 0, ns
    fusion, navigator : settings in force; None: those of the scenario

    Returns
    -------
    YAML text with the keys start_at_ns, scenario, fusion, navigator, geometry (n x 3, FLU imu_link) and frames
    """
    fusion = fusion or fusion_config(scenario)
    flu = fusion.array().H * np.array([1.0, -1.0, -1.0])
    lever_arms = {
        f"{name}_link": [float(v) for v in flip(getattr(getattr(scenario, name), "lever_arm_m", (0.0, 0.0, 0.0)))]
        for name in _SENSORS
        if getattr(scenario, name).enabled
    }
    return str(
        yaml.safe_dump(
            {
                "start_at_ns": start_at_ns,
                "scenario": yaml.safe_load(scenario.to_yaml()),
                "fusion": as_mapping(fusion),
                "navigator": as_mapping(navigator or navigator_config(scenario)),
                "geometry": flu.tolist(),
                "frames": {"parent": "base_link", "axes": "FLU", "translation_m": {"imu_link": [0.0, 0.0, 0.0], **lever_arms}},
            },
            sort_keys=False,
            allow_unicode=True,
            default_flow_style=None,
            width=150,
        )
    )


def flip(frd: tuple[float, ...]) -> tuple[float, float, float]:
    """A vector in FRD as one in FLU; its own inverse."""
    return frd[0], -frd[1] + 0.0, -frd[2] + 0.0
