"""What `glr_kf` does when its loop asks: the log of an alarm, a verdict carried out, another set of sensors.

Lives here: `answer`, `open_now`; it is seldom, so it is not compiled.
Does not live here: what raises an alarm (glr_kf_kernel.py), who explains it (glr_kf_resolve.py).
"""

from __future__ import annotations

import numpy as np

from riins_fdi.motion import error_variance

from .glr_kf_resolve import OPENED, QUIET, resolve, take_in

# isort: off
from .glr_kf_state import (
    ACTIVE, ALARM, ANEW, AT, BASED, BASE_COV, BASE_CROSS, BASE_LEARNED, BASE_SUM, BASE_TOTAL, BASE_X, BEFORE, CALL, CHANGED, CLOSED, COUNT, COV,
    COV_THEN, CROSS, CROSS_THEN, DEAD, DOF, DONE, DOUBT, EXPECTED, FILLED, FIRST, JUMP, KEPT, LEARNED, LEVEL, LOG, LONG, MOTION, NOISE, NONE,
    NOTE, OPEN, OPENED_AT, OTHER_SET, PAID, PRIOR2, SECOND, SIGMA2, SINCE, SLOT, SMALL_FOR, STATE, STEP2, STRANGE, STRIDE, SUM, SUM_THEN, TOTAL,
    TOTAL_THEN, USED, WALK, X_THEN, F, GlrRules, GlrState, X,
)  # fmt: skip
# isort: on


def answer(st: GlrState, rules: GlrRules, V: F, used: F, W: F, expected: F | None = None) -> None:
    """What the loop has asked for in st.ints[CALL].

    Parameters
    ----------
    V, used, W : (d, n), (n,), (3, n), parity matrix of unit noise, members and estimator of the set of sensors of the last sample
    expected : (n,), bias of a sensor that comes in, relative to the fused output, as far as it is known; None: zeros
    """
    call = st.ints[CALL]
    st.ints[CALL] = NONE
    if call == OTHER_SET:
        _go_over(st, rules, V, used, W, np.zeros(len(used)) if expected is None else expected)
        return
    if call == NOTE:
        _log_moment(st, int(st.ints[COUNT]), st.par[SUM])
        return
    if call == ALARM:
        _begin_log(st, int(st.ints[LEVEL]), int(st.ints[SLOT]))
    d, n = st.V.shape
    verdict, first, second, shape_first, shape_second = resolve(st, rules, np.empty((d, d)), np.empty((d, n)), np.empty(d))
    if verdict == OPENED or first >= 0 or st.ints[FIRST] > 0:
        _suppose(st, rules, first, second, shape_first, shape_second)
    if verdict == OPENED:
        _mark_open(st, first, shape_first)
        if second >= 0 and second != first:
            _mark_open(st, second, shape_second)
        _close_log(st)
        st.ints[CHANGED] = 1
    elif verdict == QUIET:
        _close_log(st)
    else:
        _log_moment(st, int(st.ints[COUNT]), st.par[SUM])


def open_now(st: GlrState, rules: GlrRules, index: int) -> None:
    """Open a sensor without an alarm, from the next sample on."""
    if st.ints[ACTIVE] == 0:
        st.vec[PAID] = st.vec[TOTAL]
        st.ints[ACTIVE] = 1
    st.mat[COV, index, index] += rules.each[SIGMA2, index] * rules.diffuse**2
    st.whole[STATE, index] = OPEN
    st.whole[OPENED_AT, index] = st.ints[COUNT]
    st.vec[JUMP, index] = 0.0
    st.vec[BEFORE, index] = st.vec[X, index]
    _close_log(st)


def forgive(st: GlrState, index: int, rules: GlrRules) -> None:
    """What a sensor has put in has been taken out by others, or never entered."""
    st.vec[PAID, index] += _debt(st, rules)[index]


def _debt(st: GlrState, rules: GlrRules) -> F:
    """Of each sensor (n,), sum over the samples: what should have been removed up to now by what is known now, less what was."""
    return np.asarray(st.vec[TOTAL] + int(st.ints[COUNT]) % rules.batch * st.vec[X] - st.vec[PAID])


def _begin_log(st: GlrState, level: int, slot: int) -> None:
    """An alarm: keep the moment before its onset, and the sums at all moments remembered since then."""
    moments = sorted((int(st.ring[q_level, AT + q]), q_level, q) for q_level in range(len(st.ring)) for q in range(int(st.ring[q_level, KEPT])))
    began = int(st.ring[level, AT + slot])
    # one moment earlier than the likeliest, if its level has one: the onset may lie between the two
    at, _, older = max([(a, level, q) for a, q_level, q in moments if q_level == level and a < began], default=(began, level, slot))
    st.vec[BASE_X] = st.r_vec[level, older, X_THEN]
    st.mat[BASE_COV] = st.r_mat[level, older, COV_THEN]
    st.mat[BASE_CROSS] = st.r_mat[level, older, CROSS_THEN]
    st.vec[BASE_TOTAL] = st.r_vec[level, older, TOTAL_THEN]
    st.par[BASE_SUM] = st.r_par[level, older, SUM_THEN]
    st.par[BASE_LEARNED] = st.r_par[level, older, EXPECTED]
    st.ints[DOUBT] = 1
    st.ints[SINCE] = st.ints[COUNT]
    st.ints[STRIDE] = 1
    st.ints[FILLED] = 0
    last = at - 1
    for a, q_level, q in moments:
        if last < a < st.ints[COUNT]:  # each moment once
            _log_moment(st, a, st.r_par[q_level, q, SUM_THEN])
            last = a


