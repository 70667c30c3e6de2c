"""The flight of thesis 5.5.1 and the sensors of tables 5.1 and 5.2, on which chapters 5 and 6 make their experiments.

Lives here: `flight` (truth and exact mean rates and forces at 20 Hz), `Table` with the printed drifts, noise, Q and P, `readings` of a seed.
Does not live here: methods and schemes, the experiments themselves (thesis_fusion.py).
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from riins_core import earth
from riins_core.imu_array import CONFIGURATIONS, ImuArray
from riins_core.jit import jit
from riins_core.noise import normal
from riins_core.rotation import dcm_from_euler
from riins_core.sensor_errors import DEG_PER_H, MICRO_G
from riins_core.strapdown import NAV_SIZE, SUMS_SIZE, StrapdownState, strapdown_block

Array = NDArray[np.float64]

RATE_HZ = 20.0
DT = 1.0 / RATE_HZ
DEG = math.pi / 180.0

SPEED = 100.0
"""m/s after the first 20 s; the thesis does not say."""
TURN_RATE = 1.5 * DEG
"""of both turns, rad/s; the thesis does not say, but with 272 s of flight least squares ends 147 m off, as there (155 m); with 3 deg/s 85 m."""
_BLEND = 4.0
"""Length of a change of bank, and of the beginning and end of the acceleration, s."""
_PITCH_BLEND = 8.0
"""Length of a change of pitch, s: 0.4 g at most."""
_FINE = 20
"""Steps of the quadrature in a sample."""
_START = (45.75 * DEG, 126.65 * DEG, 150.0)

# what happens after the acceleration of 20 s: (kind, angle [deg], length [s])
_LEGS = (
    ("pitch", 10.0, 30.0), ("pitch", 0.0, 15.0), ("turn", 60.0, 0.0), ("pitch", 0.0, 24.0), ("turn", -90.0, 0.0), ("pitch", 0.0, 30.0),
    ("pitch", -5.0, 30.0), ("pitch", 0.0, 15.0),
)  # fmt: skip


@dataclass(frozen=True)
class Flight:
    """The flight, sampled at the end of each interval of `DT`.

    Attributes
    ----------
    t : (m,), s
    start : navigation state (16,) at t = 0
    nav : (m, 16), navigation state at `t` that the mechanization reaches with the exact rates and forces
    true : (m, 15), latitude, longitude, height, velocity NED, C_nb row-major at `t`, of the flight itself
    rate, force : (m, 3), means over each interval, body FRD
    """

    t: Array
    start: Array
    nav: Array
    true: Array
    rate: Array
    force: Array


def _step(x: Array) -> tuple[Array, Array, Array]:
    """Smooth step 0 -> 1 over 0 <= x <= 1, its first derivative and its integral."""
    s = np.clip(x, 0.0, 1.0)
    return s**3 * (10.0 - 15.0 * s + 6.0 * s * s), 30.0 * s**2 * (1.0 - s) ** 2, s**4 * (2.5 - 3.0 * s + s * s) + np.maximum(x - 1.0, 0.0)


def _profile(t: Array) -> tuple[Array, Array, Array, Array, Array, Array, Array, Array]:
    """Speed, pitch, heading, roll at fine times and their derivatives, all smooth."""
    speed, speed_dot = np.zeros_like(t), np.zeros_like(t)
    a = SPEED / (20.0 - _BLEND)  # the level acceleration, blended in and out
    for sign, at in ((1.0, 0.0), (-1.0, 20.0 - _BLEND)):
        value, _, integral = _step((t - at) / _BLEND)
        speed_dot += sign * a * value
        speed += sign * a * _BLEND * integral
    pitch, pitch_dot, heading, heading_dot, roll, roll_dot = (np.zeros_like(t) for _ in range(6))
    now, angle = 20.0, 0.0
    for kind, degrees, length in _LEGS:
        if kind == "pitch":
            value, slope, _ = _step((t - now) / _PITCH_BLEND)
            pitch += (degrees * DEG - angle) * value
            pitch_dot += (degrees * DEG - angle) * slope / _PITCH_BLEND
            angle = degrees * DEG
            now += length
        else:
            sign, last = math.copysign(1.0, degrees), abs(degrees) * DEG / TURN_RATE
            bank = math.atan(SPEED * TURN_RATE / 9.81)
            for direction, at in ((1.0, now), (-1.0, now + last)):
                value, slope, integral = _step((t - at) / _BLEND)
                heading += sign * direction * TURN_RATE * _BLEND * integral
                heading_dot += sign * direction * TURN_RATE * value
                roll += sign * direction * bank * value
                roll_dot += sign * direction * bank * slope / _BLEND
            now += last + _BLEND
    return speed, speed_dot, pitch, pitch_dot, heading, heading_dot, roll, roll_dot


def duration() -> float:
    """Length of the flight, s."""
    turns = [abs(degrees) * DEG / TURN_RATE + _BLEND for kind, degrees, _ in _LEGS if kind == "turn"]
    return 20.0 + sum(length for _, _, length in _LEGS) + sum(turns)


@functools.cache
def flight() -> Flight:
    """The flight: rest, 20 s of level acceleration, 30 s of climb at 10 deg of pitch, 15 s level, right turn of 60 deg, 24 s, left turn of 90 deg,
    30 s, 30 s of dive at -5 deg, 15 s; velocity along the body's x axis, coordinated turns. Position is Simpson's rule on steps of 2.5 ms.
    """
    samples = round(duration() / DT)
    fine = DT / _FINE
    t: Array = fine * np.arange(samples * _FINE + 1, dtype=np.float64)
    speed, speed_dot, pitch, pitch_dot, heading, heading_dot, roll, roll_dot = _profile(t)
    cp, sp, ch, sh = np.cos(pitch), np.sin(pitch), np.cos(heading), np.sin(heading)
    v = np.column_stack([speed * cp * ch, speed * cp * sh, -speed * sp])
    v_dot = np.column_stack(
        [
            speed_dot * cp * ch - speed * (sp * ch * pitch_dot + cp * sh * heading_dot),
            speed_dot * cp * sh - speed * (sp * sh * pitch_dot - cp * ch * heading_dot),
            -speed_dot * sp - speed * cp * pitch_dot,
        ]
    )
    h = _START[2] - _cumulative(v[:, 2], fine)
    lat = np.full_like(t, _START[0])
    for _ in range(4):  # the radii depend on the latitude: a fixed point, contracting by 1e-3 a time
        lat = _START[0] + _cumulative(v[:, 0] / (earth.radii(lat)[0] + h), fine)
    lon = _START[1] + _cumulative(v[:, 1] / ((earth.radii(lat)[1] + h) * np.cos(lat)), fine)
    c = dcm_from_euler(roll, pitch, heading)
    cr, sr = np.cos(roll), np.sin(roll)
    w_nb = np.column_stack([roll_dot - heading_dot * sp, pitch_dot * cr + heading_dot * sr * cp, -pitch_dot * sr + heading_dot * cr * cp])
    w_ie, w_en = earth.earth_rate_n(lat), earth.transport_rate_n(lat, h, v)
    rate = w_nb + np.einsum("kji,kj->ki", c, w_ie + w_en)
    f_n = v_dot + np.cross(2.0 * w_ie + w_en, v)
    f_n[:, 2] -= earth.gravity(lat, h)
    force = np.einsum("kji,kj->ki", c, f_n)
    ends = slice(_FINE, None, _FINE)
    true = np.column_stack([lat, lon, h, v, c.reshape(-1, 9)])
    rate, force = _means(rate), _means(force)
    begin = StrapdownState(*_START, v[0], c[0])
    start = begin.nav.copy()
    nav = navigate(start, rate, force)
    return Flight(t[ends], start, nav, true[ends], rate, force)


def navigate(start: Array, rate: Array, force: Array) -> Array:
    """Navigation states (m, 16) of the mechanization fed with means over `DT`, from the state `start`."""
    path = np.empty((len(rate), NAV_SIZE))
    _navigate(start.copy(), np.ascontiguousarray(rate), np.ascontiguousarray(force), path)
    return path


@jit
def _navigate(nav: Array, rate: Array, force: Array, path: Array) -> None:
    dtheta, dv, none, sums, dt = np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(SUMS_SIZE), np.full(1, DT)
    for k in range(rate.shape[0]):
        strapdown_block(nav, dtheta, dv, rate[k : k + 1], force[k : k + 1], dt, none, none, sums)
        path[k] = nav


def _cumulative(y: Array, step: float) -> Array:
    """Integral of y at every second point by Simpson's rule, in between by the matching parabola."""
    out = np.zeros_like(y)
    a, b, c = y[:-2:2], y[1:-1:2], y[2::2]
    out[2::2] = np.cumsum(step / 3.0 * (a + 4.0 * b + c))
    out[1::2] = out[:-2:2] + step / 12.0 * (5.0 * a + 8.0 * b - c)
    return out


