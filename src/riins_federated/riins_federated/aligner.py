"""One alignment from its beginning to its end, second by second of measurement time.

Lives here: `Aligner`, `warm_up`, `heading_limit`: which method when, what is tried, when it is good enough to hand over, when it has failed and why.
Does not live here: the methods (alignment_methods.py), commands and the navigator's side of it (alignment_desk.py).
"""

from __future__ import annotations

import math

import numpy as np

from riins_core.alignment.inertial_frame import body_integrals
from riins_core.alignment.result import AlignmentError, TooSoon, check_latitude
from riins_core.alignment.stationary import ImuNoise, align_stationary
from riins_core.alignment.stored import Aids, Start, prior, run_stored
from riins_core.earth import earth_rate_n, gravity
from riins_core.rotation import euler_from_dcm, exp_so3
from riins_core.sensor_errors import MICRO_G

from .alignment_aids import fixes, imu_noise, roles, velocities
from .alignment_detect import Motion, detect
from .alignment_methods import Found, Task, attempt
from .alignment_settings import DATA_S, AlignCommand, AlignmentReport, Phase
from .alignment_store import AlignmentData
from .config import NavigatorConfig
from .timeline import to_ns
from .types import Array

SECOND_NS = 1_000_000_000
SURE_AT_ONCE = ("stationary", "redundant")
"""Methods whose refusal is a test of the data as such, so that more data cannot cure it."""
CHOICE = {Motion.REST: "stationary", Motion.SWAYING: "swaying", Motion.UNDER_WAY: "in_motion"}
WORDS = {Motion.REST: "at rest", Motion.SWAYING: "swaying at one place", Motion.UNDER_WAY: "under way"}
BOUND = 1.96
"""95 % of a normal."""
LEVEL_S = 10.0


def heading_limit(config: NavigatorConfig, lat: float) -> float:
    """Error bound of the heading, 95 %, that A.821 asks for at a latitude [rad], rad: `validity.heading_deg` times sec(latitude)."""
    return math.radians(config.validity.heading_deg) / max(math.cos(lat), 1e-6)


def warm_up() -> None:
    """Compile the kernels of the methods on seconds of nothing, so that the first attempt does not hold up the samples."""
    rate, force = np.tile(earth_rate_n(0.7), (200, 1)), np.tile([0.0, 0.0, -float(gravity(0.7, 0.0))], (200, 1))
    imu = ImuNoise(1e-5, 1e-3, 1e-6, 1e-3)
    align_stationary(rate, force, 0.1, 0.7, imu, check=False)
    still = Aids("place", np.array([100, 200]), np.zeros((2, 3)), np.ones(3))
    run_stored(rate, force, 0.1, Start(0.7, 0.1, 0.0, np.zeros(3), np.eye(3), prior(1.0, 1.0, 0.1, 0.1, imu)), imu, still)
    body_integrals(rate, force, 0.1, 1)


