"""Velocity over ground along the axes of a sensor: a Doppler log with bottom lock, as a vector.

Lives here: `BodyVelocity`, and the arithmetic of mounting angles, scale factor and lever arm that other velocity sensors share.
Does not live here: beams (beam_velocity.py), velocity through the water (water_velocity.py), wheels (odometer.py).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from riins_core.ins_error import PHI, VEL
from riins_core.sensor_errors import PPM
from riins_core.settings import setting
from riins_node.readings import read_doppler, read_dvl_bottom

from ..aiding import AidModel, Input, LeverSettings, Measurement, Pose, cross, noise, skew, white_inflation
from ..state_blocks import Block
from ..types import Aid, Array

ONE = np.eye(3)


@dataclass(frozen=True)
class MountedSettings(LeverSettings):
    """A velocity sensor with a mounting and a scale factor."""

    mounting_yaw_deg: float = setting(0.0, "known mounting yaw, clockwise from above", "deg", -180.0, 180.0)
    mounting_pitch_deg: float = setting(0.0, "known mounting pitch, bow up", "deg", -90.0, 90.0)
    misalignment_deg: float = setting(0.5, "sigma of the unknown mounting yaw; 0: known, not estimated", "deg", 0.0, 90.0)
    misalignment_pitch_deg: float = setting(0.0, "sigma of the unknown mounting pitch; 0: known, not estimated", "deg", 0.0, 90.0)
    scale_ppm: float = setting(0.0, "sigma of the unknown scale factor; 0: known, not estimated", "ppm", 0.0, 1e6)


@dataclass(frozen=True)
class BodyVelocitySettings(MountedSettings):
    """A Doppler log with bottom lock."""

    type: str = setting("body_velocity", "kind of aid", choices=("body_velocity",))
    message: str = setting("twist", "twist: TwistWithCovarianceStamped, FLU; dvl: marine_acoustic_msgs/Dvl, bottom mode", choices=("twist", "dvl"))
    sigma_mps: tuple[float, ...] = setting(
        (0.1286, 0.1286, 0.1286), "sigma forward, starboard, down where the message gives none", "m/s", 1e-6, 100.0, length=3
    )
    sigma_floor_mps: float = setting(0.0, "a smaller reported sigma is raised to this", "m/s", 0.0, 100.0)
    scale_each_axis: bool = setting(False, "a scale factor of its own for each axis (002), instead of one")
    markov_sigma_mps: float = setting(0.0, "correlated error of each axis, worked in by a larger white noise", "m/s", 0.0, 100.0)
    markov_time_s: float = setting(60.0, "its correlation time", "s", 0.1, 1e6)
    markov_state: bool = setting(False, "states for the correlated error, instead of a larger white noise")
    use_down: bool = setting(False, "fuse the third component too")


@dataclass(frozen=True)
class Mounted:
    """Velocity of the sensor in its own axes, true of scale, and its derivatives.

    Attributes
    ----------
    v : (3,), m/s
    turn : (3, 3), from NED into the axes of the sensor
    relative_n : (3,), velocity that the sensor sees of the vehicle, NED
    by_yaw, by_pitch : (3,), derivatives by the mounting angles; by_lever : (3, 3); None where that is no state
    """

    v: Array
    turn: Array
    relative_n: Array
    by_yaw: Array | None
    by_pitch: Array | None
    by_lever: Array | None

    def fill(self, H: Array, at: dict[str, slice], by: Array) -> None:
        """Columns of velocity, attitude, mounting and lever arm of H (m, n) for a prediction whose derivative by `v` is by (m, 3)."""
        turned = by @ self.turn
        H[:, VEL] = -turned
        H[:, PHI] = turned @ skew(self.relative_n)
        if self.by_yaw is not None:
            H[:, at["yaw"].start] = -by @ self.by_yaw
        if self.by_pitch is not None:
            H[:, at["pitch"].start] = -by @ self.by_pitch
        if self.by_lever is not None:
            H[:, at["lever"]] = -by @ self.by_lever


T = TypeVar("T", bound=MountedSettings)


class MountedModel(AidModel[T]):
    """What velocity sensors with a mounting share: their states yaw, pitch and scale."""

    @property
    def frame(self) -> str:
        """That of the sensor: components forward, starboard, down, or along its beams."""
        return self.settings.frame or f"{self.name}_link"

    def own(self) -> list[Block]:
        """Mounting yaw and pitch, and the scale factor, where they are not known."""
        s = self.settings
        return [
            self.state("yaw", {"yaw": "rad"}, math.radians(s.misalignment_deg)),
            self.state("pitch", {"pitch": "rad"}, math.radians(s.misalignment_pitch_deg)),
            self.state("scale", {"scale": "1"}, s.scale_ppm * PPM),
        ]

    def mounted(self, pose: Pose, parameters: Array, water_n: Array | None = None, lever: Array | None = None) -> Mounted:
        """Velocity at the sensor, or at another lever arm that is known: M_pitch M_yaw (C_nb' (v_n - water) + w x l)."""
        s = self.settings
        yaw, pitch = math.radians(s.mounting_yaw_deg) + self.number(parameters, "yaw"), self.number(parameters, "pitch")
        pitch += math.radians(s.mounting_pitch_deg)
        c, k = math.cos(yaw), math.sin(yaw)
        level = np.array([[c, k, 0.0], [-k, c, 0.0], [0.0, 0.0, 1.0]])
        up = _pitched(pitch)
        M = level if up is None else up @ level
        relative_n = pose.v_n if water_n is None else pose.v_n - water_n
        arm = self.lever + self.value(parameters, "lever") if lever is None else lever
        v_level = level @ (pose.C_nb.T @ relative_n + cross(pose.rate_b, arm))
        by_yaw = by_pitch = by_lever = None
        if "yaw" in self.at:
            by_yaw = np.array([v_level[1], -v_level[0], 0.0])
            by_yaw = by_yaw if up is None else up @ by_yaw
        if "pitch" in self.at:
            c, k = math.cos(pitch), math.sin(pitch)
            by_pitch = np.array([-k * v_level[0] - c * v_level[2], 0.0, c * v_level[0] - k * v_level[2]])
        if lever is None and "lever" in self.at:
            by_lever = M @ skew(pose.rate_b)
        return Mounted(v_level if up is None else up @ v_level, M @ pose.C_nb.T, relative_n, by_yaw, by_pitch, by_lever)


def _pitched(pitch: float) -> Array | None:
    """From level axes into those of a sensor whose bow is up by `pitch`; None: they are the same."""
    if pitch == 0.0:
        return None
    c, k = math.cos(pitch), math.sin(pitch)
    return np.array([[c, 0.0, -k], [0.0, 1.0, 0.0], [k, 0.0, c]])


U = TypeVar("U", bound=BodyVelocitySettings)


class VectorModel(MountedModel[U]):
    """A velocity vector in the axes of the sensor: (1 + s) times the velocity at the sensor, plus a correlated error."""

    def __init__(self, name: str, settings: U) -> None:
        super().__init__(name, settings, rows=slice(0, 3 if settings.use_down else 2))
        self.sigma = np.array(settings.sigma_mps)
        inflated = 0.0 if settings.markov_state else white_inflation(settings.markov_sigma_mps, settings.markov_time_s, settings.period_s)
        self.extra = inflated * np.eye(3)

    def own(self) -> list[Block]:
        """Mounting, scale factor or factors, correlated error."""
        s = self.settings
        yaw, pitch, scale = super().own()
        axes = ("x", "y", "z")[self.rows]
        if s.scale_each_axis:
            scale = self.state("scale", {f"scale_{axis}": "1" for axis in axes}, s.scale_ppm * PPM)
        markov = self.state("markov", {f"error_{axis}": "m/s" for axis in axes}, s.markov_sigma_mps if s.markov_state else 0.0, s.markov_time_s)
        return [yaw, pitch, scale, markov]

    def water(self, parameters: Array) -> Array | None:
        """Velocity of what it looks at, NED m/s; None: the ground."""
        return None

    def difference(self, aid: Aid, pose: Pose, parameters: Array) -> Measurement:
        """Innovation, H and R of a velocity forward, starboard, down."""
        n = self.rows.stop
        seen = self.mounted(pose, parameters, self.water(parameters))
        gain = np.ones(n) + self.value(parameters, "scale")
        H = np.zeros((n, self.n))
        seen.fill(H, self.at, gain[:, None] * ONE[:n])
        if "scale" in self.at:
            H[:, self.at["scale"]] = -np.diag(seen.v[:n]) if self.settings.scale_each_axis else -seen.v[:n, None]
        if "markov" in self.at:
            H[:, self.at["markov"]] = -np.eye(n)
        z = aid.z[:n] - gain * seen.v[:n]
        if "markov" in self.at:
            z -= self.value(parameters, "markov")
        return Measurement(z, H, (noise(aid.R, self.sigma, self.settings.sigma_floor_mps) + self.extra)[:n, :n])


class BodyVelocity(VectorModel[BodyVelocitySettings]):
    """Velocity over ground in the axes of the log. z: forward, starboard, down [m/s] (NaN third: not measured); R: FRD (m/s)^2."""

    kind, Settings, leaf = "body_velocity", BodyVelocitySettings, "velocity"
    inputs = {
        "twist": Input("geometry_msgs/msg/TwistWithCovarianceStamped", read_doppler),
        "dvl": Input("marine_acoustic_msgs/msg/Dvl", read_dvl_bottom, "bottom"),
    }
