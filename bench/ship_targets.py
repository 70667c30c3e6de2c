"""The ship voyage beside its targets: oracle ratio, false rejections, isolation, equality of structures, heading with and without turns.

Run: python bench/ship_targets.py [--seeds 20] [--jobs 2]   (in the workspace's environment: ./riins exec python bench/ship_targets.py)
"""

from __future__ import annotations

import argparse
import dataclasses
from concurrent.futures import ProcessPoolExecutor
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from riins_core.earth import radii
from riins_eval.configure import merged
from riins_eval.offline import sail
from riins_sim.scenario import Scenario, load

NIS = 1
"""SubfilterStatus.REASON_NIS"""
ARCMIN = np.degrees(1.0) * 60.0


def with_navigator(scenario: Scenario, settings: dict[str, Any]) -> Scenario:
    """The scenario with other settings of the navigator."""
    return dataclasses.replace(scenario, navigator=merged(scenario.navigator, settings))


def voyage(seed: int) -> dict[str, float]:
    """voyage_12h with one seed."""
    result = sail("voyage_12h", seed=seed)
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
    ratio = score["oracle_ratio"]
    return {
        "position ratio": ratio["position"],
        "velocity ratio": ratio["velocity"],
        "heading ratio": ratio["heading"],
        "good rejected": good,
        "faulty": faulty,
        "faulty fused": fused,
        "delay": max(f["delay_s"] if f["detected"] else np.inf for f in score["faults"]),
        "position": score["position_rms_m"],
        "velocity": score["velocity_rms_mps"],
        "heading": score["heading_rms_arcmin"],
        "nees": score["nees_per_dof"],
        "sigma": float(np.sqrt(record.covariance[-1, 6, 6]) * ARCMIN),
        "seconds": result.seconds,
    }


def structures(seed: int) -> dict[str, float]:
    """calm_12h without a gate: fusion-reset against the information form."""
    calm = with_navigator(load("calm_12h"), {"isolation": {"false_alarm_probability": 1e-15}})
    one = sail(calm, seed=seed, twins=False).record.settled
    other = sail(with_navigator(calm, {"structure": "fusion_reset"}), seed=seed, twins=False).record.settled
    r_m, r_n = radii(one.lat)
    apart = np.hypot((one.lat - other.lat) * r_m, (one.lon - other.lon) * r_n * np.cos(one.lat))
    heading = np.abs(np.angle(np.exp(1j * (one.rph[:, 2] - other.rph[:, 2]))))
    return {"apart": float(apart.max()), "heading apart": float(heading.max() * ARCMIN)}


def straight(seed: int) -> dict[str, float]:
    """voyage_straight: heading sigma without a turn."""
    record = sail("voyage_straight", seed=seed, twins=False).record
    return {"sigma": float(np.sqrt(record.covariance[-1, 6, 6]) * ARCMIN)}


def main() -> None:
    """Sail, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=20, help="voyages with faults")
    parser.add_argument("--jobs", type=int, default=2, help="processes")
    given = parser.parse_args()
    console = Console(width=130)
    with ProcessPoolExecutor(given.jobs) as pool, Progress(console=console) as progress:
        bar = progress.add_task("sailing", total=given.seeds + 2)
        jobs = [pool.submit(voyage, seed) for seed in range(1, given.seeds + 1)]
        compared, course = pool.submit(structures, 1), pool.submit(straight, 1)
        for job in [*jobs, compared, course]:
            job.add_done_callback(lambda _: progress.advance(bar))
        rows = [job.result() for job in jobs]
        same, calm = compared.result(), course.result()
    column = {key: np.array([row[key] for row in rows]) for key in rows[0]}
    table = Table("target", "what", "wanted", "mean", "median", "5 %", "95 %", title=f"voyage_12h, {given.seeds} seeds, t > 7800 s")

    def add(target: str, what: str, wanted: str, values: np.ndarray, digits: str = ".3f") -> None:
        low, high = np.percentile(values, [5, 95])
        table.add_row(target, what, wanted, *(format(float(v), digits) for v in (values.mean(), np.median(values), low, high)))

    add("20", "position RMS / oracle", "<= 1.01", column["position ratio"], ".4f")
    add("20", "velocity RMS / oracle", "<= 1.01", column["velocity ratio"], ".4f")
    add("20", "heading RMS / oracle", "<= 1.02", column["heading ratio"], ".4f")
    add("23", "NEES(7) / 7", ".80 - 1.35", column["nees"])
    add("24", "good epochs rejected in 12 h at P_fa 1e-5", "<= .6", column["good rejected"], ".2f")
    add("25", f"faulty epochs fused, of {int(column['faulty'].sum())}", "0", column["faulty fused"], ".0f")
    add("25", "delay of the isolation test, s", "0", column["delay"], ".1f")
    add("29", "fusion-reset vs information form, m", "< 1e-3", np.array([same["apart"]]), ".1e")
    add("29", "the same, heading, arcmin", "< 1e-4", np.array([same["heading apart"]]), ".1e")
    add("31", "heading sigma at 12 h with turns, arcmin", "<= .9", column["sigma"])
    add("31", "heading sigma at 12 h, straight course, arcmin", "2.5 - 3.6", np.array([calm["sigma"]]))
    add("", "position RMS, m", "", column["position"], ".2f")
    add("", "velocity RMS, m/s", "", column["velocity"])
    add("", "heading RMS, arcmin", "", column["heading"], ".2f")
    add("", "seconds of computing, twin and oracle included", "", column["seconds"], ".1f")
    console.print(table)


if __name__ == "__main__":
    main()
