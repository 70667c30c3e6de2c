"""Seed 002: SINS, GPS, Doppler and star sensor on an aircraft, 20 minutes, as a linear simulation of the errors; its faults and its claims.

Lives here: trajectory, tables 1 and 2, rows of targets 42 and 43, `run`.
Does not live here: the structures (riins_federated), the INS error model (riins_core.ins_error), the ship (ship.py).
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from riins_core.earth import earth_rate_n, gravity, radii, transport_rate_n
from riins_core.ins_error import error_dynamics
from riins_core.noise import normal
from riins_core.rotation import dcm_from_euler, skew
from riins_core.sensor_errors import ARCSEC, DEG_PER_H, DEG_PER_SQRT_H, MICRO_G, PPM
from riins_eval.studies.rows import Figure, Progress, Row, row
from riins_fdi.innovation import nis_threshold
from riins_federated.aiding import Measurement
from riins_federated.separated_masters import SeparatedMasters
from riins_federated.structure_settings import SolutionSeparation
from riins_federated.structures import FederatedFilter, Gate, Structure

Array = NDArray[np.float64]

SECONDS = 1200
N = 36
"""15 of the INS, 3 of correlated gyro drift, 6 scale factors (002 (36)); 6 of GPS (39), 3 of the Doppler and its 3 scale factors (41)."""
DRIFT, SCALE_G, SCALE_A, GPS_STATES, DVS_STATES, DVS_SCALE = slice(15, 18), slice(18, 21), slice(21, 24), slice(24, 30), slice(30, 33), slice(33, 36)
GPS, DVS, STAR = range(3)
PFA = 1e-5
POSITION, VELOCITY = 20.0, 0.3
"""Table 1: GPS, an axis, m and m/s."""
STAR_SIGMA = np.array([5.0, 5.0, 15.0]) * ARCSEC
DVS_WHITE, DVS_MARKOV, DVS_TAU, DVS_PPM = 0.2, 0.1, 60.0, 1000.0
"""Noise of the Doppler, m/s; 002 gives none."""
CORRELATED, GPS_TAU = 0.8, 100.0
"""Part of GPS's sigma that is correlated where it is, and its time, s; 002 gives none."""
MARKOV_DRIFT, MARKOV_TIME = 0.003 * DEG_PER_H, 3600.0
SCORED = 60
CLAIMED = (10.0, 0.5, 60.0)
"""m, m/s, arcsec: in normal operation and with any one subsystem failed."""


WHY = {
    "white GPS, without star sensor": "; the heading begins with 120 arcsec, and a straight flight tells little of it",
    "correlated GPS, modelled": "; an error that lasts 100 s does not average out: what is left is 25 to 35 m, and the filter says so",
    "correlated GPS, taken as white": "; an error that lasts 100 s does not average out, and the filter does not know",
}


class AidFault(NamedTuple):
    """A line of table 2: name, aid, seconds, what it adds to the measurement (m, m/s) at t seconds after its onset."""

    name: str
    aid: int
    first: int
    last: int
    component: int
    size: Callable[[float], float]


_EAST = 1852.0 * np.cos(np.radians(34.0))
FAULTS = (
    AidFault("GPS longitude, step 0.3 arcmin", GPS, 20, 50, 1, lambda t: 0.3 * _EAST),
    AidFault("GPS latitude, slow 0.0008 t^2 arcmin", GPS, 100, 140, 0, lambda t: 0.0008 * 1852.0 * t * t),
    AidFault("GPS v_E, step 0.3 m/s", GPS, 300, 330, 4, lambda t: 0.3),
    AidFault("Doppler v_d, step 2.0 m/s", DVS, 500, 540, 2, lambda t: 2.0),
    AidFault("GPS height, step 640 m", GPS, 600, 650, 2, lambda t: 640.0),
    AidFault("GPS v_N, ramp 0.5 t m/s", GPS, 1000, 1060, 3, lambda t: 0.5 * t),
)


