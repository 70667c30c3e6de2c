"""Cost of every detection and fusion method for redundant inertial sensors: microseconds a sample, beside NumPy-only code and pyins' strapdown.

Lives here: the timing and its table; `./riins exec python bench/fusion_cost.py [--samples 20000]`, exit status 1 when a limit is missed.
Does not live here: the methods (riins_fdi, riins_imu_fusion), the same algorithms without compiled code (numpy_methods.py).
"""

from __future__ import annotations

import argparse
import dataclasses
import statistics
import sys
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import numpy_methods as plain
import pandas as pd
import pyins.strapdown
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from riins_core import strapdown
from riins_core.imu_array import ImuArray, cone1, dodecahedron
from riins_core.noise import normal
from riins_core.sensor_errors import normal as sensor_noise
from riins_core.settings import build
from riins_fdi import drift, methods, sequential
from riins_imu_fusion.config import FusionConfig
from riins_imu_fusion.drift_compensated import CompensationSettings
from riins_imu_fusion.glr_kf import GlrKalman, GlrSettings
from riins_imu_fusion.glr_kf_state import SLOTS
from riins_imu_fusion.method import TriadModel
from riins_imu_fusion.methods import make
from riins_imu_fusion.pipeline import FusionPipeline

Array = NDArray[np.float64]
Run = Callable[[Array], tuple[Array, ...]]

VOYAGE = 12 * 3600 * 100
ARRAYS = {6: ImuArray(dodecahedron()), 12: ImuArray(np.vstack([dodecahedron(), cone1()]))}
PFA = 2.8e-7
BLOCK = 1000
LIMITS = {"wls": 2.0, "glr_kf": 5.0}
"""Microseconds a sample of the whole pipeline, so of two kinds of sensor, by its `method`; at n = 6 and at n = 12."""


class Case(NamedTuple):
    """One method for one geometry."""

    ours: Callable[[], Run]
    """a new object's way to take a block"""
    plain: Callable[[Array], tuple[Array, ...]]
    """the whole series at once, sample by sample inside"""
    share: float = 1.0
    """part of the samples it is timed on"""


def answers(method: Any, *names: str) -> Run:
    """What an object of a method says of each block under these names."""

    def run(z: Array) -> tuple[Array, ...]:
        out = method.process(z)
        return tuple(getattr(out, name) for name in names)

    return run


def parity_cases(array: ImuArray) -> dict[str, Case]:
    """The four tests of one epoch and the two of many."""
    made: dict[str, Any] = {name: methods.make(name, array, 1.0, PFA) for name in methods.METHODS}

    def tested(name: str) -> Callable[[], Run]:
        return lambda: lambda z: (made[name].statistic(z), made[name].isolate(z))

    test = made["glt"].test
    vectors = made["optimal_parity_vector"].vectors @ test.whitened
    comparison = made["direct_comparison"]
    cusum, glr = sequential.Cusum(test), sequential.WindowedGlr(test)
    u = glr._u

    def followed(kind: type) -> Callable[[], Run]:
        return lambda: answers(kind(test), "statistic", "sensor")

    return {
        "glt": Case(tested("glt"), lambda z: plain.glt(z, test.whitened, test.gain)),
        "optimal_parity_vector": Case(tested("optimal_parity_vector"), lambda z: plain.largest(z, vectors)),
        "svd": Case(tested("svd"), lambda z: plain.svd(z, made["svd"].projector)),
        "direct_comparison": Case(
            tested("direct_comparison"), lambda z: plain.direct_comparison(z, comparison.relations, comparison._member, comparison.threshold)
        ),
        "cusum": Case(followed(sequential.Cusum), lambda z: plain.cusum(z, test.whitened, u, cusum.reference)),
        "windowed_glr": Case(followed(sequential.WindowedGlr), lambda z: plain.windowed_glr(z, test.whitened, u, glr.lengths)),
    }


