"""A recorded run read back into a `RunRecord`, and the reference, faults and aids of any bag of ours.

Lives here: `read_record` and its parts.
Does not live here: bag files (riins_bag), computation on the arrays (metrics.py, score.py).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from riins_bag.bag import BagReader
from riins_core.earth import radii
from riins_core.frames import wrap_longitude
from riins_core.rotation import dcm_from_euler, euler_from_dcm, exp_so3, log_so3
from riins_node.readings import read_fault, to_ns
from riins_sim.faults import Fault, FaultType

from .lane import aid_notes, fault_intervals, judged_arrays
from .metrics import NEES7
from .recording import ORACLE_TOPIC, RAW_IMU, TWIN_TOPIC
from .run_configuration import RecordError, RunConfiguration, holds, read_configuration
from .run_record import Alignment, HealthChange, RunRecord, Samples, SensorUse, Stamps, Track

Floats = NDArray[np.float64]
Progress = Callable[[float, float], None]

CHEAP_S = 1800.0
"""A live run of at most this length is sailed again for its twins without being asked."""
LONGEST_STEP_NS = 2_000_000_000
"""The reference is not interpolated over a longer gap."""
_STATE = (
    "header.stamp", "latitude", "longitude", "height", "velocity_north", "velocity_east", "velocity_down", "roll", "pitch", "heading", "mode",
    "protection_radius",
)  # fmt: skip

__all__ = ["RecordError", "read_record"]


def read_record(bag: str | Path, twins: bool | None = None, progress: Progress | None = None, namespace: str | None = None) -> RunRecord:
    """Read a recorded run.

    Parameters
    ----------
    bag : rosbag2 directory with /nav/settled, or at least /fdi/status: then there is nothing but the sensors to be read
    twins : True: sail the scenario again for the fault-free twin and the oracle where the bag lacks them; None: where that takes seconds; False: no
    progress : called with (seconds done, seconds in all) while the twins sail
    namespace : of the recorded topics; None: the one there is

    Returns
    -------
    RunRecord

    Raises
    ------
    RecordError
        The bag has no navigation in it, or no configuration.
    BagError
        It cannot be read.
    """
    with BagReader(bag, namespace) as reader:
        fused = holds(reader, "/fdi/status") and not holds(reader, "/nav/initial_state")
        if not holds(reader, "/nav/settled") and not fused:
            cure = "; make one with `riins navigate`" if RAW_IMU in reader.topics else ""
            raise RecordError(f"{bag} has no /nav/settled: there is no navigation in it to score{cure}")
        configuration = read_configuration(reader)
        navigated = holds(reader, "/nav/settled")
        columns = reader.columns("/nav/settled", _STATE) if navigated else {}
        settled, index = _track(columns) if navigated else (Track.empty(), np.zeros(0, np.intp))
        start_ns = run_start(reader, configuration, settled)
        stop_ns = int(settled.stamp_ns[-1]) + 1 if navigated else reader.end_ns
        faults = read_faults(reader, start_ns)
        ends = max(stop_ns, reader.end_ns)
        scenario = configuration.scenario
        record = RunRecord(
            _name(configuration, reader), settled, reference_at(read_reference(reader), settled.stamp_ns),
            description=scenario.description if scenario else "", covariance=_covariance(reader, settled),
            mode=columns["mode"][index].astype(np.int64) if navigated else None,
            protection_radius=columns["protection_radius"][index] if navigated else None, judged=_judged(reader),
            health=sorted(_sensor_health(reader) + _subfilter_health(reader, stop_ns - 1), key=lambda c: c.stamp_ns),
            faults=fault_intervals(faults, start_ns, ends), origin_ns=start_ns,
            scoring_from_ns=start_ns + (round(scenario.scoring.from_s * 1e9) if scenario else 0), use=_sensor_use(reader), samples=_samples(reader),
            n_sensors=configuration.fusion.array().n,
            pieces=[(p["name"], p["start_ns"], p["stop_ns"]) for p in configuration.recording.get("pieces", [])],
            aid_fixes={name: fixes for name in ("gps", "bds") if (fixes := read_fixes(reader, name)) is not None},
            expect=dict(scenario.expect) if scenario else {}, notes=list(configuration.recording.get("notes", [])),
            drift=_drift(reader), ended_ns=_last_status_ns(reader), alignments=_alignments(reader),
        )  # fmt: skip
        for _, _, status in _last(reader, "/nav/subfilters") if navigated and holds(reader, "/nav/subfilters") else []:
            record.notes += aid_notes(status.subfilters)
        for name, topic in (("twin", TWIN_TOPIC), ("oracle", ORACLE_TOPIC), ("inertial", "/nav/inertial")):
            if holds(reader, topic):
                setattr(record, name, _track(reader.columns(topic, _STATE))[0].at(settled.stamp_ns))
    if not navigated and not record.alignments:
        record.notes.append("There is no initial state in the bag: fusion and fault detection ran alone, nothing was navigated.")
    elif navigated and record.twin is None and twins is not False:
        _sail_twins(record, configuration, faults, twins, progress)
    return record


def run_start(reader: BagReader, configuration: RunConfiguration, settled: Track | None = None) -> int:
    """Stamp of sample 0 of a run: as configured, else of the first initial state, else of the first settled epoch."""
    if configuration.start_at_ns:
        return configuration.start_at_ns
    if holds(reader, "/nav/initial_state"):
        return int(reader.columns("/nav/initial_state", ("header.stamp",))["header.stamp"][0])
    return int(settled.stamp_ns[0]) if settled is not None and len(settled) else reader.start_ns


def read_reference(reader: BagReader) -> Track:
    """The true states of a bag in order of stamps, empty when it has none."""
    if not holds(reader, "/truth/state"):
        return Track.empty()
    return _track(reader.columns("/truth/state", _STATE))[0]


def reference_at(reference: Track, stamp_ns: Stamps) -> Track:
    """A reference at other stamps: exactly where they meet, else between its neighbours no more than 2 s apart, NaN elsewhere.

    Parameters
    ----------
    reference : (r,) epochs
    stamp_ns : (m,)

    Returns
    -------
    Track of m epochs; position by a cubic through both positions and velocities, velocity linear, attitude along the rotation between both
    """
    m = len(stamp_ns)
    nothing = Track(stamp_ns, np.full(m, np.nan), np.full(m, np.nan), np.full(m, np.nan), np.full((m, 3), np.nan), np.full((m, 3), np.nan))
    if len(reference) < 2:
        return nothing
    right = np.clip(np.searchsorted(reference.stamp_ns, stamp_ns), 1, len(reference) - 1)
    a, b = reference.take(right - 1), reference.take(right)
    span = (b.stamp_ns - a.stamp_ns).astype(np.float64)
    share = (stamp_ns - a.stamp_ns) / span
    on_a, on_b = stamp_ns == a.stamp_ns, stamp_ns == b.stamp_ns
    known = ((share >= 0.0) & (share <= 1.0) & (span <= LONGEST_STEP_NS)) | on_a | on_b
    s = np.clip(share, 0.0, 1.0)
    step = span * 1e-9
    # metres north, east and up are small between neighbours: a cubic in each coordinate with the slope that both ends have
    h00, h10, h01, h11 = 2 * s**3 - 3 * s**2 + 1, s**3 - 2 * s**2 + s, -2 * s**3 + 3 * s**2, s**3 - s**2
    d_lon = wrap_longitude(b.lon - a.lon)

    def cubic(start: Floats, change: Floats, scale: Floats, v_a: Floats, v_b: Floats) -> Floats:
        return np.asarray(start * (h00 + h01) + h01 * change + step * scale * (h10 * v_a + h11 * v_b))

    r_m, r_n = radii(a.lat)
    per_north, per_east = 1.0 / (r_m + a.h), 1.0 / ((r_n + a.h) * np.cos(a.lat))  # rad per metre
    lat = cubic(a.lat, b.lat - a.lat, per_north, a.v_n[:, 0], b.v_n[:, 0])
    lon = cubic(a.lon, d_lon, per_east, a.v_n[:, 1], b.v_n[:, 1])
    h = cubic(a.h, b.h - a.h, np.full(m, -1.0), a.v_n[:, 2], b.v_n[:, 2])
    v_n = a.v_n + s[:, None] * (b.v_n - a.v_n)
    c_a, c_b = dcm_from_euler(*a.rph.T), dcm_from_euler(*b.rph.T)
    rph = np.column_stack(euler_from_dcm(c_a @ exp_so3(s[:, None] * log_so3(np.swapaxes(c_a, 1, 2) @ c_b))))
    made = Track(stamp_ns, lat, lon, h, v_n, rph)
    for exact, end in ((on_a, a), (on_b, b)):
        for field in ("lat", "lon", "h", "v_n", "rph"):
            getattr(made, field)[exact] = getattr(end, field)[exact]
    for field in ("lat", "lon", "h", "v_n", "rph"):
        getattr(made, field)[~known] = np.nan
    return made


def read_faults(reader: BagReader, start_at_ns: int) -> list[Fault]:
    """All faults that were injected into a run, times counted from `start_at_ns`; one that was cleared ends when its source no longer names it."""
    if "/truth/faults" not in reader.topics:
        return []
    current: dict[str, dict[tuple[Any, ...], Fault]] = {}
    found: dict[tuple[Any, ...], Fault] = {}
    for _, log_ns, message in reader.read(("/truth/faults",)):
        now: dict[tuple[Any, ...], Fault] = {}
        for entry in message.faults:
            values = read_fault(entry, start_at_ns)
            start = values.pop("start_ns")
            fault = Fault(**{**values, "type": FaultType(values["type"]), "start_ns": 0 if start is None else start})
            key = (message.header.frame_id, fault.target, fault.type, fault.axis, fault.start_ns, fault.size, fault.slope)
            now[key] = found[key] = fault
        stamp = to_ns(message.header.stamp) or log_ns
        for key, fault in current.get(message.header.frame_id, {}).items():
            end = stamp - start_at_ns
            if key not in now and (fault.end_ns is None or fault.end_ns > end):
                if end > fault.start_ns:
                    found[key] = dataclasses.replace(fault, end_ns=end)
                else:
                    del found[key]
        current[message.header.frame_id] = now
    return list(found.values())


def _track(columns: dict[str, NDArray[Any]]) -> tuple[Track, NDArray[np.intp]]:
    """Track of NavState columns in order of stamps, and the rows it was made of (a stamp that comes twice: the later message)."""
    stamps = columns["header.stamp"]
    order = np.argsort(stamps, kind="stable")
    index = order[np.r_[np.diff(stamps[order]) > 0, True]] if len(order) else order
    c = {name: column[index] for name, column in columns.items()}
    v_n = np.column_stack([c["velocity_north"], c["velocity_east"], c["velocity_down"]])
    rph = np.column_stack([c["roll"], c["pitch"], c["heading"]])
    return Track(stamps[index].astype(np.int64), np.radians(c["latitude"]), np.radians(c["longitude"]), c["height"], v_n, rph), index


def _alignments(reader: BagReader) -> list[Alignment]:
    """Alignments that ended, and the one that did not."""
    found: list[Alignment] = []
    running: Alignment | None = None
    for _, _, m in reader.read(["/nav/alignment"]) if holds(reader, "/nav/alignment") else ():
        stamp = to_ns(m.header.stamp)
        one = Alignment(m.method, m.text, "aligned by " in m.text, stamp - round(m.elapsed * 1e9), stamp)
        if one.aligned or "alignment failed" in m.text or "alignment cancelled" in m.text:
            found.append(one)
            running = None
        elif m.phase in (0, 1, 2):  # STANDBY, COARSE, FINE
            running = one
        elif found and found[-1].aligned:
            found[-1] = dataclasses.replace(found[-1], settle_s=float(m.settle_time))
    return found + ([running] if running is not None else [])


def _covariance(reader: BagReader, settled: Track) -> Floats | None:
    if not holds(reader, "/nav/covariance"):
        return None
    columns = reader.columns("/nav/covariance", ("header.stamp", "covariance"))
    flat, stamps = columns["covariance"], columns["header.stamp"]
    side = round(flat.shape[1] ** 0.5)
    states = np.array([int(s) for s in NEES7])
    blocks = flat.reshape(-1, side, side)[:, states[:, None], states]
    order = np.argsort(stamps, kind="stable")
    at = np.clip(np.searchsorted(stamps[order], settled.stamp_ns), 0, len(order) - 1)
    result = blocks[order[at]].copy()
    result[stamps[order[at]] != settled.stamp_ns] = np.nan
    return result


@dataclasses.dataclass(frozen=True)
class _Innovation:
    stamp_ns: int
    innovation: Floats
    sigma: Floats
    standardized: Floats
    nis: float
    threshold: float
    accepted: bool
    reason: int


def _judged(reader: BagReader) -> dict[str, Any]:
    entries: dict[str, list[_Innovation]] = {}
    for _, _, m in reader.read(("/nav/innovations",)):
        one = _Innovation(to_ns(m.header.stamp), m.innovation, m.sigma, m.standardized, m.statistic, m.threshold, m.accepted, m.reason)
        entries.setdefault(m.subfilter, []).append(one)
    return {name: judged_arrays(found) for name, found in entries.items()}


def _sensor_health(reader: BagReader) -> list[HealthChange]:
    if not holds(reader, "/fdi/status"):
        return []
    changes: list[HealthChange] = []
    for kind in ("gyro", "accel"):
        columns = reader.columns("/fdi/status", ("header.stamp", f"{kind}.state", f"{kind}.reason", f"{kind}.since"))
        states, reasons = columns[f"{kind}.state"], columns[f"{kind}.reason"]
        for sensor in range(states.shape[1]):
            moved = np.flatnonzero(np.diff(states[:, sensor].astype(np.int64), prepend=0))
            since = columns[f"{kind}.since.{sensor}"]
            stamps = np.where(since > 0, since, columns["header.stamp"])
            changes += [HealthChange(int(stamps[i]), f"{kind}_{sensor}", int(states[i, sensor]), int(reasons[i, sensor])) for i in moved]
    return changes


def _subfilter_health(reader: BagReader, settled_ns: int) -> list[HealthChange]:
    """Settled changes as they were told; behind the last settled epoch, and in recordings without events, what the states show."""
    changes: dict[tuple[int, str, int], HealthChange] = {}
    state: dict[str, int] = {}
    for _, _, message in reader.read(("/nav/subfilters",)):
        told = hasattr(message, "events")
        found = [HealthChange(to_ns(e.stamp), e.target, int(e.state), int(e.reason)) for e in message.events if e.target] if told else []
        for sub in message.subfilters:
            stamp = to_ns(sub.since) or to_ns(message.header.stamp)
            if int(sub.state) != state.get(sub.name, 0) and (not told or stamp > settled_ns):
                found.append(HealthChange(stamp, sub.name, int(sub.state), int(sub.reason)))
            state[sub.name] = int(sub.state)
        for change in found:
            changes.setdefault((change.stamp_ns, change.target, change.state), change)
    return list(changes.values())


def _sensor_use(reader: BagReader) -> SensorUse | None:
    if not holds(reader, "/imu/fused"):
        return None
    columns = reader.columns("/imu/fused", ("header.stamp", "gyro_used", "accel_used"))
    return SensorUse.from_samples(columns["header.stamp"].astype(np.int64), columns["gyro_used"], columns["accel_used"])


def _samples(reader: BagReader) -> Samples:
    received = lost = late = rejected = no_fix = None
    malformed = 0
    last = {}
    for topic in ("/fdi/status", "/nav/subfilters"):
        for _, _, message in reader.read((topic,)) if topic == "/nav/subfilters" else _last(reader, topic):
            last[topic] = message
    if "/fdi/status" in last:
        m = last["/fdi/status"]
        received, lost = int(m.received), int(m.lost)
        malformed += int(m.rejected_length) + int(m.rejected_stamp) + int(m.rejected_no_solution)
        rejected = malformed
    if "/nav/subfilters" in last:
        m = last["/nav/subfilters"]
        late = sum(int(s.late) for s in m.subfilters)
        rejected = malformed + int(m.imu_rejected) + sum(int(s.malformed) for s in m.subfilters)
        if all(hasattr(s, "no_fix") for s in m.subfilters):  # older recordings count them as rejected
            no_fix = sum(int(s.no_fix) for s in m.subfilters)
    return Samples(received, lost, late, rejected, no_fix)


def _drift(reader: BagReader) -> Floats | None:
    """What was removed from each sensor after the last sample, (2, n)."""
    last = _last(reader, "/fdi/status") if holds(reader, "/fdi/status") else []
    drifts = [np.asarray(getattr(last[0][2], kind).drift, np.float64) for kind in ("gyro", "accel")] if last else []
    return np.stack(drifts) if drifts and len(drifts[0]) == len(drifts[1]) > 0 else None


def _last_status_ns(reader: BagReader) -> int:
    last = _last(reader, "/fdi/status") if holds(reader, "/fdi/status") else []
    return to_ns(last[0][2].header.stamp) if last else 0


def _last(reader: BagReader, topic: str) -> list[Any]:
    """The last message of a topic, without reading the others of a long recording."""
    for back_s in (5, 60, 10**9):
        found = list(reader.read((topic,), start_ns=max(0, reader.end_ns - back_s * 1_000_000_000)))
        if found:
            return found[-1:]
    return []


def read_fixes(reader: BagReader, name: str) -> tuple[Stamps, Floats, Floats] | None:
    """Fixes of gps or bds: stamps, latitudes, longitudes [rad]; None when the bag has no such topic."""
    topic = f"/{name}/fix"
    if not holds(reader, topic):
        return None
    c = reader.columns(topic, ("header.stamp", "latitude", "longitude", "status.status"))
    good = c["status.status"] >= 0
    return c["header.stamp"][good], np.radians(c["latitude"][good]), np.radians(c["longitude"][good])


def _name(configuration: RunConfiguration, reader: BagReader) -> str:
    return configuration.scenario.name if configuration.scenario else reader.path.name


def _sail_twins(record: RunRecord, configuration: RunConfiguration, faults: list[Fault], twins: bool | None, progress: Progress | None) -> None:
    """Sail the scenario of a recorded run again: the noise is the same, so that the twins belong to it."""
    scenario = configuration.scenario
    if scenario is None or not configuration.simulated:
        return
    if twins is None and scenario.duration_s > CHEAP_S:
        record.notes.append("The bag has no fault-free twin and no oracle; `--twins` sails the scenario again for them.")
        return
    planned = {(f.target, f.type, f.start_ns) for f in scenario.fault_schedule().faults}
    if {(f.target, f.type, f.start_ns) for f in faults} != planned:
        record.notes.append(
            "The faults of this run are not those of its scenario (they were injected or cleared under way): there is no twin to compare with."
        )
        return
    from .offline import sail

    assert record.origin_ns is not None
    again = sail(scenario, progress=progress, start_at_ns=record.origin_ns).record
    record.twin = again.twin.at(record.settled.stamp_ns) if again.twin is not None else None
    record.oracle = again.oracle.at(record.settled.stamp_ns) if again.oracle is not None else None
    if record.twin is None:
        record.notes.append("The settled epochs of this run are not those of its scenario sailed again: there is no twin to compare with.")
