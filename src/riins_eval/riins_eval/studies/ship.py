"""Seed 003, section 3: the ship's federated filter in the platform form, 12 h with outages and gross faults, every structure against the oracle.

Lives here: rows of targets 20 to 25, 29, 30 and 33, `fly`, and `run`.
Does not live here: the simulation (ship_model.py), small and slow faults (ship_faults.py), figures (ship_figures.py), the full strapdown (bench/).
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from riins_core.noise import normal
from riins_core.sensor_errors import ARCMIN
from riins_eval.studies import ship_figures
from riins_eval.studies.rows import Figure, Progress, Row, row
from riins_eval.studies.ship_model import BDS, BEGIN, EPOCHS, GPS, SEED_FAULTS, SIGMA, Fault, Model, Voyage, epoch_of, model, voyage
from riins_fdi.innovation_tests import INNOVATION_TESTS
from riins_federated.aiding import Measurement
from riins_federated.separated_masters import SeparatedMasters
from riins_federated.structure_settings import SolutionSeparation
from riins_federated.structures import FederatedFilter, Gate, Layout, Structure

Array = NDArray[np.float64]

SCORED = 780
"""First epoch that counts: t > 7800 s."""
QUANTITIES = ("position", "velocity", "heading")
PFA = 1e-5
INTEGRITY_RISK = 1e-5
RESETS = (epoch_of(2.0), epoch_of(6.0), epoch_of(10.0))
ALONE, SEPARATED = SolutionSeparation(left_out=0), SolutionSeparation()
LAYOUT = Layout(navigation=tuple(range(7)), heading=6)
GLR = functools.partial(INNOVATION_TESTS["windowed_glr"], epochs=1.0 / PFA, window=30)
"""Over five minutes; its alarm leaves the aid out for as long."""
GATE, OPEN, TESTED_GATE = Gate(PFA), Gate(pfa=None), Gate(PFA, GLR, 30)


@dataclass(frozen=True)
class Flight:
    """One filter on one voyage, from epoch `first`.

    error (m, 17), its covariance P (m, 7, 7) of the navigation states, and for each aid (m, 3): whether there was a measurement, whether it passed,
    whether it was fused, whether the aid was isolated, whether it was only held after an alarm of the further test.
    """

    first: int
    error: Array
    P: Array
    given: NDArray[np.bool_]
    passed: NDArray[np.bool_]
    fused: NDArray[np.bool_]
    isolated: NDArray[np.bool_]
    held: NDArray[np.bool_]
    level: Array
    """(m,), horizontal protection level each minute, m; not a number between, infinite where nothing can be tested"""

    def rms(self, first: int = SCORED) -> Array:
        """RMS of position [m], velocity [m/s] and heading [arcmin] from epoch `first`, (3,)."""
        return rms(self.error[first - self.first :])

    def nees(self) -> float:
        """Mean NEES(7) / 7 of the epochs that count."""
        e, P = self.error[SCORED - self.first :, :7], self.P[SCORED - self.first :]
        return float(np.mean(np.einsum("ki,ki->k", e, np.linalg.solve(P, e[:, :, None])[:, :, 0])) / 7.0)


def rms(error: Array) -> Array:
    """RMS of position [m], velocity [m/s] and heading [arcmin] of errors (m, 17), (3,)."""
    square = np.mean(error**2, axis=0)
    return np.sqrt([square[0] + square[1], square[2] + square[3], square[6] / ARCMIN**2])


def fly(
    structure: Structure, made: Model, given: Voyage, faults: tuple[Fault, ...] = (), *, told: bool = False, outages: bool = True,
    louder: float = 1.0, first: int = BEGIN, last: int = EPOCHS, only: Callable[[int, int], bool] | None = None, weight: float = 1.0,
) -> Flight:  # fmt: skip
    """Run a structure over epochs `first` to `last`.

    Parameters
    ----------
    structure : changed
    made, given : the model and the voyage of one seed
    faults, outages, louder : of the measurements
    told : leave out what a fault spoils
    only : epoch and aid to whether the measurement is used at all
    weight : factor of GPS's R that is told to the filter
    """
    m = last - first
    error, P = np.empty((m, made.Phi.shape[1])), np.empty((m, 7, 7))
    level = np.full(m, np.nan)
    flags = np.zeros((5, m, len(SIGMA)), dtype=np.bool_)
    for k in range(first, last):
        aids = given.measurements(k, faults, outages, louder)
        if told:
            aids = [None if any(f.aid == aid and f.covers(k) for f in faults) else m for aid, m in enumerate(aids)]
        if only is not None:
            aids = [m if only(k, aid) else None for aid, m in enumerate(aids)]
        gps = aids[GPS]
        if weight != 1.0 and gps is not None:
            aids[GPS] = Measurement(gps.z, gps.H, gps.R * weight)
        verdicts = structure.epoch(made.Phi[k], made.Qd[k], aids)
        error[k - first], P[k - first] = structure.x - given.truth[k], structure.P[:7, :7]
        for aid, verdict in enumerate(verdicts):
            if verdict is not None:
                flags[:3, k - first, aid] = True, verdict.passed, verdict.fused
                flags[4, k - first, aid] = verdict.held
        if isinstance(structure, SeparatedMasters):
            flags[3, k - first] = structure.isolated
            if structure.settings.left_out and k % 6 == 0:
                level[k - first] = structure.protection(INTEGRITY_RISK)[0]
    measured, passed, fused, isolated, held = flags
    return Flight(first, error, P, measured, passed, fused, isolated, held, level)


def masters(P: Array, gate: Gate = TESTED_GATE, settings: SolutionSeparation = SEPARATED, adaptive: bool = False) -> SeparatedMasters:
    """The information form that begins with covariance P, with the NIS and the windowed GLR as gates."""
    return SeparatedMasters(np.zeros(len(P)), P, len(SIGMA), settings, layout=LAYOUT, gate=gate, adaptive=adaptive)


INFLUENCES = (
    ("position while GPS is away", 0, (2.0 + 1.0 / 6.0, 3.0)),
    ("velocity while the log is away", 1, (3.0 + 1.0 / 6.0, 4.0)),
    ("velocity while the log lies", 1, (5.0, 5.0 + 1.0 / 12.0)),
    ("position while GPS lies", 0, (9.0, 9.0 + 1.0 / 12.0)),
)
"""What, of `Flight.rms`, between which hours."""
QUIET = (6.0, 9.0)
"""Hours with all aids."""


def influence(flown: Flight) -> Array:
    """RMS in each of `INFLUENCES` over that of the hours with all aids, (4,)."""

    def between(what: int, hours: tuple[float, float]) -> float:
        first, last = (epoch_of(hour) - flown.first for hour in hours)
        return float(rms(flown.error[first:last])[what])

    return np.array([between(what, hours) / between(what, QUIET) for _, what, hours in INFLUENCES])


def federated(P: Array, retention: float, gate: Gate = GATE, sharing: str = "fixed", beta: Array | None = None) -> FederatedFilter:
    """A federated filter that begins with covariance P."""
    return FederatedFilter(np.zeros(len(P)), P, len(SIGMA), retention=retention, gate=gate, sharing=sharing, beta=beta)


STRUCTURES: dict[str, Callable[[Array], Structure]] = {
    "information, leave-one-out masters": masters,
    "centralized, NIS": functools.partial(masters, gate=GATE, settings=ALONE),
    "fusion-reset": functools.partial(federated, retention=0.0),
    "partial feedback, alpha = 0.5": functools.partial(federated, retention=0.5),
    "no-reset": functools.partial(federated, retention=1.0),
}
BEST = "information, leave-one-out masters"
EXACT = (BEST, "centralized, NIS", "fusion-reset")
"""Those that lose nothing."""


def position_reset(made: Model, given: Voyage) -> Array:
    """The INS whose position is set to a fix of BDS at 2, 6 and 10 h, and nothing else: errors (epochs, 17)."""
    error, apart = given.truth.copy(), np.zeros(made.Phi.shape[1])
    for k in range(RESETS[0], EPOCHS):
        apart = made.Phi[k] @ apart
        if k in RESETS:
            apart[:2] += given.noise[k, BDS] - (given.truth[k] + apart)[:2]
        error[k] += apart
    return error


def calibration(made: Model, given: Voyage) -> Array:
    """All that the same three fixes can tell: errors (epochs, 17) of the optimal filter that has nothing else."""
    alone = fly(masters(made.P, OPEN, ALONE), made, given, outages=False, only=lambda k, aid: aid == BDS and k in RESETS)
    return np.concatenate([given.truth[:BEGIN], alone.error])


def _random_shares(seed: int) -> Array:
    beta = np.exp(normal(seed, "shares", 0, 1, len(SIGMA))[0])
    return np.asarray(beta / beta.sum())


def voyages(seeds: int, progress: Progress) -> dict[str, dict[str, list[Array]]]:
    """The seed's voyage, its faults and outages, once for each seed: RMS of each filter, and counts."""
    made = model()
    kinds = ("rms", "nees", "rejected", "faulty", "isolated", "level", "influence")
    out: dict[str, dict[str, list[Array]]] = {name: {kind: [] for kind in kinds} for name in STRUCTURES}
    out |= {name: {"rms": []} for name in ("oracle", "pure INS", "position reset every 4 h (T1)", "calibration from the same fixes (T2)")}
    for seed in range(seeds):
        given = voyage(seed, made)
        out["oracle"]["rms"].append(fly(masters(made.P, OPEN, ALONE), made, given, SEED_FAULTS, told=True).rms())
        out["pure INS"]["rms"].append(rms(given.truth[SCORED:]))
        out["position reset every 4 h (T1)"]["rms"].append(rms(position_reset(made, given)[SCORED:]))
        out["calibration from the same fixes (T2)"]["rms"].append(rms(calibration(made, given)[SCORED:]))
        for i, (name, make) in enumerate(STRUCTURES.items()):
            flown = fly(make(made.P), made, given, SEED_FAULTS)
            faulty = np.zeros_like(flown.given)
            for fault in SEED_FAULTS:
                faulty[fault.first - BEGIN : fault.last - BEGIN, fault.aid] = True
            each = out[name]
            each["rms"].append(flown.rms())
            each["nees"].append(np.array(flown.nees()))
            each["rejected"].append(np.array(np.count_nonzero(flown.given & ~faulty & ~flown.passed & ~flown.held)))
            each["faulty"].append(np.array([np.count_nonzero(faulty), np.count_nonzero(faulty & flown.fused)]))
            off = np.hypot(*flown.error[:, :2].T)[SCORED - BEGIN :]
            level = flown.level[SCORED - BEGIN :]
            some = np.isfinite(level)
            each["level"].append(np.array([some.sum(), (off[some] > level[some]).sum(), level[some].mean() if some.any() else np.nan]))
            each["influence"].append(influence(flown))
            each["isolated"].append(np.array(np.count_nonzero(np.diff(flown.isolated.astype(int), axis=0) > 0)))
            progress((seed + (i + 1) / len(STRUCTURES)) / seeds)
    return out


