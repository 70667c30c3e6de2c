"""The compiled loop of `glr_kf`: Kalman filter on the parity vector, windowed likelihood ratios on its innovations, removal of drifts.

Lives here: one sample after the other, in place on the arrays of a `GlrState`; alarms, change to another set of sensors.
Does not live here: the arrays (glr_kf_state.py), who explains an alarm (glr_kf_resolve.py), settings and object (glr_kf.py), health (pipeline.py).
"""

from __future__ import annotations

import numpy as np

from riins_core.jit import inner, jit

from .glr_kf_filter import absorb, begin_anew, face, remember, wander, whiten

# isort: off
from .glr_kf_state import (
    ACTIVE, ALARM, ANEW, AT, BASED, BEFORE, CALL, CHANGED, CLOSED, COUNT, COV, COV_THEN, CROSS, DEAD, DOF, DONE, DOUBT, ERROR2, EXPECTED, FIRST,
    FLOOR2, JUMP, LEARNED, LEVEL, LONG, MOTION, NOISE, NONE, NOTE, OPEN, OTHER_SET, PAID, PARITY, REMOVED, RESOLVE, SIGMA2, SINCE, SLOT,
    SMALL_FOR, STATE, STEP2, STRANGE, STRIDE, SUM, SUM_THEN, TOTAL, USED, WALK, WEIGHT, F, GlrRules, GlrState, I, X,
)  # fmt: skip

# isort: on
from .wls import weigh


@inner
def test_windows(st: GlrState, rules: GlrRules, nu: F, S: F, u: F, t: F) -> tuple[int, int]:
    """Likelihood ratio of a change at each moment remembered, 2 ln L1/L0 maximized over its size, for each sensor.

    Returns
    -------
    level, slot : moment of the largest one above its threshold; -1, -1: none
    """
    d, now, n = st.ints[DOF], st.ints[COUNT], st.vec.shape[1]
    at_level, at_slot, most, least = -1, -1, 0.0, min(rules.again, rules.alarm)
    for level in range(st.ring.shape[0]):
        span = rules.batch << level
        if now % span != 0:
            break
        for slot in range(st.ring[level, 1]):
            w = now - st.ring[level, AT + slot]
            if w < 1 or (level > 0 and w < 4 * span):
                continue
            size = 0.0
            for r in range(d):
                e = (st.par[SUM, r] - st.r_par[level, slot, SUM_THEN, r]) / w - st.r_par[level, slot, EXPECTED, r]
                nu[r] = e
                size += e * e
            if size * w <= least:
                continue  # S is at least I/w: no statistic can be larger
            if rules.moving:
                face(st, rules, st.par[SUM], st.r_par[level, slot, SUM_THEN], w, st.r_par[level, slot, EXPECTED])
            for r in range(d):
                for c in range(r + 1):
                    a = 1.0 / w if r == c else 0.0
                    for i in range(n):
                        b = 0.0
                        for j in range(n):
                            b += st.r_mat[level, slot, COV_THEN, i, j] * st.V[c, j]
                        a += st.V[r, i] * (b + (wander(st, rules, i, now) * w / 3.0 + rules.each[FLOOR2, i] + st.vec[ERROR2, i]) * st.V[c, i])
                    S[r, c] = a
            if not whiten(st.V, d, nu, S, u, t):
                continue
            for i in range(n):
                a, g = 0.0, 0.0
                for r in range(d):
                    a += u[r, i] * t[r]
                    g += u[r, i] * u[r, i]
                if g > 1e-12:
                    s = a * a / g
                    if s > most and s > (rules.again if st.whole[STATE, i] == OPEN else rules.alarm):
                        at_level, at_slot, most = level, slot, s
    return at_level, at_slot


@inner
def add(z: F, moving: bool, V: F, W: F, ints: I, par: F) -> None:
    """Add the parity vector of a sample (n,), and its motion where that counts."""
    for r in range(ints[DOF]):
        s = 0.0
        for i in range(z.shape[0]):
            s += V[r, i] * z[i]
        par[PARITY, r] = s
        par[SUM, r] += s
    if moving:
        for a in range(MOTION):
            s = 0.0
            for i in range(z.shape[0]):
                s += W[a, i] * z[i]
            par[SUM, par.shape[1] - MOTION + a] += s
    ints[COUNT] += 1


@inner
def add_only(z: F, used: F, batch: int, moving: bool, V: F, W: F, ints: I, vec: F, par: F) -> bool:
    """A sample within a batch of a filter that removes nothing: it is added, and that is all. False: it is another one, and nothing was done.

    Most samples are of this kind, and to pass a whole state to `step` takes longer than to add one.
    """
    if ints[ACTIVE] == 1 or ints[BASED] == 0 or ints[ANEW] == 1 or (ints[COUNT] + 1) % batch == 0:
        return False
    for i in range(used.shape[0]):
        if used[i] != vec[USED, i]:
            return False
    ints[STRANGE] = 0
    add(z, moving, V, W, ints, par)
    return True


