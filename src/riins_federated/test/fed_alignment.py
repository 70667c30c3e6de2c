"""A ship at a quay, or under way, for the alignment tests: fused samples and aids as plain arrays, and the feeding of a navigator."""

from __future__ import annotations

import functools

import numpy as np

from riins_core.settings import build
from riins_federated.config import NavigatorConfig
from riins_federated.navigator import Navigator
from riins_federated.types import Aid
from riins_sim.scenario import from_yaml
from riins_sim.sensors import DopplerSim, PositionSim, RedundantImuSim
from riins_sim.trajectory import Trajectory

SECOND = 1_000_000_000
START = 1_700_000_000 * SECOND
YAML = """
name: quay
seed: {seed}
duration_s: {duration}
imu_rate_hz: {rate}
start: {{latitude_deg: 40.0, longitude_deg: 120.0, height_m: 5.0, speed_kn: {speed}, heading_deg: 60.0}}
legs: [{{straight_s: {stay}}}, {legs}]
sea: {{significant_wave_height_m: {waves}, peak_period_s: 7.0, direction_deg: 200.0}}
imu:
  gyro: {{constant_drift_deg_h: 0.02, arw_deg_sqrt_h: 0.002}}
  accel: {{bias_ug: 100.0, vrw_ug_sqrt_hz: 20.0}}
gps: {{period_s: 1.0, sigma_m: [2.0, 2.0, 4.0], lever_arm_m: [-8.0, 1.0, -10.0]}}
bds: {{period_s: 1.0, sigma_m: [4.0, 4.0, 8.0], lever_arm_m: [-8.0, -1.0, -10.0]}}
doppler: {{period_s: 1.0, sigma_kn: [0.1, 0.1, 0.1], misalignment_deg: 0.1, lever_arm_m: [15.0, 0.0, 3.0]}}
"""


class Ship:
    """Samples (m,), (m, 3), aids in order of stamp, and the truth by seconds since START."""

    def __init__(
        self, seed: int = 1, duration: float = 200.0, speed: float = 0.0, waves: float = 1.0, turn: bool = False, rate: int = 50, stay: float = 120.0
    ) -> None:
        legs = "{turn_deg: 60.0, rate_deg_s: 1.5}" if turn else "{speed_kn: 8.0, acceleration_mps2: 0.05}"
        text = YAML.format(seed=seed, duration=duration, rate=rate, speed=speed, waves=waves, legs=legs, stay=stay)
        scenario = from_yaml(text)
        self.trajectory = Trajectory(scenario)
        imu = RedundantImuSim(scenario, self.trajectory)
        W = imu.array.least_squares()
        block = imu.block(1, imu.samples)
        self.stamp, self.sequence = block.stamp_ns + START, np.arange(1, imu.samples + 1)
        self.rate, self.force = block.gyro @ W.T, block.accel @ W.T
        self.aids: list[Aid] = []
        for name in ("gps", "bds"):
            sim = PositionSim(scenario, name, self.trajectory)
            f = sim.block(1, sim.samples)
            self.aids += [Aid(name, int(t) + START, np.array(z), f.covariance) for t, *z in zip(f.stamp_ns, f.lat, f.lon, f.h, strict=True)]
        log = DopplerSim(scenario, self.trajectory)
        v = log.block(1, log.samples)
        self.aids += [Aid("doppler", int(t) + START, z, v.covariance) for t, z in zip(v.stamp_ns, v.v_b, strict=True)]
        self.aids.sort(key=lambda aid: aid.stamp_ns)

    def truth(self, stamp_ns: int):
        """True state at a stamp."""
        return self.trajectory.truth(np.array([(stamp_ns - START) * 1e-9]))


@functools.cache
def ship(**how) -> Ship:
    """A ship, simulated once."""
    return Ship(**how)


def config(alignment: dict[str, object], **over: object) -> NavigatorConfig:
    """Settings that know the ship's sensors."""
    base: dict[str, object] = {
        "inertial": {"gyro_bias_deg_h": 0.0142, "gyro_markov_deg_h": 0.0, "gyro_arw_deg_sqrt_h": 0.00142, "accel_bias_ug": 71.0,
                     "accel_vrw_ug_sqrt_hz": 14.2},
        "gps": {"lever_arm_m": [-8.0, 1.0, -10.0], "timeout_s": 3.5, "period_s": 1.0},
        "bds": {"lever_arm_m": [-8.0, -1.0, -10.0], "timeout_s": 3.5, "period_s": 1.0},
        "doppler": {"misalignment_deg": 0.2, "lever_arm_m": [15.0, 0.0, 3.0], "timeout_s": 3.5, "period_s": 1.0},
        "height": {"mean_m": 5.0},
        "alignment": {"attempt_s": 30.0, **alignment},
    }  # fmt: skip
    for name in ("gps", "bds", "doppler"):
        if name not in over.get("aids", ("gps", "bds", "doppler")):  # type: ignore[operator]
            del base[name]
    return build(NavigatorConfig, {**base, **over})


def feed(navigator: Navigator, s: Ship, aids: list[Aid] | None = None, cuts: tuple[int, ...] = (), **more: object) -> Navigator:
    """Everything of a ship: aids up to each block's end, then the block."""
    waiting = list(s.aids if aids is None else aids)
    for part in np.split(np.arange(len(s.stamp)), cuts):
        while waiting and waiting[0].stamp_ns <= s.stamp[part[-1]]:
            navigator.add_aid(waiting.pop(0))
        navigator.add_imu(s.stamp[part], s.sequence[part], s.rate[part], s.force[part], **more)  # type: ignore[arg-type]
    navigator.finish()
    return navigator
