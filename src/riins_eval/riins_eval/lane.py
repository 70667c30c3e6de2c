"""One pass of fused samples and aids through a navigator, with everything that scoring needs kept as arrays.

Lives here: `Lane` (navigator and what came out), `FusionLog` (what came out of the fusion), what a fault and a change of health are for scoring.
Does not live here: where the samples come from (offline.py), what is made of the arrays (score.py).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from riins_fdi.health import TRIAD_CODE
from riins_federated.alignment_settings import AlignmentReport
from riins_federated.alignment_settle import AlignmentStatus, SettleWatch
from riins_federated.calibration import Calibration, Calibrator
from riins_federated.navigator import Navigator
from riins_federated.types import Aid, FederatedReport, NavEvent, Recall
from riins_imu_fusion.pipeline import FusionPipeline
from riins_imu_fusion.types import FdiEvent, FdiStatus, FusedBlock

from . import blocks, metrics
from .recording import RunWriter
from .run_record import FAULT_TYPES, HEALTHY, Alignment, FaultInterval, HealthChange, Judged, SensorUse, Stamps, Track

Floats = NDArray[np.float64]

_UNITS = {  # of faults that are not in metres, with their number in an SI unit
    "gyro": (3600.0 * 180.0 / np.pi, "deg/h"), "accel": (1e6 / 9.80665, "ug"), "doppler": (1.0, "m/s"), "odometer": (1.0, "m/s"),
    "star_tracker": (3600.0 * 180.0 / np.pi, "arcsec"),
}  # fmt: skip
_NEES = np.array([int(s) for s in metrics.NEES7])


class Lane:
    """A navigator and its results.

    Parameters
    ----------
    navigator : fresh

    Attributes
    ----------
    calibrations, solutions, judged, events, alignment : what came out when `drain` was last called, for `write`
    """

    def __init__(self, navigator: Navigator) -> None:
        self.navigator = navigator
        self.solutions: list[Any] = []
        self.judged: list[Any] = []
        self.events: list[NavEvent] = []
        self.calibrations: list[Calibration] = []
        self.alignment: list[AlignmentStatus] = []
        self._report: AlignmentReport | None = None
        self._ended: list[Alignment] = []
        self._watch = SettleWatch(navigator.config)
        self._calibrator = Calibrator(navigator.config)
        self._tracks: list[Track] = []
        self._inertial: list[Track] = []
        self._covariances: list[Floats] = []
        self._modes: list[Floats] = []
        self._judged: dict[str, list[Any]] = {}
        self.health: list[HealthChange] = []

    def feed(self, aids: list[Aid], block: FusedBlock, pipeline: FusionPipeline) -> None:
        """Give the aids up to the last sample, then the samples of a pipeline, and take out what is settled."""
        for aid in aids:
            self.navigator.add_aid(aid)
        self.navigator.add_imu(block.stamp_ns, block.sequence, block.rate, block.force, recalls_of(block), *blocks.covariances(block, pipeline))
        self.drain()

    def calibrate(self, pipeline: FusionPipeline) -> None:
        """Tell the fusion that feeds this navigator what it has found of the biases, as nav/calibration does."""
        for one in self.calibrations:
            pipeline.add_calibration(one.effective_ns, one.gyro_bias, one.gyro_covariance, one.accel_bias, one.accel_covariance)

    def finish(self) -> None:
        """End of the run: what is left is settled."""
        self.navigator.finish()
        self.drain()

    def drain(self) -> None:
        """Take out what is settled."""
        self.solutions, self.judged = self.navigator.drain_settled(), self.navigator.drain_judged()
        self.calibrations = self._calibrator.take(self.solutions)
        reports = self.navigator.drain_alignment()
        self.alignment = self._watch.take(reports, self.solutions)
        self._report = reports[-1] if reports else self._report
        self._ended += [_alignment(report) for report in reports if report.ended]
        if self.alignment and self._ended and self._ended[-1].aligned:
            self._ended[-1] = dataclasses.replace(self._ended[-1], settle_s=self.alignment[-1].settle_s)
        if self.solutions:
            self._tracks.append(blocks.track_of(self.solutions))
            alone = [s.inertial for s in self.solutions if s.inertial is not None]
            if alone:
                self._inertial.append(blocks.track_of(alone))
            self._covariances.append(np.array([s.P[_NEES[:, None], _NEES] for s in self.solutions]))
            self._modes.append(np.array([[int(s.mode), s.protection_radius] for s in self.solutions]))
        for one in self.judged:
            self._judged.setdefault(one.name, []).append(one)
        self.events = self.navigator.drain_events()
        for event in self.events:
            if event.state is not None:
                self.health.append(HealthChange(int(event.stamp_ns), event.target, event.state, int(event.reason)))

    def write(self, writer: RunWriter, statuses: list[FdiStatus]) -> None:
        """Record what came out of the navigator since `drain` was last called, and the statuses of the fusion that came with it."""
        writer.settled(self.solutions, self.navigator.labels)
        writer.calibrations(self.calibrations)
        writer.alignment(self.alignment)
        writer.judged(self.judged)
        report = self.navigator.status()
        for event in self.events:
            writer.federated(report_at(report, event), event.text, (event,))
        writer.federated(report)
        for status in statuses:
            writer.inertial(status)

    @property
    def track(self) -> Track:
        """Settled states so far."""
        return join_tracks(self._tracks)

    @property
    def inertial(self) -> Track | None:
        """The inertial states without the correction, at the stamps of `track`; None where the correction is fed back continuously."""
        return join_tracks(self._inertial) if self._inertial else None

    @property
    def alignments(self) -> list[Alignment]:
        """Alignments that have ended, and the one that has not."""
        running = self._report is not None and not self._report.ended
        return self._ended + ([_alignment(self._report)] if running and self._report is not None else [])

    @property
    def covariance(self) -> Floats:
        """(m, 7, 7) of metrics.NEES7."""
        return np.concatenate(self._covariances) if self._covariances else np.zeros((0, 7, 7))

    @property
    def mode(self) -> NDArray[np.int64]:
        """(m,) NavState MODE_*."""
        return np.concatenate(self._modes)[:, 0].astype(np.int64) if self._modes else np.zeros(0, np.int64)

    @property
    def protection_radius(self) -> Floats:
        """(m,), m."""
        return np.concatenate(self._modes)[:, 1] if self._modes else np.zeros(0)

    @property
    def judged_arrays(self) -> dict[str, Judged]:
        """Innovations by subfilter."""
        return {name: judged_arrays(entries) for name, entries in self._judged.items()}


def _alignment(report: AlignmentReport) -> Alignment:
    return Alignment(report.method, report.text, report.ended == "aligned", report.begin_ns, report.stamp_ns)


class FusionLog:
    """What the fusion said: changes of health and which sensors were used."""

    def __init__(self) -> None:
        self.health: list[HealthChange] = []
        self._use: list[SensorUse] = []

    def add(self, block: FusedBlock, events: list[FdiEvent]) -> None:
        """Take a fused block and the events that came with it."""
        self._use.append(SensorUse.from_samples(block.stamp_ns, block.gyro_used, block.accel_used))
        for event in events:
            if event.index >= 0 and event.state is not None:
                self.health.append(HealthChange(int(event.stamp_ns), f"{event.kind}_{event.index}", TRIAD_CODE[event.state], int(event.reason)))
            elif event.kind == "restart":
                out = {c.target: c for c in self.health}
                self.health += [HealthChange(int(event.stamp_ns), target, HEALTHY) for target, c in out.items() if c.state not in (HEALTHY, 5)]

    @property
    def use(self) -> SensorUse:
        """Runs of samples with the same sensors."""
        return SensorUse.concatenate(self._use)


def recalls_of(block: FusedBlock) -> list[Recall]:
    """What the fusion recalls at samples of a block, all sensors of a sample together, as it stands in their messages."""
    if not block.recalls:
        return []
    angle, velocity, onset = block.recalled()
    return [Recall(int(block.stamp_ns[k]), int(onset[k]), angle[k], velocity[k]) for k in np.flatnonzero(onset)]


def join_tracks(tracks: list[Track]) -> Track:
    """Tracks one after the other."""
    if not tracks:
        return Track.empty()
    return Track(*(np.concatenate([getattr(t, f.name) for t in tracks]) for f in dataclasses.fields(Track)))


def judged_arrays(entries: list[Any]) -> Judged:
    """Arrays of riins_federated Judged entries of one subfilter; shorter innovations are padded with NaN."""
    width = max(len(e.innovation) for e in entries)
    columns = {name: np.full((len(entries), width), np.nan) for name in ("innovation", "sigma", "standardized")}
    for row, entry in enumerate(entries):
        for name, column in columns.items():
            value = getattr(entry, name)
            column[row, : len(value)] = value
    return Judged(
        np.array([e.stamp_ns for e in entries], np.int64), columns["innovation"], columns["sigma"], columns["standardized"],
        np.array([e.nis for e in entries], np.float64), np.array([e.threshold for e in entries], np.float64),
        np.array([e.accepted for e in entries], bool), np.array([int(e.reason) for e in entries], np.int64),
    )  # fmt: skip


def aid_notes(subfilters: Iterable[Any]) -> list[str]:
    """What a reader must know of the aids of a run that has navigated: SubfilterReports, or SubfilterStatus messages, at its end."""
    subfilters = list(subfilters)
    if not subfilters:
        return ["The navigator has no aid: it went by the inertial sensors alone, and the known height if that is enabled."]
    counts = ("accepted", "rejected", "late", "malformed", "no_fix")  # older recordings do not have the last
    silent = [s.name for s in subfilters if not any(getattr(s, count, 0) for count in counts)]
    return [f'The aid "{name}" is declared, and not one measurement of it came.' for name in silent]


def fault_intervals(faults: Any, start_at_ns: int, stop_ns: int) -> list[FaultInterval]:
    """riins_sim faults, whose times count from `start_at_ns`, as intervals; one without an end ends at `stop_ns`, one that begins later never was."""
    return [
        FaultInterval(
            f.target, FAULT_TYPES[int(f.type)], start_at_ns + f.start_ns, stop_ns if f.end_ns is None else start_at_ns + f.end_ns, size_text(f)
        )
        for f in faults
        if start_at_ns + f.start_ns < stop_ns
    ]


def size_text(fault: Any) -> str:
    """Size of a riins_sim Fault in the unit of the trade."""
    kind = FAULT_TYPES[int(fault.type)]
    if kind in ("stuck", "dropout"):
        return "" if fault.axis == "all" else fault.axis
    if kind == "scale":
        return f"{100.0 * fault.size:g} %"
    scale, unit = _UNITS.get(fault.target) or _UNITS.get(fault.target.split("_")[0], (1.0, "m"))
    if getattr(fault, "angular", False):
        scale, unit = 180.0 * 60.0 / np.pi, "arcmin"
    parts = [f"{fault.size * scale:.4g} {unit}"] if fault.size or kind != "ramp" else []
    parts += [f"{fault.slope * scale:+.4g} {unit} per s"] if kind == "ramp" else []
    return " ".join(parts + ([fault.axis] if fault.axis != "all" else []))


def report_at(report: FederatedReport, event: NavEvent) -> FederatedReport:
    """A report as of a settled event, for the recording."""
    subfilters = tuple(
        dataclasses.replace(s, state=event.state, since_ns=event.stamp_ns, reason=event.reason)
        if event.state is not None and s.name == event.target
        else s
        for s in report.subfilters
    )
    return dataclasses.replace(report, stamp_ns=event.stamp_ns, subfilters=subfilters)


def warm_up(pipeline: FusionPipeline) -> None:
    """Compile or load every kernel of a pass, so that its time is not the compiler's."""
    pipeline.warm_up()
    Navigator.warm_up()


def latest_before(stamps: Stamps, stamp_ns: int) -> int:
    """Number of stamps that are not after `stamp_ns`."""
    return int(np.searchsorted(stamps, stamp_ns, side="right"))
