"""The ship's voyage in full strapdown at 100 Hz in waves, through the whole navigator: with turns, on a straight course, and by other structures.

Lives here: the voyages of every seed beside the oracle's and the fault-free twin's, targets 20, 23 to 25, 29 and 31, and their figures.
Does not live here: the uncorrected solution (ship_damping.py), the platform form of 003 (ship.py), the engine (riins_eval.offline).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from riins_core.ins_error import State
from riins_core.sensor_errors import ARCMIN
from riins_eval import metrics
from riins_eval.configure import merged
from riins_eval.offline import RunResult, sail
from riins_eval.run_record import RunRecord
from riins_sim.scenario import Scenario, load

from . import ship_damping
from .rows import Figure, Progress, Row, row

Array = NDArray[np.float64]

NIS = 1
"""SubfilterStatus.REASON_NIS"""
NEVER = {"isolation": {"false_alarm_probability": 1e-15}}
"""A gate that nothing fails."""
STRAIGHT_SEEDS = 5
"""Voyages on a straight course: their covariance is nearly the same for every seed."""
DAMPED_SEEDS = 3
"""Voyages with and without horizontal damping."""
SHORT_S = 10_800.0
"""Quick voyages end after this: an hour with aids."""


def shortened(name: str, quick: bool, **navigator: Any) -> Scenario:
    """A shipped scenario with other settings of the navigator; cut to SHORT_S if `quick`."""
    scenario = load(name)
    scenario = dataclasses.replace(scenario, navigator=merged(scenario.navigator, navigator))
    if not quick:
        return scenario
    faults = tuple(one for one in scenario.faults if one.start_s < SHORT_S)
    outages = tuple(one for one in scenario.outages if one.start_s < SHORT_S)
    return dataclasses.replace(scenario, duration_s=SHORT_S, expect={}, faults=faults, outages=outages)


def numbers(result: RunResult) -> dict[str, float]:
    """Of one voyage: ratios to the oracle, consistency, what the gate did to good and to faulty measurements."""
    score, record = result.score, result.record
    good = faulty = fused = 0
    for name, judged in record.judged.items():
        inside = np.zeros(len(judged.stamp_ns), bool)
        for fault in record.faults:
            if fault.target == name:
                inside |= fault.covers(judged.stamp_ns)
        good += int((~inside & (judged.reason == NIS)).sum())
        faulty += int(inside.sum())
        fused += int((inside & judged.accepted).sum())
    found = {f"{kind} ratio": score["oracle_ratio"][kind] for kind in ("position", "velocity", "heading")}
    return {
        **found, "good": good, "faulty": faulty, "fused": fused,
        "delay": max((f["delay_s"] if f["detected"] else np.inf for f in score["faults"]), default=0.0),
        "position": score["position_rms_m"], "velocity": score["velocity_rms_mps"], "heading": score["heading_rms_arcmin"],
        "nees": score["nees_per_dof"], "sigma": heading_sigma(record)[-1],
    }  # fmt: skip


def heading_sigma(record: RunRecord) -> Array:
    """Own sigma of the heading at each settled epoch, arcmin."""
    at, covariance = metrics.NEES7.index(State.PHI_D), np.asarray(record.covariance)
    return np.asarray(np.sqrt(covariance[:, at, at]) / ARCMIN)


def hours_of(record: RunRecord) -> Array:
    """Time of each settled epoch since the start, h."""
    return np.asarray((record.settled.stamp_ns - (record.origin_ns or 0)) / 3.6e12)


def apart(one: RunRecord, other: RunRecord) -> tuple[float, float]:
    """Largest distance [m] and difference of heading [arcmin] of two runs."""
    distance = metrics.horizontal_distance(one.settled, other.settled)
    turned = metrics.wrap(one.settled.rph[:, 2] - other.settled.rph[:, 2])
    return float(np.nanmax(distance)), float(np.nanmax(np.abs(turned)) / ARCMIN)


def run(seeds: int, quick: bool, progress: Progress) -> tuple[Sequence[Row], Sequence[Figure]]:
    """Rows and figures; `quick` ends every voyage after an hour with aids, before the faults."""
    straights = min(seeds, STRAIGHT_SEEDS)
    damped = min(seeds, DAMPED_SEEDS)
    work, done = 2.0 * seeds + straights + 2.0 + 0.1 * damped, 0.0
    first: RunResult | None = None
    found: list[dict[str, float]] = []
    for seed in range(1, seeds + 1):
        result = sail(shortened("voyage_12h", quick), seed=seed, progress=_part(progress, done / work, 2.0 / work))
        first, done = first or result, done + 2.0
        found.append(numbers(result))
    straight: list[RunRecord] = []
    for seed in range(1, straights + 1):
        course = shortened("voyage_straight", quick)
        straight.append(sail(course, seed=seed, twins=False, progress=_part(progress, done / work, 1.0 / work)).record)
        done += 1.0
    compared = []
    for structure in ("information", "fusion_reset"):
        calm = shortened("calm_12h", quick, structure=structure, **NEVER)
        compared.append(sail(calm, seed=1, twins=False, progress=_part(progress, done / work, 1.0 / work)).record)
        done += 1.0
    pairs = []
    for seed in range(1, damped + 1):
        pairs.append(ship_damping.both(seed, quick, _part(progress, done / work, 0.1 / work)))
        done += 0.1
    assert first is not None
    made = rows(found, [float(heading_sigma(record)[-1]) for record in straight], apart(*compared), quick)
    return [*made, *ship_damping.rows(pairs)], [*figures(first.record, straight[0]), ship_damping.figure(*pairs[0])]


def _part(progress: Progress, start: float, share: float) -> Callable[[float, float], None]:
    return lambda at, total: progress(start + share * at / total)


def rows(found: Sequence[dict[str, float]], straight: Sequence[float], same: tuple[float, float], quick: bool) -> list[Row]:
    """What the voyages showed, beside the targets; a quick voyage has no verdict where it ends before what is asked for."""
    column = {key: np.array([one[key] for one in found]) for key in found[0]}

    def within(low: float, high: float) -> Callable[[Row], bool]:
        return lambda r: low <= r.value <= high

    def most(limit: float) -> Callable[[Row], bool]:
        return within(-np.inf, limit)

    made = [
        row(20, "position RMS over the oracle's", column["position ratio"], ok=most(1.01)),
        row(20, "velocity RMS over the oracle's", column["velocity ratio"], ok=most(1.01)),
        row(20, "heading RMS over the oracle's", column["heading ratio"], ok=most(1.02)),
        row(23, "NEES(7) / 7", column["nees"], ok=None if quick else within(0.8, 1.35)),
        row(24, "good measurements rejected", column["good"], ok=most(0.6), remark="in 12 h, at a false-alarm probability of 1e-5 a test"),
        row(29, "fusion-reset and information form apart, m", [same[0]], ok=most(1e-3)),
        row(29, "the same, heading, arcmin", [same[1]], ok=most(1e-4)),
        row(None, "position RMS, m", column["position"]),
        row(None, "velocity RMS, m/s", column["velocity"]),
        row(None, "heading RMS, arcmin", column["heading"]),
    ]
    if not quick:
        made[5:5] = [
            row(25, "faulty measurements fused", column["fused"], ok=most(0.0), centre=np.sum, remark=f"of {int(column['faulty'].sum())}"),
            row(25, "found after, s", column["delay"], ok=most(0.0), centre=np.max),
        ]
        made += [
            row(31, "heading sigma at 12 h, with turns, arcmin", column["sigma"], ok=most(0.9)),
            row(31, "heading sigma at 12 h, straight course, arcmin", straight, ok=within(2.5, 3.6)),
        ]
    return made


def figures(turning: RunRecord, straight: RunRecord) -> list[Figure]:
    """Errors of the first voyage with its sigma, and heading sigma with turns and without."""

    def draw_errors(canvas: Any) -> None:
        axes = canvas.subplots(3, 1, sharex=True)
        hours = hours_of(turning)
        errors = (
            np.hypot(*metrics.position_error(turning.settled, turning.truth)[:, :2].T),
            np.hypot(*(turning.settled.v_n - turning.truth.v_n)[:, :2].T),
            metrics.heading_error(turning.settled, turning.truth) / ARCMIN,
        )
        axes[0].semilogy(hours, np.maximum(errors[0], 0.1), color="#0072b2", lw=0.7)
        axes[1].semilogy(hours, np.maximum(errors[1], 1e-3), color="#0072b2", lw=0.7)
        axes[2].plot(hours, errors[2], color="#0072b2", lw=0.7)
        sigma = heading_sigma(turning)
        axes[2].fill_between(hours, -sigma, sigma, color="#cccccc", alpha=0.6, label="1 sigma")
        for ax, label in zip(axes, ("position, m", "velocity, m/s", "heading, arcmin"), strict=True):
            ax.set_ylabel(label)
            for fault in turning.faults:
                ax.axvspan(*((t - (turning.origin_ns or 0)) / 3.6e12 for t in (fault.start_ns, fault.end_ns)), color="#d55e00", alpha=0.3)
        axes[2].legend(loc="upper right")
        axes[2].set_xlabel("time, h; red: faults")

    def draw_sigma(canvas: Any) -> None:
        ax = canvas.subplots()
        for record, label, color in ((turning, "a turn every 1.5 h", "#0072b2"), (straight, "straight course", "#d55e00")):
            ax.plot(hours_of(record), heading_sigma(record), color=color, label=label)
        ax.set(xlabel="time, h", ylabel="own sigma of the heading, arcmin", ylim=(0.0, None))
        ax.legend()

    return [
        Figure("ship-strapdown-errors", "Full strapdown: errors of the first voyage", draw_errors),
        Figure("ship-strapdown-heading", "Heading sigma with turns and without", draw_sigma),
    ]
