"""Settings of an import: a scenario for a recording that says little of itself, and the faults that are put into it.

Lives here: `import_scenario`, `recording_settings`, `read_fault_list` and the defaults.
Does not live here: the import (importers.py), the settings classes (riins_sim.scenario).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from riins_core.earth import STANDARD_GRAVITY
from riins_core.frames import frd_to_flu
from riins_core.settings import SettingError, build
from riins_sim.course import KNOT
from riins_sim.faults import FaultSettings
from riins_sim.scenario import Scenario

from . import configure
from .npz_recording import ImportFailure, NpzRecording
from .several_imus import BANDWIDTH, RecordingSettings, Stacked

SURFACE_RANGE_M = 10.0
"""A vehicle whose height stays within this is taken for a ship, which keeps to its mean height."""
DEFAULTS: dict[str, Any] = {
    "imu": {"gyro": {"arw_deg_sqrt_h": 0.02}, "accel": {"vrw_ug_sqrt_hz": 50.0}},
    "gps": {"period_s": 1.0, "sigma_m": [3.0, 3.0, 6.0], "velocity_sigma_mps": 0.1},
    "bds": {"period_s": 1.0, "sigma_m": [5.0, 5.0, 10.0], "velocity_sigma_mps": 0.15},
    "initial": {"position_m": 5.0, "height_m": 2.0, "velocity_mps": 0.1, "tilt_arcsec": 120.0, "heading_arcmin": 30.0},
    "scoring": {"from_s": 60.0},
}
"""Sections of a scenario for a recording that says nothing of them. The IMU's noise is what is put on each sensor, beside the recorded one."""
INERTIAL = {"gyro_bias_deg_h": 0.1, "gyro_markov_deg_h": 0.02, "gyro_arw_deg_sqrt_h": 0.1, "accel_bias_ug": 500.0, "accel_vrw_ug_sqrt_hz": 300.0}
"""What the filter assumes of a recorded IMU it does not know: navigation grade, with room for vibration and the reference's own attitude noise."""
SMALL_IMU_INITIAL = {"tilt_arcsec": 3600.0, "heading_arcmin": 120.0}
"""Start of a vehicle with several small IMUs: its reference and its IMUs are aligned to a degree or so."""
VIBRATION = 5.0
"""Noise of a vibrating small IMU, common to all and so not seen in their differences, over that in their differences."""
COMMON_BIAS = 4.0
"""Sigma of the bias that small gyros of one make have in common, which no comparison shows, over the turn-on bias of each (seen: 1.4 deg/s of .3)."""
GNSS_FLOOR_M = 0.3
"""Of a recorded receiver: what delay and lever arm make of its centimetres on a vehicle that manoeuvres."""
LOG_FLOOR_MPS = 0.05
"""A log states its white noise; mounting, sound speed and current make errors that last, and the filter has no state for those."""


def import_scenario(
    recording: NpzRecording,
    seed: int,
    noise: bool,
    faults: list[dict[str, Any]],
    options: Mapping[str, Any],
    settings: RecordingSettings | None = None,
) -> Scenario:
    """The settings of an import in the form of a scenario, so that everything that reads one reads them.

    Parameters
    ----------
    recording : what there is: log, GNSS, reference, rate, lever arms
    seed, noise : as in importers.import_npz
    faults : of `read_fault_list`
    options : sections of a scenario that replace DEFAULTS
    settings : turn-on biases of several IMUs

    Returns
    -------
    Scenario; of several IMUs its `fusion` section holds geometry, noise and turn-on biases, so that the bag alone says them

    Raises
    ------
    ImportFailure
        A setting is unknown or out of range.
    """
    settings = settings or RecordingSettings()
    height = [p.reference[:, 3] for p in recording.pieces]
    known = np.concatenate(height)[np.isfinite(np.concatenate(height))]
    surface = recording.reference_range_m() <= SURFACE_RANGE_M
    reference = any(np.isfinite(p.reference).all(axis=1).sum() > 1 for p in recording.pieces)
    gnss = any(len(p.gnss) for p in recording.pieces)
    log = any(len(p.log_t) for p in recording.pieces)
    first = next(
        (p.reference[np.isfinite(p.reference).all(axis=1)][0] for p in recording.pieces if np.isfinite(p.reference).all(axis=1).any()), np.zeros(10)
    )
    sigma = recording.log_sigma if recording.log_sigma is not None else np.full(3, 0.05)
    lever = recording.log_lever if recording.log_lever is not None else np.zeros(3)
    several = recording.stacked
    times = np.concatenate([p.log_t[:-1] for p in recording.pieces if len(p.log_t) > 1] or [np.zeros(0)])
    steps = np.concatenate([np.diff(p.log_t) for p in recording.pieces if len(p.log_t) > 1] or [np.ones(1)])
    own = configure.merged(DEFAULTS, {
        "name": "".join(c if c.isalnum() or c in "_-" else "_" for c in recording.path.stem) or "recording",
        "description": f"Recording {recording.path.name}.",
        "seed": seed,
        "duration_s": max(1.0, *(float(p.t[-1] - p.t[0]) for p in recording.pieces)),
        "imu_rate_hz": recording.rate_hz,
        "start": {"latitude_deg": float(np.degrees(first[1])), "longitude_deg": float(np.degrees(first[2])),
                  "height_m": float(np.mean(known)) if len(known) else 0.0},
        "doppler": {"enabled": log, "period_s": float(np.median(steps)) if len(times) else 1.0, "sigma_kn": (sigma / KNOT).tolist(),
                    "misalignment_deg": 0.25, "lever_arm_m": lever.tolist()},
        "gps": {"enabled": gnss or reference},
        "bds": {"enabled": reference and several is None},
        "navigator": {
            "inertial": INERTIAL if several is None else _inertial(several, settings),
            "height": {"enabled": surface},
            "gps": {"use_height": not surface} | ({} if several is None else {"sigma_floor_m": GNSS_FLOOR_M}),
            "bds": {"use_height": not surface},
            "doppler": {"use_down": not surface, "sigma_floor_mps": LOG_FLOOR_MPS},
        },
        "faults": faults,
    })  # fmt: skip
    if several is not None:
        own = configure.merged(own, {"fusion": _fusion(several, settings), "initial": SMALL_IMU_INITIAL})
    if gnss and recording.gnss_sigma is not None:
        own["gps"] = configure.merged(
            own["gps"], {"sigma_m": recording.gnss_sigma[:3].tolist(), "velocity_sigma_mps": float(recording.gnss_sigma[3])}
        )
    values = configure.merged(own, options)
    if not noise and several is None:
        values = configure.merged(values, {"imu": {"gyro": {"arw_deg_sqrt_h": 0.0}, "accel": {"vrw_ug_sqrt_hz": 0.0}}})
    try:
        scenario = build(Scenario, values)
        configure.fusion_config(scenario)
        configure.navigator_config(scenario)
    except SettingError as error:
        raise ImportFailure(f"settings of the import: {error}") from None
    if scenario.initial.self_aligned:
        raise ImportFailure("settings of the import: initial.self_aligned needs simulated sensors, whose biases are known")
    return scenario