def riccati() -> Array:
    """RMS that the oracle's covariance predicts over the epochs that count, (3,): position [m], velocity [m/s], heading [arcmin]."""
    made = model()
    P = fly(masters(made.P, OPEN, ALONE), made, voyage(0, made), SEED_FAULTS, told=True).P[SCORED - BEGIN :]
    mean = np.mean(np.diagonal(P, axis1=1, axis2=2), axis=0)
    return np.sqrt([mean[0] + mean[1], mean[2] + mean[3], mean[6] / ARCMIN**2])


def equality(seed: int, last: int = EPOCHS) -> dict[str, tuple[float, float]]:
    """Fusion-reset against the information form without a gate: largest difference of position [m] and heading [arcmin], by shares."""
    made = model()
    given = voyage(seed, made)
    exact = fly(masters(made.P, OPEN, ALONE), made, given, last=last).error
    out = {}
    for name, sharing, beta in (("equal", "fixed", None), ("random", "fixed", _random_shares(seed)), ("by innovations", "innovation", None)):
        apart = np.abs(fly(federated(made.P, 0.0, OPEN, sharing, beta), made, given, last=last).error - exact)
        out[name] = float(np.hypot(apart[:, 0], apart[:, 1]).max()), float(apart[:, 6].max() / ARCMIN)
    return out


