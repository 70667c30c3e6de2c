"""The inertial solution of the ship between two feedbacks, free and damped horizontally by the log, through the whole navigator.

Lives here: the same voyage with both, its rows and its figure.
Does not live here: the damping (riins_federated.damping), the corrected solution's accuracy (ship_strapdown.py), seed 003's platform form (ship.py).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from riins_eval import metrics
from riins_eval.configure import merged
from riins_eval.offline import sail
from riins_eval.run_record import RunRecord
from riins_sim.scenario import Scenario, load

from .rows import Figure, Row, row

Array = NDArray[np.float64]

FEEDBACK_S, SHORT_S = 14_400.0, 3600.0
"""003's interval of feedback: one such interval is sailed, or an hour."""
RATE_HZ = 10
"""The samples are means, so that nothing of the waves is lost at a rate that costs a tenth."""
SETTINGS: dict[bool, dict[str, Any]] = {on: {"feedback_period_s": FEEDBACK_S, "damping": {"aid": "doppler" if on else ""}} for on in (False, True)}


def course(on: bool, quick: bool) -> Scenario:
    """voyage_12h until the first feedback, or for an hour, with all aids from the beginning; damped or not."""
    scenario = load("voyage_12h")
    return dataclasses.replace(
        scenario, duration_s=SHORT_S if quick else FEEDBACK_S - 1.0, imu_rate_hz=RATE_HZ, faults=(), outages=(), expect={},
        navigator=merged(scenario.navigator, SETTINGS[on]),
    )  # fmt: skip


def both(seed: int, quick: bool, progress: Callable[[float, float], None]) -> tuple[RunRecord, RunRecord]:
    """One voyage free and damped; `progress` is called with (seconds done, seconds in all)."""
    free = sail(course(False, quick), seed=seed, twins=False, progress=lambda at, total: progress(at, 2.0 * total)).record
    damped = sail(course(True, quick), seed=seed, twins=False, progress=lambda at, total: progress(total + at, 2.0 * total)).record
    return free, damped


def errors(record: RunRecord) -> tuple[Array, Array]:
    """Horizontal error of the uncorrected solution at each settled epoch, m and m/s."""
    assert record.inertial is not None
    position = metrics.position_error(record.inertial, record.truth)[:, :2]
    return np.hypot(*position.T), np.hypot(*(record.inertial.v_n - record.truth.v_n)[:, :2].T)


def rows(pairs: Sequence[tuple[RunRecord, RunRecord]]) -> list[Row]:
    """What damping does to the inertial solution, and that it does nothing to what is given out."""
    found = np.array([[[metrics.rms(e) for e in errors(record)] for record in pair] for pair in pairs])  # voyage, damped, position or velocity
    hours = f"{(pairs[0][0].last_ns - pairs[0][0].start_ns) / 3.6e12:.0f} h"
    apart = [float(np.max(metrics.horizontal_distance(free.settled, damped.settled))) for free, damped in pairs]
    return [
        row(None, f"inertial alone, {hours}: velocity RMS, m/s", found[:, 0, 1]),
        row(None, "damped by the log: velocity RMS, m/s", found[:, 1, 1]),
        row(None, f"inertial alone, {hours}: position RMS, m", found[:, 0, 0]),
        row(None, "damped by the log: position RMS, m", found[:, 1, 0], remark="what the gyros drift is not an oscillation: it stays"),
        row(None, "corrected solutions of both apart, at most, m", apart, ok=lambda r: r.value < 1.0, centre=np.max),
    ]


def figure(free: RunRecord, damped: RunRecord) -> Figure:
    """Errors of the inertial solution over time."""

    def draw(canvas: Any) -> None:
        axes = canvas.subplots(2, 1, sharex=True)
        for record, label, color in ((free, "free", "#d55e00"), (damped, "damped by the log", "#0072b2")):
            hours = (record.settled.stamp_ns - (record.origin_ns or 0)) / 3.6e12
            for ax, error in zip(axes, errors(record), strict=True):
                ax.plot(hours, error, color=color, lw=0.9, label=label)
        axes[0].set_ylabel("position, m")
        axes[1].set_ylabel("velocity, m/s")
        axes[1].set_xlabel("time, h")
        axes[0].legend(loc="upper left")

    return Figure("ship-damping", "Inertial solution until its first feedback, free and damped", draw)
