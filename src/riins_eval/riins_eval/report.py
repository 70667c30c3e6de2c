"""The report of a run: one self-contained HTML page, the same figures as PNG, the score as JSON.

Lives here: `report` (from a bag), `write_report` (from a record).
Does not live here: what the figures show (plots.py), drawing (draw_html.py, draw_png.py), the numbers (score.py).
"""

from __future__ import annotations

import datetime
import json
from collections.abc import Callable, Sequence
from pathlib import Path

from . import score as scoring
from .run_record import RunRecord


def report(
    bag: str | Path,
    out_dir: str | Path,
    twins: bool | None = None,
    progress: Callable[[float, float], None] | None = None,
    namespace: str | None = None,
) -> Path:
    """Write the report of a recorded run.

    Parameters
    ----------
    bag : rosbag2 directory with /nav/settled
    out_dir : directory to write to, made if needed
    twins : see `score.score_bag`
    progress : called with (seconds done, seconds in all)
    namespace : of the recorded topics; None: the one there is

    Returns
    -------
    path of index.html

    Raises
    ------
    RecordError
        The bag lacks what a report needs.
    """
    from .bag_record import read_record

    return write_report(read_record(bag, twins=twins, progress=progress, namespace=namespace), out_dir)


def write_report(record: RunRecord, out_dir: str | Path, result: scoring.Score | None = None) -> Path:
    """Write index.html, FIGURE.png for each figure and score.json.

    Parameters
    ----------
    record : of any run
    out_dir : directory to write to, made if needed
    result : its score; None: made here

    Returns
    -------
    path of index.html
    """
    from .draw_html import page
    from .draw_png import draw_png
    from .plots import figures

    out = Path(out_dir)
    out.mkdir(parents=True, exist_ok=True)
    result = scoring.score(record) if result is None else result
    drawn = figures(record)
    for figure in drawn:
        draw_png(figure, out / f"{figure.key}.png", record.name)
    failures = scoring.verdict(result, record.expect)
    tables: list[tuple[str, Sequence[str], Sequence[Sequence[str]]]] = []
    if result["faults"]:
        columns = ("target", "fault", "onset", "detected", "delay", "isolated right", "epochs fused")
        tables.append(("Faults", columns, scoring.fault_rows(result)))
    if result["pieces"]:
        tables.append(("Pieces of the recording", *_pieces(result)))
    text = page(
        title=record.name, description=record.description, facts=_facts(record, result), passed=not failures if record.expect else None,
        failures=failures, cards=_cards(result), numbers=scoring.table(result), tables=tables, notes=record.notes, figures=drawn, score=result,
    )  # fmt: skip
    (out / "score.json").write_text(json.dumps(result, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    (out / "index.html").write_text(text, encoding="utf-8")
    return out / "index.html"


def _facts(record: RunRecord, result: scoring.Score) -> str:
    start = datetime.datetime.fromtimestamp(record.start_ns * 1e-9, datetime.UTC).strftime("%Y-%m-%d %H:%M:%S UTC")
    duration = result["duration_s"] or 0.0
    span = f"{duration:.0f} s" if duration < 900 else f"{duration / 60:.0f} min" if duration < 3 * 3600 else f"{duration / 3600:.1f} h"
    return f"{span} from {start}; {result['epochs']} epochs scored; {len(record.faults)} faults injected."


def _cards(result: scoring.Score) -> list[tuple[str, str, str]]:
    def text(value: float | None, digits: int) -> str:
        return "-" if value is None else f"{value:.{digits}f}"

    found = sum(f["isolated_right"] for f in result["faults"])
    cards = [
        (text(result["position_rms_m"], 2), "m", "position, RMS"),
        (text(result["velocity_rms_mps"], 3), "m/s", "velocity, RMS"),
        (text(result["heading_rms_arcmin"], 2), "arcmin", "heading, RMS"),
        (text(result["nees_per_dof"], 2), "", "NEES per degree of freedom"),
        (str(result["false_isolations"]), "", "false isolations"),
    ]
    if result["faults"]:
        cards.insert(4, (f"{found} of {len(result['faults'])}", "", "faults rightly isolated"))
    return cards


def _pieces(result: scoring.Score) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    columns = ("piece", "duration [s]", "position RMS [m]", "largest [m]", "velocity RMS [m/s]", "heading RMS [arcmin]", "NEES per dof")

    def text(value: float | None, digits: int) -> str:
        return "-" if value is None else f"{value:.{digits}f}"

    keys = (("duration_s", 0), ("position_rms_m", 2), ("position_max_m", 2), ("velocity_rms_mps", 3), ("heading_rms_arcmin", 2), ("nees_per_dof", 2))
    return columns, [(p["name"], *(text(p[key], digits) for key, digits in keys)) for p in result["pieces"]]
