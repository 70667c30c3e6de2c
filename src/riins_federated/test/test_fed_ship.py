"""Ships that are nothing but YAML: the navigator with declared aids and assembled states, flown against drawn errors of every state (NEES)."""

from __future__ import annotations

import functools
from typing import Any, NamedTuple

import numpy as np
import pytest
import yaml
from scipy.stats import chi2

from riins_core.earth import radii_s
from riins_core.frames import ned_offset
from riins_core.rotation import dcm_from_euler, euler_from_dcm, exp_so3, log_so3
from riins_core.settings import build
from riins_federated.config import NavigatorConfig
from riins_federated.integrated_filter import IntegratedFilter
from riins_federated.navigator import Navigator
from riins_federated.types import Aid, InitialState
from riins_sim.scenario import from_yaml
from riins_sim.sensors import RedundantImuSim
from riins_sim.trajectory import Trajectory

VOYAGE = """
name: turning
duration_s: 60.0
start: {latitude_deg: 40.0, longitude_deg: 120.0, height_m: 5.0, speed_kn: 10.0, heading_deg: 60.0}
legs: [{straight_s: 5.0}, {turn_deg: 100.0, rate_deg_s: 3.0}, {speed_kn: 16.0, acceleration_mps2: 0.3}, {turn_deg: -60.0, rate_deg_s: 3.0}]
sea: {significant_wave_height_m: 2.0, peak_period_s: 8.0, direction_deg: 200.0}
imu: {gyro: {constant_drift_deg_h: 0.0, arw_deg_sqrt_h: 0.0}, accel: {bias_ug: 0.0, vrw_ug_sqrt_hz: 0.0}}
"""
SHIP = """
states: [gyro_markov, gyro_scale, accel_scale]
inertial: {gyro_bias_deg_h: 5.0, gyro_markov_deg_h: 3.0, gyro_markov_time_s: 300.0, gyro_arw_deg_sqrt_h: 0.05, gyro_scale_ppm: 2000.0,
           accel_bias_ug: 500.0, accel_vrw_ug_sqrt_hz: 50.0, accel_scale_ppm: 1000.0}
height: {enabled: false}
aids: [bow, stern, dvl, compass]
bow: {type: gnss_position, topic: /bow/fix, lever_arm_m: [20.0, 1.0, -12.0], sigma_m: [1.0, 1.0, 2.0], use_height: true,
      markov_sigma_m: 1.5, markov_time_s: 60.0, markov_state: true, period_s: 1.0, timeout_s: 3.5}
stern: {type: gnss_position, lever_arm_m: [-30.0, 0.0, -15.0], lever_sigma_m: 0.5, delay_sigma_s: 0.1, sigma_m: [1.0, 1.0, 2.0], use_height: true,
        markov_sigma_m: 1.5, markov_time_s: 60.0, markov_state: true, period_s: 1.0, timeout_s: 3.5}
dvl: {type: beam_velocity, lever_arm_m: [10.0, 0.0, 4.0], sigma_mps: 0.03, misalignment_deg: 1.0, misalignment_pitch_deg: 1.0, scale_ppm: 5000.0,
      period_s: 1.0, timeout_s: 3.5}
compass: {type: heading, frame: compass_link, sigma_deg: 0.3, deviation_deg: 1.0, period_s: 1.0, timeout_s: 3.5, false_alarm_probability: 1.0e-6}
"""
STATES_24 = """
states: [gyro_markov, gyro_scale, accel_scale]
inertial: {gyro_bias_deg_h: 5.0, gyro_markov_deg_h: 3.0, gyro_markov_time_s: 300.0, gyro_arw_deg_sqrt_h: 0.05, gyro_scale_ppm: 2000.0,
           accel_bias_ug: 500.0, accel_vrw_ug_sqrt_hz: 50.0, accel_scale_ppm: 1000.0}
height: {enabled: false}
gps: {use_height: true, sigma_m: [1.0, 1.0, 2.0], period_s: 1.0, timeout_s: 3.5}
bds: {use_height: true, sigma_m: [2.0, 2.0, 4.0], lever_arm_m: [-8.0, 0.0, -10.0], period_s: 1.0, timeout_s: 3.5}
doppler: {use_down: true, misalignment_deg: 0.0, sigma_mps: [0.05, 0.05, 0.05], period_s: 1.0, timeout_s: 3.5}
"""
SENSORS = STATES_24[: STATES_24.index("gps:")]
STATES_36 = f"""{SENSORS}
aids: [gps, gps_velocity, dvs]
gps: {{type: gnss_position, use_height: true, sigma_m: [1.0, 1.0, 2.0], markov_sigma_m: 1.5, markov_time_s: 60.0, markov_state: true, period_s: 1.0,
      timeout_s: 3.5}}
gps_velocity: {{type: gnss_velocity, sigma_mps: [0.1, 0.1, 0.2], markov_sigma_mps: 0.1, markov_time_s: 60.0, markov_state: true, period_s: 1.0,
               timeout_s: 3.5}}
dvs: {{type: body_velocity, use_down: true, misalignment_deg: 0.0, scale_ppm: 5000.0, scale_each_axis: true, sigma_mps: [0.05, 0.05, 0.05],
      markov_sigma_mps: 0.1, markov_time_s: 60.0, markov_state: true, period_s: 1.0, timeout_s: 3.5}}
"""
WATER_LOCK = f"""{SENSORS}
aids: [gps, log]
gps: {{type: gnss_position, use_height: true, sigma_m: [1.0, 1.0, 2.0], period_s: 1.0, timeout_s: 3.5}}
log: {{type: water_velocity, use_down: true, misalignment_deg: 1.0, sigma_mps: [0.05, 0.05, 0.05], current_sigma_mps: 0.5, current_time_s: 600.0,
      period_s: 1.0, timeout_s: 3.5}}
"""
SIGMA = {"position": 5.0, "velocity": 0.2, "attitude": np.array([0.003, 0.003, 0.02])}


