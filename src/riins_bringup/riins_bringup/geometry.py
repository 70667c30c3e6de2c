"""Figures of merit of sensor geometries for a terminal and as JSON.

Lives here: `describe_thesis`, `describe_file`.
Does not live here: the figures themselves (riins_core.imu_array).
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from riins_core import imu_array
from riins_core.settings import SettingError

Described = tuple[list[Table], dict[str, Any]]


def describe_thesis() -> Described:
    """Tables 2.1 to 2.3 of the thesis, and the accuracy left after isolation, for its four configurations.

    Returns
    -------
    tables for a terminal, figures for JSON (angles in degrees)
    """
    survivors = (3, 4, 5)
    by_survivors = {s: {row.n: row for row in imu_array.table_2_1(12, s)} for s in survivors}
    one = Table("n", *(f"theta_n, F_n ({s} must work)" for s in survivors), title="Table 2.1: relative MTBF and figure F_n = theta_n / n (* best)")
    best = {s: max(rows.values(), key=lambda r: r.figure).n for s, rows in by_survivors.items()}
    for n in range(3, 13):
        cells = [f"{rows[n].theta:.4f}  {rows[n].figure:.4f}{'*' if best[s] == n else ''}" if n in rows else "-" for s, rows in by_survivors.items()]
        one.add_row(str(n), *cells)
    two = Table("configuration", "angle, deg", "J_p", "GDOP", "|H'H - n/3 I|", title="Table 2.2: accuracy")
    for row in imu_array.table_2_2():
        two.add_row(
            row.name,
            "-" if row.angle is None else f"{math.degrees(row.angle):.4f}",
            f"{row.accuracy_figure:.4f}",
            f"{row.gdop:.4f}",
            f"{row.deviation:.1e}",
        )
    three = Table("configuration", "coherence", title="Table 2.3: coherence of the axes (* best for telling faults apart)")
    for line in imu_array.table_2_3():
        three.add_row(line.name, f"{line.coherence:.4f}{'*' if line.best else ''}")
    isolation = {name: _isolation(imu_array.ImuArray(H)) for name, H in imu_array.CONFIGURATIONS.items()}
    figures = {
        "table_2_1": {str(s): [row._asdict() for row in rows.values()] for s, rows in by_survivors.items()},
        "table_2_2": [
            {"name": r.name, "angle_deg": None if r.angle is None else math.degrees(r.angle), "accuracy_figure": r.accuracy_figure, "gdop": r.gdop}
            for r in imu_array.table_2_2()
        ],
        "table_2_3": [{"name": r.name, "coherence": r.coherence, "best": bool(r.best)} for r in imu_array.table_2_3()],
        "isolation": isolation,
    }
    return [one, two, three, *(_isolation_table(name, rows) for name, rows in isolation.items())], figures


def describe_file(path: Path) -> Described:
    """Figures of merit of an n x 3 geometry in a text file.

    Parameters
    ----------
    path : one sensing axis a row, three numbers divided by blanks or commas; '#' begins a comment

    Raises
    ------
    SettingError
        The file is not n x 3 numbers, a row is not of unit length, or the axes do not span space.
    """
    try:
        rows = [line.split("#")[0].replace(",", " ").split() for line in path.read_text(encoding="utf-8").splitlines()]
        array = imu_array.ImuArray([[float(word) for word in row] for row in rows if row])
    except (ValueError, UnicodeDecodeError) as error:
        raise SettingError(f"{path}: {' '.join(str(error).split())}") from None
    deviation = float(np.max(np.abs(array.H.T @ array.H - array.n / 3.0 * np.eye(3))))
    sheet = Table(show_header=False, title=f"{path.name}: {array.n} sensors")
    figures: dict[str, Any] = {
        "n": array.n,
        "accuracy_figure": array.accuracy_figure(),
        "accuracy_figure_best": (array.n / 3.0) ** 3,
        "gdop": array.gdop(),
        "gdop_best": 3.0 / math.sqrt(array.n),
        "coherence": array.coherence(),
        "deviation": deviation,
        "parity": array.parity().tolist(),
        "isolation": _isolation(array),
    }
    sheet.add_row("accuracy J_p (best possible)", f"{figures['accuracy_figure']:.4f} ({figures['accuracy_figure_best']:.4f})")
    sheet.add_row("GDOP (best possible)", f"{figures['gdop']:.4f} ({figures['gdop_best']:.4f})")
    sheet.add_row("coherence", f"{figures['coherence']:.4f}")
    sheet.add_row("largest element of |H'H - n/3 I|", f"{deviation:.1e}")
    parity = Table(*(f"sensor {i}" for i in range(array.n)), title="parity matrix V")
    for row in figures["parity"]:
        parity.add_row(*(f"{value:+.4f}" for value in row))
    return [sheet, parity, _isolation_table(path.name, figures["isolation"])], figures


def _isolation(array: imu_array.ImuArray) -> list[dict[str, Any]]:
    counts = tuple(range(min(3, array.n - 3) + 1))
    rows = [row._asdict() for row in imu_array.worst_case_after_isolation(array, counts)]
    return [{key: None if isinstance(value, float) and math.isinf(value) else value for key, value in row.items()} for row in rows]


def _isolation_table(name: str, rows: list[dict[str, Any]]) -> Table:
    sheet = Table(
        "isolated", "worst GDOP", "worst sigma", "least J_p", "choices without solution", title=f"{name}: accuracy left after isolation, worst choice"
    )
    for row in rows:
        cells = ["none" if row[key] is None else f"{row[key]:.4f}" for key in ("gdop", "sigma_worst", "accuracy_figure")]
        sheet.add_row(str(row["isolated"]), *cells, f"{row['singular']} of {row['choices']}")
    return sheet
