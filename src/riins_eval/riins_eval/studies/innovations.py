"""Innovation tests at equal false-alarm rate: time between false alarms, delay on ramps and steps (seed 004), extended RAIM (002), correlation.

Lives here: rows of targets 40, 41 and 44, and `run`.
Does not live here: the tests (riins_fdi.innovation_tests), the ship on which they judge aids (ship_faults.py).
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from riins_core import kalman
from riins_core.noise import normal
from riins_eval.studies.rows import Figure, Progress, Row, row
from riins_fdi.eraim import eraim_statistic
from riins_fdi.innovation_tests import INNOVATION_TESTS, InnovationTest

Array = NDArray[np.float64]

DOF = 3
EPOCHS = 36_000
"""Ten hours at 1 Hz between false alarms."""
FOLLOW = 60.0
"""Time constant [s] with which a filter follows a faulty aid: what is left of a ramp in the innovation levels off."""
COSTS = 58.0
"""Delay [s] of the chi-square test that fixes the slope of the ramp, the paper's."""
_ONSET, _AFTER = 100, 500
_RUNS, _QUICK_RUNS = 40, 20
CORRELATION = 0.3
TIME = 10.0
"""Time constant [s] of an aid's Markov error."""


@functools.cache
def made(name: str) -> InnovationTest:
    """A test calibrated once; copies are flown."""
    return INNOVATION_TESTS[name](DOF, EPOCHS)


def false_alarms(name: str, seed: int, epochs: int, correlation: float = 0.0) -> int:
    """False alarms in `epochs` innovations, white or with the given correlation from one to the next."""
    test, count, last = made(name).clone(), 0, np.zeros(DOF)
    for k0 in range(0, epochs, 50_000):
        u = normal(seed, "innovations", k0, min(50_000, epochs - k0), DOF)
        if correlation:
            u *= np.sqrt(1.0 - correlation**2)
            for k in range(len(u)):
                last = u[k] = u[k] + correlation * last
        count += int(np.count_nonzero(test.process(u)[1]))
    return count


def half_correlated(seed: int, epochs: int, modelled: bool) -> Array:
    """Standardized innovations of an aid half of whose variance is a Markov error of time constant TIME, (epochs, DOF).

    Taken as white, with the right variance, or with the Markov error as a state: the Kalman filter of that state, in its steady state.
    """
    white, drive = np.split(normal(seed, "half correlated", 0, epochs, 2 * DOF), 2, axis=1)
    kept = np.exp(-1.0 / TIME)
    markov = lfilter([np.sqrt(1.0 - kept**2)], [1.0, -kept], drive, axis=0)
    z = np.sqrt(0.5) * (white + markov)
    if not modelled:
        return np.asarray(z)
    P = 0.5
    for _ in range(200):
        P = kept**2 * P * 0.5 / (P + 0.5) + 0.5 * (1.0 - kept**2)
    gain = P / (P + 0.5)
    predicted = lfilter([0.0, kept * gain], [1.0, -kept * (1.0 - gain)], z, axis=0)
    return np.asarray((z - predicted) / np.sqrt(P + 0.5))


def shape(kind: str, size: float) -> Array:
    """What a fault leaves in the innovation, sigma: "ramp" followed by the filter, "kept" a ramp that stays in full, "step" followed too."""
    t = np.arange(1, _AFTER + 1, dtype=np.float64)
    if kind == "kept":
        return size * t
    return size * FOLLOW * -np.expm1(-t / FOLLOW) if kind == "ramp" else size * np.exp(-t / FOLLOW)


def delay(name: str, kind: str, size: float, seed: int, runs: int) -> float:
    """Mean delay [s] on a fault of the first component; a run that does not find it counts as long as it is."""
    fault, total = shape(kind, size), 0.0
    for run in range(runs):
        u = normal(seed, f"fault {run}", 0, _ONSET + _AFTER, DOF)
        u[_ONSET:, 0] += fault
        alarm = made(name).clone().process(u)[1][_ONSET:]
        total += float(alarm.argmax()) + 1.0 if alarm.any() else float(_AFTER)
    return total / runs


@functools.cache
def slope(kind: str) -> float:
    """Slope [sigma/s] that costs the chi-square test 58 s, by bisection on its own seeds."""
    low, high = 0.01, 1.0
    for _ in range(12):
        middle = float(np.sqrt(low * high))
        low, high = (middle, high) if delay("nis", kind, middle, 999, 200) > COSTS else (low, middle)
    return high


