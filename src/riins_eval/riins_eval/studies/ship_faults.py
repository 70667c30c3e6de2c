"""Small and slow faults of GPS on the ship of seed 003, for every structure and test, against the fault-free twin; and faults drawn at random.

Lives here: rows of targets 26 to 28, the table of steps and ramps, a thousand drawn faults, and `run`.
Does not live here: the simulation (ship_model.py), the seed's own voyage (ship.py), figures (ship_figures.py).
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from riins_core.noise import normal
from riins_eval.studies import ship_figures
from riins_eval.studies.rows import Figure, Progress, Row, row
from riins_eval.studies.ship import ALONE, BEST, GATE, PFA, Flight, federated, fly, masters
from riins_eval.studies.ship_model import BDS, BEGIN, EPOCHS, GPS, PERIOD, SIGMA, Fault, epoch_of, model, voyage
from riins_fdi.eraim import cross_check
from riins_fdi.innovation_tests import INNOVATION_TESTS
from riins_federated.structures import Gate, Structure

Array = NDArray[np.float64]

ONSET = epoch_of(4.5)
LASTS, SHORT, LATER = 90, 30, 120
"""Epochs: a fault lasts 15 minutes, those of target 26 five as the seed's own; 20 minutes later the deviation from the twin is read."""
STEPS = (60.0, 100.0, 150.0, 300.0)
RAMPS = (0.05, 0.1, 0.2, 0.5, 1.0)
HELD = 30
DRAWS, QUICK_DRAWS = 1000, 60
KINDS = ("step", "ramp")
TOO_LARGE = 8.0
"""Sigma of the innovation above which no epoch may be fused."""


def _tested(name: str) -> Callable[[Array], Structure]:
    return lambda P: masters(P, Gate(PFA, functools.partial(INNOVATION_TESTS[name], epochs=1.0 / PFA), HELD), ALONE)


TESTED: dict[str, Callable[[Array], Structure]] = {
    BEST: masters,
    "leave-one-out masters, NIS without GLR": lambda P: masters(P, GATE),
    "information form, NIS": lambda P: masters(P, GATE, ALONE),
    "no-reset, NIS": lambda P: federated(P, 1.0),
    "fusion-reset, NIS": lambda P: federated(P, 0.0),
    "partial feedback, alpha = 0.5, NIS": lambda P: federated(P, 0.5),
} | {f"information form, NIS and {name}": _tested(name) for name in ("improved", "averaged", "mewma", "cusum", "windowed_glr")}


class Outcome(NamedTuple):
    """What a fault did: delay until it was found [s] (infinite: not while it lasted), epochs fused, largest deviation from the twin [m], the same 20
    minutes after its end."""

    delay: float
    fused: int
    shift: float
    later: float


def faults() -> dict[str, Fault]:
    """The table: steps [m] and ramps [m/s] of GPS to the north."""
    made = {f"step {size:g} m": Fault(GPS, ONSET, ONSET + LASTS, step=(size, 0.0)) for size in STEPS}
    made |= {f"{label}, 5 min": fault._replace(last=ONSET + SHORT) for label, fault in made.items() if fault.step[0] >= 150.0}
    return made | {f"ramp {slope:g} m/s": Fault(GPS, ONSET, ONSET + LASTS, slope=(slope, 0.0)) for slope in RAMPS}


def outcome(flown: Flight, twin: Flight, fault: Fault) -> Outcome:
    """Compare a flight with its fault-free twin. Found: isolated, or rejected; three times in a row where the fault is slow."""
    during = slice(fault.first - flown.first, fault.last - flown.first)
    out = ~flown.passed[during, fault.aid] & flown.given[during, fault.aid]
    needed = 3 if any(fault.slope) else 1
    runs = np.convolve(out, np.ones(needed, dtype=int), "valid") == needed
    seen = flown.isolated[during, fault.aid].copy()
    seen[needed - 1 :] |= runs
    apart = np.hypot(*(flown.error - twin.error)[:, :2].T)
    delay = (int(seen.argmax()) + 1) * PERIOD if seen.any() else np.inf
    return Outcome(delay, int(np.count_nonzero(flown.fused[during, fault.aid])), float(apart.max()), float(apart[-1]))


def table(seed: int, names: Sequence[str], which: dict[str, Fault]) -> dict[str, dict[str, Outcome]]:
    """Every fault on every structure, one seed; all begin from the same flight to the onset."""
    made = model()
    given = voyage(seed, made)
    out: dict[str, dict[str, Outcome]] = {}
    last = ONSET + LASTS + LATER
    for name in names:
        before = TESTED[name](made.P)
        fly(before, made, given, outages=False, last=ONSET)
        twin = fly(before.clone(), made, given, outages=False, first=ONSET, last=last)
        out[name] = {}
        for label, fault in which.items():
            out[name][label] = outcome(fly(before.clone(), made, given, (fault,), outages=False, first=ONSET, last=last), twin, fault)
    return out


