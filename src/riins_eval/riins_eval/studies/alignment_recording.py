"""Alignment on the sea recording: heading over each piece from the IMU with its log (target 50), and with GNSS velocity simulated from the reference.

Lives here: `prepare`, `align_piece`, rows, figure and `run` of the chapter.
Does not live here: the method (riins_federated.alignment_in_motion), the recording itself, which is no part of the project.
"""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from riins_core.alignment.result import AlignmentError, settled_after
from riins_core.alignment.stationary import ImuNoise
from riins_core.alignment.stored import Aids
from riins_core.rotation import euler_from_dcm
from riins_core.sensor_errors import DEG, DEG_PER_H, DEG_PER_SQRT_H, MICRO_G
from riins_federated.alignment_in_motion import align_in_motion

from ..npz_recording import load
from ..reference import RecordedMotion, fit_reference_lever, reference_at_imu
from .real_sensors import missing
from .rows import Figure, Progress, Row, row

Array = NDArray[np.float64]

FILE = "snapir_open.npz"
FOG = ImuNoise(0.01 * DEG_PER_SQRT_H, 50.0 * MICRO_G, 0.05 * DEG_PER_H, 200.0 * MICRO_G)
"""A fibre-optic-gyro IMU whose output is rounded to 1e-4 rad/s and 1e-4 m/s^2: at 100 Hz that alone is 0.01 deg/sqrt(h)."""
LOG_SIGMA, LOG_PRIOR = 0.03, (0.01, 0.005)
"""m/s (the recording says 0.02, and it is less in calm water); yaw [rad] and scale factor of the log."""
GNSS_SIGMA = 0.05
"""m/s"""
WHOLE_S, SHORT_S = 400.0, 120.0


@dataclasses.dataclass(frozen=True)
class Piece:
    """One piece: IMU, and what goes with it.

    Attributes
    ----------
    name : number of the piece as recorded
    dt : s
    rate, force : (m, 3)
    log, gnss : velocities of the log and, simulated, of a receiver
    truth : (k, 10), reference: time since the first sample's interval began [s], latitude, ..., heading
    """

    name: str
    dt: float
    rate: Array
    force: Array
    log: Aids
    gnss: Aids
    truth: Array


@dataclasses.dataclass(frozen=True)
class Found:
    """Heading along a piece against the reference, rad: t (k,) s, error (k,), sigma (k,); empty where the alignment refused, and why."""

    t: Array
    error: Array
    sigma: Array
    refused: str = ""


def prepare(path: Path) -> list[Piece]:
    """The pieces of the recording, with velocities at sample numbers.

    Notes
    -----
    The reference, and with it the lever arm of the log, holds at a point forward of the IMU; every turn shows it, and both are moved to the IMU. With
    the lever arm as recorded the heading is four times as far off. Of the reference nothing else gets into the alignment but the place at the start.
    """
    recording = load(path)
    dt = 1.0 / recording.rate_hz
    motions = [RecordedMotion(p.t, p.rate, p.force, np.zeros((0, 10)), dt) for p in recording.pieces]
    lever = fit_reference_lever([(m, p.reference) for m, p in zip(motions, recording.pieces, strict=True)])[0]
    mounted = lever + (recording.log_lever if recording.log_lever is not None else 0.0)
    out = []
    for i, (motion, piece) in enumerate(zip(motions, recording.pieces, strict=True)):
        truth = reference_at_imu(motion, piece.reference[np.all(np.isfinite(piece.reference), axis=1)], lever)
        begin = float(piece.t[0]) - dt
        truth[:, 0] -= begin
        index, good = _samples(piece.log_t - begin, dt, len(piece.t), truth)
        logged = Aids("log", index[good], piece.log_v[good], np.full(3, LOG_SIGMA), mounted, LOG_PRIOR)
        index, good = _samples(truth[:, 0], dt, len(piece.t), truth)
        velocity = truth[:, 4:7] + GNSS_SIGMA * np.random.default_rng([i, 52]).standard_normal((len(truth), 3))
        out.append(
            Piece(piece.name, dt, piece.rate, piece.force, logged, Aids("velocity", index[good], velocity[good], np.full(3, GNSS_SIGMA)), truth)
        )
    return out


