"""Figures of the drawn faults: distance from the fault-free twin against size, and errors against protection levels (Stanford plots).

Lives here: `figures`, made of what the study has measured.
Does not live here: the experiment and its numbers (fault_draws.py).
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.colors import LogNorm
from numpy.typing import NDArray

from riins_sim.faults import FaultType

from .fault_draws import AIDS, TOO_LARGE, TYPES, Outcome
from .rows import Figure

Array = NDArray[np.float64]
_COLORS = ("#0072b2", "#009e73", "#d55e00")
_MARKS = {FaultType.STEP: "o", FaultType.RAMP: "^", FaultType.NOISE: "x", FaultType.STUCK: "s"}


def figures(found: Sequence[Outcome], quiet: Sequence[Array]) -> list[Figure]:
    """Distance against size, and the Stanford plots of position and heading."""

    def draw_shift(canvas: Any) -> None:
        axes = canvas.subplots(1, len(AIDS), sharey=True)
        for i, (ax, aid, color) in enumerate(zip(axes, AIDS, _COLORS, strict=True)):
            for kind in TYPES:
                some = [o for o in found if o.aid == i and o.kind == int(kind)]
                shifts = [max(o.shift, 1e-2) for o in some]
                ax.loglog([max(o.size, 0.1) for o in some], shifts, _MARKS[kind], ms=4, color=color, mfc="none", label=kind.name.lower())
            ax.axvline(TOO_LARGE, color="#999999", lw=1)
            ax.set(xlabel="largest error, sigma of the innovation", title=aid)
            ax.legend(fontsize=8)
        axes[0].set_ylabel("largest distance from the fault-free twin, m")

    def draw_stanford(first: int, scale: float, what: str, canvas: Any) -> None:
        axes = canvas.subplots(1, 2, sharey=True)
        for ax, (title, some) in zip(axes, (("without a fault", quiet), ("with a fault", [o.integrity for o in found])), strict=True):
            error, level = np.concatenate([one[first : first + 2] for one in some], axis=1) / scale
            usable = np.isfinite(level)
            top = float(np.quantile(level[usable], 0.999)) * 1.2 if usable.any() else 1.0
            edges = np.linspace(0.0, top, 120)
            *_, image = ax.hist2d(
                np.clip(error[usable], 0.0, top), np.clip(level[usable], 0.0, top), bins=(edges, edges), norm=LogNorm(), cmap="viridis"
            )
            ax.plot([0.0, top], [0.0, top], color="#d55e00", lw=1)
            ax.set(xlabel=what, title=f"{title}: {int(np.sum(error > level))} of {len(error)} epochs beyond")
        axes[0].set_ylabel("protection level")
        canvas.colorbar(image, ax=axes, label="epochs")

    return [
        Figure("draws-distance", "How far a fault draws the position, against its size", draw_shift),
        Figure("draws-stanford", "Error against protection radius (Stanford plot)", functools.partial(draw_stanford, 0, 1.0, "horizontal error, m")),
        Figure(
            "draws-stanford-heading", "The same of the heading", functools.partial(draw_stanford, 2, float(np.radians(1.0)), "heading error, deg")
        ),
    ]
