"""A recorded bag navigated again: raw topics through the same fusion and navigator, offline.

Lives here: `navigate`.
Does not live here: bag files (riins_bag), what a message says (riins_node.readings), the algorithms.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from riins_bag.bag import BagReader
from riins_federated.aid_inputs import AidInput, inputs
from riins_federated.alignment_settings import AlignCommand, MasterState
from riins_federated.navigator import Navigator
from riins_federated.timeline import SOON_NS
from riins_federated.types import Aid, InitialState, UseCommand
from riins_imu_fusion.config import KINDS
from riins_imu_fusion.types import FusedBlock, join
from riins_node import alignment_fields, readings

from . import score as scoring
from .bag_record import read_faults, read_fixes, read_reference, reference_at, run_start
from .lane import FusionLog, Lane, aid_notes, fault_intervals, warm_up
from .offline import RunResult, reporting_pipeline, samples
from .recording import RAW_IMU, RunWriter
from .run_configuration import RecordError, RunConfiguration, holds, read_configuration, with_settings
from .run_record import RunRecord

WINDOW_NS = 10_000_000_000
PLAIN_IMU = "/imu/data_raw"
INITIAL_TOPIC, COMMAND_TOPIC, METHOD_TOPIC = "/nav/initial_state", "/nav/commands", "/fdi/method"
ALIGN_TOPIC, MASTER_TOPIC = "/nav/align", "/master/state"
RAW_TOPICS = (
    RAW_IMU, "/gps/fix", "/bds/fix", "/doppler/velocity", "/gps/velocity", "/bds/velocity", "/odometer/velocity", "/altimeter/height",
    "/star_tracker/attitude", INITIAL_TOPIC, COMMAND_TOPIC, ALIGN_TOPIC, METHOD_TOPIC, MASTER_TOPIC,
    "/truth/state", "/truth/odometry", "/truth/faults",
)  # fmt: skip


class _Method(NamedTuple):
    """Arguments of FusionPipeline.set_method."""

    fusion: str
    parity_test: str
    sequential_test: str
    adapt_noise: bool
    effective_ns: int


Other = Aid | InitialState | UseCommand | AlignCommand | MasterState | _Method


class _Window(NamedTuple):
    """What arrived within a stretch of log time, IMU samples in order of arrival."""

    log_ns: NDArray[np.int64]
    stamp_ns: NDArray[np.int64]
    sequence: NDArray[np.uint32]
    gyro: NDArray[np.float64]
    accel: NDArray[np.float64]
    gyro_valid: NDArray[np.uint64]
    accel_valid: NDArray[np.uint64]
    gyros: NDArray[np.int64]
    accels: NDArray[np.int64]
    others: list[tuple[int, Other]]


def navigate(
    bag_in: str | Path,
    bag_out: str | Path | None = None,
    record: str = "nav",
    progress: Callable[[float, float], None] | None = None,
    overrides: dict[str, Any] | None = None,
    namespace: str | None = None,
) -> RunResult:
    """Fuse and navigate from the raw topics of a bag, with the settings that are in it; without an initial state the fusion runs alone.

    Parameters
    ----------
    bag_in : bag with /rimu/raw, aids, /nav/initial_state and /riins/configuration
    bag_out : directory to write; None: nothing is written. Aids, initial states, commands, truth, faults are copied: it can be scored alone
    record : nav, raw (copies /rimu/raw too) or all, see recording.RECORDS
    progress : called with (recorded seconds done, seconds in all)
    overrides : settings that replace the recorded ones: {"navigator": {"gps": {"enabled": False}}}; where they name an alignment method, initial
        states of the recording are left alone
    namespace : of the recorded topics, taken off in the new bag; None: the one there is

    Returns
    -------
    RunResult

    Raises
    ------
    RecordError
        The bag lacks raw samples or its configuration; a simulated run lacks its initial state; that does not belong to the samples.
    BagError, SettingError
    """
    with BagReader(bag_in, namespace) as reader:
        if holds(reader, PLAIN_IMU) and not holds(reader, RAW_IMU) and not holds(reader, "/imu/fused"):
            raise RecordError(
                f"{bag_in} has no {RAW_IMU}, only {PLAIN_IMU} of one IMU: play it (ros2 bag play) to a navigator with imu_topic_type imu"
            )
        configuration = read_configuration(reader, overrides)
        if not holds(reader, RAW_IMU):
            raise RecordError(f"{bag_in} has no {RAW_IMU}: there is nothing to navigate from")
        aligned = (overrides or {}).get("navigator", {}).get("alignment", {}).get("method", "none") != "none"
        run = _Run(reader, configuration, frozenset((overrides or {}).get("fusion", {})), aligned)
        if bag_out is None or record == "none":
            return run.through(None, progress)
        with RunWriter(bag_out, record) as writer:
            return run.through(writer, progress)


class _Run:
    """One bag on its way through fusion and navigator."""

    def __init__(self, reader: BagReader, configuration: RunConfiguration, overridden: frozenset[str], aligned: bool = False) -> None:
        self.reader, self.configuration, self._overridden = reader, configuration, overridden
        self._aligned = aligned  # the caller wants it to find the state that it is given in the recording
        self.pipeline = reporting_pipeline(configuration.fusion)
        self._aids: dict[str, list[AidInput]] = {}
        for source in inputs(configuration.navigator.aid):
            self._aids.setdefault(f"/{source.topic.strip('/')}", []).append(source)
        self.lane = Lane(Navigator(configuration.navigator))
        self.fusion = FusionLog()
        self._max_delay = round(configuration.navigator.max_delay_s * 1e9)
        self._newest = -(2**62)
        self._writer: RunWriter | None = None
        self.notes: list[str] = []
        aligns = configuration.navigator.alignment.method != "none" or holds(reader, ALIGN_TOPIC)
        self._alone = not holds(reader, INITIAL_TOPIC) and not aligns
        if self._alone and configuration.simulated:
            raise RecordError(f"{reader.path} has no {INITIAL_TOPIC}, and no alignment: the navigator would never start")
        if self._alone:
            self.notes.append("There is no initial state in the bag: fusion and fault detection ran alone, nothing was navigated.")

    def through(self, writer: RunWriter | None, progress: Callable[[float, float], None] | None) -> RunResult:
        """Everything, in windows of about 10 s of log time."""
        self._writer = writer
        warm_up(self.pipeline)
        began = time.perf_counter()
        if writer is not None:
            writer.configuration(with_settings(self.configuration), self.reader.start_ns)
            drop = (METHOD_TOPIC, *(() if writer.raw else (RAW_IMU,)), *((INITIAL_TOPIC,) if self._aligned else ()))
            writer.copy(self.reader, dict.fromkeys((*RAW_TOPICS, *self._aids)), drop=drop)
            if METHOD_TOPIC not in self.reader.topics:
                writer.method(0, self.pipeline.selected(), self.reader.start_ns)
        total = self.reader.duration_s
        for done_ns, window in self._windows():
            for part in _cut(window, self._max_delay):
                self._obey(part)
                fused = self._fuse(part)
                self._feed(part, fused)
                if writer is None:
                    self.pipeline.drain_statuses()
                else:
                    writer.fused_imu(fused, self.pipeline)
                    self.lane.write(writer, self.pipeline.drain_statuses())
            if progress is not None:
                progress(min((done_ns - self.reader.start_ns) * 1e-9, total), total)
        self.lane.finish()
        if writer is not None:
            self.lane.write(writer, self.pipeline.drain_statuses())
            writer.inertial(self.pipeline.status())  # what the last samples made of it
        seconds = time.perf_counter() - began
        made = self._record(seconds)
        return RunResult(made, scoring.score(made), seconds)

    def _windows(self) -> Iterator[tuple[int, _Window]]:
        names = ("header.stamp", "sequence", "gyro", "accel", "gyro_valid", "accel_valid")
        initial = () if self._aligned else (INITIAL_TOPIC,)
        others_from = [t for t in (*self._aids, *initial, MASTER_TOPIC) if t in self.reader.topics]
        commands_from = [t for t in (COMMAND_TOPIC, ALIGN_TOPIC, METHOD_TOPIC) if t in self.reader.topics]
        heard = [(log_ns, self._command(topic, m)) for topic, log_ns, m in self.reader.read(commands_from)] if commands_from else []
        # a busy recorder may hear of a command long after the sample it holds from: its own stamp counts if it is earlier
        commands = [(min(log_ns, c.effective_ns if isinstance(c, _Method) else c.stamp_ns), c) for log_ns, c in heard]
        start = self.reader.start_ns
        while start <= self.reader.end_ns:
            stop = start + WINDOW_NS
            c = self.reader.columns(RAW_IMU, names, start, stop)
            others: list[tuple[int, Other]] = []
            others += [(log_ns, item) for topic, log_ns, message in self.reader.read(others_from, start, stop) for item in self._take(topic, message)]
            others += [c for c in commands if c[0] < stop + self._max_delay]
            commands = [c for c in commands if c[0] >= stop + self._max_delay]
            yield stop, _Window(
                c["log_time"], c["header.stamp"].astype(np.int64), c["sequence"].astype(np.uint32), c["gyro"], c["accel"],
                c["gyro_valid"].astype(np.uint64), c["accel_valid"].astype(np.uint64), c["gyro.count"], c["accel.count"], others,
            )  # fmt: skip
            start = stop

    def _take(self, topic: str, message: Any) -> list[Other]:
        if topic == INITIAL_TOPIC:
            return [InitialState(**readings.read_initial_state(message))]
        if topic == MASTER_TOPIC:
            return [MasterState(**alignment_fields.read_master_state(message))]
        return [aid for source in self._aids[topic] if (aid := source.read(message)) is not None]

    def _command(self, topic: str, message: Any) -> UseCommand | AlignCommand | _Method:
        """A command of the recording; what the caller has overridden stays as he wants it."""
        if topic == COMMAND_TOPIC:
            return UseCommand(**readings.read_sensor_use(message))
        if topic == ALIGN_TOPIC:
            return AlignCommand(**alignment_fields.read_align_command(message))
        fusion, given = self.configuration.fusion, readings.read_fusion_method(message)
        names = {"fusion": "method", "parity_test": "parity_test", "sequential_test": "sequential_test", "adapt_noise": "adapt_noise"}
        return _Method(**{**given, **{ours: getattr(fusion, name) for ours, name in names.items() if name in self._overridden}})

    def _obey(self, part: _Window) -> None:
        """Commands before the samples: each waits for its own stamp. A selection is written as it is obeyed, with what the caller has overridden."""
        for log_ns, item in part.others:
            if isinstance(item, _Method):
                result = self.pipeline.set_method(*item)
                if result.success and self._writer is not None:
                    self._writer.method(item.effective_ns, self.pipeline.selected(result.effective_ns), max(log_ns, self.reader.start_ns))
                if not result.success:
                    self.notes.append(f"Selection at {(item.effective_ns - self.reader.start_ns) / 1e9:.1f} s refused: {result.message}.")
                continue
            if not isinstance(item, UseCommand | AlignCommand):
                continue
            if isinstance(item, AlignCommand):
                problem = self.lane.navigator.align(item)
            elif item.name.partition("_")[0] in KINDS:
                result = self.pipeline.set_sensor_use(item.name, item.use, item.stamp_ns)
                problem = "" if result.success else result.message
            else:
                problem = self.lane.navigator.set_use(item)
            if problem:
                self.notes.append(f"Command at {(item.stamp_ns - self.reader.start_ns) / 1e9:.1f} s refused: {problem}.")

    def _fuse(self, part: _Window) -> FusedBlock:
        """Fuse the samples; those with the wrong number of axes are rejected where they stand."""
        good = (part.gyros == self.pipeline.n) & (part.accels == self.pipeline.n)
        if good.all():
            pieces = [slice(0, len(good))]
        else:
            edges = [0, *(np.flatnonzero(np.diff(good)) + 1).tolist(), len(good)]
            pieces = [slice(a, b) for a, b in itertools.pairwise(edges)]
        out: list[FusedBlock] = []
        for piece in pieces:
            if piece.start < piece.stop and not good[piece.start]:
                for k in range(piece.start, piece.stop):
                    self.pipeline.reject_length(int(part.stamp_ns[k]), int(part.sequence[k]), int(part.gyros[k]), int(part.accels[k]))
                continue
            out.append(self._process(part, piece))
        if not out:  # nothing but samples of the wrong length
            out.append(self._process(part, slice(0, 0)))
        fused = out[0] if len(out) == 1 else join(out)
        self.fusion.add(fused, self.pipeline.drain_events())
        return fused

    def _process(self, part: _Window, rows: slice) -> FusedBlock:
        n = self.pipeline.n  # columns are as wide as the longest message of the window
        gyro, accel = part.gyro[rows, :n], part.accel[rows, :n]
        return self.pipeline.process(part.stamp_ns[rows], part.sequence[rows], gyro, accel, part.gyro_valid[rows], part.accel_valid[rows])

    def _feed(self, part: _Window, fused: FusedBlock) -> None:
        """Aids before the samples, as the block is one; what had come too late live comes after them, and is late again."""
        if self._alone:
            return
        late: list[Aid] = []
        newest = np.maximum.accumulate(np.maximum(part.stamp_ns, self._newest)) if len(part.stamp_ns) else part.stamp_ns
        early: list[Aid] = []
        for log_ns, item in part.others:
            if isinstance(item, UseCommand | AlignCommand | _Method):
                continue
            if isinstance(item, MasterState):
                self.lane.navigator.add_master(item)
                continue
            if isinstance(item, InitialState):
                problem = self.lane.navigator.set_initial_state(item)
                if problem:
                    self.notes.append(f"Initial state at {(item.stamp_ns - self.reader.start_ns) / 1e9:.1f} s refused: {problem}.")
                continue
            before = int(np.searchsorted(part.log_ns, log_ns, side="left"))
            seen = int(newest[before - 1]) if before else self._newest
            if seen > -(2**61) and item.stamp_ns - seen > max(SOON_NS, self._max_delay):
                self.lane.navigator.add_aid(item, seen)  # refused and counted, as it was live
                continue
            (late if 0 <= seen - item.stamp_ns - self._max_delay < 2**61 else early).append(item)
        self.lane.feed(early, fused, self.pipeline)
        self.lane.calibrate(self.pipeline)
        for aid in late:
            self.lane.navigator.add_aid(aid)
        if len(newest):
            self._newest = int(part.stamp_ns[-1]) if part.stamp_ns[-1] < self._newest - self._max_delay else int(newest[-1])

    def _record(self, seconds: float) -> RunRecord:
        lane, reader, configuration = self.lane, self.reader, self.configuration
        settled = lane.track
        if not len(settled) and not self._alone and not lane.alignments:
            delay = configuration.navigator.max_delay_s
            raise RecordError(f"{reader.path}: the navigator never started; is the initial state within {delay:g} s of an IMU sample?")
        start_ns = run_start(reader, configuration, settled)
        scenario, recording = configuration.scenario, configuration.recording
        counters, report = self.pipeline.counters, lane.navigator.status()
        return RunRecord(
            scenario.name if scenario else reader.path.name, settled, reference_at(read_reference(reader), settled.stamp_ns),
            description=scenario.description if scenario else "", covariance=lane.covariance,
            protection_radius=lane.protection_radius, mode=lane.mode,
            judged=lane.judged_arrays, health=sorted(self.fusion.health + lane.health, key=lambda c: c.stamp_ns),
            faults=fault_intervals(read_faults(reader, start_ns), start_ns, max(reader.end_ns, int(settled.stamp_ns[-1]) + 1 if len(settled) else 0)),
            origin_ns=start_ns,
            scoring_from_ns=start_ns + (round(scenario.scoring.from_s * 1e9) if scenario else 0), use=self.fusion.use,
            samples=samples(counters, report),
            n_sensors=self.pipeline.n, realtime_factor=reader.duration_s / seconds if seconds > 0.0 else None,
            pieces=[(p["name"], p["start_ns"], p["stop_ns"]) for p in recording.get("pieces", [])],
            aid_fixes={name: fixes for name in ("gps", "bds") if (fixes := read_fixes(reader, name)) is not None},
            expect=dict(scenario.expect) if scenario else {},
            notes=[*recording.get("notes", []), *self.notes, *(aid_notes(report.subfilters) if len(settled) else [])],
            drift=self.pipeline.drift, ended_ns=self.pipeline.last_stamp_ns or 0, alignments=lane.alignments, inertial=lane.inertial,
        )  # fmt: skip


def _cut(window: _Window, max_delay_ns: int) -> Iterator[_Window]:
    """A window cut where the IMU stamp jumps: what belongs before the jump must be worked before the run restarts."""
    jumps = np.flatnonzero(np.abs(np.diff(window.stamp_ns)) > max_delay_ns) + 1
    edges = [0, *jumps.tolist(), len(window.stamp_ns)]
    first_log = -(2**62)
    for number, (a, b) in enumerate(itertools.pairwise(edges)):
        until = int(window.log_ns[b]) if number < len(edges) - 2 else 2**62
        others = [(log, item) for log, item in window.others if first_log <= log < until]
        first_log = until
        yield window._replace(others=others, **{name: getattr(window, name)[a:b] for name in window._fields if name != "others"})
