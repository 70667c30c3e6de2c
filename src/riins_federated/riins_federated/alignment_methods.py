"""One attempt of an alignment on the data so far: every method ends in the same state with the same covariance.

Lives here: `Found`, `attempt`: place, data and aids to the methods, and their results to 15 error states.
Does not live here: the methods (riins_core.alignment, alignment_in_motion.py, alignment_hot_start.py, alignment_transfer.py), when (aligner.py).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from riins_core.alignment.coarse import check_still, triad
from riins_core.alignment.result import Alignment, AlignmentError, TooSoon, bias_covariance, bias_response, check_latitude
from riins_core.alignment.stationary import ImuNoise, StationarySettings, align_stationary
from riins_core.alignment.stored import Aids, Pass
from riins_core.alignment.swaying import SwayingSettings, align_swaying
from riins_core.earth import OMEGA_IE
from riins_core.ins_error import BA, BG, PHI, POS, VEL
from riins_core.rotation import euler_from_dcm

from .alignment_aids import Fixes, Role, fixes, heading_at, imu_noise, moved, velocities
from .alignment_detect import Motion
from .alignment_hot_start import SavedHeading, align_known_heading, check_heading, hot_start
from .alignment_in_motion import InMotionSettings, align_in_motion
from .alignment_settings import AlignmentSettings
from .alignment_store import AlignmentData, Window
from .alignment_transfer import align_transfer
from .config import NavigatorConfig
from .types import Array, InitialState

AT_REST_MPS = 0.002
"""Error of a zero velocity at rest: vibration."""
REST_MPS = 0.02
"""1-sigma velocity of a ship at rest that is handed over."""
ANY_HEADING_DEG = 60.0
PLACE_FALSE_ALARM = 1e-6
"""Probability with which a right given position is refused for the fixes' sake."""


@dataclass(frozen=True)
class Found:
    """Result of an attempt, at the end of its data.

    Attributes
    ----------
    stamp_ns : measurement time
    C_nb : (3, 3)
    v_n : (3,), m/s
    place : (3,), latitude, longitude [rad], height [m]
    bias_g, bias_a : (3,), estimated biases that have been taken out
    P : (15, 15), order of riins_core.ins_error.State
    """

    stamp_ns: int
    C_nb: Array
    v_n: Array
    place: Array
    bias_g: Array
    bias_a: Array
    P: Array

    def initial_state(self, source: str) -> InitialState:
        """As the navigator begins from it."""
        s = np.sqrt(np.diag(self.P))
        lat, lon, h = (float(v) for v in self.place)
        rph = np.array([float(a) for a in euler_from_dcm(self.C_nb)])
        return InitialState(
            self.stamp_ns, lat, lon, h, self.v_n, rph, s[POS], s[VEL], s[PHI], s[BG], s[BA], self.P, source, self.bias_g, self.bias_a
        )  # fmt: skip


@dataclass(frozen=True)
class Task:
    """What an attempt has to go by.

    Attributes
    ----------
    config : of the navigator
    known : aids that serve, by name
    data : samples and aids
    heading : known or saved heading and sigma, rad; None: none
    """

    config: NavigatorConfig
    known: dict[str, Role]
    data: AlignmentData
    heading: tuple[float, float] | None = None

    @property
    def settings(self) -> AlignmentSettings:
        """Section alignment."""
        return self.config.alignment


@dataclass(frozen=True)
class _Place:
    """Where the ship is: place (3,), sigma (3,) [m], lever arm (3,) of what measured it."""

    place: Array
    sigma: Array
    lever: Array


def attempt(method: str, task: Task, until_ns: int, motion: Motion) -> Found:
    """Try a method on the data up to a stamp.

    Parameters
    ----------
    method : one of alignment_settings.METHODS
    task : settings and data
    until_ns : measurement time up to which everything is settled
    motion : what the ship does, for the methods that serve both at rest and under way

    Returns
    -------
    Found

    Raises
    ------
    AlignmentError
        No attitude; `TooSoon` where more data may give one.
    """
    if method == "transfer":
        return _transfer(task, until_ns)
    if method == "in_motion" or (motion is Motion.UNDER_WAY and method in ("known_heading", "hot_start")):
        return _under_way(method, task, until_ns)
    window = task.data.window(until_ns)
    if window is None:
        raise TooSoon("there are no samples yet")
    here = _moored_place(task, until_ns)
    check_latitude(float(here.place[0]))
    imu, lat = imu_noise(task.config, window), float(here.place[0])
    if method == "stationary":
        found, _ = align_stationary(window.rate, window.force, window.dt, lat, imu, StationarySettings(again=True, velocity_sigma_mps=AT_REST_MPS))
        return _at_rest(found, window, here, imu, task)
    if method == "redundant":
        return _at_rest(_redundant(window, lat, imu), window, here, imu, task)
    if method == "swaying":
        _, run = _swaying(window, here, imu, task)
        return _of_pass(run, window, here, task)
    heading = _heading(method, task, window)
    if motion is Motion.REST:
        return _at_rest(hot_start(window.rate, window.force, window.dt, lat, imu, heading), window, here, imu, task)
    return _of_pass(_swaying_known(window, here, imu, task, heading), window, here, task)


