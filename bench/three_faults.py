"""Three inertial sensors fail one after the other while the ship turns in sea state 5: what is fused then, and the error beside the twin's.

Lives here: offline over seeds, and live with recording; `./riins exec python bench/three_faults.py [--live]`, status 1 if the default method misses.
Does not live here: the scenario (riins_bringup/scenarios/three_faults.yaml), graph and launcher (riins_bringup), scoring (riins_eval).
"""

from __future__ import annotations

import argparse
import dataclasses
import shutil
import sys
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from riins_eval import metrics
from riins_eval.configure import merged
from riins_eval.draw_png import STYLE
from riins_eval.offline import sail
from riins_eval.run_record import RunRecord, Track
from riins_fdi.health import HealthState
from riins_sim.scenario import Scenario, load

Array = NDArray[np.float64]

METHODS = {
    "wls": {"method": "wls"},
    "wls, sequential glr": {"method": "wls", "sequential_test": "glr"},
    "glr_kf": {"method": "glr_kf"},
}
LIVE = ("wls", "glr_kf")
DEFAULT = "glr_kf"
"""The method that must reach the aim."""
AIM = 1.1
"""Error over that of the fault-free twin."""
KINDS = ("position", "velocity", "heading", "tilt")
ARCMIN = np.degrees(1.0) * 60.0
COLORS = {"wls": "#b45309", "wls, sequential glr": "#7c3aed", "glr_kf": "#0f766e"}


def with_method(method: str) -> Scenario:
    """The scenario with one of `METHODS`."""
    scenario = load("three_faults")
    return dataclasses.replace(scenario, fusion=merged(scenario.fusion, METHODS[method]))


def errors(track: Track, truth: Track) -> dict[str, Array]:
    """Horizontal position [m], horizontal velocity [m/s], heading and tilt [arcmin], (m, 1 or 2) each."""
    return {
        "position": metrics.position_error(track, truth)[:, :2],
        "velocity": (track.v_n - truth.v_n)[:, :2],
        "heading": metrics.heading_error(track, truth)[:, None] * ARCMIN,
        "tilt": metrics.attitude_error(track, truth)[:, :2] * ARCMIN,
    }


def ratios(record: RunRecord, other: Track | None) -> dict[str, float]:
    """RMS of the run over that of its twin or oracle, over the epochs that count."""
    assert other is not None
    counts = record.settled.stamp_ns >= record.scoring_from_ns
    truth = record.truth.take(counts)
    own, beside = errors(record.settled.take(counts), truth), errors(other.take(counts), truth)
    return {kind: metrics.rms(own[kind]) / metrics.rms(beside[kind]) for kind in KINDS}


def declarations(record: RunRecord) -> list[dict[str, Any]]:
    """For each fault: seconds from onset to compensation and isolation, samples fused with the drift removed, and after the isolation."""
    found = []
    for fault in record.faults:
        own = [c for c in record.health if c.target == fault.target and c.stamp_ns >= fault.start_ns]
        at = {state: min((c.stamp_ns for c in own if c.state == state), default=None) for state in (HealthState.COMPENSATED, HealthState.ISOLATED)}
        kept, gone = at[HealthState.COMPENSATED], at[HealthState.ISOLATED]
        assert record.use is not None
        until = fault.end_ns
        found.append({
            "target": fault.target,
            "compensated_s": None if kept is None else (kept - fault.start_ns) / 1e9,
            "isolated_s": None if gone is None else (gone - fault.start_ns) / 1e9,
            "removed": 0 if kept is None else record.use.samples_with(fault.target, kept, gone or until),
            "fused_after": None if gone is None else record.use.samples_with(fault.target, gone, until),
        })  # fmt: skip
    return found