def louder_gps(seed: int, last: int = EPOCHS) -> dict[str, float]:
    """Position RMS / that of the filter that knows, GPS noise three times what is told, no outage."""
    made = model()
    given = voyage(seed, made)
    flights = {
        "knows": fly(masters(made.P, Gate(PFA), ALONE), made, given, outages=False, louder=3.0, weight=9.0, last=last),
        "adaptive R": fly(masters(made.P, Gate(PFA), ALONE, True), made, given, outages=False, louder=3.0, last=last),
        "fixed R": fly(masters(made.P, Gate(PFA), ALONE), made, given, outages=False, louder=3.0, last=last),
        "no-reset, equal shares": fly(federated(made.P, 1.0), made, given, outages=False, louder=3.0, last=last),
        "no-reset, shares by innovations": fly(federated(made.P, 1.0, sharing="innovation"), made, given, outages=False, louder=3.0, last=last),
    }
    known = flights.pop("knows").rms()[0]
    return {name: float(flown.rms()[0] / known) for name, flown in flights.items()}


def run(seeds: int, quick: bool, progress: Progress) -> tuple[Sequence[Row], Sequence[Figure]]:
    """Rows and figures of the voyage; with `quick` no figures and one seed for target 33."""
    flown = voyages(seeds, lambda part: progress(0.75 * part))
    rows = _ratios(flown) + _counts(flown)
    apart = [equality(seed) for seed in range(min(seeds, 1 if quick else 3))]
    for name in apart[0]:
        metres, arcmin = np.array([one[name] for one in apart]).T
        rows.append(row(29, f"fusion-reset against the information form, shares {name}, m", metres, ok=lambda r: r.p95 < 1e-3))
        rows.append(row(29, f"the same, heading, shares {name}, arcmin", arcmin, ok=lambda r: r.p95 < 1e-4))
    progress(0.8)
    louder: list[dict[str, float]] = []
    for seed in range(1 if quick else min(seeds, 20)):
        louder.append(louder_gps(seed))
        progress(0.8 + 0.18 * (seed + 1) / min(seeds, 20))
    for name in louder[0]:
        aimed = name == "adaptive R"
        rows.append(
            row(
                33 if aimed else None, f"GPS noise tripled, untold: position RMS / the filter that knows, {name}", [one[name] for one in louder],
                ok=(lambda r: r.value <= 1.15) if aimed else None,
                remark="004: adaptive shares change next to nothing" if "innovations" in name else "",
            )
        )  # fmt: skip
    return rows, [] if quick else ship_figures.voyage_figures()


