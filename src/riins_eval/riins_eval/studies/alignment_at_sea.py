"""Alignment of a ship: moored in waves (target 49) and under way from unknown heading, with GNSS or log velocity.

Lives here: the simulated ships, rows and `run` of the chapter.
Does not live here: the methods (riins_core.alignment, riins_federated), the sea recording (alignment_recording.py).
"""

from __future__ import annotations

import functools
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from riins_core.alignment.coarse import triad
from riins_core.alignment.result import Alignment, AlignmentError, attitude_error, bounds, settled_after
from riins_core.alignment.stationary import ImuNoise, align_stationary
from riins_core.alignment.stored import Aids, Pass
from riins_core.alignment.swaying import SwayingSettings, align_swaying
from riins_core.rotation import rotate
from riins_core.sensor_errors import ARCMIN, ARCSEC, DEG, DEG_PER_H, DEG_PER_SQRT_H, MICRO_G
from riins_federated.alignment_in_motion import align_in_motion
from riins_sim.course import LegSettings
from riins_sim.scenario import Scenario, StartSettings
from riins_sim.trajectory import Trajectory, Truth
from riins_sim.vessel import VesselSettings
from riins_sim.waves import SeaSettings

from .alignment_figures import Curve, at_sea_figures
from .rows import Figure, Progress, Row, row

Array = NDArray[np.float64]

LATITUDE = 45.0
LAT = math.radians(LATITUDE)
RATE = 50
SHIP = ImuNoise(0.002 * DEG_PER_SQRT_H, 10.0 * MICRO_G, 0.01 * DEG_PER_H, 50.0 * MICRO_G)
"""Of the fused triad in seed 003."""
MOORED_S, UNDER_WAY_S = 600.0, 400.0
SEAS = {
    "harbour swell": (SeaSettings(significant_wave_height_m=2.5, direction_deg=30.0), VesselSettings()),
    "rough, ship of 30 m": (
        SeaSettings(significant_wave_height_m=3.0, direction_deg=80.0),
        VesselSettings(length_m=30.0, roll_deg_per_m=4.0, roll_period_s=7.0, pitch_deg_per_m=2.5, yaw_deg_per_m=1.0),
    ),
}
LIMIT = 1.0 * DEG
"""A heading one may sail by."""
AIDS = {"velocity": 0.05, "log": 0.05}
"""Standard deviation of each axis, m/s, 1 Hz: GNSS velocity NED, log in the body."""


@functools.cache
def moored(sea: str) -> tuple[Array, Array, Truth]:
    """True rate and force (m, 3) of a ship that stays where she is, and the truth at start and end."""
    waves, vessel = SEAS[sea]
    start = StartSettings(latitude_deg=LATITUDE, longitude_deg=10.0, heading_deg=70.0, speed_kn=0.0)
    path = Trajectory(Scenario(name="moored", duration_s=MOORED_S + 1.0, imu_rate_hz=RATE, seed=3, start=start, sea=waves, vessel=vessel))
    return (*path.increments(1, round(MOORED_S * RATE)), path.truth(np.arange(0.0, MOORED_S + 0.5)))


@functools.cache
def under_way() -> tuple[Array, Array, Truth]:
    """True rate and force (m, 3) of a ship at 10 kn that turns by 60 deg after 150 s, and the truth at every second."""
    start = StartSettings(latitude_deg=LATITUDE, longitude_deg=10.0, heading_deg=130.0, speed_kn=10.0)
    legs = (LegSettings(straight_s=150.0), LegSettings(turn_deg=60.0, rate_deg_s=1.0))
    sea = SeaSettings(significant_wave_height_m=2.5, direction_deg=30.0)
    path = Trajectory(Scenario(name="under_way", duration_s=UNDER_WAY_S + 1.0, imu_rate_hz=RATE, seed=4, start=start, legs=legs, sea=sea))
    return (*path.increments(1, round(UNDER_WAY_S * RATE)), path.truth(np.arange(0.0, UNDER_WAY_S + 0.5)))


def biases(seed: int) -> tuple[Array, Array]:
    """Gyro and accelerometer biases (3,) of a seed."""
    rng = np.random.default_rng([seed, 49])
    return SHIP.bias_g * rng.standard_normal(3), SHIP.bias_a * rng.standard_normal(3)


def sensed(rate: Array, force: Array, seed: int) -> tuple[Array, Array]:
    """What the IMU reads of it: the biases of the seed, and white noise."""
    rng, root = np.random.default_rng([seed, 50]), math.sqrt(RATE)
    bias_g, bias_a = biases(seed)
    noisy = rate + bias_g + SHIP.arw * root * rng.standard_normal(rate.shape)
    return noisy, force + bias_a + SHIP.vrw * root * rng.standard_normal(force.shape)


def _errors(history: Pass, truth: Truth) -> Array:
    index = np.rint(history.t).astype(int)
    return np.array([attitude_error(C, T) for C, T in zip(history.C_nb, truth.C_nb[index], strict=True)])


