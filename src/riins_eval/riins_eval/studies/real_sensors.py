"""Real sensors: four small IMUs on one drone, twelve gyros and twelve accelerometers that disagree; every method on the same cases.

Lives here: the recording quad4imu.npz prepared, its natural fault, its rows and figures.
Does not live here: cases and counting (real_cases.py), methods (real_detectors.py), the sea recording (sea_sensors.py).
"""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from riins_core.imu_array import ImuArray

from ..npz_recording import load
from ..several_imus import STUCK, RecordingSettings, lowpass
from .real_cases import EPISODES_A_HALF, Case, Material, bars, curves, draw, judge, rows_of, shape_of, tune
from .real_detectors import Detector, Pair, Sensors, detectors
from .rows import Figure, Progress, Row

Array = NDArray[np.float64]

FILE = "quad4imu.npz"
SETTLE_S = 2.0
LEARN_S = 30.0
"""The biases are learned in the first so many seconds after SETTLE_S."""
BLOCK_S = 16.0
"""The rest is cut into blocks that belong to the two halves in turn, so that both have calm and wild flight."""
HORIZON_S = 10.0
WINDOW_S = 4.0
"""Longest window of the GLR."""
SIZES = {
    "step": ((np.radians(0.05), np.radians(2.0)), (0.05, 2.0)),
    "ramp": ((np.radians(0.02), np.radians(1.0)), (0.02, 1.0)),
    "noise": ((np.radians(0.5), np.radians(10.0)), (0.5, 10.0)),
}
"""Steps in deg/s and m/s^2, ramps in these per second, noise as rms of a raw sample at 120 Hz."""
BAD = 9
"""The x gyro of IMU 3, sensor 3 i + j."""


@dataclasses.dataclass(frozen=True)
class Flight:
    """The recording: raw sensors on one clock, the low-pass, every `keep`th sample kept, what is left of both kinds, the geometry, noise, priors."""

    raw: Pair
    raw_hz: float
    cut_hz: float
    keep: int
    slow: Pair
    array: ImuArray
    sigma: Array
    bias: Array

    @property
    def rate_hz(self) -> float:
        """Samples a second that are kept."""
        return self.raw_hz / self.keep


def read(path: Path) -> Flight:
    """Prepare the recording as `riins import` does, and keep the raw sensors too, for faults come before the low-pass."""
    settings = RecordingSettings()
    found = load(path, settings).stacked
    assert found is not None
    loaded = load(path, dataclasses.replace(settings, lowpass_hz=0.0, check_units=False))
    assert loaded.pieces[0].sensors is not None
    raw, raw_hz = loaded.pieces[0].sensors[:2], float(loaded.rate_hz)
    keep = max(1, round(raw_hz / found.rate_hz))
    slow = tuple(lowpass(z, found.lowpass_hz, raw_hz)[::keep] for z in raw)
    bias = np.array([np.radians(settings.gyro_turn_on_deg_s), settings.accel_turn_on_mps2])
    sigma = np.stack([found.gyro_sigma, found.accel_sigma])
    return Flight(raw, raw_hz, found.lowpass_hz, keep, (slow[0], slow[1]), ImuArray(found.axes), sigma, bias)


def prepare(flight: Flight) -> Material:
    """The recording ready for cases; what the sensors' means of the first part contradict each other in is taken off as bias."""
    rate, n = flight.rate_hz, flight.array.n
    Q = np.eye(n) - flight.array.H @ np.linalg.pinv(flight.array.H)
    first, learned = round(SETTLE_S * rate), round((SETTLE_S + LEARN_S) * rate)
    gyro, accel = (Q @ z[first:learned].mean(axis=0) for z in flight.slow)
    clean = flight.slow[0][first:] - gyro, flight.slow[1][first:] - accel
    m, learned = len(clean[0]), learned - first
    blocks = max(2, 2 * round((m - learned) / rate / BLOCK_S / 2.0))  # as many in one half as in the other
    half = np.full(m, -1, dtype=np.int64)
    half[learned:] = np.arange(m - learned) * blocks // (m - learned) % 2

    def inject(case: Case) -> Pair:
        end = min(m, int(np.ceil(case.end_s * rate)))
        z = [part[:end].copy() for part in clean]
        t = np.arange((first + end) * flight.keep) / flight.raw_hz - first / rate
        for fault in case.faults:
            column = flight.raw[case.kind][: len(t), fault.sensor].copy()
            if fault.type == "stuck":
                k = int(np.argmax(t >= fault.start_s))
                column[k:] = column[max(0, k - 1)]
            else:
                column += shape_of(fault, t, round(1e3 * fault.start_s))
            smooth = lowpass(column[:, None], flight.cut_hz, flight.raw_hz)[:, 0]
            if fault.type == "stuck":  # what repeats itself passes as it is, as in an import
                smooth[k + STUCK :] = column[k + STUCK :]
            z[case.kind][:, fault.sensor] = smooth[:: flight.keep][first:] - (gyro, accel)[case.kind][fault.sensor]
        return z[0], z[1]

    alarms_h = 2.0 * EPISODES_A_HALF / ((m - learned) / rate / 3600.0)
    sensors = Sensors(rate, flight.array, flight.sigma, np.zeros(2), alarms_h)
    return Material(sensors, [clean], [half], inject, SIZES, HORIZON_S)


