"""What goes into the navigator and what comes out of it, as plain dataclasses.

Lives here: initial state, aid measurement, settled epoch, judged innovation, commands, counters and their enumerations (values as in riins_msgs).
Does not live here: parameters (config.py), messages (riins_node.fields), any computation.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from riins_fdi.health import Change

Array = NDArray[np.float64]


class Mode(IntEnum):
    """Mode of the navigator, NavState.MODE_*."""

    WAITING = 0
    ALIGNMENT = 1
    NAVIGATING = 2
    COASTING = 3
    FAILED = 4


class Validity(IntEnum):
    """Validity of a datum in the sense of IMO MSC.252(83)."""

    VALID = 0
    DOUBTFUL = 1
    INVALID = 2


class Reason(IntEnum):
    """Why a measurement was not fused, SubfilterStatus.REASON_*."""

    NONE = 0
    NIS = 1
    HOLD = 2
    LATE = 3
    NOT_FINITE = 4
    NO_FIX = 5
    COVARIANCE = 6
    OPERATOR = 7
    SEPARATION = 8
    NOT_READY = 9
    DUPLICATE = 10
    INNOVATIONS = 11
    FRAME = 12
    AHEAD = 13


@dataclass(frozen=True)
class InitialState:
    """State the navigator starts from.

    Attributes
    ----------
    stamp_ns : measurement time at which it holds
    lat, lon, h : rad, rad, m above the ellipsoid
    v_n : (3,), m/s, NED
    rph : (3,), roll, pitch, heading, rad
    sigma_position, sigma_velocity, sigma_attitude : (3,), m, m/s, rad, NED
    sigma_gyro_bias, sigma_accel_bias : (3,), rad/s, m/s^2, FRD; zeros: the navigator's own
    covariance : None, or (15, 15) in the order of riins_core.ins_error.State; overrides the sigmas
    source : who says so
    gyro_bias, accel_bias : (3,), what is known of the biases, measured - true, rad/s, m/s^2, FRD
    """

    stamp_ns: int
    lat: float
    lon: float
    h: float
    v_n: Array
    rph: Array
    sigma_position: Array
    sigma_velocity: Array
    sigma_attitude: Array
    sigma_gyro_bias: Array = field(default_factory=lambda: np.zeros(3))
    sigma_accel_bias: Array = field(default_factory=lambda: np.zeros(3))
    covariance: Array | None = None
    source: str = ""
    gyro_bias: Array = field(default_factory=lambda: np.zeros(3))
    accel_bias: Array = field(default_factory=lambda: np.zeros(3))

    def problem(self) -> str:
        """What is wrong with it, one sentence, or '' when it can be used."""
        numbers = np.concatenate([[self.lat, self.lon, self.h], self.v_n, self.rph, self.gyro_bias, self.accel_bias])
        sigmas = np.concatenate([self.sigma_position, self.sigma_velocity, self.sigma_attitude, self.sigma_gyro_bias, self.sigma_accel_bias])
        if not (np.isfinite(numbers).all() and np.isfinite(sigmas).all()):
            return "the initial state holds a value that is not finite"
        if abs(self.lat) > np.radians(89.9):
            return "the initial latitude is beyond 89.9 deg: NED is singular at the poles"
        if abs(self.lon) > 2.0 * np.pi or abs(self.h) > 1e5:
            return "the initial longitude must be within 360 deg, the initial height within 1e5 m"
        if self.covariance is not None:
            if np.shape(self.covariance) != (15, 15) or not np.isfinite(self.covariance).all():
                return "the initial covariance must be 15 x 15 and finite"
            if (np.diag(self.covariance) < 0.0).any():
                return "the initial covariance holds a negative variance"
            sigma = np.sqrt(np.diag(self.covariance))
            scale = np.where(sigma > 0.0, sigma, 1.0)  # units differ by 1e8
            if np.linalg.eigvalsh(self.covariance / np.outer(scale, scale)).min() < -1e-9:
                return "the initial covariance is not positive semidefinite"
        elif (sigmas[:9] <= 0.0).any() or (sigmas < 0.0).any():
            return "the initial sigmas of position, velocity and attitude must be positive"
        return ""


@dataclass(frozen=True)
class Aid:
    """One measurement of an aid.

    Attributes
    ----------
    name : the subfilter it is for
    stamp_ns : measurement time
    z : (m,), what the type of aid says: latitude, longitude [rad], height [m]; forward, starboard, down [m/s] (NaN third: not measured); ...
    R : covariance, NED m^2 or FRD (m/s)^2 or as the type says; all zeros: unknown, the configured sigma is used
    ok : False: the sensor says it has no fix
    frame : frame_id of its message, None: it came otherwise
    """

    name: str
    stamp_ns: int
    z: Array
    R: Array
    ok: bool = True
    frame: str | None = None


@dataclass(frozen=True)
class Recall:
    """What inertial sensors declared faulty at an IMU sample have put into attitude and velocity since their faults began.

    Attributes
    ----------
    stamp_ns : of the sample, itself free of it
    onset_ns : estimated beginning
    angle : (3,), rad, body FRD at `stamp_ns`: the integrated attitude is C_nb exp([angle x]) instead of C_nb
    velocity : (3,), m/s, body FRD at `stamp_ns`: excess of the integrated velocity
    """

    stamp_ns: int
    onset_ns: int
    angle: Array
    velocity: Array


@dataclass(frozen=True)
class UseCommand:
    """The operator excludes or restores a subfilter from a measurement time on."""

    name: str
    use: bool
    stamp_ns: int


@dataclass(frozen=True)
class NavSolution:
    """Navigation state at one instant, after output correction.

    Attributes
    ----------
    stamp_ns : measurement time
    lat, lon, h : rad, rad, m
    v_n : (3,), m/s, NED
    rph : (3,), roll, pitch, heading 0..2 pi, rad
    C_nb : (3, 3)
    rate_b : (3,), body rate relative to NED, rad/s, FRD
    force_b : (3,), specific force less bias, m/s^2, FRD
    bias_g, bias_a : (3,), rad/s, m/s^2, FRD
    P : (n, n), covariance of the error state, order of the assembled state (state_blocks.StateModel)
    mode : Mode
    validity : (position, velocity, heading)
    protection_radius : m, horizontal, at the configured integrity risk
    protection_heading : rad, at the same risk
    reset_count : corrections larger than one sigma, and re-initialisations
    reset : (position [m], velocity [m/s], heading [rad]) of the last of them
    inertial : the solution without output correction, of a settled epoch where there is such a correction
    """

    stamp_ns: int
    lat: float
    lon: float
    h: float
    v_n: Array
    rph: Array
    C_nb: Array
    rate_b: Array
    force_b: Array
    bias_g: Array
    bias_a: Array
    P: Array
    mode: Mode
    validity: tuple[Validity, Validity, Validity]
    protection_radius: float
    protection_heading: float
    reset_count: int
    reset: tuple[float, float, float]
    inertial: NavSolution | None = None


SettledEpoch = NavSolution


@dataclass(frozen=True)
class Judged:
    """An aid measurement and the verdict on it.

    Attributes
    ----------
    stamp_ns, name : as in Aid
    innovation, sigma, standardized : (m,), measured - predicted, its 1 sigma, whitened by the Cholesky factor
    nis, threshold : dimensionless, chi-square with m degrees of freedom
    accepted : it entered the navigation state, and was not taken out of it at once
    reason : Reason, NONE when accepted; SEPARATION: nis and threshold are those of the separation
    frame : of the components of innovation and sigma
    """

    stamp_ns: int
    name: str
    innovation: Array
    sigma: Array
    standardized: Array
    nis: float
    threshold: float
    accepted: bool
    reason: Reason
    frame: str = "map_ned"


@dataclass(frozen=True)
class TakenOut:
    """What an aid had put in has been taken out of the solution.

    Attributes
    ----------
    stamp_ns, name : of the sample at which the separation of solutions found it, and the aid
    change : of its health, None where it was out of use already
    statistic, threshold : of the separation
    reset : (position [m], velocity [m/s], heading [rad]) by which the solution has changed
    """

    stamp_ns: int
    name: str
    change: Change | None
    statistic: float
    threshold: float
    reset: tuple[float, float, float]


class EventKind(IntEnum):
    """What a NavEvent is about; values as in NavEvent.msg."""

    HEALTH = 0
    BEGUN = 1
    RESTARTED = 2
    RECALLED = 3
    TAKEN_OUT = 4


@dataclass(frozen=True)
class NavEvent:
    """Something an operator wants to know.

    Attributes
    ----------
    stamp_ns : measurement time
    text : one line
    kind : EventKind
    target, state, reason : of a change of health: the subfilter, its new state (SubfilterStatus constant) and why; else '', None, NONE
    """

    stamp_ns: int
    text: str
    kind: EventKind
    target: str = ""
    state: int | None = None
    reason: Reason = Reason.NONE


@dataclass(frozen=True)
class SubfilterReport:
    """State of one local filter; counters are exact for everything judged up to the newest IMU sample.

    separation, separation_threshold : of the solution without this aid from the solution, 0 where it is not tested
    """

    name: str
    state: int
    reason: Reason
    stamp_ns: int
    since_ns: int
    statistic: float
    threshold: float
    beta: float
    information_trace: tuple[float, float]
    accepted: int
    rejected: int
    late: int
    malformed: int
    no_fix: int
    separation: float = 0.0
    separation_threshold: float = 0.0


@dataclass(frozen=True)
class FederatedReport:
    """State of the federated filter.

    cross_check, cross_check_threshold : of two satellite receivers against each other, the last time both measured at one IMU sample; 0: never
    """

    stamp_ns: int
    mode: Mode
    subfilters: tuple[SubfilterReport, ...]
    imu_received: int
    imu_lost: int
    imu_rejected: int
    restarts: int
    rollbacks: int
    cross_check: float = 0.0
    cross_check_threshold: float = 0.0
