"""Heading: a gyrocompass, a magnetic compass, two GNSS antennas.

Lives here: `Heading`; its own state is the deviation of the compass, or what is not known of the baseline.
Does not live here: three angles (attitude.py).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from riins_core.ins_error import PHI
from riins_core.settings import setting
from riins_node.readings import read_heading

from ..aiding import AidModel, AidSettings, Input, Measurement, Pose, noise
from ..state_blocks import Block
from ..types import Aid, Array


@dataclass(frozen=True)
class HeadingSettings(AidSettings):
    """A sensor of heading."""

    type: str = setting("heading", "kind of aid", choices=("heading",))
    sigma_deg: float = setting(0.5, "sigma where the message gives none", "deg", 1e-6, 180.0)
    sigma_floor_deg: float = setting(0.0, "a smaller reported sigma is raised to this", "deg", 0.0, 180.0)
    offset_deg: float = setting(0.0, "known mounting: what it reads less the heading", "deg", -180.0, 180.0)
    two_antennas: bool = setting(False, "it reads the azimuth of a baseline in the deck, offset_deg from the bow: roll and pitch enter")
    deviation_deg: float = setting(0.0, "sigma of a deviation that is not known, a state; 0: none", "deg", 0.0, 180.0)
    deviation_time_s: float = setting(0.0, "its correlation time; 0: a constant", "s", 0.0, 1e7)


class Heading(AidModel[HeadingSettings]):
    """Heading clockwise from true north, or the azimuth of a baseline. z: (1,) [rad]; R: (1, 1) rad^2."""

    kind, Settings, leaf = "heading", HeadingSettings, "heading"
    inputs = {"": Input("geometry_msgs/msg/PoseWithCovarianceStamped", read_heading)}

    def __init__(self, name: str, settings: HeadingSettings) -> None:
        super().__init__(name, settings, size=1, rows=slice(0, 1))
        offset = math.radians(settings.offset_deg)
        self.baseline = np.array([math.cos(offset), math.sin(offset), 0.0]) if settings.two_antennas else np.array([1.0, 0.0, 0.0])
        self.offset = 0.0 if settings.two_antennas else offset

    def own(self) -> list[Block]:
        """The deviation."""
        s = self.settings
        return [self.state("deviation", {"deviation": "rad"}, math.radians(s.deviation_deg), s.deviation_time_s or np.inf)]

    def difference(self, aid: Aid, pose: Pose, parameters: Array) -> Measurement:
        """Innovation, H and R: the direction of the x axis, or of the baseline, in the horizon, whatever roll and pitch."""
        north, east, down = pose.C_nb @ self.baseline
        level = north * north + east * east
        H = np.zeros((1, self.n))
        H[0, PHI] = -north * down / level, -east * down / level, 1.0  # computed - true heading = -phi_D where the vehicle is level
        if "deviation" in self.at:
            H[0, self.at["deviation"].start] = -1.0
        predicted = math.atan2(east, north) + self.offset + self.number(parameters, "deviation")
        z = (aid.z[0] - predicted + math.pi) % (2.0 * math.pi) - math.pi
        sigma, floor = math.radians(self.settings.sigma_deg), math.radians(self.settings.sigma_floor_deg)
        return Measurement(np.array([z]), H, noise(aid.R, np.array([sigma]), floor))
