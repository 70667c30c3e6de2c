"""The compiled inner loop of the fusion: one sample after the other until something happens that Python decides.

Lives here: the order of what is done with a sample, and which set of sensors is tested and fused.
Does not live here: its arrays (state.py), its steps (samples.py, judges.py, corrections.py), health machines, tables, events (pipeline.py).
No result depends on where a block ends.
"""

from __future__ import annotations

import numpy as np

from riins_core.jit import inner, jit
from riins_fdi.motion import errors_of, rows_in_motion, white_in_motion
from riins_fdi.parity import parity_vector
from riins_imu_fusion.corrections import GLR_KF, OPT, RFDC, add_excess, follow, known, learn, take_out
from riins_imu_fusion.glr_kf_kernel import add_only
from riins_imu_fusion.glr_kf_state import ACTIVE, LONG
from riins_imu_fusion.judges import DIRECT, GLT, SVD, blame_unit, compare, explain_parity, largest, quadratic, resolve
from riins_imu_fusion.noise_watch import OF, RUN, gather
from riins_imu_fusion.samples import check_axes, judge_out, judge_used, note_past, note_sequence, remember, wake_up
from riins_imu_fusion.sequences import NONE as NO_SEQUENCE
from riins_imu_fusion.sequences import feed, move

# isort: off
from riins_imu_fusion.state import (
    COMMAND, COMPENSATED, DONE, EVENT, FORCE_STATUS, FUSED, HAVE, LAST, NEED_DRIFT, NEED_TABLE, NEXT_COMMAND, QUIET, RECEIVED, REJECTED_NO_SOLUTION,
    REJECTED_STAMP, RESOLVED, RESTART, SEQUENCE, SEQUENCES, SOLUTION, TABLE, TEST, TICK, UNRESOLVED, B, Block, I, Output, Rules, State, Tables, U,
)  # fmt: skip
# isort: on


@inner
def find_slot(kind: int, key: U, count: I, wanted: np.uint64, hint: int) -> int:
    """Slot of a set of sensors, -1: not made yet."""
    if hint < count[kind] and key[kind, hint] == wanted:
        return hint
    for s in range(count[kind]):
        if key[kind, s] == wanted:
            return s
    return -1


@inner
def without(key: np.uint64, first: int, second: int) -> np.uint64:
    """Set of sensors with two taken out (-1: none)."""
    if first >= 0:
        key &= ~(np.uint64(1) << np.uint64(first))
    if second >= 0:
        key &= ~(np.uint64(1) << np.uint64(second))
    return key


@inner
def unit(group: I, number: int) -> np.uint64:
    """Sensors of a unit."""
    key = np.uint64(0)
    for i in range(group.shape[0]):
        if group[i] == number:
            key |= np.uint64(1) << np.uint64(i)
    return key


@inner
def in_use(kind: int, base: B) -> np.uint64:
    """Sensors that their health machines let be used."""
    key = np.uint64(0)
    for i in range(base.shape[1]):
        if base[kind, i]:
            key |= np.uint64(1) << np.uint64(i)
    return key


@inner
def need(st: State, kind: int, what: int, key: np.uint64) -> int:
    """Say what of a set of sensors is missing before the sample can be worked in."""
    st.need[0] = kind
    st.need[1] = what
    st.need_key[0] = key
    return NEED_TABLE


