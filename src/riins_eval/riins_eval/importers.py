"""A foreign recording becomes a bag that the graph can replay: real IMU on redundant axes, real log, GNSS as recorded or simulated.

Lives here: `import_npz`.
Does not live here: files (npz_recording.py), settings and sentences (import_*.py), motion (reference.py), sensors and faults (riins_sim).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from riins_core.earth import radii
from riins_federated.types import InitialState
from riins_sim.course import KNOT
from riins_sim.faults import Fault, FaultSchedule, Sample
from riins_sim.initial import initial_state
from riins_sim.scenario import Scenario
from riins_sim.sensors import PositionBlock, PositionSim, RawBlock, RedundantImuSim, VelocityBlock

from . import configure
from .import_notes import GAP_S, import_notes, simulated_aids
from .import_settings import import_scenario, read_fault_list, recording_settings
from .npz_recording import ImportFailure, NpzRecording, Piece, load
from .recording import RunWriter
from .reference import RecordedMotion, fit_reference_lever, reference_at_imu

__all__ = ["ImportFailure", "import_npz"]

Floats = NDArray[np.float64]
Progress = Callable[[float, float], None]

EPOCH_S = 1_600_000_000
"""A recording whose own time does not look like Unix time begins here (2020-09-13T12:26:40Z)."""
UNIX_S = 1e9
TRUTH_HZ = 10
CHUNK = 1000


def import_npz(
    path: str | Path,
    out: str | Path,
    seed: int = 1,
    noise: bool = True,
    faults: str | Path | Sequence[Mapping[str, Any]] | None = None,
    options: Mapping[str, Any] | None = None,
    reference_lever_m: Sequence[float] | None = None,
    progress: Progress | None = None,
) -> list[str]:
    """Make a bag of a recording in the common .npz layout.

    Parameters
    ----------
    path : .npz file, see npz_recording.load
    out : bag directory to make
    seed : of sensor noise, simulated GNSS and initial errors
    noise : white noise on each of the redundant sensors; without it all sensors agree to the last bit and parity is exactly zero
    faults : as in a scenario, times counted from the start of each piece: YAML file with a list, or the list
    options : sections of a scenario that replace DEFAULTS (imu, gps, bds, doppler, initial, outages, scoring, navigator, fusion, expect), and
        `recording`, see several_imus.RecordingSettings; an aid that is not `enabled` is withheld
    reference_lever_m : (3,), of the reference's point from the IMU, FRD; None: found from the recording itself, where its turns show it
    progress : called with (recorded seconds done, seconds in all)

    Returns
    -------
    list of sentences: what became of what

    Raises
    ------
    ImportFailure
        The recording, the faults or the options cannot be used.
    BagError
        The bag cannot be written.
    """
    settings, sections = recording_settings(options or {})
    recording, lever_note = _at_imu(load(path, settings), reference_lever_m)
    scenario = import_scenario(recording, seed, noise, read_fault_list(faults), sections, settings)
    placed = _place(recording)
    outside = sum(int((~_within(p, p.piece.log_t)).sum()) for p in placed)
    cut = sum(int(p.used.start or 0) for p in placed)
    about = import_notes(recording, scenario, noise, any(p.has_reference for p in placed), outside, cut)
    notes = [*recording.notes, *about, *lever_note]
    total, done = sum(p.motion.duration for p in placed), 0.0
    with RunWriter(out, "raw") as writer:
        writer.configuration(_configuration(recording, scenario, placed, notes), placed[0].start_ns)
        for piece in placed:
            _write_piece(writer, recording, scenario, piece)
            done += piece.motion.duration
            if progress is not None:
                progress(done, total)
    return [f"{recording.path.name}: {len(placed)} pieces, {total:.0f} s at {recording.rate_hz} Hz", *notes]


@dataclasses.dataclass(frozen=True)
class _Placed:
    """A piece and its place in the bag.

    Attributes
    ----------
    piece : as recorded
    motion : from its sample 0 on, which is the first with a reference
    used : index of the recorded samples from sample 0 on
    start_ns : stamp of sample 0
    seed_offset : so that each piece has noise of its own
    """

    piece: Piece
    motion: RecordedMotion
    used: slice
    start_ns: int
    seed_offset: int

    @property
    def has_reference(self) -> bool:
        return self.motion.known[1] > self.motion.known[0]

    def stamps(self, t: Floats) -> NDArray[np.int64]:
        """Stamps in the bag of recorded times."""
        return np.asarray(self.start_ns + np.round((t - self.motion.origin) * 1e9).astype(np.int64))


def _at_imu(recording: NpzRecording, given: Sequence[float] | None) -> tuple[NpzRecording, list[str]]:
    """The recording with its reference, and the lever arm of its log, moved to the IMU, which is base_link; and what to say of it."""
    dt = 1.0 / recording.rate_hz
    motions = [RecordedMotion(p.t, p.rate, p.force, np.zeros((0, 10)), dt) for p in recording.pieces]
    if given is not None:
        lever = np.array(given, dtype=np.float64)
        if lever.shape != (3,) or not np.isfinite(lever).all():
            raise ImportFailure("reference_lever_m must be three numbers: forward, starboard, down")
        words = "as given"
    else:
        lever, sigma, before, after = fit_reference_lever([(m, p.reference) for m, p in zip(motions, recording.pieces, strict=True)])
        # a wrong lever arm is worse than none: it must be seen clearly and explain most of what does not close
        if float(np.linalg.norm(lever)) <= max(5.0 * float(np.linalg.norm(sigma)), 0.05) or after >= 0.5 * before:
            return recording, []
        words = f"found from its turns: velocity over an epoch then closes to {1e3 * after:.1f} mm/s instead of {1e3 * before:.1f}"
    if not lever.any():
        return recording, []
    pieces = [
        dataclasses.replace(p, reference=reference_at_imu(m, p.reference, lever)) if len(p.reference) else p
        for m, p in zip(motions, recording.pieces, strict=True)
    ]
    log_lever = recording.log_lever + lever if recording.log_lever is not None else None
    place = ", ".join(f"{v:+.2f}" for v in lever)
    note = f"The reference holds {place} m (forward, starboard, down) from the IMU ({words}); it and the log's lever arm are moved to the IMU."
    return dataclasses.replace(recording, pieces=pieces, log_lever=log_lever), [note]


def _place(recording: NpzRecording) -> list[_Placed]:
    placed: list[_Placed] = []
    dt = 1.0 / recording.rate_hz
    for number, piece in enumerate(recording.pieces):
        complete = piece.reference[np.isfinite(piece.reference).all(axis=1), 0]
        covered = complete[complete >= piece.t[0] - dt]  # between an epoch before the IMU and the next nobody knows the motion
        first = int(np.searchsorted(piece.t, covered[0])) if len(covered) > 1 else 0
        if len(complete) > 1 and (len(covered) < 2 or first > len(piece.t) - 2):
            raise ImportFailure(f"{recording.path.name}: the reference of piece {piece.name} does not overlap its IMU")
        used = slice(first, None)
        motion = RecordedMotion(piece.t[used], piece.rate[used], piece.force[used], piece.reference, dt)
        if placed:
            start = placed[-1].start_ns + round((placed[-1].motion.duration + GAP_S) * 1e9)
        else:
            start = round(piece.t[first] * 1e9) if piece.t[first] > UNIX_S else EPOCH_S * 1_000_000_000
        placed.append(_Placed(piece, motion, used, start, number))
    return placed


def _write_piece(writer: RunWriter, recording: NpzRecording, scenario: Scenario, placed: _Placed) -> None:
    motion = placed.motion
    duration_ns = round(motion.duration * 1e9) + 1
    # each piece has its own noise; the scenario's times count from the start of each piece
    local = dataclasses.replace(scenario, seed=(scenario.seed * 1009 + placed.seed_offset) % 2**31, duration_s=max(1.0, motion.duration))
    faults = [_ended(f, duration_ns) for f in local.fault_schedule().faults if f.start_ns < duration_ns]
    schedule = FaultSchedule(faults, local.seed)
    if faults:
        writer.faults(placed.start_ns, faults, placed.start_ns, f"piece {placed.piece.name}")
    if placed.has_reference:
        writer.initial_state(_initial(local, placed))
        _write_truth(writer, placed)
    for name in ("gps", "bds"):
        if not getattr(local, name).enabled:
            continue
        if name == "gps" and len(placed.piece.gnss):
            _write_recorded_gps(writer, recording, local, placed, schedule)
        elif placed.has_reference:
            _write_simulated_fixes(writer, local, placed, schedule, name)
    if local.doppler.enabled and len(placed.piece.log_t):
        _write_log(writer, local, placed, schedule)
    if placed.piece.sensors is None:
        _write_imu(writer, local, placed, schedule)
    else:
        _write_sensors(writer, placed, schedule)


def _write_imu(writer: RunWriter, scenario: Scenario, placed: _Placed, schedule: FaultSchedule) -> None:
    """The recorded IMU seen by the redundant sensors; sample 0 is the origin and is not written."""
    motion = placed.motion
    sensors = RedundantImuSim(scenario, motion)  # type: ignore[arg-type]  # it moves as a Trajectory does
    stamps = placed.stamps(placed.piece.t[placed.used])
    number = motion.number
    for a in range(1, len(number), CHUNK):
        b = min(a + CHUNK, len(number))
        k0, k1 = int(number[a]), int(number[b - 1])
        block = sensors.block(k0, k1 - k0 + 1, schedule)
        rows = number[a:b] - k0
        present = RawBlock(*(getattr(block, f.name)[rows] for f in dataclasses.fields(RawBlock)))
        writer.raw_imu(stamps[a:b], (number[a:b] & 0xFFFFFFFF).astype(np.uint32), present)


def _write_sensors(writer: RunWriter, placed: _Placed, schedule: FaultSchedule) -> None:
    """The sensors of several IMUs as they are; sample 0 is the origin and is not written."""
    assert placed.piece.sensors is not None
    gyro, accel = (a[placed.used][1:].copy() for a in placed.piece.sensors[:2])
    present = placed.piece.sensors[2][placed.used][1:]
    stamps, number = placed.stamps(placed.piece.t[placed.used])[1:], placed.motion.number[1:]
    since = stamps - placed.start_ns
    clean = {"gyro": gyro.copy(), "accel": accel.copy()}

    def before(kind: str, t: int) -> Sample:
        k = max(int(np.searchsorted(since, t)) - 1, 0)
        return Sample(int(since[k]), k + 1, clean[kind][k])

    bits = (present * (np.uint64(1) << np.arange(present.shape[1], dtype=np.uint64))).sum(axis=1, dtype=np.uint64)
    gyro_valid = bits & schedule.apply_axes("gyro", since, 1, gyro, lambda t: before("gyro", t))
    accel_valid = bits & schedule.apply_axes("accel", since, 1, accel, lambda t: before("accel", t))
    block = RawBlock(number, since, gyro, accel, gyro_valid, accel_valid)
    writer.raw_imu(stamps, (number & 0xFFFFFFFF).astype(np.uint32), block)


def _write_truth(writer: RunWriter, placed: _Placed) -> None:
    motion = placed.motion
    step = max(1, round(1.0 / (motion.dt * TRUTH_HZ)))
    k = np.arange(0, motion.samples + 1, step)
    times = motion.times(k)
    writer.truth(placed.start_ns + np.round(times * 1e9).astype(np.int64), motion.truth(times))


def _write_simulated_fixes(writer: RunWriter, scenario: Scenario, placed: _Placed, schedule: FaultSchedule, name: str) -> None:
    receiver = PositionSim(scenario, name, placed.motion)  # type: ignore[arg-type]
    period = receiver.period_ns * 1e-9
    first = max(1, int(np.ceil(placed.motion.known[0] / period - 1e-9)))
    last = min(receiver.samples, int(np.floor(placed.motion.known[1] / period + 1e-9)))
    if last >= first:
        block = receiver.block(first, last - first + 1, schedule)
        good = np.isfinite(block.lat)
        block = dataclasses.replace(block, **{f: getattr(block, f)[good] for f in ("k", "stamp_ns", "lat", "lon", "h", "has_fix", "v_n")})
        writer.position(name, placed.start_ns + block.stamp_ns, block)


def _write_recorded_gps(writer: RunWriter, recording: NpzRecording, scenario: Scenario, placed: _Placed, schedule: FaultSchedule) -> None:
    gnss = placed.piece.gnss[_within(placed, placed.piece.gnss[:, 0])]
    if not len(gnss):
        return
    stamps = placed.stamps(gnss[:, 0]) - placed.start_ns
    place = gnss[:, 1:4].copy()
    sigma = recording.gnss_sigma if recording.gnss_sigma is not None else np.zeros(6)
    lat = float(np.nanmedian(place[:, 0])) if np.isfinite(place[:, 0]).any() else 0.0
    r_m, r_n = (float(r) for r in radii(lat))
    per_metre = np.tile([1.0 / r_m, 1.0 / (r_n * np.cos(lat)), -1.0], (len(gnss), 1))
    has_fix = _outages(scenario, "gps", stamps) & np.isfinite(place).all(axis=1)
    has_fix &= schedule.apply_aid("gps", stamps, 1, place, lambda t: _before(t, stamps, gnss[:, 1:4], per_metre), per_metre)
    block = PositionBlock(
        np.arange(1, len(gnss) + 1),
        stamps,
        place[:, 0],
        place[:, 1],
        place[:, 2],
        np.diag(sigma[:3] ** 2),
        has_fix,
        gnss[:, 4:7],
        np.diag(sigma[3:] ** 2),
    )
    writer.position("gps", placed.start_ns + stamps, block)


def _write_log(writer: RunWriter, scenario: Scenario, placed: _Placed, schedule: FaultSchedule) -> None:
    inside = _within(placed, placed.piece.log_t)
    stamps = placed.stamps(placed.piece.log_t[inside]) - placed.start_ns
    if not len(stamps):
        return
    recorded = placed.piece.log_v[inside]
    v_b = recorded.copy()
    valid = _outages(scenario, "doppler", stamps)
    valid &= schedule.apply_aid("doppler", stamps, 1, v_b, lambda t: _before(t, stamps, recorded))
    covariance = np.diag((np.array(scenario.doppler.sigma_kn) * KNOT) ** 2)
    writer.aid("doppler", placed.start_ns + stamps, VelocityBlock(np.arange(1, len(stamps) + 1), stamps, v_b, covariance, valid))


def _within(placed: _Placed, t: Floats) -> NDArray[np.bool_]:
    """Measurements after sample 0 and not after the last IMU sample: nothing else can be judged."""
    last = float(placed.piece.t[-1])
    return np.asarray((t > placed.motion.origin) & (t <= last + 1e-9))


def _outages(scenario: Scenario, name: str, stamps: NDArray[np.int64]) -> NDArray[np.bool_]:
    nothing = Sample(0, 0, np.zeros(3))
    return np.asarray(scenario.outage_schedule().only([name]).apply_aid(name, stamps, 1, np.zeros((len(stamps), 3)), lambda _: nothing))


def _before(stamp_ns: int, stamps: NDArray[np.int64], values: Floats, per_metre: Floats | None = None) -> Any:
    k = max(int(np.searchsorted(stamps, stamp_ns)) - 1, 0)
    return Sample(int(stamps[k]), k + 1, values[k]) if per_metre is None else Sample(int(stamps[k]), k + 1, values[k], per_metre[k])


def _initial(scenario: Scenario, placed: _Placed) -> InitialState:
    """State at sample 0 from the reference, with errors drawn by seed; of the real biases nothing is known."""
    drawn = initial_state(scenario, placed.motion)  # type: ignore[arg-type]
    return InitialState(
        placed.start_ns, drawn.lat, drawn.lon, drawn.h, drawn.v_n, drawn.rph, drawn.sigma_position, drawn.sigma_velocity, drawn.sigma_attitude,
        source="reference",
    )  # fmt: skip


def _ended(fault: Fault, duration_ns: int) -> Fault:
    return dataclasses.replace(fault, end_ns=duration_ns if fault.end_ns is None else min(fault.end_ns, duration_ns))


def _configuration(recording: NpzRecording, scenario: Scenario, placed: list[_Placed], notes: list[str]) -> str:
    content = dict(yaml.safe_load(configure.configuration_text(scenario, placed[0].start_ns)))
    content["recording"] = {
        "file": recording.path.name,
        "imu_values": recording.kind or "taken as means over the sample interval; the recording does not say",
        "simulated": simulated_aids(recording, scenario),
        "pieces": [
            {"name": p.piece.name, "start_ns": p.start_ns, "stop_ns": int(p.stamps(p.piece.t[-1:])[0]), "recorded_start_s": float(p.motion.origin)}
            for p in placed
        ],
        "notes": notes,
    }
    return str(yaml.safe_dump(content, sort_keys=False, allow_unicode=True, default_flow_style=None, width=150))
