"""The compiled inner loop of the fusion: one sample after the other until something happens that Python decides.

Lives here: stamp and sequence checks, availability of each axis, GLT test and isolation, least squares, judging of sensors that are out.
Does not live here: the arrays it works on (state.py), the health machines, the making of tables, events (pipeline.py).
No result depends on where a block ends.
"""

from __future__ import annotations

import numpy as np

from riins_core.jit import jit
from riins_fdi.parity import parity_vector, suspect, suspect_pair
from riins_imu_fusion.glr_kf_kernel import hold, other_set, step
from riins_imu_fusion.glr_kf_state import ACTIVE, CALL, CHANGED, COUNT, COV, DOUBT, FIRST, REMOVED, SINCE, STATE, USED, GlrRules, GlrState, X
from riins_imu_fusion.glr_kf_state import NONE as GLR_NONE
from riins_imu_fusion.glr_kf_state import OPEN as GLR_OPEN
from riins_imu_fusion.state import (
    BAD,
    COMMAND,
    DONE,
    EVENT,
    FILLED,
    FORCE_STATUS,
    FUSED,
    GOOD,
    HAVE,
    INVALID,
    LAST,
    LOST,
    NEED_TABLE,
    NEWEST,
    NEXT_COMMAND,
    NONE,
    NOT_FINITE,
    OPEN,
    PARITY,
    QUIET,
    RECEIVED,
    REJECTED_NO_SOLUTION,
    REJECTED_STAMP,
    RESOLVED,
    RESTART,
    SATURATED,
    SEQUENCE,
    SOLUTION,
    STUCK,
    TICK,
    UNRESOLVED,
    B,
    Block,
    F,
    I,
    Output,
    Rules,
    State,
    Tables,
    U,
)  # fmt: skip


@jit
def find_slot(kind: int, key: U, count: I, wanted: np.uint64, hint: int) -> int:
    """Slot of a set of sensors, -1: not made yet."""
    if hint < count[kind] and key[kind, hint] == wanted:
        return hint
    for s in range(count[kind]):
        if key[kind, s] == wanted:
            return s
    return -1


@jit
def note_sequence(clock: I, counts: I, sequence: int, lost_limit: int) -> None:
    """Count the samples missing before this one; a number that runs back or jumps too far is a new numbering."""
    ahead = (sequence - clock[SEQUENCE]) % 4294967296
    if ahead == 0 or ahead >= 2147483648:
        if (4294967296 - ahead) % 4294967296 > lost_limit:
            clock[SEQUENCE] = sequence
        return
    if ahead - 1 <= lost_limit:
        counts[LOST] += ahead - 1
    clock[SEQUENCE] = sequence


@jit
def check_axes(kind: int, k: int, raw: F, valid: U, limit: F, stuck: int, value: F, repeat: I, base: B, z: F, why: I) -> np.uint64:
    """Which axes of a sample can be used: why[kind, i] = 0; returns those in use among them. Nothing is remembered yet."""
    key = np.uint64(0)
    for i in range(raw.shape[1]):
        v = raw[k, i]
        reason = 0
        if (valid[k] >> np.uint64(i)) & np.uint64(1) == np.uint64(0):
            reason = INVALID
        elif not np.isfinite(v):
            reason = NOT_FINITE
        elif abs(v) >= limit[kind]:
            reason = SATURATED
        elif stuck > 0 and v == value[kind, i] and repeat[kind, i] + 1 >= stuck:
            reason = STUCK
        why[kind, i] = reason
        z[kind, i] = v if reason == 0 else 0.0
        if reason == 0 and base[kind, i]:
            key |= np.uint64(1) << np.uint64(i)
    return key


@jit
def quadratic(kind: int, slot: int, dof: int, whitened: F, z: F) -> float:
    """GLT statistic of the set of sensors in `slot`."""
    total = 0.0
    for r in range(dof):
        s = 0.0
        for i in range(z.shape[1]):
            s += whitened[kind, slot, r, i] * z[kind, i]
        total += s * s
    return total


@jit
def resolve(dof: int, statistic: float, whitened: F, gain: F, isolable: B, z: F, threshold: F) -> tuple[int, int, int, int]:
    """Who explains an alarm; arrays are those of one kind and slot.

    One sensor that explains the parity vector leaves; else two, if only one pair explains it. Otherwise the alarm is unresolved: the best
    pair (with five sensors, the best one) stays out of the sample, and nobody's health is judged by it. With four sensors all stay.

    Returns
    -------
    alarm : RESOLVED or UNRESOLVED
    first, second : sensors to leave out, -1: none
    pointed : sensor the test points at, -1: it cannot tell
    """
    p = np.empty(dof)
    parity_vector(whitened, dof, z, p)
    best, value = suspect(whitened, dof, gain, p)
    if dof < 2 or best < 0 or not isolable[best]:
        return UNRESOLVED, -1, -1, -1
    if statistic - value <= threshold[dof - 1]:
        return RESOLVED, best, -1, best
    if dof == 2:
        return UNRESOLVED, best, -1, best
    i, j, _, count = suspect_pair(whitened, dof, gain, p, statistic - threshold[dof - 2])
    unique = count == 1 and isolable[i] and isolable[j]
    return RESOLVED if unique else UNRESOLVED, i, j, best