def _ratios(flown: dict[str, dict[str, list[Array]]]) -> list[Row]:
    oracle = np.array(flown["oracle"]["rms"])
    predicted = riccati()
    limits = dict.fromkeys(EXACT, (20, (1.01, 1.01, 1.02))) | {"no-reset": (21, (1.10, 1.05, 1.15))}
    rows = []
    for name in STRUCTURES:
        target, most = limits.get(name, (None, (np.inf,) * 3))
        for i, what in enumerate(QUANTITIES):
            ratio = np.array(flown[name]["rms"])[:, i] / oracle[:, i]
            demand = None if target is None else functools.partial(_most, most[i])
            rows.append(row(target, f"{name}: {what} RMS / oracle", ratio, ok=demand))
    for i, (what, low, high) in enumerate((("position, m", 0.92, 1.09), ("velocity, m/s", 0.95, 1.05), ("heading, arcmin", 0.6, 1.6))):
        values = np.array(flown[BEST]["rms"])[:, i]
        rows.append(row(None, f"{BEST}: RMS of {what}", values))
        rows.append(row(22, f"the same / Riccati ({predicted[i]:.4g})", values / predicted[i], ok=functools.partial(_between, low, high)))
    for name in ("pure INS", "position reset every 4 h (T1)", "calibration from the same fixes (T2)"):
        values = np.array(flown[name]["rms"])
        for i, (what, least) in enumerate(zip(QUANTITIES, (100.0, 10.0, 1.3), strict=True)):
            fused = np.array(flown[BEST]["rms"])[:, i]
            pooled = functools.partial(_pooled, values[:, i], fused)
            reset = name.endswith("(T1)")
            rows.append(
                row(
                    30 if reset else None, f"{name}: {what} RMS / {BEST}, over all seeds", values[:, i] / fused, paper="better" if reset else None,
                    ok=functools.partial(_least, least) if reset else None, centre=pooled,
                )
            )  # fmt: skip
    return rows


def _counts(flown: dict[str, dict[str, list[Array]]]) -> list[Row]:
    rows = []
    for name in STRUCTURES:
        each = flown[name]
        exact = name in EXACT
        rows.append(row(23 if exact else None, f"{name}: NEES(7) / 7", each["nees"], ok=functools.partial(_between, 0.80, 1.35) if exact else None))
        rows.append(
            row(24 if exact else None, f"{name}: good epochs rejected in 12 h", each["rejected"], ok=functools.partial(_most, 0.6) if exact else None)
        )
        faulty = np.array(each["faulty"])
        rows.append(row(25, f"{name}: faulty epochs fused, of {faulty[:, 0].sum()}", faulty[:, 1], ok=functools.partial(_most, 0.0)))
    level = np.array(flown[BEST]["level"])
    for i, (words, _, _) in enumerate(INFLUENCES):
        values = np.array(flown[BEST]["influence"])[:, i]
        remark = "" if "lies" in words else "an aid that is missing is missed: what is left knows less, and says so"
        rows.append(row(None, f"{BEST}: {words}, RMS over that with all aids", values, paper="no influence", centre=np.median, remark=remark))
    rows.append(row(None, f"{BEST}: mean horizontal protection level at risk {INTEGRITY_RISK:g}, m", level[:, 2]))
    rows.append(row(None, f"{BEST}: errors above it, of {level[:, 0].sum():.0f}", level[:, 1], ok=lambda r: r.value == 0.0))
    rows.append(row(None, f"{BEST}: isolations by separation in 12 h", flown[BEST]["isolated"], remark="no fault of this voyage needs one"))
    return rows


def _pooled(one: Array, other: Array, _: Array) -> float:
    return float(np.sqrt(np.mean(one**2) / np.mean(other**2)))


def _most(limit: float, made: Row) -> bool:
    return made.value <= limit


def _least(limit: float, made: Row) -> bool:
    return made.value >= limit


def _between(low: float, high: float, made: Row) -> bool:
    return low <= made.value <= high
