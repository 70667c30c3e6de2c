"""Figures of the alignment study: convergence at rest, the thesis' figures 3.3 to 3.5, error by heading, observability, waves, under way.

Lives here: `at_rest_figures`, `at_sea_figures`. Does not live here: the numbers (alignment.py, alignment_at_sea.py).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from riins_core.sensor_errors import ARCMIN, ARCSEC

from .alignment import (
    ANGLES,
    BIAS,
    DRIFT,
    all_sensors,
    attitude_error_rows,
    observed,
    seed_001,
    thesis_filter,
    traditional,
)
from .rows import Figure

Array = NDArray[np.float64]
Curve = tuple[str, Array, Array, Array]
"""Label, times [s], attitude errors (m, 3) and their sigmas (m, 3), rad."""

_COLORS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00")


def at_rest_figures() -> list[Figure]:
    """Figures of the chapter at rest, with the noise of seed 0."""
    return [_convergence(), _traditional(), _three_states(), _by_heading(), _singular()]


def _convergence() -> Figure:
    curves = []
    for column, staged in enumerate((False, True)):
        for line, angle in enumerate(ANGLES):
            for states in (12, 10, 7):
                _, history = seed_001(states, angle, staged, 0)
                curves.append((line, column, states, history.t, attitude_error_rows(history.C_nb, np.eye(3))[:, 2] / ARCMIN))

    def draw(canvas: Any) -> None:
        grid = canvas.subplots(3, 2, sharex=True, sharey="row")
        for line, column, states, t, error in curves:
            color = _COLORS[(12, 10, 7).index(states)]
            grid[line, column].plot(t, error, color=color, linewidth=(3.0, 1.8, 0.9)[(12, 10, 7).index(states)], label=f"{states} states")
        for line, angle in enumerate(ANGLES):
            grid[line, 0].set_ylabel(f"{angle:g}°: heading [arcmin]")
            grid[line, 0].set_ylim(-60.0, 60.0)
        grid[0, 0].set_title("one correction")
        grid[0, 1].set_title("begun anew at 60 and 120 s")
        for axes in grid[2]:
            axes.set_xlabel("time [s]")
        grid[0, 1].legend()

    return Figure("alignment_states", "Seed 001, figure 1: heading error of the corrected attitude for three misalignments", draw)


def _traditional() -> Figure:
    t, error = traditional(0)

    def draw(canvas: Any) -> None:
        left, right = canvas.subplots(1, 2)
        for k, name in enumerate(("about north", "about east")):
            left.plot(t, error[:, k] / ARCSEC, color=_COLORS[k], label=name)
        right.plot(t, error[:, 2] / ARCMIN, color=_COLORS[2])
        left.set_ylim(-100.0, 100.0)
        right.set_ylim(-60.0, 60.0)
        left.set_ylabel("level error [arcsec]")
        right.set_ylabel("heading error [arcmin]")
        left.legend()
        for axes in (left, right):
            axes.set_xlabel("time [s]")

    return Figure("alignment_traditional", "Thesis, figures 3.3 and 3.4: the traditional model, 10 states", draw)


def _three_states() -> Figure:
    error = thesis_filter(0, 0.5 * np.pi)

    def draw(canvas: Any) -> None:
        left, right = canvas.subplots(1, 2)
        t = np.arange(1, len(error) + 1)
        for k, name in enumerate(("roll", "pitch")):
            left.plot(t, error[:, k] / ARCSEC, color=_COLORS[k], label=name)
        right.plot(t, error[:, 2] / ARCMIN, color=_COLORS[2])
        left.set_ylabel("level error [arcsec]")
        right.set_ylabel("heading error [arcmin]")
        left.legend()
        for axes in (left, right):
            axes.set_xlabel("time [s]")

    return Figure("alignment_three_states", "Thesis, figure 3.5: three states on raw outputs, largest NC", draw)


def _by_heading() -> Figure:
    headings, sign = np.arange(0.0, 360.0, 15.0), np.array([1.0, -1.0] * 3)
    pairs = np.array([thesis_filter(1, h)[-1, 2] for h in np.deg2rad(headings)])
    every = np.array([all_sensors(1, h, -DRIFT * sign, BIAS * sign)[-1, 2] for h in np.deg2rad(headings)])

    def draw(canvas: Any) -> None:
        axes = canvas.subplots()
        axes.plot(headings, np.abs(pairs) / ARCMIN, "o-", color=_COLORS[1], label="three states of the thesis, started within 1°")
        axes.plot(headings, np.abs(every) / ARCMIN, "s-", color=_COLORS[0], label="three states on all outputs, started from nothing")
        axes.set_xlabel("heading [°]")
        axes.set_ylabel("|heading error| after 60 s [arcmin]")
        axes.legend()

    return Figure("alignment_by_heading", "Largest NC at every heading", draw)


def _singular() -> Figure:
    def draw(canvas: Any) -> None:
        axes = canvas.subplots()
        for color, (name, (_, seen)) in zip(_COLORS, observed().items(), strict=True):
            axes.semilogy(np.arange(1, seen.states + 1), np.maximum(seen.singular, 1e-20), "o-", color=color, label=f"{name}: rank {seen.rank}")
        axes.set_xlabel("number")
        axes.set_ylabel("singular value, prior over noise of one measurement")
        axes.legend()

    return Figure("alignment_observability", "Singular values of the observability matrices, scaled by prior and noise", draw)


def at_sea_figures(waves: Sequence[Curve], under_way: Sequence[Curve]) -> list[Figure]:
    """Heading error and three times its own sigma along the way, in waves at a mooring and under way."""
    return [
        _with_sigma("alignment_waves", "Moored in waves: the filter over the stored data", waves),
        _with_sigma("alignment_under_way", "Under way from unknown heading: the filter over the stored data", under_way),
    ]


def _with_sigma(name: str, title: str, curves: Sequence[Curve]) -> Figure:
    def draw(canvas: Any) -> None:
        grid = canvas.subplots(2, 1, sharex=True)
        for color, (label, t, error, sigma) in zip(_COLORS, curves, strict=False):
            for axes, k, unit in ((grid[0], 1, ARCSEC), (grid[1], 2, ARCMIN)):
                axes.plot(t, error[:, k] / unit, color=color, linewidth=1.0, label=label)
                axes.fill_between(t, -3.0 * sigma[:, k] / unit, 3.0 * sigma[:, k] / unit, color=color, alpha=0.12, linewidth=0.0)
        grid[0].set_ylabel("tilt about east [arcsec]")
        grid[1].set_ylabel("heading error [arcmin]")
        last = max(float(3.0 * c[3][-1, 2] / ARCMIN) for c in curves)
        grid[0].set_ylim(-120.0, 120.0)
        grid[1].set_ylim(-4.0 * last, 4.0 * last)
        grid[1].set_xlabel("time [s]")
        grid[0].legend()

    return Figure(name, title + ", with 3 sigma", draw)
