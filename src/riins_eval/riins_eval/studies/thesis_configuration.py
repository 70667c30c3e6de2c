"""Thesis chapter 2: how many sensors, and how they are mounted; tables 2.1 to 2.3 and what is left when sensors are isolated.

Lives here: the rows and figures of the configuration study for the thesis' geometries.
Does not live here: the figures of merit (riins_core.imu_array, riins_core.survivors), other geometries (`riins geometry FILE`).
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from riins_core.imu_array import CONFIGURATIONS, ImuArray, cone1, cone2, table_2_1, table_2_3
from riins_core.survivors import worst_case_after_isolation, worst_sigma_by_direction
from riins_eval.studies.rows import Figure, Progress, Row, row

Array = NDArray[np.float64]

# theta_n of table 2.1 for n = 3 .. 16
PRINTED_THETA = (1, 1.75, 2.35, 2.85, 3.2786, 3.6536, 3.9869, 4.2869, 4.5596, 4.8096, 5.0404, 5.2547, 5.4547, 5.6422)
PRINTED_COHERENCE = {"orthogonal": 1.0, "cone1": 0.6667, "cone2": 0.5774, "dodecahedron": 0.4472}
PRINTED_ANGLE = {"cone1": 54.7356, "cone2": 35.7356}
_ISOLATED = (1, 2, 3)


def describe(name: str, array: ImuArray) -> list[Row]:
    """Figures of merit of one geometry: J_p, GDOP, coherence, H'H - n/3 I, and the worst case when sensors are isolated."""
    best = (array.n / 3.0) ** 3
    deviation = float(np.max(np.abs(array.H.T @ array.H - array.n / 3.0 * np.eye(3))))
    rows = [
        row(None, f"{name}: J_p, best {best:.6g}", array.accuracy_figure()),
        row(None, f"{name}: GDOP, best {3.0 / math.sqrt(array.n):.4f}", array.gdop()),
        row(None, f"{name}: coherence", array.coherence()),
        row(None, f"{name}: largest |H'H - n/3 I|", deviation),
    ]
    for left in worst_case_after_isolation(array, tuple(k for k in _ISOLATED if k <= array.n - 3)):
        remark = f"{left.singular} of {left.choices} choices leave fewer than three axes" if left.singular else ""
        rows.append(Row(None, f"{name}: worst sigma of any direction, {left.isolated} isolated", None, *(left.sigma_worst,) * 3, 1, None, remark))
    return rows


def best_angle(cone: Any) -> float:
    """Inclination [deg] of a cone configuration that makes J_p largest, found by searching."""
    found = minimize_scalar(lambda a: -ImuArray(cone(a)).accuracy_figure(), bounds=(0.1, 1.5), method="bounded", options={"xatol": 1e-10})
    return math.degrees(found.x)


def run(seeds: int, quick: bool, progress: Progress) -> tuple[list[Row], list[Figure]]:
    """The whole chapter; nothing in it is random, so `seeds` and `quick` change nothing."""
    rows = _tables()
    progress(0.5)
    for name, H in CONFIGURATIONS.items():
        rows += [r for r in describe(name, ImuArray(H)) if "isolated" in r.name]
    progress(1.0)
    return rows, [
        Figure("reliability", "Reliability against the number of sensors (figures 2.2 to 2.4)", _draw_reliability),
        Figure("cone_angles", "Accuracy and coherence against the cone angle (figures 2.9 and 2.10)", _draw_cones),
        Figure("accuracy_by_direction", "Standard deviation by direction, worst choice of isolated sensors", _draw_directions),
    ]


def _near(wanted: float, tolerance: float) -> Callable[[Row], bool]:
    return lambda r: abs(r.value - wanted) <= tolerance


