"""What a figure is made of, whoever draws it: panels of traces, bands, bars and shades, colours, thinning.

Lives here: `Figure`, `Panel`, `Trace`, `Band`, `Bar`, `Shade`, `thin`.
Does not live here: which figures a run has (plots.py), drawing (draw_png.py, draw_html.py).
"""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

MOST_POINTS = 5000
"""Points of a trace at most; a 12 h run at 1 Hz has 43200."""

INK, MUTED, ESTIMATE, REJECTED = "#1f2937", "#9ca3af", "#0072b2", "#d55e00"
AID_COLORS = {
    "gps": "#e69f00",
    "bds": "#009e73",
    "doppler": "#cc79a7",
    "height": "#7c6fb0",
    "odometer": "#56b4e9",
    "altimeter": "#8c6d31",
    "star_tracker": "#332288",
}
STATE_COLORS = {
    "healthy": "#b7dfc6", "suspect": "#f2cf3f", "isolated": "#d55e00", "probation": "#7cc4ec", "compensated": "#0072b2",
    "absent": "#9ca3af", "excluded": "#4b5563",
}  # fmt: skip
AID_NAMES = {
    "gps": "GPS",
    "bds": "BDS",
    "doppler": "Doppler log",
    "height": "mean height",
    "odometer": "odometer",
    "altimeter": "altimeter",
    "star_tracker": "star sensor",
}


@dataclasses.dataclass
class Trace:
    """A line or a cloud of points; `style`: line, dash, dots, crosses; `legend`: name it there."""

    x: Floats
    y: Floats
    name: str
    color: str
    style: str = "line"
    width: float = 1.4
    legend: bool = True


@dataclasses.dataclass
class Band:
    """An area between two lines."""

    x: Floats
    low: Floats
    high: Floats
    name: str
    color: str
    legend: bool = True


@dataclasses.dataclass
class Bar:
    """A stretch of a timeline: row name, from, to, state."""

    row: str
    start: float
    stop: float
    state: str


@dataclasses.dataclass
class Shade:
    """A fault in force: from, to, label."""

    start: float
    stop: float
    label: str


@dataclasses.dataclass
class Panel:
    """One pair of axes."""

    label: str
    traces: list[Trace] = dataclasses.field(default_factory=list)
    bands: list[Band] = dataclasses.field(default_factory=list)
    bars: list[Bar] = dataclasses.field(default_factory=list)
    shades: list[Shade] = dataclasses.field(default_factory=list)
    rows: list[str] = dataclasses.field(default_factory=list)
    log: bool = False
    y_range: tuple[float, float] | None = None


@dataclasses.dataclass
class Figure:
    """Panels on one horizontal axis, top to bottom; `equal`: a map, one metre is as long on both axes; `height`: px of a panel."""

    key: str
    title: str
    caption: str
    x_label: str
    panels: list[Panel]
    equal: bool = False
    height: int = 210
    x_range: tuple[float, float] | None = None


def thin(x: Floats, y: Floats, most: int = MOST_POINTS) -> tuple[Floats, Floats]:
    """Thin a line so that its extremes stay: of each bucket the smallest and the largest value, in their order.

    Parameters
    ----------
    x, y : (m,)
    most : points at most

    Returns
    -------
    x, y : (k,), k <= most
    """
    m = len(x)
    if m <= most:
        return x, y
    edges = np.linspace(0, m, most // 2 + 1).astype(int)
    keep: list[int] = []
    for a, b in itertools.pairwise(edges):
        piece = y[a:b]
        if np.isfinite(piece).any():
            low, high = a + int(np.nanargmin(piece)), a + int(np.nanargmax(piece))
            keep += [low] if low == high else [min(low, high), max(low, high)]
        else:
            keep.append(int(a))
    return x[keep], y[keep]
