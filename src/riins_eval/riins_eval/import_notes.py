"""What an import tells its reader: what is real, what is simulated, what was found and what was left out.

Lives here: `import_notes`, `simulated_aids`.
Does not live here: the import (importers.py), the settings that are told of (import_settings.py).
"""

from __future__ import annotations

import numpy as np

from riins_sim.scenario import Scenario

from . import configure
from .npz_recording import NpzRecording

GAP_S = 10.0
"""Between the pieces of a recording in the bag: longer than any max_delay, so that the run restarts, and no longer to wait for than that."""


def simulated_aids(recording: NpzRecording, scenario: Scenario) -> list[str]:
    """The aids that the recording does not have."""
    recorded = any(len(p.gnss) for p in recording.pieces)
    return [name for name in ("gps", "bds") if getattr(scenario, name).enabled and not (name == "gps" and recorded)]


def import_notes(recording: NpzRecording, scenario: Scenario, noise: bool, referenced: bool, outside: int, cut: int) -> list[str]:
    """Sentences on an import.

    Parameters
    ----------
    recording, scenario, noise : as imported
    referenced : any piece has a reference
    outside : measurements of the log outside the IMU's time
    cut : IMU samples before the reference begins
    """
    names = {"gps": "GPS", "bds": "BDS"}
    if recording.stacked is not None:
        notes = _several_notes(recording, scenario)
    else:
        n, imu = 2 * len(configure.fusion_config(scenario).array().H), scenario.imu
        notes = [f"IMU: real, projected on {n} axes ({imu.configuration})" + (
            f" with {imu.gyro.arw_deg_sqrt_h:g} deg/sqrt(h) and {imu.accel.vrw_ug_sqrt_hz:g} ug/sqrt(Hz) of white noise put on each."
            if noise else " without noise of their own: the sensors agree exactly, parity is zero."
        )]  # fmt: skip
    if not recording.kind and not (recording.stacked and recording.stacked.lowpass_hz):
        notes.append("The recording does not say whether IMU values are means over the interval or instantaneous: they are taken as means.")
    if scenario.doppler.enabled:
        notes.append("Doppler log: as recorded" + (f"; {outside} measurements outside the IMU's time are left out." if outside else "."))
    for name in ("gps", "bds"):
        if name in simulated_aids(recording, scenario):
            sigma = ", ".join(f"{s:g}" for s in getattr(scenario, name).sigma_m)
            notes.append(f"{names[name]}: SIMULATED from the reference with white errors of {sigma} m (north, east, down).")
    if not (scenario.gps.enabled or scenario.bds.enabled or scenario.doppler.enabled):
        notes.append("There is no aid: what is navigated, from an initial state, is inertial alone.")
    if _one_source(recording):
        said = "it is withheld here" if not scenario.gps.enabled else "a score with it flatters; withhold it to score (--withhold gps)"
        notes.append(f"The recorded GNSS and the reference are one source: {said}.")
    if not referenced:
        notes.append("There is no reference: no truth and no initial state; fusion and fault detection run alone until SetInitialState gives one.")
    else:
        notes.append(
            "Truth: the recording's reference, brought to 10 Hz by the IMU between its epochs; a score is a distance to it, not an accuracy."
        )
    if cut:
        notes.append(f"{cut} IMU samples before the reference begins are left out.")
    if len(recording.pieces) > 1:
        notes.append(f"The pieces follow each other with gaps of {GAP_S:g} s, at which the run restarts.")
    return notes


def _one_source(recording: NpzRecording) -> bool:
    """Whether the reference is nothing but the recorded GNSS."""
    for piece in recording.pieces:
        if len(piece.gnss) and len(piece.reference) == len(piece.gnss):
            return bool(np.allclose(piece.reference[:, :4], piece.gnss[:, :4], rtol=0.0, atol=1e-9, equal_nan=True))
    return False


def _several_notes(recording: NpzRecording, scenario: Scenario) -> list[str]:
    several = recording.stacked
    assert several is not None
    count, n = len(several.offsets), len(several.axes)
    notes = [f"{count} IMUs, each with its own mounting: {n} gyros and {n} accelerometers; sensor 3 i + j is axis j of IMU i."]
    found = "; added to each: " + ", ".join(f"{1e3 * o:+.2f}" for o in several.offsets) + " ms (found from their turns)"
    notes.append(f"Clocks: interpolated to that of IMU 0{found if several.offsets.any() else ', as recorded'}.")
    if several.lowpass_hz:
        delay = f"its delay of {1e3 * several.delay_s:.0f} ms is taken off the stamps"
        notes.append(f"Vibration: causal low-pass at {several.lowpass_hz:.2g} Hz; {delay}.")
    config = configure.fusion_config(scenario)
    gyro, accel = np.degrees(config.gyro_sigma), config.accel_sigma
    notes.append(
        f"Noise told to the fusion, the real one is coloured: gyros {min(gyro):.2g} .. {max(gyro):.2g} deg/s, "
        f"accelerometers {min(accel):.2g} .. {max(accel):.2g} m/s^2; "
        f"turn-on biases assumed: {np.degrees(config.gyro_bias_sigma):.2g} deg/s, {config.accel_bias_sigma:.2g} m/s^2."
    )
    return notes
