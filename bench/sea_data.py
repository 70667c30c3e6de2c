"""Sea data: distance to the reference of every piece, with all aids, the log alone, a GPS spoof and a gyro drift, and GNSS denied after 100 s.

Run: ./riins exec python bench/sea_data.py [../shared/data/snapir_open.npz] [--out DIR]; where that recording is not there, it says so and ends.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from riins_eval import metrics
from riins_eval.importers import import_npz
from riins_eval.offline import navigate
from riins_eval.reproduce import RECORDINGS
from riins_eval.run_record import RunRecord

DENIED_S = 100.0
"""GPS and BDS are there for so long in every piece of the fourth run."""
LOG_ALONE: dict[str, Any] = {"navigator": {"gps": {"enabled": False}, "bds": {"enabled": False}}}


def faults(starts: list[float]) -> list[dict[str, Any]]:
    """In every piece: GPS 60 m north from 100 to 160 s, gyro 2 ramps at 2 deg/h per s from 200 to 300 s."""
    made: list[dict[str, Any]] = []
    for start in starts:
        made.append({"target": "gps", "type": "step", "axis": "north", "size_m": 60.0, "start_s": start + 100.0, "end_s": start + 160.0})
        made.append({"target": "gyro_2", "type": "ramp", "slope_deg_h_s": 2.0, "start_s": start + 200.0, "end_s": start + 300.0})
    return made


def denials(starts: list[float]) -> list[dict[str, Any]]:
    """In every piece: neither GPS nor BDS from DENIED_S on, for as long as a piece lasts."""
    return [
        {"target": name, "type": "dropout", "start_s": start + DENIED_S, "end_s": start + 400.0 - 1e-3} for start in starts for name in ("gps", "bds")
    ]


def denied_cells(record: RunRecord) -> list[tuple[str, ...]]:
    """Of each piece, and of all: position RMS, largest and last [m], heading RMS [arcmin] after DENIED_S, and NEES(7)/7."""
    found = []
    for _, start_ns, stop_ns in record.pieces:
        piece = record.between(start_ns + round(DENIED_S * 1e9), stop_ns)
        apart = metrics.horizontal_distance(piece.settled, piece.truth)
        turned = np.degrees(metrics.heading_error(piece.settled, piece.truth)) * 60.0
        nees = metrics.nees7(piece.settled, piece.truth, piece.covariance) / 7.0
        last = float(apart[np.isfinite(apart)][-1])
        found.append((metrics.rms(apart), float(np.nanmax(apart)), last, metrics.rms(turned), float(np.nanmean(nees))))
    table = np.array(found)
    square = np.sqrt(np.mean(table**2, axis=0))
    found.append((square[0], table[:, 1].max(), square[2], square[3], table[:, 4].mean()))
    return [tuple(f"{value:.{digits}f}" for value, digits in zip(one, (2, 2, 2, 1, 2), strict=True)) for one in found]


def main() -> None:
    """Import, navigate four times, print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("recording", type=Path, nargs="?", default=RECORDINGS / "snapir_open.npz")
    parser.add_argument("--out", type=Path, default=None, help="keep the bags here")
    given = parser.parse_args()
    if not given.recording.is_file():
        print(f"{given.recording} is not there: no table of sea data")
        return
    with tempfile.TemporaryDirectory() as temporary:
        out = given.out or Path(temporary)
        out.mkdir(parents=True, exist_ok=True)
        import_npz(given.recording, out / "clean")
        clean = navigate(out / "clean", None).score
        alone = navigate(out / "clean", None, overrides=LOG_ALONE).score
        starts = piece_starts(out / "clean")
        import_npz(given.recording, out / "faulty", faults=faults(starts))
        faulty = navigate(out / "faulty", None).score
        import_npz(given.recording, out / "denied", faults=denials(starts))
        denied = navigate(out / "denied", None)
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
    table = Table("piece", "m", "largest, m", "last, m", "heading, arcmin", "NEES(7)/7", title=f"GNSS for {DENIED_S:.0f} s, then the log")
    for name, row in zip([piece["name"] for piece in clean["pieces"]] + ["all"], denied_cells(denied.record), strict=True):
        table.add_row(name, *row)
    console.print(table)


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