def _swaying(window: Window, here: _Place, imu: ImuNoise, task: Task) -> tuple[Alignment, Pass]:
    coarse_s = max(60.0, min(300.0, window.length_s - window.dt))
    settings = SwayingSettings(coarse_s=coarse_s, swing_m=task.settings.swing_m)
    return align_swaying(window.rate, window.force, window.dt, float(here.place[0]), imu, settings, float(here.place[1]), float(here.place[2]))


def _swaying_known(window: Window, here: _Place, imu: ImuNoise, task: Task, known: SavedHeading) -> Pass:
    """A known heading in waves. The place alone hardly judges it in a minute, so gyros that feel the Earth rate are asked by themselves."""
    if imu.bias_g < 0.5 * OMEGA_IE * math.cos(float(here.place[0])):
        own, _ = _swaying(window, here, imu, task)
        check_heading(own, known)
    index = np.arange(1, int(window.length_s / 5.0) + 1, dtype=np.int64) * round(5.0 / window.dt)
    index = index[index <= len(window.rate)]
    still = Aids("place", index, np.zeros((len(index), 3)), np.full(3, task.settings.swing_m))
    return align_known_heading(window.rate, window.force, window.dt, tuple(here.place), imu, still, known, task.settings.swing_m)


def _heading(method: str, task: Task, window: Window) -> SavedHeading:
    """Given, or of a heading sensor; the moorings turn a ship, not the antennas."""
    if task.heading is not None:
        return SavedHeading(*task.heading, math.radians(task.settings.turned_deg))
    seen = heading_at(task.known, task.data, window) if method == "known_heading" else None
    if seen is None:
        raise TooSoon("no heading is known: none is given, and no heading sensor has measured one")
    return SavedHeading(*seen, 0.0)


def _redundant(window: Window, lat: float, imu: ImuNoise) -> Alignment:
    """Least squares of all healthy sensors, which the fusion has made, then TRIAD."""
    check_still(window.rate, window.force, window.dt, lat, imu.arw, imu.vrw, imu.bias_g, imu.bias_a)
    C = triad(window.force.mean(axis=0), window.rate.mean(axis=0), lat)
    time = window.length_s
    P = bias_covariance(lat, C, (imu.bias_g**2 + imu.arw**2 / time) * np.eye(3), (imu.bias_a**2 + imu.vrw**2 / time) * np.eye(3))
    return Alignment("redundant least squares", C, P, time)


def _given(task: Task) -> _Place | None:
    p = task.settings.position
    if not p:
        return None
    return _Place(np.array([math.radians(p[0]), math.radians(p[1]), p[2]]), np.full(3, task.settings.position_sigma_m), np.zeros(3))


def _moored_place(task: Task, until_ns: int) -> _Place:
    given, seen = _given(task), fixes(task.known, task.data, until_ns)
    if given is not None:
        _compare(given, seen)
        return given
    if seen is None:
        raise TooSoon("no position: there is no GNSS fix, and none is given")
    place, sigma, lever = seen.mean()
    return _Place(place, np.hypot(sigma, task.settings.swing_m), lever)


def _compare(given: _Place, seen: Fixes | None) -> None:
    """Refuse a given position that is not where the fixes are."""
    if seen is None:
        return
    off = seen.offset(given.place)[0, :2]
    variance = float(seen.variance[0, :2].max() + seen.slow[0] ** 2 + np.sum(seen.lever[0] ** 2) + given.sigma[0] ** 2)
    if float(off @ off) > chi2.isf(PLACE_FALSE_ALARM, 2) * variance:
        lat, lon = np.degrees(seen.place[0, :2])
        raise AlignmentError(
            f"the given position {np.degrees(given.place[0]):.4f}, {np.degrees(given.place[1]):.4f} deg is {np.linalg.norm(off) / 1000.0:.3g} km "
            f"from the GNSS fix {lat:.4f}, {lon:.4f}: wrong latitude or longitude"
        )


def _imu_place(place: Array, C_nb: Array, lever: Array, task: Task) -> Array:
    """Place of the IMU; a ship knows its height better than GNSS does."""
    lat, lon, h = moved(place, -C_nb @ lever)
    height = task.config.height
    return np.array([lat, lon, height.above_ellipsoid if height.enabled else h])


