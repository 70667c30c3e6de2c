"""Measurement models of the aids: what a sensor should read, how the reading depends on the error state, and its noise.

Lives here: position (GNSS), body velocity (Doppler log) and mean height, each with innovation z, matrix H and noise R.
Does not live here: the fault test (local_filter.py), the filter (master.py). Errors are computed minus true, so H is minus the seeds' H.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from riins_core.earth import radii_s
from riins_core.ins_error import PHI, POS, VEL, State
from riins_core.rotation import skew

from .config import HeightAid, PositionAid, VelocityAid
from .state_blocks import N_FED_BACK, Block, StateModel
from .types import Aid, Array


@dataclass(frozen=True)
class Pose:
    """Nominal state at the measurement time.

    Attributes
    ----------
    lat, lon, h : rad, rad, m
    v_n : (3,), m/s, NED
    C_nb : (3, 3)
    rate_b : (3,), body rate relative to NED, rad/s, FRD
    """

    lat: float
    lon: float
    h: float
    v_n: Array
    C_nb: Array
    rate_b: Array


@dataclass(frozen=True)
class Measurement:
    """z = measured - predicted (m,), H (m, n) with z = H x + noise, and R (m, m)."""

    z: Array
    H: Array
    R: Array


def white_inflation(sigma: float, correlation_time: float, period: float) -> float:
    """Variance of a white noise that carries as much information as a first-order Markov noise sampled at `period`.

    Parameters
    ----------
    sigma, correlation_time, period : unit of the measurement, s, s

    Returns
    -------
    float, sigma^2 (1 + r) / (1 - r), r = exp(-period / correlation_time)
    """
    r = np.exp(-period / correlation_time)
    return float(sigma**2 * (1.0 + r) / (1.0 - r))


class PositionModel:
    """GNSS position at the antenna, compared in metres NED."""

    def __init__(self, config: PositionAid) -> None:
        self.lever = np.array(config.lever_arm_m)
        self.sigma = np.array(config.sigma_m)
        self.floor = config.sigma_floor_m
        self.extra = white_inflation(config.markov_sigma_m, config.markov_time_s, config.period_s)
        self.rows = 3 if config.use_height else 2
        self.coordinates = slice(0, self.rows)

    def blocks(self) -> list[Block]:
        """States of its own: none."""
        return []

    def place(self, states: StateModel) -> None:
        """Be told the assembled state."""
        self.n = states.n

    def measurement(self, aid: Aid, pose: Pose, parameters: Array) -> Measurement:
        """Innovation, H and R of a position; see Groves (14.102) for the lever arm, with errors computed minus true."""
        lever_n = pose.C_nb @ self.lever
        r_m, r_n = radii_s(pose.lat)
        d_lon = (aid.z[1] - pose.lon + np.pi) % (2.0 * np.pi) - np.pi  # across the date line
        difference = np.array([(aid.z[0] - pose.lat) * (r_m + pose.h), d_lon * (r_n + pose.h) * np.cos(pose.lat), pose.h - aid.z[2]])
        H = np.zeros((3, self.n))
        H[:, POS] = -np.eye(3)
        H[:, PHI] = -skew(lever_n)
        R = noise(aid.R, self.sigma, self.floor) + self.extra * np.eye(3)
        n = self.rows
        return Measurement((difference - lever_n)[:n], H[:n], R[:n, :n])


class VelocityModel:
    """Velocity over ground in log axes at the transducer: (1 + s) (I - yaw [z x]) C_nb' v_n, plus the lever arm's w x l."""

    def __init__(self, config: VelocityAid, name: str = "doppler") -> None:
        self.name = name
        self.sigma_yaw, self.sigma_scale = np.radians(config.misalignment_deg), config.scale_ppm * 1e-6
        self.lever = np.array(config.lever_arm_m)
        self.sigma = np.array(config.sigma_mps)
        self.floor = config.sigma_floor_mps
        self.rows = 3 if config.use_down else 2
        self.coordinates = slice(0, self.rows)

    def blocks(self) -> list[Block]:
        """States of its own: mounting yaw and scale factor, where they are not known."""
        return [
            Block(f"{self.name}.yaw", (f"{self.name}_yaw [rad]",), float(self.sigma_yaw)),
            Block(f"{self.name}.scale", (f"{self.name}_scale [1]",), self.sigma_scale),
        ]

    def place(self, states: StateModel) -> None:
        """Be told the assembled state."""
        self.n = states.n
        self.yaw, self.scale = (None if at is None else at.start for at in (states.place(f"{self.name}.{state}") for state in ("yaw", "scale")))

    def measurement(self, aid: Aid, pose: Pose, parameters: Array) -> Measurement:
        """Innovation, H and R of a velocity in log axes, forward, starboard, down."""
        yaw = 0.0 if self.yaw is None else parameters[self.yaw - N_FED_BACK]
        scale = 0.0 if self.scale is None else parameters[self.scale - N_FED_BACK]
        c, s = np.cos(yaw), np.sin(yaw)
        M = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
        v_b = pose.C_nb.T @ pose.v_n + np.cross(pose.rate_b, self.lever)
        v_log = M @ v_b
        predicted = (1.0 + scale) * v_log
        turn = (1.0 + scale) * M @ pose.C_nb.T
        H = np.zeros((3, self.n))
        H[:, VEL] = -turn
        H[:, PHI] = turn @ skew(pose.v_n)
        if self.yaw is not None:
            H[:, self.yaw] = -(1.0 + scale) * np.array([v_log[1], -v_log[0], 0.0])
        if self.scale is not None:
            H[:, self.scale] = -v_log
        n = self.rows
        return Measurement((aid.z - predicted)[:n], H[:n], noise(aid.R, self.sigma, self.floor)[:n, :n])


class HeightModel:
    """Mean height of the vehicle above the ellipsoid."""

    def __init__(self, config: HeightAid) -> None:
        self.mean = config.mean_m
        self.variance = white_inflation(config.sigma_m, config.correlation_time_s, config.period_s)

    def place(self, states: StateModel) -> None:
        """Be told the assembled state."""
        self.n = states.n

    def measurement(self, pose: Pose) -> Measurement:
        """Innovation, H and R of the known mean height, on the down axis."""
        H = np.zeros((1, self.n))
        H[0, State.POS_D] = -1.0
        return Measurement(np.array([pose.h - self.mean]), H, np.array([[self.variance]]))


def noise(R: Array, sigma: Array, floor: float) -> Array:
    """Covariance to use: the reported one, or the configured sigma where it is all zeros, not below the floor.

    Parameters
    ----------
    R : (3, 3), reported
    sigma : (3,), configured
    floor : smallest sigma

    Returns
    -------
    (3, 3)
    """
    R = np.array(R) if R.any() else np.diag(sigma**2)
    low = floor**2 - np.diag(R)
    return R + np.diag(np.maximum(low, 0.0))


def reported_covariance_ok(R: Array, rows: slice) -> bool:
    """All zeros (unknown), or finite, symmetric and positive definite in the rows that are used."""
    if not np.isfinite(R[rows, rows]).all():
        return False
    if not R.any():
        return True
    part = R[rows, rows]
    return bool(np.allclose(part, part.T, rtol=1e-9, atol=1e-9 * float(np.abs(part).max())) and np.linalg.eigvalsh(part).min() > 0.0)
