"""Figures drawn by matplotlib, one PNG each.

Lives here: `draw_png`.
Does not live here: what is drawn (plots.py), the interactive page (draw_html.py).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure as Canvas
from matplotlib.patches import Patch

from .figure import INK, MUTED, STATE_COLORS, Figure, Panel

STYLE: dict[str, Any] = {
    "font.size": 10, "axes.edgecolor": MUTED, "axes.labelcolor": INK, "xtick.color": INK, "ytick.color": INK, "axes.grid": True,
    "grid.color": "#e5e7eb", "grid.linewidth": 0.8, "axes.axisbelow": True, "axes.spines.top": False, "axes.spines.right": False,
    "legend.frameon": False, "font.family": "DejaVu Sans",
}  # fmt: skip
_DPI = 110


def draw_png(figure: Figure, path: Path, title: str) -> None:
    """Draw one figure.

    Parameters
    ----------
    figure : of `plots.figures`
    path : PNG to write
    title : of the run, put before the figure's own
    """
    with matplotlib.rc_context(STYLE):  # type: ignore[arg-type,unused-ignore]
        height = 1.1 + sum(figure.height for _ in figure.panels) / 100.0
        canvas = Canvas(figsize=(11.0, min(height, 14.0)), dpi=_DPI, layout="constrained")
        FigureCanvasAgg(canvas)
        canvas.suptitle(f"{title}: {figure.title.lower()}", fontsize=13, color=INK, x=0.01, ha="left")
        grid = canvas.subplots(len(figure.panels), 1, sharex=not figure.equal, squeeze=False)
        for row, (axes, panel) in enumerate(zip(grid[:, 0], figure.panels, strict=True)):
            _panel(axes, panel, figure, labels=row == 0)
        canvas.align_ylabels()
        grid[-1, 0].set_xlabel(figure.x_label)
        canvas.savefig(path)


def _panel(axes: Any, panel: Panel, figure: Figure, labels: bool) -> None:
    if panel.rows:
        _timeline(axes, panel)
    for shade in panel.shades:
        axes.axvspan(shade.start, shade.stop, color="#f59e0b", alpha=0.13, linewidth=0)
    for band in panel.bands:
        axes.fill_between(band.x, band.low, band.high, color=band.color, alpha=0.15, linewidth=0, label=band.name if band.legend else None)
    for trace in panel.traces:
        label = trace.name if trace.legend else None
        if trace.style == "dots":
            axes.plot(trace.x, trace.y, ".", color=trace.color, markersize=3.5, alpha=0.7, label=label, markeredgewidth=0)
        elif trace.style == "crosses":
            axes.plot(trace.x, trace.y, "x", color=trace.color, markersize=5, markeredgewidth=1.2, label=label)
        else:
            axes.plot(trace.x, trace.y, linestyle="--" if trace.style == "dash" else "-", color=trace.color, linewidth=trace.width, label=label)
    axes.set_ylabel(panel.label)
    if panel.log:
        axes.set_yscale("log")
    if panel.y_range:
        axes.set_ylim(*panel.y_range)
    if figure.x_range:
        axes.set_xlim(*figure.x_range)
    if figure.equal:
        axes.set_aspect("equal", adjustable="datalim")
    for shade, height in _label_heights(panel) if labels else ():
        axes.annotate(
            shade.label, (shade.start, height), xycoords=("data", "axes fraction"), xytext=(3, -2), textcoords="offset points",
            va="top", fontsize=8, color="#92400e",
        )  # fmt: skip
    handles, names = axes.get_legend_handles_labels()
    if handles and not panel.rows:
        best = "best" if figure.equal else "upper right"
        axes.legend(handles, names, loc=best, ncols=len(handles) if not figure.equal else 1, fontsize=9, markerscale=2.0 if figure.equal else 1.0)


def _label_heights(panel: Panel) -> list[tuple[Any, float]]:
    """Labels of faults that overlap go one under the other."""
    placed: list[tuple[Any, float]] = []
    for shade in sorted(panel.shades, key=lambda s: s.start):
        level = sum(1 for other, _ in placed if other.stop > shade.start)
        placed.append((shade, 1.0 - 0.1 * min(level, 6)))
    return placed


def _timeline(axes: Any, panel: Panel) -> None:
    place = {row: len(panel.rows) - 1 - index for index, row in enumerate(panel.rows)}
    shown: set[str] = set()
    for bar in panel.bars:
        if bar.state == "fault":
            axes.broken_barh([(bar.start, bar.stop - bar.start)], (place[bar.row] - 0.44, 0.1), facecolors=INK, linewidth=0, zorder=3)
        else:
            axes.broken_barh([(bar.start, bar.stop - bar.start)], (place[bar.row] - 0.32, 0.68), facecolors=STATE_COLORS[bar.state], linewidth=0)
        shown.add(bar.state)
    axes.set_yticks(list(place.values()), [row.replace("_", " ") for row in place])
    axes.set_ylim(-0.7, len(place) - 0.3)
    axes.grid(axis="y", visible=False)
    handles = [Patch(color=color, label=state) for state, color in STATE_COLORS.items() if state in shown]
    handles += [Patch(color=INK, label="fault in force")] if "fault" in shown else []
    axes.legend(handles=handles, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=len(handles), fontsize=9)
