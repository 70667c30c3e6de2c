"""Who explains an alarm of `glr_kf`: every sensor and every pair weighed by the log of parity sums since the moment before it.

Lives here: the hypotheses and their likelihoods; the log taken in again under one of them.
Does not live here: the log and what follows from a verdict (glr_kf_answer.py), what raises an alarm (glr_kf_kernel.py).
"""

from __future__ import annotations

import numpy as np

from riins_core.jit import inner, jit

from .glr_kf_filter import absorb, face, wander, whiten

# isort: off
from .glr_kf_state import (
    BASE_COV, BASE_LEARNED, BASE_SUM, BASE_X, COUNT, COV, CROSS, DOF, ERROR2, FILLED, FLOOR2, LEARNED, OPEN, SIGMA2, STATE, SUM, TOTAL, WEIGHT,
    F, GlrRules, GlrState, X,
)  # fmt: skip
# isort: on

# what is made of an alarm
QUIET, OPENED, DOUBTFUL = 0, 1, 2


@inner
def shapes(st: GlrState, w: float, y: F, gram: F, weight: F, mean: F) -> int:
    """What a drift may look like since the base of the log: steps at each entry, then ramps from every second one on (end at 1).

    Parameters
    ----------
    w : samples since the base
    y : (LOG, d), to be filled: sum of each interval of the log without what the base expected
    gram, weight, mean : (K, K), (K,), (K, d), to be filled: sums over the intervals of w f_k f_l, w f_k, f_k y

    Returns
    -------
    K, shapes in use
    """
    d, G, now = st.ints[DOF], st.ints[FILLED], st.ints[COUNT]
    span, f = np.empty(G), np.zeros((gram.shape[0], G))
    for g in range(G):
        last = g + 1 == G
        span[g] = float((now if last else st.log_at[g + 1]) - st.log_at[g])
        for r in range(d):
            e = (st.par[SUM, r] if last else st.log_sum[g + 1, r]) - st.log_sum[g, r]
            for i in range(st.vec.shape[1]):
                e -= span[g] * st.V[r, i] * st.vec[BASE_X, i]
            y[g, r] = e
    K = G
    for k in range(G):
        for g in range(k, G):
            f[k, g] = 1.0
    for k in range(0, G - 2, 2):
        length = float(now - st.log_at[k])
        for g in range(k, G):
            f[K, g] = (st.log_at[g] - st.log_at[k] + 0.5 * span[g]) / length
        K += 1
    for k in range(K):
        weight[k] = 0.0
        for r in range(d):
            mean[k, r] = 0.0
        for g in range(G):
            weight[k] += span[g] * f[k, g]
            for r in range(d):
                mean[k, r] += f[k, g] * y[g, r]
        for j in range(k + 1):
            a = 0.0
            for g in range(max(onset(k, G), onset(j, G)), G):
                a += span[g] * f[k, g] * f[j, g]
            gram[k, j] = a
            gram[j, k] = a
    return K


@inner
def onset(k: int, G: int) -> int:
    """Entry of the log at which a shape begins."""
    return k if k < G else 2 * (k - G)


@inner
def best_two(
    b_i: F, b_j: F, a_i: F, a_j: F, vv: float, uu: float, blur_i: F, blur_j: F, gram: F, weight: F, w: float, K: int, same: bool
) -> tuple[float, float, int, int]:  # fmt: skip
    """Largest statistic of two drifts of any shapes, the same without what the motion blurs, and the shapes; `same`: both of one sensor."""
    top, sharp, top_k, top_j = -1.0, -1.0, 0, 0
    for k in range(K):
        for j in range(k if same else K):
            c = vv * (gram[k, j] - weight[k] * weight[j] / w) + weight[k] * weight[j] / (w * w) * uu
            det = a_i[k] * a_j[j] - c * c
            if det <= 1e-6 * a_i[k] * a_j[j]:
                continue
            full = (b_i[k] * b_i[k] * a_j[j] - 2.0 * b_i[k] * b_j[j] * c + b_j[j] * b_j[j] * a_i[k]) / det
            s = full
            if blur_i[k] + blur_j[j] > 0.0:
                f, g = (b_i[k] * a_j[j] - b_j[j] * c) / det, (b_j[j] * a_i[k] - b_i[k] * c) / det
                p, q, m = a_j[j] / det + blur_i[k], a_i[k] / det + blur_j[j], -c / det
                s = (f * f * q - 2.0 * f * g * m + g * g * p) / (p * q - m * m)
            if s > top:
                top, sharp, top_k, top_j = s, full, k, j
    return top, sharp, top_k, top_j


