"""Horizontal damping of the inertial solution by a log: the Schuler oscillation of what is integrated dies away, the estimate stays what it is.

Lives here: `HorizontalDamping` and its settings: the network, how far a log and the inertial solution are apart, and the turn of the level.
Does not live here: when it is applied (integrated_filter.py), the log itself (aids/), the platform form of seed 003 (riins_core.platform_error).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from riins_core.earth import STANDARD_GRAVITY, A, B, radii_s
from riins_core.ins_error import VEL
from riins_core.settings import SettingError, nearest, setting

from .aiding import AidSettings, Measurement
from .types import Array

SCHULER = math.sqrt(STANDARD_GRAVITY / ((2.0 * A + B) / 3.0))
"""Schuler frequency, rad/s: 84.4 minutes."""
LOGS = ("body_velocity", "water_velocity")
"""Types of aid that can damp."""
COARSEST = 0.3
"""Largest product of the frequency of the damped oscillation and the interval between measurements: beyond it they are too few to damp it."""
N, E = VEL.start, VEL.start + 1


@dataclass(frozen=True)
class DampingSettings:
    """Horizontal damping of the uncorrected inertial solution, between two feedbacks."""

    aid: str = setting(
        "", "name of the aid, a body_velocity or water_velocity, by which the uncorrected inertial solution is damped; empty: it is not damped"
    )
    ratio: float = setting(0.5, "damping ratio of the damped oscillation", "", 0.05, 2.0)
    frequency: float = setting(1.5, "its natural frequency, in Schuler frequencies", "", 1.05, 5.0)


@dataclass(frozen=True)
class Network:
    """H(s) = k1 + k3 / (s + k2), H(0) = 1; k2 and k3 in 1/s."""

    k1: float
    k2: float
    k3: float

    @classmethod
    def of(cls, ratio: float, frequency: float, schuler: float = SCHULER) -> Network:
        """The network that gives an oscillation of this damping ratio and natural frequency.

        Parameters
        ----------
        ratio : zeta
        frequency : in Schuler frequencies, > 1
        schuler : rad/s

        Notes
        -----
        s^2 + ws^2 H(s) = 0, that is s^3 + k2 s^2 + k1 ws^2 s + k2 ws^2 = (s^2 + 2 zeta wd s + wd^2) (s + a), since H(0) = 1 makes k1 k2 + k3 = k2.
        Three equations in k1, k2 and a: none of the three is free. a = k2 / frequency^2, k2 = 2 zeta wd / (1 - 1 / frequency^2),
        k1 = frequency^2 + 2 zeta frequency a / ws, k3 = k2 (1 - k1). Of 0.5 and 1.5: 4.05, 3.350e-3, -1.0217e-2 1/s (003, errata).
        """
        f2 = frequency * frequency
        k2 = 2.0 * ratio * frequency * schuler / (1.0 - 1.0 / f2)
        k1 = f2 + 2.0 * ratio * frequency * k2 / (f2 * schuler)
        return cls(k1, k2, k2 * (1.0 - k1))

    def step(self, state: Array, apart: Array, elapsed: float, held: float) -> Array:
        """Integral of (H(s) - 1) apart over the last part of an interval, and the state at its end.

        Parameters
        ----------
        state : (m,), of the network, unit of `apart`; in place
        apart : (m,), constant over that part
        elapsed : s since the last step
        held : s, the part; before it the state decays and nothing is put out
        """
        state *= math.exp(-self.k2 * (elapsed - held))
        kept = math.exp(-self.k2 * held)
        through = (1.0 - kept) / self.k2
        out = ((self.k1 - 1.0) * held) * apart + through * state + (self.k3 * (held - through) / self.k2) * apart
        state *= kept
        state += (self.k3 * through) * apart
        return np.asarray(out)


class HorizontalDamping:
    """Log-referenced damping: the craft rate is fed by v_log + H(s) (v_ins - v_log) instead of v_ins, so that a turn of the ship excites nothing.

    Parameters
    ----------
    settings : with an aid
    period_s : nominal interval between its measurements

    Notes
    -----
    Beside the mechanization the level is turned by (H(s) - 1) (v_ins - v_log) / R, in all three axes as the craft rate is (platform_error.py has the
    same in the platform form of 003). v_ins is the velocity of the uncorrected solution: no other aid has a part in it.
    Each accepted measurement stands for the time since the one before, `period_s` at most. While measurements are rejected, held or out nothing is
    damped, and the state of the network decays. The turn is known, so that the error estimate can be shifted by it: it is no estimate of anything.
    """

    def __init__(self, settings: DampingSettings, period_s: float) -> None:
        self.aid = settings.aid
        self.network = Network.of(settings.ratio, settings.frequency)
        self._period = period_s

    def turn(self, state: Array, measurement: Measurement, elapsed: float, lat: float, h: float) -> Array:
        """Rotation vector (3,), NED, rad, by which n is turned beyond what the mechanization does: C_nb <- exp(-[turn x]) C_nb.

        Parameters
        ----------
        state : (2,), of the network, north and east, m/s; in place
        measurement : of the log against the uncorrected solution
        elapsed : s since the last accepted one
        lat, h : rad, m
        """
        way = self.network.step(state, velocity_apart(measurement), elapsed, min(elapsed, self._period))
        r_m, r_n = radii_s(lat)
        east = way[1] / (r_n + h)
        return np.array([east, -way[0] / (r_m + h), -east * math.tan(lat)])


def velocity_apart(measurement: Measurement) -> Array:
    """Velocity of the solution that a log was compared with, minus that of the log, north and east (2,), m/s, the vertical being alike."""
    return np.asarray(np.linalg.lstsq(measurement.H[:, N : E + 1], measurement.z, rcond=None)[0])


def check_damping(settings: DampingSettings, aids: Mapping[str, AidSettings], feedback_period_s: float) -> None:
    """Refuse damping by what cannot damp, or of what is corrected at every measurement.

    Raises
    ------
    SettingError
        There is no such aid; it measures no velocity in axes of the ship, or too seldom; the solution is fed back continuously.
    """
    name = settings.aid
    if not name:
        return
    if name not in aids:
        raise SettingError(f'"damping.aid" names "{name}"{nearest(name, aids)}; the aids are {", ".join(aids) or "none"}', ("damping", "aid"))
    aid = aids[name]
    if aid.type not in LOGS:
        raise SettingError(f'"damping.aid" names "{name}", a {aid.type}: the level is damped by one of {", ".join(LOGS)}', ("damping", "aid"))
    longest = COARSEST / (settings.frequency * SCHULER)
    if aid.period_s > longest:
        raise SettingError(f'"damping.aid" names "{name}", which measures every {aid.period_s:g} s: {longest:.0f} s are the most', ("damping", "aid"))
    if not feedback_period_s:
        raise SettingError(
            '"damping.aid" needs a "feedback_period_s": with feedback at every measurement there is nothing to damp', ("damping", "aid")
        )


def make_damping(settings: DampingSettings, aids: Mapping[str, AidSettings]) -> HorizontalDamping | None:
    """The damping that the settings ask for, None where there is none or its aid is not enabled."""
    used = aids.get(settings.aid)
    return HorizontalDamping(settings, used.period_s) if used is not None and used.enabled else None