@inner
def step(z: F, st: GlrState, rules: GlrRules) -> None:
    """One sample (n,) of the set of sensors the state is based on; st.vec[REMOVED] is what is to be removed from it.

    When st.ints[CALL] is not NONE afterwards, `answer` is to be called before the next sample.
    """
    if st.ints[ANEW] == 1:
        begin_anew(st)
    add(z, rules.moving, st.V, st.W, st.ints, st.par)
    if st.ints[COUNT] % rules.batch == 0:
        tick(st, rules)
    if st.ints[ACTIVE] == 1:
        remove(st, rules)


@inner
def learn_motion(st: GlrState, rules: GlrRules) -> None:
    """Follow the motion at which the biases are learned: its mean with the gain of a healthy sensor's bias, which walks.

    The first batch: scale factor and mounting have made their part of the ordinary biases, as large as they can at this motion.
    """
    c, w = st.par.shape[1] - MOTION, rules.batch
    if st.par[LEARNED, WEIGHT] == 0.0:
        face(st, rules, st.par[SUM], st.par[DONE], w, st.par[LEARNED])
        for i in range(st.vec.shape[1]):
            st.mat[COV, i, i] += st.vec[ERROR2, i]
        gain = 1.0
        st.par[LEARNED, WEIGHT] = 1.0 / w
    else:
        s = st.par[LEARNED, WEIGHT] + w * rules.each[STEP2, 0] / rules.each[SIGMA2, 0]
        gain = s / (s + 1.0 / w)
        st.par[LEARNED, WEIGHT] = (1.0 - gain) * s
    for a in range(c, c + MOTION):
        st.par[LEARNED, a] += gain * ((st.par[SUM, a] - st.par[DONE, a]) / w - st.par[LEARNED, a])
        st.par[DONE, a] = st.par[SUM, a]


@inner
def tick(st: GlrState, rules: GlrRules) -> None:
    """Work in the batch of samples that is complete."""
    n, d, count, w = st.vec.shape[1], st.ints[DOF], st.ints[COUNT], rules.batch
    nu, t, S, u = np.empty(d), np.empty(d), np.empty((d, d)), np.empty((d, n))
    for r in range(d):
        nu[r] = (st.par[SUM, r] - st.par[DONE, r]) / w
        st.par[DONE, r] = st.par[SUM, r]
    for i in range(n):
        st.mat[COV, i, i] += w * wander(st, rules, i, count)
    for i in range(n):
        st.vec[TOTAL, i] += w * st.vec[X, i]
        for j in range(n):
            st.mat[CROSS, i, j] += w * st.mat[COV, i, j]
    if st.ints[ACTIVE] == 1:
        watch(st, rules, nu)
    if rules.moving:
        learn_motion(st, rules)
    absorb(st.V, d, nu, 1.0 / w, st.vec[X], st.mat[COV], st.mat[CROSS], st.vec[TOTAL])
    beat = count // w
    if st.ints[ACTIVE] == 1:
        review(st, rules, beat)
    if st.ints[DOUBT] == 1:
        st.ints[LONG] = 1 if st.ints[FIRST] == 0 and count - st.ints[SINCE] > rules.doubt else 0
        if beat % (2 * st.ints[STRIDE]) == 0:
            st.ints[CALL] = RESOLVE
        elif beat % st.ints[STRIDE] == 0:
            st.ints[CALL] = NOTE
        return
    level, slot = test_windows(st, rules, nu, S, u, t)
    if level >= 0:
        st.ints[CALL], st.ints[LEVEL], st.ints[SLOT] = ALARM, level, slot
        return
    for level in range(st.ring.shape[0]):
        if beat % (1 << level) != 0:
            break
        remember(st, level)


@inner
def along(st: GlrState, i: int) -> tuple[float, float]:
    """v_i'v_i and v_i' V P V' v_i: what the parities know of a sensor's drift has the variance of the latter over the square of the former."""
    n, d = st.vec.shape[1], st.ints[DOF]
    w = np.zeros(n)
    for j in range(n):
        for r in range(d):
            w[j] += st.V[r, i] * st.V[r, j]
    s = 0.0
    for j in range(n):
        for k in range(n):
            s += w[j] * st.mat[COV, j, k] * w[k]
    return w[i], s


