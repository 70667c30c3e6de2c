"""Cases of faults put into real recordings, alarm rates made equal on what is free of faults, and what each method makes of every case.

Lives here: `Material`, `draw`, `calibrate`, `judge` and the rows and figures that both recordings share.
Does not live here: the recordings (real_sensors.py, sea_sensors.py), the methods (real_detectors.py).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .real_detectors import Detector, Finding, Pair, Sensors
from .rows import Figure, Row, row

Array = NDArray[np.float64]

TYPES = ("step", "ramp", "stuck", "noise")
QUIET_S = 2.0
"""Alarms closer together than this are one."""
APART_S = 2.0
"""The second of two faults begins at most so long after the first."""
EPISODES_A_HALF = 1
"""Alarms left in each half of the fault-free recording when the methods have been made equal."""
SCALES = np.geomspace(0.5, 16.0, 86)
"""Multiples of the noise among which each method's is sought; 4 % apart."""


@dataclasses.dataclass(frozen=True)
class Fault:
    """One fault of a case: index of the sensor, type, size (rad/s or m/s^2, a second of it for a ramp), seconds since the begin of the stretch."""

    sensor: int
    type: str
    size: float
    start_s: float


@dataclasses.dataclass(frozen=True)
class Case:
    """Faults on one or two sensors of a kind, in the order of their beginnings, in a stretch, judged until `end_s`."""

    kind: int
    stretch: int
    faults: tuple[Fault, ...]
    end_s: float

    @property
    def truth(self) -> frozenset[int]:
        """The sensors."""
        return frozenset(f.sensor for f in self.faults)


@dataclasses.dataclass(frozen=True)
class Material:
    """A recording ready for cases.

    Attributes
    ----------
    sensors : rate, geometry, noise; biases are learned and taken off
    clean : fault-free stretches, gyros and accelerometers (m, n) each
    half : of each stretch (m,), 0 or 1: the half of the recording a sample belongs to, -1: to none (biases are learned there)
    inject : stretch and faults of a case -> gyros and accelerometers from its begin to its end
    sizes : type -> ((least, most) of gyros, (least, most) of accelerometers), SI; drawn evenly in their logarithm
    horizon_s : a fault is looked for so long
    """

    sensors: Sensors
    clean: list[Pair]
    half: list[NDArray[np.int64]]
    inject: Callable[[Case], Pair]
    sizes: dict[str, tuple[tuple[float, float], tuple[float, float]]]
    horizon_s: float

    def hours(self, half: int) -> float:
        """Length of a half."""
        return sum(int((h == half).sum()) for h in self.half) / self.sensors.rate_hz / 3600.0


