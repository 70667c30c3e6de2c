"""A short simulated voyage for the tests of riins_federated: samples of the fused IMU and of the aids, as plain arrays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from riins_core.rotation import euler_from_dcm
from riins_core.settings import build
from riins_federated.config import NavigatorConfig
from riins_federated.navigator import Navigator
from riins_federated.types import Aid, InitialState
from riins_sim.scenario import from_yaml
from riins_sim.sensors import DopplerSim, PositionSim, RedundantImuSim
from riins_sim.trajectory import Trajectory

YAML = """
name: short
seed: 3
duration_s: 60.0
start: {latitude_deg: 40.0, longitude_deg: 120.0, height_m: 5.0, speed_kn: 10.0, heading_deg: 60.0}
legs: [{straight_s: 10.0}, {turn_deg: 60.0, rate_deg_s: 3.0}]
sea: {significant_wave_height_m: 2.0, peak_period_s: 8.0, direction_deg: 200.0}
imu:
  gyro: {constant_drift_deg_h: 0.05, arw_deg_sqrt_h: 0.005}
  accel: {bias_ug: 100.0, vrw_ug_sqrt_hz: 20.0}
gps: {period_s: 1.0, sigma_m: [2.0, 2.0, 4.0], lever_arm_m: [-8.0, 1.0, -10.0]}
bds: {period_s: 1.0, sigma_m: [4.0, 4.0, 8.0], lever_arm_m: [-8.0, -1.0, -10.0]}
doppler: {period_s: 0.5, sigma_kn: [0.1, 0.1, 0.1], misalignment_deg: 0.2, lever_arm_m: [15.0, 0.0, 3.0]}
"""


@dataclass(frozen=True)
class Voyage:
    """stamp (m,), rate and force (m, 3); aids in order of stamp; initial state; trajectory and true log misalignment."""

    stamp: np.ndarray
    sequence: np.ndarray
    rate: np.ndarray
    force: np.ndarray
    aids: list[Aid]
    initial: InitialState
    trajectory: Trajectory
    misalignment: float


def voyage(start_ns: int = 0) -> Voyage:
    """The voyage, with measurement time 0 at `start_ns`."""
    scenario = from_yaml(YAML)
    trajectory = Trajectory(scenario)
    imu = RedundantImuSim(scenario, trajectory)
    W = imu.array.least_squares()
    block = imu.block(1, imu.samples)
    aids = []
    for name in ("gps", "bds"):
        sim = PositionSim(scenario, name, trajectory)
        fixes = sim.block(1, sim.samples)
        aids += [
            Aid(name, int(t) + start_ns, np.array(z), fixes.covariance) for t, *z in zip(fixes.stamp_ns, fixes.lat, fixes.lon, fixes.h, strict=True)
        ]
    log = DopplerSim(scenario, trajectory)
    speeds = log.block(1, log.samples)
    aids += [Aid("doppler", int(t) + start_ns, v, speeds.covariance) for t, v in zip(speeds.stamp_ns, speeds.v_b, strict=True)]
    aids.sort(key=lambda aid: aid.stamp_ns)
    truth = trajectory.truth(np.zeros(1))
    rng = np.random.default_rng(1)
    sigma_position, sigma_velocity, sigma_attitude = np.array([5.0, 5.0, 2.0]), np.full(3, 0.1), np.array([1.5e-4, 1.5e-4, 2e-3])
    rph = np.ravel(euler_from_dcm(truth.C_nb[0])) + rng.normal(size=3) * sigma_attitude
    initial = InitialState(
        start_ns,
        float(truth.lat[0]) + 3.0 / 6.37e6,
        float(truth.lon[0]),
        float(truth.h[0]),
        truth.v_n[0] + 0.05,
        rph,
        sigma_position,
        sigma_velocity,
        sigma_attitude,
        source="test",
    )
    sequence = np.arange(1, imu.samples + 1)
    return Voyage(block.stamp_ns + start_ns, sequence, block.gyro @ W.T, block.accel @ W.T, aids, initial, trajectory, log.true_misalignment)


def config(**over: object) -> NavigatorConfig:
    """Settings that know the voyage's sensors."""
    base: dict[str, object] = {
        "inertial": {
            "gyro_bias_deg_h": 0.035,
            "gyro_markov_deg_h": 0.0,
            "gyro_arw_deg_sqrt_h": 0.0035,
            "accel_bias_ug": 71.0,
            "accel_vrw_ug_sqrt_hz": 14.0,
        },
        "gps": {"lever_arm_m": [-8.0, 1.0, -10.0], "timeout_s": 3.5, "period_s": 1.0},
        "bds": {"lever_arm_m": [-8.0, -1.0, -10.0], "timeout_s": 3.5, "period_s": 1.0},
        "doppler": {"misalignment_deg": 0.4, "lever_arm_m": [15.0, 0.0, 3.0], "timeout_s": 3.5, "period_s": 0.5},
        "height": {"mean_m": 5.0},
        "isolation": {"hold_s": 5.0},
    }
    for section, values in over.items():
        base[section] = {**base.get(section, {}), **values} if isinstance(values, dict) else values  # type: ignore[dict-item]
    return build(NavigatorConfig, base)


def run(v: Voyage, navigator: Navigator, aids: list[Aid] | None = None, cuts: tuple[int, ...] = ()) -> Navigator:
    """Feed everything: aids first, then the IMU in blocks cut at the given samples."""
    navigator.set_initial_state(v.initial)
    for aid in v.aids if aids is None else aids:
        navigator.add_aid(aid)
    for part in np.split(np.arange(len(v.stamp)), cuts):
        navigator.add_imu(v.stamp[part], v.sequence[part], v.rate[part], v.force[part])
    navigator.finish()
    return navigator
