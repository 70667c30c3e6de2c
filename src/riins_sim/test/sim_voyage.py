"""The small voyage of riins_sim's tests, and faults for it.

Lives here: `BASE`, `FAULTS`.
Does not live here: fixtures (conftest.py).
"""

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