def _fusion(several: Stacked, settings: RecordingSettings) -> dict[str, Any]:
    """What the fusion is told: the white noise whose sums grow as those of the low-passed noise do."""
    white = float(np.sqrt(max(1.0, several.rate_hz / (2.0 * BANDWIDTH * several.lowpass_hz)))) if several.lowpass_hz else 1.0
    return {
        "geometry": frd_to_flu(several.axes).ravel().tolist(),
        "gyro_sigma": (white * several.gyro_sigma).tolist(),
        "accel_sigma": (white * several.accel_sigma).tolist(),
        "gyro_bias_sigma": float(np.radians(settings.gyro_turn_on_deg_s)),
        "accel_bias_sigma": settings.accel_turn_on_mps2,
        "gyro_limit": 0.0,  # their ranges are not known
        "accel_limit": 0.0,
    }


def _inertial(several: Stacked, settings: RecordingSettings) -> dict[str, Any]:
    """What the filter assumes of the mean of several small IMUs: their biases, and what vibration and scale factors put on top of them."""
    fused, n = float(np.sqrt(3.0 / len(several.axes))), several.rate_hz
    gyro, accel = (float(np.sqrt(np.mean(s**2))) * fused for s in (several.gyro_sigma, several.accel_sigma))
    # slow noise of the sensors is as long as the low-pass, not one sample
    length = np.sqrt(0.5 / several.lowpass_hz if several.lowpass_hz else 1.0 / n)
    return {
        "gyro_bias_deg_h": COMMON_BIAS * settings.gyro_turn_on_deg_s * 3600.0,
        "gyro_markov_deg_h": 0.5 * settings.gyro_turn_on_deg_s * 3600.0 * fused,
        "gyro_markov_time_s": 60.0,
        "gyro_arw_deg_sqrt_h": float(VIBRATION * np.degrees(gyro) * length * 60.0),
        "accel_bias_ug": settings.accel_turn_on_mps2 / STANDARD_GRAVITY * 1e6,
        "accel_vrw_ug_sqrt_hz": VIBRATION * accel / STANDARD_GRAVITY * 1e6 * float(length),
        "accel_bias_walk_ug_sqrt_h": 3.0 * settings.accel_turn_on_mps2 / STANDARD_GRAVITY * 1e6 * fused,
    }


def recording_settings(options: Mapping[str, Any]) -> tuple[RecordingSettings, dict[str, Any]]:
    """Section `recording` of the options of an import, and the other sections.

    Raises
    ------
    ImportFailure
        A setting is unknown or out of range.
    """
    rest = dict(options)
    try:
        return build(RecordingSettings, rest.pop("recording", {}), ("recording",)), rest
    except SettingError as error:
        raise ImportFailure(f"settings of the import: {error}") from None


def read_fault_list(given: str | Path | Sequence[Mapping[str, Any]] | None) -> list[dict[str, Any]]:
    """Faults as in a scenario, checked: the list itself, or a YAML file with a list (or with the key `faults`).

    Raises
    ------
    ImportFailure
        The file cannot be read, or a fault makes no sense; its number is named.
    """
    if given is None:
        return []
    where = "faults"
    if isinstance(given, str | Path):
        where = str(given)
        try:
            given = yaml.safe_load(Path(given).read_text(encoding="utf-8"))
        except OSError as error:
            raise ImportFailure(f"{where}: cannot be read: {error.strerror}") from None
        except (yaml.YAMLError, ValueError) as error:  # also bytes that are no text, a date that is none
            raise ImportFailure(f"{where}: {' '.join(str(error).split())}") from None
        if isinstance(given, Mapping) and set(given) == {"faults"}:
            given = given["faults"]
    if not isinstance(given, Sequence) or isinstance(given, str):
        raise ImportFailure(f"{where}: a list of faults is wanted, each like {{target: gps, type: step, size_m: 60, start_s: 100, end_s: 200}}")
    for number, entry in enumerate(given):
        try:
            build(FaultSettings, entry)
        except SettingError as error:
            raise ImportFailure(f"{where}: fault {number + 1}: {error}") from None
    return [dict(entry) for entry in given]