@dataclass(frozen=True)
class Model:
    """Transitions (seconds, N, N), square roots of the process noise, square root A of the start, and the measurement matrices each second."""

    Phi: Array
    Qd: Array
    root: Array
    A: Array
    H: list[list[Array]]


@functools.lru_cache(maxsize=2)
def model(correlated: bool) -> Model:
    """The flight of 4.1: 34 N 108 E, 1000 m, 30 deg east of north, 100 m/s for 100 s, 1 m/s^2 for 100 s, level to the end.

    Level and straight; errors computed - true, NED. The mounting errors of table 1 have no state in 002's model and are left out: on a straight
    flight they cannot be told from biases.
    """
    C = dcm_from_euler(0.0, 0.0, np.radians(30.0))
    q = np.zeros(N)
    q[3:6], q[6:9] = (5.0 * MICRO_G) ** 2, (0.001 * DEG_PER_SQRT_H) ** 2
    q[DRIFT] = 2.0 * MARKOV_DRIFT**2 / MARKOV_TIME
    markov = np.zeros(N)
    if correlated:
        sigma = CORRELATED * np.repeat([POSITION, VELOCITY], 3)
        q[GPS_STATES], markov[GPS_STATES] = 2.0 * sigma**2 / GPS_TAU, 1.0 / GPS_TAU
    q[DVS_STATES], markov[DVS_STATES], markov[DRIFT] = 2.0 * DVS_MARKOV**2 / DVS_TAU, 1.0 / DVS_TAU, 1.0 / MARKOV_TIME
    lat, speed, one = np.radians(34.0), 100.0, np.eye(N)
    Phi, Qd, H = np.empty((SECONDS, N, N)), np.empty((SECONDS, N, N)), []
    for k in range(SECONDS):
        along = 1.0 if 100 <= k < 200 else 0.0
        v_n = C @ [speed, 0.0, 0.0]
        f_b = np.array([along, 0.0, -float(gravity(lat, 1000.0))])
        F = np.zeros((N, N))
        F[:15, :15] = error_dynamics(np.array([lat, 0.0, 1000.0, *v_n]), C @ f_b, C)
        rate_b = C.T @ (earth_rate_n(lat) + transport_rate_n(lat, 1000.0, v_n))
        F[6:9, DRIFT], F[6:9, SCALE_G], F[3:6, SCALE_A] = -C, -C * rate_b, C * f_b
        F -= np.diag(markov)
        Phi[k] = one + F @ (one + F @ (one / 2.0 + F / 6.0))
        Qd[k] = 0.5 * (Phi[k] * q @ Phi[k].T + np.diag(q))
        lat += v_n[0] / (float(radii(lat)[0]) + 1000.0)
        speed += along
        v_n = C @ [speed, 0.0, 0.0]
        gps, dvs, star = np.zeros((6, N)), np.zeros((3, N)), np.zeros((3, N))
        gps[:, :6] = np.eye(6)
        gps[:, GPS_STATES] = -np.eye(6)
        dvs[:, 3:6], dvs[:, 6:9] = C.T, -C.T @ skew(v_n)  # computed v_b = C_bn (I + [phi x]) (v + dv)
        dvs[:, DVS_STATES], dvs[:, DVS_SCALE] = -np.eye(3), -np.diag([speed, 0.0, 0.0])
        star[:, 6:9] = np.eye(3)
        H.append([gps, dvs, star])
    scale = np.sqrt(np.maximum(Qd.diagonal(axis1=1, axis2=2), 1e-60))
    values, vectors = np.linalg.eigh(Qd / (scale[:, :, None] * scale[:, None, :]))
    root = scale[:, :, None] * vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]
    start = np.zeros(N)
    start[:15] = [5.0] * 3 + [0.01] * 3 + [10.0 * ARCSEC] * 2 + [120.0 * ARCSEC] + [0.01 * DEG_PER_H] * 3 + [50.0 * MICRO_G] * 3
    start[DRIFT], start[SCALE_G], start[SCALE_A] = MARKOV_DRIFT, 20.0 * PPM, 20.0 * PPM
    if correlated:
        start[GPS_STATES] = CORRELATED * np.repeat([POSITION, VELOCITY], 3)
    start[DVS_STATES], start[DVS_SCALE] = DVS_MARKOV, DVS_PPM * PPM
    return Model(Phi, Qd, root, np.diag(start), H)