@inner
def unsteady(st: GlrState, rules: GlrRules, K: int, weight: F, error: F) -> None:
    """Variance that scale factor and mounting add to the size of each shape as one sensor's readings have it, in place in error (K, n).

    The motion of an interval of the log makes an error of one sign while it lasts: what enters is the mean standard deviation over the shape, and
    over what came before it as far as that says where the shape begins, beside all that was learned up to the base.
    """
    n, G, now = st.vec.shape[1], st.ints[FILLED], st.ints[COUNT]
    span, size = np.zeros(G), np.zeros((G, n))
    for g in range(G):
        last = g + 1 == G
        span[g] = float((now if last else st.log_at[g + 1]) - st.log_at[g])
        if span[g] > 0.0:
            face(st, rules, st.par[SUM] if last else st.log_sum[g + 1], st.log_sum[g], span[g], st.par[BASE_LEARNED])
            for i in range(n):
                size[g, i] = np.sqrt(st.vec[ERROR2, i])
    known = 1.0 / max(st.par[LEARNED, WEIGHT], 1e-12)  # samples
    for k in range(K):
        first = onset(k, G)
        length, earlier = float(now - st.log_at[first]), float(st.log_at[first] - st.log_at[0])
        for i in range(n):
            during, before = 0.0, 0.0
            for g in range(first):
                before += span[g] * size[g, i]
            for g in range(first, G):
                part = 1.0 if k < G else (st.log_at[g] - st.log_at[first] + 0.5 * span[g]) / length
                during += part * span[g] * size[g, i]
            error[k, i] = (during / max(weight[k], 1.0) + before / (earlier + known)) ** 2


@jit
def resolve(st: GlrState, rules: GlrRules, S: F, u: F, t: F) -> tuple[int, int, int, int, int]:
    """Who explains what has come since the base of the log: one sensor, with one change or two, or two sensors, each with a change of its own.

    The common mean of the parity vector, of which the base says N(V x, V P V'), is eliminated; what is left of each hypothesis is one or two
    unknown sizes f with information A and A f = b, and the statistic b'A^-1 b. With S = V P V' + I/w, (M^-1 + w I)^-1 = I/w - S^-1/w^2.
    Errors that grow with the motion do not average out: they add their variance to A^-1.

    Returns
    -------
    verdict : QUIET: the alarm has passed; DOUBTFUL: not resolved yet; OPENED
    first, second : sensors; when in doubt, those that explain it best so far; -1: none; both the same: it changed twice
    shape_first, shape_second : as in `shapes`
    """
    n, d, G, now = st.vec.shape[1], st.ints[DOF], st.ints[FILLED], st.ints[COUNT]
    w = float(now - st.log_at[0])
    nu = np.zeros(d)
    for r in range(d):
        nu[r] = st.par[SUM, r] - st.par[BASE_SUM, r]
        for i in range(n):
            nu[r] -= w * st.V[r, i] * st.vec[BASE_X, i]
        for c in range(r + 1):
            a = 1.0 / w if r == c else 0.0
            for i in range(n):
                b = 0.0
                for j in range(n):
                    b += st.mat[BASE_COV, i, j] * st.V[c, j]
                a += st.V[r, i] * (b + (wander(st, rules, i, now) * w / 3.0 + rules.each[FLOOR2, i]) * st.V[c, i])
            S[r, c] = a
    if w < 1.0 or not whiten(st.V, d, nu, S, u, t):
        return QUIET, -1, -1, 0, 0
    most_shapes = G + (G + 1) // 2
    y, gram, weight, mean = np.empty((G, d)), np.empty((most_shapes, most_shapes)), np.empty(most_shapes), np.empty((most_shapes, d))
    K = shapes(st, w, y, gram, weight, mean)
    rhs, info = np.zeros((n, K)), np.ones((n, K))
    vv, uu = np.zeros((n, n)), np.zeros((n, n))
    single, one, two = np.full(n, -1.0), np.zeros(n, np.int64), np.full(n, -1)
    error, blur, sharp = np.zeros((K, n)), np.zeros((n, K)), np.full(n, -1.0)  # sharp: as `single`, without what the motion blurs
    if rules.moving:
        unsteady(st, rules, K, weight, error)
    best, value = -1, -1.0
    for i in range(n):
        for j in range(n):
            for r in range(d):
                vv[i, j] += st.V[r, i] * st.V[r, j]
                uu[i, j] += u[r, i] * u[r, j]
        if vv[i, i] <= 1e-12 / rules.each[SIGMA2, i]:
            continue
        if rules.moving:
            for k in range(K):
                for j in range(n):
                    blur[i, k] += vv[i, j] * vv[i, j] * error[k, j]
                blur[i, k] /= vv[i, i] * vv[i, i]
        bonus = rules.bonus if st.whole[STATE, i] == OPEN else 0.0
        along = 0.0
        for r in range(d):
            along += u[r, i] * t[r]
        for k in range(K):
            b = weight[k] / (w * w) * along
            for r in range(d):
                b += st.V[r, i] * (mean[k, r] - weight[k] / w * nu[r])
            rhs[i, k] = b
            info[i, k] = vv[i, i] * (gram[k, k] - weight[k] * weight[k] / w) + weight[k] * weight[k] / (w * w) * uu[i, i]
            s = b * b / (info[i, k] + info[i, k] * info[i, k] * blur[i, k]) + bonus
            if s > single[i]:
                single[i], one[i], sharp[i] = s, k, b * b / info[i, k] + bonus
        s, full, k, j = best_two(rhs[i], rhs[i], info[i], info[i], vv[i, i], uu[i, i], blur[i], blur[i], gram, weight, w, K, True)
        if s + bonus - rules.twice > single[i]:
            single[i], one[i], two[i], sharp[i] = s + bonus - rules.twice, k, j, full + bonus - rules.twice
        if single[i] > value:
            best, value = i, single[i]
    if best < 0 or value < 0.5 * (rules.again if st.whole[STATE, best] == OPEN else rules.alarm):
        return QUIET, -1, -1, 0, 0
    if d < 2:
        return DOUBTFUL, -1, -1, 0, 0
    runner, first, second, shape_first, shape_second, most, next_most, most_sharp = -1.0, -1, -1, 0, 0, -1.0, -1.0, -1.0
    for i in range(n):
        if single[i] < 0.0:
            continue
        if i != best:
            runner = max(runner, single[i])
        for j in range(i + 1, n):
            if d < 3 or single[j] < 0.0:
                continue
            s, full, k, q = best_two(rhs[i], rhs[j], info[i], info[j], vv[i, j], uu[i, j], blur[i], blur[j], gram, weight, w, K, False)
            bonus = (rules.bonus if st.whole[STATE, i] == OPEN else 0.0) + (rules.bonus if st.whole[STATE, j] == OPEN else 0.0)
            s += bonus
            if s > most:
                next_most = most
                first, second, shape_first, shape_second, most, most_sharp = i, j, k, q, s, full + bonus
            elif s > next_most:
                next_most = s
    # what the best one leaves of the scatter of the log, noise and misfit: differences count in units of it
    left = -max(sharp[best], most_sharp)
    for r in range(d):
        left += t[r] * t[r] / (w * w) - nu[r] * nu[r] / w
        for g in range(G):
            span = float((now if g + 1 == G else st.log_at[g + 1]) - st.log_at[g])
            if span > 0.0:
                left += y[g, r] * y[g, r] / span
    misfit = max(1.0, left / max(d * G - 2, 1))
    if most - value < rules.parsimony * misfit:
        ahead = (value - runner) / misfit
        sure = value >= rules.sure * misfit or st.whole[STATE, best] == OPEN
        first, second, shape_first, shape_second = best, best if two[best] >= 0 else -1, one[best], two[best]
    else:
        ahead = (most - next_most) / misfit
        sure = most >= rules.sure * misfit
    if sure and ahead >= rules.margin:
        return OPENED, first, second, shape_first, shape_second
    if ahead >= rules.lead:
        return DOUBTFUL, first, second, shape_first, shape_second
    return DOUBTFUL, -1, -1, 0, 0


