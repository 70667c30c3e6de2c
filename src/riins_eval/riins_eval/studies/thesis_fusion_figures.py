"""Figures like those of thesis chapters 5 and 6: rate and force errors, position errors, trajectories, sensors before and after compensation.

Lives here: `figures`, made of the flight with the noise of seed 0.
Does not live here: the experiments and their numbers (thesis_fusion.py).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from riins_core.sensor_errors import DEG_PER_H, MICRO_G

from .rows import Figure
from .thesis_flight import ARRAY, HEALTHY, TOLD, UNTOLD, Experiment, flight, readings
from .thesis_fusion import FIX_S, WAYS, fly, fly_scheme, fuse

Array = NDArray[np.float64]
Curve = tuple[str, Array, Array, Array]
"""Label, position errors NED [m], rate errors [rad/s], force errors [m/s^2], (m, 3) each."""

_SEED = 0
_GOOD = (0b111010, 0b101110)
_COLORS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7")
_WIDTHS = (4.0, 2.2, 1.0)
"""The first curve is the widest: those that coincide stay visible."""


def figures() -> list[Figure]:
    """The figures of both chapters; the curves are computed here, drawing is cheap."""
    made = [Figure("flight", "The flight (figures 5.6-5.8)", _draw_flight)]
    experiments: tuple[tuple[int, str, Experiment, tuple[tuple[str, str, tuple[int, int]], ...]], ...] = (
        (1, "P and Q known", TOLD, (("WLS", "wls", (63, 63)), ("OPT", "opt", (63, 63)))),
        (2, "Q unknown", UNTOLD, (("WLS", "wls", (63, 63)), ("OPT", "opt", (63, 63)))),
        (3, "Q unknown, adaptive", UNTOLD, (("OPT", "opt", (63, 63)), ("AOPT", "aopt", (63, 63)))),
        (4, "isolation and compensation", TOLD, (("WLS", "wls", (63, 63)), ("FDI", "wls", _GOOD), ("OPTDC", "optdc", (63, 63)))),
        (5, "no fault", HEALTHY, (("WLS", "wls", (63, 63)), ("OPTDC", "optdc", (63, 63)))),
    )
    path = flight()
    for number, title, experiment, methods in experiments:
        curves = []
        for label, name, masks in methods:
            fused = fuse(name, experiment, readings(experiment, _SEED), masks)
            curves.append((label, fly(fused), fused[0].x - path.rate, fused[1].x - path.force))
        made += _pair(f"fusion-{number}", f"Chapter 5, experiment {number}: {title}", curves)
    made.append(_sensors())
    for number, experiment, names in (
        (1, HEALTHY, ("wls_na", "po_na")),
        (2, TOLD, ("wls_na_without_parity", "wls_na", "po_na")),
        (3, UNTOLD, ("wls_na", "po_na")),
        (4, UNTOLD, ("po_na", "ipo_na")),
    ):
        curves = []
        for name in names:
            error, rate, force = fly_scheme(name, experiment, _SEED, (0,))[0]
            curves.append((_words(name), error, rate - path.rate, force - path.force))
        made += _pair(f"schemes-{number}", f"Chapter 6, experiment {number}: {WAYS[0]} at {FIX_S:.0f} s", curves)
    return made


def _words(name: str) -> str:
    first, _, rest = name.partition("_na")
    return f"{first.upper()}.NA{rest.replace('_', ' ')}"


def _smooth(y: Array, width: int = 20) -> Array:
    """Means over `width` samples, (m, 3) -> (m / width, 3): 1 s, so that the noise does not hide the drift."""
    m = len(y) // width * width
    return np.asarray(y[:m].reshape(-1, width, y.shape[1]).mean(axis=1))


def _pair(name: str, title: str, curves: list[Curve]) -> list[Figure]:
    seconds = _smooth(flight().t[:, None])[:, 0]
    inertial = [(label, (_smooth(force) / MICRO_G, _smooth(rate) / DEG_PER_H)) for label, _, rate, force in curves]
    errors = [(label, error[::10]) for label, error, _, _ in curves]

    def draw_errors(canvas: Any) -> None:
        grid = canvas.subplots(3, 2, sharex=True)
        for column, unit in enumerate(("force error [µg]", "rate error [°/h]")):
            for axis, letter in enumerate("xyz"):
                axes = grid[axis, column]
                for color, (label, columns) in zip(_COLORS, inertial, strict=False):
                    axes.plot(seconds, columns[column][:, axis], color=color, linewidth=0.9, label=label)
                axes.set_ylabel(f"{letter}: {unit}")
            grid[2, column].set_xlabel("time [s]")
        grid[0, 0].legend()

    def draw_positions(canvas: Any) -> None:
        grid = canvas.subplots(2, 2)
        t = flight().t[::10]
        for axis, (axes, what) in enumerate(zip(grid.flat, ("north", "east", "down"), strict=False)):
            for color, width, (label, error) in zip(_COLORS, _WIDTHS, errors, strict=False):
                axes.plot(t, error[:, axis], color=color, linewidth=width, label=label)
            axes.set_xlabel("time [s]")
            axes.set_ylabel(f"{what} error [m]")
        grid[0, 0].legend()
        _plan(grid[1, 1], [(label, error) for label, error in errors])

    return [
        Figure(f"{name}-errors", f"{title}: force and rate errors, means over 1 s", draw_errors),
        Figure(f"{name}-position", f"{title}: position errors and trajectory", draw_positions),
    ]


def _way() -> Array:
    """North and east way of the flight, (m, 2), m."""
    path = flight()
    north = (path.nav[:, 0] - path.start[0]) * 6.36e6
    return np.column_stack([north, (path.nav[:, 1] - path.start[1]) * 6.39e6 * np.cos(path.start[0])])


def _plan(axes: Any, errors: list[tuple[str, Array]]) -> None:
    way = _way()[::10]
    axes.plot(way[:, 1] / 1e3, way[:, 0] / 1e3, color="#1f2937", linewidth=6.0, alpha=0.35, label="true")
    for color, width, (label, error) in zip(_COLORS, _WIDTHS, errors, strict=False):
        axes.plot((way[:, 1] + error[:, 1]) / 1e3, (way[:, 0] + error[:, 0]) / 1e3, color=color, linewidth=width, label=label)
    axes.set_xlabel("east [km]")
    axes.set_ylabel("north [km]")


def _draw_flight(canvas: Any) -> None:
    path = flight()
    grid = canvas.subplots(2, 2)
    _plan(grid[0, 0], [])
    grid[0, 1].plot(path.t, path.nav[:, 2], color=_COLORS[0])
    grid[0, 1].set_ylabel("height [m]")
    for axes, values, unit in ((grid[1, 0], path.force, "specific force [m/s²]"), (grid[1, 1], np.degrees(path.rate), "rate [°/s]")):
        for axis, letter in enumerate("xyz"):
            axes.plot(path.t, values[:, axis], color=_COLORS[axis], label=letter, linewidth=1.0)
        axes.set_ylabel(unit)
        axes.legend()
    for axes in (grid[0, 1], grid[1, 0], grid[1, 1]):
        axes.set_xlabel("time [s]")


def _sensors() -> Figure:
    """Errors of the twelve sensors before and after OPTDC, figures 5.24-5.27."""
    path, z = flight(), readings(TOLD, _SEED)
    fused = fuse("optdc", TOLD, z)
    panels = []
    for kind, (true, unit, scale) in enumerate(((path.rate, "gyro error [°/h]", DEG_PER_H), (path.force, "accelerometer error [µg]", MICRO_G))):
        before = z[kind] - true @ ARRAY.H.T
        panels.append((unit, _smooth(before) / scale, _smooth(before - fused[kind].compensation) / scale))
    seconds = _smooth(path.t[:, None])[:, 0]

    def draw(canvas: Any) -> None:
        grid = canvas.subplots(2, 2, sharex=True, sharey="row")
        for line, (unit, before, after) in enumerate(panels):
            for column, values in enumerate((before, after)):
                for i in range(values.shape[1]):
                    grid[line, column].plot(seconds, values[:, i], linewidth=0.9, label=f"{i + 1}")
            grid[line, 0].set_ylabel(unit)
        for column, words in enumerate(("before compensation", "after compensation")):
            grid[0, column].set_title(words)
            grid[1, column].set_xlabel("time [s]")
        grid[0, 1].legend(ncols=3, fontsize="small")

    return Figure("fusion-4-sensors", "Chapter 5, experiment 4: sensor errors before and after OPTDC, means over 1 s", draw)
