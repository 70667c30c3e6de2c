"""The filter that goes over stored data: strapdown and 15 error states with measured place or velocity, from a start found later than its time.

Lives here: `Aids`, `Start`, `run_stored`, `check_biases`, `start_of_end`. Does not live here: the first attitude (inertial_frame.py), faults of aids.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from ..earth import radii
from ..ins_error import BA, BG, N_STATES, PHI, POS, VEL, correct, error_dynamics, noise_input
from ..kalman import innovation, update
from ..rotation import skew
from ..strapdown import C_NB, SUM_DT, SUM_FORCE, StrapdownState
from .result import AlignmentError
from .stationary import ImuNoise

Array = NDArray[np.float64]

_LOG = slice(N_STATES, N_STATES + 2)
_SIZE = N_STATES + 2
_SEEN = 0.05
KINDS = ("place", "velocity", "log")
"""Place north, east, down of the start [m]; velocity NED [m/s]; velocity in the body of a log [m/s]."""


@dataclasses.dataclass(frozen=True)
class Aids:
    """Measurements of one kind.

    Attributes
    ----------
    kind : one of KINDS
    index : (k,), samples after which each holds, ascending
    value : (k, 3)
    sigma : (3,), standard deviation of each component
    lever : (3,), of the antenna or the log in the body, m; not of a place
    log_prior : standard deviations of a log's yaw [rad] and scale factor; zero: it has none
    """

    kind: str
    index: NDArray[np.int64]
    value: Array
    sigma: Array
    lever: Array = dataclasses.field(default_factory=lambda: np.zeros(3))
    log_prior: tuple[float, float] = (0.0, 0.0)


@dataclasses.dataclass(frozen=True)
class Start:
    """State before the first sample: lat, lon [rad], h [m], v_n (3,) [m/s], C_nb (3, 3), and P (15, 15) of its errors, order of `ins_error.State`."""

    lat: float
    lon: float
    h: float
    v_n: Array
    C_nb: Array
    P: Array


@dataclasses.dataclass(frozen=True)
class Pass:
    """What one pass gave.

    Attributes
    ----------
    t : (k,), s, of each measurement
    C_nb : (k, 3, 3), after it
    sigma : (k, 3), of phi, rad
    C_end, P : (3, 3), (15, 15), at the last sample
    v_n, bias_g, bias_a : (3,), at the last sample
    log : (2,), yaw [rad] and scale factor of a log
    nis : (k,), normalized innovation squared of each, 3 degrees of freedom
    refused : how many measurements the gate kept out
    place : (3,), latitude, longitude [rad], height [m] at the last sample
    """

    t: Array
    C_nb: Array
    sigma: Array
    C_end: Array
    P: Array
    v_n: Array
    bias_g: Array
    bias_a: Array
    log: Array
    nis: Array
    refused: int
    place: Array


def prior(place: float, velocity: float, level: float, heading: float, imu: ImuNoise) -> Array:
    """P (15, 15) with these standard deviations: m, m/s, rad, rad, and the biases of `imu`."""
    sigma = np.empty(N_STATES)
    sigma[POS], sigma[VEL], sigma[PHI], sigma[BG], sigma[BA] = place, velocity, (level, level, heading), imu.bias_g, imu.bias_a
    return np.diag(sigma**2)


def run_stored(rate: Array, force: Array, dt: float, start: Start, imu: ImuNoise, aids: Aids, false_alarm: float = 1e-6) -> Pass:
    """One pass over stored data.

    Parameters
    ----------
    rate, force : (m, 3), means over dt [rad/s], [m/s^2]
    dt : s
    start : state before the first sample
    imu : noise of the process; biases are constant
    aids : the measurements
    false_alarm : a measurement whose NIS is beyond this quantile is refused and counted

    Notes
    -----
    Errors go into the state at every measurement (closed loop). A log's yaw and scale factor are states where `log_prior` says so.
    """
    if aids.kind not in KINDS:
        raise ValueError(f"measurements are one of {', '.join(KINDS)}, not {aids.kind!r}")
    ship = StrapdownState(start.lat, start.lon, start.h, start.v_n, start.C_nb)
    P, bias_g, bias_a, log = np.zeros((_SIZE, _SIZE)), np.zeros(3), np.zeros(3), np.zeros(2)
    P[:N_STATES, :N_STATES] = start.P
    P[_LOG, _LOG] = np.diag(np.square(aids.log_prior))
    density = np.diag([imu.arw**2] * 3 + [imu.vrw**2] * 3)
    gate, R = float(chi2.isf(false_alarm, 3)), np.diag(np.square(aids.sigma))
    r_m, r_n = (float(r) for r in radii(start.lat))
    steps = np.full(len(rate), dt)
    C_nb, sigma, nis = np.empty((len(aids.index), 3, 3)), np.empty((len(aids.index), 3)), np.empty(len(aids.index))
    refused, done = 0, 0
    for k, index in enumerate([*aids.index, len(rate)]):
        if index > done:
            P = _propagate(ship, P, rate[done:index], force[done:index], steps[done:index], bias_g, bias_a, density)
            done = int(index)
        if k == len(aids.index):
            break
        C, v = ship.c_nb, ship.v_n
        H = np.zeros((3, _SIZE))
        if aids.kind == "place":
            north, east = (ship.nav[0] - start.lat) * (r_m + start.h), (ship.nav[1] - start.lon) * (r_n + start.h) * np.cos(start.lat)
            z = aids.value[k] - [north, east, start.h - ship.nav[2]]
            H[:, POS] = -np.eye(3)
        elif aids.kind == "velocity":
            z = aids.value[k] - v - C @ np.cross(rate[max(done - 1, 0)] - bias_g, aids.lever)
            H[:, VEL] = -np.eye(3)
        else:
            z, H = _log(aids, k, C, v, rate[max(done - 1, 0)] - bias_g, log)
        nis[k] = innovation(np.zeros(_SIZE), P, z, H, R).nis
        if nis[k] <= gate:
            x, P, _ = update(np.zeros(_SIZE), P, z, H, R)
            correct(ship.nav, x)
            bias_g, bias_a, log = bias_g + x[BG], bias_a + x[BA], log - x[_LOG]
        else:
            refused += 1
        C_nb[k], sigma[k] = ship.c_nb, np.sqrt(np.diag(P)[PHI])
    return Pass(
        np.asarray(aids.index * dt, dtype=np.float64),
        C_nb,
        sigma,
        ship.c_nb.copy(),
        P[:N_STATES, :N_STATES],
        ship.v_n.copy(),
        bias_g,
        bias_a,
        log,
        nis,
        refused,
        ship.nav[:3].copy(),
    )


def _log(aids: Aids, k: int, C: Array, v: Array, turn: Array, log: Array) -> tuple[Array, Array]:
    """Innovation and H of a log: it reads (1 + scale) u + yaw (u_y, -u_x, 0), u = C_bn v + turn x lever."""
    u = C.T @ v + np.cross(turn, aids.lever)
    across = np.array([u[1], -u[0], 0.0])
    H = np.zeros((3, _SIZE))
    H[:, VEL], H[:, PHI] = -C.T, C.T @ skew(v)
    H[:, _LOG] = -np.column_stack([across, u])
    return aids.value[k] - u - log[0] * across - log[1] * u, H


def _propagate(ship: StrapdownState, P: Array, rate: Array, force: Array, steps: Array, bias_g: Array, bias_a: Array, density: Array) -> Array:
    before = ship.nav.copy()
    ship.sums[:] = 0.0
    ship.propagate(np.ascontiguousarray(rate), np.ascontiguousarray(force), steps, bias_g, bias_a)
    time = ship.sums[SUM_DT]
    C = ship.sums[3:12].reshape(3, 3) / time
    F = error_dynamics(0.5 * (before + ship.nav), ship.sums[SUM_FORCE] / time, C) * time
    Phi = np.eye(_SIZE)
    Phi[:N_STATES, :N_STATES] += F + 0.5 * F @ F
    G = noise_input(before[C_NB].reshape(3, 3))
    Q = np.zeros((_SIZE, _SIZE))
    Q[:N_STATES, :N_STATES] = G @ density @ G.T * time
    P = Phi @ P @ Phi.T + 0.5 * (Phi @ Q @ Phi.T + Q)
    return np.asarray(0.5 * (P + P.T))


def check_biases(found: Pass, imu: ImuNoise, false_alarm: float = 1e-6) -> None:
    """Refuse a pass that explains what it saw by biases this IMU does not have: its attitude would be as wrong.

    Parameters
    ----------
    found : pass that began with zero biases and the prior of `imu`
    imu : its bias sigmas
    false_alarm : probability that a good pass is refused

    Raises
    ------
    AlignmentError
        The six estimated biases are beyond the quantile of what they vary by.

    Notes
    -----
    An estimate that starts from zero varies by prior minus posterior covariance, not by the prior: it is drawn to zero where little is seen of it. In
    units of the prior, b' (I - P)^-1 b is chi-square; directions of which less than `_SEEN` is seen are left out. A wrong latitude shows here, as a
    rate of W sin(L) dL about north and as the change of gravity.
    """
    scale = np.repeat([imu.bias_g, imu.bias_a], 3)
    b = np.concatenate([found.bias_g, found.bias_a]) / scale
    part, axes = np.linalg.eigh(np.eye(6) - found.P[9:15, 9:15] / np.outer(scale, scale))
    seen = part > _SEEN
    if not seen.any():
        return
    statistic = float(np.sum((axes.T @ b)[seen] ** 2 / part[seen]))
    if statistic > chi2.isf(false_alarm, int(seen.sum())):
        worst = int(np.argmax(np.abs(b)))
        word = "a gyro" if worst < 3 else "an accelerometer"
        times = math.sqrt(statistic / float(seen.sum()))
        raise AlignmentError(
            f"the data ask for {word} bias of {abs(b[worst]):.1f} sigma, all biases {times:.1f} times as large as they should be: "
            "wrong latitude, another IMU, or the aid errs"
        )


def start_of_end(C_end: Array, turn_n: Array, turn_b: Array) -> Array:
    """Attitude of the first moment from that of the last: C_n0n C_nb C_b0b', each (3, 3)."""
    return turn_n @ C_end @ turn_b.T