@inner
def watch(st: GlrState, rules: GlrRules, mean: F) -> None:
    """Running mean square of the open sensors' innovations along their own direction, 1 for white noise of the known size."""
    n, d = st.vec.shape[1], st.ints[DOF]
    if rules.moving:
        face(st, rules, st.par[SUM], st.par[DONE], rules.batch, st.par[LEARNED])
    for i in range(n):
        if st.whole[STATE, i] != OPEN or st.vec[USED, i] == 0.0:
            continue
        g, s = along(st, i)
        for j in range(n):
            a = 0.0
            for r in range(d):
                a += st.V[r, i] * st.V[r, j]
            s += a * a * st.vec[ERROR2, j]
        a = 0.0
        for r in range(d):
            e = mean[r]
            for j in range(n):
                e -= st.V[r, j] * st.vec[X, j]
            a += st.V[r, i] * e
        st.vec[NOISE, i] += rules.noise_gain * (a * a / (g / rules.batch + s) - st.vec[NOISE, i])


@inner
def review(st: GlrState, rules: GlrRules, beat: int) -> None:
    """Mark a sensor that is dead: too much noise or too large a drift to be kept; close one whose drift has gone."""
    for i in range(st.vec.shape[1]):
        drift = st.vec[X, i] - st.vec[BEFORE, i]
        too_far = drift * drift > rules.drift_limit**2 * rules.each[SIGMA2, i]
        if st.whole[STATE, i] == OPEN and st.vec[USED, i] > 0.0 and (too_far or st.vec[NOISE, i] > rules.noise_limit):
            st.whole[DEAD, i] = 1
            st.ints[CHANGED] = 1
        elif st.whole[STATE, i] == OPEN and beat % 16 == 0 and st.ints[DOUBT] == 0:
            g, s = along(st, i)
            gone = st.vec[X, i] - st.vec[BEFORE, i]
            small = g > 0.0 and gone * gone < 9.0 * s / (g * g) + (0.05 * st.vec[JUMP, i]) ** 2
            st.whole[SMALL_FOR, i] = st.whole[SMALL_FOR, i] + 16 * rules.batch if small else 0
            if st.whole[SMALL_FOR, i] > rules.close:
                st.whole[STATE, i] = CLOSED
                st.vec[WALK, i] = rules.each[STEP2, i]
                st.ints[CHANGED] = 1


@inner
def hold(st: GlrState) -> None:
    """A sample that is not worked in: the drifts go on."""
    if st.ints[ACTIVE] == 1:
        for i in range(st.vec.shape[1]):
            st.vec[TOTAL, i] += st.vec[X, i]
            st.vec[REMOVED, i] = st.vec[X, i]
            st.vec[PAID, i] += st.vec[X, i]


@inner
def remove(st: GlrState, rules: GlrRules) -> None:
    """What is removed from this sample: the drift, and part of what earlier samples should have had removed by what is known now."""
    lead = st.ints[COUNT] % rules.batch  # `total` is that of the last complete batch
    lead = lead - 1 if lead > 0 else -1
    for i in range(st.vec.shape[1]):
        debt = st.vec[TOTAL, i] + lead * st.vec[X, i] - st.vec[PAID, i]
        st.vec[REMOVED, i] = st.vec[X, i] + rules.payback * debt
        st.vec[PAID, i] += st.vec[REMOVED, i]
        for a in range(3):  # along H it is removed from the fused output, whoever is in use, and no parity sees it
            st.vec[REMOVED, i] += rules.payback * rules.H[i, a] * st.owed[a]
    for a in range(3):
        st.owed[a] -= rules.payback * st.owed[a]


@inner
def other_set(st: GlrState, rules: GlrRules, used: F) -> bool:
    """Whether a sample has other sensors than the filter works with; when that lasts, `answer` is to go over to them."""
    same = True
    for i in range(used.shape[0]):
        same = same and used[i] == st.vec[USED, i]
    if same and st.ints[BASED] == 1:
        st.ints[STRANGE] = 0
        return False
    st.ints[STRANGE] += 1
    if st.ints[BASED] == 0 or st.ints[STRANGE] > rules.patience:
        st.ints[CALL] = OTHER_SET
    hold(st)
    return True


@jit
def fuse_block(k: int, z: F, used: F, d: int, W: F, st: GlrState, rules: GlrRules, x: F, covariance: F, drift: F) -> int:
    """Samples (m, n) of one set of sensors from number k on, into x (m, 3), covariance (m, 3, 3) and drift (m, n).

    Returns
    -------
    number of the next sample; less than m: call `answer` first
    """
    n = st.vec.shape[1]
    while k < z.shape[0] and st.ints[CALL] == NONE:
        if d > 0 and not other_set(st, rules, used):
            step(z[k], st, rules)
        weigh(W, z[k], st.vec[REMOVED], rules.each[SIGMA2], st.mat[COV], x[k], covariance[k])
        for i in range(n):
            drift[k, i] = st.vec[X, i]
        k += 1
    return k
