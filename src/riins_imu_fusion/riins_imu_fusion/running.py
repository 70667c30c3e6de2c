"""The methods that are running: rules, tables and memory of the fusion, of the tests over time, of the drift filters and of the noise estimation.

Lives here: `Methods`, which makes them from the configuration, and anew when another selection or another noise is to be used.
Does not live here: when that happens, health and events (pipeline.py), what may be selected (selection.py).
"""

from __future__ import annotations

import math

import numpy as np

from riins_fdi.health import ALWAYS_NS, NEVER_NS
from riins_fdi.innovation import nis_threshold
from riins_fdi.parity import glt_threshold
from riins_imu_fusion import state as K
from riins_imu_fusion.compensation import Compensation
from riins_imu_fusion.config import KINDS, FusionConfig
from riins_imu_fusion.corrections import FUSION, IRFDC, RFDC
from riins_imu_fusion.drifts import Drifts
from riins_imu_fusion.judges import PARITY_TESTS
from riins_imu_fusion.noise_watch import NoiseWatch
from riins_imu_fusion.rfdc import Rfdc
from riins_imu_fusion.selection import Selection
from riins_imu_fusion.sequences import SEQUENTIAL_TESTS, Sequences, forget
from riins_imu_fusion.tables import TableCache

RECORD_S = 0.1
"""Length of a record of the past: how finely an onset is known."""
RECORDS_SPARE = 4
"""Records kept for each one in the window: changes of the sensors used end records early."""


