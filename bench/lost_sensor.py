"""A gyro and an accelerometer die for good after twenty minutes: consistency and errors of the last forty, with and without process noise that
follows the covariance of the fused samples (`navigator: {inertial: {follow_covariance: ...}}`).

Run: `python bench/lost_sensor.py [--seeds N]` in the workspace's environment; prints a table.
"""

from __future__ import annotations

import argparse
import dataclasses

import numpy as np

from riins_eval import offline
from riins_sim.scenario import from_yaml

SCENARIO = """
name: loss
description: A gyro and an accelerometer stick after twenty minutes, when the biases of the whole set have been learned.
duration_s: 3600
start: {latitude_deg: 40, longitude_deg: 121, speed_kn: 10, heading_deg: 30}
legs: [{straight_s: 600}, {turn_deg: 90, rate_deg_s: 0.5}, {straight_s: 900}, {turn_deg: -90, rate_deg_s: 0.5}]
sea: {significant_wave_height_m: 1.0, peak_period_s: 6}
imu: {gyro: {constant_drift_deg_h: 0.3, arw_deg_sqrt_h: 0.01}, accel: {bias_ug: 300, vrw_ug_sqrt_hz: 15}}
gps: {period_s: 1, sigma_m: [2, 2, 4], lever_arm_m: [-5, 1, -8]}
bds: {period_s: 2, sigma_m: [4, 4, 8]}
doppler: {period_s: 1, lever_arm_m: [10, 0, 2], misalignment_deg: 0.1}
initial: {position_m: 3, tilt_arcsec: 40, heading_arcmin: 20}
faults:
  - {target: gyro_4, type: stuck, start_s: 1200}
  - {target: accel_2, type: stuck, start_s: 1200}
scoring: {from_s: 1260}
"""
NAMES = ("nees_per_dof", "heading_rms_arcmin", "velocity_rms_mps", "position_rms_m")


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=10)
    seeds = range(1, parser.parse_args().seeds + 1)
    base = from_yaml(SCENARIO)
    print(f"| follow_covariance | {' | '.join(NAMES)} |, mean (max) of {len(seeds)} seeds")
    for follow in (False, True):
        scenario = dataclasses.replace(base, navigator={"inertial": {"follow_covariance": follow}})
        rows = np.array([[offline.sail(scenario, seed=seed, twins=False).score[name] for name in NAMES] for seed in seeds])
        print(f"| {follow} | {' | '.join(f'{mean:.3f} ({worst:.3f})' for mean, worst in zip(rows.mean(0), rows.max(0), strict=True))} |")


if __name__ == "__main__":
    main()
