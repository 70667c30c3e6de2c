"""From raw redundant samples to body rate and specific force: fusion with fault detection, isolation and return.

Lives here: `FusionPipeline`, which drives the kernel, steps the health machine of each sensor, and reports.
Does not live here: the inner loop (kernel.py), tables (tables.py), ROS (node.py). Same results for any block size, bit for bit.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from riins_fdi.health import ALWAYS_NS, IN_USE, NEVER_NS, Change, HealthMachine, HealthState
from riins_fdi.parity import Capability
from riins_imu_fusion import state as K
from riins_imu_fusion.commanded import Commanded
from riins_imu_fusion.config import KINDS, FusionConfig
from riins_imu_fusion.drifts import removed
from riins_imu_fusion.glr_kf_state import CHANGED, LONG
from riins_imu_fusion.kernel import fuse_samples
from riins_imu_fusion.known_bias import Calibration
from riins_imu_fusion.recall import Recaller
from riins_imu_fusion.running import Methods
from riins_imu_fusion.samples import note_sequence
from riins_imu_fusion.selection import Selection
from riins_imu_fusion.sequences import forget
from riins_imu_fusion.status import Health, fused_block, health_of, triad_status
from riins_imu_fusion.types import REASON_WORDS, Counters, FdiEvent, FdiStatus, FusedBlock, Reason, Recall, TriadStatus

Array = NDArray[np.float64]


class FusionPipeline(Commanded):
    """Fusion of the healthy sensors by the method selected, tests that detect faults, and one health machine for each sensor.

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
        n = self.array.n
        super().__init__(n)
        self._statuses_wanted = statuses
        self._methods = Methods(config, round(config.status_period_s * 1e9) if statuses else 0)
        self._state = self._methods.fresh()
        self._recaller = Recaller(config, self.array, self._methods.cache)
        self._recalls: list[Recall] = []
        self._machines = [[HealthMachine(config.health, Reason.RECOVERED) for _ in range(n)] for _ in KINDS]
        self._health: list[Health | None] = [None, None]
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
            return fused_block(out, 0, ())
        k = o = 0
        while True:
            k, o, code = fuse_samples(k, o, block, out, self._methods.cache.tables, self._methods.rules, self._state)
            if code == K.DONE:
                recalls, self._recalls = tuple(self._recalls), []
                return fused_block(out, o, recalls)
            if code == K.NEED_TABLE:
                self._methods.make(self._state)
            elif code == K.NEED_DRIFT:
                self._methods.compensate(self._state)
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
            note_sequence(st.clock, st.counts, sequence, self._methods.rules.lost_limit)
        if not 0 <= stamp_ns - self._length_event_ns < 1_000_000_000:  # one event a second, whatever the rate
            self._length_event_ns = stamp_ns
            self._tell(stamp_ns, "stream", -1, None, Reason.NONE, f"rejected: {gyros} gyros and {accels} accelerometers instead of {self.n} each")

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
            calibrations_refused=self._calibrations_refused,
        )

    @property
    def last_stamp_ns(self) -> int | None:
        """Stamp of the last sample accepted; None before the first."""
        return int(self._state.clock[K.LAST]) if self._state.clock[K.HAVE] else None

    @property
    def drift(self) -> Array:
        """Drift removed from each sensor after the last sample, (kind, sensor) [rad/s, m/s^2]; weighted least squares removes none."""
        return np.stack([removed(kind, self._methods.rules.fusion, self._state) for kind in range(2)])

    def rate_covariance(self, mask: int) -> Array:
        """Covariance (3, 3) of the fused rate's white noise [(rad/s)^2], body FRD, when the gyros in `mask` are used."""
        return self._methods.cache.noise_covariance(0, int(mask))

    def force_covariance(self, mask: int) -> Array:
        """Covariance (3, 3) of the fused specific force's white noise [(m/s^2)^2], body FRD, when the accelerometers in `mask` are used."""
        return self._methods.cache.noise_covariance(1, int(mask))

    def warm_up(self) -> None:
        """Compile or load the kernel by fusing a sample of a throw-away pipeline; this one is not touched."""
        other = FusionPipeline(self.config, self._statuses_wanted)
        valid = [(1 << self.n) - 1]
        other.process([0], [0], np.zeros((1, self.n)), np.zeros((1, self.n)), valid, valid)
        other.reject_length(1, 1, 0, 0)
        self._methods.warm_up()

    def _after_sample(self, code: int) -> None:
        st = self._state
        t = int(st.clock[K.LAST])
        if code & K.EVENT:
            for kind, index in np.argwhere(st.wakes).tolist():
                self._step(kind, index, t)
            st.wakes[:] = False
            for kind, glr in enumerate(st.glr):
                self._methods.compensation.answer(kind, glr, self._methods.cache.tables, int(st.slot[kind]))
                if glr.ints[CHANGED]:
                    for index, change, note in self._methods.compensation.findings(kind, glr, self._machines[kind], t):
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
                self._methods.compensation.recalled(kind, st.glr[kind], index)
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
            test = self._methods.cache.test(kind, int(st.key[kind]))
            cause = "more than one pair of sensors explains it" if test.capability is Capability.ISOLATES else "these sensors detect only"
            self._tell(t, KINDS[kind], -1, None, Reason.PARITY, f"{KINDS[kind]} doubtful: a fault is seen but not isolated, {cause}")
        elif st.doubt[kind] and not unresolved and t - int(st.doubt_last[kind]) > self._methods.rules.doubt_time:
            st.doubt[kind] = 0
            self._tell(t, KINDS[kind], -1, None, Reason.RECOVERED, f"{KINDS[kind]} no longer doubtful")

    def _solved(self) -> bool:
        st, dof = self._state, self._methods.cache.tables.dof
        return bool(dof[0, st.slot[0]] >= 0 and dof[1, st.slot[1]] >= 0)

    def _tell_solution(self, t: int, solved: bool) -> None:
        if solved:
            self._tell(t, "stream", -1, None, Reason.RECOVERED, "solution again")
            return
        st = self._state
        lacking = [name for kind, name in enumerate(KINDS) if self._methods.cache.tables.dof[kind, st.slot[kind]] < 0]
        self._tell(t, "stream", -1, None, Reason.NONE, f"no solution: too few usable axes of {' and '.join(lacking)}")

    def _restart(self, stamp_ns: int) -> None:
        """A stamp jumped: begin anew; only the operator's exclusions stay."""
        jump = (stamp_ns - int(self._state.clock[K.LAST])) * 1e-9
        old, self._state = self._state, self._methods.restart()
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
                for index, death, note in self._methods.compensation.deaths(kind, glr, self._machines[kind], stamp_ns):
                    self._refresh(kind, index)
                    self._changed(kind, index, death, note)  # no recall: the filter has paid back what it put in
        for kind_name, index, text in self._methods.end_window(self._state, stamp_ns):
            self._tell(stamp_ns, kind_name, index, None, Reason.NONE, text)
        while (command := self._commands.take(stamp_ns)) is not None:
            if isinstance(command, Selection):
                self._change_method(command, stamp_ns)
                continue
            if isinstance(command, Calibration):
                self._methods.compensation.calibrate(command)
                continue
            machine = self._machines[command.kind][command.sensor]
            change = (machine.restore if command.use else machine.exclude)(stamp_ns, int(Reason.OPERATOR))
            self._refresh(command.kind, command.sensor)
            if change is not None:
                self._changed(command.kind, command.sensor, change)
        self._state.clock[K.NEXT_COMMAND] = min(self._commands.next_ns, self._methods.window_ends)

    def _change_method(self, selection: Selection, stamp_ns: int) -> None:
        before = self._methods.selection
        if selection == before:
            return
        self._state = self._methods.change(self._state, selection)
        if selection.fusion != before.fusion:  # the next one removes no drift yet
            for kind, machines in enumerate(self._machines):
                for index, machine in enumerate(machines):
                    if (change := machine.recover(stamp_ns)) is not None:
                        self._refresh(kind, index)
                        self._changed(kind, index, change)
        self._tell(stamp_ns, "command", -1, None, Reason.OPERATOR, f"method: {selection.text()}")

    def _tell(self, stamp_ns: int, kind: str, index: int, state: HealthState | None, reason: int, text: str) -> None:
        self._events.append(FdiEvent(stamp_ns, kind, index, state, int(reason), text))
        if self._statuses_wanted:
            self._text.append(text)
            self._state.clock[K.FORCE_STATUS] = 1

    def _refresh(self, kind: int, index: int) -> None:
        st, machine = self._state, self._machines[kind][index]
        self._health[kind] = None
        if st.base[kind, index] != machine.in_use:  # the filter goes over to the other set at the next sample
            self._methods.other_set(st, kind, index, machine.in_use)
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
        methods = self._methods
        bias = methods.compensation.known[kind].all(st.glr[kind])
        return triad_status(kind, st, health, methods.cache, removed(kind, methods.rules.fusion, st), bias, methods.watch.estimate[kind])