class Methods:
    """What the loop is given besides the samples.

    Parameters
    ----------
    config : settings
    status_period_ns : 0: no ticks

    Attributes
    ----------
    selection : in force
    rules, cache : for the loop
    compensation, drifts, rfdc, watch : the filters of glr_kf, of opt, aopt and optdc, of rfdc and irfdc, the noise estimation
    window_ends : stamp at which the window of the noise estimation ends
    """

    def __init__(self, config: FusionConfig, status_period_ns: int) -> None:
        array, n, pfa = config.array(), config.array().n, config.pfa()
        record_s = max(RECORD_S, 1.0 / config.rate_hz)
        self._config = config
        self._records = RECORDS_SPARE * math.ceil(config.recall_window_s / record_s) + 1
        self._sequences = Sequences(config.sequence, n, config.rate_hz, 2.0 / pfa)
        self.compensation = Compensation(config)
        self.drifts = Drifts(config)
        self.rfdc = Rfdc(array, config.drift.rfdc, config.sigma(), config.rate_hz)
        self.watch = NoiseWatch(array, config.noise, config.sigma())
        self.cache = TableCache(array, self.watch.stated, config.total_sigma(), pfa, PARITY_TESTS[config.parity_test])
        self.rules = K.Rules(
            H=np.array(array.H),  # to be written: a copy of the pipeline must be of the same type for the compiler
            limit=config.limits(),
            group=np.array(config.groups or (-1,) * n, np.int64),
            grouped=bool(config.groups),
            fusion=0,
            test=0,
            sequential=0,
            threshold=np.zeros(max(2, n - 2)),
            judge_threshold=nis_threshold(pfa, 1),
            max_delay=round(config.max_delay_s * 1e9),
            lost_limit=math.ceil(config.max_delay_s * config.rate_hz) + 1,
            stuck=config.stuck_count,
            status_period=status_period_ns,
            doubt_time=round(config.health.probation_s * 1e9),
            period=1.0 / config.rate_hz,
            record=round(record_s * 1e9) if config.recall_window_s > 0.0 else 0,
            glr=self.compensation.rules,
            drift=self.drifts.numbers,
            noise=self.watch.window_ns > 0,
            moving=bool(config.motion_errors().any()),
            errors=config.motion_errors() ** 2,
        )
        self._select(Selection(config.method, config.parity_test, config.sequential_test, config.adapt_noise))

    def fresh(self) -> K.State:
        """Memory before the first sample."""
        self.window_ends = ALWAYS_NS if self.watch.window_ns else NEVER_NS
        sequence = self._sequences.fresh(self.rules.sequential)
        self.rfdc.fresh()
        state = K.fresh_state(self.rules.H.shape[0], self._records, self.compensation.fresh(), self.drifts.fresh(), sequence, self.watch.fresh())
        state.clock[K.NEXT_COMMAND] = ALWAYS_NS
        return state

    def restart(self) -> K.State:
        """`fresh`; the selection stays, the noise is as stated again."""
        self.watch.reset()
        self._select(self.selection)
        return self.fresh()

    def change(self, state: K.State, selection: Selection) -> K.State:
        """Go over to another selection; memory that it does not share begins anew."""
        before, noise = self.selection, self.cache.sigma
        self._select(selection)
        state = state._replace(sequence=self._sequences.fresh(self.rules.sequential))
        if selection.fusion != before.fusion:
            self.rfdc.fresh()
            return state._replace(drift=self.drifts.fresh(), glr=self.compensation.fresh())
        if self.cache.sigma is not noise:
            self.compensation.go_on(state.glr)
        return state

    def make(self, state: K.State) -> None:
        """Make what the loop lacks of a set of sensors."""
        kind, what, mask = int(state.need[0]), int(state.need[1]), int(state.need_key[0])
        if what == K.TABLE:
            self.cache.add(kind, mask)
        elif what == K.TEST:
            self.cache.add_test(kind, mask)
        else:
            bias = (self._config.gyro_bias_sigma, self._config.accel_bias_sigma)[kind]
            self._sequences.begin(state.sequence, self.rules.sequential, kind, self.cache.test(kind, mask), self.cache.white(kind, mask), bias)

    def other_set(self, state: K.State, kind: int, index: int, in_use: bool) -> None:
        """A sensor is in use from now on, or no longer: the filters go over to the other set."""
        self.compensation.go_over(kind, state.glr[kind])
        self.rfdc.begin(kind)
        if in_use:
            self.drifts.begin(state.drift, kind, index)
        else:
            self.drifts.forget(state.drift, kind)

    def compensate(self, state: K.State) -> None:
        """Say what rfdc or irfdc takes out of the sample at hand."""
        self.rfdc.step(state, self.cache.tables, self.rules.fusion == IRFDC)

    def warm_up(self) -> None:
        """Compile or load what the loop asks for."""
        self.compensation.warm_up()
        if self.rules.fusion >= RFDC:
            self.rfdc.warm_up()

    def end_window(self, state: K.State, stamp_ns: int) -> list[tuple[str, int, str]]:
        """End the window of the noise estimation if a sample of `stamp_ns` is beyond it; what is to be said: kind, sensor, text."""
        if stamp_ns < self.window_ends:
            return []
        begun = self.window_ends != ALWAYS_NS
        self.window_ends = self.watch.end(stamp_ns)
        if not begun:
            return []
        known = [dict(self.watch.loud(kind)) for kind in range(2)]
        changed = self.watch.close(state.noise, state.valid)
        said = [
            (name, index, f"{name}_{index}: noise is {times:.1f} times the stated")
            for kind, name in enumerate(KINDS)
            for index, times in self.watch.loud(kind)
            if index not in known[kind]
        ]
        if changed and self.selection.adapt_noise:
            self._select(self.selection)
            self.compensation.go_on(state.glr)
            for kind in range(2):
                forget(state.sequence, kind)
            said.append(("stream", -1, "thresholds and weights follow the noise as estimated"))
        return said

    def _select(self, selection: Selection) -> None:
        """Rules and tables of a selection, with the noise that it asks for."""
        config, self.selection = self._config, selection
        sigma = self.watch.sigma if selection.adapt_noise else self.watch.stated
        total = np.hypot(sigma, np.array([[config.gyro_bias_sigma], [config.accel_bias_sigma]]))
        sequential, test = SEQUENTIAL_TESTS[selection.sequential_test], PARITY_TESTS[selection.parity_test]
        pfa = config.pfa() * (0.5 if sequential else 1.0)
        if sigma is not self.cache.sigma:
            self.compensation.change_noise(sigma)
        self.cache.change(sigma, total, pfa, test)
        threshold = np.array([math.inf, *(glt_threshold(pfa, dof) for dof in range(1, max(2, self.rules.H.shape[0] - 2)))])
        self.rules = self.rules._replace(
            fusion=FUSION[selection.fusion], test=test, sequential=sequential, threshold=threshold, glr=self.compensation.rules
        )  # fmt: skip