@jit
def judge_used(kind: int, alarm: int, first: int, second: int, base: B, why: I, left_out: I, verdict: I) -> None:
    """Verdict on the sensors in use."""
    for i in range(base.shape[1]):
        verdict[kind, i] = NONE
        if not base[kind, i]:
            continue
        if why[kind, i] != 0:
            verdict[kind, i] = BAD
            left_out[kind, i, why[kind, i]] += 1
        elif i == first or i == second:
            left_out[kind, i, PARITY] += 1
            if alarm == RESOLVED:
                verdict[kind, i] = BAD
                why[kind, i] = PARITY
        elif alarm != UNRESOLVED:
            verdict[kind, i] = GOOD


@jit
def judge_out(
    kind: int, slot: int, t: int, rules: Rules, judged: B, wake: I, z: F, x: F, reach: F, mean_sum: F, mean_count: I, why: I, verdict: I
) -> None:
    """Verdict on the sensors that are out and on the way back: their residual against those in use."""
    for i in range(judged.shape[1]):
        if not judged[kind, i] or (t < wake[0, kind, i] and t < wake[1, kind, i]):
            continue
        if why[kind, i] != 0:
            verdict[kind, i] = BAD
            continue
        r = z[kind, i]
        for a in range(3):
            r -= rules.H[i, a] * x[kind, a]
        scale = reach[kind, slot, i]
        mean_sum[kind, i] += r * np.sqrt(scale)
        mean_count[kind, i] += 1
        if r * r * scale <= rules.judge_threshold:
            verdict[kind, i] = GOOD
        else:
            verdict[kind, i] = BAD
            why[kind, i] = PARITY


@jit
def wake_up(kind: int, t: int, wake: I, verdict: I, wakes: B) -> bool:
    """Mark the verdicts that concern a health machine; True: there are some."""
    woken = False
    for i in range(verdict.shape[1]):
        v = verdict[kind, i]
        wakes[kind, i] = (v == GOOD and t >= wake[0, kind, i]) or (v == BAD and t >= wake[1, kind, i])
        woken |= wakes[kind, i]
    return woken


@jit
def remember(kind: int, k: int, raw: F, value: F, repeat: I) -> None:
    """Keep the values for the stuck test."""
    for i in range(raw.shape[1]):
        if raw[k, i] == value[kind, i]:
            repeat[kind, i] += 1
        else:
            repeat[kind, i] = 1
            value[kind, i] = raw[k, i]


@jit
def note_past(
    t: int, grid: int, period: float, set0: np.uint64, set1: np.uint64, z: F, place: I, end: I, last: I, span: F, used: U, total: F
) -> None:
    """Add a fused sample to the records of the past."""
    r = place[OPEN]
    dt = period if place[FILLED] == 0 else (t - place[NEWEST]) * 1e-9  # as a consumer that integrates has it
    place[NEWEST] = t
    if place[FILLED] == 0 or t >= end[r] or set0 != used[r, 0] or set1 != used[r, 1]:
        if place[FILLED] > 0:
            r = (r + 1) % end.shape[0]
            place[OPEN] = r
        place[FILLED] = min(place[FILLED] + 1, end.shape[0])
        end[r] = t - t % grid + grid
        used[r, 0] = set0
        used[r, 1] = set1
        span[r, 0] = 0.0
        span[r, 1] = 0.0
        total[r] = 0.0
    last[r] = t
    span[r, 0] += dt
    span[r, 1] += dt * dt
    for kind in range(2):
        for i in range(z.shape[1]):
            total[r, kind, i] += dt * z[kind, i]


@jit
def without(key: np.uint64, first: int, second: int) -> np.uint64:
    """Set of sensors with two taken out (-1: none)."""
    if first >= 0:
        key &= ~(np.uint64(1) << np.uint64(first))
    if second >= 0:
        key &= ~(np.uint64(1) << np.uint64(second))
    return key


@jit
def known(kind: int, glr: GlrState, z: F, tested: F) -> None:
    """Measurements without the drifts known before this sample."""
    for i in range(z.shape[1]):
        tested[kind, i] = z[kind, i]
        if glr.ints[ACTIVE] == 1 and glr.vec[USED, i] > 0.0:
            tested[kind, i] -= glr.vec[X, i]


@jit
def learn(
    kind: int, alarm: int, dof: int, member: F, z: F, glr: GlrState, rules: GlrRules, clean: F, drift: F
) -> bool:  # fmt: skip
    """Let the filter see the sample and take the drifts from it; True: it asks for an answer, or a sensor was closed or found dead."""
    n, rows = z.shape[1], glr.V.shape[0]
    if alarm != QUIET or dof < 1:
        hold(glr)  # not even the sensors in use agree: nothing to learn
    elif not other_set(glr, rules, member):
        nu, t, S, u = np.empty(rows), np.empty(rows), np.empty((rows, rows)), np.empty((rows, n))
        step(z[kind], glr, rules, nu, S, u, t)
    if glr.ints[ACTIVE] == 0:
        return bool(glr.ints[CALL] != GLR_NONE)
    for i in range(n):
        clean[kind, i] = z[kind, i] - glr.vec[REMOVED, i]
        if glr.whole[STATE, i] == GLR_OPEN and member[i] > 0.0:
            drift[i] = glr.vec[X, i]
    return bool(glr.ints[CALL] != GLR_NONE or glr.ints[CHANGED] == 1)


