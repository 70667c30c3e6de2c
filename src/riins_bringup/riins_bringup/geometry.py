"""Figures of merit of sensor geometries for a terminal and as JSON.

Lives here: `describe_thesis`, `describe_geometry`.
Does not live here: the figures themselves (riins_core.imu_array, riins_core.survivors), files (geometry_file.py), drawing (geometry_plot.py).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from rich.table import Table

from riins_core import imu_array
from riins_core.settings import SettingError
from riins_core.survivors import worst_case_after_isolation

Described = tuple[list[Table], dict[str, Any]]

SURVIVORS = (3, 4, 5)
"""Sensors that must work: three for a solution, four to see a fault, five to isolate it."""
_MOST_SENSORS = 64


def describe_thesis(survivors: Sequence[int] = SURVIVORS) -> Described:
    """Tables 2.1 to 2.3 of the thesis, and the accuracy left after isolation, for its four configurations.

    Parameters
    ----------
    survivors : least numbers of sensors that must work, a column of table 2.1 each

    Returns
    -------
    tables for a terminal, figures for JSON (angles in degrees)

    Raises
    ------
    SettingError
        A number of survivors is not 3 to 64.
    """
    one, by_survivors = _reliability(survivors)
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
        "table_2_1": by_survivors,
        "table_2_2": [
            {"name": r.name, "angle_deg": None if r.angle is None else math.degrees(r.angle), "accuracy_figure": r.accuracy_figure, "gdop": r.gdop}
            for r in imu_array.table_2_2()
        ],
        "table_2_3": [{"name": r.name, "coherence": r.coherence, "best": bool(r.best)} for r in imu_array.table_2_3()],
        "isolation": isolation,
    }
    return [one, two, three, *(_isolation_table(name, rows) for name, rows in isolation.items())], figures


def describe_geometry(name: str, array: imu_array.ImuArray, survivors: Sequence[int] = SURVIVORS) -> Described:
    """Figures of merit of any geometry.

    Parameters
    ----------
    name : how it is called in the titles
    array : the geometry
    survivors : least numbers of sensors that must work, for the reliability; those above its n are left out

    Returns
    -------
    tables for a terminal, figures for JSON

    Raises
    ------
    SettingError
        A number of survivors is not 3 to 64.
    """
    _check(survivors)
    deviation = float(np.max(np.abs(array.H.T @ array.H - array.n / 3.0 * np.eye(3))))
    sheet = Table(show_header=False, title=f"{name}: {array.n} sensors")
    reliable = {k: imu_array.reliability(array.n, k) for k in survivors if k <= array.n}
    figures: dict[str, Any] = {
        "n": array.n,
        "accuracy_figure": array.accuracy_figure(),
        "accuracy_figure_best": (array.n / 3.0) ** 3,
        "gdop": array.gdop(),
        "gdop_best": 3.0 / math.sqrt(array.n),
        "coherence": array.coherence(),
        "deviation": deviation,
        "parity": array.parity().tolist(),
        "reliability": {str(k): {"theta": theta, "figure": theta / array.n} for k, theta in reliable.items()},
        "isolation": _isolation(array),
    }
    sheet.add_row("accuracy J_p (best possible)", f"{figures['accuracy_figure']:.4f} ({figures['accuracy_figure_best']:.4f})")
    sheet.add_row("GDOP (best possible)", f"{figures['gdop']:.4f} ({figures['gdop_best']:.4f})")
    sheet.add_row("coherence", f"{figures['coherence']:.4f}")
    sheet.add_row("largest element of |H'H - n/3 I|", f"{deviation:.1e}")
    for k, theta in reliable.items():
        sheet.add_row(f"relative MTBF theta_n, F_n = theta_n / n ({k} must work)", f"{theta:.4f}  {theta / array.n:.4f}")
    parity = Table(*(f"sensor {i}" for i in range(array.n)), title="parity matrix V")
    for row in figures["parity"]:
        parity.add_row(*(f"{value:+.4f}" for value in row))
    return [sheet, parity, _isolation_table(name, figures["isolation"])], figures


def _check(survivors: Sequence[int]) -> None:
    for k in survivors:
        if not 3 <= k <= _MOST_SENSORS:
            raise SettingError(f"the number of sensors that must work must be 3 to {_MOST_SENSORS}, not {k}")


def _reliability(survivors: Sequence[int]) -> tuple[Table, dict[str, list[dict[str, Any]]]]:
    """Table 2.1, as far as each column's best n and at least as far as the thesis' figure 2.4."""
    _check(survivors)
    columns = {k: {row.n: row for row in imu_array.table_2_1(3 * _MOST_SENSORS, k)} for k in dict.fromkeys(survivors)}
    best = {k: max(rows.values(), key=lambda r: r.figure).n for k, rows in columns.items()}
    last = max(12, *(n + 1 for n in best.values()))
    heads = [f"theta_n, F_n ({k} must work)" for k in columns]
    sheet = Table("n", *heads, title="Table 2.1: relative MTBF and figure F_n = theta_n / n (* best)")
    for n in range(3, last + 1):
        cells = [f"{rows[n].theta:.4f}  {rows[n].figure:.4f}{'*' if best[k] == n else ''}" if n in rows else "-" for k, rows in columns.items()]
        sheet.add_row(str(n), *cells)
    return sheet, {str(k): [row._asdict() for n, row in rows.items() if n <= last] for k, rows in columns.items()}


def _isolation(array: imu_array.ImuArray) -> list[dict[str, Any]]:
    counts = tuple(range(min(3, array.n - 3) + 1))
    rows = [row._asdict() for row in worst_case_after_isolation(array, counts)]
    return [{key: None if isinstance(value, float) and math.isinf(value) else value for key, value in row.items()} for row in rows]


def _isolation_table(name: str, rows: list[dict[str, Any]]) -> Table:
    sheet = Table(title=f"{name}: worst left after isolation; sigma of one sensor is 1; (k): k choices alike")
    for head in ("out", "GDOP", "sigma", "J_p", "which, from 0", "along x y z", "lost"):
        sheet.add_column(head, no_wrap=True)
    for row in rows:
        cells = ["none" if row[key] is None else f"{row[key]:.4f}" for key in ("gdop", "sigma_worst", "accuracy_figure")]
        alike = f" ({row['alike']})" if row["alike"] > 1 else ""
        sensors = " ".join(map(str, row["sensors"])) + alike if row["isolated"] else "-"  # in brackets: choices as bad
        along = "every" if row["direction"] is None else " ".join(f"{v:+.2f}" for v in row["direction"])
        sheet.add_row(str(row["isolated"]), *cells, sensors, along, f"{row['singular']}/{row['choices']}")
    return sheet