def raim_difference(seed: int) -> float:
    """Relative difference of the extended RAIM's statistic and the NIS on a random system with units that differ by 1e8."""
    n, m = 8, 3
    draw = normal(seed, "raim", 0, n + 2 * m, n + m)
    units = 10.0 ** np.linspace(-5.0, 3.0, n)
    P = (draw[:n, :n] @ draw[:n, :n].T + 0.1 * np.eye(n)) * np.outer(units, units)
    x, H, z, R = draw[n, :n] * units, draw[n : n + m, :n] / units, 3.0 * draw[n + m, :m], np.diag(1.0 + draw[-1, :m] ** 2)
    nis = kalman.innovation(x, P, z, H, R).nis
    return abs(eraim_statistic(x, P, z, H, R) / nis - 1.0)


def run(seeds: int, quick: bool, progress: Progress) -> tuple[Sequence[Row], Sequence[Figure]]:
    """Rows and a figure."""
    rows: list[Row] = []
    names = list(INNOVATION_TESTS)
    hours = 20 if quick else 100
    for i, name in enumerate(names):
        counts = [false_alarms(name, seed, hours * 3600) for seed in range(seeds)]
        total = max(sum(counts), 1)
        between = hours * seeds / total
        rows.append(
            row(
                40, f"{name}: mean time between false alarms, h, of 10 ({hours * seeds} h simulated)", [between],
                ok=lambda r: 5.0 <= r.value <= 20.0, remark="" if hours * seeds >= 200 else "fewer than the 200 h that the target asks for",
            )
        )  # fmt: skip
        progress(0.4 * (i + 1) / len(names))
    runs, delays = _QUICK_RUNS if quick else _RUNS, {}
    for i, kind in enumerate(("ramp", "kept")):
        for name in names:
            delays[kind, name] = np.array([delay(name, kind, slope(kind), seed, runs) for seed in range(seeds)])
        progress(0.4 + 0.4 * (i + 1) / 2)
    for kind, words in (("ramp", "ramp that the filter follows in 60 s"), ("kept", "ramp that stays in the innovation in full")):
        rows.append(row(None, f"{words}, {slope(kind):.3f} sigma/s: chi-square, s", delays[kind, "nis"], paper=58.0))
        for name in names[1:]:
            low, high = (0.60, 0.78) if name == "improved" else (0.30, 0.48)
            ratio = delays[kind, name] / delays[kind, "nis"].mean()
            aimed = kind == "ramp" and name in ("improved", "mewma", "averaged")
            rows.append(
                row(
                    41 if aimed else None, f"{words}: {name} / chi-square", ratio, paper=30.0 / 58.0 if name == "improved" else None,
                    ok=functools.partial(_between, low, high) if aimed else None,
                    remark="the paper's 58 s and 30 s are one run each at thresholds that are not told" if aimed and name == "improved" else "",
                )
            )  # fmt: skip
    rows.append(
        row(44, "extended RAIM against NIS, largest relative difference", [max(map(raim_difference, range(200)))], ok=lambda r: r.value <= 1e-9)
    )
    for name in names:
        many = sum(false_alarms(name, seed, 5 * 3600, CORRELATION) for seed in range(min(seeds, 4)))
        hours_between = 5.0 * min(seeds, 4) / max(many, 1)
        rows.append(
            row(None, f"{name}: time between false alarms, h, correlation {CORRELATION} that nobody models", [hours_between], remark="nominal: 10 h")
        )
    spans, span = range(4), (20 if quick else 100) * 3600
    for name in names:
        times = []
        for modelled in (False, True):
            many = sum(int(np.count_nonzero(made(name).clone().process(half_correlated(seed, span, modelled))[1])) for seed in spans)
            times.append(len(spans) * span / 3600.0 / max(many, 1))
        label = f"{name}: time between false alarms, h, half of the variance correlated over {TIME:g} s and a state of the filter"
        remark = f"nominal: 10 h; taken as white: {times[0]:.2g} h"
        rows.append(row(40, label, times[1:], ok=None if quick else functools.partial(_between, 5.0, 20.0), remark=remark))
    progress(1.0)
    return rows, [] if quick else [Figure("innovation-ramps", "Delay on a ramp at equal false-alarm rate", functools.partial(_draw, _sweep()))]


def _between(low: float, high: float, made_row: Row) -> bool:
    return low <= made_row.value <= high


def _sweep() -> dict[str, tuple[Array, Array]]:
    slopes = slope("ramp") * 2.0 ** np.linspace(-1.0, 3.0, 7)
    return {name: (slopes, np.array([delay(name, "ramp", float(size), 7, 60) for size in slopes])) for name in INNOVATION_TESTS}


def _draw(sweep: dict[str, tuple[Array, Array]], canvas: Any) -> None:
    ax = canvas.subplots()
    for name, (slopes, delays) in sweep.items():
        ax.loglog(slopes, delays, "o-", label=name)
    ax.set(xlabel="slope, sigma/s (the filter follows in 60 s)", ylabel="mean delay, s")
    ax.legend()
