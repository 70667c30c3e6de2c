"""Velocity of a GNSS receiver.

Lives here: `GnssVelocity`; its own states are a Gauss-Markov velocity error and the lever arm of the antenna.
Does not live here: position of a receiver (gnss_position.py), velocities along the vehicle's axes (body_velocity.py).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from riins_core.ins_error import PHI, VEL
from riins_core.settings import setting
from riins_node.readings import read_velocity

from ..aiding import AidModel, Input, LeverSettings, Measurement, Pose, cross, noise, skew, white_inflation
from ..state_blocks import Block
from ..types import Aid, Array


@dataclass(frozen=True)
class GnssVelocitySettings(LeverSettings):
    """Velocity of a GNSS receiver."""

    type: str = setting("gnss_velocity", "kind of aid", choices=("gnss_velocity",))
    sigma_mps: tuple[float, ...] = setting(
        (0.1, 0.1, 0.2), "sigma north, east, down where the message gives no covariance", "m/s", 1e-6, 100.0, length=3
    )
    sigma_floor_mps: float = setting(0.0, "a smaller reported sigma is raised to this", "m/s", 0.0, 100.0)
    markov_sigma_mps: float = setting(0.0, "correlated error of each axis, worked in by a larger white noise", "m/s", 0.0, 100.0)
    markov_time_s: float = setting(100.0, "its correlation time", "s", 0.1, 1e6)
    markov_state: bool = setting(False, "three states for the correlated error, instead of a larger white noise")
    use_down: bool = setting(True, "fuse the vertical velocity too")


class GnssVelocity(AidModel[GnssVelocitySettings]):
    """Velocity of the antenna over ground. z: north, east, down [m/s]; R: NED (m/s)^2."""

    kind, Settings, leaf = "gnss_velocity", GnssVelocitySettings, "velocity"
    inputs = {"": Input("geometry_msgs/msg/TwistWithCovarianceStamped", read_velocity)}

    def __init__(self, name: str, settings: GnssVelocitySettings) -> None:
        super().__init__(name, settings, rows=slice(0, 3 if settings.use_down else 2))
        self.sigma = np.array(settings.sigma_mps)
        inflated = 0.0 if settings.markov_state else white_inflation(settings.markov_sigma_mps, settings.markov_time_s, settings.period_s)
        self.extra = inflated * np.eye(3)

    def own(self) -> list[Block]:
        """The correlated error."""
        s = self.settings
        labels = dict.fromkeys(("error_n", "error_e", "error_d")[self.rows], "m/s")
        return [self.state("markov", labels, s.markov_sigma_mps if s.markov_state else 0.0, s.markov_time_s)]

    def difference(self, aid: Aid, pose: Pose, parameters: Array) -> Measurement:
        """Innovation, H and R of a velocity NED."""
        n = self.rows.stop
        swing = pose.C_nb @ cross(pose.rate_b, self.lever + self.value(parameters, "lever"))
        H = np.zeros((3, self.n))
        H[:, VEL] = -np.eye(3)
        H[:, PHI] = -skew(swing)
        H = H[:n]
        if "lever" in self.at:
            H[:, self.at["lever"]] = -(pose.C_nb @ skew(pose.rate_b))[:n]
        if "markov" in self.at:
            H[:, self.at["markov"]] = -np.eye(n)
        R = noise(aid.R, self.sigma, self.settings.sigma_floor_mps) + self.extra
        return Measurement((aid.z - pose.v_n - swing)[:n] - self.value(parameters, "markov"), H, R[:n, :n])
