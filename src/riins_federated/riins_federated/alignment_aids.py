"""What the aids of a navigator are to an alignment: place, velocity over ground or of a log, heading; and which of them serve.

Lives here: `Role`, `roles`, `imu_noise`, `Fixes`, `fixes`, `velocities`, `heading_at`.
Does not live here: the measurements (alignment_store.py), the methods (alignment_methods.py).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from riins_core.alignment.stationary import ImuNoise
from riins_core.alignment.stored import Aids
from riins_core.earth import radii
from riins_core.rotation import dcm_from_euler
from riins_core.sensor_errors import DEG_PER_H, DEG_PER_SQRT_H, MICRO_G

from .aids.body_velocity import BodyVelocitySettings
from .aids.gnss_position import GnssPositionSettings
from .aids.gnss_velocity import GnssVelocitySettings
from .aids.heading import HeadingSettings
from .alignment_store import AlignmentData, Window
from .config import NavigatorConfig
from .types import Array

UNMEASURED_MPS = 0.5
"""1-sigma vertical velocity of a ship in waves, for a log that does not measure it."""


@dataclass(frozen=True)
class Role:
    """An aid as an alignment sees it.

    Attributes
    ----------
    kind : place, velocity (NED), log (FRD) or heading
    sigma : (3,), where a measurement tells none; m or m/s
    floor : a smaller one is raised to this
    lever : (3,), m, FRD
    slow : 1 sigma of an error that no mean takes away, m
    log_prior : 1 sigma of yaw [rad] and scale factor
    mounting : (3, 3), from the axes of a log to the body
    offset : what a heading sensor reads too much, rad
    """

    kind: str
    sigma: Array
    floor: float
    lever: Array
    slow: float = 0.0
    log_prior: tuple[float, float] = (0.0, 0.0)
    mounting: Array = field(default_factory=lambda: np.eye(3))
    offset: float = 0.0


def roles(config: NavigatorConfig) -> dict[str, Role]:
    """Roles of the declared aids that serve an alignment, by name of the subfilter."""
    found: dict[str, Role] = {}
    for name, aid in config.aid.items():
        if not aid.enabled:
            continue
        if isinstance(aid, GnssPositionSettings):
            found[name] = Role("place", np.array(aid.sigma_m), aid.sigma_floor_m, np.array(aid.lever_arm_m), aid.markov_sigma_m)
        elif isinstance(aid, GnssVelocitySettings):
            found[name] = Role("velocity", np.array(aid.sigma_mps), aid.sigma_floor_mps, np.array(aid.lever_arm_m))
        elif isinstance(aid, BodyVelocitySettings):
            mounting = dcm_from_euler(0.0, math.radians(aid.mounting_pitch_deg), math.radians(aid.mounting_yaw_deg))
            prior = (math.radians(aid.misalignment_deg), aid.scale_ppm * 1e-6)
            found[name] = Role("log", np.array(aid.sigma_mps), aid.sigma_floor_mps, np.array(aid.lever_arm_m), log_prior=prior, mounting=mounting)
        elif isinstance(aid, HeadingSettings):
            sigma = math.radians(math.hypot(aid.sigma_deg, aid.deviation_deg))
            found[name] = Role("heading", np.full(3, sigma), math.radians(aid.sigma_floor_deg), np.zeros(3), offset=math.radians(aid.offset_deg))
    return found


def imu_noise(config: NavigatorConfig, window: Window) -> ImuNoise:
    """Noise and biases of an axis: the configured model, or what the fusion says of its samples where that is more."""
    model, root = config.inertial, math.sqrt(window.dt)
    return ImuNoise(
        max(model.gyro_arw_deg_sqrt_h * DEG_PER_SQRT_H, float(window.noise[0]) * root),
        max(model.accel_vrw_ug_sqrt_hz * MICRO_G, float(window.noise[1]) * root),
        math.hypot(model.gyro_bias_deg_h, model.gyro_markov_deg_h) * DEG_PER_H,
        model.accel_bias_ug * MICRO_G,
    )


class Fixes(NamedTuple):
    """Fixes: stamps (k,), lat, lon, h (k, 3), variances (k, 3) [m^2], lever arms (k, 3), slow errors (k,)."""

    stamp_ns: Array
    place: Array
    variance: Array
    lever: Array
    slow: Array

    def offset(self, origin: Array) -> Array:
        """North, east, down (k, 3) [m] from an origin (lat, lon, h)."""
        r_m, r_n = (float(r) for r in radii(origin[0]))
        d = self.place - origin
        east = np.mod(d[:, 1] + math.pi, 2.0 * math.pi) - math.pi
        return np.column_stack([d[:, 0] * (r_m + origin[2]), east * (r_n + origin[2]) * math.cos(origin[0]), -d[:, 2]])

    def mean(self) -> tuple[Array, Array, Array]:
        """Weighted mean place (lat, lon, h), its sigma (3,) [m] and lever arm (3,) of a ship that stays where she is."""
        origin = self.place[0]
        weight = 1.0 / self.variance
        total = weight.sum(axis=0)
        mean = (weight * self.offset(origin)).sum(axis=0) / total
        lever = (weight[:, :1] * self.lever).sum(axis=0) / weight[:, 0].sum()
        return moved(origin, mean), np.sqrt(1.0 / total + self.slow.min() ** 2), lever


def moved(origin: Array, ned: Array) -> Array:
    """Place (lat, lon, h) that lies `ned` (3,) [m] from an origin."""
    r_m, r_n = (float(r) for r in radii(origin[0]))
    return np.array(
        [
            origin[0] + ned[0] / (r_m + origin[2]),
            origin[1] + ned[1] / ((r_n + origin[2]) * math.cos(origin[0])),
            origin[2] - ned[2],
        ]
    )


def fixes(known: dict[str, Role], data: AlignmentData, until_ns: int) -> Fixes | None:
    """Fixes of the position aids up to a stamp; None where there are none."""
    names = tuple(name for name, role in known.items() if role.kind == "place")
    taken = data.aids(names, until_ns)
    if not taken:
        return None
    return Fixes(
        np.array([a.stamp_ns for a in taken], np.int64),
        np.array([a.z[:3] for a in taken], np.float64),
        np.array([_variance(a.R, known[a.name]) for a in taken]),
        np.array([known[a.name].lever for a in taken]),
        np.array([known[a.name].slow for a in taken]),
    )


def velocities(known: dict[str, Role], data: AlignmentData, window: Window) -> Aids | None:
    """Velocities within a window, of the aid that has most of them; over ground before those of a log; None where there are none.

    Notes
    -----
    Velocity over ground shows the heading in every change of velocity, that of a log does not.
    """
    best: Aids | None = None
    for kind in ("velocity", "log"):
        for name, role in known.items():
            taken = data.aids((name,), window.end_ns) if role.kind == kind else []
            taken = [a for a in taken if a.stamp_ns > window.edges[0]]
            if not taken or (best is not None and len(taken) <= len(best.index)):
                continue
            value = np.array([a.z[:3] for a in taken], np.float64)
            variance = np.array([_variance(a.R, role) for a in taken])
            unmeasured = ~np.isfinite(value)
            value[unmeasured], variance[unmeasured] = 0.0, UNMEASURED_MPS**2
            if kind == "log":
                value = value @ role.mounting.T
            index = window.index(np.array([a.stamp_ns for a in taken], np.int64))
            keep = np.concatenate([np.diff(index) > 0, [True]]) & (index > 0)
            best = Aids(kind, index[keep], value[keep], np.sqrt(variance[keep].mean(axis=0)), role.lever, role.log_prior)
        if best is not None and len(best.index) >= 10:
            return best
    return best


def heading_at(known: dict[str, Role], data: AlignmentData, window: Window) -> tuple[float, float] | None:
    """Heading at the beginning of a window and its sigma, rad: the first measurement of a heading sensor; None where there is none."""
    for name, role in known.items():
        taken = data.aids((name,), window.end_ns) if role.kind == "heading" else []
        taken = [a for a in taken if a.stamp_ns > window.edges[0]]
        if taken:
            reported = float(taken[0].R[0, 0])
            sigma = math.sqrt(reported) if math.isfinite(reported) and reported > 0.0 else float(role.sigma[0])
            turned = float(window.rate[: max(1, int(window.index(np.array([taken[0].stamp_ns]))[0])), 2].sum()) * window.dt
            return float(taken[0].z[0]) - role.offset - turned, max(sigma, role.floor)
    return None


def _variance(R: Array, role: Role) -> Array:
    """Variance (3,) of a measurement, the configured one where it tells none."""
    own = np.diag(R)[:3] if R.any() else np.square(role.sigma)
    return np.maximum(np.where(np.isfinite(own) & (own > 0.0), own, np.square(role.sigma)), role.floor**2)
