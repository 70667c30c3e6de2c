"""Thesis 4.3.3: drift compensation, experiments 1 to 3 and table 4.3, and what the claims are worth.

Lives here: the experiments' drifts and noise, one seed of each, rows and figures of targets 8, 9 and 16.
Does not live here: the algorithms (riins_fdi.drift), the rest of chapter 4 (thesis_detection).
"""

from __future__ import annotations

import functools
import math
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from riins_core.imu_array import CONFIGURATIONS, ImuArray
from riins_core.noise import normal
from riins_eval.studies.rows import Figure, Progress, Row, row
from riins_fdi.drift import DriftBlock, DriftCompensator, DriftConfig

Array = NDArray[np.float64]

ARRAY = ImuArray(CONFIGURATIONS["dodecahedron"])
DT = 0.01
SAMPLES = 4000
TIME = DT * np.arange(1, SAMPLES + 1)
ONSETS = (2.0, 6.0, 12.0, 20.0, 26.0, 32.0)
GAINS = (5.0, 10.0, 40.0, 60.0, 80.0, 120.0)
# mean estimation errors of table 4.3
PRINTED = {"aekpf": (0.1035, 0.1540, 0.1770, 0.1758, 0.1294, 0.1993), "pf": (0.2738, 0.3845, 0.2517, 0.2471, 0.2253, 0.2754)}
_SUCCESS = 0.3  # deg/h left of the worst sensor, mean of the last 5 s, below which a compensation counts as one that worked


def drifts(experiment: int) -> Array:
    """True drifts (samples, 6) [deg/h] of experiment 1 (and 3) or 2; t counts from the start of the run."""
    t = TIME
    shapes = (2.0 - 0.5 * np.sin(0.5 * t), -np.exp(0.01 * t), 2.0 + 0 * t, -2.0 + 0 * t, 2.0 + 0 * t, 3.0 - 0.6 * np.sin(t))
    out = np.column_stack([np.where(t >= onset, shape, 0.0) for onset, shape in zip(ONSETS, shapes, strict=True)])
    if experiment == 2:
        out[:, 4] = np.where(t >= ONSETS[4], 2.0 - 0.6 * np.sin(t), 0.0)
    return out


def varying(count: int, seed: int) -> Array:
    """Drifts of `count` sensors chosen by the seed that all vary, one after the other; the other sensors are healthy."""
    rng = np.random.default_rng([seed, count])
    out = np.zeros((SAMPLES, 6))
    for sensor, onset in zip(rng.permutation(6)[:count], ONSETS, strict=False):
        out[:, sensor] = np.where(TIME >= onset, rng.choice([-1.0, 1.0]) * (2.0 - 0.6 * np.sin(TIME + rng.uniform(0.0, 2.0 * math.pi))), 0.0)
    return out


def readings(drift: Array, seed: int) -> Array:
    """Gyro readings (samples, 6) [deg/h] at rest: drift and flicker noise (4-89), 0.6 N(0, 0.05) + 0.4 N(0, 0.01), read as standard deviations."""
    draw = normal(seed, "flicker", 0, len(drift), 12)
    return np.asarray(drift + np.where(ndtr(draw[:, 6:]) < 0.4, 0.01, 0.05) * draw[:, :6])


def compensate(drift: Array, seed: int, **settings: Any) -> DriftBlock:
    """One run of the loop over the readings of a seed."""
    return DriftCompensator(ARRAY, DriftConfig(dt=DT, seed=seed, **settings)).process(readings(drift, seed))


def errors(drift: Array, block: DriftBlock) -> Array:
    """Mean |d - D| of each sensor over the run, (6,) [deg/h]: the drift that is left."""
    return np.asarray(np.abs(drift - block.compensation).mean(axis=0))