@jit
def fuse_samples(k: int, o: int, block: Block, output: Output, tb: Tables, rules: Rules, st: State) -> tuple[int, int, int]:
    """Fuse samples from number k on, writing from place o on, until the block ends or Python is needed.

    Returns
    -------
    k : next sample to give
    o : next place to write
    code : DONE; EVENT and TICK (bits, the sample before k is finished); RESTART, COMMAND, NEED_TABLE (sample k is not begun);
        NEED_DRIFT (it is tested, and its drifts are wanted)
    """
    clock, counts = st.clock, st.counts
    value, repeat, base, wake, calm = st.value, st.repeat, st.base, st.wake, st.calm
    z, why, x, key, slot, used, used_slot = st.z, st.why, st.x, st.key, st.slot, st.used, st.used_slot
    statistic, alarm, leave, pointed, doubt, doubt_last = st.statistic, st.alarm, st.leave, st.suspect, st.doubt, st.doubt_last
    verdict, wakes = st.verdict, st.wakes
    dofs, w, tested, clean = tb.dof, tb.W, st.tested, st.clean
    period, n = rules.status_period, st.z.shape[1]
    grid, nominal = rules.record, rules.period
    place_past, end, last, span, used_past, total = st.past.place, st.past.end, st.past.last, st.past.span, st.past.used, st.past.sum
    while k < block.stamp.shape[0]:
        t = block.stamp[k]
        if clock[HAVE] == 1:
            step = t - clock[LAST]
            if step > rules.max_delay or step < -rules.max_delay:
                return k, o, RESTART
            if step <= 0:
                counts[RECEIVED] += 1
                counts[REJECTED_STAMP] += 1
                note_sequence(clock, counts, int(block.sequence[k]), rules.lost_limit)
                k += 1
                continue
        if t >= clock[NEXT_COMMAND]:
            return k, o, COMMAND

        key[0] = check_axes(0, k, block.gyro, block.gyro_valid, rules.limit, rules.stuck, value, repeat, base, z, why, st.valid)
        key[1] = check_axes(1, k, block.accel, block.accel_valid, rules.limit, rules.stuck, value, repeat, base, z, why, st.valid)
        solved = True
        for kind in range(2):
            place = find_slot(kind, tb.key, tb.filled, key[kind], slot[kind])
            if place < 0:
                return k, o, need(st, kind, TABLE, key[kind])
            slot[kind] = place
            used[kind] = key[kind]
            used_slot[kind] = place
            alarm[kind] = QUIET
            pointed[kind] = -1
            leave[kind] = 0
            statistic[kind] = np.nan
            dof = dofs[kind, place]
            solved &= dof >= 0
            known(kind, st.glr[kind].ints, st.glr[kind].vec, z, tested)
            if dof < 1:
                continue
            if rules.test == GLT or rules.test == SVD:
                statistic[kind] = quadratic(kind, place, dof, tb.whitened, tested)
                loud = statistic[kind] > rules.threshold[dof]
            else:
                if tb.level[kind, place] < 0.0:
                    return k, o, need(st, kind, TEST, key[kind])
                statistic[kind] = largest(tb.rows[kind, place], tested[kind])
                loud = statistic[kind] > tb.level[kind, place]
            unit_found = -1
            if loud:
                white, gain, rows = tb.whitened[kind, place], tb.gain[kind, place], tb.rows[kind, place]
                pick = tb.pick[kind, place]
                if rules.moving:  # with the errors that grow with the motion the statistic is never larger: a quiet sample needs none of this
                    D = np.empty(n)
                    errors_of(rules.H, w[kind, place], tested[kind], rules.errors[kind], D)
                    white, gain = white_in_motion(dof, white, gain, D)
                    if rules.test == GLT or rules.test == SVD:
                        statistic[kind] = parity_vector(white, dof, tested[kind], np.empty(dof))
                        loud = statistic[kind] > rules.threshold[dof]
                    else:
                        rows = rows_in_motion(rows, D)
                        statistic[kind] = largest(rows, tested[kind])
                        loud = statistic[kind] > tb.level[kind, place]
                    if rules.test != SVD:
                        pick = gain
            if loud:
                alarm[kind], i, j, pointed[kind] = (
                    compare(rows, tb.members[kind, place], tb.level[kind, place], dof, white, gain, tb.isolable[kind, place], tested[kind])
                    if rules.test == DIRECT
                    else resolve(dof, white, gain, pick, tb.isolable[kind, place], tested[kind], rules.threshold)
                )
                if rules.grouped and (j >= 0 or alarm[kind] == UNRESOLVED):
                    unit_found = blame_unit(dof, white, tested[kind], rules.group, rules.threshold)
            elif rules.sequential == NO_SEQUENCE:
                continue
            else:
                if key[kind] != st.sequence.key[kind]:
                    if key[kind] != in_use(kind, base):
                        continue  # an axis is missing for the moment
                    return k, o, need(st, kind, SEQUENCES, key[kind])
                if rules.moving:
                    move(kind, t, rules.sequential, rules.H, w[kind, place], rules.errors[kind], tb.V[kind, place], dof, tested[kind], st.sequence)
                if not feed(kind, t, rules.sequential, tb.V[kind, place], dof, tested[kind], st.sequence):
                    continue
                alarm[kind], i, j, pointed[kind] = explain_parity(
                    dof, st.sequence.p[kind], tb.V[kind, place], tb.isolable[kind, place], rules.threshold
                )
            rest = without(key[kind], i, j)
            if unit_found >= 0:
                alarm[kind] = RESOLVED
                rest = key[kind] & ~unit(rules.group, unit_found)
            if rest == key[kind]:
                continue
            place = find_slot(kind, tb.key, tb.filled, rest, 0)
            if place < 0:
                return k, o, need(st, kind, TABLE, rest)
            if dofs[kind, place] < 0:  # they are needed for a solution: keep all, in doubt
                alarm[kind] = UNRESOLVED
                continue
            leave[kind] = key[kind] & ~rest
            used[kind] = rest
            used_slot[kind] = place

        if solved and rules.fusion >= RFDC and clock[COMPENSATED] != t:
            clock[COMPENSATED] = t
            return k, o, NEED_DRIFT
        # from here on the sample is worked in, once
        code = DONE
        counts[RECEIVED] += 1
        if solved:
            for kind in range(2):
                place = used_slot[kind]
                for i in range(n):
                    clean[kind, i] = z[kind, i]
                    output.drift[kind, o, i] = 0.0
                for a in range(9):
                    output.excess[kind, o, a // 3, a % 3] = tb.extra[kind, place, a // 3, a % 3]
                if rules.fusion >= RFDC:
                    take_out(kind, tb.member[kind, place], st.drift, z, clean, output.drift[kind, o], output.excess[kind, o])
                elif rules.fusion >= OPT:
                    first = slot[kind]
                    follow(
                        kind, rules.fusion, alarm[kind], dofs[kind, first], tb.V[kind, first], tb.member[kind, place], w[kind, place], z,
                        rules.drift, st.drift, clean, output.drift[kind, o], output.excess[kind, o],
                    )  # fmt: skip
                elif rules.fusion == GLR_KF:
                    glr, first = st.glr[kind], slot[kind]  # the filter learns only where nobody was left out: then both slots are one
                    simple = alarm[kind] == QUIET and dofs[kind, first] > 0
                    if simple and add_only(
                        z[kind], tb.member[kind, first], rules.glr[kind].batch, rules.glr[kind].moving, glr.V, glr.W, glr.ints, glr.vec, glr.par
                    ):  # fmt: skip
                        pass
                    elif learn(
                        kind, alarm[kind], dofs[kind, first], tb.member[kind, first], z, glr, rules.glr[kind], clean,
                        output.drift[kind, o],
                    ):  # fmt: skip
                        code |= EVENT
                    if glr.ints[ACTIVE] == 1:
                        add_excess(glr, rules.glr[kind], w[kind, place], output.excess[kind, o])
                    if glr.ints[LONG] == 1:
                        doubt_last[kind] = t
                        if doubt[kind] == 0:
                            code |= EVENT
                for a in range(3):
                    s = 0.0
                    for i in range(n):
                        s += w[kind, place, a, i] * clean[kind, i]
                    x[kind, a] = s
                    output.fused[kind, o, a] = s
                output.used[kind, o] = used[kind]
                output.statistic[kind, o] = statistic[kind]
                if alarm[kind] != QUIET or used[kind] != calm[kind]:  # else all in use are healthy, nobody is out on trial, and all is well
                    judge_used(kind, alarm[kind], leave, base, why, st.left_out, verdict)
                    if alarm[kind] != UNRESOLVED:
                        judge_out(kind, place, t, rules, st.judged, wake, z, x, w[kind, place], tb.reach, st.mean_sum, st.mean_count, why, verdict)
                    if wake_up(kind, t, wake, verdict, wakes):
                        code |= EVENT
                if alarm[kind] == UNRESOLVED:
                    doubt_last[kind] = t
                    if doubt[kind] == 0:
                        code |= EVENT
                elif doubt[kind] == 1 and t - doubt_last[kind] > rules.doubt_time:
                    code |= EVENT
            turn = counts[FUSED] % OF
            if rules.noise and turn < RUN:
                gather(0, turn, st.valid[0], z, st.noise)
                gather(1, turn, st.valid[1], z, st.noise)
            if grid > 0:
                note_past(t, grid, nominal, used[0], used[1], clean, place_past, end, last, span, used_past, total)
            output.stamp[o] = t
            output.sequence[o] = block.sequence[k]
            o += 1
            counts[FUSED] += 1
            if clock[SOLUTION] == 0:
                code |= EVENT
        else:
            # a sample without a solution judges nobody: an outage of the whole unit must not isolate its sensors
            counts[REJECTED_NO_SOLUTION] += 1
            if clock[SOLUTION] == 1:
                code |= EVENT
            for kind in range(2):
                for i in range(n):
                    if base[kind, i] and why[kind, i] != 0:
                        st.left_out[kind, i, why[kind, i]] += 1
        remember(0, k, block.gyro, value, repeat)
        remember(1, k, block.accel, value, repeat)
        if period > 0 and (clock[HAVE] == 0 or clock[FORCE_STATUS] == 1 or t // period != clock[LAST] // period):
            code |= TICK
        if clock[HAVE] == 1:
            note_sequence(clock, counts, int(block.sequence[k]), rules.lost_limit)
        else:
            clock[SEQUENCE] = int(block.sequence[k])
        clock[LAST] = t
        clock[HAVE] = 1
        k += 1
        if code != DONE:
            return k, o, code
    return k, o, DONE
