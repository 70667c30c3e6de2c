"""Fusion that learns the ordinary biases, finds the sensor that drifts, and removes its drift: nobody tells it which one (`glr_kf`).

Lives here: `GlrSettings`, thresholds from a mean time between false alarms, `GlrKalman`, the method for one kind of sensor.
Does not live here: the loop (glr_kf_kernel.py), its arrays (glr_kf_state.py), isolation and return of a sensor (pipeline.py).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from riins_core.settings import setting
from riins_fdi.innovation import nis_threshold

from .glr_kf_answer import answer, open_now
from .glr_kf_kernel import fuse_block
from .glr_kf_state import CALL, DOUBT, OPEN, WALK, GlrRules, GlrState, fresh
from .method import Fused, FusionMethod, Table, TriadModel

Array = NDArray[np.float64]

EFFECTIVE_TESTS = 6.0
"""Independent tests in a batch for each sensor: the windows overlap, so 13 of them count for 6 (measured, 1e6 samples: within 20 %)."""


@dataclass(frozen=True)
class GlrSettings:
    """When a drift is believed, and how it is removed. Statistics are 2 ln of a likelihood ratio."""

    mean_time_between_false_alarms_h: float = setting(10.0, "of each triad; an alarm alone removes nothing", "h", 1e-6, 1e9)
    batch_s: float = setting(0.04, "samples of this time are worked in at once", "s", 0.0, 10.0)
    longest_window_s: float = setting(600.0, "longest window of the likelihood ratios", "s", 0.1, 1e5)
    sure: float = setting(150.0, "statistic below which a sensor is not opened for good", "", 1.0, 1e6)
    margin: float = setting(25.0, "by which the best explanation must beat any other for good", "", 0.0, 1e6)
    lead: float = setting(8.0, "by which it must beat them to be acted on for the time being", "", 0.0, 1e6)
    parsimony: float = setting(25.0, "by which two sensors must beat one", "", 0.0, 1e6)
    twice: float = setting(12.0, "by which two changes of a sensor must beat one", "", 0.0, 1e6)
    again: float = setting(20.0, "alarm threshold of a sensor that is open already", "", 1.0, 1e6)
    bonus: float = setting(6.0, "advantage of a sensor that is open already over one that is not", "", 0.0, 1e6)
    restless: float = setting(1.0, "part of its size by which an open drift is expected to change while its age grows e-fold", "", 0.0, 100.0)
    floor: float = setting(0.0, "part of an ordinary bias that changes with the motion, in sigma of a sample's noise", "", 0.0, 100.0)
    recall_s: float = setting(0.5, "time constant in which what a drift has put in before it was known is taken out again", "s", 0.0, 600.0)
    noise_time_s: float = setting(5.0, "time constant of the mean square by which an open sensor is watched", "s", 0.01, 600.0)
    noise_limit: float = setting(2.0, "mean square above which an open sensor is dead, 1: that of its noise", "", 1.0, 1e6)
    drift_limit: float = setting(10.0, "drift beyond which a sensor is isolated instead of compensated, in sigma of a sample's noise", "", 0.1, 1e9)
    close_s: float = setting(60.0, "a sensor whose drift is gone for this long counts as healthy again", "s", 0.1, 1e6)
    doubt_s: float = setting(5.0, "an alarm that is not resolved after this is reported", "s", 0.0, 1e6)
    walk: float = setting(1e-5, "bias instability of a healthy sensor: step of a sample, in sigma of its noise", "", 0.0, 1.0)
    patience_s: float = setting(1.0, "another set of sensors is worked with when it lasts this long", "s", 0.0, 600.0)


def alarm_threshold(hours: float, batches_hz: float, n: int) -> float:
    """Threshold of a statistic with one degree of freedom.

    Parameters
    ----------
    hours : mean time between false alarms of a triad, h
    batches_hz : rate at which all windows are tested, Hz
    n : number of sensors
    """
    return nis_threshold(min(0.5, 1.0 / (hours * 3600.0 * batches_hz * EFFECTIVE_TESTS * n)), 1)


def make_rules(model: TriadModel, settings: GlrSettings) -> GlrRules:
    """Rules of the kernel."""
    batch = max(1, round(settings.batch_s / model.dt))
    return GlrRules(
        batch=batch,
        each=np.stack([model.R, model.P, model.Q, settings.floor**2 * model.R]),
        H=np.array(model.array.H),  # to be written, as any copy of it is: one type for the compiler
        errors=np.array([model.scale**2, model.misalignment**2]),
        moving=model.scale > 0.0 or model.misalignment > 0.0,
        common=_common(model),
        alarm=alarm_threshold(settings.mean_time_between_false_alarms_h, 1.0 / (batch * model.dt), model.array.n),
        sure=settings.sure,
        again=settings.again,
        margin=settings.margin,
        lead=settings.lead,
        bonus=settings.bonus,
        twice=settings.twice,
        parsimony=settings.parsimony,
        diffuse=1e4,
        restless=settings.restless,
        payback=-math.expm1(-model.dt / settings.recall_s) if settings.recall_s > 0.0 else 1.0,
        noise_gain=-math.expm1(-batch * model.dt / settings.noise_time_s),
        noise_limit=settings.noise_limit,
        drift_limit=settings.drift_limit,
        close=round(settings.close_s / model.dt),
        doubt=round(settings.doubt_s / model.dt),
        patience=round(settings.patience_s / model.dt),
    )


def _common(model: TriadModel) -> Array:
    """Covariance (3, 3) of the bias of the fused output when every parity is known: what the prior says of the range of H."""
    H = model.array.H
    return np.asarray(np.linalg.inv(H.T @ (H / model.P[:, None]))) if np.all(model.P > 0.0) else np.zeros((3, 3))


def make_state(model: TriadModel, settings: GlrSettings) -> GlrState:
    """State before the first sample."""
    batch = max(1, round(settings.batch_s / model.dt)) * model.dt
    levels = max(1, 1 + math.ceil(math.log2(max(1.0, settings.longest_window_s / batch / 8.0))))
    state = fresh(model.array.n, levels)
    state.P[:] = np.diag(model.P)
    state.vec[WALK] = model.Q
    return state


class GlrKalman(FusionMethod):
    """Kalman filter on the parity vector, with windowed generalized likelihood ratios on its innovations.

    Parameters
    ----------
    model : `drift` is the calibration prior, the ordinary bias of a healthy sensor; `walk` its bias instability
    settings : when a drift is believed

    Notes
    -----
    The state is one bias e_i for each sensor; the measurement is the parity vector, p = V e + v. Without an alarm the filter learns V e, the
    residual biases common to all. Moments of the past (windows 1..8 batches, then twice that, and so on) are kept with the filter's state, and
    for each the likelihood ratio of "sensor i changed there" against "nothing changed" is taken (Willsky and Jones 1976, with the filter held at
    the supposed onset so that its innovations are not those of a filter that has followed the fault). An alarm keeps the moment before it and a
    log of parity sums. From them every sensor alone (changed once or twice) and every pair, each with an onset of its own, is weighed. The
    best is acted on provisionally once it leads, for good once it is sure; a pair that cannot be told from another is never acted on.
    An open sensor starts from the moment before, with its bias unknown: one sensor for each alarm, two where one cannot explain it.
    What is removed is the estimated drift, and within `recall_s` what its integral has had too much or too little: the filter carries the integral
    of the drifts as states (only their covariance with e is needed), so any revision of the past is paid back. Removed drifts integrate like
    those of a filter that left the sensor out from its onset, with less noise. Drifts in the range of H are not seen by any parity; the
    covariance W (R + P) W' keeps their prior.
    """

    name = "glr_kf"
    title = "parity Kalman filter with likelihood ratios"

    def __init__(self, model: TriadModel, settings: GlrSettings | None = None) -> None:
        self.settings = settings or GlrSettings()
        self.rules = make_rules(model, self.settings)
        super().__init__(model)

    def _begin(self) -> tuple[Array, ...]:
        return cast(tuple[Array, ...], tuple(make_state(self.model, self.settings)))

    @property
    def state(self) -> GlrState:
        """The memory, plain arrays."""
        return GlrState(*cast(Any, self._state))

    @property
    def open(self) -> tuple[int, ...]:
        """Sensors whose drift is removed."""
        return tuple(int(i) for i in np.flatnonzero(self.state.open == OPEN))

    @property
    def doubtful(self) -> bool:
        """An alarm is not resolved."""
        return bool(self.state.ints[DOUBT])

    def open_now(self, sensor: int) -> None:
        """Open a sensor from the next sample on, on somebody's word; for studies, and for an operator who knows."""
        open_now(self.state, self.rules, sensor)

    def _run(self, table: Table, z: Array, out: Fused) -> None:
        V = np.linalg.solve(np.linalg.cholesky(table.R), table.V) if len(table.V) else table.V
        V, state, k = np.ascontiguousarray(V), self.state, 0
        while k < len(z):
            k = fuse_block(k, z, table.used, len(V), table.W, state, self.rules, out.x, out.covariance, out.drift)
            if state.ints[CALL]:
                answer(state, self.rules, V, table.used, table.W)
