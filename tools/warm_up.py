"""Compiles every kernel once, into the cache beside the installed modules: the largest ones side by side, then all that a user's commands need.

Lives here: nothing else. Runs in the workspace's environment; tools/setup.py calls it when the source has changed.
"""

from __future__ import annotations

import dataclasses
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

SECONDS = 40.0
PARTS = ("fusion", "ship")
"""About equal in compiling time; each runs in a process of its own."""


def warm_fusion() -> None:
    """The kernels of the redundant inertial sensors."""
    from riins_imu_fusion.config import FusionConfig
    from riins_imu_fusion.pipeline import FusionPipeline

    config = FusionConfig()
    FusionPipeline(config).warm_up()
    other = dataclasses.replace(config, method="irfdc", sequential_test="glr")  # what a switch while running must not wait for
    FusionPipeline(other).warm_up()


def warm_ship() -> None:
    """The kernels of the simulator and of the navigator."""
    from riins_federated.navigator import Navigator
    from riins_sim import scenario as scenarios
    from riins_sim.sensors import DopplerSim, PositionSim, RedundantImuSim
    from riins_sim.trajectory import Trajectory

    Navigator.warm_up()
    scenario = scenarios.load("harbour")
    trajectory = Trajectory(scenario)
    trajectory.truth(np.arange(1.0, 3.0))
    RedundantImuSim(scenario, trajectory).block(1, 100)
    PositionSim(scenario, "gps", trajectory).block(1, 2)
    DopplerSim(scenario, trajectory).block(1, 2)


def sail_and_report() -> None:
    """Sail, navigate from the bag, score, report: what a user does, in small."""
    from riins_eval import offline
    from riins_eval.bag_record import read_record
    from riins_eval.report import write_report
    from riins_sim import scenario as scenarios

    short = dataclasses.replace(scenarios.load("harbour"), duration_s=SECONDS)
    with tempfile.TemporaryDirectory() as folder:
        bag = Path(folder) / "bag"
        offline.sail(short, bag=bag, record="all")
        offline.navigate(bag, Path(folder) / "again")
        write_report(read_record(bag, twins=False), Path(folder) / "report")


def main(arguments: list[str]) -> int:
    """Without an argument everything; with one of PARTS that alone."""
    if arguments:
        {"fusion": warm_fusion, "ship": warm_ship}[arguments[0]]()
        return 0
    others = [subprocess.Popen([sys.executable, __file__, part]) for part in PARTS]
    failed = [part for part, other in zip(PARTS, others, strict=True) if other.wait()]
    if failed:
        print(f"error: {' and '.join(failed)} did not compile", file=sys.stderr)
        return 1
    sail_and_report()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