def _means(y: Array) -> Array:
    """Means over each sample, by Simpson's rule."""
    weight = np.ones(_FINE + 1)
    weight[1:-1:2], weight[2:-1:2] = 4.0, 2.0
    index = _FINE * np.arange((len(y) - 1) // _FINE)[:, None] + np.arange(_FINE + 1)
    return np.einsum("kja,j->ka", y[index], weight / (3.0 * _FINE))


ARRAY = ImuArray(CONFIGURATIONS["dodecahedron"])
"""Six and six sensors on the normals of a dodecahedron, in the order of (2-33)."""
KINDS = ("gyro", "accel")
R_PRINTED = (8.4e-12, 2.4e-7)
"""(5-108): (rad/s)^2, (m/s^2)^2 of a sample of 50 ms. The tables' "0.01 deg/h" is an angle random walk of 0.0022 deg/sqrt h."""


@dataclass(frozen=True)
class Experiment:
    """Sensors of a table, and what a filter is told of them; (2, 6) arrays: gyros [rad/s], accelerometers [m/s^2].

    Attributes
    ----------
    drift : what the sensors have
    sigma : their white noise
    P, Q : diagonals the filter is given, Q for a step of 50 ms
    """

    drift: Array
    sigma: Array
    P: Array
    Q: Array


def _six(first: float, second: float, bad: dict[int, float]) -> Array:
    return np.array([[bad.get(10 + i, first) for i in range(6)], [bad.get(20 + i, second) for i in range(6)]])


_BAD = (10, 12, 20, 24)  # gyros 1 and 3, accelerometers 1 and 5
_QUIET = {10: 0.8, 12: 0.8, 20: 0.9, 24: 0.9}  # 0.008 of 0.01 deg/h, 45 of 50 ug
_SIGMA = np.sqrt(R_PRINTED)[:, None]
_NO_DRIFT = _six(0.001 * DEG_PER_H, 100.0 * MICRO_G, {})
_DRIFT = _six(0.001 * DEG_PER_H, 100.0 * MICRO_G, {10: 2.0 * DEG_PER_H, 12: -2.0 * DEG_PER_H, 20: 300.0 * MICRO_G, 24: -300.0 * MICRO_G})
_Q_TOLD = _six(2.3e-11, 1e-6, {10: 2.3e-10, 12: 2.3e-10, 20: 1e-5, 24: 1e-5})
_P_TOLD = _six(2.4e-17, 9.6e-7, {10: 9.4e-11, 12: 9.4e-11, 20: 8.6e-6, 24: 8.6e-6})
_Q_EQUAL = _six(2.3e-11, 1e-6, {})
_P_EQUAL = _six(2.4e-17, 9.6e-7, {10: 9.4e-17, 12: 9.4e-17, 20: 8.6e-7, 24: 8.6e-7})
_NOISY = _SIGMA * _six(1.0, 1.0, _QUIET)

TOLD = Experiment(_DRIFT, _NOISY, _P_TOLD, _Q_TOLD)
"""Experiments 1 and 4 of chapter 5, 2 of chapter 6: table 5.2, Q and P name the bad sensors, (5-108)-(5-110)."""
UNTOLD = Experiment(_DRIFT, _NOISY, _P_EQUAL, _Q_EQUAL)
"""Experiments 2 and 3 of chapter 5, 3 and 4 of chapter 6: table 5.2, equal Q and as good as equal P, (5-112)-(5-114)."""
HEALTHY = Experiment(_NO_DRIFT, np.broadcast_to(_SIGMA, (2, 6)), _P_EQUAL, _Q_EQUAL)
"""Experiment 5 of chapter 5, 1 of chapter 6: table 5.1, (5-119)-(5-122)."""


def readings(experiment: Experiment, seed: int, drift: Array | None = None) -> tuple[Array, Array]:
    """Readings (m, 6) of the gyros and of the accelerometers along the flight.

    Parameters
    ----------
    experiment : drifts and noise
    seed : of the noise, which is the same for every experiment
    drift : (2, 6) or (2, m, 6), instead of that of the experiment
    """
    path = flight()
    d = experiment.drift if drift is None else drift
    made = []
    for kind, true in enumerate((path.rate, path.force)):
        noise = experiment.sigma[kind] * normal(seed, f"thesis/{KINDS[kind]}", 0, len(true), ARRAY.n)
        made.append(true @ ARRAY.H.T + d[kind] + noise)
    return made[0], made[1]


def position_error(nav: Array, true: Array | None = None) -> Array:
    """Position errors NED (m, 3) [m] of navigation states (m, 16) against the error-free mechanization of the flight."""
    ref = flight().nav if true is None else true
    r_m, r_n = earth.radii(ref[:, 0])
    north = (nav[:, 0] - ref[:, 0]) * (r_m + ref[:, 2])
    east = (nav[:, 1] - ref[:, 1]) * (r_n + ref[:, 2]) * np.cos(ref[:, 0])
    return np.column_stack([north, east, ref[:, 2] - nav[:, 2]])
