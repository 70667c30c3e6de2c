"""Strapdown, master and subfilters in one object that can be stopped, copied and taken back.

Lives here: `IntegratedFilter`: integrate samples, propagate, judge aids, feed back, say the solution.
Does not live here: what happens when (navigator.py), the models (aiding.py, error_filter.py), the structures (structures.py).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from riins_core import ins_error
from riins_core.ins_error import PHI, VEL, State
from riins_core.rotation import dcm_from_euler, exp_so3
from riins_core.strapdown import strapdown_block
from riins_fdi.eraim import cross_check
from riins_fdi.health import Change

from .aiding import Measurement, Pose
from .aids import make
from .aids.gnss_position import GnssPosition
from .assembly import make_structure
from .config import NavigatorConfig
from .damping import make_damping
from .error_filter import between, gather, transition
from .known_height import HeightModel
from .local_filter import LocalFilter
from .sample_noise import SampleNoise
from .solution import body_rate, solution
from .state_blocks import N_FED_BACK, StateModel
from .structures import Structure
from .types import Aid, Array, InitialState, Judged, Mode, NavSolution, Recall, SubfilterReport, TakenOut

VERTICAL = [int(State.POS_D), int(State.VEL_D)]


@dataclass
class _Motion:
    """Nominal state and what goes with it."""

    nav: Array
    nav_before: Array  # one sample earlier
    dtheta: Array
    dv: Array
    parameters: Array  # estimated: gyro bias, accelerometer bias, then in the order of the state
    sums: Array
    swing: Array  # see error_filter.gather
    rate: Array  # last two samples, newest first
    force: Array
    noise: Array  # of SampleNoise
    network: Array  # of HorizontalDamping
    damped_ns: int  # stamp of the last measurement it has seen
    dt: float = 0.0
    stamp_ns: int = 0
    started_ns: int = 0
    reset_count: int = 0
    reset: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def copy(self) -> _Motion:
        fresh = replace(self)
        for name in ("nav", "nav_before", "dtheta", "dv", "parameters", "sums", "swing", "rate", "force", "noise", "network"):
            setattr(fresh, name, getattr(self, name).copy())
        return fresh


class IntegratedFilter:
    """The federated filter at one measurement time.

    Parameters
    ----------
    config : NavigatorConfig

    Attributes
    ----------
    subfilters : LocalFilter for each aid that is enabled
    states : the assembled error state
    running : it has an initial state
    cross_check : statistic and threshold of the satellite receivers against each other, 0 before they measured at one sample
    """

    def __init__(self, config: NavigatorConfig) -> None:
        self._config = config
        self._sample_noise = SampleNoise(config)
        self._height = HeightModel(config.height)
        on = {name: settings for name, settings in config.aid.items() if settings.enabled}
        self._damping = make_damping(config.damping, config.aid)
        models = [make(name, settings) for name, settings in on.items()]
        own = [block for model in models for block in model.blocks()]
        self.states = StateModel(config.inertial, config.states, [*own, *self._height.blocks()])
        for model in models:
            model.place(self.states)
        self._height.place(self.states)
        self.subfilters = [LocalFilter(model, config.isolation) for model in models]
        self._motion: _Motion | None = None
        self._aids = list(on.values())
        self._receivers = [i for i, local in enumerate(self.subfilters) if isinstance(local.model, GnssPosition)]
        self._structure: Structure = make_structure(config, np.zeros((self.states.n, self.states.n)), self._aids)
        self._fixes: dict[int, Measurement] = {}  # of the receivers, at the newest sample
        self.cross_check = (0.0, 0.0)
        self._Phi, self._Qd = np.empty((self.states.n, self.states.n)), np.empty((self.states.n, self.states.n))

    @property
    def running(self) -> bool:
        """It has an initial state."""
        return self._motion is not None

    @property
    def started_ns(self) -> int:
        """Stamp of the initial state; 0 without one."""
        return self._motion.started_ns if self._motion else 0

    @property
    def stamp_ns(self) -> int:
        """Stamp of the newest sample integrated."""
        return self._motion.stamp_ns if self._motion else 0

    @property
    def beta(self) -> Array:
        """Information shares of the subfilters."""
        return self._structure.beta

    def start(self, initial: InitialState) -> None:
        """Begin at an initial state, forgetting what was estimated before."""
        nav = np.zeros(16)
        nav[0:3] = initial.lat, initial.lon, initial.h
        nav[3:6] = initial.v_n
        nav[6:15] = dcm_from_euler(*initial.rph).ravel()
        before = self._motion
        self._motion = _Motion(
            nav,
            nav.copy(),
            np.zeros(3),
            np.zeros(3),
            self.states.initial_parameters(initial),
            np.zeros(13),
            np.zeros(6),
            np.zeros((2, 3)),
            np.zeros((2, 3)),
            self._sample_noise.fresh(),
            np.zeros(2),
            initial.stamp_ns,
            stamp_ns=initial.stamp_ns,
            started_ns=initial.stamp_ns,
            reset_count=before.reset_count + 1 if before else 0,
        )
        P0 = self.states.initial_covariance(initial)
        self._structure = make_structure(self._config, P0, self._aids)
        self._fixes, self.cross_check = {}, (0.0, 0.0)

    def stop(self) -> None:
        """Forget the run; counts and the operator's exclusions stay."""
        self._motion = None
        for local in self.subfilters:
            local.restart()

    def integrate(self, rate: Array, force: Array, dt: Array, stamp_ns: int, rate_covariance: Array, force_covariance: Array, unknown: Array) -> None:
        """Advance the nominal state by samples (m, 3), (m, 3), (m,) of covariances (m, 3, 3) and (m, 6), the last of which ends at `stamp_ns`."""
        m = self._running()
        self._sample_noise.gather(m.noise, rate_covariance, force_covariance, unknown, dt)
        if len(dt) > 1:
            m.rate[0], m.force[0] = rate[-2], force[-2]
        elif not m.dt:
            m.rate[0], m.force[0] = rate[0], force[0]
        m.rate[1], m.force[1] = m.rate[0], m.force[0]
        m.rate[0], m.force[0] = rate[-1], force[-1]
        bias_g, bias_a = self.states.biases(m.parameters)
        if self.states.scaled:
            gain_g, gain_a = self.states.gains(m.parameters)
            rate, force, bias_g, bias_a = rate * gain_g, force * gain_a, bias_g * gain_g, bias_a * gain_a
            gather(m.swing, rate - bias_g, force - bias_a, dt)
        if len(dt) > 1:
            strapdown_block(m.nav, m.dtheta, m.dv, rate[:-1], force[:-1], dt[:-1], bias_g, bias_a, m.sums)
        m.nav_before[:] = m.nav
        strapdown_block(m.nav, m.dtheta, m.dv, rate[-1:], force[-1:], dt[-1:], bias_g, bias_a, m.sums)
        m.dt, m.stamp_ns = float(dt[-1]), stamp_ns

    def propagate(self) -> None:
        """Bring the error covariance up to the nominal state."""
        m = self._running()
        if m.sums[12] > 0.0:
            s = self.states
            nav, sums = self._middle() if self._config.feedback_period_s else (m.nav, m.sums)
            transition(nav, sums, m.swing, s.density, s.decay, s.column, s.factor, self._Phi, self._Qd)
            self._sample_noise.add(m.noise, m.sums[3:12].reshape(3, 3) / m.sums[12], float(m.sums[12]), self._Qd)
            self._structure.predict(self._Phi, self._Qd)
            m.parameters *= self._Phi.diagonal()[N_FED_BACK:]  # what is estimated of a Markov process fades as the process does
            m.sums[:] = 0.0
            m.swing[:] = 0.0

    def judge(self, index: int, aid: Aid) -> tuple[Judged, Change | None]:
        """Test a measurement of subfilter `index`, not later than the newest sample, and fuse it if it passes."""
        local = self.subfilters[index]
        nominal = self._pose(aid.stamp_ns)
        pose, parameters, x = self._estimated(nominal)
        verdict = self._structure.judge(index, about(local.model.measurement(aid, pose, parameters), x))
        judged, change = local.judge(aid.stamp_ns, verdict, self._structure.separated(index))
        self._structure.take(index, verdict, judged.accepted)
        if index in self._receivers:
            self._fixes[index] = verdict.measurement
        if judged.accepted and self._damping is not None and local.name == self._damping.aid:
            self._damp(local.model.measurement(aid, nominal, self._running().parameters), aid.stamp_ns)
        return judged, change

    def fuse_height(self) -> None:
        """Fuse the known mean height, in every master."""
        pose, parameters, x = self._estimated(self._pose(self.stamp_ns))
        self._structure.add(about(self._height.measurement(pose, parameters), x))

    def close(self) -> list[TakenOut]:
        """End of what is judged at one sample: the solutions are compared, and what a faulty aid has put in is taken out; announced as a reset."""
        self._check_receivers()
        out = []
        for one in self._structure.close():
            local = self.subfilters[one.aid]
            self._announce(one.jump)
            out.append(TakenOut(self.stamp_ns, local.name, local.take_out(self.stamp_ns), one.statistic, one.threshold, self._running().reset))
        return out

    def feed_back(self, announced: bool = False) -> None:
        """Correct the nominal state by the estimate, which is zero afterwards; a correction beyond one sigma is a reset, unless it is announced."""
        x = self._structure.x.copy()
        if not x.any():
            return
        self._shift(x, announced)
        self._structure.shift(x)
        self._running().network[:] = 0.0  # what the log and the solution were apart is gone

    def damp_vertical(self) -> None:
        """Correct height and vertical velocity of the nominal state alone: without aids they run away, e-fold in ten minutes, and it with them."""
        x = np.zeros(self.states.n)
        x[VERTICAL] = self._structure.x[VERTICAL]
        if x.any():
            self._shift(x)
            self._structure.shift(x)

    def _damp(self, measurement: Measurement, stamp_ns: int) -> None:
        """Turn the level of the nominal state by a measurement of the log against it, and the estimate of its error with it: the output stays."""
        m = self._running()
        assert self._damping is not None
        x = np.zeros(self.states.n)
        x[PHI] = -self._damping.turn(m.network, measurement, (stamp_ns - m.damped_ns) * 1e-9, float(m.nav[0]), float(m.nav[2]))
        m.damped_ns = stamp_ns
        self._shift(x, announced=True)
        self._structure.shift(x)

    def recall(self, recall: Recall) -> None:
        """Take out of the nominal state what declared sensors have put in; the aids' corrections since, and the position, stay."""
        C_nb = self._running().nav[6:15].reshape(3, 3)
        x = np.zeros(self.states.n)
        x[PHI] = -(C_nb @ recall.angle)  # computed C_nb = C_nb exp([angle x]) = (I - [phi x]) C_nb
        x[VEL] = C_nb @ recall.velocity
        self._shift(x)

    def _middle(self) -> tuple[Array, Array]:
        """Nominal state and `sums` halfway to the estimate: the error of a nominal state far from the true one is linear about the middle of both."""
        m, x = self._running(), 0.5 * self._structure.x
        nav, sums, turn = m.nav.copy(), m.sums.copy(), exp_so3(x[PHI])
        ins_error.correct(nav, x[:N_FED_BACK])
        sums[0:3] = turn @ sums[0:3]
        sums[3:12] = (turn @ sums[3:12].reshape(3, 3)).ravel()
        return nav, sums

    def _estimated(self, pose: Pose) -> tuple[Pose, Array, Array | None]:
        """Pose and parameters to compare a measurement with, and the estimated errors that have been taken out of them, None: none.

        While the estimate is not fed back it grows: products of errors, as of heading and velocity in a log, would become errors of the filter.
        """
        m = self._running()
        if not self._config.feedback_period_s:
            return pose, m.parameters, None
        x = self._structure.x.copy()
        nav, parameters = np.array([pose.lat, pose.lon, pose.h, *pose.v_n, *pose.C_nb.ravel(), 0.0]), m.parameters.copy()
        self.states.correct(nav, parameters, x)
        estimated = pose._replace(lat=nav[0], lon=nav[1], h=nav[2], v_n=nav[3:6], C_nb=nav[6:15].reshape(3, 3))
        return estimated, parameters, x

    def _shift(self, x: Array, announced: bool = False) -> None:
        """Subtract errors from the nominal state; beyond one sigma it is a reset."""
        m, P = self._running(), self._structure.P
        self.states.correct(m.nav, m.parameters, x)
        ins_error.correct(m.nav_before, x[:N_FED_BACK])
        position, velocity, heading = math.hypot(x[0], x[1]), math.hypot(x[3], x[4]), abs(x[8])
        if not announced and (position**2 > P[0, 0] + P[1, 1] or velocity**2 > P[3, 3] + P[4, 4] or heading**2 > P[8, 8]):
            self._announce(x)

    def _announce(self, x: Array) -> None:
        """Count a reset by which x is subtracted from the solution."""
        m = self._running()
        m.reset_count += 1
        m.reset = (math.hypot(x[0], x[1]), math.hypot(x[3], x[4]), float(x[8]))

    def _check_receivers(self) -> None:
        """Satellite receivers that measured at one sample against each other; of more than two the pair that is furthest apart."""
        fixes = [(one.z[:2], one.R[:2, :2]) for one in self._fixes.values()]
        self._fixes = {}
        pairs = [(*fixes[i], *fixes[j]) for i in range(len(fixes)) for j in range(i)]
        if pairs:
            self.cross_check = max(cross_check(*pair, self._config.isolation.false_alarm_probability)[:2] for pair in pairs)

    def mode(self) -> Mode:
        """Navigating while some aid has been fused within its time-out, else coasting."""
        if self._motion is None:
            return Mode.WAITING
        return Mode.NAVIGATING if any(local.fusing(self._motion.stamp_ns) for local in self.subfilters) else Mode.COASTING

    def solution(self) -> NavSolution:
        """State at the newest sample, corrected by the estimate."""
        protection = self._structure.protection(self._config.validity.integrity_risk)
        return self._told(self._structure.x, self._structure.P, self.mode(), protection)

    def inertial(self) -> NavSolution:
        """State at the newest sample without the correction, and its mean square error by the estimate: P + x x'."""
        x = self._structure.x
        radius, heading = self._structure.protection(self._config.validity.integrity_risk)
        protection = radius + math.hypot(x[0], x[1]), heading + abs(float(x[8]))
        return self._told(np.zeros(len(x)), self._structure.P + np.outer(x, x), Mode.COASTING, protection)

    def _told(self, x: Array, P: Array, mode: Mode, protection: tuple[float, float]) -> NavSolution:
        m = self._running()
        return solution(
            m.stamp_ns,
            m.nav,
            m.parameters,
            self.states,
            m.rate[0],
            m.force[0],
            x,
            P,
            mode,
            self._config.validity,
            protection,
            m.reset_count,
            m.reset,
        )

    def reports(self) -> tuple[SubfilterReport, ...]:
        """State of the subfilters."""
        beta = self.beta if self.running else np.zeros(len(self.subfilters))
        return tuple(local.report(float(beta[i]), self._structure.watched(i)) for i, local in enumerate(self.subfilters))

    def snapshot(self) -> tuple[Any, ...]:
        """All that `restore` needs."""
        motion = self._motion.copy() if self._motion else None
        return motion, self._structure, self._structure.snapshot(), tuple(local.snapshot() for local in self.subfilters), self.cross_check

    def restore(self, snapshot: tuple[Any, ...]) -> None:
        """Go back to a snapshot, which stays usable."""
        motion, self._structure, estimate, subfilters, self.cross_check = snapshot
        self._motion = motion.copy() if motion else None
        self._fixes = {}
        self._structure.restore(estimate)
        for local, part in zip(self.subfilters, subfilters, strict=True):
            local.restore(part)

    def _running(self) -> _Motion:
        if self._motion is None:
            raise RuntimeError("the filter has no initial state")
        return self._motion

    def _pose(self, stamp_ns: int) -> Pose:
        """Nominal state at a stamp within the newest sample, by linear interpolation."""
        m = self._running()
        nav = m.nav
        newest, before = m.rate
        rate = 1.5 * newest - 0.5 * before  # from means over samples to the end of the newest
        back = (m.stamp_ns - stamp_ns) * 1e-9
        if back > 0.0 and m.dt > 0.0:
            w = min(back / m.dt, 1.0)
            nav = between(nav, m.nav_before, w)
            rate = rate + w * (before - newest)
        rate_b = body_rate(nav, self.states.rate(m.parameters, rate))
        a_n = (m.nav[3:6] - m.nav_before[3:6]) / m.dt if m.dt > 0.0 else np.zeros(3)
        lat, lon, h = nav[0:3].tolist()
        return Pose(lat, lon, h, nav[3:6], nav[6:15].reshape(3, 3), rate_b, a_n)


def about(measurement: Measurement, x: Array | None) -> Measurement:
    """The measurement against the nominal state, of one that was compared with the nominal state less x."""
    return measurement if x is None else measurement._replace(z=measurement.z + measurement.H @ x)
