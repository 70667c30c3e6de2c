"""Motion of a point of the ship from the navigator's state: attitude, its rates, heave, their sigmas and validity.

Lives here: `MotionConfig`, `Motion`, `MotionEstimator`.
Does not live here: the filter (heave.py), the message (messages.py), ROS (nodes/motion.py).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from riins_core.settings import setting

from .heave import SETTLING_PERIODS, HeaveFilter, drift_gain, transfer

VALID, DOUBTFUL, INVALID = 0, 1, 2
NAVIGATING, COASTING = 2, 3
_JUMP_M = 0.02


@dataclass(frozen=True)
class MotionConfig:
    """How heave is found, where, and when it is good enough."""

    cutoff_period_s: float = setting(
        80.0, "motion slower than this is mean level, not heave; 6 times the longest wave period loses 1 %", "s", 20.0, 1e3
    )
    point_m: tuple[float, ...] = setting(
        (0.0, 0.0, 0.0), "point whose heave is given, from base_link: forward, starboard, down", "m", -500.0, 500.0, length=3
    )
    velocity_error_time_s: float = setting(600.0, "correlation time of the error of the navigator's vertical velocity, for the sigma", "s", 1.0, 1e5)
    heave_limit_m: float = setting(0.05, "heave is doubtful when its sigma exceeds this", "m", 1e-4, 10.0)
    heave_limit_ratio: float = setting(0.05, "... and this part of its own RMS", "", 0.0, 1.0)
    tilt_limit_deg: float = setting(0.25, "roll and pitch are doubtful when the sigma of either exceeds this", "deg", 1e-4, 45.0)
    max_gap_s: float = setting(1.0, "a longer gap between states, or a jump back by more, starts the heave filter anew", "s", 0.01, 60.0)


@dataclass(frozen=True)
class Motion:
    """Motion at `stamp_ns`: attitude FRD in NED [rad], Euler rates [rad/s], heave [m] and its rate [m/s] up, 1-sigma each, validity 0..2 each."""

    stamp_ns: int
    rph: tuple[float, float, float]
    rph_rate: tuple[float, float, float]
    heave: float
    heave_velocity: float
    sigma_rph: tuple[float, float, float]
    sigma_heave: float
    sigma_heave_velocity: float
    attitude_validity: int
    heading_validity: int
    heave_validity: int


class MotionEstimator:
    """Motion of one point, state by state.

    Parameters
    ----------
    config : MotionConfig

    Attributes
    ----------
    received, dropped : states taken; states whose stamp was not after the last one's
    restarts : reason and number of the heave filter's new beginnings

    Notes
    -----
    A function of the states and their stamps alone. The state is provisional (`nav/state`), so heave is too: a late measurement that the
    navigator works in changes the states after it, not the heave already published.

    When the navigator announces a reset (`reset_count`) that moves the height, the filter begins anew: what a faulty sensor had put into the
    vertical velocity is gone from heave as well, and heave is invalid until it has settled.
    """

    def __init__(self, config: MotionConfig) -> None:
        self.config = config
        self.received = self.dropped = 0
        self.restarts = {"gap": 0, "stamp jumped back": 0, "reset": 0, "no navigation": 0}
        self._filter = HeaveFilter(config.cutoff_period_s)
        self._settling_ns = round(SETTLING_PERIODS * config.cutoff_period_s * 1e9)
        self._gain = drift_gain(config.cutoff_period_s, config.velocity_error_time_s)
        self._last: Mapping[str, Any] | None = None
        self._began_ns: int | None = None
        self._velocity = 0.0
        self._m0 = self._m2 = 0.0

    @property
    def settling_s(self) -> float:
        """Time from the start to a valid heave [s]."""
        return self._settling_ns * 1e-9

    def add(self, state: Mapping[str, Any]) -> Motion | None:
        """Take a state.

        Parameters
        ----------
        state : as `riins_node.readings.read_nav_state` gives it

        Returns
        -------
        Motion at its stamp; None when the stamp is not after the last one's
        """
        stamp = int(state["stamp_ns"])
        dt_ns = stamp - int(self._last["stamp_ns"]) if self._last is not None else 0
        if self._last is not None and -self.config.max_gap_s * 1e9 <= dt_ns <= 0:
            self.dropped += 1
            return None
        self.received += 1
        roll, pitch, heading = (float(angle) for angle in state["rph"])
        rates = _euler_rates(roll, pitch, state["rate_b"])
        velocity = _upward(state, roll, pitch, self.config.point_m)
        navigating = int(state["mode"]) in (NAVIGATING, COASTING) and math.isfinite(velocity)
        heave, rate = self._heave(state, dt_ns, velocity, navigating)
        self._last = state if navigating else None
        sigmas = [float(sigma) for sigma in state["sigma_rph"]]
        good = max(sigmas[:2]) <= math.radians(self.config.tilt_limit_deg)
        sigma_heave, sigma_rate = self._sigmas(float(state["sigma_velocity"][2]))
        return Motion(
            stamp,
            (roll, pitch, heading),
            rates,
            heave,
            rate,
            (sigmas[0], sigmas[1], sigmas[2]),
            sigma_heave,
            sigma_rate,
            (VALID if good else DOUBTFUL) if navigating else INVALID,
            int(state["validity"][2]) if navigating else INVALID,
            self._heave_validity(stamp, sigma_heave),
        )

    def _heave(self, state: Mapping[str, Any], dt_ns: int, velocity: float, navigating: bool) -> tuple[float, float]:
        if not navigating:
            if self._began_ns is not None:
                self.restarts["no navigation"] += 1
            self._began_ns = None
            return 0.0, 0.0
        reason = self._why_anew(state, dt_ns)
        if reason is not None or self._began_ns is None:
            if reason is not None and self._began_ns is not None:
                self.restarts[reason] += 1
            self._began_ns, self._m0, self._m2 = int(state["stamp_ns"]), 0.0, 0.0
            self._filter.start(velocity)
            return 0.0, 0.0
        heave, rate = self._filter.step(dt_ns, velocity)
        forget = math.exp(-dt_ns * 1e-9 / self.config.cutoff_period_s)
        self._m0 = forget * self._m0 + (1.0 - forget) * heave * heave
        self._m2 = forget * self._m2 + (1.0 - forget) * rate * rate
        return heave, rate

    def _why_anew(self, state: Mapping[str, Any], dt_ns: int) -> str | None:
        last = self._last
        if last is None:
            return None
        if dt_ns < 0:
            return "stamp jumped back"
        if dt_ns > self.config.max_gap_s * 1e9:
            return "gap"
        if int(state["reset_count"]) != int(last["reset_count"]):
            sailed = -0.5e-9 * dt_ns * (float(state["v_n"][2]) + float(last["v_n"][2]))
            if abs(float(state["h"]) - float(last["h"]) - sailed) > _JUMP_M:
                return "reset"
        return None

    def _sigmas(self, sigma_velocity: float) -> tuple[float, float]:
        """Slow error of the velocity through the filter, and what the filter does to the waves there are, at their mean period."""
        distortion = 0.0
        if self._m0 > 0.0 and self._m2 > 0.0:
            distortion = abs(transfer(2.0 * math.pi * math.sqrt(self._m0 / self._m2), self.config.cutoff_period_s) - 1.0)
        return (
            math.hypot(self._gain[0] * sigma_velocity, distortion * math.sqrt(self._m0)),
            math.hypot(self._gain[1] * sigma_velocity, distortion * math.sqrt(self._m2)),
        )

    def _heave_validity(self, stamp_ns: int, sigma: float) -> int:
        if self._began_ns is None or stamp_ns - self._began_ns < self._settling_ns:
            return INVALID
        limit = max(self.config.heave_limit_m, self.config.heave_limit_ratio * math.sqrt(self._m0))
        return VALID if sigma <= limit else DOUBTFUL


def _euler_rates(roll: float, pitch: float, rate_b: Any) -> tuple[float, float, float]:
    """Derivatives of roll, pitch, heading from the body rate relative to NED, FRD."""
    p, q, r = (float(one) for one in rate_b)
    sine, cosine = math.sin(roll), math.cos(roll)
    heading = (q * sine + r * cosine) / math.cos(pitch)
    return p + heading * math.sin(pitch), q * cosine - r * sine, heading


def _upward(state: Mapping[str, Any], roll: float, pitch: float, point: tuple[float, ...]) -> float:
    """Upward velocity of a point: that of base_link and what the rotation adds."""
    p, q, r = (float(one) for one in state["rate_b"])
    x, y, z = point
    turned = q * z - r * y, r * x - p * z, p * y - q * x
    down = -math.sin(pitch) * turned[0] + math.cos(pitch) * (math.sin(roll) * turned[1] + math.cos(roll) * turned[2])
    return -float(state["v_n"][2]) - down
