"""Spoofing: the position of GPS pulled away slowly, or that of GPS and BDS together, while the ship keeps its log and its IMU.

Lives here: pulls of several rates on full voyages through the whole navigator: what is found, when, and how far the ship is led astray.
Does not live here: the voyages (fault_draws.py), the tests that find a pull (riins_fdi, riins_federated).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from riins_eval import metrics
from riins_eval.run_record import ISOLATED
from riins_sim.faults import Fault, FaultType

from .fault_draws import BEGIN_S, Voyage, voyage
from .rows import Figure, Progress, Row, row

Array = NDArray[np.float64]

RATES = (0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0)
"""m/s, to the north."""
PULLED = {"GPS alone": ("gps",), "GPS and BDS together": ("gps", "bds")}
VOYAGES = 20
QUICK_VOYAGES = 3


class Pull(NamedTuple):
    """One pull: isolated after so many seconds (NaN: never); distance from the twin just before (or at the end), largest, last, m; (e,) of it all."""

    delay_s: float
    then: float
    largest: float
    last: float
    stamp_s: Array
    shift: Array
    wrong: bool
    """an aid that was not pulled has been isolated"""


def pulled(under_way: Voyage, names: Sequence[str], rate: float) -> Pull:
    """Sail a pull from BEGIN_S to the end of the voyage."""
    start = round(BEGIN_S * 1e9)
    lane = under_way.fly(*(Fault(name, FaultType.RAMP, slope=rate, axis="north", start_ns=start) for name in names))
    shift = metrics.horizontal_distance(lane.track, under_way.twin.track)
    isolated = [change for change in lane.health if change.state == ISOLATED and change.stamp_ns > start]
    right = [change.stamp_ns for change in isolated if change.target in names]
    delay = (min(right) - start) * 1e-9 if right else np.nan
    at = int(np.searchsorted(lane.track.stamp_ns, min(right))) if right else len(shift)
    seconds = np.asarray((lane.track.stamp_ns - start) * 1e-9, np.float64)
    wrong = any(change.target not in names for change in isolated)
    return Pull(delay, float(shift[max(at - 1, 0)]), float(shift.max()), float(shift[-1]), seconds, shift, wrong)


def run(seeds: int, quick: bool, progress: Progress) -> tuple[Sequence[Row], Sequence[Figure]]:
    """Rows and figures; the number of voyages is its own, since `seeds` counts draws."""
    voyages = QUICK_VOYAGES if quick else min(VOYAGES, max(QUICK_VOYAGES, seeds))
    found: dict[tuple[str, float], list[Pull]] = {(name, rate): [] for name in PULLED for rate in RATES}
    for seed in range(voyages):
        under_way = Voyage(voyage(501 + seed))
        for i, key in enumerate(found):
            found[key].append(pulled(under_way, PULLED[key[0]], key[1]))
            progress((seed + (i + 1) / len(found)) / voyages)
    rows = []
    for (name, rate), pulls in found.items():
        delays = np.array([p.delay_s for p in pulls])
        seen = np.isfinite(delays)
        when = f"isolated in {seen.mean():.0%} of the runs"
        if seen.any():
            then = np.median([p.then for p in pulls if np.isfinite(p.delay_s)])
            when += f", in the median after {np.median(delays[seen]):.0f} s, at {then:.0f} m"
        amiss = sum(p.wrong for p in pulls)
        rows.append(row(None, f"{name} pulled at {rate:g} m/s: largest distance from the fault-free twin, m", [p.largest for p in pulls],
                        centre=np.median, remark=when + (f"; another aid isolated in {amiss} runs" if amiss else "")))  # fmt: skip
    return rows, [Figure("spoofing", "A pulled position: distance from the fault-free twin, one voyage", _drawing(found))]


def _drawing(found: dict[tuple[str, float], list[Pull]]) -> Any:
    def draw(canvas: Any) -> None:
        axes = canvas.subplots(1, len(PULLED), sharey=True)
        for ax, name in zip(axes, PULLED, strict=True):
            for rate in RATES:
                pull = found[name, rate][0]
                after = pull.stamp_s > 0.0
                (line,) = ax.semilogy(pull.stamp_s[after], np.maximum(pull.shift[after], 1e-2), label=f"{rate:g} m/s")
                if np.isfinite(pull.delay_s):
                    ax.axvline(pull.delay_s, color=line.get_color(), lw=0.6, ls=":")
            ax.set(title=name, xlabel="time since the pull began, s; dotted: isolated")
            ax.legend(fontsize=8)
        axes[0].set_ylabel("distance from the fault-free twin, m")

    return draw