@jit
def add_excess(glr: GlrState, member: F, W: F, excess: F) -> None:
    """Covariance that the uncertainty of the drifts removed adds to that of the fused sample."""
    n = member.shape[0]
    for i in range(n):
        for j in range(n):
            if glr.whole[STATE, i] == GLR_OPEN and glr.whole[STATE, j] == GLR_OPEN and member[i] * member[j] > 0.0:
                for a in range(3):
                    for b in range(3):
                        excess[a, b] += W[a, i] * glr.mat[COV, i, j] * W[b, j]


@jit
def unresolved_long(glr: GlrState, rules: GlrRules) -> bool:
    """An alarm has gone on for long and nobody is supposed to be its cause."""
    return bool(glr.ints[DOUBT] == 1 and glr.ints[FIRST] == 0 and glr.ints[COUNT] - glr.ints[SINCE] > rules.doubt)


@jit
def fuse_samples(k: int, o: int, block: Block, output: Output, tb: Tables, rules: Rules, st: State) -> tuple[int, int, int]:
    """Fuse samples from number k on, writing from place o on, until the block ends or Python is needed.

    Returns
    -------
    k : next sample to give
    o : next place to write
    code : DONE; EVENT and TICK (bits, the sample before k is finished); RESTART, COMMAND, NEED_TABLE (sample k is not begun)
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

        key[0] = check_axes(0, k, block.gyro, block.gyro_valid, rules.limit, rules.stuck, value, repeat, base, z, why)
        key[1] = check_axes(1, k, block.accel, block.accel_valid, rules.limit, rules.stuck, value, repeat, base, z, why)
        solved = True
        for kind in range(2):
            place = find_slot(kind, tb.key, tb.filled, key[kind], slot[kind])
            if place < 0:
                st.need[0] = kind
                st.need_key[0] = key[kind]
                return k, o, NEED_TABLE
            slot[kind] = place
            used[kind] = key[kind]
            used_slot[kind] = place
            alarm[kind] = QUIET
            pointed[kind] = -1
            leave[kind, 0] = -1
            leave[kind, 1] = -1
            statistic[kind] = np.nan
            dof = dofs[kind, place]
            solved &= dof >= 0
            known(kind, st.glr[kind], z, tested)
            if dof < 1:
                continue
            statistic[kind] = quadratic(kind, place, dof, tb.whitened, tested)
            if statistic[kind] <= rules.threshold[dof]:
                continue
            alarm[kind], i, j, pointed[kind] = resolve(
                dof, statistic[kind], tb.whitened[kind, place], tb.gain[kind, place], tb.isolable[kind, place], tested[kind], rules.threshold
            )
            if i < 0:
                continue
            rest = without(key[kind], i, j)
            place = find_slot(kind, tb.key, tb.filled, rest, 0)
            if place < 0:
                st.need[0] = kind
                st.need_key[0] = rest
                return k, o, NEED_TABLE
            if dofs[kind, place] < 0:  # they are needed for a solution: keep all, in doubt
                alarm[kind] = UNRESOLVED
                continue
            leave[kind, 0] = i
            leave[kind, 1] = j
            used[kind] = rest
            used_slot[kind] = place

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
                    output.excess[kind, o, a // 3, a % 3] = 0.0
                if rules.compensates:
                    glr, first = st.glr[kind], slot[kind]  # the filter learns only where nobody was left out: then both slots are one
                    if learn(
                        kind, alarm[kind], dofs[kind, first], tb.member[kind, first], z, glr, rules.glr[kind], clean,
                        output.drift[kind, o],
                    ):  # fmt: skip
                        code |= EVENT
                    if glr.ints[ACTIVE] == 1:
                        add_excess(glr, tb.member[kind, place], w[kind, place], output.excess[kind, o])
                    if unresolved_long(glr, rules.glr[kind]):
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
                    judge_used(kind, alarm[kind], leave[kind, 0], leave[kind, 1], base, why, st.left_out, verdict)
                    if alarm[kind] != UNRESOLVED:
                        judge_out(kind, place, t, rules, st.judged, wake, z, x, tb.reach, st.mean_sum, st.mean_count, why, verdict)
                    if wake_up(kind, t, wake, verdict, wakes):
                        code |= EVENT
                if alarm[kind] == UNRESOLVED:
                    doubt_last[kind] = t
                    if doubt[kind] == 0:
                        code |= EVENT
                elif doubt[kind] == 1 and t - doubt_last[kind] > rules.doubt_time:
                    code |= EVENT
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
