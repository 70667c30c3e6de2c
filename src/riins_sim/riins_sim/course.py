"""The course of a ship, a car or an aircraft: legs, and the heading, speed and height they make, twice continuously differentiable.

Lives here: `LegSettings`, `segments` (legs as a table), the kernels `course_at` (heading, turn rate, horizontal speed) and `climb_at` (height).
Does not live here: integration of the course to a position (trajectory.py), motion in waves (vessel.py).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from riins_core.jit import jit
from riins_core.sensor_errors import KNOT
from riins_core.settings import SettingError, setting

_STRAIGHT, _TURN, _SPEED, _CLIMB = 0.0, 1.0, 2.0, 3.0
FASTEST_KN = 1000.0
_PEAK_OF_SMOOTHSTEP = 15.0 / 8.0
"""Largest slope of 10 x^3 - 15 x^4 + 6 x^5."""


@dataclass(frozen=True)
class LegSettings:
    """One leg: straight, a turn, a change of speed, or a climb; give the keys of exactly one of them."""

    straight_s: float | None = setting(None, "straight leg of constant speed", "s", low=0.0)
    turn_deg: float | None = setting(None, "change of heading, positive to starboard", "deg", low=-3600.0, high=3600.0)
    rate_deg_s: float | None = setting(None, "turn: rate in the middle of the turn, positive", "deg/s", low=0.001, high=10.0)
    blend_s: float = setting(
        10.0, "turn, climb: time in which its rate builds up and dies down (less where it is too small for it)", "s", low=1.0, high=300.0
    )
    speed_kn: float | None = setting(None, "change of speed: the new speed along the path", "kn", low=-FASTEST_KN, high=FASTEST_KN)
    acceleration_mps2: float | None = setting(None, "change of speed: largest acceleration, positive", "m/s^2", low=1e-4, high=5.0)
    climb_m: float | None = setting(None, "change of height at the speed that is on, down negative", "m", low=-2e4, high=2e4)
    climb_deg: float | None = setting(None, "climb: steepest angle of the path, positive; the body pitches with it", "deg", low=0.01, high=60.0)

    def __post_init__(self) -> None:
        kinds = [name for name in ("straight_s", "turn_deg", "speed_kn", "climb_m") if getattr(self, name) is not None]
        if len(kinds) != 1:
            given = " and ".join(kinds) if kinds else "none"
            raise SettingError(f"a leg has exactly one of straight_s, turn_deg, speed_kn, climb_m, not {given}")
        for companion, of in (("rate_deg_s", "turn_deg"), ("acceleration_mps2", "speed_kn"), ("climb_deg", "climb_m")):
            if kinds[0] == of and getattr(self, companion) is None:
                raise SettingError(f"a leg with {of} needs {companion}", (of,))
            if kinds[0] != of and getattr(self, companion) is not None:
                raise SettingError(f"{companion} belongs to a leg with {of}", (companion,))


def segments(legs: Sequence[LegSettings], heading: float, speed: float) -> NDArray[np.float64]:
    """Legs as the table that `course_at` reads.

    Parameters
    ----------
    legs : in order
    heading, speed : at the start, rad and m/s

    Returns
    -------
    (n + 1, 8): start time [s], heading [rad] and speed along the path [m/s] there, kind, and for a turn: rate [rad/s], blend [s], hold [s]; for a
    climb: the same with the vertical speed [m/s]; for a change of speed: difference [m/s], duration [s]; at last the height gained before [m].
    The last row is the straight course after the last leg.

    Raises
    ------
    SettingError
        A climb at no speed.
    """
    rows: list[tuple[float, ...]] = []
    t = height = 0.0
    for leg in legs:
        if leg.straight_s is not None:
            rows.append((t, heading, speed, _STRAIGHT, 0.0, 0.0, 0.0, height))
            t += leg.straight_s
        elif leg.turn_deg is not None and leg.rate_deg_s is not None:
            angle = math.radians(leg.turn_deg)
            rate = math.copysign(math.radians(leg.rate_deg_s), angle)
            blend = min(leg.blend_s, angle / rate)
            hold = angle / rate - blend
            if blend > 0.0:
                rows.append((t, heading, speed, _TURN, rate, blend, hold, height))
            t += 2.0 * blend + hold
            heading += angle
        elif leg.climb_m is not None and leg.climb_deg is not None:
            rate = math.copysign(abs(speed) * math.sin(math.radians(leg.climb_deg)), leg.climb_m)
            if rate == 0.0:
                raise SettingError("nothing climbs that stands still", ("climb_m",))
            blend = min(leg.blend_s, leg.climb_m / rate)
            hold = leg.climb_m / rate - blend
            if blend > 0.0:
                rows.append((t, heading, speed, _CLIMB, rate, blend, hold, height))
            t += 2.0 * blend + hold
            height += leg.climb_m
        elif leg.speed_kn is not None and leg.acceleration_mps2 is not None:
            change = leg.speed_kn * KNOT - speed
            duration = _PEAK_OF_SMOOTHSTEP * abs(change) / leg.acceleration_mps2
            if duration > 0.0:
                rows.append((t, heading, speed, _SPEED, change, duration, 0.0, height))
            t += duration
            speed += change
    rows.append((t, heading, speed, _STRAIGHT, 0.0, 0.0, 0.0, height))
    return np.array(rows)


@jit
def _smoothstep(x: float) -> tuple[float, float, float, float]:
    """10 x^3 - 15 x^4 + 6 x^5: its integral from 0, itself, its first and second derivative."""
    x2 = x * x
    integral = x2 * x2 * (2.5 + x * (-3.0 + x))
    value = x2 * x * (10.0 + x * (-15.0 + 6.0 * x))
    first = 30.0 * x2 * (1.0 - x) * (1.0 - x)
    second = 60.0 * x * (1.0 - x) * (1.0 - 2.0 * x)
    return integral, value, first, second


@jit
def _row_at(t: float, table: NDArray[np.float64]) -> int:
    """Row of the leg that is under way."""
    low, high = 0, table.shape[0]
    while high - low > 1:
        middle = (low + high) // 2
        if table[middle, 0] <= t:
            low = middle
        else:
            high = middle
    return low


@jit
def _rounded(x: float, peak: float, blend: float, hold: float) -> tuple[float, float, float, float]:
    """A rate that builds up to `peak` within `blend`, stays for `hold` and dies down: its integral from 0, itself, two derivatives, at x >= 0."""
    if x < blend:
        i, s, s1, s2 = _smoothstep(x / blend)
        return peak * blend * i, peak * s, peak * s1 / blend, peak * s2 / (blend * blend)
    if x <= blend + hold:
        return peak * (x - 0.5 * blend), peak, 0.0, 0.0
    i, s, s1, s2 = _smoothstep(max(0.0, (2.0 * blend + hold - x) / blend))  # the mirror image of the beginning
    return peak * (blend + hold - blend * i), peak * s, -peak * s1 / blend, peak * s2 / (blend * blend)


@jit
def course_at(t: float, table: NDArray[np.float64]) -> tuple[float, float, float, float, float, float]:
    """Heading and horizontal speed at a time.

    Parameters
    ----------
    t : s, >= 0
    table : as `segments` makes it

    Returns
    -------
    heading [rad, not wrapped], turn rate [rad/s], its first [rad/s^2] and second derivative [rad/s^3], horizontal speed [m/s], acceleration [m/s^2]
    """
    low = _row_at(t, table)
    x = t - table[low, 0]
    heading, speed, kind = table[low, 1], table[low, 2], table[low, 3]
    rate, rate1, rate2, acceleration = 0.0, 0.0, 0.0, 0.0
    if kind == _TURN:
        turned, rate, rate1, rate2 = _rounded(x, table[low, 4], table[low, 5], table[low, 6])
        heading += turned
    elif kind == _SPEED:
        change, duration = table[low, 4], table[low, 5]
        _, s, s1, _ = _smoothstep(min(1.0, x / duration))
        speed += change * s
        acceleration = change * s1 / duration
    elif kind == _CLIMB:  # the speed along the path stays
        _, up, up1, _ = _rounded(x, table[low, 4], table[low, 5], table[low, 6])
        speed = math.copysign(math.sqrt(speed * speed - up * up), speed)
        acceleration = -up * up1 / speed
    return heading, rate, rate1, rate2, speed, acceleration


@jit
def climb_at(t: float, table: NDArray[np.float64]) -> tuple[float, float, float, float]:
    """Height gained since the start [m], vertical speed, up [m/s], and its first [m/s^2] and second derivative [m/s^3]; arguments as `course_at`."""
    low = _row_at(t, table)
    if table[low, 3] != _CLIMB:
        return table[low, 7], 0.0, 0.0, 0.0
    gained, up, up1, up2 = _rounded(t - table[low, 0], table[low, 4], table[low, 5], table[low, 6])
    return table[low, 7] + gained, up, up1, up2
