"""Figures of the car of seed 004: errors as its figures 4 to 9, test statistics as its figures 10 and 11, delay against slope.

Lives here: `figures`.
Does not live here: the experiments and their numbers (vehicle.py), the simulation (vehicle_model.py).
"""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
from numpy.typing import NDArray

from riins_fdi.innovation_tests import INNOVATION_TESTS

from . import vehicle
from .rows import Figure
from .vehicle_model import ALTIMETER, GNSS, LOUDER, ODOMETER, SECONDS, Fault, drive, judge

Array = NDArray[np.float64]
_COLORS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
_SHADES = {GNSS: "#d55e00", ODOMETER: "#56b4e9", ALTIMETER: "#009e73"}


def figures() -> list[Figure]:
    """Errors of one drive, statistics with a step and a ramp, delay against slope."""
    names = ("fusion-reset, equal shares", "no-reset, equal shares", "no-reset, shares by innovations", "information form, adaptive R")
    errors = {name: vehicle.steer(vehicle.ACCURACY[name](), drive(0), louder=True).error for name in names}
    by_all = judge(vehicle.ALL)
    noise, unit = by_all.innovations(7, 60), by_all.shift(Fault(vehicle.ONSET, SECONDS, slope=1.0))
    slopes = vehicle.slope(vehicle.ALL) * 2.0 ** np.linspace(-1.0, 3.0, 7)
    late = {name: [vehicle.delays(vehicle.made(name), noise, size * unit).mean() for size in slopes] for name in INNOVATION_TESTS}
    return [
        Figure("vehicle-errors", "A drive on which the noise grows untold (figures 4 to 9)", functools.partial(_draw_errors, errors)),
        Figure("vehicle-tests", "Step and ramp of GNSS: chi-square and improved test (figures 10 and 11)", functools.partial(_draw_tests, noise[0])),
        Figure("vehicle-ramps", "Delay on a ramp of GNSS at equal false-alarm rate", functools.partial(_draw_ramps, slopes, late)),
    ]


def _draw_errors(errors: dict[str, Array], canvas: Any) -> None:
    axes = canvas.subplots(3, 2, sharex=True)
    labels = ("east velocity, m/s", "north velocity, m/s", "down velocity, m/s", "north, m", "east, m", "down, m")
    for ax, state, label in zip(axes.T.ravel(), (4, 3, 5, 0, 1, 2), labels, strict=True):
        for color, (name, error) in zip(_COLORS, errors.items(), strict=False):
            ax.plot(error[:, state], lw=0.8, color=color, label=name)
        for aid, first, last, _ in LOUDER:
            ax.axvspan(first, last, color=_SHADES[aid], alpha=0.1)
        ax.set_ylabel(label)
        inside = np.abs(np.concatenate([error[vehicle.SCORED :, state] for error in errors.values()])).max()
        ax.set_ylim(-1.1 * inside, 1.1 * inside)
    axes[0, 0].legend(fontsize=7)
    for ax in axes[-1]:
        ax.set_xlabel("time, s; red, blue, green: noise of GNSS, odometer, altimeter grows")


def _draw_tests(noise: Array, canvas: Any) -> None:
    axes = canvas.subplots(2, 2, sharex=True, sharey="row")
    by_all = judge(vehicle.ALL)
    cases = {"step": Fault(vehicle.ONSET, SECONDS, step=vehicle.STEP), "ramp": Fault(vehicle.ONSET, SECONDS, slope=vehicle.slope(vehicle.ALL))}
    for column, (word, fault) in enumerate(cases.items()):
        shifted = noise + by_all.shift(fault)
        for ax, name, label in zip(axes[:, column], ("nis", "improved"), ("chi-square", "improved"), strict=True):
            test = vehicle.made(name).clone()
            test.restart = False
            ax.semilogy(np.maximum(test.process(shifted)[0], 0.1), lw=0.8, color=_COLORS[0])
            ax.axhline(test.threshold, color=_COLORS[1], lw=1)
            ax.axvline(vehicle.ONSET, color="#999999", lw=1)
            ax.set_ylabel(label)
        axes[0, column].set_title(f"{word} from {vehicle.ONSET} s on")
        axes[1, column].set_xlabel("time, s")


def _draw_ramps(slopes: Array, late: dict[str, list[float]], canvas: Any) -> None:
    ax = canvas.subplots()
    for color, (name, values) in zip(_COLORS, late.items(), strict=True):
        ax.loglog(slopes, values, "o-", color=color, label=name)
    ax.axhline(vehicle.COSTS, color="#999999", lw=1)
    ax.set(xlabel="slope, m/s", ylabel="mean delay, s")
    ax.legend()