@functools.lru_cache(maxsize=4)
def flight(seed: int, correlated: bool) -> tuple[Array, Array]:
    """Truth (seconds, N) and white noise (seconds, 12) of the aids of one seed."""
    made = model(correlated)
    x = made.A @ normal(seed, "aircraft start", 0, 1, N)[0]
    drive = normal(seed, "aircraft process", 0, SECONDS, N)
    truth = np.empty((SECONDS, N))
    for k in range(SECONDS):
        x = truth[k] = made.Phi[k] @ x + made.root[k] @ drive[k]
    return truth, normal(seed, "aircraft aids", 0, SECONDS, 12)


def sigmas(correlated: bool) -> tuple[Array, Array, Array]:
    """Sigma of the white part of each aid's noise."""
    gps = np.repeat([POSITION, VELOCITY], 3) * (np.sqrt(1.0 - CORRELATED**2) if correlated else 1.0)
    return gps, np.full(3, DVS_WHITE), STAR_SIGMA


@dataclass(frozen=True)
class Flown:
    """Errors (seconds, 9): position m, velocity m/s, attitude rad; NIS, threshold of each aid (seconds, 3), not a number without a measurement."""

    error: Array
    nis: Array
    rejected: NDArray[np.bool_]


def fly(seed: int, *, star: bool = True, correlated: bool = False, known: bool = True, faults: bool = False, no_reset: bool = False) -> Flown:
    """One flight.

    Parameters
    ----------
    seed : of everything random
    star : with the star sensor
    correlated : GPS errors are; `known`: the filter has states for them, else it takes them as white
    faults : those of table 2
    no_reset : the paper's structure instead of the information form
    """
    truth_model, told = model(correlated), model(correlated and known)
    truth, noise = flight(seed, correlated)
    white = sigmas(correlated)
    R = [np.diag(s**2) for s in sigmas(correlated and known)]
    P = told.A @ told.A.T
    structure: Structure
    if no_reset:
        structure = FederatedFilter(np.zeros(N), P, 3, retention=1.0, gate=Gate(PFA))
    else:
        structure = SeparatedMasters(np.zeros(N), P, 3, SolutionSeparation(left_out=0), gate=Gate(PFA))
    error, nis, rejected = np.empty((SECONDS, 9)), np.full((SECONDS, 3), np.nan), np.zeros((SECONDS, 3), dtype=np.bool_)
    for k in range(SECONDS):
        aids: list[Measurement | None] = []
        for aid, columns in enumerate((slice(0, 6), slice(6, 9), slice(9, 12))):
            z = truth_model.H[k][aid] @ truth[k] - white[aid] * noise[k, columns]
            for fault in FAULTS if faults else ():
                if fault.aid == aid and fault.first <= k < fault.last:
                    z[fault.component] -= fault.size(float(k - fault.first))
            aids.append(None if aid == STAR and not star else Measurement(z, told.H[k][aid], R[aid]))
        for aid, verdict in enumerate(structure.epoch(told.Phi[k], told.Qd[k], aids)):
            if verdict is not None:
                nis[k, aid], rejected[k, aid] = verdict.statistic, not verdict.passed
        error[k] = structure.x[:9] - truth[k, :9]
    return Flown(error, nis, rejected)


def delay(flown: Flown, fault: AidFault) -> float:
    """Seconds until a fault was first rejected; infinite: it was not."""
    out = flown.rejected[fault.first : fault.last, fault.aid]
    return float(out.argmax()) if out.any() else np.inf


