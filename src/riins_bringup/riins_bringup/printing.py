"""Tables for a terminal: scores and faults.

Lives here: rich tables made of rows that riins_eval.score gives.
Does not live here: figures (riins_eval), the live table (table.py).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rich.table import Table

from riins_eval.score import fault_rows, sensor_rows, table


def score_table(result: Mapping[str, Any]) -> Table:
    """The score of a run, as of `riins_eval.score.score`."""
    sheet = Table(title=str(result.get("name") or "score"), show_header=False, title_justify="left")
    for what, value, unit in table(result):
        sheet.add_row(what, f"{value} {unit}".strip())
    return sheet


def fault_table(result: Mapping[str, Any]) -> Table:
    """The faults of a run and what became of them."""
    sheet = Table("target", "fault", "onset", "detected", "delay", "isolated right", "epochs fused", title="faults", title_justify="left")
    for row in fault_rows(result):
        sheet.add_row(*row)
    return sheet


def sensor_table(result: Mapping[str, Any]) -> Table:
    """The inertial sensors that changed their state."""
    sheet = Table("sensor", "state", "first change", "reason", "drift removed", title="sensors", title_justify="left")
    for row in sensor_rows(result):
        sheet.add_row(*row)
    return sheet
