"""The compiled loop of `glr_kf`: Kalman filter on the parity vector, windowed likelihood ratios on its innovations, removal of drifts.

Lives here: one sample after the other, in place on the arrays of a `GlrState`; alarms, change to another set of sensors.
Does not live here: the arrays (glr_kf_state.py), who explains an alarm (glr_kf_resolve.py), settings and object (glr_kf.py), health (pipeline.py).
"""

from __future__ import annotations

import numpy as np

from riins_core.jit import jit

from .glr_kf_filter import absorb, free, remember, wander, whiten
from .glr_kf_resolve import DOUBTFUL, OPENED, QUIET, begin_log, close_log, log_moment, resolve, settle, suppose
from .glr_kf_state import ACTIVE, BASED, CLOSED, COUNT, DOF, DOUBT, FIRST, OPEN, STRANGE, STRIDE, F, GlrRules, GlrState
from .wls import weigh


@jit
def test_windows(st: GlrState, rules: GlrRules, nu: F, S: F, u: F, t: F) -> tuple[int, int]:
    """Likelihood ratio of a change at each moment remembered, 2 ln L1/L0 maximized over its size, for each sensor.

    Returns
    -------
    level, slot : moment of the largest one above its threshold; -1, -1: none
    """
    d, now, n = st.ints[DOF], st.ints[COUNT], st.x.shape[0]
    at_level, at_slot, most, least = -1, -1, 0.0, min(rules.again, rules.alarm)
    for level in range(st.ring.shape[0]):
        span = rules.batch << level
        if now % span != 0:
            break
        for slot in range(st.ring[level, 1]):
            w = now - st.at[level, slot]
            if w < 1 or (level > 0 and w < 4 * span):
                continue
            size = 0.0
            for r in range(d):
                e = (st.sum[r] - st.r_sum[level, slot, r]) / w - st.r_mean[level, slot, r]
                nu[r] = e
                size += e * e
            if size * w <= least:
                continue  # S is at least I/w: no statistic can be larger
            for r in range(d):
                for c in range(r + 1):
                    a = 1.0 / w if r == c else 0.0
                    for i in range(n):
                        b = 0.0
                        for j in range(n):
                            b += st.r_P[level, slot, i, j] * st.V[c, j]
                        a += st.V[r, i] * (b + (wander(st, rules, i, now) * w / 3.0 + rules.floor2[i]) * st.V[c, i])
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
                    if s > most and s > (rules.again if st.open[i] == OPEN else rules.alarm):
                        at_level, at_slot, most = level, slot, s
    return at_level, at_slot


@jit
def open_now(st: GlrState, rules: GlrRules, index: int) -> None:
    """Open a sensor without an alarm, from the next sample on."""
    if st.ints[ACTIVE] == 0:
        st.paid[:] = st.total
        st.ints[ACTIVE] = 1
    free(st, rules, index, st.ints[COUNT])
    st.open[index] = OPEN
    st.opened[index] = st.ints[COUNT]
    st.jump[index] = 0.0
    close_log(st)


@jit
def step(z: F, st: GlrState, rules: GlrRules, nu: F, S: F, u: F, t: F) -> tuple[int, int, int]:
    """One sample (n,) of the set of sensors the state is based on; st.c is what is to be removed from it.

    Returns
    -------
    verdict : QUIET, OPENED, DOUBTFUL
    first, second : sensors opened, -1: none
    """
    n, d = st.x.shape[0], st.ints[DOF]
    for r in range(d):
        s = 0.0
        for i in range(n):
            s += st.V[r, i] * z[i]
        st.p[r] = s
        st.sum[r] += s
    st.ints[COUNT] += 1
    verdict, first, second = QUIET, -1, -1
    if st.ints[COUNT] % rules.batch == 0:
        verdict, first, second = tick(st, rules, nu, S, u, t)
    elif st.ints[DOUBT] == 1:
        verdict = DOUBTFUL
    if st.ints[ACTIVE] == 1:
        remove(st, rules)
    return verdict, first, second


@jit
def tick(st: GlrState, rules: GlrRules, nu: F, S: F, u: F, t: F) -> tuple[int, int, int]:
    """Work in the batch of samples that is complete; returns as `step`."""
    n, d, count, w = st.x.shape[0], st.ints[DOF], st.ints[COUNT], rules.batch
    for r in range(d):
        nu[r] = (st.sum[r] - st.done[r]) / w
        st.done[r] = st.sum[r]
    for i in range(n):
        st.P[i, i] += w * wander(st, rules, i, count)
    for i in range(n):
        st.total[i] += w * st.x[i]
        for j in range(n):
            st.C[i, j] += w * st.P[i, j]
    if st.ints[ACTIVE] == 1:
        watch(st, rules, nu)
    absorb(st.V, d, nu, 1.0 / w, st.x, st.P, st.C, st.total)
    verdict, first, second = QUIET, -1, -1
    beat = count // w
    if st.ints[DOUBT] == 0:
        level, slot = test_windows(st, rules, nu, S, u, t)
        if level >= 0:
            begin_log(st, level, slot)
    if st.ints[DOUBT] == 1:
        verdict = DOUBTFUL
        if beat % (2 * st.ints[STRIDE]) == 0:
            verdict, first, second, shape_first, shape_second = resolve(st, rules, S, u, t)
            if verdict == OPENED:
                suppose(st, rules, first, second, shape_first, shape_second)
                settle(st, first, second, shape_first, shape_second)
            elif first >= 0 or st.ints[FIRST] > 0:
                suppose(st, rules, first, second, shape_first, shape_second)
            if verdict == QUIET:
                close_log(st)
        if st.ints[DOUBT] == 1 and beat % st.ints[STRIDE] == 0:
            log_moment(st, count, st.sum)
    else:
        for level in range(st.ring.shape[0]):
            if beat % (1 << level) != 0:
                break
            remember(st, level)
    return verdict, first, second


