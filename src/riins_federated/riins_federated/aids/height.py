"""Height above the ellipsoid that a sensor gives: barometer, pressure depth, radar.

Lives here: `Height`; its own state is a bias: of the barometer by weather, or the tide.
Does not live here: the mean height that a ship keeps by itself (config.HeightAid, known_height.py).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from riins_core.ins_error import PHI, State
from riins_core.settings import setting
from riins_node.readings import read_height

from ..aiding import AidModel, Input, LeverSettings, Measurement, Pose, noise, skew, white_inflation
from ..state_blocks import Block
from ..types import Aid, Array


@dataclass(frozen=True)
class HeightSettings(LeverSettings):
    """A sensor of height."""

    type: str = setting("height", "kind of aid", choices=("height",))
    sigma_m: float = setting(1.0, "sigma where the message gives none", "m", 1e-4, 1e5)
    sigma_floor_m: float = setting(0.0, "a smaller reported sigma is raised to this", "m", 0.0, 1e5)
    zero_m: float = setting(0.0, "height above the ellipsoid of the sensor's zero: geoid undulation for heights above the sea", "m", -1e4, 1e5)
    markov_sigma_m: float = setting(0.0, "correlated error, worked in by a larger white noise", "m", 0.0, 1e5)
    markov_time_s: float = setting(3600.0, "its correlation time", "s", 0.1, 1e7)
    markov_state: bool = setting(False, "a state for the correlated error, instead of a larger white noise")


class Height(AidModel[HeightSettings]):
    """Height of the sensor. z: (1,) [m], upwards; R: (1, 1) m^2."""

    kind, Settings, leaf = "height", HeightSettings, "height"
    inputs = {"": Input("geometry_msgs/msg/PoseWithCovarianceStamped", read_height)}

    def __init__(self, name: str, settings: HeightSettings) -> None:
        super().__init__(name, settings, size=1, rows=slice(0, 1))
        self.extra = 0.0 if settings.markov_state else white_inflation(settings.markov_sigma_m, settings.markov_time_s, settings.period_s)

    def own(self) -> list[Block]:
        """The correlated error."""
        s = self.settings
        return [self.state("markov", {"error": "m"}, s.markov_sigma_m if s.markov_state else 0.0, s.markov_time_s)]

    def difference(self, aid: Aid, pose: Pose, parameters: Array) -> Measurement:
        """Innovation, H and R of a height."""
        lever_n = pose.C_nb @ (self.lever + self.value(parameters, "lever"))
        H = np.zeros((1, self.n))
        H[0, State.POS_D] = 1.0
        H[0, PHI] = skew(lever_n)[2]
        if "lever" in self.at:
            H[0, self.at["lever"]] = pose.C_nb[2]
        if "markov" in self.at:
            H[0, self.at["markov"]] = -1.0
        predicted = pose.h - lever_n[2] - self.settings.zero_m + self.number(parameters, "markov")
        R = noise(aid.R, np.array([self.settings.sigma_m]), self.settings.sigma_floor_m) + self.extra
        return Measurement(np.array([aid.z[0] - predicted]), H, R)
