"""Settings of the alignment, its phases, and what it is told and tells, as plain dataclasses.

Lives here: `AlignmentSettings` (section `alignment` of the navigator), `Phase`, `AlignCommand`, `MasterState`, `AlignmentReport`.
Does not live here: the alignment itself (aligner.py, alignment_methods.py), messages (riins_node.fields).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np

from riins_core.settings import SettingError, setting

from .types import Array, InitialState, Reason

METHODS = ("stationary", "redundant", "swaying", "in_motion", "known_heading", "hot_start", "transfer")
"""auto chooses among stationary, swaying and in_motion."""
WORDS = ("none", "auto", *METHODS)
CANCEL = "cancel"
DATA_S = {
    "stationary": 180.0, "redundant": 10.0, "swaying": 300.0, "in_motion": 300.0, "known_heading": 60.0, "hot_start": 60.0, "transfer": 60.0,
}  # fmt: skip
"""Data that a method wants before it hands over."""


class Phase(IntEnum):
    """Phase of the navigator, AlignmentStatus."""

    STANDBY = 0
    COARSE = 1
    FINE = 2
    NAVIGATING = 3
    COASTING = 4
    FAILED = 5


@dataclass(frozen=True)
class AlignmentSettings:
    """How the navigator finds its attitude where no initial state is given."""

    method: str = setting(
        "none", "none: wait for an initial state; auto: stationary, swaying or in_motion, by the motion that is seen; or one of the methods",
        choices=WORDS,
    )  # fmt: skip
    data_s: float = setting(0.0, "data before the attitude is handed over; 0: the method's own, 10 s to 300 s", "s", 0.0, 3600.0)
    attempt_s: float = setting(30.0, "interval of the attempts on the data so far", "s", 1.0, 600.0)
    time_limit_s: float = setting(1800.0, "without a heading after this time the alignment has failed", "s", 5.0, 86400.0)
    position: tuple[float, ...] = setting((), "latitude [deg], longitude [deg], height [m]; empty: of the GNSS fixes")
    position_sigma_m: float = setting(20.0, "1-sigma error of the given position", "m", 0.01, 1e5)
    heading: tuple[float, ...] = setting((), "heading and its 1 sigma, deg, for known_heading and hot_start; empty: of a heading sensor")
    heading_file: str = setting("", "file the settled heading is kept in and a hot start reads it from; empty: none")
    turned_deg: float = setting(0.5, "1-sigma turn at her moorings since the heading was saved, and yawing in waves", "deg", 0.0, 90.0)
    swing_m: float = setting(1.5, "largest 1-sigma swing about the mean place of a moored ship", "m", 0.01, 100.0)
    mounting_deg: float = setting(1.0, "1-sigma misalignment of this IMU to the master's axes, each axis", "deg", 0.001, 45.0)
    master_lever_arm_m: tuple[float, ...] = setting((0.0, 0.0, 0.0), "master from the IMU, forward, starboard, down", "m", -1e3, 1e3, length=3)
    detect_s: float = setting(20.0, "stretches of data in which auto looks for motion", "s", 5.0, 300.0)
    false_alarm_probability: float = setting(1e-6, "probability that a stretch without motion is taken for one with motion", "", 1e-15, 0.1)

    def __post_init__(self) -> None:
        if len(self.position) not in (0, 3):
            raise SettingError(f'"position" must be empty or latitude, longitude, height, not {len(self.position)} numbers', ("position",))
        if self.position and not (abs(self.position[0]) <= 90.0 and abs(self.position[1]) <= 360.0 and abs(self.position[2]) <= 1e5):
            raise SettingError('"position" must be a latitude in -90 .. 90 deg, a longitude in -360 .. 360 deg, a height within 1e5 m', ("position",))
        if len(self.heading) not in (0, 2) or (self.heading and not (abs(self.heading[0]) <= 360.0 and 0.0 < self.heading[1] <= 90.0)):
            raise SettingError('"heading" must be empty, or the heading, -360 .. 360 deg, and its sigma, 0 .. 90 deg and not 0', ("heading",))


@dataclass(frozen=True)
class AlignCommand:
    """Align from a measurement time on, or give up what is under way (method "cancel").

    Attributes
    ----------
    stamp_ns : from which samples and aids are used
    method : one of auto, METHODS, cancel
    time_limit_s : 0: that of the settings
    heading, sigma_heading : rad; sigma 0: those of the settings
    """

    stamp_ns: int
    method: str
    time_limit_s: float = 0.0
    heading: float = 0.0
    sigma_heading: float = 0.0

    def problem(self) -> str:
        """What is wrong with it, one sentence, or ''."""
        if self.method not in (*WORDS[1:], CANCEL):
            return f'there is no method "{self.method}"; there are: {", ".join(WORDS[1:])}'
        if not (math.isfinite(self.time_limit_s) and self.time_limit_s >= 0.0):
            return "the time limit must be a finite number of seconds, not negative"
        if not (math.isfinite(self.heading) and math.isfinite(self.sigma_heading) and self.sigma_heading >= 0.0):
            return "the heading and its sigma must be finite, the sigma not negative"
        return ""


@dataclass(frozen=True)
class MasterState:
    """State of another INS, of which this one learns.

    Attributes
    ----------
    stamp_ns : measurement time
    lat, lon, h : rad, rad, m
    v_n : (3,), m/s, NED
    C_nb : (3, 3), its body axes FRD to NED
    sigma_position, sigma_velocity, sigma_attitude : (3,), m, m/s, rad, NED
    valid : it navigates, and calls neither its position nor its velocity or heading invalid
    """

    stamp_ns: int
    lat: float
    lon: float
    h: float
    v_n: Array
    C_nb: Array
    sigma_position: Array
    sigma_velocity: Array
    sigma_attitude: Array
    valid: bool = True

    def defect(self) -> Reason:
        """Why it cannot be learned from: NO_FIX where the master says so itself, NOT_FINITE, COVARIANCE without standard deviations, or NONE."""
        sigma = np.concatenate([self.sigma_position, self.sigma_velocity, self.sigma_attitude])
        values = np.concatenate([[self.lat, self.lon, self.h], self.v_n, self.C_nb.ravel(), sigma])
        if not self.valid:
            return Reason.NO_FIX
        if not (np.all(np.isfinite(values)) and abs(self.lat) <= math.pi / 2):
            return Reason.NOT_FINITE
        return Reason.NONE if np.all(sigma > 0.0) else Reason.COVARIANCE


@dataclass(frozen=True)
class AlignmentReport:
    """Progress of an alignment at a measurement time.

    Attributes
    ----------
    stamp_ns, begin_ns : measurement time, settled; of the command or the first sample
    phase : Phase
    method : the method in use; "auto" until one is chosen
    rph, sigma : (3,), roll, pitch, heading and standard deviations of phi, rad; NaN: not known yet
    elapsed_s : since the alignment began
    text : what changed, one line, or ''
    place : (3,), latitude, longitude [rad], height [m]; NaN: not known
    initial : what was found; None before the end
    ended : "", "aligned", "failed", "cancelled"
    """

    stamp_ns: int
    begin_ns: int
    phase: Phase
    method: str
    elapsed_s: float
    text: str = ""
    rph: Array = field(default_factory=lambda: np.full(3, np.nan))
    sigma: Array = field(default_factory=lambda: np.full(3, np.nan))
    place: Array = field(default_factory=lambda: np.full(3, np.nan))
    initial: InitialState | None = None
    ended: str = ""