def cross_checked(seed: int, which: dict[str, Fault]) -> dict[str, float]:
    """GPS against BDS without any filter: delay [s] until they contradict each other while a fault lasts; infinite: they do not."""
    given, R = voyage(seed, model()), [sigma**2 * np.eye(2) for sigma in SIGMA[:2]]
    out = {}
    for label, fault in which.items():
        out[label] = np.inf
        for k in range(fault.first, fault.last):
            gps, bds = given.measurements(k, (fault,), outages=False)[:2]
            assert gps is not None and bds is not None
            if cross_check(gps.z, R[GPS], bds.z, R[BDS], PFA)[2]:
                out[label] = float((k - fault.first + 1) * PERIOD)
                break
    return out


def pulled_together(seed: int, slope: float) -> tuple[str, float]:
    """GPS and BDS drawn north alike, m/s: which aid the default structure isolates first, and the largest shift [m]."""
    made = model()
    given = voyage(seed, made)
    before = masters(made.P)
    fly(before, made, given, outages=False, last=ONSET)
    both = tuple(Fault(aid, ONSET, ONSET + LASTS, slope=(slope, 0.0)) for aid in (GPS, BDS))
    twin = fly(before.clone(), made, given, outages=False, first=ONSET, last=ONSET + LASTS)
    flown = fly(before.clone(), made, given, both, outages=False, first=ONSET, last=ONSET + LASTS)
    first = np.where(flown.isolated.any(axis=0), flown.isolated.argmax(axis=0), EPOCHS)
    named = ("GPS", "BDS", "log")[int(first.argmin())] if first.min() < EPOCHS else "none"
    return named, float(np.hypot(*(flown.error - twin.error)[:, :2].T).max())


class Drawn(NamedTuple):
    """One fault drawn at random: kind, aid, largest size in sigma of the innovation, deviation from the twin [m], epochs fused above 8 sigma."""

    kind: int
    aid: int
    size: float
    shift: float
    fused: int


def _draw(number: int, aid_sigma: Array, first: int) -> tuple[int, float, Fault]:
    """Kind, size in sigma, fault; from uniform numbers addressed by the draw."""
    u = (np.argsort(np.argsort(normal(1, f"fault {number}", 0, 1, 64)[0]))[:5] + 0.5) / 64.0
    kind, aid = int(u[0] * len(KINDS)), int(u[1] * len(SIGMA))
    size = 3.0 * (1000.0 / 3.0) ** u[2]
    lasts = 3 + int(u[3] * 57)
    axis = int(u[4] * 2)
    vector = tuple(float(size * aid_sigma[aid] * (i == axis)) for i in range(2))
    rate = tuple(v / (lasts * PERIOD) for v in vector)
    return kind, size, Fault(aid, first, first + lasts, step=vector if kind == 0 else (0.0, 0.0), slope=rate if kind else (0.0, 0.0))  # type: ignore[arg-type]