def _tables() -> list[Row]:
    theta = np.array([r.theta for r in table_2_1()])
    rows = [row(1, "table 2.1: largest difference of theta_n, n = 3..16", np.max(np.abs(theta - PRINTED_THETA)), paper=0.0, ok=_near(0.0, 1e-4))]
    for survivors, remark in ((3, ""), (4, "with four left a fault is still seen"), (5, "with five left a fault is still isolated")):
        best = max(table_2_1(30, survivors), key=lambda r: r.figure)
        demanded = {3: 6, 4: 9, 5: 11}[survivors]
        text = f"the optimum of 6 holds only where three survivors are enough; {remark}" if remark else ""
        rows.append(row(1, f"n of the largest F_n, {survivors} survivors needed", best.n, paper=6, ok=_near(demanded, 0.0), remark=text))
    for name, cone in (("cone1", cone1), ("cone2", cone2)):
        wanted = {"cone1": 54.7356, "cone2": 35.2644}[name]
        remark = "printed 35.7356 is a slip: the printed row (0.5774, 0, 0.8165) is that of 35.2644" if name == "cone2" else ""
        rows.append(
            row(
                1, f"{name}: angle of the largest J_p, deg", best_angle(cone), paper=PRINTED_ANGLE[name],
                ok=_near(wanted, 1e-4), remark=remark,
            )
        )  # fmt: skip
    coherence = {r.name: r.coherence for r in table_2_3()}
    for name, H in CONFIGURATIONS.items():
        array, least = ImuArray(H), min(coherence.values())
        deviation = float(np.max(np.abs(array.H.T @ array.H - 2.0 * np.eye(3))))
        rows.append(row(1, f"table 2.2, {name}: largest |H'H - 2 I|", deviation, paper=0.0, ok=_near(0.0, 1e-12)))
        rows.append(row(1, f"{name}: J_p", array.accuracy_figure(), paper=8.0, ok=_near(8.0, 1e-12)))
        made = row(
            1, f"table 2.3, {name}: coherence", coherence[name], paper=PRINTED_COHERENCE[name],
            ok=_near(PRINTED_COHERENCE[name], 1e-4),
        )  # fmt: skip
        rows.append(dataclasses.replace(made, remark="best" if coherence[name] == least else ""))
    return rows


def _draw_reliability(canvas: Any) -> None:
    left, right = canvas.subplots(1, 2)
    for survivors in (3, 4, 5):
        table = table_2_1(20, survivors)
        n = [r.n for r in table]
        left.plot(n, [r.theta for r in table], "o-", label=f"{survivors} must survive")
        right.plot(n, [r.figure for r in table], "o-", label=f"{survivors} must survive")
    left.set(xlabel="sensors n", ylabel="relative MTBF")
    right.set(xlabel="sensors n", ylabel="F_n = MTBF / n")
    left.legend()


def _draw_cones(canvas: Any) -> None:
    axes = canvas.subplots(1, 2)
    angles = np.radians(np.linspace(2.0, 88.0, 173))
    for ax, (name, cone) in zip(axes, (("cone1", cone1), ("cone2", cone2)), strict=True):
        arrays = [ImuArray(cone(a)) for a in angles]
        ax.plot(np.degrees(angles), [a.accuracy_figure() for a in arrays], label="J_p")
        ax.plot(np.degrees(angles), [8.0 * a.coherence() for a in arrays], label="8 x coherence")
        ax.axvline(best_angle(cone), color="0.6", lw=0.8)
        ax.set(xlabel="cone angle, deg", title=name)
    axes[0].legend()


def _draw_directions(canvas: Any) -> None:
    turn = np.linspace(0.0, 2.0 * math.pi, 361)
    cos, sin, zero = np.cos(turn), np.sin(turn), np.zeros_like(turn)
    planes = {"xy": np.column_stack([cos, sin, zero]), "xz": np.column_stack([cos, zero, sin])}
    axes = canvas.subplots(len(planes), len(CONFIGURATIONS), subplot_kw={"projection": "polar"})
    for i, (plane, directions) in enumerate(planes.items()):
        for ax, (name, H) in zip(axes[i], CONFIGURATIONS.items(), strict=True):
            for isolated in (0, 1, 2, 3):
                sigma = worst_sigma_by_direction(ImuArray(H), directions, isolated)
                if np.all(np.isfinite(sigma)):
                    ax.plot(turn, sigma, label=f"{isolated} isolated")
            ax.set_title(f"{name}, {plane}")
            ax.set_rmax(4.4)  # one scale for all
            ax.set_rticks([1.0, 2.0, 3.0, 4.0])
            ax.tick_params(labelsize=6)
    canvas.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
