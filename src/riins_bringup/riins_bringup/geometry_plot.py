"""Polar figure of a geometry's accuracy by direction.

Lives here: `draw_accuracy`.
Does not live here: the standard deviations (riins_core.survivors), the tables (geometry.py), the figures of runs (riins_eval.plots).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Literal

import matplotlib
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from riins_core.imu_array import ImuArray
from riins_core.survivors import worst_sigma_by_direction
from riins_eval.draw_png import STYLE

_AXES = (("forward", "aft"), ("starboard", "port"), ("down", "up"))
_PLANES = ((0, 1), (0, 2), (1, 2))
_COLORS = ("#0f766e", "#b45309", "#7c3aed", "#be123c")
_LINES: tuple[Literal["-", "--", "-.", ":"], ...] = ("-", "--", "-.", ":")
_ISOLATED = {0: "all sensors", 1: "worst sensor isolated", 2: "worst two isolated"}
_STEPS = 720


def draw_accuracy(arrays: Mapping[str, ImuArray], path: Path) -> None:
    """Standard deviation of the fused value by direction in the three principal planes: with all sensors, and after the worst loss of one and of two.

    Parameters
    ----------
    arrays : geometries by name, up to four, to be compared
    path : PNG to write; the worst loss is that of each direction, so a curve is the envelope over all choices
    """
    turn = np.linspace(0.0, 2.0 * math.pi, _STEPS + 1)
    losses = [k for k in _ISOLATED if all(array.n - k >= 3 for array in arrays.values())]
    with matplotlib.rc_context(STYLE):  # type: ignore[arg-type,unused-ignore]
        canvas = Figure(figsize=(11.0, 3.9 * len(losses) + 0.8), dpi=110, layout="constrained")
        FigureCanvasAgg(canvas)
        canvas.suptitle("Standard deviation of the fused value by direction, in units of one sensor's", fontsize=13, x=0.01, ha="left")
        grid = canvas.subplots(len(losses), len(_PLANES), subplot_kw={"projection": "polar"}, squeeze=False)
        for row, isolated in zip(grid, losses, strict=True):
            largest, lost = 0.0, []
            for column, (axes, (first, second)) in enumerate(zip(row, _PLANES, strict=True)):
                directions = np.zeros((len(turn), 3))
                directions[:, first], directions[:, second] = np.cos(turn), np.sin(turn)
                for (name, array), color, line in zip(arrays.items(), _COLORS, _LINES, strict=False):
                    sigma = worst_sigma_by_direction(array, directions, isolated)
                    if np.all(np.isfinite(sigma)):
                        axes.plot(turn, sigma, color=color, linestyle=line, linewidth=1.8)
                        largest = max(largest, float(sigma.max()))
                    elif column == 0:
                        lost.append(name)
                ends = (_AXES[first][0], "", _AXES[second][0], "", _AXES[first][1], "", _AXES[second][1], "")
                axes.set_thetagrids(range(0, 360, 45), ends)
                axes.set_title(_ISOLATED[isolated], fontsize=10)
                axes.tick_params(labelsize=8)
            for axes in row:  # one scale a row, from zero: shapes and sizes can be compared
                axes.set_rlim(0.0, 1.1 * largest or 1.0)
                axes.yaxis.set_major_locator(MaxNLocator(4, prune="lower"))
            if lost:
                row[0].set_xlabel(f"{', '.join(lost)}: an axis is lost", fontsize=8)
        handles = [Line2D([], [], color=color, linestyle=line, linewidth=1.8) for color, line in zip(_COLORS, _LINES, strict=True)]
        canvas.legend(handles[: len(arrays)], list(arrays), loc="outside lower center", ncols=4)
        path.parent.mkdir(parents=True, exist_ok=True)
        canvas.savefig(path, format="png")