def fusion_cases(array: ImuArray) -> dict[str, Case]:
    """Methods of fusion, with their covariance, each without the fault test."""
    model = TriadModel(array, 1.0, 0.5, 0.01)
    W, V, RV = array.least_squares(), array.parity(), array.parity() @ array.parity().T
    R, P, Q = np.diag(model.R), np.diag(model.P), np.diag(model.Q)
    calm = TriadModel(array, 1.0, 0.5, 1e-5)
    glr = GlrKalman(calm, GlrSettings())
    levels = len(glr.state.ring)

    def method(name: str, of: TriadModel = model) -> Callable[[], Run]:
        return lambda: answers(make(name, of), "x", "covariance")

    return {
        "wls": Case(method("wls"), lambda z: plain.wls(z, W, R, P, Q)),
        "opt": Case(method("opt"), lambda z: plain.opt(z, W, R, P, Q, V, RV)),
        "aopt": Case(method("aopt"), lambda z: plain.aopt(z, W, R, P, Q, V, RV, make("aopt", model).settings)),
        "optdc": Case(method("optdc"), lambda z: plain.optdc(z, W, R, P, Q, V, RV, CompensationSettings().gain * model.dt)),
        "glr_kf": Case(method("glr_kf", calm), lambda z: plain.glr_kf(z, W, V, glr.rules, P, levels, SLOTS)),
    }


def drift_cases(array: ImuArray) -> dict[str, Case]:
    """RFDC and IRFDC with each filter."""
    V, votes = array.parity(), drift.voting_rows(array)

    def compensated(config: drift.DriftConfig) -> Callable[[], Run]:
        return lambda: answers(drift.DriftCompensator(array, config), "compensation", "remaining")

    def numpy_only(config: drift.DriftConfig) -> Callable[[Array], tuple[Array, ...]]:
        if config.filter in ("ekf", "aekf"):
            return lambda z: plain.rfdc(z, V, votes, config, config.filter == "aekf")
        return lambda z: plain.pf(z, V, votes, config, normal(config.seed, "drift particles", 0, len(z), config.particles * array.n + 1))

    found = {}
    for name, factor, filter_name in (
        ("RFDC, ekf", False, "ekf"), ("IRFDC, ekf", True, "ekf"), ("IRFDC, aekf", True, "aekf"), ("IRFDC, pf (100)", True, "pf"),
        ("IRFDC, aekpf (100)", True, "aekpf"), ("IRFDC, aekpf_optimal (100)", True, "aekpf_optimal"),
    ):  # fmt: skip
        config = drift.DriftConfig(filter=filter_name, drift_factor=factor, sigma=1.0, process_sigma=0.01, vote_sigma=1.0)
        particles = filter_name in ("pf", "aekpf", "aekpf_optimal")
        reference = (lambda z: ()) if filter_name.startswith("aekpf") else numpy_only(config)  # particles with a filter each: none was written
        found[name] = Case(compensated(config), reference, 0.02 if particles else 0.5)
    return found


def seconds(work: Callable[[], Any], repetitions: int) -> float:
    """Median CPU seconds of a piece of work."""
    times = []
    for _ in range(repetitions):
        before = time.process_time()
        work()
        times.append(time.process_time() - before)
    return statistics.median(times)


def in_blocks(run: Run, z: Array) -> list[tuple[Array, ...]]:
    """The series in blocks."""
    return [run(z[start : start + BLOCK]) for start in range(0, len(z), BLOCK)]