class Motion(NamedTuple):
    """True motion: at 100 Hz, and the mean rate and force of each sample."""

    stamp: np.ndarray
    rate: np.ndarray
    force: np.ndarray
    truth: Any


@functools.lru_cache
def motion() -> Motion:
    scenario = from_yaml(VOYAGE)
    trajectory = Trajectory(scenario)
    imu = RedundantImuSim(scenario, trajectory)
    block, W = imu.block(1, imu.samples), imu.array.least_squares()
    return Motion(block.stamp_ns, block.gyro @ W.T, block.accel @ W.T, trajectory.truth)


class Drawn:
    """The true errors of one voyage: of every state but position, velocity, attitude, drawn from what the filter believes."""

    def __init__(self, config: NavigatorConfig, seed: int) -> None:
        self.rng = np.random.default_rng(seed)
        self.states = IntegratedFilter(config).states
        n = self.states.n
        sigma = np.zeros(n)
        model = config.inertial
        sigma[9:12], sigma[12:15] = np.radians(model.gyro_bias_deg_h) / 3600.0, model.accel_bias_ug * 9.80665e-6
        sigma[15:] = self.states.initial_sigma()[15:]
        self.sigma = sigma
        self.x = sigma * self.rng.normal(size=n)
        self.history = [self.x.copy()]
        for _ in range(60):  # Markov states second by second
            kept = np.exp(-self.states.decay)
            self.history.append(kept * self.history[-1] + sigma * np.sqrt(1.0 - kept**2) * self.rng.normal(size=n))

    def at(self, name: str, second: int) -> np.ndarray:
        """A block, zero where it is off."""
        place = self.states.place(name)
        return np.zeros(3) if place is None else self.history[second][place]