def judge(runs: list[dict[str, Any]], method: str, console: Console) -> list[str]:
    """Print the figures of one method over its runs; what is missed."""
    missed = []
    table = Table("", *KINDS, title=f"{method}: RMS error over the fault-free twin's, {len(runs)} seeds")
    for name, pick in (("mean", np.mean), ("median", np.median), ("5 %", lambda v: np.percentile(v, 5)), ("95 %", lambda v: np.percentile(v, 95))):
        table.add_row(name, *(f"{pick([run['twin'][kind] for run in runs]):.3f}" for kind in KINDS))
    pooled = {
        kind: np.sqrt(np.mean([run["squares"][kind][0] for run in runs]) / np.mean([run["squares"][kind][1] for run in runs])) for kind in KINDS
    }
    table.add_row("of all runs together", *(f"{pooled[kind]:.3f}" for kind in KINDS))
    table.add_row("mean over the oracle's", *(f"{np.mean([run['oracle'][kind] for run in runs]):.3f}" for kind in KINDS))
    console.print(table)
    missed += [f"{method}: {kind} error is {pooled[kind]:.3f} of the twin's" for kind in KINDS if pooled[kind] > AIM]
    for row in zip(*(run["declared"] for run in runs), strict=True):
        seconds = {key: [r[key] for r in row if r[key] is not None] for key in ("compensated_s", "isolated_s", "fused_after")}
        text = ", ".join(f"{word} in {len(v)} runs after {np.mean(v):.2f} s" for word, v in
                         (("compensated", seconds["compensated_s"]), ("isolated", seconds["isolated_s"])) if v)  # fmt: skip
        console.print(f"{method}, {row[0]['target']}: {text}; samples fused after the isolation: {sum(seconds['fused_after'])}", highlight=False)
        if sum(seconds["fused_after"]) or len(seconds["isolated_s"]) < len(row):
            missed.append(f"{method}: {row[0]['target']} fused after its isolation, or not isolated")
    wrong = sum(run["false"] for run in runs)
    console.print(f"{method}: false isolations: {wrong}; NEES(7)/7 {np.mean([run['nees'] for run in runs]):.3f}", highlight=False)
    return missed + ([f"{method}: {wrong} false isolations"] if wrong else [])


def figures(record: RunRecord, score: dict[str, Any]) -> dict[str, Any]:
    """What is kept of a run."""
    counts = record.settled.stamp_ns >= record.scoring_from_ns
    truth = record.truth.take(counts)
    assert record.twin is not None
    own, twin = errors(record.settled.take(counts), truth), errors(record.twin.take(counts), truth)
    return {
        "twin": ratios(record, record.twin), "oracle": ratios(record, record.oracle), "declared": declarations(record),
        "squares": {kind: (metrics.rms(own[kind]) ** 2, metrics.rms(twin[kind]) ** 2) for kind in KINDS},
        "false": score["false_isolations"], "nees": score["nees_per_dof"], "deviation": score["twin_deviation_max_m"],
    }  # fmt: skip


def live(method: str, out: Path, console: Console) -> tuple[RunRecord, dict[str, Any], int]:
    """One live run with recording; its record, score and lost samples."""
    from riins_bringup.graph import GraphSettings, build_graph
    from riins_bringup.live import run_live
    from riins_eval.bag_record import read_record
    from riins_eval.score import score as score_of

    directory = out / method
    directory.mkdir(parents=True)
    scenario, bag = directory / "three_faults.yaml", directory / "bag"
    scenario.write_text(with_method(method).to_yaml())
    graph = build_graph(GraphSettings(scenario=str(scenario), record=str(bag)))
    run = run_live(graph, console=console, directory=directory / "logs", record=str(bag), json_file=directory / "live.json")
    if run["status"]:
        raise SystemExit(f"the live run failed: see {directory / 'logs'}")
    record = read_record(bag, twins=True)
    lost = run["samples"].get("lost", 0) + run["samples"].get("navigator_lost", 0) + run["samples"]["nav_states_lost"]
    return record, score_of(record), lost


