"""The same algorithm objects without DDS: a scenario sailed, in blocks of about 10 s, far faster than real time.

Lives here: `sail` (simulate, fuse, navigate, score), `RunResult`, and `navigate` (from a bag, renavigate.py) by name.
Does not live here: the algorithms, what a bag of it holds (recording.py), what is kept for scoring (lane.py).
"""

from __future__ import annotations

import copy
import dataclasses
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from riins_federated.navigator import Navigator
from riins_federated.types import InitialState
from riins_imu_fusion.config import FusionConfig
from riins_imu_fusion.pipeline import FusionPipeline
from riins_imu_fusion.types import FusedBlock
from riins_sim import scenario as scenarios
from riins_sim.faults import Fault
from riins_sim.initial import initial_state
from riins_sim.scenario import Scenario
from riins_sim.sensors import PositionSim, RawBlock, RedundantImuSim
from riins_sim.trajectory import Trajectory

from . import blocks, configure
from . import score as scoring
from .lane import FusionLog, Lane, aid_notes, fault_intervals, warm_up
from .recording import ORACLE_TOPIC, TWIN_TOPIC, RunWriter
from .run_configuration import RecordError
from .run_record import RunRecord, Samples
from .simulated_aids import Found, SimulatedAids

START_NS = 1_600_000_000_000_000_000
"""Epoch of a run that has no date of its own (2020-09-13T12:26:40Z)."""
CHUNK_S = 10.0
TRUTH_PERIOD_NS = 100_000_000

Progress = Callable[[float, float], None]


@dataclasses.dataclass
class RunResult:
    """A finished run.

    Attributes
    ----------
    record : what scoring and reporting need
    score : of it, see docs/json.md
    seconds : of computing, without compilation
    """

    record: RunRecord
    score: scoring.Score
    seconds: float

    @property
    def expect(self) -> dict[str, Any]:
        """What the scenario promises."""
        return self.record.expect


def sail(
    scenario: Scenario | str | Path,
    seed: int | None = None,
    bag: str | Path | None = None,
    record: str = "nav",
    progress: Progress | None = None,
    twins: bool = True,
    start_at_ns: int = START_NS,
) -> RunResult:
    """Simulate, fuse, navigate and score a voyage.

    Parameters
    ----------
    scenario : a Scenario, the name of a shipped one, or a YAML file
    seed : of all noise; None: the scenario's
    bag : directory to write; None: nothing is written
    record : nav, raw or all, see recording.RECORDS
    progress : called with (simulated seconds, seconds in all)
    twins : sail the fault-free twin (same noise, no fault) and the oracle (the same navigator, told the fault intervals) in lock step
    start_at_ns : measurement time of sample 0

    Returns
    -------
    RunResult

    Raises
    ------
    ScenarioError, SettingError, BagError
    RecordError
        The navigator never started.
    """
    ship = scenario if isinstance(scenario, Scenario) else scenarios.load(scenario)
    voyage = _Voyage(ship if seed is None else ship.with_seed(seed), twins, start_at_ns)
    if bag is None or record == "none":
        return voyage.run(None, progress)
    with RunWriter(bag, record) as writer:
        return voyage.run(writer, progress)


