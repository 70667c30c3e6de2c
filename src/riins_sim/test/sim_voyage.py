"""The small voyage of riins_sim's tests, faults for it, and how far the strapdown on a trajectory's increments gets from it.

Lives here: `BASE`, `FAULTS`, `close`.
Does not live here: fixtures (conftest.py).
"""

import numpy as np

from riins_core.earth import radii
from riins_core.rotation import log_so3
from riins_core.strapdown import StrapdownState, strapdown_slaved
from riins_sim.trajectory import Trajectory

BASE = {
    "name": "test",
    "duration_s": 400.0,
    "seed": 3,
    "start": {"latitude_deg": 40.0, "longitude_deg": 121.0, "height_m": 5.0, "speed_kn": 15.0, "heading_deg": 30.0},
    "legs": [{"straight_s": 60.0}, {"turn_deg": 90.0, "rate_deg_s": 1.0}, {"straight_s": 40.0}, {"speed_kn": 8.0, "acceleration_mps2": 0.05}],
    "sea": {"significant_wave_height_m": 3.5, "peak_period_s": 8.5, "direction_deg": 75.0},
    "imu": {
        "gyro": {"constant_drift_deg_h": 0.02, "markov_drift_deg_h": 0.01, "markov_time_s": 100.0, "arw_deg_sqrt_h": 0.003},
        "accel": {"bias_ug": 100.0, "vrw_ug_sqrt_hz": 20.0},
    },
    "gps": {"period_s": 1.0, "sigma_m": [2.0, 3.0, 4.0], "markov_sigma_m": 1.0, "markov_time_s": 30.0, "lever_arm_m": [-8.0, 2.0, -12.0]},
    "doppler": {"period_s": 1.0, "misalignment_deg": 0.5, "scale_ppm": 1000.0, "lever_arm_m": [15.0, 0.0, 3.0]},
}

FAULTS = [
    {"target": "gyro_1", "type": "noise", "size_deg_h": 20.0, "start_s": 5.0},
    {"target": "gyro_1", "type": "stuck", "start_s": 10.0, "end_s": 15.0},
    {"target": "accel_3", "type": "dropout", "start_s": 7.0, "end_s": 9.0},
    {"target": "gps", "type": "ramp", "slope_mps": 1.0, "start_s": 20.0},
    {"target": "gps", "type": "stuck", "start_s": 100.0, "end_s": 120.0},
    {"target": "doppler", "type": "scale", "size_percent": 10.0, "start_s": 50.0},
    {"target": "doppler", "type": "stuck", "axis": "forward", "start_s": 200.0},
]


def close(trajectory: Trajectory, seconds: float) -> tuple[float, float]:
    """Largest horizontal distance [m] and heading error [arcsec] of the strapdown fed with exact increments; height slaved to the truth."""
    start = trajectory.truth(0.0)
    state = StrapdownState(float(start.lat[0]), float(start.lon[0]), float(start.h[0]), start.v_n[0], start.C_nb[0])
    zero, block = np.zeros(3), 6000
    distance = heading = 0.0
    for k0 in range(1, round(seconds / trajectory.dt) + 1, block):
        rate, force = trajectory.increments(k0, block)
        truth = trajectory.truth(np.arange(k0, k0 + block) * trajectory.dt)
        dt = np.full(block, trajectory.dt)
        strapdown_slaved(state.nav, state.dtheta_prev, state.dv_prev, rate, force, dt, zero, zero, state.sums, truth.h, truth.v_n[:, 2])
        r_m, r_n = radii(truth.lat[-1])
        north, east = (state.nav[0] - truth.lat[-1]) * float(r_m), (state.nav[1] - truth.lon[-1]) * float(r_n) * np.cos(truth.lat[-1])
        distance = max(distance, float(np.hypot(north, east)))
        error = log_so3(state.c_nb @ truth.C_nb[-1].T)
        heading = max(heading, abs(np.rad2deg(error[2]) * 3600.0))
    return distance, heading