def _at_rest(found: Alignment, window: Window, here: _Place, imu: ImuNoise, task: Task) -> Found:
    """15 states of a ship at rest: the attitude errors that the biases make are known to be theirs."""
    P = np.zeros((15, 15))
    P[POS, POS], P[VEL, VEL], P[PHI, PHI] = np.diag(_sigma_place(here, task) ** 2), REST_MPS**2 * np.eye(3), found.P
    P[BG, BG], P[BA, BA] = imu.bias_g**2 * np.eye(3), imu.bias_a**2 * np.eye(3)
    by_g, by_a = bias_response(float(here.place[0]), found.C_nb)
    P[PHI, BG], P[PHI, BA] = by_g * imu.bias_g**2, by_a * imu.bias_a**2
    own = found.P - by_g @ P[BG, BG] @ by_g.T - by_a @ P[BA, BA] @ by_a.T
    if np.linalg.eigvalsh(own).min() < -1e-3 * np.trace(found.P):  # sharpened by a heading: the bias takes its part of it no longer
        P[PHI, BG] = 0.0
    P[BG, PHI], P[BA, PHI] = P[PHI, BG].T, P[PHI, BA].T
    place = _imu_place(here.place, found.C_nb, here.lever, task)
    return Found(window.end_ns, found.C_nb, np.zeros(3), place, np.zeros(3), np.zeros(3), _proper(P))


def _of_pass(run: Pass, window: Window, here: _Place, task: Task) -> Found:
    """15 states of a pass over the stored data about a place whose own error comes on top."""
    P = run.P.copy()
    P[POS, POS] += np.diag(_sigma_place(here, task) ** 2)
    place = _imu_place(run.place, run.C_end, here.lever, task)
    return Found(window.end_ns, run.C_end, run.v_n, place, run.bias_g, run.bias_a, _proper(P))


def _sigma_place(here: _Place, task: Task) -> Array:
    height = task.config.height
    return np.array([here.sigma[0], here.sigma[1], height.sigma_m if height.enabled else here.sigma[2]])


def _under_way(method: str, task: Task, until_ns: int) -> Found:
    """From the first fix on, or from the beginning where a position is given."""
    given, seen = _given(task), fixes(task.known, task.data, until_ns)
    if given is not None:
        _compare(given, seen)
        window, here = task.data.window(until_ns), given
    elif seen is None:
        raise TooSoon("no position: there is no GNSS fix, and none is given")
    else:
        window = task.data.window(until_ns, int(seen.stamp_ns[0]))
        here = _Place(seen.place[0], np.sqrt(seen.variance[0] + seen.slow[0] ** 2), seen.lever[0])
    check_latitude(float(here.place[0]))
    if window is None:
        raise TooSoon("there are no samples yet")
    aids = velocities(task.known, task.data, window)
    if aids is None:
        raise TooSoon("no velocity: an alignment under way needs a log or GNSS velocity")
    imu = imu_noise(task.config, window)
    place = (float(here.place[0]), float(here.place[1]), float(here.place[2]))
    if method == "in_motion":
        settings = InMotionSettings(place_m=float(np.max(here.sigma[:2])), heading_limit_deg=ANY_HEADING_DEG, shortest_s=30.0)
        _, run = align_in_motion(window.rate, window.force, window.dt, place, imu, aids, settings)
    else:
        heading = _heading(method, task, window)
        run = align_known_heading(window.rate, window.force, window.dt, place, imu, aids, heading, float(np.max(here.sigma[:2])))
    place_now = _imu_place(run.place, run.C_nb[0], here.lever, task)  # the fix is the first one's
    P = run.P.copy()
    P[2, 2] = max(P[2, 2], _sigma_place(here, task)[2] ** 2)
    return Found(window.end_ns, run.C_end, run.v_n, place_now, run.bias_g, run.bias_a, _proper(P))


def _transfer(task: Task, until_ns: int) -> Found:
    states = task.data.masters(until_ns)
    if not states:
        raise TooSoon("no state of the master INS has come")
    window = task.data.window(until_ns, states[0].stamp_ns)
    if window is None:
        raise TooSoon("there are no samples yet")
    settings = task.settings
    run, place = align_transfer(
        window, states, imu_noise(task.config, window), math.radians(settings.mounting_deg), np.array(settings.master_lever_arm_m)
    )
    return Found(window.end_ns, run.C_end, run.v_n, place, run.bias_g, run.bias_a, _proper(run.P))


def _proper(P: Array) -> Array:
    """Symmetric, and positive definite to rounding."""
    scale = np.sqrt(np.maximum(np.diag(P), 1e-30))
    unit = 0.5 * (P + P.T) / np.outer(scale, scale)
    least = float(np.linalg.eigvalsh(unit).min())
    if least < 1e-9:
        unit += (1e-9 - least) * np.eye(len(P))
    return np.asarray(unit * np.outer(scale, scale))