class _Voyage:
    """One scenario under way: sensors, fusion, and the navigators in lock step."""

    def __init__(self, scenario: Scenario, twins: bool, start_at_ns: int) -> None:
        self.scenario, self.start = scenario, start_at_ns
        self.trajectory = Trajectory(scenario)
        self.imu = RedundantImuSim(scenario, self.trajectory)
        self.faults = scenario.fault_schedule()
        self.imu_faults = self.faults.only(["gyro", "accel"])
        self.twins = twins and bool(self.faults.faults)
        self.same = twins and not self.faults.faults
        self.fusion_config, self.navigator_config = configure.simulated_fusion_config(scenario), configure.navigator_config(scenario)
        self.aids = SimulatedAids(scenario, self.trajectory, self.navigator_config, start_at_ns)
        self.pipeline = reporting_pipeline(self.fusion_config)
        self.lane = Lane(Navigator(self.navigator_config))
        self.log_of_fusion = FusionLog()
        # before the first fault the twin and the oracle are the run itself: they part from it as copies
        self.twin: Lane | None = None
        self.oracle: Lane | None = None
        self.twin_pipeline = self.oracle_pipeline = self.pipeline

    def run(self, writer: RunWriter | None, progress: Progress | None) -> RunResult:
        """Sail from start to end."""
        warm_up(self.pipeline)
        began = time.perf_counter()
        drawn = initial_state(self.scenario, self.trajectory)
        names = [f.name for f in dataclasses.fields(InitialState) if f.name not in ("stamp_ns", "source") and hasattr(drawn, f.name)]
        state = InitialState(stamp_ns=self.start + drawn.stamp_ns, source="scenario", **{n: getattr(drawn, n) for n in names})
        given = self.scenario.initial.given
        if given:
            self.lane.navigator.set_initial_state(_as_received(state))
        if writer is not None:
            writer.configuration(configure.configuration_text(self.scenario, self.start), self.start)
            writer.method(0, self.pipeline.selected(), self.start)
            if given:
                writer.initial_state(state)
            writer.faults(self.start, self.faults.faults, self.start, "scenario")
            writer.truth(np.array([self.start]), self.trajectory.truth([0.0]))
        size = max(1, round(CHUNK_S / self.trajectory.dt))
        for k0 in range(1, self.imu.samples + 1, size):
            self._chunk(k0, min(size, self.imu.samples + 1 - k0), writer)
            if progress is not None:
                progress(min(self.trajectory.duration, (k0 + size) * self.trajectory.dt), self.trajectory.duration)
        for lane in self._lanes():
            lane.finish()
        self._write_settled(writer)
        if writer is not None:
            writer.inertial(self.pipeline.status())  # what the last samples made of it
        seconds = time.perf_counter() - began
        made = self._record(self.imu.samples * self.trajectory.dt / seconds)
        if writer is not None:
            for topic, track in ((TWIN_TOPIC, made.twin), (ORACLE_TOPIC, made.oracle)):
                if track is not None:
                    writer.evaluation(topic, track)
        return RunResult(made, scoring.score(made), seconds)

    def _lanes(self) -> list[Lane]:
        return [lane for lane in (self.lane, self.twin, self.oracle) if lane is not None]

    def _chunk(self, k0: int, m: int, writer: RunWriter | None) -> None:
        first_ns, last_ns = int(self.imu.stamp_ns(k0 - 1)), int(self.imu.stamp_ns(k0 + m - 1))
        if self.twins and self.twin is None and any(f.start_ns <= last_ns for f in self.faults.faults):
            self._part()
        faulty_imu = _touches(self.imu_faults.faults, first_ns, last_ns)
        raw = self.imu.block(k0, m, self.imu_faults if faulty_imu else None)
        stamps = self.start + raw.stamp_ns
        sequence = (raw.k & 0xFFFFFFFF).astype(np.uint32)
        fused = _fuse(self.pipeline, stamps, sequence, raw)
        self.log_of_fusion.add(fused, self.pipeline.drain_events())
        found = self.aids.between(first_ns, last_ns, self.faults)
        aids = self.aids.read(found)
        self.lane.feed(aids, fused, self.pipeline)
        self.lane.calibrate(self.pipeline)
        if self.twin is not None and self.oracle is not None:
            clean, hidden = raw, raw
            if faulty_imu:
                clean, hidden = self.imu.block(k0, m, None), _hide(raw, self.imu_faults.faults)
            block = fused if self.twin_pipeline is self.pipeline else _fuse(self.twin_pipeline, stamps, sequence, clean)
            self.twin.feed(self.aids.read(self.aids.between(first_ns, last_ns, None)), block, self.twin_pipeline)
            block = fused if self.oracle_pipeline is self.pipeline else _fuse(self.oracle_pipeline, stamps, sequence, hidden)
            self.oracle.feed([aid for aid in aids if not self.aids.lies(aid, self.faults.faults)], block, self.oracle_pipeline)
            for lane, pipeline in ((self.twin, self.twin_pipeline), (self.oracle, self.oracle_pipeline)):
                if pipeline is not self.pipeline:
                    lane.calibrate(pipeline)
        if writer is None:
            self.pipeline.drain_statuses()
        else:
            self._write(writer, first_ns, last_ns, stamps, sequence, raw, fused, found)

    def _part(self) -> None:
        self.twin, self.oracle = copy.deepcopy(self.lane), copy.deepcopy(self.lane)
        if self.imu_faults.faults:
            self.twin_pipeline, self.oracle_pipeline = copy.deepcopy(self.pipeline), copy.deepcopy(self.pipeline)

    def _write(
        self,
        writer: RunWriter,
        first_ns: int,
        last_ns: int,
        stamps: Any,
        sequence: Any,
        raw: RawBlock,
        fused: FusedBlock,
        found: Found,
    ) -> None:
        writer.raw_imu(stamps, sequence, raw)
        for name, (aid_stamps, block) in found.items():
            writer.aid(name, aid_stamps, block)
        writer.fused_imu(fused, self.pipeline)
        period = TRUTH_PERIOD_NS if writer.raw else 1_000_000_000
        times = np.arange(first_ns // period + 1, last_ns // period + 1, dtype=np.int64) * period
        writer.truth(self.start + times, self.trajectory.truth(times * 1e-9))
        self._write_settled(writer)

    def _write_settled(self, writer: RunWriter | None) -> None:
        statuses = self.pipeline.drain_statuses()
        if writer is not None and writer.nav:
            self.lane.write(writer, statuses)

    def _record(self, realtime_factor: float) -> RunRecord:
        lane, end_ns = self.lane, self.start + int(self.imu.stamp_ns(self.imu.samples)) + 1
        settled = lane.track
        counters, report = self.pipeline.counters, lane.navigator.status()
        if not len(settled) and not lane.alignments:
            fused = f"{counters.fused} of {counters.received} samples of the IMU were fused"
            raise RecordError(f"{self.scenario.name}: the navigator never started: {fused}")
        fixes = {}
        for name, sensor in self.aids.sensors.items():
            if not isinstance(sensor, PositionSim):
                continue
            block = sensor.block(1, sensor.samples, self.faults)
            fixes[name] = (self.start + block.stamp_ns[block.has_fix], block.lat[block.has_fix], block.lon[block.has_fix])
        return RunRecord(
            self.scenario.name, settled, blocks.track_of_truth(self.trajectory.truth((settled.stamp_ns - self.start) * 1e-9), settled.stamp_ns),
            description=self.scenario.description, covariance=lane.covariance, protection_radius=lane.protection_radius, mode=lane.mode,
            judged=lane.judged_arrays, health=sorted(self.log_of_fusion.health + lane.health, key=lambda c: c.stamp_ns),
            faults=fault_intervals(self.faults.faults, self.start, end_ns), origin_ns=self.start,
            scoring_from_ns=self.start + round(self.scenario.scoring.from_s * 1e9), use=self.log_of_fusion.use,
            samples=samples(counters, report), n_sensors=self.pipeline.n,
            twin=settled if self.same else self.twin.track.at(settled.stamp_ns) if self.twin else None,
            oracle=settled if self.same else self.oracle.track.at(settled.stamp_ns) if self.oracle else None,
            realtime_factor=realtime_factor, aid_fixes=fixes, expect=dict(self.scenario.expect), drift=self.pipeline.drift, ended_ns=end_ns,
            alignments=lane.alignments, notes=aid_notes(report.subfilters) if len(settled) else [], inertial=lane.inertial,
        )  # fmt: skip


def reporting_pipeline(config: FusionConfig) -> FusionPipeline:
    """A pipeline that collects its status at every change and every CHUNK_S, not ten times a second: 12 h must not cost a minute of status."""
    return FusionPipeline(dataclasses.replace(config, status_period_s=CHUNK_S), statuses=True)


def samples(counters: Any, report: Any) -> Samples:
    """Counters of a pipeline and a navigator, as the score has them."""
    malformed = counters.rejected_length + counters.rejected_stamp + counters.rejected_no_solution + report.imu_rejected
    late, wrong, no_fix = (sum(getattr(s, name) for s in report.subfilters) for name in ("late", "malformed", "no_fix"))
    return Samples(counters.received, counters.lost, late, malformed + wrong, no_fix)


def _as_received(state: InitialState) -> InitialState:
    """The state after its message, which carries degrees."""
    return dataclasses.replace(state, lat=float(np.radians(np.degrees(state.lat))), lon=float(np.radians(np.degrees(state.lon))))


def _fuse(pipeline: FusionPipeline, stamps: Any, sequence: Any, raw: RawBlock) -> FusedBlock:
    return pipeline.process(stamps, sequence, raw.gyro, raw.accel, raw.gyro_valid, raw.accel_valid)


def _touches(faults: tuple[Fault, ...], first_ns: int, last_ns: int) -> bool:
    return any(f.start_ns <= last_ns and (f.end_ns is None or f.end_ns > first_ns) for f in faults)


def _hide(raw: RawBlock, faults: tuple[Fault, ...]) -> RawBlock:
    """The block as the oracle sees it: a sensor with a fault in force says that it is invalid."""
    valid = {"gyro": raw.gyro_valid.copy(), "accel": raw.accel_valid.copy()}
    for fault in faults:
        word, _, number = fault.target.partition("_")
        inside = (raw.stamp_ns >= fault.start_ns) & (raw.stamp_ns < (fault.end_ns if fault.end_ns is not None else 2**62))
        valid[word][inside] &= ~np.uint64(1 << int(number))
    return dataclasses.replace(raw, gyro_valid=valid["gyro"], accel_valid=valid["accel"])


def navigate(
    bag_in: str | Path,
    bag_out: str | Path | None = None,
    record: str = "nav",
    progress: Progress | None = None,
    overrides: dict[str, Any] | None = None,
    namespace: str | None = None,
) -> RunResult:
    """Fuse and navigate from the raw topics of a bag; see `renavigate.navigate`."""
    from . import renavigate

    return renavigate.navigate(bag_in, bag_out, record, progress, overrides, namespace)
