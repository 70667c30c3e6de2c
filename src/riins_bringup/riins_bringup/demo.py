"""The demonstration: one live run with recording, one long voyage offline beside it, the report, one table.

Lives here: `run_demo`, what `make demo` calls.
Does not live here: running (live.py), sailing and reporting (riins_eval).
"""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from riins_bringup.graph import GraphSettings, build_graph
from riins_bringup.live import run_live
from riins_bringup.printing import fault_table

LIVE, VOYAGE = "harbour", "voyage_12h"
VOYAGE_LOG = "voyage.log"


def run_demo(out: Path, console: Console, duration_s: float = 0.0) -> int:
    """Run everything once.

    Parameters
    ----------
    out : directory for bags and reports; what an earlier demo left there is removed
    console : where to print
    duration_s : length of the live run [s]; 0: all of the scenario

    Returns
    -------
    0 when both runs hold what their scenarios expect, else 1
    """
    from riins_eval.bag_record import read_record
    from riins_eval.report import write_report
    from riins_eval.score import score, verdict
    from riins_sim import scenario as scenarios

    began = time.monotonic()
    live_bag, page = out / LIVE, out / f"{LIVE}_report"
    for path in (live_bag, page, out / "logs"):
        shutil.rmtree(path, ignore_errors=True)
    out.mkdir(parents=True, exist_ok=True)

    with background_voyage(out) as finished:
        console.rule("1. live: nine processes over DDS, recorded", align="left")
        graph = build_graph(GraphSettings(scenario=LIVE, record=str(live_bag), duration_s=duration_s))
        live = run_live(graph, console=console, directory=out / "logs", record=str(live_bag), json_file=out / "live.json")
        if live["status"] != 0:
            return 1

        console.rule("2. offline: twelve hours with the same algorithm objects, meanwhile at the lowest priority", align="left")
        voyage = finished()
        if voyage is None:
            console.print(f"error: {VOYAGE} was not sailed, see {out / VOYAGE_LOG}", style="bold red", highlight=False)
            return 1
    console.print(f"{voyage['realtime_factor']:.0f} times real time", highlight=False)

    console.rule("3. report of the live bag", align="left")
    record = read_record(live_bag, twins=True)
    harbour = score(record)
    index = write_report(record, page, harbour)

    console.rule("4. results", align="left")
    console.print(comparison({"live harbour": harbour, "offline voyage_12h": voyage}, live))
    console.print(fault_table({"faults": [*harbour["faults"], *voyage["faults"]]}))
    failures = [f"live: {line}" for line in verdict(harbour, record.expect if duration_s == 0.0 else {})]
    failures += [f"voyage: {line}" for line in verdict(voyage, scenarios.load(VOYAGE).expect)]
    for line in failures:
        console.print(f"not as expected: {line}", style="bold red", markup=False, highlight=False)
    (out / "demo.json").write_text(json.dumps({"live": live, "harbour": harbour, "voyage_12h": voyage, "failures": failures}, indent=2) + "\n")
    console.print(f"bag {live_bag}\nreport {index}\nall in {time.monotonic() - began:.0f} s", highlight=False, soft_wrap=True)
    return 1 if failures else 0


@contextlib.contextmanager
def background_voyage(out: Path) -> Iterator[Callable[[], dict[str, Any] | None]]:
    """Sail the voyage beside what is done meanwhile; it does not outlive the block.

    Parameters
    ----------
    out : directory for its score and its log

    Yields
    ------
    function that waits for the end and gives the score of docs/json.md, None if there is none
    """
    results = out / "voyage.json"
    results.unlink(missing_ok=True)
    # Not recorded: that takes as long again. No twins: one is not needed to see it.
    words = [sys.executable, "-m", "riins_bringup", "sail", VOYAGE, "--record", "none", "--no-twins", "--json", str(results)]
    with (out / VOYAGE_LOG).open("w", encoding="utf-8") as log:
        sailing = subprocess.Popen(words, stdin=subprocess.DEVNULL, stdout=log, stderr=log, preexec_fn=lambda: os.nice(19))

    def finished() -> dict[str, Any] | None:
        sailing.wait()
        return json.loads(results.read_text(encoding="utf-8")) if results.is_file() else None

    try:
        yield finished
    finally:
        sailing.kill()
        sailing.wait()


def comparison(results: dict[str, dict[str, Any]], live: dict[str, Any]) -> Table:
    """The figures of several runs side by side, the latency of the live one below."""
    sheet = Table("", *results)
    for label, key, digits in (
        ("position error RMS, m", "position_rms_m", 2),
        ("position error max, m", "position_max_m", 2),
        ("velocity error RMS, m/s", "velocity_rms_mps", 3),
        ("heading error RMS, arcmin", "heading_rms_arcmin", 2),
        ("NEES per degree of freedom", "nees_per_dof", 2),
        ("distance from the fault-free twin, max, m", "twin_deviation_max_m", 2),
        ("false isolations", "false_isolations", 0),
        ("times real time", "realtime_factor", 0),
    ):
        cells = ["-" if r[key] is None else f"{r[key]:.{digits}f}" for r in results.values()]
        sheet.add_row(label, *cells)
    sheet.add_row("IMU samples received, lost", *(f"{r['samples']['received']}, {r['samples']['lost']}" for r in results.values()))
    if live["latency_ms"]:
        sheet.add_row("latency IMU stamp to NavState p50, p99, ms", f"{live['latency_ms']['p50']:.1f}, {live['latency_ms']['p99']:.1f}")
    return sheet
