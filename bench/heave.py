"""Heave of the node `motion` in simulated seas, from the navigator's own state: error against the truth, its sigma, time until it is valid.

Lives here: the table; `./riins exec python bench/heave.py [--minutes 15]`, exit status 1 when valid heave is out by more than 5 cm or 5 % (RMS).
Does not live here: the filter (riins_nmea.heave), its tests. The navigator is that of a scenario; GNSS and log as the scenario has them.
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
from types import SimpleNamespace

import numpy as np
import yaml
from rich.console import Console
from rich.table import Table

from riins_core.settings import as_mapping
from riins_eval import configure
from riins_federated.navigator import Navigator
from riins_federated.types import Aid, InitialState
from riins_nmea.motion import VALID, MotionConfig, MotionEstimator
from riins_node import fields
from riins_node.readings import read_nav_state
from riins_sim import scenario as scenarios
from riins_sim.initial import initial_state
from riins_sim.sensors import PositionSim, RedundantImuSim
from riins_sim.trajectory import Trajectory

SEAS = ((1.0, 5.0, 30.0), (3.0, 8.0, 50.0), (6.0, 14.0, 100.0))
"""Significant wave height [m], peak period [s], length of the ship [m]."""
POINTS = ((0.0, 0.0, 0.0), (40.0, 0.0, -3.0))


def sail(height: float, period: float, length: float, seconds: float) -> tuple[list[dict], Trajectory]:
    """States of the navigator at the IMU rate, without a fault, on a course with two turns."""
    made = as_mapping(scenarios.load("harbour"))
    legs = [{"straight_s": 300.0}, {"turn_deg": 90.0, "rate_deg_s": 1.5}]
    made |= {"duration_s": seconds, "imu_rate_hz": 50, "legs": legs * 2, "faults": [], "outages": [], "expect": {}}
    made["sea"] |= {"significant_wave_height_m": height, "peak_period_s": period}
    made["vessel"] |= {"length_m": length}
    ship = scenarios.from_yaml(yaml.safe_dump(made))
    trajectory = Trajectory(ship)
    imu, gps = RedundantImuSim(ship, trajectory), PositionSim(ship, "gps", trajectory)
    navigator = Navigator(configure.navigator_config(ship))
    drawn = initial_state(ship, trajectory)
    navigator.set_initial_state(InitialState(**{f.name: getattr(drawn, f.name) for f in dataclasses.fields(InitialState) if hasattr(drawn, f.name)}))
    block, W = imu.block(1, imu.samples), imu.array.least_squares()
    rate, force = block.gyro @ W.T, block.accel @ W.T
    fixes = gps.block(1, gps.samples)
    states, fix = [], 0
    for k, stamp in enumerate(block.stamp_ns):
        navigator.add_imu(block.stamp_ns[k : k + 1], block.k[k : k + 1], rate[k : k + 1], force[k : k + 1])
        while fix < len(fixes.k) and fixes.stamp_ns[fix] <= stamp:
            z = np.array([fixes.lat[fix], fixes.lon[fix], fixes.h[fix]])
            navigator.add_aid(Aid("gps", int(fixes.stamp_ns[fix]), z, fixes.covariance))
            fix += 1
        if (head := navigator.head()) is not None:
            made = fields.nav_state(head, k)
            sec, nanosec = divmod(made["header"]["stamp"], 1_000_000_000)
            made["header"] = SimpleNamespace(stamp=SimpleNamespace(sec=sec, nanosec=nanosec))
            states.append(read_nav_state(SimpleNamespace(**made)))
    return states, trajectory


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=15.0)
    seconds = 60.0 * parser.parse_args().minutes
    table = Table(
        "Hs, Tp, ship", "point", "heave RMS, m", "error RMS while valid, m", "error / sigma", "valid after, s", "settled, RMS from 184 s, m"
    )
    bad = False
    for sea in SEAS:
        states, trajectory = sail(*sea, seconds)
        t = np.array([one["stamp_ns"] for one in states]) * 1e-9
        truth = trajectory.truth(t)
        for point in POINTS:
            estimator = MotionEstimator(MotionConfig(point_m=point))
            out = [estimator.add(one) for one in states]
            level = truth.h - truth.C_nb[:, 2] @ np.array(point)
            error = np.array([one.heave for one in out]) - (level - level.mean())
            valid, settled = np.array([one.heave_validity == VALID for one in out]), t - t[0] >= estimator.settling_s
            sigma = np.array([one.sigma_heave for one in out])
            rms = float(np.sqrt(np.mean(error[valid] ** 2))) if valid.any() else float("nan")
            bad |= not rms <= max(0.05, 0.05 * level.std())
            cells = [level.std(), rms, np.sqrt(np.mean((error / sigma)[settled] ** 2)), t[valid][0] if valid.any() else np.nan]
            cells.append(np.sqrt(np.mean(error[settled] ** 2)))
            formats = ("{:.2f}", "{:.3f}", "{:.2f}", "{:.0f}", "{:.3f}")
            table.add_row("{} m, {} s, {} m".format(*sea), str(point), *(f.format(c) for f, c in zip(formats, cells, strict=True)))
    Console(width=150).print(table)
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