def claims(flown: Flown) -> tuple[bool, bool, bool]:
    """002: 10 m (from 200 s), 0.5 m/s, 60 arcsec, each at every second from 60 s on."""
    e = np.abs(flown.error)
    parts = e[200:, :3] <= CLAIMED[0], e[SCORED:, 3:6] <= CLAIMED[1], e[SCORED:, 6:] <= CLAIMED[2] * ARCSEC
    position, velocity, attitude = (bool(part.all()) for part in parts)
    return position, velocity, attitude


def run(seeds: int, quick: bool, progress: Progress) -> tuple[Sequence[Row], Sequence[Figure]]:
    """Rows and a figure."""
    variants: dict[str, dict[str, Any]] = {
        "white GPS, with star sensor": {},
        "white GPS, without star sensor": {"star": False},
        "correlated GPS, modelled": {"correlated": True},
        "correlated GPS, taken as white": {"correlated": True, "known": False},
        "white GPS, no-reset as in the paper": {"no_reset": True},
        "white GPS, faults of table 2": {"faults": True},
    }
    rows: list[Row] = []
    for i, (name, options) in enumerate(variants.items()):
        made = [fly(seed, **options) for seed in range(seeds)]
        progress((i + 0.5) / len(variants))
        rows += _accuracy(name, made, aimed=not options)
        if options.get("faults"):
            rows += _faults(made)
        progress((i + 1.0) / len(variants))
    figures = [
        Figure("aircraft-path", "The flight (figure 6)", _draw_path),
        Figure("aircraft-tests", "Innovation tests with the faults of table 2 (figure 7a)", _draw),
        Figure("aircraft-errors", "Errors with the faults of table 2 (figures 7b to 7d); dashed: what is claimed", _draw_errors),
    ]
    return rows, [] if quick else figures


def _accuracy(name: str, made: Sequence[Flown], aimed: bool) -> list[Row]:
    rms = np.array([np.sqrt(np.mean(one.error[SCORED:] ** 2, axis=0)) for one in made])
    rms[:, 6:] /= ARCSEC
    limits = (3.5,) * 3 + (0.05,) * 3 + (1.0, 1.0, 2.0)
    words = ("north, m", "east, m", "down, m", "v_N, m/s", "v_E, m/s", "v_D, m/s", "phi_N, arcsec", "phi_E, arcsec", "phi_D, arcsec")
    rows = [
        row(42 if aimed else None, f"{name}: RMS {word}", rms[:, i], ok=functools.partial(_most, limits[i]) if aimed else None)
        for i, word in enumerate(words)
    ]
    held = np.array([claims(one) for one in made], dtype=float)
    each = "position {:.0%}, velocity {:.0%}, attitude {:.0%} of the runs".format(*held.mean(axis=0))
    told = aimed or "faults" in name  # what the paper says of it; the other variants it does not have
    rows.append(
        row(
            42 if aimed else None, f"{name}: runs that keep 10 m, 0.5 m/s, 60 arcsec throughout", held.all(axis=1), paper="all" if told else None,
            ok=(lambda r: r.value >= 0.95) if told else None, remark=each + WHY.get(name, ""),
        )
    )  # fmt: skip
    false = np.array([np.count_nonzero(one.rejected) for one in made], dtype=float)
    if "faults" not in name:
        rows.append(row(None, f"{name}: measurements rejected at 1e-5", false))
    return rows