def fly(config: NavigatorConfig, seed: int) -> tuple[float, Navigator]:
    """NEES of all states at the end of a voyage."""
    m, drawn = motion(), Drawn(config, seed)
    rng, states = drawn.rng, drawn.states
    second = np.minimum((m.stamp - 1) // 1_000_000_000, 59).astype(int)
    table = np.array(drawn.history)[second]

    def part(name: str) -> np.ndarray:
        place = states.place(name)
        return np.zeros((len(second), 3)) if place is None else table[:, place]

    model, hertz = config.inertial, 10.0
    white_g = rng.normal(size=m.rate.shape) * np.radians(model.gyro_arw_deg_sqrt_h) / 60.0 * hertz
    white_a = rng.normal(size=m.rate.shape) * model.accel_vrw_ug_sqrt_hz * 9.80665e-6 * hertz
    rate = (1.0 + part("gyro_scale")) * m.rate + table[:, 9:12] + part("gyro_markov") + white_g
    force = (1.0 + part("accel_scale")) * m.force + table[:, 12:15] + white_a

    truth = m.truth(np.zeros(1))
    start = SIGMA["position"] * rng.normal(size=3)
    lat, lon, h = (float(v) for v in ned_offset(truth.lat[0], truth.lon[0], truth.h[0], start))
    C = exp_so3(-SIGMA["attitude"] * rng.normal(size=3)) @ truth.C_nb[0]
    velocity = truth.v_n[0] + SIGMA["velocity"] * rng.normal(size=3)
    ones, rph = np.ones(3), np.ravel(euler_from_dcm(C))
    navigator = Navigator(config)
    initial = InitialState(0, lat, lon, h, velocity, rph, SIGMA["position"] * ones, SIGMA["velocity"] * ones, SIGMA["attitude"])
    assert navigator.set_initial_state(initial) == ""
    for k in range(1, 60):
        for aid in aids(config, drawn, m, k):
            navigator.add_aid(aid)
    navigator.add_imu(m.stamp, np.arange(1, len(m.stamp) + 1), rate, force)
    return nees(navigator, drawn, m), navigator


def aids(config: NavigatorConfig, drawn: Drawn, m: Motion, k: int) -> list[Aid]:
    """What the sensors say at second k."""
    found = []
    for name, s in config.aid.items():
        delay = float(drawn.at(f"{name}.delay", k)[0])
        t = m.truth(np.array([k - delay]))
        C, v_n, rate = t.C_nb[0], t.v_n[0], t.rate_nb_b[0]
        lever = np.array(getattr(s, "lever_arm_m", (0.0, 0.0, 0.0))) + drawn.at(f"{name}.lever", k)
        noise = drawn.rng.normal(size=4)
        if s.type == "gnss_position":
            z = np.array(ned_offset(t.lat[0], t.lon[0], t.h[0], C @ lever + drawn.at(f"{name}.markov", k) + noise[:3] * s.sigma_m))
            R = np.zeros((3, 3))
        elif s.type == "gnss_velocity":
            z, R = v_n + C @ np.cross(rate, lever) + drawn.at(f"{name}.markov", k) + noise[:3] * s.sigma_mps, np.zeros((3, 3))
        elif s.type in ("body_velocity", "water_velocity"):
            water = np.resize(np.append(drawn.at(f"{name}.current", k)[:2], 0.0), 3)
            v = dcm_from_euler(0.0, 0.0, drawn.at(f"{name}.yaw", k)[0]).T @ (C.T @ (v_n - water) + np.cross(rate, lever))
            z = (1.0 + drawn.at(f"{name}.scale", k)) * v + drawn.at(f"{name}.markov", k) + noise[:3] * s.sigma_mps
            R = np.zeros((3, 3))
        elif s.type == "beam_velocity":
            yaw, pitch, scale = (drawn.at(f"{name}.{state}", k)[0] for state in ("yaw", "pitch", "scale"))
            v = dcm_from_euler(0.0, pitch, yaw).T @ (C.T @ v_n + np.cross(rate, lever))
            angle, azimuth = np.radians(s.beam_angle_deg), np.radians(s.beam_azimuth_deg)
            along = np.column_stack([np.sin(angle) * np.cos(azimuth), np.sin(angle) * np.sin(azimuth), np.full(4, np.cos(angle))])
            z, R = (1.0 + scale) * (along @ v) + noise * s.sigma_mps, np.zeros((4, 4))
            z[k % 4] = np.where(k % 3, np.nan, z[k % 4])  # a beam is lost now and then
        else:
            heading = np.arctan2(C[1, 0], C[0, 0]) + drawn.at(f"{name}.deviation", k)[:1]
            z, R = heading + noise[:1] * np.radians(s.sigma_deg), np.zeros((1, 1))
        found.append(Aid(name, k * 1_000_000_000, z, R))
    return found


def nees(navigator: Navigator, drawn: Drawn, m: Motion) -> float:
    """Squared error of all states against the covariance, at the last sample."""
    flt, states = navigator._filter, drawn.states
    nav, parameters, P = flt._running().nav.copy(), flt._running().parameters.copy(), flt._structure.P
    states.correct(nav, parameters, flt._structure.x)
    t = m.truth(np.array([flt.stamp_ns * 1e-9]))
    r_m, r_n = radii_s(t.lat[0])
    position = [(nav[0] - t.lat[0]) * (r_m + t.h[0]), (nav[1] - t.lon[0]) * (r_n + t.h[0]) * np.cos(t.lat[0]), t.h[0] - nav[2]]
    phi = log_so3(t.C_nb[0] @ nav[6:15].reshape(3, 3).T)
    x = np.concatenate([position, nav[3:6] - t.v_n[0], phi, states.sign * (drawn.history[59][9:] - parameters)])
    scale = np.sqrt(np.diag(P))
    return float(x / scale @ np.linalg.solve(P / np.outer(scale, scale), x / scale))


@pytest.mark.parametrize(
    ("text", "n", "seeds"),
    [(STATES_24, 24, 8), (STATES_36, 36, 4), (WATER_LOCK, 27, 4), (SHIP, 38, 8)],
    ids=["24 states of 002", "24, GPS 6 and DVS 6 of 002", "water lock in a current", "two GNSS, DVL, compass"],
)
def test_nees_of_all_states_of_a_filter_that_is_only_declared(text: str, n: int, seeds: int) -> None:
    config = build(NavigatorConfig, yaml.safe_load(text))
    runs = [fly(config, seed) for seed in range(seeds)]
    assert len(runs[0][1].labels) == n
    total = sum(value for value, _ in runs)
    low, high = chi2.ppf([0.001, 0.999], n * len(runs))
    assert low < total < high, total / n / len(runs)
    for _, navigator in runs:
        for sub in navigator.status().subfilters:
            assert sub.accepted >= 58 and sub.malformed == 0