class Aligner:
    """An alignment under way.

    Parameters
    ----------
    config : of the navigator
    command : method, time limit and beginning

    Attributes
    ----------
    data : feed it with everything from the beginning on
    due_ns : stamp at which `second` is next to be called, once everything up to it is settled
    ended : there is a result, or none will come
    """

    def __init__(self, config: NavigatorConfig, command: AlignCommand) -> None:
        self._config, self._settings, self.command = config, config.alignment, command
        self.data = AlignmentData(command.stamp_ns)
        given = self._settings.heading
        heading = (command.heading, command.sigma_heading) if command.sigma_heading > 0.0 else None
        if heading is None and given:
            heading = (math.radians(given[0]), math.radians(given[1]))
        self._task = Task(config, roles(config), self.data, heading)
        self._limit_s = command.time_limit_s or self._settings.time_limit_s
        self._motion = Motion.REST
        self._method = "" if command.method == "auto" else command.method
        self._next_s = 0.0
        self._phase, self._reason = Phase.STANDBY, "there are no samples yet"
        self._C: Array | None = None
        self._attitude_ns = 0
        self._sigma, self._level, self._place = np.full(3, np.nan), np.full(3, np.nan), np.full(3, np.nan)
        self._news: list[str] = []
        self.due_ns = command.stamp_ns + SECOND_NS
        self.ended = False

    @property
    def method(self) -> str:
        """In use; auto until one is chosen."""
        return self._method or "auto"

    def second(self) -> AlignmentReport:
        """Work the data up to `due_ns`, to which everything is settled."""
        now = self.due_ns
        self.due_ns += SECOND_NS
        elapsed = (now - self.command.stamp_ns) * 1e-9
        for recall, done in self.data.settle(now):
            since = f"since {(recall.stamp_ns - recall.onset_ns) * 1e-9:.1f} s"
            self._tell(
                f"taken out of the stored data what isolated inertial sensors had put in {since}" if done
                else "an inertial sensor isolated whose fault began before the alignment: the data so far are not used"
            )  # fmt: skip
            if not done and self._C is not None:
                self._C, self._phase = None, Phase.COARSE
        try:
            self._check_given()
            found = self._try(now, elapsed) if elapsed + 1e-9 >= self._next_s else None
        except TooSoon as reason:
            found, self._reason = None, str(reason)
        except AlignmentError as reason:
            return self._end(now, elapsed, "failed", str(reason))
        if found is not None:
            return self._end(now, elapsed, "aligned", "", found)
        if elapsed >= self._limit_s:
            return self._end(now, elapsed, "failed", f"no heading within {self._limit_s:g} s: {self._reason}")
        self._follow(now)
        return self._report(now, elapsed)

    def give_up(self, stamp_ns: int, why: str) -> AlignmentReport:
        """End without a result at somebody's word."""
        return self._end(stamp_ns, (stamp_ns - self.command.stamp_ns) * 1e-9, "cancelled", f"{why}; so far: {self._reason}")

    def _check_given(self) -> None:
        if self._settings.position:
            check_latitude(math.radians(self._settings.position[0]))

    def _try(self, now: int, elapsed: float) -> Found | None:
        """One attempt; the result once it may be handed over."""
        settings = self._settings
        held = (now - self.data.floor_ns) * 1e-9
        first = min(settings.attempt_s, settings.data_s or math.inf, DATA_S.get(self._method, math.inf))
        if held + 1e-9 < first:
            self._next_s = elapsed + first - held
            raise TooSoon(f"{first:g} s of data are waited for")
        self._choose(now)
        wanted = settings.data_s or DATA_S[self._method]
        ready = held + 1e-9 >= wanted
        steps = math.floor(held / settings.attempt_s + 1e-9) + 1
        self._next_s = elapsed - held + (steps * settings.attempt_s if ready else min(steps * settings.attempt_s, wanted))
        try:
            found = attempt(self._method, self._task, now, self._motion)
        except TooSoon:
            raise
        except AlignmentError as reason:
            if not ready and self._method not in SURE_AT_ONCE:
                raise TooSoon(str(reason)) from None
            raise
        self._take(found)
        bound, limit = BOUND * math.sqrt(found.P[8, 8]), heading_limit(self._config, float(found.place[0]))
        if not bound <= limit:
            raise TooSoon(
                f"the data do not give the heading yet: 95 % bound {math.degrees(bound):.2g} deg after {elapsed:.0f} s, "
                f"{math.degrees(limit):.2g} asked for; poor gyros want changes of velocity or a known heading"
            )
        if not ready:
            raise TooSoon(f"{wanted:g} s of data are waited for")
        return found

    def _choose(self, now: int) -> None:
        """What the ship does; auto follows it, to the more general method only."""
        window = self.data.window(now)
        if window is None:
            raise TooSoon("there are no samples yet")
        known = self._task.known
        imu = imu_noise(self._config, window)
        motion, why = detect(window, imu, fixes(known, self.data, now), velocities(known, self.data, window), self._settings)
        self._motion = max(self._motion, motion)
        choice = CHOICE[self._motion]
        if self.command.method == "auto" and choice != self._method:
            self._tell(f"{WORDS[self._motion]} ({why}): method {choice}")
            self._method = choice

    def _take(self, found: Found) -> None:
        if self._C is None or self._phase is not Phase.FINE:
            self._tell("attitude found, being refined")
        self._phase = Phase.FINE
        self._C, self._attitude_ns, self._place = found.C_nb, found.stamp_ns, found.place
        self._sigma = np.sqrt(np.diag(found.P)[6:9])

    def _follow(self, now: int) -> None:
        """Attitude of now: what was found, turned on by the gyros, or the level alone."""
        if self._phase is Phase.FINE and self._C is not None:
            window = self.data.window(now, self._attitude_ns)
            if window is not None:
                turn = body_integrals(window.rate, window.force, window.dt, len(window.rate))[0][1]
                self._C = exp_so3(-earth_rate_n(float(self._place[0])) * window.length_s) @ self._C @ turn
                self._attitude_ns = window.end_ns
            return
        window = self.data.window(now, now - to_ns(LEVEL_S))
        if window is None:
            return
        if self._phase is Phase.STANDBY:
            self._phase = Phase.COARSE
        seen = fixes(self._task.known, self.data, now)
        if seen is not None:
            self._place = seen.place[-1]
        f = window.force.mean(axis=0)
        g = float(gravity(0.7, 0.0))
        scatter = float(np.max(window.force.std(axis=0)[:2])) / g
        level = math.hypot(self._config.inertial.accel_bias_ug * MICRO_G / g, scatter)
        self._level = np.array([math.atan2(-f[1], -f[2]), math.atan2(f[0], math.hypot(f[1], f[2])), math.nan])
        self._sigma = np.array([level, level, math.nan])

    def _report(self, now: int, elapsed: float, ended: str = "", found: Found | None = None) -> AlignmentReport:
        rph = np.full(3, np.nan)
        if self._C is not None:
            rph = np.array([float(a) for a in euler_from_dcm(self._C)])
        elif self._phase is Phase.COARSE:
            rph = self._level
        text, self._news = "; ".join(self._news), []
        source = f"alignment ({self.method})"
        initial = found.initial_state(source) if found is not None else None
        begin = self.command.stamp_ns
        return AlignmentReport(now, begin, self._phase, self.method, elapsed, text, rph, self._sigma.copy(), self._place.copy(), initial, ended)

    def _end(self, now: int, elapsed: float, ended: str, why: str, found: Found | None = None) -> AlignmentReport:
        self.ended = True
        if found is not None:
            self._phase = Phase.NAVIGATING
            heading, sigma = float(euler_from_dcm(found.C_nb)[2]), math.sqrt(found.P[8, 8])
            self._tell(
                f"aligned by {self.method} after {elapsed:.0f} s: heading {math.degrees(heading):.2f} deg, 95 % bound "
                f"{math.degrees(BOUND * sigma):.2g} deg"
            )
        else:
            self._phase, self._C = Phase.FAILED if ended == "failed" else Phase.STANDBY, None
            self._sigma = np.full(3, np.nan)
            self._tell(f"alignment {ended}: {why}")
        return self._report(now, elapsed, ended, found)

    def _tell(self, line: str) -> None:
        self._news.append(line)
