"""Speed of the wheels, and that a vehicle moves neither sideways nor off the road.

Lives here: `Odometer`; its own states are the scale factor of the wheels and the mounting of the IMU against the direction of travel.
Does not live here: logs (body_velocity.py), whose mounting and lever arm it shares.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from riins_core.settings import SettingError, setting
from riins_node.readings import read_odometer

from ..aiding import Input, Measurement, Pose, white_inflation
from ..types import Aid, Array
from .body_velocity import MountedModel, MountedSettings


@dataclass(frozen=True)
class OdometerSettings(MountedSettings):
    """Wheels; the lever arm is that of the wheel whose speed is told."""

    type: str = setting("odometer", "kind of aid", choices=("odometer",))
    sigma_mps: float = setting(0.1, "sigma of the speed where the message gives none", "m/s", 1e-6, 100.0)
    sigma_floor_mps: float = setting(0.0, "a smaller reported sigma is raised to this", "m/s", 0.0, 100.0)
    markov_sigma_mps: float = setting(0.0, "correlated error of the speed (slip), worked in by a larger white noise", "m/s", 0.0, 100.0)
    markov_time_s: float = setting(10.0, "its correlation time", "s", 0.1, 1e6)
    axle_m: tuple[float, ...] = setting(
        (),
        "where the vehicle does not move sideways and off the road: the axle that does not steer, from the IMU; empty: at the lever arm",
        "m",
        -100.0,
        100.0,
    )
    sideways_mps: float = setting(0.1, "sigma of no sideways velocity, where the message gives none; 0: not used", "m/s", 0.0, 100.0)
    down_mps: float = setting(0.1, "sigma of no velocity off the road, where the message gives none; 0: not used", "m/s", 0.0, 100.0)

    def __post_init__(self) -> None:
        if len(self.axle_m) not in (0, 3):
            raise SettingError('"axle_m" must be empty or forward, starboard, down', ("axle_m",))


class Odometer(MountedModel[OdometerSettings]):
    """Speed forward, and nothing sideways and down. z: (1,) [m/s]; R: (3, 3) FRD (m/s)^2, of the zeros too where it says so."""

    kind, Settings, leaf = "odometer", OdometerSettings, "velocity"
    inputs = {"": Input("geometry_msgs/msg/TwistWithCovarianceStamped", read_odometer)}

    def __init__(self, name: str, settings: OdometerSettings) -> None:
        super().__init__(name, settings, size=1, rows=slice(0, 1))
        self.axes = np.array([0, *([1] if settings.sideways_mps else []), *([2] if settings.down_mps else [])])
        self.extra = white_inflation(settings.markov_sigma_mps, settings.markov_time_s, settings.period_s)
        self.axle = np.array(settings.axle_m) if settings.axle_m else None
        self.sigma = np.array([settings.sigma_mps, settings.sideways_mps, settings.down_mps])

    def difference(self, aid: Aid, pose: Pose, parameters: Array) -> Measurement:
        """Innovation, H and R; the wheels' scale factor is that of the speed alone."""
        seen = self.mounted(pose, parameters)
        gain = np.array([1.0 + self.number(parameters, "scale"), 1.0, 1.0])
        v = seen.v
        whole = np.zeros((3, self.n))
        seen.fill(whole, self.at, gain[:, None] * np.eye(3))
        if self.axle is not None:
            still = self.mounted(pose, parameters, lever=self.axle)
            v = np.append(v[:1], still.v[1:])
            still.fill(whole[1:], self.at, np.eye(3)[1:])
        H = whole[self.axes]
        if "scale" in self.at:
            H[0, self.at["scale"].start] = -v[0]
        told = np.diag(aid.R)
        variance = np.where(told > 0.0, told, self.sigma**2)
        variance[0] = max(variance[0], self.settings.sigma_floor_mps**2) + self.extra
        measured = np.array([aid.z[0], 0.0, 0.0])
        return Measurement((measured - gain * v)[self.axes], H, np.diag(variance[self.axes]))

    def covariance_ok(self, aid: Aid) -> bool:
        """Variances that are not negative; 0: not told."""
        return np.shape(aid.R) == (3, 3) and bool((np.isfinite(np.diag(aid.R)) & (np.diag(aid.R) >= 0.0)).all())