def measure(case: Case, n: int, samples: int, repetitions: int) -> tuple[float, float, float]:
    """Microseconds a sample, ours and NumPy's, and the largest difference of their answers relative to the size of the answers."""
    z = np.random.default_rng(n).standard_normal((max(int(samples * case.share), 200), n))
    few = z[: max(len(z) // 20, 200)]
    case.ours()(few)  # compiles
    theirs = case.plain(few)
    ours = [np.concatenate(parts) for parts in zip(*in_blocks(case.ours(), few), strict=True)]
    apart = max((float(np.max(np.abs(a - b))) / max(1.0, float(np.max(np.abs(b)))) for a, b in zip(ours, theirs, strict=False)), default=np.nan)
    run = case.ours()
    cost = seconds(lambda: in_blocks(run, z), repetitions) / len(z) * 1e6
    plain_cost = seconds(lambda: case.plain(few), repetitions) / len(few) * 1e6 if theirs else np.nan
    return cost, plain_cost, apart


def pipeline_cost(
    settings: dict[str, Any], n: int, samples: int, block: int, repetitions: int, faulty: bool = False, statuses: bool = False
) -> float:
    """Microseconds a sample of `FusionPipeline` (gyros and accelerometers, health and all) in blocks; `faulty`: one gyro lies all the time."""
    geometry = {"geometry": (ARRAYS[n].H * [1.0, -1.0, -1.0]).ravel().tolist()}  # FLU
    config = build(FusionConfig, settings | geometry)
    sigma = config.sigma()
    gyro, accel = (s[0] * sensor_noise(1, stream, 0, samples, n) for stream, s in enumerate(sigma))
    if faulty:
        gyro[:, 2] += 1e-3
    valid, k = np.full(samples, (1 << n) - 1, np.uint64), np.arange(samples)
    stamp, sequence = (k + 1) * 10_000_000, k.astype(np.uint32)

    def work(first: int, last: int) -> None:
        for start in range(first, last, block):
            part = slice(start, min(start + block, last))
            pipeline.process(stamp[part], sequence[part], gyro[part], accel[part], valid[part], valid[part])
            pipeline.drain_statuses()
            pipeline.drain_events()

    times = []
    for _ in range(repetitions):
        pipeline = FusionPipeline(config, statuses=statuses)
        pipeline.warm_up()
        work(0, samples // 10)  # with it the tables of the sensors in use are made
        before = time.process_time()
        work(samples // 10, samples)
        times.append(time.process_time() - before)
    return statistics.median(times) / (samples - samples // 10) * 1e6


def numpy_cost(array: ImuArray, method: str, samples: int, repetitions: int) -> float:
    """Microseconds a sample of NumPy-only code for both kinds of sensor: least squares and likelihood test, and with glr_kf its filter."""
    test = methods.make("glt", array, 1.0, PFA).test
    W, z = array.least_squares(), np.random.default_rng(1).standard_normal((samples, array.n))
    works = [lambda: plain.fit(z, W, test.whitened, test.gain, test.threshold)]
    if method == "glr_kf":
        works.append(lambda: fusion_cases(array)["glr_kf"].plain(z))
    return 2.0 * sum(seconds(work, repetitions) for work in works) / samples * 1e6


def strapdown_costs(samples: int, repetitions: int) -> tuple[float, float]:
    """Microseconds a sample of strapdown navigation: ours and pyins', on the same increments at rest."""
    dt = 0.01
    rate, force = np.zeros((samples, 3)), np.tile([0.0, 0.0, -9.81], (samples, 1))
    columns = ["gyro_x", "gyro_y", "gyro_z", "accel_x", "accel_y", "accel_z"]
    increments = pyins.strapdown.compute_increments_from_imu(
        pd.DataFrame(np.hstack([rate, force]) * dt, index=np.arange(samples) * dt, columns=columns), "increment"
    )
    names = ["lat", "lon", "alt", "VN", "VE", "VD", "roll", "pitch", "heading"]
    start = pd.Series(np.array([40.0, 121.0, *np.zeros(7)]), index=names)

    def theirs() -> None:
        pyins.strapdown.Integrator(start, with_altitude=False).integrate(increments)

    still, none, steps = np.zeros(samples), np.zeros(3), np.full(samples, dt)

    def ours() -> None:
        s = strapdown.StrapdownState(np.radians(40.0), np.radians(121.0), 0.0, np.zeros(3), np.eye(3))
        strapdown.strapdown_slaved(s.nav, s.dtheta_prev, s.dv_prev, rate, force, steps, none, none, s.sums, still, still)

    for work in (theirs, ours):
        work()
    return seconds(ours, repetitions) / samples * 1e6, seconds(theirs, repetitions) / samples * 1e6


def choices(name: str) -> tuple[str, ...]:
    """Allowed words of a setting of the pipeline."""
    return next(field.metadata["choices"] for field in dataclasses.fields(FusionConfig) if field.name == name)


def main() -> int:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--samples", type=int, default=20_000, help="samples of each measurement")
    parser.add_argument("--repetitions", type=int, default=5, help="of which the median counts")
    given = parser.parse_args()
    console = Console(width=130)
    missed: list[str] = []
    heads = ("method", "n = 6, us", "n = 12, us", "NumPy n = 6", "NumPy n = 12", "differ by")
    table = Table(*heads, title=f"One kind of sensor, blocks of {BLOCK}, CPU time a sample, median of {given.repetitions}")
    cases = {n: parity_cases(array) | fusion_cases(array) | drift_cases(array) for n, array in ARRAYS.items()}
    for name in cases[6]:
        results = [measure(cases[n][name], n, given.samples, given.repetitions) for n in ARRAYS]
        apart = max(r[2] for r in results)
        words = [f"{results[0][0]:.2f}", f"{results[1][0]:.2f}", *("-" if np.isnan(r[1]) else f"{r[1]:.0f}" for r in results)]
        table.add_row(name, *words, "-" if np.isnan(apart) else f"{apart:.0e}")
        if apart > 1e-6:
            missed.append(f"{name}: the NumPy code gives other answers, {apart:.1e} apart")
    console.print(table)
    ours, theirs = strapdown_costs(given.samples, given.repetitions)
    console.print(f"strapdown in the same run: ours {ours:.2f} us, pyins {theirs:.2f} us a sample", highlight=False)

    heads = ("pipeline", "n = 6, us", "n = 12, us", "limit", "NumPy n = 6", "NumPy n = 12", "12 h at n = 6, s")
    whole = Table(*heads, title="FusionPipeline: gyros and accelerometers, faults tested, health, output (NumPy: fusion and test alone)")
    rows: list[tuple[str, dict[str, Any], int, dict[str, bool]]] = []
    for field in ("method", "parity_test", "sequential_test"):
        rows += [(f"{field}: {word}", {"method": "wls", field: word}, BLOCK, {}) for word in choices(field)]
    rows += [
        ("wls, adapt_noise", {"method": "wls", "adapt_noise": True}, BLOCK, {}),
        ("default, one gyro lies", {}, BLOCK, {"faulty": True}),
        ("default, 10 Hz status", {}, BLOCK, {"statuses": True}),
        ("default, one by one, 10 Hz status, as live", {}, 1, {"statuses": True}),
    ]
    for name, settings, block, more in rows:
        samples = given.samples if block > 1 else given.samples // 4
        each = [pipeline_cost(settings, n, samples, block, given.repetitions, **more) for n in ARRAYS]
        word = name.removeprefix("method: ")
        limit = LIMITS.get(word)
        if limit is not None and max(each) > limit:
            missed.append(f"{name}: {max(each):.2f} us of {limit:g}")
        slow = [numpy_cost(array, word, given.samples // 20, given.repetitions) for array in ARRAYS.values()] if limit else []
        words = [f"{value:.2f}" for value in each], [f"{value:.0f}" for value in slow] or ["", ""]
        whole.add_row(name, *words[0], f"{limit:g}" if limit else "", *words[1], f"{each[0] * VOYAGE * 1e-6:.1f}")
    console.print(whole)
    for line in missed:
        console.print(f"missed: {line}", style="red", highlight=False)
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