def _log_moment(st: GlrState, count: int, total: F) -> None:
    """Append a moment; a full log drops every second one but the first."""
    if st.ints[FILLED] == LOG:
        rest = np.r_[0, 2:LOG:2]
        st.log_at[: len(rest)] = st.log_at[rest]
        st.log_sum[: len(rest)] = st.log_sum[rest]
        st.ints[FILLED] = len(rest)
        st.ints[STRIDE] *= 2
    st.log_at[st.ints[FILLED]] = count
    st.log_sum[st.ints[FILLED]] = total
    st.ints[FILLED] += 1


def _close_log(st: GlrState) -> None:
    """The alarm is over; all windows begin now."""
    st.ints[[DOUBT, FIRST, SECOND, LONG]] = 0
    st.ints[ANEW] = 1


def _suppose(st: GlrState, rules: GlrRules, first: int, second: int, shape_first: int, shape_second: int) -> None:
    """Go back to the base of the log, and take in what has come since as if up to two sensors (-1: none) had drifted."""
    if st.ints[ACTIVE] == 0:
        # nothing has been removed so far: what is known of healthy sensors is not seen in W, so it may as well have been
        st.vec[PAID] = st.vec[BASE_TOTAL] + (st.ints[COUNT] - st.log_at[0]) * st.vec[BASE_X]
        st.ints[ACTIVE] = 1
    st.vec[X], st.vec[TOTAL] = st.vec[BASE_X], st.vec[BASE_TOTAL]
    st.mat[COV], st.mat[CROSS] = st.mat[BASE_COV], st.mat[BASE_CROSS]
    take_in(st, rules, first, second, shape_first, shape_second)
    st.ints[FIRST], st.ints[SECOND] = first + 1, second + 1


def _mark_open(st: GlrState, i: int, shape: int) -> None:
    """A sensor is open since the onset of a shape."""
    filled = int(st.ints[FILLED])
    at = st.log_at[shape if shape < filled else 2 * (shape - filled)]
    change = st.vec[X, i] - st.vec[BASE_X, i]
    if st.whole[STATE, i] == OPEN:  # opened again: it wanders, and by about so much
        st.vec[WALK, i] = max(st.vec[WALK, i], change * change / max(at - st.whole[OPENED_AT, i], 1))
    else:
        st.vec[BEFORE, i] = st.vec[BASE_X, i]
    st.whole[STATE, i] = OPEN
    st.whole[SMALL_FOR, i] = 0
    st.whole[DEAD, i] = 0
    st.whole[OPENED_AT, i] = at
    st.vec[JUMP, i] = change
    st.vec[NOISE, i] = 1.0


def _go_over(st: GlrState, rules: GlrRules, V: F, used: F, W: F, expected: F) -> None:
    """Go over to another set of sensors; what is known of each stays, one that comes in anew is as uncertain as at the beginning."""
    d, first_time = len(V), st.ints[BASED] == 0
    leaving = np.flatnonzero((used == 0.0) & (st.vec[USED] > 0.0))
    entering = np.flatnonzero((used > 0.0) & (st.vec[USED] == 0.0))
    if st.ints[ACTIVE] == 1 and len(leaving):  # what they have put in stays in the integrals: it is owed by all from now on
        st.owed[:] += st.W[:, leaving] @ _debt(st, rules)[leaving]
    if st.ints[DOUBT] == 1:  # those that leave may be its cause: what they have shown must not pass for biases of the others
        first, second = (*leaving.tolist()[:2], -1, -1)[:2]
        _suppose(st, rules, first, second, 0, 0)
    motion = error_variance(rules.H, st.par[LEARNED, -MOTION:], *np.sqrt(rules.errors).tolist())
    for i in entering:
        st.vec[X, i] = 0.0 if first_time else expected[i]
        st.vec[TOTAL, i] = st.vec[PAID, i]
        st.mat[[COV, CROSS], i] = 0.0
        st.mat[[COV, CROSS], :, i] = 0.0
        st.mat[COV, i, i] = rules.each[PRIOR2, i] + motion[i]
        st.vec[WALK, i] = rules.each[STEP2, i]
        st.whole[[STATE, DEAD], i] = CLOSED, 0
    st.vec[USED] = used
    st.whole[OPENED_AT] -= st.ints[COUNT]
    st.V[:] = 0.0
    st.V[:d] = V
    st.W[:] = W
    if not first_time and st.ints[ACTIVE] == 0:  # the biases of the healthy ones are seen in the new W
        st.vec[PAID] = st.vec[TOTAL]
        st.ints[ACTIVE] = 1
    st.ints[BASED], st.ints[DOF] = 1, d
    st.ints[[COUNT, STRANGE]] = 0
    st.par[[SUM, DONE]] = 0.0
    _close_log(st)