@jit
def watch(st: GlrState, rules: GlrRules, mean: F) -> None:
    """Running mean square of the open sensors' innovations along their own direction, 1 for white noise of the known size."""
    n, d = st.x.shape[0], st.ints[DOF]
    for i in range(n):
        if st.open[i] != OPEN or st.used[i] == 0.0:
            continue
        a, g, s = 0.0, 0.0, 0.0
        for r in range(d):
            e = mean[r]
            for j in range(n):
                e -= st.V[r, j] * st.x[j]
            a += st.V[r, i] * e
            g += st.V[r, i] * st.V[r, i]
        for j in range(n):
            b = 0.0
            for r in range(d):
                b += st.V[r, i] * st.V[r, j]
            for k in range(n):
                c = 0.0
                for r in range(d):
                    c += st.V[r, i] * st.V[r, k]
                s += b * st.P[j, k] * c
        st.noise[i] += rules.noise_gain * (a * a / (g / rules.batch + s) - st.noise[i])


@jit
def remove(st: GlrState, rules: GlrRules) -> None:
    """What is removed from this sample: the drift, and part of what earlier samples should have had removed by what is known now."""
    lead = st.ints[COUNT] % rules.batch  # `total` is that of the last complete batch
    lead = lead - 1 if lead > 0 else -1
    for i in range(st.x.shape[0]):
        debt = st.total[i] + lead * st.x[i] - st.paid[i]
        st.c[i] = st.x[i] + rules.payback * debt
        st.paid[i] += st.c[i]


@jit
def rebase(st: GlrState, rules: GlrRules, V: F, used: F) -> None:
    """Go over to another set of sensors; what is known of each stays, but one that comes in anew is as at the beginning."""
    n, d = st.x.shape[0], V.shape[0]
    if st.ints[DOUBT] == 1:
        suppose(st, rules, -1, -1, -1, -1)
    first_time = st.ints[BASED] == 0
    for i in range(n):
        if used[i] > 0.0 and st.used[i] == 0.0:
            st.x[i] = 0.0
            st.total[i] = st.paid[i]
            st.P[i] = 0.0
            st.P[:, i] = 0.0
            st.C[i] = 0.0
            st.C[:, i] = 0.0
            st.P[i, i] = rules.prior2[i]
            st.walk[i] = rules.walk[i]
            st.open[i] = CLOSED
        st.used[i] = used[i]
        st.opened[i] -= st.ints[COUNT]
    st.V[:] = 0.0
    for r in range(d):
        for i in range(n):
            st.V[r, i] = V[r, i]
    if not first_time and st.ints[ACTIVE] == 0:  # the biases of the healthy ones are seen in the new W
        st.paid[:] = st.total
        st.ints[ACTIVE] = 1
    st.ints[BASED] = 1
    st.ints[DOF] = d
    st.ints[COUNT] = 0
    st.ints[STRANGE] = 0
    st.sum[:] = 0.0
    st.done[:] = 0.0
    close_log(st)


@jit
def other_set(st: GlrState, rules: GlrRules, V: F, used: F) -> bool:
    """Whether a sample has other sensors than the filter works with; when that lasts, it goes over to them."""
    same = True
    for i in range(used.shape[0]):
        same = same and used[i] == st.used[i]
    if same and st.ints[BASED] == 1:
        st.ints[STRANGE] = 0
        return False
    st.ints[STRANGE] += 1
    if st.ints[BASED] == 0 or st.ints[STRANGE] > rules.patience:
        rebase(st, rules, V, used)
        return False
    if st.ints[ACTIVE] == 1:  # the drifts go on
        for i in range(used.shape[0]):
            st.total[i] += st.x[i]
            st.c[i] = st.x[i]
            st.paid[i] += st.x[i]
    return True


@jit
def fuse_block(z: F, V: F, used: F, W: F, st: GlrState, rules: GlrRules, x: F, covariance: F, drift: F) -> None:
    """Samples (m, n) of one set of sensors one after the other, into x (m, 3), covariance (m, 3, 3) and drift (m, n)."""
    n, d = st.x.shape[0], V.shape[0]
    nu, t, S, u = np.empty(st.V.shape[0]), np.empty(st.V.shape[0]), np.empty((st.V.shape[0], st.V.shape[0])), np.empty((st.V.shape[0], n))
    for k in range(z.shape[0]):
        if d > 0 and not other_set(st, rules, V, used):
            step(z[k], st, rules, nu, S, u, t)
        weigh(W, z[k], st.c, rules.sigma2, st.P, x[k], covariance[k])
        for i in range(n):
            drift[k, i] = st.x[i]