def hidden(seed: int) -> tuple[float, float]:
    """Target 16: body error left by a drift d = H w0 with |w0| = 2 deg/h, and the part of d in the patterns the report names."""
    w0 = np.random.default_rng(seed).standard_normal(3)
    w0 *= 2.0 / np.linalg.norm(w0)
    drift = np.tile(ARRAY.H @ w0, (SAMPLES, 1))
    loop = DriftCompensator(ARRAY, DriftConfig(dt=DT))
    block = loop.process(readings(drift, seed))
    body = block.compensated[SAMPLES // 2 :].mean(axis=0) @ ARRAY.least_squares().T
    named = float(np.linalg.norm(loop.report().unobservable.T @ drift[0]) / np.linalg.norm(drift[0]))
    return float(np.linalg.norm(body)), named


def study(seeds: int, progress: Progress) -> tuple[list[Row], list[Figure]]:
    """Rows and figures of 4.3.3, `progress` from 0 to 1."""
    first, second = drifts(1), drifts(2)
    rows: list[Row] = []
    error = {name: np.array([errors(first, compensate(first, s, drift_factor=factor)) for s in range(seeds)]) for name, factor in
             (("RFDC", False), ("IRFDC", True))}  # fmt: skip
    improved, plain = error["IRFDC"].mean(axis=1), error["RFDC"].mean(axis=1)
    rows += [
        row(8, "IRFDC (EKF), experiment 1, K = 40: mean drift left, deg/h", improved, ok=lambda r: r.value <= 0.15),
        row(
            8, "the same over RFDC's", improved / plain, ok=lambda r: improved.mean() <= 0.45 * plain.mean(),
            remark="the drift factor helps, as the thesis says",
        ),
        row(None, "IRFDC with AEKF as the thesis has it", [errors(first, compensate(first, s, filter="aekf")).mean() for s in range(seeds)]),
    ]  # fmt: skip
    progress(0.15)
    rows += _table_4_3(seeds, lambda part: progress(0.15 + 0.6 * part))
    left = np.array([errors(second, compensate(second, s)) for s in range(seeds)])
    rows.append(
        row(
            None, "experiment 2: drift left of sensor 6", left[:, 5], paper="fails",
            remark="the thesis' failure does not come back with the EKF: sensor 6 is found. Whether a drift is attributed rightly does not hang on "
            "three healthy or constant sensors alone, see the rows with varying sensors",
        )
    )  # fmt: skip
    rows.append(row(None, "experiment 2: drift left, mean of all sensors", left.mean(axis=1)))
    gains = {gain: [compensate(first, s, gain=gain) for s in range(min(seeds, 10))] for gain in GAINS}
    for gain, blocks in gains.items():
        values = [errors(first, b)[1] for b in blocks]
        remark = "not here: the interval, which the thesis does not give, decides (K dt = 2 is the limit of stability)" if gain > 70.0 else ""
        rows.append(row(None, f"experiment 3, K = {gain:g}: drift left of sensor 2", values, paper=_printed(gain), remark=remark))
    progress(0.85)
    for count in (1, 2, 3, 4):
        good = []
        for s in range(seeds):
            drift = varying(count, s)
            left = np.abs(drift - compensate(drift, s).compensation)[-500:].mean(axis=0)
            good.append(float(left.max() < _SUCCESS))
        remark = "the thesis: always, while three are healthy or constant and compensated; it falls gradually" if count > 1 else ""
        rows.append(row(None, f"compensation works with {count} varying sensor{'s' * (count > 1)}, others healthy", good, paper="1", remark=remark))
    progress(0.95)
    body, named = np.array([hidden(s) for s in range(seeds)]).T
    rows.append(
        row(
            16, "drift H w0 of 2 deg/h: body error left, deg/h", body, ok=lambda r: abs(r.value - 2.0) < 0.2 and bool(np.all(named > 1.0 - 1e-9)),
            remark="no parity test sees it; the report names the pattern, and only aiding from outside resolves it",
        )
    )  # fmt: skip
    progress(1.0)
    return rows, _figures(first, second, gains)


def _printed(gain: float) -> str:
    return "follows" if 10.0 <= gain <= 70.0 else "slow" if gain < 10.0 else "drifts away"


def _table_4_3(seeds: int, progress: Progress) -> list[Row]:
    drift, kinds = drifts(1), (("pf", 800), ("aekpf", 100), ("aekpf_optimal", 100))
    left = {name: np.zeros((seeds, 6)) for name, _ in kinds}

    def one(seed: int) -> list[Array]:
        return [errors(drift, compensate(drift, seed, filter=name, particles=particles)) for name, particles in kinds]

    with ThreadPoolExecutor(2) as pool:  # the kernels run without the interpreter's lock
        for s, found in enumerate(pool.map(one, range(seeds))):
            for (name, _), value in zip(kinds, found, strict=True):
                left[name][s] = value
            progress((s + 1) / seeds)
    mean = {name: value.mean(axis=1) for name, value in left.items()}
    rows = [
        row(
            9, "locally optimal AEKPF(100) / PF(800), experiment 1", mean["aekpf_optimal"] / mean["pf"], paper=0.57,
            ok=lambda r: mean["aekpf_optimal"].mean() <= 0.70 * mean["pf"].mean(),
            remark="the ratio of the means decides; it depends on the process noise, which the thesis does not give: 0.3 to 0.5 for 0.01 to 0.03",
        ),
        row(
            None, "AEKPF(100) as printed / PF(800)", mean["aekpf"] / mean["pf"], paper=0.57,
            remark="half the error of PF comes only with the locally optimal proposal, and a plain EKF in the same loop beats both",
        ),
    ]  # fmt: skip
    for sensor in range(6):
        for name, _ in kinds:
            printed = PRINTED["pf" if name == "pf" else "aekpf"][sensor]
            rows.append(row(None, f"table 4.3, sensor {sensor + 1}, {name}", left[name][:, sensor], paper=printed))
    return rows


def _figures(first: Array, second: Array, gains: dict[float, list[DriftBlock]]) -> list[Figure]:
    def outputs(canvas: Any, drift: Array) -> None:
        block, before = compensate(drift, 0), readings(drift, 0)
        for sensor, ax in enumerate(canvas.subplots(3, 2, sharex=True).flat):
            ax.plot(TIME, before[:, sensor], lw=0.5, label="before compensation")
            ax.plot(TIME, block.compensated[:, sensor], lw=0.5, label="after")
            ax.set_ylabel(f"m{sensor + 1}, deg/h")
            if sensor == 0:
                ax.legend(fontsize=7)
            if sensor > 3:
                ax.set_xlabel("t, s")

    def by_gain(canvas: Any) -> None:
        for ax, (gain, blocks) in zip(canvas.subplots(3, 2, sharex=True, sharey=True).flat, gains.items(), strict=True):
            ax.plot(TIME, readings(first, 0)[:, 1], lw=0.4, color="0.7")
            ax.plot(TIME, blocks[0].compensated[:, 1], lw=0.5)
            ax.set_title(f"K = {gain:g}", fontsize=8)

    def estimates(canvas: Any) -> None:
        for ax, (name, particles) in zip(canvas.subplots(3, 1, sharex=True), (("aekpf_optimal", 100), ("aekpf", 100), ("pf", 800)), strict=True):
            ax.plot(TIME, first - compensate(first, 0, filter=name, particles=particles).compensation, lw=0.5)
            ax.set_ylabel(f"{name}, deg/h")
        ax.set_xlabel("t, s")

    return [
        Figure("drift_experiment_1", "Gyro output before and after compensation, experiment 1 (figure 4.1)", functools.partial(outputs, drift=first)),
        Figure(
            "drift_experiment_2", "Gyro output before and after compensation, experiment 2 (figure 4.2)", functools.partial(outputs, drift=second)
        ),
        Figure("drift_experiment_3", "Gyro 2 with different feedback gains, experiment 3 (figure 4.3)", by_gain),
        Figure("drift_estimates", "Drift left by AEKPF and PF (figures 4.4 and 4.5)", estimates),
    ]