def natural_fault(flight: Flight, alarms_h: float, methods: list[Detector] | None = None) -> list[Row]:
    """Nobody says anything but the ordinary turn-on biases: when each method names the bad gyro, and whom else."""
    rows = []
    first = round(SETTLE_S * flight.rate_hz)
    z = flight.slow[0][first:], flight.slow[1][first:]
    told = Sensors(flight.rate_hz, flight.array, flight.sigma, flight.bias, alarms_h)
    for method in methods or detectors(told, WINDOW_S):
        found = method.find(z, 0, 0, (1.0, 1.0))
        seconds = (found.naming + 1) / flight.rate_hz if found.naming >= 0 else np.nan
        right = found.first == (BAD,)
        others = sorted(found.named - {BAD})
        remark = "named rightly" if right else f"names {', '.join(f'gyro_{i}' for i in found.first) or 'nobody'} first"
        remark += f"; later also {', '.join(f'gyro_{i}' for i in others)}" if right and others else ""
        asked = method.name in ("wls", "glr_kf")
        rows.append(Row(None, f"natural fault, {method.title}: x gyro of IMU 3 named after, s", "at once", seconds, seconds, seconds, 1,
                        bool(right and seconds <= 1.0) if asked else None, remark))  # fmt: skip
    return rows


def run(seeds: int = 200, quick: bool = False, progress: Progress = lambda part: None, data: Path | None = None) -> tuple[list[Row], list[Figure]]:
    """The chapter.

    Parameters
    ----------
    seeds : cases
    quick : no difference but in `seeds`
    progress : told the part done
    data : directory of the recording
    """
    path = (data or Path()) / FILE
    if not path.is_file():
        return [missing(FILE, data)], []
    flight = read(path)
    material = prepare(flight)
    others = [3 * i for i in range(4) if 3 * i != BAD]
    mean = flight.slow[0][: round(LEARN_S * flight.rate_hz)].mean(axis=0)
    beyond = float(np.degrees(mean[BAD] - mean[others].mean()))
    rows = [Row(None, "x gyro of IMU 3 beyond the mean of the other three, deg/s", 2.6, beyond, beyond, beyond, 1, None, "")]
    rows += natural_fault(flight, material.sensors.alarms_h)
    progress(0.1)
    methods = detectors(material.sensors, WINDOW_S)
    scales, alarms = tune(material, methods, lambda part: progress(0.1 + 0.2 * part))
    cases = [draw(material, i) for i in range(seeds)]
    results = judge(material, methods, scales, cases, lambda part: progress(0.3 + 0.7 * part))
    rows += rows_of("drone", material, methods, scales, alarms, results)
    figures = [
        Figure(
            "real_natural_fault",
            "Four IMUs on one drone: the x gyros after the low-pass, and each beyond the median of the four",
            _natural(flight),
        ),
        bars("real_drone_methods", f"Drone, {seeds} cases at equal alarm rate on the fault-free flight", methods, results),
        curves("real_drone_sizes", "Drone: detection of one fault by its size", material, methods, results),
    ]
    return rows, figures


def missing(file: str, data: Path | None) -> Row:
    """A row in place of a chapter whose recording is not there."""
    words = f"skipped: {file} is not in {data or Path()}; `--data DIR` says where recordings are"
    return Row(None, f"{file}: not there", None, np.nan, np.nan, np.nan, 0, None, words)


def _natural(flight: Flight) -> Any:
    def draw_lines(canvas: Any) -> None:
        above, below = canvas.subplots(2, 1, sharex=True)
        m = round(40.0 * flight.rate_hz)
        t = np.arange(m) / flight.rate_hz
        x = np.degrees(flight.slow[0][:m, 0::3])
        for i in range(4):
            above.plot(t, x[:, i], linewidth=0.8, label=f"IMU {i}")
            below.plot(t, x[:, i] - np.median(x, axis=1), linewidth=1.8 if 3 * i == BAD else 0.8, label=f"gyro_{3 * i}")
        above.set_ylabel("x gyro [deg/s]")
        below.set_ylabel("beyond the median [deg/s]")
        below.set_xlabel("time [s]")
        below.annotate("isolated at once", (0.5, 2.6), (4.0, 3.4), arrowprops={"arrowstyle": "->"})
        above.legend(ncols=4)
        below.legend(ncols=4)

    return draw_lines
