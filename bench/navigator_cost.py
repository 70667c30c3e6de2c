"""Cost of the whole navigator in microseconds an IMU sample: 100 Hz, three aids at 1 Hz, every structure, beside the same in NumPy alone.

Lives here: the timing and its table; `./riins exec python bench/navigator_cost.py [--seconds 60]`, exit status 1 when the limit is missed.
Does not live here: the navigator (riins_federated), the same without compiled code (numpy_navigator.py).
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
import time
from typing import Any

import numpy as np
from numpy_navigator import without_kernels
from rich.console import Console
from rich.table import Table

from riins_core.rotation import log_so3
from riins_eval.configure import navigator_config
from riins_federated.config import NavigatorConfig
from riins_federated.navigator import Navigator
from riins_federated.types import Aid, InitialState, NavSolution
from riins_sim.initial import initial_state
from riins_sim.scenario import ScoringSettings, load
from riins_sim.sensors import DopplerSim, PositionSim, RedundantImuSim
from riins_sim.trajectory import Trajectory

LIMIT = 5.0
"""Microseconds a sample, of the default structure."""
BLOCK = 1000
"""Samples that are fed at once, as the offline engine does."""
SCENARIO = "voyage_12h"
"""Whose sensors it has, but for the period of the aids and the faults."""


@dataclasses.dataclass
class Voyage:
    """Samples of a perfect IMU, aids in order of stamp, and where it begins."""

    stamp: Any
    rate: Any
    force: Any
    aids: list[Aid]
    initial: InitialState
    config: NavigatorConfig


def voyage(seconds: int) -> Voyage:
    """Simulate."""
    scenario = load(SCENARIO)
    often = {name: dataclasses.replace(getattr(scenario, name), period_s=1.0) for name in ("gps", "bds", "doppler")}
    scenario = dataclasses.replace(scenario, duration_s=float(seconds), faults=(), outages=(), scoring=ScoringSettings(), **often)
    path = Trajectory(scenario)
    imu = RedundantImuSim(scenario, path)
    block, W = imu.block(1, imu.samples), imu.array.least_squares()
    log = DopplerSim(scenario, path)
    speeds = log.block(1, log.samples)
    aids = [Aid("doppler", int(t), v, speeds.covariance) for t, v in zip(speeds.stamp_ns, speeds.v_b, strict=True)]
    for name in ("gps", "bds"):
        receiver = PositionSim(scenario, name, path)
        fixes = receiver.block(1, receiver.samples)
        aids += [Aid(name, int(t), np.array(z), fixes.covariance) for t, *z in zip(fixes.stamp_ns, fixes.lat, fixes.lon, fixes.h, strict=True)]
    drawn = initial_state(scenario, path)
    names = [f.name for f in dataclasses.fields(InitialState) if hasattr(drawn, f.name) and f.name != "source"]
    initial = InitialState(**{name: getattr(drawn, name) for name in names})
    aids.sort(key=lambda aid: aid.stamp_ns)
    return Voyage(block.stamp_ns, block.gyro @ W.T, block.accel @ W.T, aids, initial, navigator_config(scenario))


def sail(v: Voyage, **settings: Any) -> tuple[float, list[NavSolution], int]:
    """Seconds of processor time of a voyage, its settled states, and the number of error states."""
    navigator = Navigator(dataclasses.replace(v.config, **settings))
    navigator.set_initial_state(v.initial)
    sequence, due, settled = np.arange(len(v.stamp)), 0, []
    began = time.process_time()
    for k in range(0, len(v.stamp), BLOCK):
        part = slice(k, k + BLOCK)
        while due < len(v.aids) and v.aids[due].stamp_ns <= v.stamp[part][-1]:
            navigator.add_aid(v.aids[due])
            due += 1
        navigator.add_imu(v.stamp[part], sequence[part], v.rate[part], v.force[part])
        settled += navigator.drain_settled()
        navigator.drain_judged()
    took = time.process_time() - began
    return took, settled, len(settled[-1].P)


def apart(one: list[NavSolution], other: list[NavSolution]) -> tuple[float, float]:
    """Largest difference of position [m] and attitude [rad]."""
    metres = max(float(np.hypot((a.lat - b.lat) * 6.4e6, (a.lon - b.lon) * 6.4e6)) for a, b in zip(one, other, strict=True))
    return metres, max(float(np.linalg.norm(log_so3(a.C_nb @ b.C_nb.T))) for a, b in zip(one, other, strict=True))


def known_mounting(config: NavigatorConfig) -> dict[str, Any]:
    """The aids with a log whose mounting is known, so that the states are the 24 of seed 002."""
    return {**config.aid, "doppler": dataclasses.replace(config.aid["doppler"], misalignment_deg=0.0)}


def main() -> int:
    """Time, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=int, default=60, help="length of the voyage")
    parser.add_argument("--repeat", type=int, default=25, help="the fastest of so many is printed: others at work on the machine only slow it down")
    given = parser.parse_args()
    v, console = voyage(given.seconds), Console(width=130)
    samples = len(v.stamp)
    began = time.perf_counter()
    Navigator.warm_up()
    console.print(f"kernels ready after {time.perf_counter() - began:.1f} s")
    columns = ("structure", "masters", "states", "us / sample", "NumPy, us / sample", "ratio", "apart, m", "apart, rad")
    table = Table(*columns, title="100 Hz, three aids at 1 Hz")
    cases: dict[str, dict[str, Any]] = {
        "separated (the default)": {},
        "separated, 24 states": {"states": ("gyro_markov", "gyro_scale", "accel_scale"), "aid": known_mounting(v.config)},
        "separated, left_out 1": {"separation": dataclasses.replace(v.config.separation, left_out=1)},
        "information": {"structure": "information"},
        "fusion_reset": {"structure": "fusion_reset"},
        "no_reset": {"structure": "no_reset"},
    }
    masters = {"separated (the default)": "1 + 3 + 3", "separated, 24 states": "1 + 3 + 3", "separated, left_out 1": "1 + 3", "information": "1"}
    missed = False
    for name, settings in cases.items():
        sail(v, **settings)
        runs = [sail(v, **settings) for _ in range(given.repeat)]
        ours = min(run[0] for run in runs) / samples * 1e6
        with without_kernels():
            plain = sail(v, **settings)
        theirs = plain[0] / samples * 1e6
        metres, radians = apart(runs[0][1], plain[1])
        row = f"{ours:.2f}", f"{theirs:.1f}", f"{theirs / ours:.0f}", f"{metres:.1e}", f"{radians:.1e}"
        table.add_row(name, masters.get(name, "1 + 4 local"), str(plain[2]), *row)
        missed |= not settings and ours > LIMIT
    console.print(table)
    return int(missed)


if __name__ == "__main__":
    sys.exit(main())