def _samples(t: Array, dt: float, m: int, truth: Array) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Number of samples before times [s], and which of them are within the samples and the reference."""
    index = np.rint(t / dt).astype(np.int64)
    return index, (index > 0) & (index <= m) & (t >= truth[0, 0]) & (t <= truth[-1, 0])


def align_piece(piece: Piece, aids: Aids, seconds: float = WHOLE_S) -> Found:
    """Alignment over the first `seconds` of a piece, of which nothing is known but the place at its start."""
    m = min(len(piece.rate), round(seconds / piece.dt))
    used = aids.index <= m
    aids = dataclasses.replace(aids, index=aids.index[used], value=aids.value[used])
    place = (float(piece.truth[0, 1]), float(piece.truth[0, 2]), float(piece.truth[0, 3]))
    try:
        _, history = align_in_motion(piece.rate[:m], piece.force[:m], piece.dt, place, FOG, aids)
    except AlignmentError as refusal:
        return Found(np.zeros(0), np.zeros(0), np.zeros(0), str(refusal))
    reference = np.interp(history.t, piece.truth[:, 0], np.unwrap(piece.truth[:, 9]))
    error = np.mod(euler_from_dcm(history.C_nb)[2] - reference + np.pi, 2.0 * np.pi) - np.pi
    return Found(history.t, error, history.sigma[:, 2])


def _row(name: str, found: list[Found], target: int | None) -> Row:
    errors = np.array([abs(f.error[-1]) for f in found if not f.refused]) / DEG
    refusals = sum(bool(f.refused) for f in found)
    words = f"{refusals} of {len(found)} refused" if refusals else "the reference comes of the same IMU and, we believe, the same log"
    if not len(errors):
        return Row(target, name, None, math.nan, math.nan, math.nan, 0, False if target else None, words)
    sigma = float(np.sqrt(np.mean([f.sigma[-1] ** 2 for f in found if not f.refused]))) / DEG

    def reached(r: Row) -> bool:
        return not refusals and r.value <= 0.6

    remark = f"worst {errors.max():.2f}, own sigma {sigma:.2f}; {words}"
    return row(target, name, errors, centre=lambda e: float(np.sqrt(np.mean(np.square(e)))), ok=reached if target else None, remark=remark)


def run(seeds: int, quick: bool, progress: Progress, data: Path | None = None) -> tuple[list[Row], list[Figure]]:
    """The chapter."""
    path = (data or Path()) / FILE
    if not path.is_file():
        return [missing(FILE, data)], []
    pieces, results = prepare(path), []
    for i, piece in enumerate(pieces):
        results.append((align_piece(piece, piece.log), align_piece(piece, piece.gnss), align_piece(piece, piece.log, SHORT_S)))
        progress((i + 1) / len(pieces))
    log, gnss, short = ([r[k] for r in results] for k in range(3))
    rows = [
        _row(f"IMU and log alone, unknown heading, {WHOLE_S:.0f} s: heading, °, RMS over the pieces", log, 50),
        _row(f"IMU and log alone, {SHORT_S:.0f} s", short, None),
        _row(f"IMU and simulated GNSS velocity, {WHOLE_S:.0f} s", gnss, None),
    ]
    for piece, (with_log, with_gnss, _) in zip(pieces, results, strict=True):
        for name, found in (("log", with_log), ("simulated GNSS", with_gnss)):
            value = math.nan if found.refused else float(found.error[-1]) / DEG
            words = found.refused or f"own sigma {found.sigma[-1] / DEG:.2f} after {found.t[-1]:.0f} s; {_settled(piece, found)}"
            rows.append(Row(None, f"piece {piece.name}, {name}: heading, °", None, value, value, value, 1, None, words))
    return rows, [_figure(pieces, log)]


def _settled(piece: Piece, found: Found) -> str:
    """When the 95 % bound came to stay inside 0.75 deg sec(latitude), of the last pass over the data."""
    limit = 0.75 * DEG / math.cos(float(piece.truth[0, 1]))
    after = settled_after(found.t, found.sigma, limit, 1.96)
    return f"settled (A.821) after {after:.0f} s" if math.isfinite(after) else "not settled (A.821)"


def _figure(pieces: list[Piece], found: list[Found]) -> Figure:
    def draw(canvas: Any) -> None:
        grid = canvas.subplots(3, 3, sharex=True, sharey=True).flat
        for axes, piece, one in zip(grid, pieces, found, strict=False):
            axes.fill_between(one.t, -3.0 * one.sigma / DEG, 3.0 * one.sigma / DEG, color="#0072b2", alpha=0.15, linewidth=0.0)
            axes.plot(one.t, one.error / DEG, color="#0072b2", linewidth=1.0)
            axes.set_title(f"piece {piece.name}" + (": refused" if one.refused else ""))
            axes.set_ylim(-2.0, 2.0)
        canvas.supxlabel("time [s]")
        canvas.supylabel("heading error [°]")

    title = "Sea recording: heading from IMU and log, last pass, with 3 sigma (peaks: turns between two epochs of the reference)"
    return Figure("alignment_sea", title, draw)