def drawn(draws: int, progress: Progress) -> list[Drawn]:
    """Faults of random kind, size (3 to 1000 sigma, log-uniform), aid, axis and duration, on the default structure; ten onsets a voyage."""
    made = model()
    out: list[Drawn] = []
    sigma = np.array(SIGMA)
    onsets = np.linspace(epoch_of(3.0), EPOCHS - 100, 10).astype(int)
    per_voyage = max(1, min(draws, 200) // len(onsets)) * len(onsets)
    for seed in range(-(-draws // per_voyage)):
        given = voyage(1000 + seed, made)
        structure: Structure = masters(made.P)
        at = BEGIN
        for onset in onsets:
            fly(structure, made, given, outages=False, first=at, last=int(onset))
            at = int(onset)
            last = at + 90
            twin = fly(structure.clone(), made, given, outages=False, first=at, last=last)
            S = [np.sqrt(structure.P[rows, rows] + s * s) for rows, s in zip((0, 0, 2), sigma, strict=True)]
            for _ in range(per_voyage // len(onsets)):
                if len(out) == draws:
                    break
                kind, size, fault = _draw(len(out), np.array(S), at)
                flown = fly(structure.clone(), made, given, (fault,), outages=False, first=at, last=last)
                apart = np.hypot(*(flown.error - twin.error)[:, :2].T)
                large = np.array([fault.covers(k) and np.abs(fault.at(k)).max() > TOO_LARGE * S[fault.aid] for k in range(at, last)])
                out.append(Drawn(kind, fault.aid, size, float(apart.max()), int(np.count_nonzero(flown.fused[large, fault.aid]))))
            progress(len(out) / draws)
    return out


def run(seeds: int, quick: bool, progress: Progress) -> tuple[Sequence[Row], Sequence[Figure]]:
    """Rows and figures; with `quick` fewer tests, faults and draws, and no figures."""
    names = list(TESTED)[:4] if quick else list(TESTED)
    labels = ("step 150 m, 5 min", "step 300 m, 5 min", "ramp 0.2 m/s", "ramp 1 m/s") if quick else tuple(faults())
    which = {label: fault for label, fault in faults().items() if label in labels}
    made: list[dict[str, dict[str, Outcome]]] = []
    for seed in range(seeds):
        made.append(table(seed, names, which))
        progress(0.75 * (seed + 1) / seeds)
    checked = [cross_checked(seed, which) for seed in range(seeds)]
    rows = _targets([one[BEST] for one in made])
    for label in which:
        for name in names:
            each = [one[name][label] for one in made]
            late = np.array([o.delay for o in each])
            part = np.isfinite(late).mean()
            after = f"after {late[np.isfinite(late)].mean():.0f} s" if part else "never"
            rows.append(row(None, f"{label}: {name}: largest shift, m", [o.shift for o in each], remark=f"found while it lasts: {part:.0%}, {after}"))
        late = np.array([one[label] for one in checked])
        after = f"after {late[np.isfinite(late)].mean():.0f} s; " if np.isfinite(late).any() else ""
        remark = f"{after}it tells that one of the two lies, not which, and keeps nothing out"
        rows.append(row(None, f"{label}: GPS against BDS, no filter: found while it lasts", np.isfinite(late), remark=remark))
    for slope in (0.2, 1.0):
        both = [pulled_together(seed, slope) for seed in range(seeds)]
        named = ", ".join(f"{name} {sum(b[0] == name for b in both)}" for name in ("log", "GPS", "BDS", "none"))
        remark = f"isolated first, of {seeds}: {named}. Two systems that lie alike against the log and the INS: not kept out"
        rows.append(row(None, f"GPS and BDS pulled together {slope:g} m/s: largest shift in 15 min, m", [b[1] for b in both], remark=remark))
    draws = drawn(QUICK_DRAWS if quick else DRAWS, lambda part: progress(0.75 + 0.25 * part))
    rows.append(row(None, f"{len(draws)} drawn faults: epochs above 8 sigma that were fused", [d.fused for d in draws], ok=lambda r: r.value == 0.0))
    rows.append(row(None, "the same: largest shift, m", [d.shift for d in draws], remark=_worst(draws)))
    return rows, [] if quick else ship_figures.fault_figures(made, draws)


def _worst(draws: Sequence[Drawn]) -> str:
    worst = max(draws, key=lambda d: d.shift)
    return f"worst {worst.shift:.1f} m: a {KINDS[worst.kind]} of {worst.size:.1f} sigma on {('GPS', 'BDS', 'the log')[worst.aid]}"


def _targets(best: Sequence[dict[str, Outcome]]) -> list[Row]:
    def values(label: str, what: str) -> Array:
        return np.array([getattr(one[label], what) for one in best], dtype=float)

    def most(limit: float) -> Callable[[Row], bool]:
        return lambda r: r.value <= limit

    def found(label: str, within: float) -> Array:
        return np.asarray(values(label, "delay") <= within, dtype=float)

    rows = [
        row(26, "GPS step 300 m, 5 min: faulty epochs fused", values("step 300 m, 5 min", "fused"), ok=most(0.0)),
        row(26, "GPS step 300 m, 5 min: largest shift, m", values("step 300 m, 5 min", "shift"), ok=most(15.0)),
        row(26, "GPS step 150 m, 5 min: found within 3 epochs", found("step 150 m, 5 min", 30.0), ok=lambda r: r.value >= 0.95),
        row(26, "GPS step 150 m, 5 min: largest shift, m", values("step 150 m, 5 min", "shift"), ok=most(25.0)),
        row(27, "GPS ramp 1 m/s: found after, s", values("ramp 1 m/s", "delay"), ok=most(180.0)),
        row(27, "GPS ramp 1 m/s: largest shift, m", values("ramp 1 m/s", "shift"), ok=most(60.0)),
        row(27, "GPS ramp 1 m/s: shift 20 min later, m", values("ramp 1 m/s", "later"), ok=most(2.0)),
        row(28, "GPS ramp 0.2 m/s: found in 15 min", found("ramp 0.2 m/s", 900.0), ok=lambda r: r.value >= 0.95),
        row(28, "GPS ramp 0.2 m/s: largest shift, m", values("ramp 0.2 m/s", "shift"), ok=most(80.0)),
        row(28, "GPS ramp 0.2 m/s: shift 20 min later, m", values("ramp 0.2 m/s", "later"), ok=most(2.0)),
    ]
    return rows
