"""The ship in full strapdown beside what she would have instead: inertial alone, a position reset every four hours, three fixes, no feedback.

Lives here: those voyages, targets 30 and 32 and the centralized filter in this form, and their figure.
Does not live here: the default navigator's own voyages (ship_strapdown.py), the platform form of seed 003 (ship.py).
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from riins_core.frames import ned_offset
from riins_core.sensor_errors import ARCMIN
from riins_eval import blocks, configure, metrics
from riins_eval.lane import Lane
from riins_eval.offline import sail
from riins_eval.run_record import RunRecord, Track
from riins_federated.navigator import Navigator
from riins_federated.types import InitialState
from riins_imu_fusion.pipeline import FusionPipeline
from riins_sim.initial import initial_state
from riins_sim.scenario import OutageSettings, Scenario
from riins_sim.sensors import PositionSim, RedundantImuSim
from riins_sim.trajectory import Trajectory

from .rows import Figure, Progress, Row, row
from .ship_strapdown import apart, shortened

Array = NDArray[np.float64]

SEEDS = 3
"""Voyages; six navigators sail each."""
RESETS_H = (2.0, 6.0, 10.0)
PERIOD_S = 4 * 3600.0
NEVER_S = 1e6
STRIDE_S = 100.0
QUANTITIES = ("position", "velocity", "heading")
NO_AIDS = {name: {"enabled": False} for name in ("gps", "bds", "doppler")}
T1, T2 = "position reset every 4 h (T1)", "the same fixes in the optimal filter (T2)"


class Errors(NamedTuple):
    """Time [h] since the start and errors of each epoch: position [m], velocity [m/s], heading [arcmin]; (m,), (m, 3)."""

    hours: Array
    error: Array

    def rms(self, from_h: float) -> Array:
        """RMS (3,) from a time on."""
        return np.asarray(np.sqrt(np.mean(self.error[self.hours >= from_h] ** 2, axis=0)))


def errors(track: Track, truth: Track, origin_ns: int) -> Errors:
    """Horizontal errors of a track."""
    position = np.hypot(*metrics.position_error(track, truth)[:, :2].T)
    velocity = np.hypot(*(track.v_n - truth.v_n)[:, :2].T)
    hours = np.asarray((track.stamp_ns - origin_ns) / 3.6e12, np.float64)
    return Errors(hours, np.column_stack([position, velocity, metrics.heading_error(track, truth) / ARCMIN]))


def adrift(scenario: Scenario, resets_h: Sequence[float]) -> tuple[Errors, Errors]:
    """The INS without any aid but the known mean height, and the same with its position set to a fix of BDS at some times and nothing else."""
    scenario = dataclasses.replace(scenario, navigator=configure.merged(scenario.navigator, NO_AIDS), outages=(), faults=())
    trajectory = Trajectory(scenario)
    imu, bds = RedundantImuSim(scenario, trajectory), PositionSim(scenario, "bds", trajectory)
    config, pipeline = configure.navigator_config(scenario), FusionPipeline(configure.fusion_config(scenario))
    drawn = initial_state(scenario, trajectory)
    names = [f.name for f in dataclasses.fields(InitialState) if f.name != "source" and hasattr(drawn, f.name)]
    alone, reset = Lane(Navigator(config)), Lane(Navigator(config))
    for lane in (alone, reset):
        lane.navigator.set_initial_state(InitialState(**{name: getattr(drawn, name) for name in names}, source="study"))
    stride = round(STRIDE_S / trajectory.dt)
    due = [round(hours * 3600.0 / scenario.bds.period_s) for hours in resets_h if hours * 3600.0 < scenario.duration_s]
    for k0 in range(1, imu.samples + 1, stride):
        raw = imu.block(k0, min(stride, imu.samples + 1 - k0))
        fused = pipeline.process(raw.stamp_ns, (raw.k & 0xFFFFFFFF).astype(np.uint32), raw.gyro, raw.accel, raw.gyro_valid, raw.accel_valid)
        pipeline.drain_events()
        for lane in (alone, reset):
            lane.feed([], fused, pipeline)
        if due and bds.period_ns * due[0] <= raw.stamp_ns[-1]:
            set_position(reset.navigator, bds, due.pop(0), scenario)
    found = []
    for lane in (alone, reset):
        lane.finish()
        track = lane.track
        found.append(errors(track, blocks.track_of_truth(trajectory.truth(track.stamp_ns * 1e-9), track.stamp_ns), 0))
    return found[0], found[1]


def set_position(navigator: Navigator, receiver: PositionSim, number: int, scenario: Scenario) -> None:
    """Set the position to a fix that has just come; all else stays as it is."""
    fix, now = receiver.block(number, 1), navigator.head()
    assert now is not None and fix.stamp_ns[0] == now.stamp_ns
    lever_n = now.C_nb @ np.array(scenario.bds.lever_arm_m)
    lat, lon, _ = (float(one) for one in ned_offset(fix.lat[0], fix.lon[0], fix.h[0], -lever_n))
    sigma = np.sqrt(np.diag(now.P))
    state = InitialState(
        now.stamp_ns, lat, lon, now.h, now.v_n, now.rph, sigma[0:3], sigma[3:6], sigma[6:9], covariance=now.P[:15, :15], source="reset",
        gyro_bias=now.bias_g, accel_bias=now.bias_a,
    )  # fmt: skip
    refused = navigator.set_initial_state(state)
    assert not refused, refused


def three_fixes(scenario: Scenario, resets_h: Sequence[float]) -> Scenario:
    """The voyage in which nothing comes but a fix of BDS at some times."""
    ends = [hours * 3600.0 for hours in resets_h] + [scenario.duration_s + 1.0]
    starts = [0.0] + [end + 0.5 * scenario.bds.period_s for end in ends[:-1]]
    outages = tuple(OutageSettings("bds", start, end) for start, end in zip(starts, ends, strict=True) if start < scenario.duration_s)
    navigator = configure.merged(scenario.navigator, {"gps": {"enabled": False}, "doppler": {"enabled": False}})
    return dataclasses.replace(scenario, navigator=navigator, outages=outages, faults=(), expect={})


@dataclasses.dataclass(frozen=True)
class Compared:
    """One voyage: errors by the name of the navigator, position, velocity, heading of the centralized one over its oracle's, and how far the voyage
    without feedback is from the one with (RMS over its, largest distance [m], largest difference of heading [arcmin])."""

    flown: dict[str, Errors]
    oracle: Array
    feedback: Array
    peaks: tuple[float, float]


def compare(seed: int, quick: bool, progress: Progress) -> Compared:
    """Sail one voyage with each navigator."""
    resets = tuple(hours for hours in RESETS_H if not quick or hours < 3.0)
    runs: dict[str, RunRecord] = {}

    def centralized(name: str, feedback_s: float, twins: bool = False) -> None:
        scenario = shortened("voyage_12h", quick, structure="information", feedback_period_s=feedback_s)
        runs[name] = sail(scenario, seed=seed, twins=twins).record

    centralized("centralized", 0.0, twins=True)
    progress(0.35)
    centralized("output correction", NEVER_S)
    progress(0.5)
    centralized("feedback", PERIOD_S if not quick else 3600.0)
    progress(0.65)
    runs[T2] = sail(three_fixes(shortened("voyage_12h", quick), resets), seed=seed, twins=False).record
    progress(0.8)
    flown = {name: errors(record.settled, record.truth, record.origin_ns or 0) for name, record in runs.items()}
    flown["inertial alone"], flown[T1] = adrift(shortened("voyage_12h", quick).with_seed(seed), resets)
    best = runs["centralized"]
    from_h = scored_from(best)
    oracle = flown["centralized"].rms(from_h) / (errors(best.oracle, best.truth, best.origin_ns or 0).rms(from_h) if best.oracle else np.nan)
    feedback = np.abs(flown["output correction"].rms(from_h) / flown["feedback"].rms(from_h) - 1.0)
    progress(1.0)
    return Compared(flown, oracle, feedback, apart(runs["output correction"], runs["feedback"]))


def scored_from(record: RunRecord) -> float:
    """Hours after which the errors count."""
    return float(((record.scoring_from_ns or 0) - (record.origin_ns or 0)) / 3.6e12)


def run(seeds: int, quick: bool, progress: Progress) -> tuple[Sequence[Row], Sequence[Figure]]:
    """Rows and a figure; `quick` ends every voyage an hour after the aids have come."""
    voyages = 1 if quick else min(seeds, SEEDS)
    found = []
    for seed in range(1, voyages + 1):
        found.append(compare(seed, quick, functools.partial(_told, progress, seed - 1, voyages)))
    from_h = shortened("voyage_12h", quick).scoring.from_s / 3600.0
    return rows(found, from_h, quick), [] if quick else [Figure("ship-compared", "Full strapdown: what she would have instead", _drawing(found[0]))]


def rows(found: Sequence[Compared], from_h: float, quick: bool) -> list[Row]:
    """What the voyages showed; a quick one is too short for the position reset to be judged."""
    made = []
    best = np.array([one.flown["centralized"].rms(from_h) for one in found])
    for i, (what, most) in enumerate(zip(QUANTITIES, (1.01, 1.01, 1.02), strict=True)):
        made.append(row(20, f"centralized filter with its gate: {what} RMS over the oracle's", [one.oracle[i] for one in found], ok=_at_most(most)))
    for name in ("inertial alone", T1, T2):
        other = np.array([one.flown[name].rms(from_h) for one in found])
        for i, (what, least) in enumerate(zip(QUANTITIES, (100.0, 10.0, np.nan), strict=True)):
            judged = name == T1 and not quick and least > 0.0
            remark = "" if least > 0.0 else "an error of the heading lasts hours: so few voyages do not settle it; the platform form has every seed"
            pooled = float(np.sqrt(np.mean(other[:, i] ** 2) / np.mean(best[:, i] ** 2)))
            made.append(
                row(
                    30 if judged else None, f"{name}: {what} RMS over the centralized filter's, all voyages together", other[:, i] / best[:, i],
                    paper="better" if name == T1 else None, centre=functools.partial(_this, pooled),
                    ok=_at_least(least) if judged else None, remark=remark,
                )
            )  # fmt: skip
    for i, (what, most) in enumerate(zip(QUANTITIES, (0.02, 0.02, 0.05), strict=True)):
        label = f"output correction alone against feedback every 4 h: {what} RMS apart, part of it"
        made.append(row(32, label, [one.feedback[i] for one in found], ok=_at_most(most)))
    for i, (what, most) in enumerate((("largest distance, m", 2.0), ("largest difference of heading, arcmin", 0.5))):
        made.append(row(32, f"the same two: {what}", [one.peaks[i] for one in found], ok=_at_most(most), centre=np.max))
    return made


def _told(progress: Progress, before: int, voyages: int, part: float) -> None:
    progress((before + part) / voyages)


def _this(value: float, _: Array) -> float:
    return value


def _at_most(limit: float) -> Callable[[Row], bool]:
    return lambda made: made.value <= limit


def _at_least(limit: float) -> Callable[[Row], bool]:
    return lambda made: made.value >= limit


def _drawing(one: Compared) -> Callable[[Any], None]:
    def draw(canvas: Any) -> None:
        axes = canvas.subplots(3, 1, sharex=True)
        for color, name in zip(("#0072b2", "#d55e00", "#e69f00", "#009e73"), ("inertial alone", T1, T2, "centralized"), strict=True):
            flown = one.flown[name]
            for ax, column, least in zip(axes, flown.error.T, (0.1, 1e-3, 1e-2), strict=True):
                ax.semilogy(flown.hours, np.maximum(np.abs(column), least), color=color, lw=0.8, label=name)
        for ax, label in zip(axes, ("position, m", "velocity, m/s", "heading, arcmin"), strict=True):
            ax.set_ylabel(label)
        axes[0].legend(loc="lower left", fontsize=8)
        axes[-1].set_xlabel("time, h")

    return draw
