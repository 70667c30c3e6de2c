"""The experiments of thesis chapters 5 (fusion: WLS, OPT, AOPT, FDI, OPTDC) and 6 (navigation: WLS.NA, PO.NA, IPO.NA), targets 10-14.

Lives here: `run`, one function for each experiment's numbers of one seed, the rows with the thesis' values beside them.
Does not live here: the flight and the sensors (thesis_flight.py), the figures (thesis_fusion_figures.py), methods and schemes.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from riins_core import ins_error
from riins_core.noise import normal
from riins_federated.schemes import NavigationScheme
from riins_imu_fusion.method import Fused, TriadModel
from riins_imu_fusion.methods import make
from riins_imu_fusion.noise_estimation import NoiseEstimator

from .rows import Figure, Progress, Row, row
from .thesis_flight import (
    ARRAY,
    DT,
    HEALTHY,
    KINDS,
    R_PRINTED,
    RATE_HZ,
    TOLD,
    UNTOLD,
    Experiment,
    flight,
    navigate,
    position_error,
    readings,
)  # fmt: skip

Array = NDArray[np.float64]

_GOOD = (0b111010, 0b101110)
"""Gyros and accelerometers that table 5.2 leaves healthy."""
_EVERY = (0b111111, 0b111111)
FIX_S = 150.0
_OUTAGE_S = 200.0
WAYS = ("one exact fix", "fixes at 1 Hz", "fixes at 1 Hz until 200 s")
"""The three ways "external information is effective at 150 s" can be read."""
_EXACT = np.array([1e-3] * 3 + [1e-4] * 3 + [1e-8] * 3)
_AID = np.array([3.0] * 3 + [0.05] * 3 + [math.inf] * 3)
_ALS_EPOCHS = 5000


def models(experiment: Experiment, noise: tuple[float, float] = R_PRINTED) -> tuple[TriadModel, TriadModel]:
    """What the filters are told of gyros and accelerometers; R is that of all sensors alike, as in (5-108)."""
    made = [TriadModel(ARRAY, math.sqrt(noise[k]), np.sqrt(experiment.P[k]), np.sqrt(experiment.Q[k]), DT) for k in range(2)]
    return made[0], made[1]


def fuse(name: str, experiment: Experiment, z: tuple[Array, Array], masks: tuple[int, int] = _EVERY) -> tuple[Fused, Fused]:
    """Both triads by one method."""
    gyro, accel = (make(name, model).process(z[k], masks[k]) for k, model in enumerate(models(experiment)))
    return gyro, accel


def horizontal(error: Array) -> Array:
    """Length of the horizontal part of errors NED (..., 3)."""
    return np.asarray(np.hypot(error[..., 0], error[..., 1]))


def fly(fused: tuple[Fused, Fused]) -> Array:
    """Position errors NED (m, 3), m, of the flight navigated with two fused triads."""
    return position_error(navigate(flight().start, fused[0].x, fused[1].x))


def _final(name: str, experiment: Experiment, z: tuple[Array, Array], masks: tuple[int, int] = _EVERY) -> float:
    return float(horizontal(fly(fuse(name, experiment, z, masks))[-1]))


_ZERO = np.zeros((2, 6))
_ALIKE = np.ones((2, 6)) * [[1e-12], [1e-6]]
_EQUAL = dataclasses.replace(UNTOLD, P=_ALIKE)
_NO_WALK = dataclasses.replace(UNTOLD, P=_ALIKE, Q=_ZERO)
_NO_WALK_PRINTED = dataclasses.replace(UNTOLD, Q=_ZERO)
_LEVEL = dataclasses.replace(UNTOLD, P=np.ones((2, 6)) * [[2.4e-17], [9.6e-7]])
"""The P of (5-114) without what it tells: there gyros 1 and 3 have 9.4e-17."""
_WRONG = dataclasses.replace(TOLD, P=np.roll(TOLD.P, 1, axis=1), Q=np.roll(TOLD.Q, 1, axis=1))


def chapter_5(seed: int) -> dict[str, float]:
    """Numbers of the five experiments for one seed; lengths in m."""
    bad, good = readings(TOLD, seed), readings(HEALTHY, seed)
    wls, healthy = _final("wls", TOLD, bad), _final("wls", HEALTHY, good)
    made = {"wls": wls, "healthy": healthy, "optdc_healthy": _final("optdc", HEALTHY, good) / healthy}
    for key, name, told in (
        ("opt", "opt", TOLD), ("optdc", "optdc", TOLD), ("opt_untold", "opt", UNTOLD), ("opt_equal", "opt", _EQUAL), ("opt_still", "opt", _NO_WALK),
        ("opt_still_printed", "opt", _NO_WALK_PRINTED), ("opt_wrong", "opt", _WRONG), ("aopt", "aopt", UNTOLD),
        ("aopt_level", "aopt", _LEVEL),
    ):  # fmt: skip
        made[key] = _final(name, told, bad) / wls
    made["fdi"] = _final("wls", TOLD, bad, _GOOD) / wls
    # fault-induced error in the body frame, a number without the geometry of the flight: accelerometers in m/s^2 over that of WLS
    path = flight()
    common = np.full(6, HEALTHY.drift[1, 0]) @ ARRAY.least_squares().T
    aopt, plain = (np.mean(fuse(name, UNTOLD, bad)[1].x - path.force, axis=0) - common for name in ("aopt", "wls"))
    made["aopt_body"] = float(np.linalg.norm(aopt) / np.linalg.norm(plain))
    return made


def measured(seed: int, number: int, k: int) -> Array:
    """External information of way 2 and 3, fix `number`, after sample k: a navigation state off by 3 m and 0.05 m/s."""
    nav = flight().nav[k].copy()
    off = np.zeros(9)
    off[:6] = _AID[:6] * normal(seed, "thesis/aid", number, 1, 6)[0]
    ins_error.correct(nav, off)
    return nav


def fly_scheme(name: str, experiment: Experiment, seed: int, ways: tuple[int, ...] = (0, 1, 2)) -> list[tuple[Array, Array, Array]]:
    """Navigate by a scheme of chapter 6: for each way position errors (m, 3), rates (m, 3), forces (m, 3)."""
    path, z = flight(), readings(experiment, seed)
    first, m, second = round(FIX_S * RATE_HZ), len(path.t), round(RATE_HZ)
    scheme = NavigationScheme(name, path.start, *models(experiment))
    before = scheme.process(z[0][:first], z[1][:first])
    made = []
    for way in ways:
        branch, parts = scheme.copy(), [before]
        for number, k in enumerate(range(first, m, second)):
            if way == 0 and k == first:
                branch.fix(path.nav[k - 1], _EXACT)
            elif way == 1 or (way == 2 and k * DT < _OUTAGE_S - 0.5 * DT):
                branch.fix(measured(seed, number, k - 1), _AID)
            parts.append(branch.process(z[0][k : k + second], z[1][k : k + second]))
        nav, rate, force = (np.concatenate(column) for column in zip(*parts, strict=True))
        made.append((position_error(nav), rate, force))
    return made


_CHAPTER_6 = (
    (HEALTHY, ("wls_na", "po_na")),
    (TOLD, ("wls_na", "po_na", "wls_na_without_parity")),
    (UNTOLD, ("wls_na", "po_na", "ipo_na")),
)
"""Experiments 1, 2, and 3 with 4: sensors, and the schemes flown."""


def chapter_6(seed: int) -> dict[str, float]:
    """Numbers of the four experiments for one seed: horizontal RMS after the fix, by way, and before it; m."""
    made = {}
    first = round(FIX_S * RATE_HZ)
    for number, (experiment, names) in enumerate(_CHAPTER_6, start=1):
        for name in names:
            for way, (error, _, _) in enumerate(fly_scheme(name, experiment, seed)):
                h = horizontal(error)
                made[f"{number} {name} {way}"] = float(np.sqrt(np.mean(h[first:] ** 2)))
            made[f"{number} {name} before"] = float(np.sqrt(np.mean(h[:first] ** 2)))
            made[f"{number} {name} at"] = float(h[first - 1])
    return made


def noise_estimates(seed: int) -> dict[str, Array]:
    """ALS on random-walk drifts of the printed Q and R: estimate over truth, (2, 6), (2,); on the constant drifts of table 5.2: Q over printed Q."""
    walk, white, still = np.empty((2, 6)), np.empty(2), np.empty((2, 6))
    for kind in range(2):
        q, r = TOLD.Q[kind], R_PRINTED[kind]
        steps = normal(seed, f"als/{KINDS[kind]}/walk", 0, _ALS_EPOCHS, 6)
        noise = normal(seed, f"als/{KINDS[kind]}/white", 0, _ALS_EPOCHS, 6)
        estimator = NoiseEstimator(ARRAY, lags=10, gain=0.7)
        estimator.process(np.cumsum(np.sqrt(q) * steps, axis=0) + math.sqrt(r) * noise)
        estimate = estimator.estimate()
        walk[kind], white[kind] = estimate.Q / q, estimate.R[0] / r
        estimator = NoiseEstimator(ARRAY, lags=10, gain=0.1)
        estimator.process(TOLD.drift[kind] + math.sqrt(r) * noise)
        still[kind] = estimator.estimate().Q / q
    return {"walk": walk, "white": white, "still": still}


def rows_5(made: list[dict[str, float]]) -> list[Row]:
    """Rows of chapter 5, one dictionary a seed."""

    def of(key: str) -> list[float]:
        return [one[key] for one in made]

    def below(limit: float) -> Callable[[Row], bool]:
        return lambda one: one.p95 <= limit

    oracle = "OPT is an oracle: its P and Q name the bad sensors"
    return [
        row(None, "exp. 1: WLS, final horizontal error [m]", of("wls"), paper=154.6, remark="speed and turn rates of that flight are not known"),
        row(10, "exp. 1: OPT told P and Q / WLS, final horizontal error", of("opt"), paper=0.40, ok=below(0.42), remark=oracle),
        row(None, "exp. 1: OPT told the wrong sensors / WLS", of("opt_wrong"), remark="each mark moved to the next sensor: it loses to WLS"),
        row(11, "exp. 2: OPT with equal Q and the printed P / WLS", of("opt_untold"), paper=1.00, ok=lambda one: 0.98 <= one.p05 <= one.p95 <= 1.02),
        row(11, "exp. 2: OPT with equal Q and equal P / WLS", of("opt_equal"), ok=lambda one: max(abs(one.p05 - 1.0), abs(one.p95 - 1.0)) < 1e-6),
        row(11, "exp. 2: OPT with Q = 0 and equal P / WLS", of("opt_still"), ok=lambda one: max(abs(one.p05 - 1.0), abs(one.p95 - 1.0)) < 1e-6),
        row(None, "exp. 2: OPT with Q = 0 and the printed P / WLS", of("opt_still_printed"), remark="the printed P is not equal: 8.6 and 9.6e-7"),
        row(
            12, "exp. 3: AOPT / WLS, final horizontal error", of("aopt"), paper=0.51, ok=below(0.80),
            remark="the spread is that of the first samples; the printed P gives gyros 1 and 3 four times the variance of the others",
        ),
        row(
            None, "exp. 3: AOPT with equal P / WLS, final horizontal error", of("aopt_level"),
            remark="AOPT's advantage is what the printed P gives away: told nothing, it is least squares but for a few per cent",
        ),
        row(
            None, "exp. 3: AOPT / WLS, fault-induced force error in the body", of("aopt_body"),
            remark="accelerometers only, whose printed P tells nothing: no gain",
        ),
        row(
            10, "exp. 4: OPTDC told P and Q / WLS, final horizontal error", of("optdc"), paper=0.34, ok=below(0.42),
            remark='equal to OPT to rounding for any feedback gain: "OPTDC is more accurate than OPT" does not hold',
        ),
        row(
            None, "exp. 4: FDI (the right four sensors of each kind) / WLS", of("fdi"), paper=0.80,
            remark="isolation that errs never; what is left is the 100 ug common to all and the poorer geometry",
        ),
        row(None, "exp. 5: WLS without faults, final horizontal error [m]", of("healthy"), paper=43.7),
        row(None, "exp. 5: OPTDC / WLS without faults", of("optdc_healthy"), paper=0.98, ok=lambda one: 0.95 <= one.p05 <= one.p95 <= 1.05),
    ]  # fmt: skip


def rows_6(made: list[dict[str, float]]) -> list[Row]:
    """Rows of chapter 6, one dictionary a seed."""

    def of(above: str, below: str) -> Array:
        return np.array([one[above] / one[below] for one in made])

    rows = []
    paper = {1: 1.00, 2: 0.06, 3: 1.00}
    for number in (1, 2, 3):
        for way in range(3):
            remark = "the printed advantage needs a WLS.NA that drops its parity rows" if number == 2 else ""
            rows.append(
                row(
                    13, f"exp. {number}: PO.NA / WLS.NA after 150 s, {WAYS[way]}", of(f"{number} po_na {way}", f"{number} wls_na {way}"),
                    paper=paper[number], ok=lambda one: 0.95 <= one.p05 <= one.p95 <= 1.05, remark=remark,
                )
            )  # fmt: skip
    rows.append(
        row(
            13, "exp. 2: PO.NA / WLS.NA without parity rows, at 150 s", of("2 po_na at", "2 wls_na_without_parity at"), paper=0.06,
            ok=lambda one: one.p95 <= 0.60, remark="the thesis compares the end of the flight, where 74 m cannot be after an exact fix at 150 s",
        )
    )  # fmt: skip
    for way in range(3):
        rows.append(
            row(
                None, f"exp. 4: IPO.NA / PO.NA after 150 s, {WAYS[way]}", of(f"3 ipo_na {way}", f"3 po_na {way}"), paper=0.45,
                remark="the estimated Q is about 0, the printed one a walk of 55 deg/h in 150 s: a physical Q remembers what the fix taught",
            )
        )  # fmt: skip
    rows.append(
        row(
            None, "exp. 4: IPO.NA / PO.NA before 150 s", of("3 ipo_na before", "3 po_na before"),
            remark="on constant drifts the right Q is about 0, and equal Q is WLS: no gain before the fix can come from noise estimation",
        )
    )  # fmt: skip
    return rows


def rows_als(made: list[dict[str, Array]]) -> list[Row]:
    """Rows of the noise estimation, one dictionary a seed."""
    walk, white, still = (np.array([one[key] for one in made]) for key in ("walk", "white", "still"))
    rows = []
    for kind, bad in ((0, (0, 2)), (1, (0, 4))):
        for i in bad:
            name = f"ALS: Q of {KINDS[kind]} {i + 1} / true, random walk, {_ALS_EPOCHS} epochs"
            rows.append(row(14, name, walk[:, kind, i], ok=lambda one: 0.75 <= one.p05 <= one.p95 <= 1.25))
        rows.append(row(14, f"ALS: R of the {KINDS[kind]}s / true", white[:, kind], ok=lambda one: 0.5 <= one.p05 <= one.p95 <= 2.0))
        rows.append(
            row(
                None, f"ALS: largest Q of the {KINDS[kind]}s on the constant drifts of table 5.2 / printed Q", still[:, kind].max(axis=1),
                remark="a constant drift is no process noise",
            )
        )  # fmt: skip
    return rows


def run(seeds: int, quick: bool, progress: Progress) -> tuple[list[Row], list[Figure]]:
    """All experiments of chapters 5 and 6.

    Parameters
    ----------
    seeds : of the noise
    quick : at most 5 seeds
    progress : told the part that is done
    """
    from .thesis_fusion_figures import figures

    seeds = min(seeds, 5) if quick else seeds
    five: list[dict[str, float]] = []
    six: list[dict[str, float]] = []
    als: list[dict[str, Array]] = []
    for seed in range(seeds):
        five.append(chapter_5(seed))
        als.append(noise_estimates(seed))
        six.append(chapter_6(seed))
        progress((seed + 1) / (seeds + 1))
    drawn = figures()
    progress(1.0)
    return rows_5(five) + rows_6(six) + rows_als(als), drawn
