"""Position of a GNSS receiver: GPS, BDS, any NavSatFix.

Lives here: `GnssPosition`; its own states are a Gauss-Markov position error and the lever arm of the antenna.
Does not live here: velocity of a receiver (gnss_velocity.py).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from riins_core.earth import radii_s
from riins_core.ins_error import PHI, POS
from riins_core.settings import setting
from riins_node.readings import read_position_aid

from ..aiding import AidModel, Input, LeverSettings, Measurement, Pose, noise, skew, white_inflation
from ..state_blocks import Block
from ..types import Aid, Array

MINUS_ONE = -np.eye(3)


@dataclass(frozen=True)
class GnssPositionSettings(LeverSettings):
    """A GNSS receiver."""

    type: str = setting("gnss_position", "kind of aid", choices=("gnss_position",))
    sigma_m: tuple[float, ...] = setting(
        (30.0, 30.0, 60.0), "sigma north, east, down where the message gives no covariance", "m", 1e-4, 1e5, length=3
    )
    sigma_floor_m: float = setting(0.0, "a smaller reported sigma is raised to this", "m", 0.0, 1e5)
    markov_sigma_m: float = setting(0.0, "correlated error of each axis, worked in by a larger white noise", "m", 0.0, 1e5)
    markov_time_s: float = setting(100.0, "its correlation time", "s", 0.1, 1e6)
    markov_state: bool = setting(False, "three states for the correlated error, instead of a larger white noise")
    use_height: bool = setting(False, "fuse the height too (mean sea level serves a ship better)")


class GnssPosition(AidModel[GnssPositionSettings]):
    """Position at the antenna, compared in metres NED. z: latitude, longitude [rad], height [m]; R: NED m^2."""

    kind, Settings, leaf = "gnss_position", GnssPositionSettings, "fix"
    inputs = {"": Input("sensor_msgs/msg/NavSatFix", read_position_aid)}

    def __init__(self, name: str, settings: GnssPositionSettings) -> None:
        super().__init__(name, settings, rows=slice(0, 3 if settings.use_height else 2))
        self.sigma = np.array(settings.sigma_m)
        inflated = 0.0 if settings.markov_state else white_inflation(settings.markov_sigma_m, settings.markov_time_s, settings.period_s)
        self.extra = inflated * np.eye(3)

    def own(self) -> list[Block]:
        """The correlated error; its height only where that is fused."""
        s = self.settings
        labels = dict.fromkeys(("error_n", "error_e", "error_d")[self.rows], "m")
        return [self.state("markov", labels, s.markov_sigma_m if s.markov_state else 0.0, s.markov_time_s)]

    def difference(self, aid: Aid, pose: Pose, parameters: Array) -> Measurement:
        """Innovation, H and R of a position; see Groves (14.102) for the lever arm, with errors computed minus true."""
        n = self.rows.stop
        lever_n = pose.C_nb @ (self.lever + self.value(parameters, "lever"))
        r_m, r_n = radii_s(pose.lat)
        lat, lon, h = aid.z.tolist()
        d_lon = (lon - pose.lon + math.pi) % (2.0 * math.pi) - math.pi  # across the date line
        difference = np.array([(lat - pose.lat) * (r_m + pose.h), d_lon * (r_n + pose.h) * math.cos(pose.lat), pose.h - h])
        z = (difference - lever_n)[:n]
        if "markov" in self.at:
            z -= self.value(parameters, "markov")
        H = np.zeros((n, self.n))
        H[:, POS] = MINUS_ONE[:n]
        H[:, PHI] = -skew(lever_n)[:n]
        if "lever" in self.at:
            H[:, self.at["lever"]] = -pose.C_nb[:n]
        if "markov" in self.at:
            H[:, self.at["markov"]] = -np.eye(n)
        R = noise(aid.R, self.sigma, self.settings.sigma_floor_m) + self.extra
        return Measurement(z, H, R[:n, :n])

    def plausible(self, z: Array) -> bool:
        """Numbers, and a place on Earth."""
        return super().plausible(z) and bool(abs(z[0]) <= np.pi / 2 and abs(z[1]) <= 2 * np.pi)
