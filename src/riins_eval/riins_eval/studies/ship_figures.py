"""Figures of the ship of seed 003: errors like its figure 3, heading, small and slow faults, faults drawn at random.

Lives here: `voyage_figures`, made of seed 0, and `fault_figures`, made of what the study has measured.
Does not live here: the experiments and their numbers (ship.py, ship_faults.py).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from riins_core.sensor_errors import ARCMIN

from . import ship
from .rows import Figure
from .ship_model import BEGIN, EPOCHS, PERIOD, SEED_FAULTS, model, voyage

if TYPE_CHECKING:
    from .ship_faults import Drawn, Outcome

Array = NDArray[np.float64]
_COLORS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000", "#999999", "#8c6d31", "#7b4173", "#637939")


def voyage_figures() -> list[Figure]:
    """Errors of one voyage with the seed's outages and faults."""
    made = model()
    given = voyage(0, made)
    hours = (np.arange(EPOCHS) + 1) * PERIOD / 3600.0
    best = ship.fly(ship.masters(made.P), made, given, SEED_FAULTS)
    curves = {
        "pure INS": given.truth,
        "position reset every 4 h": ship.position_reset(made, given),
        "information, leave-one-out masters": np.concatenate([given.truth[:BEGIN], best.error]),
    }

    def draw(canvas: Any) -> None:
        axes = canvas.subplots(3, 1, sharex=True)
        for color, (name, error) in zip(_COLORS, curves.items(), strict=False):
            axes[0].semilogy(hours, np.maximum(np.hypot(error[:, 0], error[:, 1]), 1e-1), color=color, label=name)
            axes[1].semilogy(hours, np.maximum(np.hypot(error[:, 2], error[:, 3]), 1e-4), color=color)
            axes[2].plot(hours, error[:, 6] / ARCMIN, color=color)
        sigma = np.sqrt(best.P[:, 6, 6]) / ARCMIN
        axes[2].fill_between(hours[BEGIN:], -sigma, sigma, color="#cccccc", alpha=0.5, label="1 sigma")
        for ax, label in zip(axes, ("position, m", "velocity, m/s", "heading, arcmin"), strict=True):
            ax.set_ylabel(label)
            for fault in SEED_FAULTS:
                ax.axvspan(fault.first * PERIOD / 3600.0, fault.last * PERIOD / 3600.0, color="#d55e00", alpha=0.25)
            for span in ((2.0, 3.0), (3.0, 4.0)):
                ax.axvspan(*span, color="#56b4e9", alpha=0.1)
        axes[0].legend(loc="upper left")
        axes[2].set_xlabel("time, h; blue: GPS, then the log away; red: faults")

    return [Figure("ship-errors", "The voyage (figure 3): errors, seed 0", draw)]


def fault_figures(made: Sequence[Mapping[str, Mapping[str, Outcome]]], draws: Sequence[Drawn]) -> list[Figure]:
    """Largest shift by fault and structure, and the shift of each drawn fault against its size."""

    def draw_table(canvas: Any) -> None:
        axes = canvas.subplots(1, 2, sharey=True)
        for ax, kind in zip(axes, ("step", "ramp"), strict=True):
            for color, name in zip(_COLORS, made[0], strict=False):
                labels = [label for label in made[0][name] if label.startswith(kind) and not label.endswith("min")]
                shift = [np.mean([one[name][label].shift for one in made]) for label in labels]
                ax.loglog([float(label.split()[1]) for label in labels], shift, "o-", color=color, label=name)
        axes[0].set(xlabel="step, m", ylabel="largest shift of the position, mean, m")
        axes[1].set(xlabel="ramp, m/s")
        axes[0].legend(fontsize=7)

    def draw_drawn(canvas: Any) -> None:
        ax = canvas.subplots()
        for aid, name in enumerate(("GPS", "BDS", "log")):
            for kind, mark in enumerate("ox"):
                some = [d for d in draws if d.aid == aid and d.kind == kind]
                sizes, shifts = [d.size for d in some], [max(d.shift, 1e-3) for d in some]
                ax.loglog(sizes, shifts, mark, ms=4, color=_COLORS[aid], label=f"{name}, {('step', 'ramp')[kind]}")
        ax.axvline(8.0, color="#999999", lw=1)
        ax.set(xlabel="largest size, sigma of the innovation", ylabel="largest shift from the fault-free twin, m")
        ax.legend(fontsize=8)

    return [
        Figure("ship-slow-faults", "Small and slow faults of GPS: how far the position is drawn", draw_table),
        Figure("ship-drawn-faults", "Faults drawn at random, default structure", draw_drawn),
    ]