def _waves(seeds: int) -> tuple[list[Row], list[Curve]]:
    level, heading = bounds(LAT, SHIP.bias_g, SHIP.bias_a)
    rows: list[Row] = []
    curves: list[Curve] = []
    for sea in SEAS:
        rate, force, truth = moored(sea)
        errors, limits, sigmas, static, refused = [], [], [], [], 0
        for s in range(seeds):
            noisy, pushed = sensed(rate, force, s)
            found, history = align_swaying(noisy, pushed, 1.0 / RATE, LAT, SHIP, SwayingSettings())
            errors.append(attitude_error(found.C_nb, truth.C_nb[-1]))
            sigmas.append(found.sigma)
            drawn = [truth.C_nb[-1] @ b for b in biases(s)]
            limits.append([drawn[1][0] * level / SHIP.bias_a, drawn[1][1] * level / SHIP.bias_a, drawn[0][1] * heading / SHIP.bias_g])
            static.append(attitude_error(triad(pushed.mean(axis=0), noisy.mean(axis=0), LAT), truth.C_nb[-1]))
            refused += _refused(noisy, pushed)
            if s == 0:
                curves.append((sea, history.t, _errors(history, truth), history.sigma))
        e, limit, own = np.array(errors), np.array(limits), float(sigmas[0][2]) / heading
        level_limit, heading_limit = _rms(limit[:, :2]), _rms(limit[:, 2])
        rows += [
            row(49, f"{sea}: level / (bias/g), RMS", np.sqrt(np.mean(e[:, :2] ** 2, axis=1)) / level_limit, centre=_rms, ok=lambda r: r.value <= 1.6,
                remark=f"bound: bias/g of the biases drawn, {level_limit / ARCSEC:.1f} arcsec RMS over the seeds, {level / ARCSEC:.1f} of all"),
            row(49, f"{sea}: heading / (eps/(W cos L)), RMS", np.abs(e[:, 2]) / heading_limit, centre=_rms, ok=lambda r: r.value <= 1.5,
                remark=f"bound: eps/(W cos L) of the drifts drawn, {heading_limit / ARCMIN:.2f} arcmin RMS, {heading / ARCMIN:.2f} of all; own sigma "
                f"{own:.2f} of it; with the angle random walk of 600 s {_with_noise():.2f} is the least"),
            row(None, f"{sea}: RMS of attitude errors / own sigma", np.sqrt(np.mean((e / np.array(sigmas)) ** 2, axis=1)), centre=_rms,
                ok=lambda r: 0.5 < r.value < 1.3),
            row(None, f"{sea}: TRIAD of the means, error, °", np.linalg.norm(static, axis=1) / DEG, remark="what a static method would give"),
            row(None, f"{sea}: part refused by the static method", refused / seeds, ok=lambda r: r.value == 1.0),
        ]  # fmt: skip
    return rows, curves


def _with_noise() -> float:
    """Bound with the gyros' white noise over that with their drift alone: tilt without error at both ends gives the rate to arw / sqrt(T)."""
    return math.hypot(1.0, SHIP.arw / math.sqrt(MOORED_S) / SHIP.bias_g)


def _refused(rate: Array, force: Array) -> int:
    try:
        align_stationary(rate, force, 1.0 / RATE, LAT, SHIP)
    except AlignmentError:
        return 1
    return 0


def in_motion(kind: str, seed: int) -> tuple[Alignment, Pass, Truth]:
    """Alignment under way of one seed."""
    rate, force, truth = under_way()
    noisy, pushed = sensed(rate, force, seed)
    v, sigma = truth.v_n[1:], AIDS[kind]
    value = v if kind == "velocity" else rotate(np.swapaxes(truth.C_nb[1:], 1, 2), v)
    value = value + sigma * np.random.default_rng([seed, 51]).standard_normal(value.shape)
    aids = Aids(kind, np.arange(RATE, len(rate) + 1, RATE), value, np.full(3, sigma))
    found, history = align_in_motion(noisy, pushed, 1.0 / RATE, (float(truth.lat[0]), float(truth.lon[0]), 0.0), SHIP, aids)
    return found, history, truth


def _motion(seeds: int, progress: Progress) -> tuple[list[Row], list[Curve]]:
    rows: list[Row] = []
    curves: list[Curve] = []
    for i, (kind, name) in enumerate((("velocity", "GNSS velocity"), ("log", "Doppler log"))):
        errors, scaled, tilts, times = [], [], [], []
        for s in range(seeds):
            found, history, truth = in_motion(kind, s)
            phi = attitude_error(found.C_nb, truth.C_nb[-1])
            errors.append(abs(phi[2]) / ARCMIN)
            tilts.append(_rms(phi[:2]) / bounds(LAT, SHIP.bias_g, SHIP.bias_a)[0])
            times.append(settled_after(history.t, history.sigma[:, 2], LIMIT))
            scaled.append(errors[-1] * ARCMIN / found.sigma[2])
            if s == 0:
                curves.append((name, history.t, _errors(history, truth), history.sigma))
            progress((i + (s + 1) / seeds) / 2.0)
        rows += [
            row(None, f"{name}, unknown heading, {UNDER_WAY_S:.0f} s: heading, arcmin, RMS", errors, centre=_rms),
            row(None, f"{name}: part within 3 sigma of its own covariance", np.array(scaled) <= 3.0, ok=lambda r: r.value >= 0.95),
            row(None, f"{name}: heading error / own sigma, RMS", scaled, centre=_rms),
            row(None, f"{name}: tilt / (bias/g), RMS", tilts, centre=_rms, ok=lambda r: r.value < 1.0,
                remark="below the bound of a ship that does not turn: the turn tells bias and tilt apart"),
            row(None, f"{name}: 2 sigma of the heading inside 1° after, s", times),
        ]  # fmt: skip
    return rows, curves


def _rms(values: Any) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def run(seeds: int, quick: bool, progress: Progress) -> tuple[list[Row], list[Figure]]:
    """The chapter."""
    rows, waves = _waves(max(seeds, 20))
    progress(0.5)
    more, way = _motion(seeds, lambda part: progress(0.5 + 0.4 * part))
    return rows + more, at_sea_figures(waves, way)