def draw(records: dict[str, RunRecord], path: Path, title: str) -> None:
    """Errors of the runs and of the fault-free twin over time, with the onsets and what was declared when."""
    first = next(iter(records.values()))
    assert first.twin is not None
    with matplotlib.rc_context(STYLE):  # type: ignore[arg-type,unused-ignore]
        canvas = Figure(figsize=(11.0, 10.5), dpi=110, layout="constrained")
        FigureCanvasAgg(canvas)
        canvas.suptitle(title, fontsize=13, x=0.01, ha="left")
        apart, *rows = canvas.subplots(5, 1, sharex=True)
        time = (first.settled.stamp_ns - first.origin_ns) / 1e9
        twin = errors(first.twin, first.truth)
        own = {method: errors(record.settled, record.truth) for method, record in records.items()}
        for method, record in records.items():
            assert record.twin is not None
            seconds = (record.settled.stamp_ns - record.origin_ns) / 1e9
            apart.plot(seconds, metrics.horizontal_distance(record.settled, record.twin), color=COLORS[method], label=method)
        apart.set_ylabel("distance from\nthe twin, m")
        labels = {
            "position": "position error, m",
            "velocity": "velocity error, m/s",
            "heading": "heading error, arcmin",
            "tilt": "tilt error, arcmin",
        }
        for axes, kind in zip(rows, KINDS, strict=True):
            axes.plot(time, np.linalg.norm(twin[kind], axis=1), color="#111827", linewidth=2.6, alpha=0.35, label="fault-free twin")
            for method, record in records.items():
                seconds = (record.settled.stamp_ns - record.origin_ns) / 1e9
                axes.plot(seconds, np.linalg.norm(own[method][kind], axis=1), color=COLORS[method], linewidth=1.3, label=method)
            axes.set_ylabel(labels[kind])
        for axes in (apart, *rows):
            for fault in first.faults:
                axes.axvline((fault.start_ns - first.origin_ns) / 1e9, color="#be123c", linewidth=1.0)
            for method, record in records.items():
                for declared, fault in zip(declarations(record), record.faults, strict=True):
                    for key, line in (("compensated_s", ":"), ("isolated_s", "--")):
                        if declared[key] is not None:
                            at = (fault.start_ns - record.origin_ns) / 1e9 + declared[key]
                            axes.axvline(at, color=COLORS[method], linewidth=1.0, linestyle=line)
        for fault in first.faults:
            at = (fault.start_ns - first.origin_ns) / 1e9
            apart.annotate(f"{fault.target} {fault.type}", (at, 0.97), xycoords=("data", "axes fraction"), xytext=(4, -8), textcoords="offset points",
                           fontsize=8, color="#be123c")  # fmt: skip
        rows[0].legend(loc="upper right", ncols=3)
        rows[-1].set_xlabel("time, s (red: onset; dotted: drift removed from here on; dashed: isolated)")
        canvas.savefig(path, format="png")


def main() -> int:
    """Run, print and draw."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=20, help="offline runs of each method; 0: none")
    parser.add_argument("--live", action="store_true", help="and one live run of each method, five minutes each")
    parser.add_argument("--out", type=Path, default=Path("out/three_faults"), help="directory of the live runs, made anew")
    parser.add_argument("--png", type=Path, default=None, help="figure of the live runs, or without them of the last seed")
    given = parser.parse_args()
    console, missed, shown = Console(width=120), [], {}
    for method in METHODS if given.seeds else ():
        runs = []
        for seed in range(1, given.seeds + 1):
            result = sail(with_method(method), seed=seed)
            runs.append(figures(result.record, result.score))
            shown[method] = result.record
        missed += judge(runs, method, console)
    if given.live:
        shutil.rmtree(given.out, ignore_errors=True)
        for method in LIVE:
            record, score, lost = live(method, given.out, console)
            shown[method], kept = record, figures(record, score)
            text = ", ".join(f"{kind} {kept['twin'][kind]:.3f}" for kind in KINDS)
            console.print(
                f"live, {method}: {lost} samples lost; error over the twin's: {text}; at most {kept['deviation']:.3f} m apart", highlight=False
            )
            for row in kept["declared"]:
                console.print(f"  {row}", highlight=False)
            missed += [
                f"live, {method}: {row['target']} fused after its isolation, or not isolated" for row in kept["declared"] if row["fused_after"] != 0
            ]
            missed += [f"live, {method}: {lost} samples lost"] if lost else []
            missed += [f"live, {method}: {kind} error is {value:.3f} of the twin's" for kind, value in kept["twin"].items() if value > AIM]
    if given.png is not None and shown:
        given.png.parent.mkdir(parents=True, exist_ok=True)
        draw(shown, given.png, f"Three inertial faults, one after another: {'live' if given.live else 'offline'}")
    for line in missed:
        console.print(f"missed: {line}", style="red", highlight=False)
    return 1 if any(DEFAULT in line for line in missed) else 0  # the others stand beside it


if __name__ == "__main__":
    sys.exit(main())
