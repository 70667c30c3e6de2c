"""Velocity through the water: a log with water lock, and the current as two states.

Lives here: `WaterVelocity`.
Does not live here: bottom lock (body_velocity.py), whose mounting, scale factor and lever arm it shares.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from riins_core.settings import setting
from riins_node.readings import read_doppler, read_dvl_water

from ..aiding import Input, Measurement, Pose
from ..state_blocks import Block
from ..types import Aid, Array
from .body_velocity import BodyVelocitySettings, VectorModel


@dataclass(frozen=True)
class WaterVelocitySettings(BodyVelocitySettings):
    """A log with water lock."""

    type: str = setting("water_velocity", "kind of aid", choices=("water_velocity",))
    message: str = setting("twist", "twist: TwistWithCovarianceStamped, FLU; dvl: marine_acoustic_msgs/Dvl, water mode", choices=("twist", "dvl"))
    current_sigma_mps: float = setting(0.5, "sigma of the current north and east, two Gauss-Markov states; 0: still water", "m/s", 0.0, 10.0)
    current_time_s: float = setting(3600.0, "its correlation time, as the ship meets it", "s", 1.0, 1e7)


class WaterVelocity(VectorModel[WaterVelocitySettings]):
    """Velocity relative to the water in the axes of the log. z: forward, starboard, down [m/s] (NaN third: not measured); R: FRD (m/s)^2."""

    kind, Settings, leaf = "water_velocity", WaterVelocitySettings, "velocity"
    inputs = {
        "twist": Input("geometry_msgs/msg/TwistWithCovarianceStamped", read_doppler),
        "dvl": Input("marine_acoustic_msgs/msg/Dvl", read_dvl_water, "water"),
    }

    def own(self) -> list[Block]:
        """Those of a log, and the current."""
        s = self.settings
        current = self.state("current", {"current_n": "m/s", "current_e": "m/s"}, s.current_sigma_mps, s.current_time_s)
        return [*super().own(), current]

    def water(self, parameters: Array) -> Array | None:
        """The current, level."""
        return np.append(self.value(parameters, "current"), 0.0) if "current" in self.at else None

    def difference(self, aid: Aid, pose: Pose, parameters: Array) -> Measurement:
        """As over ground; the current enters with the opposite sign of the velocity."""
        found = super().difference(aid, pose, parameters)
        if "current" in self.at:
            found.H[:, self.at["current"]] = -found.H[:, 3:5]
        return found
