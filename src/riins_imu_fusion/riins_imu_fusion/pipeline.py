"""From raw redundant samples to body rate and specific force: fusion with fault detection, isolation and return.

Lives here: `FusionPipeline`, which drives the kernel, steps the health machine of each sensor, and reports.
Does not live here: the inner loop (kernel.py), tables (tables.py), ROS (node.py). Same results for any block size, bit for bit.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from riins_fdi.health import ALWAYS_NS, IN_USE, NEVER_NS, Change, HealthMachine, HealthState
from riins_fdi.innovation import nis_threshold
from riins_fdi.parity import Capability, glt_threshold
from riins_imu_fusion import state as K
from riins_imu_fusion.compensation import Compensation
from riins_imu_fusion.config import KINDS, FusionConfig
from riins_imu_fusion.corrections import FUSION
from riins_imu_fusion.drifts import Drifts, removed
from riins_imu_fusion.glr_kf_state import CHANGED, LONG
from riins_imu_fusion.judges import PARITY_TESTS
from riins_imu_fusion.kernel import fuse_samples
from riins_imu_fusion.noise_watch import NoiseWatch
from riins_imu_fusion.recall import Recaller
from riins_imu_fusion.samples import note_sequence
from riins_imu_fusion.selection import Commands, Selection, UseSensor, refusal
from riins_imu_fusion.sequences import SEQUENTIAL_TESTS, Sequences, forget
from riins_imu_fusion.status import Health, health_of, triad_status
from riins_imu_fusion.tables import TableCache
from riins_imu_fusion.types import REASON_WORDS, CommandResult, Counters, FdiEvent, FdiStatus, FusedBlock, Reason, Recall, TriadStatus

Array = NDArray[np.float64]

RECORD_S = 0.1
"""Length of a record of the past: how finely an onset is known."""
RECORDS_SPARE = 4
"""Records kept for each one in the window: changes of the sensors used end records early."""


class FusionPipeline:
    """Weighted least squares over the healthy sensors, with GLT fault detection and one health machine for each sensor.

    Parameters
    ----------
    config : settings
    statuses : collect a status at every change and every `status_period_s` of measurement time, for `drain_statuses`

    Notes
    -----
    A sample whose test exceeds the threshold is fused without the sensor that explains it; persistence isolates that sensor, and it returns
    through a hold and a probation in which its residual against the sensors in use is tested. A missing, stuck or saturated axis is left
    out at once and goes the same way. With four sensors in use a fault is detected and stays in; the status is then doubtful. What a sensor
    has put in from the estimated onset of its fault until its isolation is said in `FusedBlock.recalls`, for those who integrate.
    """

    def __init__(self, config: FusionConfig, statuses: bool = False) -> None:
        self.config = config
        self.array = config.array()
        self.n = n = self.array.n
        pfa = config.pfa()
        self._selection = Selection(config.method, config.parity_test, config.sequential_test, config.adapt_noise)
        self._cache = TableCache(self.array, config.sigma(), config.total_sigma(), pfa, PARITY_TESTS[config.parity_test])
        self._statuses_wanted = statuses
        self._compensation = Compensation(config)
        self._drifts = Drifts(config)
        self._sequences = Sequences(config.sequence, n, config.rate_hz, 2.0 / pfa)
        self._watch = NoiseWatch(self.array, config.noise, config.sigma())
        max_delay = round(config.max_delay_s * 1e9)
        record_s = max(RECORD_S, 1.0 / config.rate_hz)
        self._records = RECORDS_SPARE * math.ceil(config.recall_window_s / record_s) + 1
        self._rules = K.Rules(
            H=np.ascontiguousarray(self.array.H),
            limit=config.limits(),
            group=np.array(config.groups or (-1,) * n, np.int64),
            grouped=bool(config.groups),
            fusion=0,
            test=0,
            sequential=0,
            threshold=np.zeros(max(2, n - 2)),
            judge_threshold=nis_threshold(pfa, 1),
            max_delay=max_delay,
            lost_limit=math.ceil(config.max_delay_s * config.rate_hz) + 1,
            stuck=config.stuck_count,
            status_period=round(config.status_period_s * 1e9) if statuses else 0,
            doubt_time=round(config.health.probation_s * 1e9),
            period=1.0 / config.rate_hz,
            record=round(record_s * 1e9) if config.recall_window_s > 0.0 else 0,
            glr=self._compensation.rules,
            drift=self._drifts.numbers,
            noise=self._watch.window_ns > 0,
        )
        self._select(self._selection)
        self._state = self._fresh()
        self._recaller = Recaller(config, self.array, self._cache)
        self._recalls: list[Recall] = []
        self._machines = [[HealthMachine(config.health, Reason.RECOVERED) for _ in range(n)] for _ in KINDS]
        self._health: list[Health | None] = [None, None]
        self._commands = Commands()
        self._commands_refused = 0
        self._events: list[FdiEvent] = []
        self._statuses: list[FdiStatus] = []
        self._text: list[str] = []
        self._length_event_ns = ALWAYS_NS
        self._refresh_all()

    def process(
        self,
        stamp_ns: ArrayLike,
        sequence: ArrayLike,
        gyro: ArrayLike,
        accel: ArrayLike,
        gyro_valid: ArrayLike,
        accel_valid: ArrayLike,
    ) -> FusedBlock:
        """Fuse m samples.

        Parameters
        ----------
        stamp_ns : (m,), end of each averaging interval
        sequence : (m,), sample numbers, modulo 2^32
        gyro, accel : (m, n), rad/s and m/s^2 along the sensing axes; anything but n columns is rejected and counted
        gyro_valid, accel_valid : (m,), bit i set: sensor i reports itself valid

        Returns
        -------
        FusedBlock of the samples that were fused

        Raises
        ------
        ValueError
            The arrays have different numbers of samples.
        """
        block = K.Block(
            np.ascontiguousarray(stamp_ns, np.int64),
            np.ascontiguousarray(sequence, np.uint32),
            np.ascontiguousarray(gyro, np.float64),
            np.ascontiguousarray(accel, np.float64),
            np.ascontiguousarray(gyro_valid, np.uint64),
            np.ascontiguousarray(accel_valid, np.uint64),
        )
        m = block.stamp.size
        if any(a.shape[0] != m for a in block) or block.gyro.ndim != 2 or block.accel.ndim != 2:
            raise ValueError(f"the arrays of a block must have one row for each sample: {[a.shape for a in block]}")
        out = K.room(m, self.n)
        if block.gyro.shape[1] != self.n or block.accel.shape[1] != self.n:
            for t, s in zip(block.stamp.tolist(), block.sequence.tolist(), strict=True):
                self.reject_length(t, s, block.gyro.shape[1], block.accel.shape[1])
            return _fused(out, 0, ())
        k = o = 0
        while True:
            k, o, code = fuse_samples(k, o, block, out, self._cache.tables, self._rules, self._state)
            if code == K.DONE:
                recalls, self._recalls = tuple(self._recalls), []
                return _fused(out, o, recalls)
            if code == K.NEED_TABLE:
                self._make()
            elif code == K.RESTART:
                self._restart(int(block.stamp[k]))
            elif code == K.COMMAND:
                self._obey(int(block.stamp[k]))
            else:
                self._after_sample(code)

    def reject_length(self, stamp_ns: int, sequence: int, gyros: int, accels: int) -> None:
        """Count a sample with the wrong number of axes; its sequence number is not lost."""
        st = self._state
        st.counts[K.RECEIVED] += 1
        st.counts[K.REJECTED_LENGTH] += 1
        if st.clock[K.HAVE]:
            note_sequence(st.clock, st.counts, sequence, self._rules.lost_limit)
        if not 0 <= stamp_ns - self._length_event_ns < 1_000_000_000:  # one event a second, whatever the rate
            self._length_event_ns = stamp_ns
            self._tell(stamp_ns, "stream", -1, None, Reason.NONE, f"rejected: {gyros} gyros and {accels} accelerometers instead of {self.n} each")

    def set_sensor_use(self, target: str, use: bool, effective_ns: int = 0) -> CommandResult:
        """Exclude a sensor on the operator's word, or let it return through probation.

        Parameters
        ----------
        target : gyro_0, accel_5, ...
        use : False: exclude; True: restore
        effective_ns : holds from the first sample with this stamp or a later one; 0: from the next sample on

        Returns
        -------
        CommandResult; refused and counted for an unknown target or a stamp that has passed
        """
        kind_name, _, number = target.rpartition("_")
        if kind_name not in KINDS or not number.isdigit() or int(number) >= self.n:
            return self._refuse(f'no sensor "{target}": gyro_0 .. gyro_{self.n - 1}, accel_0 .. accel_{self.n - 1}')
        effective_ns, when = self._due(effective_ns)
        if when.startswith("passed"):
            return self._refuse(f"{target}: the effective stamp {when}")
        self._put(effective_ns, UseSensor(KINDS.index(kind_name), int(number), use))
        return CommandResult(True, effective_ns, f"{target}: {'probation' if use else 'excluded'} from {when} on")

    def set_method(
        self, fusion: str = "", parity_test: str = "", sequential_test: str = "", adapt_noise: bool = False, effective_ns: int = 0
    ) -> CommandResult:  # fmt: skip
        """Fuse and judge with other methods.

        Parameters
        ----------
        fusion, parity_test, sequential_test : names as in `FusionConfig`; empty: stays
        adapt_noise : the noise estimated while running is used
        effective_ns : holds from the first sample with this stamp or a later one; 0: from the next sample on

        Returns
        -------
        CommandResult; refused and counted for an unknown name or a stamp that has passed. `selected` says what will hold
        """
        if problem := refusal(fusion, parity_test, sequential_test):
            return self._refuse(problem)
        effective_ns, when = self._due(effective_ns)
        if when.startswith("passed"):
            return self._refuse(f"method: the effective stamp {when}")
        now = self.selected(effective_ns)
        chosen = Selection(fusion or now.fusion, parity_test or now.parity_test, sequential_test or now.sequential_test, adapt_noise)
        self._put(effective_ns, chosen)
        return CommandResult(True, effective_ns, f"{chosen.text()} from {when} on")

    def selected(self, effective_ns: int | None = None) -> Selection:
        """Methods in force, or those that will be at a stamp as far as they have been commanded."""
        return self._selection if effective_ns is None else self._commands.selection(effective_ns, self._selection)

    def status(self) -> FdiStatus:
        """State after the last sample."""
        return self._status("")

    def drain_statuses(self) -> list[FdiStatus]:
        """Periodic statuses and those of changes since the last call, in order."""
        drained, self._statuses = self._statuses, []
        return drained

    def drain_events(self) -> list[FdiEvent]:
        """Events since the last call, in order."""
        drained, self._events = self._events, []
        return drained

    @property
    def counters(self) -> Counters:
        """Samples received, and what became of them."""
        c = self._state.counts.tolist()
        return Counters(
            received=c[K.RECEIVED],
            fused=c[K.FUSED],
            lost=c[K.LOST],
            rejected_length=c[K.REJECTED_LENGTH],
            rejected_stamp=c[K.REJECTED_STAMP],
            rejected_no_solution=c[K.REJECTED_NO_SOLUTION],
            restarts=c[K.RESTARTS],
            commands_refused=self._commands_refused,
        )

    @property
    def last_stamp_ns(self) -> int | None:
        """Stamp of the last sample accepted; None before the first."""
        return int(self._state.clock[K.LAST]) if self._state.clock[K.HAVE] else None

    @property
    def drift(self) -> Array:
        """Drift removed from each sensor after the last sample, (kind, sensor) [rad/s, m/s^2]; weighted least squares removes none."""
        return np.stack([removed(kind, self._rules.fusion, self._state) for kind in range(2)])

    def rate_covariance(self, mask: int) -> Array:
        """Covariance (3, 3) of the fused rate's white noise [(rad/s)^2], body FRD, when the gyros in `mask` are used."""
        return self._cache.noise_covariance(0, int(mask))

    def force_covariance(self, mask: int) -> Array:
        """Covariance (3, 3) of the fused specific force's white noise [(m/s^2)^2], body FRD, when the accelerometers in `mask` are used."""
        return self._cache.noise_covariance(1, int(mask))

    def warm_up(self) -> None:
        """Compile or load the kernel by fusing a sample of a throw-away pipeline; this one is not touched."""
        other = FusionPipeline(self.config, self._statuses_wanted)
        valid = [(1 << self.n) - 1]
        other.process([0], [0], np.zeros((1, self.n)), np.zeros((1, self.n)), valid, valid)
        other.reject_length(1, 1, 0, 0)
        self._compensation.warm_up()

    def _after_sample(self, code: int) -> None:
        st = self._state
        t = int(st.clock[K.LAST])
        if code & K.EVENT:
            for kind, index in np.argwhere(st.wakes).tolist():
                self._step(kind, index, t)
            st.wakes[:] = False
            for kind, glr in enumerate(st.glr):
                self._compensation.answer(kind, glr, self._cache.tables, int(st.slot[kind]))
                if glr.ints[CHANGED]:
                    for index, change, note in self._compensation.findings(kind, glr, self._machines[kind], t):
                        self._refresh(kind, index)
                        self._changed(kind, index, change, note)
                        forget(st.sequence, kind)
                    st.clock[K.NEXT_COMMAND] = t + 1  # the dead leave before the next sample
            solved = int(self._solved())
            if solved != int(st.clock[K.SOLUTION]):
                st.clock[K.SOLUTION] = solved
                self._tell_solution(t, bool(solved))
            for kind in range(2):
                self._step_doubt(kind, t)
        if self._statuses_wanted and (code & K.TICK or self._text):
            self._statuses.append(self._status("; ".join(self._text)))
            self._text.clear()
            st.clock[K.FORCE_STATUS] = 0

    def _step(self, kind: int, index: int, t: int) -> None:
        st, machine = self._state, self._machines[kind][index]
        good = int(st.verdict[kind, index]) == K.GOOD
        reason = int(st.why[kind, index])
        note = ""
        if good and machine.state is HealthState.PROBATION and machine.wakes_at_ns()[0] > ALWAYS_NS and st.mean_count[kind, index]:
            mean = float(st.mean_sum[kind, index] / st.mean_count[kind, index])
            if abs(mean) > self.config.probation_mean_limit:
                good, reason, note = False, int(Reason.PARITY), f", mean residual {mean:+.2f} sigma"
        change = machine.step(t, good, reason)
        self._refresh(kind, index)
        if change is None:
            return
        if change.state is HealthState.ISOLATED and change.previous in IN_USE and reason in (Reason.PARITY, Reason.STUCK):
            stuck = int(st.repeat[kind, index]) if reason == Reason.STUCK else 0
            recall = self._recaller.recall(st.past, kind, index, t, stuck)  # other bad values never entered
            if recall is not None:
                self._recalls.append(recall)
                self._compensation.recalled(kind, st.glr[kind], index)
                note = f", {recall.text()}"
        self._changed(kind, index, change, note)

    def _changed(self, kind: int, index: int, change: Change, note: str = "") -> None:
        if change.state is HealthState.PROBATION:
            self._state.mean_sum[kind, index] = 0.0
            self._state.mean_count[kind, index] = 0
        why = f" ({REASON_WORDS[Reason(change.reason)]}{note})" if change.reason else ""
        text = f"{KINDS[kind]}_{index} {change.previous.name.lower()} -> {change.state.name.lower()}{why}"
        self._tell(change.stamp_ns, KINDS[kind], index, change.state, change.reason, text)

    def _step_doubt(self, kind: int, t: int) -> None:
        st = self._state
        unresolved = int(st.alarm[kind]) == K.UNRESOLVED or bool(st.glr[kind].ints[LONG])
        if unresolved and not st.doubt[kind]:
            st.doubt[kind] = 1
            test = self._cache.test(kind, int(st.key[kind]))
            cause = "more than one pair of sensors explains it" if test.capability is Capability.ISOLATES else "these sensors detect only"
            self._tell(t, KINDS[kind], -1, None, Reason.PARITY, f"{KINDS[kind]} doubtful: a fault is seen but not isolated, {cause}")
        elif st.doubt[kind] and not unresolved and t - int(st.doubt_last[kind]) > self._rules.doubt_time:
            st.doubt[kind] = 0
            self._tell(t, KINDS[kind], -1, None, Reason.RECOVERED, f"{KINDS[kind]} no longer doubtful")

    def _solved(self) -> bool:
        st, dof = self._state, self._cache.tables.dof
        return bool(dof[0, st.slot[0]] >= 0 and dof[1, st.slot[1]] >= 0)

    def _tell_solution(self, t: int, solved: bool) -> None:
        if solved:
            self._tell(t, "stream", -1, None, Reason.RECOVERED, "solution again")
            return
        st = self._state
        lacking = [name for kind, name in enumerate(KINDS) if self._cache.tables.dof[kind, st.slot[kind]] < 0]
        self._tell(t, "stream", -1, None, Reason.NONE, f"no solution: too few usable axes of {' and '.join(lacking)}")

    def _restart(self, stamp_ns: int) -> None:
        """A stamp jumped: begin anew; only the operator's exclusions stay."""
        jump = (stamp_ns - int(self._state.clock[K.LAST])) * 1e-9
        self._watch.reset()
        self._select(self._selection)  # the noise is as stated again
        old, self._state = self._state, self._fresh()
        self._recaller.reset()
        self._state.counts[:] = old.counts
        self._state.counts[K.RESTARTS] += 1
        self._state.left_out[:] = old.left_out
        for machine in (m for triad in self._machines for m in triad):
            machine.reset()
        self._refresh_all()
        self._tell(stamp_ns, "restart", -1, None, Reason.NONE, f"restart: the stamp jumped by {jump:+.3f} s")

    def _obey(self, stamp_ns: int) -> None:
        """Carry out the commands whose time has come, and isolate what the filters have found dead."""
        for kind, glr in enumerate(self._state.glr):
            if glr.ints[CHANGED]:
                for index, death, note in self._compensation.deaths(kind, glr, self._machines[kind], stamp_ns):
                    self._refresh(kind, index)
                    self._changed(kind, index, death, note)  # no recall: the filter has paid back what it put in
        if self._watch.window_ns and stamp_ns >= self._window_ends:
            self._end_window(stamp_ns)
        while (command := self._commands.take(stamp_ns)) is not None:
            if isinstance(command, Selection):
                self._change_method(command, stamp_ns)
                continue
            machine = self._machines[command.kind][command.sensor]
            change = (machine.restore if command.use else machine.exclude)(stamp_ns, int(Reason.OPERATOR))
            self._refresh(command.kind, command.sensor)
            if change is not None:
                self._changed(command.kind, command.sensor, change)
        self._plan()

    def _plan(self) -> None:
        """Stamp at which the loop must come back before it goes on."""
        due = self._commands.next_ns
        self._state.clock[K.NEXT_COMMAND] = min(due, self._window_ends) if self._watch.window_ns else due

    def _fresh(self) -> K.State:
        """Memory before the first sample."""
        self._window_ends = ALWAYS_NS
        sequence = self._sequences.fresh(self._rules.sequential)
        state = K.fresh_state(self.n, self._records, self._compensation.fresh(), self._drifts.fresh(), sequence, self._watch.fresh())
        state.clock[K.NEXT_COMMAND] = ALWAYS_NS
        return state

    def _select(self, selection: Selection) -> None:
        """Rules and tables of a selection with the noise that it asks for."""
        sigma, total = self.config.sigma(), self.config.total_sigma()
        if selection.adapt_noise:
            sigma = self._watch.sigma
            total = np.hypot(sigma, np.array([[self.config.gyro_bias_sigma], [self.config.accel_bias_sigma]]))
        self._selection = selection
        sequential, test = SEQUENTIAL_TESTS[selection.sequential_test], PARITY_TESTS[selection.parity_test]
        pfa = self.config.pfa() * (0.5 if sequential else 1.0)
        self._cache.change(sigma, total, pfa, test)
        threshold = np.array([math.inf, *(glt_threshold(pfa, dof) for dof in range(1, max(2, self.n - 2)))])
        self._rules = self._rules._replace(fusion=FUSION[selection.fusion], test=test, sequential=sequential, threshold=threshold)

    def _change_method(self, selection: Selection, stamp_ns: int) -> None:
        before = self._selection
        self._select(selection)
        state = self._state._replace(sequence=self._sequences.fresh(self._rules.sequential))
        if selection.fusion != before.fusion:
            state = state._replace(drift=self._drifts.fresh(), glr=self._compensation.fresh())
            for kind, machines in enumerate(self._machines):
                for index, machine in enumerate(machines):
                    if (change := machine.recover(stamp_ns)) is not None:  # the next method removes no drift yet
                        self._refresh(kind, index)
                        self._changed(kind, index, change)
        self._state = state
        self._tell(stamp_ns, "command", -1, None, Reason.OPERATOR, f"method: {selection.text()}")

    def _end_window(self, stamp_ns: int) -> None:
        """The window of the noise estimation is over, or there was none yet."""
        begun = self._window_ends != ALWAYS_NS
        self._window_ends = self._watch.end(stamp_ns)
        if not begun:
            return
        known = [dict(self._watch.loud(kind)) for kind in range(2)]
        changed = self._watch.close(self._state.noise, self._state.valid)
        for kind, name in enumerate(KINDS):
            for index, times in self._watch.loud(kind):
                if index not in known[kind]:
                    self._tell(stamp_ns, name, index, None, Reason.NONE, f"{name}_{index}: noise is {times:.1f} times the stated")
        if changed and self._selection.adapt_noise:
            self._select(self._selection)
            for kind in range(2):
                forget(self._state.sequence, kind)
            self._tell(stamp_ns, "stream", -1, None, Reason.NONE, "thresholds and weights follow the noise as estimated")

    def _make(self) -> None:
        """Make what the loop lacks of a set of sensors."""
        st = self._state
        kind, what, mask = int(st.need[0]), int(st.need[1]), int(st.need_key[0])
        if what == K.TABLE:
            self._cache.add(kind, mask)
        elif what == K.TEST:
            self._cache.add_test(kind, mask)
        else:
            bias = (self.config.gyro_bias_sigma, self.config.accel_bias_sigma)[kind]
            test = self._cache.test(kind, mask)
            self._sequences.begin(st.sequence, self._rules.sequential, kind, test, self._cache.white(kind, mask), bias)

    def _due(self, effective_ns: int) -> tuple[int, str]:
        """Stamp from which a command holds, and in words; the words begin with "passed" when that time has."""
        last = self.last_stamp_ns
        if effective_ns == 0:
            return (ALWAYS_NS if last is None else last + 1), "the next sample"
        if last is not None and effective_ns <= last:
            return effective_ns, f"passed {(last - effective_ns) * 1e-9:.3f} s ago"
        return effective_ns, "the next sample" if effective_ns == (last or 0) + 1 else f"{effective_ns * 1e-9:.3f} s"

    def _put(self, effective_ns: int, command: UseSensor | Selection) -> None:
        self._commands.put(effective_ns, command)
        self._state.clock[K.NEXT_COMMAND] = min(int(self._state.clock[K.NEXT_COMMAND]), effective_ns)

    def _refuse(self, message: str) -> CommandResult:
        self._commands_refused += 1
        stamp = self.last_stamp_ns or 0
        self._tell(stamp, "command", -1, None, Reason.OPERATOR, f"refused: {message}")
        return CommandResult(False, 0, message)

    def _tell(self, stamp_ns: int, kind: str, index: int, state: HealthState | None, reason: int, text: str) -> None:
        self._events.append(FdiEvent(stamp_ns, kind, index, state, int(reason), text))
        if self._statuses_wanted:
            self._text.append(text)
            self._state.clock[K.FORCE_STATUS] = 1

    def _refresh(self, kind: int, index: int) -> None:
        st, machine = self._state, self._machines[kind][index]
        self._health[kind] = None
        if st.base[kind, index] != machine.in_use:  # the filter goes over to the other set at the next sample
            self._compensation.go_over(kind, st.glr[kind])
            if machine.in_use:
                self._drifts.begin(st.drift, kind, index)
        st.base[kind, index] = machine.in_use
        st.judged[kind, index] = machine.state in (HealthState.ISOLATED, HealthState.PROBATION)
        st.wake[:, kind, index] = machine.wakes_at_ns()
        calm = not st.judged[kind].any() and bool(np.all(st.wake[0, kind] == NEVER_NS))
        st.calm[kind] = np.uint64(sum(1 << int(i) for i in np.flatnonzero(st.base[kind])) if calm else 0)

    def _refresh_all(self) -> None:
        for kind in range(2):
            for index in range(self.n):
                self._refresh(kind, index)

    def _status(self, text: str) -> FdiStatus:
        return FdiStatus(int(self._state.clock[K.LAST]), self._triad(0), self._triad(1), self.counters, text)

    def _triad(self, kind: int) -> TriadStatus:
        st, health = self._state, self._health[kind]
        if health is None:
            health = self._health[kind] = health_of(self._machines[kind])
        return triad_status(kind, st, health, self._cache, removed(kind, self._rules.fusion, st), self._watch.estimate[kind])


def _fused(out: K.Output, m: int, recalls: tuple[Recall, ...]) -> FusedBlock:
    (rate, force), (gyro_used, accel_used), (gyro_statistic, accel_statistic) = out.fused[:, :m], out.used[:, :m], out.statistic[:, :m]
    columns = (out.stamp[:m], out.sequence[:m], rate, force, gyro_used, accel_used, gyro_statistic, accel_statistic)
    (gyro_drift, accel_drift), (gyro_excess, accel_excess) = out.drift[:, :m], out.excess[:, :m]
    return FusedBlock(*columns, gyro_drift, accel_drift, gyro_excess, accel_excess, recalls)
