"""Real motion at sea: one fibre-optic IMU projected on six axes with white noise on each; every method on the same cases.

Lives here: the recording snapir_open.npz prepared, its rows and figures.
Does not live here: cases and counting (real_cases.py), methods (real_detectors.py), sensors that really disagree (real_sensors.py).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from riins_core.imu_array import CONFIGURATIONS, ImuArray
from riins_core.sensor_errors import DEG_PER_H, MICRO_G
from riins_core.settings import build
from riins_sim.scenario import ImuSettings

from ..import_settings import DEFAULTS
from ..npz_recording import load
from .real_cases import EPISODES_A_HALF, Case, Material, bars, curves, draw, judge, rows_of, shape_of, tune
from .real_detectors import Pair, Sensors, detectors
from .real_sensors import missing
from .rows import Figure, Progress, Row

FILE = "snapir_open.npz"
HORIZON_S = 30.0
WINDOW_S = 4.0
SETTLE_S = 20.0
"""Of each piece: the filters learn before faults begin."""
PIECES_QUICK = 2
SIZES = {
    "step": ((2.0 * DEG_PER_H, 200.0 * DEG_PER_H), (100.0 * MICRO_G, 10_000.0 * MICRO_G)),
    "ramp": ((0.2 * DEG_PER_H, 20.0 * DEG_PER_H), (10.0 * MICRO_G, 1_000.0 * MICRO_G)),
    "noise": ((4.0 * DEG_PER_H, 100.0 * DEG_PER_H), (200.0 * MICRO_G, 5_000.0 * MICRO_G)),
}
"""Steps in deg/h and ug, ramps in these per second, noise as rms of a sample."""


def prepare(path: Path, quick: bool) -> Material:
    """The recording ready for cases: every piece seen by six gyros and six accelerometers of the dodecahedron with the noise of an import."""
    recording = load(path)
    array = ImuArray(CONFIGURATIONS["dodecahedron"])
    imu, dt = build(ImuSettings, DEFAULTS["imu"]), 1.0 / recording.rate_hz
    sigma = np.array([[imu.gyro.si().white_sigma(dt)], [imu.accel.si().white_sigma(dt)]])
    clean: list[Pair] = []
    half = []
    for number, piece in enumerate(recording.pieces[: PIECES_QUICK if quick else None]):
        rng = np.random.default_rng((7, number))
        gyro, accel = (z @ array.H.T + s * rng.standard_normal((len(z), array.n)) for z, s in zip((piece.rate, piece.force), sigma, strict=True))
        clean.append((gyro, accel))
        belongs = np.full(len(gyro), number % 2, dtype=np.int64)
        belongs[: round(SETTLE_S / dt)] = -1
        half.append(belongs)

    def inject(case: Case) -> Pair:
        end = min(len(clean[case.stretch][0]), int(np.ceil(case.end_s / dt)))
        z = [part[:end].copy() for part in clean[case.stretch]]
        t = np.arange(end, dtype=np.float64) * dt
        for fault in case.faults:
            column = z[case.kind][:, fault.sensor]
            if fault.type == "stuck":
                k = int(np.argmax(t >= fault.start_s))
                column[k:] = column[max(0, k - 1)]
            else:
                column += shape_of(fault, t, round(1e3 * fault.start_s))
        return z[0], z[1]

    hours = sum(int((h >= 0).sum()) for h in half) * dt / 3600.0
    sensors = Sensors(float(recording.rate_hz), array, np.broadcast_to(sigma, (2, array.n)).copy(), np.zeros(2), 2.0 * EPISODES_A_HALF / hours)
    return Material(sensors, clean, half, inject, SIZES, HORIZON_S)


def run(seeds: int = 200, quick: bool = False, progress: Progress = lambda part: None, data: Path | None = None) -> tuple[list[Row], list[Figure]]:
    """The chapter.

    Parameters
    ----------
    seeds : cases
    quick : two pieces instead of nine
    progress : told the part done
    data : directory of the recording
    """
    path = (data or Path()) / FILE
    if not path.is_file():
        return [missing(FILE, data)], []
    material = prepare(path, quick)
    progress(0.02)
    methods = detectors(material.sensors, WINDOW_S)
    scales, alarms = tune(material, methods, lambda part: progress(0.02 + 0.38 * part))
    cases = [draw(material, i) for i in range(seeds)]
    results = judge(material, methods, scales, cases, lambda part: progress(0.4 + 0.6 * part))
    rows = rows_of("sea", material, methods, scales, alarms, results)
    title = f"Sea, {seeds} cases at equal alarm rate on the recording without faults"
    by_size = curves("real_sea_sizes", "Sea: detection of one fault by its size", material, methods, results)
    return rows, [bars("real_sea_methods", title, methods, results), by_size]
