"""Velocities along the beams of a Doppler log: each beam counts by itself, so two that see the bottom are worth something.

Lives here: `BeamVelocity`.
Does not live here: the vector that a log makes of its beams (body_velocity.py).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from riins_core.settings import SettingError, setting
from riins_node.readings import read_dvl_beams

from ..aiding import Input, Measurement, Pose, noise, white_inflation
from ..types import Aid, Array
from .body_velocity import MountedModel, MountedSettings


@dataclass(frozen=True)
class BeamVelocitySettings(MountedSettings):
    """A Doppler log whose beams are known."""

    type: str = setting("beam_velocity", "kind of aid", choices=("beam_velocity",))
    beam_angle_deg: float = setting(30.0, "angle of the beams from straight down (Janus)", "deg", 0.0, 89.0)
    beam_azimuth_deg: tuple[float, ...] = setting((45.0, 135.0, 225.0, 315.0), "azimuth of each beam, clockwise from the bow", "deg", -360.0, 360.0)
    beam_sign: float = setting(1.0, "1: a velocity is positive when the log moves along its beam; -1: the other way", "", -1.0, 1.0)
    sigma_mps: float = setting(0.05, "sigma of a beam where the message gives none", "m/s", 1e-6, 100.0)
    sigma_floor_mps: float = setting(0.0, "a smaller reported sigma is raised to this", "m/s", 0.0, 100.0)
    markov_sigma_mps: float = setting(0.0, "correlated error of each beam, worked in by a larger white noise", "m/s", 0.0, 100.0)
    markov_time_s: float = setting(60.0, "its correlation time", "s", 0.1, 1e6)

    def __post_init__(self) -> None:
        if abs(self.beam_sign) != 1.0:
            raise SettingError('"beam_sign" must be 1 or -1', ("beam_sign",))
        if not self.beam_azimuth_deg:
            raise SettingError('"beam_azimuth_deg" must name a beam at least', ("beam_azimuth_deg",))


class BeamVelocity(MountedModel[BeamVelocitySettings]):
    """Velocity over ground along each beam. z: (beams,) [m/s], NaN: that beam has lost the bottom; R: (beams, beams) (m/s)^2, diagonal."""

    kind, Settings, leaf = "beam_velocity", BeamVelocitySettings, "dvl"
    inputs = {"": Input("marine_acoustic_msgs/msg/Dvl", read_dvl_beams, "beams")}

    def __init__(self, name: str, settings: BeamVelocitySettings) -> None:
        azimuth, angle = np.radians(settings.beam_azimuth_deg), np.radians(settings.beam_angle_deg)
        beams = len(azimuth)
        super().__init__(name, settings, size=beams, rows=slice(0, beams))
        self.extra = white_inflation(settings.markov_sigma_mps, settings.markov_time_s, settings.period_s)
        across, down = np.sin(angle), np.full(beams, np.cos(angle))
        self.beams = settings.beam_sign * np.column_stack([across * np.cos(azimuth), across * np.sin(azimuth), down])

    def difference(self, aid: Aid, pose: Pose, parameters: Array) -> Measurement:
        """Innovation, H and R of the beams that have a velocity."""
        good = np.isfinite(aid.z)
        seen, gain = self.mounted(pose, parameters), 1.0 + self.number(parameters, "scale")
        along = self.beams[good]
        H = np.zeros((len(along), self.n))
        seen.fill(H, self.at, gain * along)
        if "scale" in self.at:
            H[:, self.at["scale"].start] = -along @ seen.v
        reported = np.diag(np.diag(aid.R)[good])
        R = noise(reported, np.full(len(along), self.settings.sigma_mps), self.settings.sigma_floor_mps)
        return Measurement(aid.z[good] - gain * (along @ seen.v), H, R + self.extra * np.eye(len(along)))

    def plausible(self, z: Array) -> bool:
        """At least one beam sees the bottom."""
        return bool(np.isfinite(z).any()) and not np.isinf(z).any()

    def covariance_ok(self, aid: Aid) -> bool:
        """Of the beams that have a velocity: all unknown, or all positive."""
        if np.shape(aid.R) != (self.size, self.size):
            return False
        variance = np.diag(aid.R)[np.isfinite(aid.z)]
        return bool((variance == 0.0).all() or (np.isfinite(variance) & (variance > 0.0)).all())