def _faults(made: Sequence[Flown]) -> list[Row]:
    at_once = (0.0, 0.0)
    limits = {"longitude": at_once, "latitude": (6.0, 10.0), "v_d": at_once, "height": at_once, "v_N": (1.0, 5.0)}
    rows = []
    for fault in FAULTS:
        late = np.array([delay(one, fault) for one in made])
        key = next((k for k in limits if k in fault.name), None)
        if key is None:  # v_E: one sigma
            missed = np.isinf(late).astype(float)
            remark = "one sigma of one measurement: it is not detected, and does no harm"
            rows.append(row(43, f"{fault.name}: not detected in", missed, paper="detected, no delay", ok=lambda r: r.value >= 0.9, remark=remark))
            continue
        low, high = limits[key]
        remark = "it begins at nothing: no test finds it at once" if high else ""
        rows.append(row(43, f"{fault.name}: delay, s", late, paper=0.0, centre=np.median, ok=functools.partial(_between, low, high), remark=remark))
    return rows


def _most(limit: float, made: Row) -> bool:
    return made.value <= limit


def _between(low: float, high: float, made: Row) -> bool:
    return low <= made.value <= high


def path() -> Array:
    """Latitude, longitude [deg], height [m] and speed [m/s] of each second, (seconds, 4)."""
    lat, lon, speed = np.radians(34.0), np.radians(108.0), 100.0
    out = np.empty((SECONDS, 4))
    for k in range(SECONDS):
        speed += 1.0 if 100 <= k < 200 else 0.0
        meridian, normal_radius = (float(one) for one in radii(lat))
        lat += speed * np.cos(np.radians(30.0)) / (meridian + 1000.0)
        lon += speed * np.sin(np.radians(30.0)) / ((normal_radius + 1000.0) * np.cos(lat))
        out[k] = np.degrees(lat), np.degrees(lon), 1000.0, speed
    return out


def _draw_path(canvas: Any) -> None:
    flown = path()
    axes = canvas.subplots(1, 3)
    for ax, x, y, words in zip(axes, (flown[:, 1], None, None), (flown[:, 0], flown[:, 2], flown[:, 3]), _PATH, strict=True):
        ax.plot(np.arange(SECONDS) if x is None else x, y, color="#0072b2")
        ax.set(xlabel=words[0], ylabel=words[1])


_PATH = (("longitude, deg", "latitude, deg"), ("time, s", "height, m"), ("time, s", "speed, m/s"))


def _draw_errors(canvas: Any) -> None:
    error = fly(0, faults=True).error
    axes = canvas.subplots(3, 1, sharex=True)
    kinds = zip(axes, ("position, m", "velocity, m/s", "attitude, arcsec"), (1.0, 1.0, ARCSEC), CLAIMED, strict=True)
    for i, (ax, label, unit, claimed) in enumerate(kinds):
        for axis, color, name in zip(range(3), ("#0072b2", "#d55e00", "#009e73"), ("north", "east", "down"), strict=True):
            ax.plot(error[:, 3 * i + axis] / unit, lw=0.7, color=color, label=name)
        for limit in (-claimed, claimed):
            ax.axhline(limit, color="#999999", lw=1, ls="--")
        for fault in FAULTS:
            ax.axvspan(fault.first, fault.last, color="#d55e00", alpha=0.1)
        ax.set(ylabel=label, ylim=(-1.2 * claimed, 1.2 * claimed))
    axes[0].legend(loc="upper right", ncols=3, fontsize=8)
    axes[-1].set_xlabel("time, s; red: a fault")


def _draw(canvas: Any) -> None:
    flown = fly(0, faults=True)
    axes = canvas.subplots(3, 1, sharex=True)
    for aid, (ax, name, dof) in enumerate(zip(axes, ("GPS", "Doppler", "star sensor"), (6, 3, 3), strict=True)):
        ax.semilogy(flown.nis[:, aid], lw=0.6, color="#0072b2")
        ax.axhline(nis_threshold(PFA, dof), color="#d55e00", lw=1)
        for fault in FAULTS:
            if fault.aid == aid:
                ax.axvspan(fault.first, fault.last, color="#d55e00", alpha=0.2)
        ax.set_ylabel(f"NIS, {name}")
    axes[-1].set_xlabel("time, s")
