"""The course of a ship: legs, and the heading and speed they make, twice continuously differentiable.

Lives here: `LegSettings`, `segments` (legs as a table), the kernel `course_at` (heading, turn rate and speed at a time, with derivatives).
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

_STRAIGHT, _TURN, _SPEED = 0.0, 1.0, 2.0
_PEAK_OF_SMOOTHSTEP = 15.0 / 8.0
"""Largest slope of 10 x^3 - 15 x^4 + 6 x^5."""


@dataclass(frozen=True)
class LegSettings:
    """One leg: straight, a turn, or a change of speed; give the keys of exactly one of them."""

    straight_s: float | None = setting(None, "straight leg of constant speed", "s", low=0.0)
    turn_deg: float | None = setting(None, "change of heading, positive to starboard", "deg", low=-3600.0, high=3600.0)
    rate_deg_s: float | None = setting(None, "turn: rate in the middle of the turn, positive", "deg/s", low=0.001, high=10.0)
    blend_s: float = setting(10.0, "turn: time in which the rate builds up and dies down (less in a turn too small for it)", "s", low=1.0, high=300.0)
    speed_kn: float | None = setting(None, "change of speed: the new speed", "kn", low=-20.0, high=60.0)
    acceleration_mps2: float | None = setting(None, "change of speed: largest acceleration, positive", "m/s^2", low=1e-4, high=5.0)

    def __post_init__(self) -> None:
        kinds = [name for name in ("straight_s", "turn_deg", "speed_kn") if getattr(self, name) is not None]
        if len(kinds) != 1:
            given = " and ".join(kinds) if kinds else "none"
            raise SettingError(f"a leg has exactly one of straight_s, turn_deg, speed_kn, not {given}")
        for companion, of in (("rate_deg_s", "turn_deg"), ("acceleration_mps2", "speed_kn")):
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
    (n + 1, 7): start time [s], heading [rad] and speed [m/s] there, kind, and for a turn: rate [rad/s], blend [s], hold [s];
    for a change of speed: difference [m/s], duration [s]. The last row is the straight course after the last leg.
    """
    rows: list[tuple[float, ...]] = []
    t = 0.0
    for leg in legs:
        if leg.straight_s is not None:
            rows.append((t, heading, speed, _STRAIGHT, 0.0, 0.0, 0.0))
            t += leg.straight_s
        elif leg.turn_deg is not None and leg.rate_deg_s is not None:
            angle = math.radians(leg.turn_deg)
            rate = math.copysign(math.radians(leg.rate_deg_s), angle)
            blend = min(leg.blend_s, angle / rate)
            hold = angle / rate - blend
            if blend > 0.0:
                rows.append((t, heading, speed, _TURN, rate, blend, hold))
            t += 2.0 * blend + hold
            heading += angle
        elif leg.speed_kn is not None and leg.acceleration_mps2 is not None:
            change = leg.speed_kn * KNOT - speed
            duration = _PEAK_OF_SMOOTHSTEP * abs(change) / leg.acceleration_mps2
            if duration > 0.0:
                rows.append((t, heading, speed, _SPEED, change, duration, 0.0))
            t += duration
            speed += change
    rows.append((t, heading, speed, _STRAIGHT, 0.0, 0.0, 0.0))
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
def course_at(t: float, table: NDArray[np.float64]) -> tuple[float, float, float, float, float, float]:
    """Heading and speed at a time.

    Parameters
    ----------
    t : s, >= 0
    table : as `segments` makes it

    Returns
    -------
    heading [rad, not wrapped], turn rate [rad/s], its first [rad/s^2] and second derivative [rad/s^3], speed [m/s], acceleration [m/s^2]
    """
    low, high = 0, table.shape[0]
    while high - low > 1:
        middle = (low + high) // 2
        if table[middle, 0] <= t:
            low = middle
        else:
            high = middle
    x = t - table[low, 0]
    heading, speed, kind = table[low, 1], table[low, 2], table[low, 3]
    rate, rate1, rate2, acceleration = 0.0, 0.0, 0.0, 0.0
    if kind == _TURN:
        peak, blend, hold = table[low, 4], table[low, 5], table[low, 6]
        if x < blend:
            i, s, s1, s2 = _smoothstep(x / blend)
            heading += peak * blend * i
            rate, rate1, rate2 = peak * s, peak * s1 / blend, peak * s2 / (blend * blend)
        elif x <= blend + hold:
            heading += peak * (x - 0.5 * blend)
            rate = peak
        else:  # the mirror image of the beginning
            i, s, s1, s2 = _smoothstep(max(0.0, (2.0 * blend + hold - x) / blend))
            heading += peak * (blend + hold - blend * i)
            rate, rate1, rate2 = peak * s, -peak * s1 / blend, peak * s2 / (blend * blend)
    elif kind == _SPEED:
        change, duration = table[low, 4], table[low, 5]
        _, s, s1, _ = _smoothstep(min(1.0, x / duration))
        speed += change * s
        acceleration = change * s1 / duration
    return heading, rate, rate1, rate2, speed, acceleration
