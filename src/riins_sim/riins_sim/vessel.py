"""How the hull answers: roll, pitch, yaw, heave, surge and sway in waves, and heel in a turn.

Lives here: `VesselSettings`, `response_table` (its answer to each wave component), the kernel `motion` (six motions with two derivatives).
Does not live here: the waves (waves.py), the course (course.py), position and attitude (trajectory.py).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from riins_core.jit import jit
from riins_core.settings import setting

from .waves import WaveField

Array = NDArray[np.float64]


@dataclass(frozen=True)
class VesselSettings:
    """Response of the hull: amplitude per metre of wave amplitude, for long waves in the worst direction. The defaults are a ship of 100 m."""

    length_m: float = setting(100.0, "length of the hull; waves much shorter do not move it", "m", low=1.0, high=500.0)
    roll_deg_per_m: float = setting(2.0, "roll in a beam sea, away from resonance", "deg/m", low=0.0, high=30.0)
    roll_period_s: float = setting(12.0, "natural period of roll", "s", low=2.0, high=40.0)
    roll_damping: float = setting(0.2, "damping ratio of roll", "", low=0.02, high=1.0)
    pitch_deg_per_m: float = setting(1.0, "pitch in a head or following sea", "deg/m", low=0.0, high=30.0)
    yaw_deg_per_m: float = setting(0.3, "yaw in a quartering sea", "deg/m", low=0.0, high=10.0)
    heave_m_per_m: float = setting(0.8, "heave", "m/m", low=0.0, high=2.0)
    surge_m_per_m: float = setting(0.5, "surge in a head or following sea", "m/m", low=0.0, high=2.0)
    sway_m_per_m: float = setting(0.6, "sway in a beam sea", "m/m", low=0.0, high=2.0)
    heel_rad_per_g: float = setting(3.0, "outward heel in a steady turn per g of centripetal acceleration", "rad/g", low=-10.0, high=10.0)


def response_table(field: WaveField, vessel: VesselSettings) -> Array:
    """Wave components with the answer of the hull to each.

    Parameters
    ----------
    field : the sea
    vessel : response of the hull

    Returns
    -------
    (n, 13): omega [rad/s], k cos and k sin of the direction [rad/m], cos and sin of the direction, phase [rad], then amplitudes of heave,
    surge, sway [m], pitch, yaw [rad], and roll [rad] times the cosine and times the sine of its phase lag

    Notes
    -----
    Strip-theory habits in their simplest form: heave follows the elevation, pitch and roll its slope, surge and sway the orbit of the water;
    hull averaging 1 / (1 + (length / wave length)^4); roll is a second-order system at the wave frequency.
    """
    average = 1.0 / (1.0 + (vessel.length_m * field.wave_number / (2.0 * math.pi)) ** 4)
    a = field.amplitude * average
    ratio = field.omega * vessel.roll_period_s / (2.0 * math.pi)
    roll = a * math.radians(vessel.roll_deg_per_m) / (1.0 - ratio**2 + 2.0j * vessel.roll_damping * ratio)
    cos, sin = np.cos(field.direction), np.sin(field.direction)
    columns = [
        field.omega,
        field.wave_number * cos,
        field.wave_number * sin,
        cos,
        sin,
        field.phase,
        a * vessel.heave_m_per_m,
        a * vessel.surge_m_per_m,
        a * vessel.sway_m_per_m,
        a * math.radians(vessel.pitch_deg_per_m),
        2.0 * a * math.radians(vessel.yaw_deg_per_m),
        roll.real,
        -roll.imag,
    ]
    return np.ascontiguousarray(np.stack(columns, axis=-1))


@jit
def motion(t: float, place: Array, course: Array, table: Array, out: Array) -> None:
    """Motion in waves at a time, with its derivatives along the ship's path.

    Parameters
    ----------
    t : s
    place : (6,), north, east of the start [m], and first and second derivatives, of the ship without waves
    course : (3,), heading [rad], turn rate [rad/s] and its derivative [rad/s^2], without waves
    table : (n, 13), from `response_table`
    out : (6, 3), written: roll, pitch, yaw [rad], heave (up), surge, sway [m] along and across the heading without waves; value, two derivatives

    Notes
    -----
    Waves are met where the ship is, so the encounter frequency comes of itself, also in a turn. With eta = a cos(p) rising ahead when its slope
    k a sin(p) cos(mu) is positive, mu from heading to direction of travel: pitch +sin(p) cos(mu) (bow up), roll -sin(p) sin(mu) (starboard down),
    surge and sway +sin(p) (cos mu, sin mu).
    """
    for i in range(6):
        for j in range(3):
            out[i, j] = 0.0
    ch, sh = math.cos(course[0]), math.sin(course[0])
    r, r1 = course[1], course[2]
    for i in range(table.shape[0]):
        kn, ke = table[i, 1], table[i, 2]
        p = table[i, 0] * t - kn * place[0] - ke * place[1] + table[i, 5]
        p1 = table[i, 0] - kn * place[2] - ke * place[3]
        p2 = -kn * place[4] - ke * place[5]
        c, s = math.cos(p), math.sin(p)
        c1, s1 = -s * p1, c * p1
        c2, s2 = -s * p2 - c * p1 * p1, c * p2 - s * p1 * p1
        # cosine and sine of mu change as the ship turns
        x = table[i, 3] * ch + table[i, 4] * sh
        y = table[i, 4] * ch - table[i, 3] * sh
        x1, y1 = y * r, -x * r
        x2, y2 = y * r1 - x * r * r, -x * r1 - y * r * r
        lag_c, lag_s = table[i, 11], table[i, 12]  # sin(p - lag)
        q, q1, q2 = lag_c * s - lag_s * c, lag_c * s1 - lag_s * c1, lag_c * s2 - lag_s * c2
        out[0, 0] -= q * y
        out[0, 1] -= q1 * y + q * y1
        out[0, 2] -= q2 * y + 2.0 * q1 * y1 + q * y2
        sx, sx1, sx2 = s * x, s1 * x + s * x1, s2 * x + 2.0 * s1 * x1 + s * x2
        pitch, surge = table[i, 9], table[i, 7]
        out[1, 0] += pitch * sx
        out[1, 1] += pitch * sx1
        out[1, 2] += pitch * sx2
        out[4, 0] += surge * sx
        out[4, 1] += surge * sx1
        out[4, 2] += surge * sx2
        z, z1, z2 = x * y, x1 * y + x * y1, x2 * y + 2.0 * x1 * y1 + x * y2
        yaw = table[i, 10]
        out[2, 0] += yaw * c * z
        out[2, 1] += yaw * (c1 * z + c * z1)
        out[2, 2] += yaw * (c2 * z + 2.0 * c1 * z1 + c * z2)
        heave = table[i, 6]
        out[3, 0] += heave * c
        out[3, 1] += heave * c1
        out[3, 2] += heave * c2
        sway = table[i, 8]
        out[5, 0] += sway * s * y
        out[5, 1] += sway * (s1 * y + s * y1)
        out[5, 2] += sway * (s2 * y + 2.0 * s1 * y1 + s * y2)