def draw(material: Material, number: int) -> Case:
    """Case of a number: gyros and accelerometers in turn, every third with two sensors, types in turn; the rest drawn with the number as seed."""
    rng = np.random.default_rng((2026, number))
    kind, count = number % 2, 2 if number % 3 == 2 else 1
    rate, n = material.sensors.rate_hz, material.sensors.array.n
    room = material.horizon_s + APART_S
    lengths = np.array([max(0.0, float((h >= 0).sum()) / rate - room) for h in material.half])
    stretch = int(rng.choice(len(lengths), p=lengths / lengths.sum()))
    begin = float(np.argmax(material.half[stretch] >= 0)) / rate
    start = begin + float(rng.uniform(0.0, lengths[stretch]))
    chosen = rng.permutation(n)[:count]
    faults = []
    for order, sensor in enumerate(chosen):
        shape = TYPES[(number // 2 + order * int(rng.integers(4))) % 4]
        least, most = material.sizes[shape][kind] if shape in material.sizes else (0.0, 0.0)
        size = float(np.exp(rng.uniform(np.log(least), np.log(most))) * rng.choice([-1.0, 1.0])) if most else 0.0
        faults.append(Fault(int(sensor), shape, size, start + (float(rng.uniform(0.0, APART_S)) if order else 0.0)))
    return Case(kind, stretch, tuple(faults), faults[-1].start_s + material.horizon_s)


def shape_of(fault: Fault, t: Array, seed: int) -> Array:
    """What a step, ramp or noise adds at times t (m,) [s]; a stuck value is no sum."""
    on = t >= fault.start_s
    if fault.type == "step":
        return np.asarray(fault.size * on)
    if fault.type == "ramp":
        return np.asarray(fault.size * np.where(on, t - fault.start_s, 0.0))
    return np.asarray(np.random.default_rng((seed, fault.sensor)).normal(0.0, abs(fault.size), len(t)) * on)


def episodes(alarms: NDArray[np.int64], half: NDArray[np.int64], rate_hz: float) -> Array:
    """Number of alarms in each half, (2,): those closer together than QUIET_S are one."""
    apart = np.diff(alarms, prepend=-(10**9)) > QUIET_S * rate_hz
    return np.array([np.sum(half[alarms[apart]] == h) for h in range(2)], dtype=np.float64)


def calibrate(material: Material, detector: Detector, scales: Array = SCALES) -> tuple[Array, Array]:
    """The noise a method must be told so that all alarm equally often, and what that is worth elsewhere.

    Parameters
    ----------
    material, detector
    scales : ascending

    Returns
    -------
    scale : (2,), of each kind: the smallest one that leaves 2 EPISODES_A_HALF alarms in all that is free of faults, by bisection
    alarms : (2,), of each kind: number in both halves, each with the scale that leaves EPISODES_A_HALF in the other one
    """
    known: dict[int, Array] = {}

    def count(i: int) -> Array:
        """Alarms of kind and half."""
        if i not in known:
            known[i] = np.zeros((2, 2))
            for z, half in zip(material.clean, material.half, strict=True):
                for kind, alarms in enumerate(detector.alarms(z, float(scales[i]))):
                    known[i][kind] += episodes(alarms, half, material.sensors.rate_hz)
        return known[i]

    def least(number: Callable[[Array], float], allowed: int) -> int:
        below, at = -1, len(scales) - 1
        while at - below > 1:  # more noise, fewer alarms
            middle = (below + at) // 2
            below, at = (below, middle) if number(count(middle)) <= allowed else (middle, at)
        return at

    scale, alarms = np.empty(2), np.zeros(2)
    for kind in range(2):
        scale[kind] = scales[least(lambda c, kind=kind: float(c[kind].sum()), 2 * EPISODES_A_HALF)]  # type: ignore[misc]
        for half in range(2):
            other = least(lambda c, kind=kind, half=half: float(c[kind, 1 - half]), EPISODES_A_HALF)  # type: ignore[misc]
            alarms[kind] += count(other)[kind, half]
    return scale, alarms


def tune(material: Material, methods: Sequence[Detector], progress: Callable[[float], None]) -> tuple[dict[str, Array], dict[str, Array]]:
    """`calibrate` of every method, by its name."""
    scales, alarms = {}, {}
    for number, method in enumerate(methods):
        scales[method.name], alarms[method.name] = calibrate(material, method)
        progress((number + 1) / len(methods))
    return scales, alarms


@dataclasses.dataclass(frozen=True)
class Result:
    """What a method made of a case."""

    case: Case
    finding: Finding
    delay_s: float

    @property
    def detected(self) -> bool:
        """It alarmed within the horizon."""
        return self.finding.alarm >= 0

    @property
    def right(self) -> bool:
        """The first it named are all at fault."""
        return bool(self.finding.first) and set(self.finding.first) <= self.case.truth

    @property
    def whole(self) -> bool:
        """At the end it has named all that are at fault, and no other."""
        return self.finding.named == self.case.truth

    @property
    def wrong(self) -> bool:
        """It has named one that is not at fault."""
        return bool((self.finding.named | set(self.finding.first)) - self.case.truth)


def judge(
    material: Material, methods: Sequence[Detector], scales: dict[str, Array], cases: Sequence[Case], progress: Callable[[float], None]
) -> dict[str, list[Result]]:
    """Every method on every case."""
    results: dict[str, list[Result]] = {m.name: [] for m in methods}
    for number, case in enumerate(cases):
        z = material.inject(case)
        onset = int(np.ceil(case.faults[0].start_s * material.sensors.rate_hz))
        for method in methods:
            finding = method.find(z, case.kind, onset, scales[method.name].tolist())
            delay = (finding.alarm - onset) / material.sensors.rate_hz if finding.alarm >= 0 else np.inf
            results[method.name].append(Result(case, finding, delay))
        progress((number + 1) / len(cases))
    return results


def share(name: str, hits: Sequence[bool], remark: str = "", ok: bool | None = None) -> Row:
    """A row of a probability with Wilson's 5 and 95 % bounds in place of percentiles."""
    n, z2 = len(hits), 1.6449**2
    if not n:
        return Row(None, name, None, np.nan, np.nan, np.nan, 0, None, remark)
    p = float(np.mean(hits))
    middle, half = (p + z2 / (2 * n)) / (1 + z2 / n), np.sqrt(z2 * (p * (1 - p) / n + z2 / (4 * n * n))) / (1 + z2 / n)
    return Row(None, name, None, p, float(max(0.0, middle - half)), float(min(1.0, middle + half)), n, ok, remark)


def rows_of(
    prefix: str,
    material: Material,
    methods: Sequence[Detector],
    scales: dict[str, Array],
    alarms: dict[str, Array],
    results: dict[str, list[Result]],
) -> list[Row]:
    """Rows of a recording: of each method the table's columns, then detection by type."""
    rows = []
    hours = material.hours(0) + material.hours(1)
    asked = 2 * EPISODES_A_HALF / hours
    for method in methods:
        start = f"{prefix}, {method.title}: "
        single = [r for r in results[method.name] if len(r.case.faults) == 1]
        double = [r for r in results[method.name] if len(r.case.faults) == 2]
        told = "the noise it is told: gyros x {:.2f}, accelerometers x {:.2f}".format(*scales[method.name])
        per_hour = alarms[method.name] / hours
        rows.append(Row(None, start + "false alarms an hour and kind where not calibrated", f"{asked:.3g} where it was", float(np.mean(per_hour)),
                        float(per_hour.min()), float(per_hour.max()), 2, None, told))  # fmt: skip
        rows.append(share(start + "one fault: detected", [r.detected for r in single]))
        rows.append(share(start + "one fault: right sensor, of those detected", [r.right for r in single if r.detected]))
        delays = np.array([r.delay_s for r in single if r.detected] or [np.nan])
        rows.append(row(None, start + "one fault: median delay, s", delays, centre=np.median))
        rows.append(share(start + "two faults: detected", [r.detected for r in double]))
        rows.append(share(start + "two faults: first name right, of those detected", [r.right for r in double if r.detected]))
        rows.append(share(start + "two faults: both named and no other", [r.whole for r in double]))
        rows.append(share(start + "a healthy sensor named, of all cases", [r.wrong for r in (*single, *double)]))
        for shape in TYPES:
            rows.append(share(start + f"one fault, {shape}: detected", [r.detected for r in single if r.case.faults[0].type == shape]))
    return rows


def bars(name: str, title: str, methods: Sequence[Detector], results: dict[str, list[Result]]) -> Figure:
    """Detection and isolation of every method."""

    def draw_bars(canvas: Any) -> None:
        left, right = canvas.subplots(1, 2, sharey=True)
        at = np.arange(len(methods))
        for axes, count, words in ((left, 1, "one fault"), (right, 2, "two faults")):
            mine = {m.name: [r for r in results[m.name] if len(r.case.faults) == count] for m in methods}
            for i, (label, of) in enumerate((("detected", "detected"), ("first name right", "right"), ("all named, no other", "whole"))):
                axes.barh(at + 0.27 * (i - 1), [np.mean([getattr(r, of) for r in mine[m.name]] or [0.0]) for m in methods], 0.25, label=label)
            axes.set_title(f"{words}, n = {len(mine[methods[0].name])}")
            axes.set_xlim(0.0, 1.0)
            axes.set_xlabel("share of all cases")
        left.set_yticks(at, [m.title for m in methods])
        left.invert_yaxis()
        canvas.legend(*right.get_legend_handles_labels(), loc="outside lower center", ncols=3)

    return Figure(name, title, draw_bars)


def curves(name: str, title: str, material: Material, methods: Sequence[Detector], results: dict[str, list[Result]]) -> Figure:
    """Detection of one step, ramp or noise by its size."""

    def draw_curves(canvas: Any) -> None:
        plots = canvas.subplots(1, 3, sharey=True)
        for axes, shape in zip(plots, ("step", "ramp", "noise"), strict=True):
            for number, method in enumerate(methods):
                mine = [r for r in results[method.name] if len(r.case.faults) == 1 and r.case.faults[0].type == shape]
                if not mine:
                    continue
                # gyros and accelerometers on one axis: part of the range of sizes, in its logarithm
                place = []
                for r in mine:
                    least, most = material.sizes[shape][r.case.kind]
                    place.append(np.log(abs(r.case.faults[0].size) / least) / np.log(most / least))
                order = np.argsort(place)
                groups = np.array_split(order, min(4, len(order)))
                found = np.array([r.detected for r in mine], dtype=np.float64)
                axes.plot(
                    [np.mean(np.array(place)[g]) for g in groups],
                    [np.mean(found[g]) for g in groups],
                    "o-",
                    linewidth=5.0 - 0.5 * number,
                    label=method.title,
                )
            axes.set_title(shape)
            (g0, g1), (a0, a1) = material.sizes[shape]
            axes.set_xticks([0.0, 1.0], [f"{np.degrees(g0):.2g} deg/s\n{a0:.2g} m/s²", f"{np.degrees(g1):.2g} deg/s\n{a1:.2g} m/s²"])
            axes.set_ylim(-0.03, 1.03)
        plots[0].set_ylabel("detected")
        canvas.legend(*plots[-1].get_legend_handles_labels(), loc="outside lower center", ncols=4)

    return Figure(name, title, draw_curves)
