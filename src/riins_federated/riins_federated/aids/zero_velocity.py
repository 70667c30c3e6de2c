"""That the vehicle stands: each message of a source that knows says so for its stamp, or the IMU shows it.

Lives here: `ZeroVelocity`.
Does not live here: how the IMU shows it (standstill.py).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from riins_core.ins_error import PHI, VEL
from riins_core.settings import setting
from riins_node.readings import read_doppler

from ..aiding import AidModel, Input, LeverSettings, Measurement, Pose, cross, noise, skew
from ..types import Aid, Array


@dataclass(frozen=True)
class ZeroVelocitySettings(LeverSettings):
    """When the vehicle stands; the lever arm is that of the point that stands."""

    type: str = setting("zero_velocity", "kind of aid", choices=("zero_velocity",))
    sigma_mps: float = setting(0.02, "sigma of each axis where the message gives none: what standing leaves of motion", "m/s", 1e-6, 10.0)
    sigma_floor_mps: float = setting(0.0, "a smaller reported sigma is raised to this", "m/s", 0.0, 10.0)
    detect: bool = setting(False, "by the IMU, in windows of period_s, instead of messages; for vehicles that vibrate when they move, not for ships")
    miss_probability: float = setting(1e-3, "probability that a window in which the vehicle stands is not taken for one", "", 1e-9, 0.5)
    vibration: float = setting(1.0, "noise of the IMU while it stands, as with its engine on, over that of section inertial", "", 0.1, 1000.0)


class ZeroVelocity(AidModel[ZeroVelocitySettings]):
    """No velocity over ground, along the axes of the body. z: (3,) zeros, else it does not stand [m/s]; R: FRD (m/s)^2."""

    kind, Settings, leaf = "zero_velocity", ZeroVelocitySettings, "velocity"
    inputs = {"": Input("geometry_msgs/msg/TwistWithCovarianceStamped", read_doppler)}

    @property
    def frame(self) -> str:
        """The axes of the body."""
        return "imu_link"

    def difference(self, aid: Aid, pose: Pose, parameters: Array) -> Measurement:
        """Innovation, H and R of a velocity of zero."""
        v_b = pose.C_nb.T @ pose.v_n + cross(pose.rate_b, self.lever + self.value(parameters, "lever"))
        H = np.zeros((3, self.n))
        H[:, VEL] = -pose.C_nb.T
        H[:, PHI] = pose.C_nb.T @ skew(pose.v_n)
        if "lever" in self.at:
            H[:, self.at["lever"]] = -skew(pose.rate_b)
        return Measurement(-v_b, H, noise(aid.R, np.full(3, self.settings.sigma_mps), self.settings.sigma_floor_mps))

    def plausible(self, z: Array) -> bool:
        """It says that the vehicle stands."""
        return super().plausible(z) and not z.any()
