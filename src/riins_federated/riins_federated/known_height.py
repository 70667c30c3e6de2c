"""The mean height that a ship keeps by itself: mean sea level, with tide and heave as correlated noise.

Lives here: `HeightAid`, `HeightModel`.
Does not live here: a height that a sensor measures (aids/height.py).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from riins_core.ins_error import State
from riins_core.settings import setting

from .aiding import Measurement, Pose, white_inflation
from .state_blocks import N_FED_BACK, Block, StateModel
from .types import Array


@dataclass(frozen=True)
class HeightAid:
    """Mean height of a ship: mean sea level with geoid undulation, tide and heave as correlated noise."""

    enabled: bool = setting(True, "a ship stays near the geoid; switch off for vehicles that leave the surface")
    mean_m: float = setting(0.0, "mean height of the IMU above the sea; without undulation_m above the ellipsoid", "m", -1e4, 1e5)
    undulation_m: float = setting(0.0, "mean sea level above the ellipsoid, about the geoid undulation where the ship is", "m", -200.0, 200.0)
    sigma_m: float = setting(2.0, "sigma of tide and heave", "m", 1e-3, 1e4)
    correlation_time_s: float = setting(10.0, "its correlation time", "s", 0.1, 1e5)
    period_s: float = setting(10.0, "interval at which it is fused", "s", 0.01, 3600.0)
    bias_m: float = setting(0.0, "sigma of a slow part, as the tide, which is a state; 0: none", "m", 0.0, 1e3)
    bias_time_s: float = setting(10800.0, "its correlation time", "s", 1.0, 1e7)

    @property
    def above_ellipsoid(self) -> float:
        """Mean height of the IMU above the ellipsoid, m."""
        return self.mean_m + self.undulation_m


class HeightModel:
    """Mean height of the vehicle above the ellipsoid."""

    def __init__(self, config: HeightAid) -> None:
        self.config = config
        self.variance = white_inflation(config.sigma_m, config.correlation_time_s, config.period_s)
        self.bias: int | None = None

    def blocks(self) -> list[Block]:
        """The slow part."""
        on = self.config.enabled
        return [Block("height.bias", ("height_bias [m]",), self.config.bias_m if on else 0.0, self.config.bias_time_s)]

    def place(self, states: StateModel) -> None:
        """Be told the assembled state."""
        self.n, at = states.n, states.place("height.bias")
        self.bias = None if at is None else at.start

    def measurement(self, pose: Pose, parameters: Array) -> Measurement:
        """Innovation, H and R of the known mean height, on the down axis."""
        H = np.zeros((1, self.n))
        H[0, State.POS_D] = -1.0
        z = pose.h - self.config.above_ellipsoid
        if self.bias is not None:
            H[0, self.bias] = 1.0
            z -= parameters[self.bias - N_FED_BACK]
        return Measurement(np.array([z]), H, np.array([[self.variance]]))
