"""The redundant IMU is silent for a while, twice on the way in sea state 5: errors and consistency behind it, and aids blamed for it.

Run: `python bench/imu_gaps.py [--seeds N]` in the workspace's environment; prints a table.
"""

from __future__ import annotations

import argparse
import dataclasses

import numpy as np

from riins_core.settings import build
from riins_eval import offline
from riins_sim.scenario import OutageSettings, load

LENGTHS = (0.0, 0.05, 0.5, 1.5, 5.0, 18.0)
NAMES = ("position_rms_m", "velocity_rms_mps", "heading_rms_arcmin", "tilt_rms_arcmin", "nees_per_dof")


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=10)
    seeds = range(1, parser.parse_args().seeds + 1)
    base = dataclasses.replace(load("voyage_2h"), duration_s=1000.0, faults=(), outages=())
    print(f"| silent, s | {' | '.join(NAMES)} | isolated wrongly |, mean (max) of {len(seeds)} seeds")
    for length in LENGTHS:
        silent = [build(OutageSettings, {"target": "imu", "start_s": t, "end_s": t + length}) for t in (200.0, 600.0) if length]
        scores = [offline.sail(dataclasses.replace(base, outages=tuple(silent)), seed=seed, twins=False).score for seed in seeds]
        rows = np.array([[score[name] for name in NAMES] for score in scores])
        values = " | ".join(f"{mean:.3f} ({worst:.3f})" for mean, worst in zip(rows.mean(0), rows.max(0), strict=True))
        print(f"| {length:g} | {values} | {sum(score['false_isolations'] for score in scores)} |", flush=True)


if __name__ == "__main__":
    main()