@inner
def growth(st: GlrState, i: int, age: int) -> float:
    """Variance of a step for a drift that has become about as large as the parity of the last half of the log along its sensor, within `age`."""
    g = st.ints[FILLED] // 2
    w = float(st.ints[COUNT] - st.log_at[g])
    a, b = 0.0, 0.0
    for r in range(st.ints[DOF]):
        e = (st.par[SUM, r] - st.log_sum[g, r]) / w
        for k in range(st.vec.shape[1]):
            e -= st.V[r, k] * st.vec[BASE_X, k]
        a += st.V[r, i] * e
        b += st.V[r, i] * st.V[r, i]
    return float((a / b) ** 2 / age)


@jit
def take_in(st: GlrState, rules: GlrRules, first: int, second: int, shape_first: int, shape_second: int) -> None:
    """From the base of the log on, let the drift of up to two sensors be anything from its onset on, and take in what has come since.

    One that grows like a ramp wanders while the log is taken in, by as much as the parities say.
    """
    n, d, G = st.vec.shape[1], st.ints[DOF], st.ints[FILLED]
    mean = np.empty(d)
    for g in range(G):
        for i, shape in ((first, shape_first), (second, shape_second)):
            if i >= 0 and g == onset(shape, G):
                st.mat[COV, i, i] += rules.each[SIGMA2, i] * rules.diffuse**2
        end = st.log_at[g + 1] if g + 1 < G else st.ints[COUNT]
        w = end - st.log_at[g]
        if w < 1:
            continue
        for r in range(d):
            mean[r] = ((st.log_sum[g + 1, r] if g + 1 < G else st.par[SUM, r]) - st.log_sum[g, r]) / w
        for i in range(n):
            st.mat[COV, i, i] += w * wander(st, rules, i, end)
        for i, shape in ((first, shape_first), (second, shape_second)):
            if i >= 0 and shape >= G and g > onset(shape, G):
                st.mat[COV, i, i] += w * growth(st, i, st.ints[COUNT] - st.log_at[onset(shape, G)])
        for i in range(n):
            st.vec[TOTAL, i] += w * st.vec[X, i]
            for j in range(n):
                st.mat[CROSS, i, j] += w * st.mat[COV, i, j]
        absorb(st.V, d, mean, 1.0 / w, st.vec[X], st.mat[COV], st.mat[CROSS], st.vec[TOTAL])
