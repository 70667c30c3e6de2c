"""Attitude of a sensor: a star tracker, a gyrocompass with roll and pitch, another inertial system.

Lives here: `Attitude`; its own states are the three mounting angles that are not known.
Does not live here: heading alone (heading.py).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from riins_core.ins_error import PHI
from riins_core.rotation import dcm_from_euler, dcm_from_quat, exp_so3, log_so3
from riins_core.settings import setting
from riins_node.readings import read_attitude

from ..aiding import AidModel, AidSettings, Input, Measurement, Pose, noise, reported_covariance_ok, skew, white_inflation
from ..state_blocks import Block
from ..types import Aid, Array


@dataclass(frozen=True)
class AttitudeAidSettings(AidSettings):
    """A sensor of attitude."""

    type: str = setting("attitude", "kind of aid", choices=("attitude",))
    sigma_deg: tuple[float, ...] = setting((0.01, 0.01, 0.01), "sigma about north, east, down where none is reported", "deg", 1e-7, 180.0, length=3)
    sigma_floor_deg: float = setting(0.0, "a smaller reported sigma is raised to this", "deg", 0.0, 180.0)
    markov_sigma_deg: float = setting(0.0, "correlated error of each angle, worked in by a larger white noise", "deg", 0.0, 180.0)
    markov_time_s: float = setting(60.0, "its correlation time", "s", 0.1, 1e6)
    mounting_rpy_deg: tuple[float, ...] = setting((0.0, 0.0, 0.0), "roll, pitch, yaw of the sensor in the body", "deg", -360.0, 360.0, length=3)
    misalignment_deg: float = setting(0.0, "sigma of each mounting angle that is not known, three states; 0: known", "deg", 0.0, 20.0)


class Attitude(AidModel[AttitudeAidSettings]):
    """Attitude as a rotation. z: (4,) quaternion (x, y, z, w) from the sensor (FRD) to NED; R: (3, 3) rad^2, of a small rotation about NED."""

    kind, Settings, leaf = "attitude", AttitudeAidSettings, "attitude"
    inputs = {"": Input("geometry_msgs/msg/PoseWithCovarianceStamped", read_attitude)}

    def __init__(self, name: str, settings: AttitudeAidSettings) -> None:
        super().__init__(name, settings, size=4, rows=slice(0, 4))
        self.C_bs = dcm_from_euler(*np.radians(settings.mounting_rpy_deg))
        self.sigma = np.radians(settings.sigma_deg)
        self.extra = white_inflation(float(np.radians(settings.markov_sigma_deg)), settings.markov_time_s, settings.period_s) * np.eye(3)

    def own(self) -> list[Block]:
        """Mounting angles, a rotation about the body axes."""
        labels = dict.fromkeys(("mounting_x", "mounting_y", "mounting_z"), "rad")
        return [self.state("mounting", labels, float(np.radians(self.settings.misalignment_deg)))]

    def difference(self, aid: Aid, pose: Pose, parameters: Array) -> Measurement:
        """The rotation vector in NED from the predicted to the measured attitude: phi, as errors are computed minus true."""
        mounting = np.zeros(3) + self.value(parameters, "mounting")
        C_bs = exp_so3(mounting) @ self.C_bs
        z = log_so3(dcm_from_quat(aid.z) @ (pose.C_nb @ C_bs).T)
        H = np.zeros((3, self.n))
        H[:, PHI] = np.eye(3)
        if "mounting" in self.at:
            turn = skew(mounting)  # left Jacobian of the rotation, whose angle is small
            H[:, self.at["mounting"]] = -pose.C_nb @ (np.eye(3) + turn / 2.0 + turn @ turn / 6.0)
        return Measurement(z, H, noise(aid.R, self.sigma, float(np.radians(self.settings.sigma_floor_deg))) + self.extra)

    def plausible(self, z: Array) -> bool:
        """A quaternion that can be normalised."""
        return super().plausible(z) and bool(0.5 < float(z @ z) < 2.0)

    def covariance_ok(self, aid: Aid) -> bool:
        """Of three angles."""
        return np.shape(aid.R) == (3, 3) and reported_covariance_ok(aid.R, slice(0, 3))
