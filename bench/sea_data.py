"""Sea data: distance to the reference of every piece, with all aids, with the log alone, and with a GPS spoof and a gyro drift added.

Run: python bench/sea_data.py ../shared/data/snapir_open.npz [--out DIR]   (./riins exec python bench/sea_data.py ...)
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from riins_eval.importers import import_npz
from riins_eval.offline import navigate

LOG_ALONE: dict[str, Any] = {"navigator": {"gps": {"enabled": False}, "bds": {"enabled": False}}}


def faults(starts: list[float]) -> list[dict[str, Any]]:
    """In every piece: GPS 60 m north from 100 to 160 s, gyro 2 ramps at 2 deg/h per s from 200 to 300 s."""
    made: list[dict[str, Any]] = []
    for start in starts:
        made.append({"target": "gps", "type": "step", "axis": "north", "size_m": 60.0, "start_s": start + 100.0, "end_s": start + 160.0})
        made.append({"target": "gyro_2", "type": "ramp", "slope_deg_h_s": 2.0, "start_s": start + 200.0, "end_s": start + 300.0})
    return made


def main() -> None:
    """Import, navigate three times, print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("recording", type=Path)
    parser.add_argument("--out", type=Path, default=None, help="keep the bags here")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        out = given.out or Path(temporary)
        out.mkdir(parents=True, exist_ok=True)
        import_npz(given.recording, out / "clean")
        clean = navigate(out / "clean", None).score
        alone = navigate(out / "clean", None, overrides=LOG_ALONE).score
        starts = piece_starts(out / "clean")
        import_npz(given.recording, out / "faulty", faults=faults(starts))
        faulty = navigate(out / "faulty", None).score
    table = Table(
        "piece",
        *(f"{run}: {what}" for run in ("all aids", "log alone", "with faults") for what in ("m", "m/s", "heading, arcmin")),
        title=given.recording.name,
    )
    for one, two, three in zip(clean["pieces"], alone["pieces"], faulty["pieces"], strict=True):
        table.add_row(one["name"], *(cell for piece in (one, two, three) for cell in cells(piece)))
    table.add_row("all", *(cell for run in (clean, alone, faulty) for cell in cells(run)))
    console = Console(width=150)
    console.print(table)
    right = sum(bool(fault["isolated_right"]) for fault in faulty["faults"])
    delays = [fault["delay_s"] for fault in faulty["faults"] if fault["target"] == "gyro_2" and fault["delay_s"] is not None]
    fused = sum(fault["epochs_fused"] or 0 for fault in faulty["faults"])
    console.print(
        f"{right} of {len(faulty['faults'])} faults isolated right, {fused} faulty epochs fused, false isolations: "
        f"{clean['false_isolations']}, {alone['false_isolations']}, {faulty['false_isolations']}"
    )
    console.print(f"gyro drift found after {min(delays):.1f} .. {max(delays):.1f} s")


def cells(score: dict[str, Any]) -> tuple[str, str, str]:
    """Position, velocity and heading RMS."""
    return f"{score['position_rms_m']:.2f}", f"{score['velocity_rms_mps']:.3f}", f"{score['heading_rms_arcmin']:.1f}"


def piece_starts(bag: Path) -> list[float]:
    """Start of each piece in the bag, s since its start."""
    from riins_bag.bag import BagReader
    from riins_eval.run_configuration import read_configuration

    configuration = read_configuration(BagReader(bag), None)
    return [(piece["start_ns"] - configuration.start_at_ns) * 1e-9 for piece in configuration.recording["pieces"]]


if __name__ == "__main__":
    main()
