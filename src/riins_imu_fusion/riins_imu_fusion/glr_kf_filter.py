"""The filter of `glr_kf`: Kalman update with a parity vector, the moments it remembers, how a drift is expected to wander.

Lives here: the kernels the other two modules build on, in place on the arrays of a `GlrState`.
Does not live here: alarms (glr_kf_kernel.py), who explains one (glr_kf_resolve.py).
"""

from __future__ import annotations

import numpy as np

from riins_core.jit import inner
from riins_fdi.motion import SCALE2, TILT2, errors_at

from .glr_kf_state import (
    ANEW,
    AT,
    CLOSED,
    COUNT,
    COV,
    COV_THEN,
    CROSS,
    CROSS_THEN,
    DOF,
    ERROR2,
    EXPECTED,
    JUMP,
    LEARNED,
    MOTION,
    OPENED_AT,
    SLOTS,
    STATE,
    SUM,
    SUM_THEN,
    TOTAL,
    TOTAL_THEN,
    WALK,
    X_THEN,
    F,
    GlrRules,
    GlrState,
    X,
)  # fmt: skip


@inner
def absorb(V: F, d: int, p: F, variance: float, x: F, P: F, C: F, total: F) -> None:
    """Kalman update with a parity vector (d,) of unit noise times sqrt(variance), row by row; `total` is carried along by C."""
    n = x.shape[0]
    Ph, Ch = np.empty(n), np.empty(n)
    for r in range(d):
        s = variance
        e = p[r]
        for i in range(n):
            Ph[i] = 0.0
        for j in range(n):  # P is symmetric: row by row, a processor takes several columns at once
            v = V[r, j]
            for i in range(n):
                Ph[i] += P[j, i] * v
        for i in range(n):
            b = 0.0
            for j in range(n):
                b += C[i, j] * V[r, j]
            Ch[i] = b
            s += V[r, i] * Ph[i]
            e -= V[r, i] * x[i]
        g = 1.0 / s
        for i in range(n):
            k = Ph[i] * g
            x[i] += k * e
            total[i] += Ch[i] * g * e
            for j in range(i + 1):
                P[i, j] -= k * Ph[j]
            for j in range(i):
                P[j, i] = P[i, j]
            k = Ch[i] * g
            for j in range(n):
                C[i, j] -= k * Ph[j]


@inner
def remember(st: GlrState, level: int) -> None:
    """Keep the present moment on a level."""
    n, s = st.vec.shape[1], st.ring[level, 0]
    st.ring[level, 0] = (s + 1) % SLOTS
    st.ring[level, 1] = min(SLOTS, st.ring[level, 1] + 1)
    st.ring[level, AT + s] = st.ints[COUNT]
    for r in range(st.ints[DOF]):
        st.r_par[level, s, SUM_THEN, r] = st.par[SUM, r]
        a = 0.0
        for i in range(n):
            a += st.V[r, i] * st.vec[X, i]
        st.r_par[level, s, EXPECTED, r] = a
    for c in range(st.par.shape[1] - MOTION, st.par.shape[1]):
        st.r_par[level, s, SUM_THEN, c] = st.par[SUM, c]
        st.r_par[level, s, EXPECTED, c] = st.par[LEARNED, c]
    for i in range(n):
        st.r_vec[level, s, X_THEN, i] = st.vec[X, i]
        st.r_vec[level, s, TOTAL_THEN, i] = st.vec[TOTAL, i]
        for j in range(n):
            st.r_mat[level, s, COV_THEN, i, j] = st.mat[COV, i, j]
            st.r_mat[level, s, CROSS_THEN, i, j] = st.mat[CROSS, i, j]


@inner
def face(st: GlrState, rules: GlrRules, total: F, before: F, span: float, learned: F) -> None:
    """st.vec[ERROR2] for the mean motion over `span` samples, from two sums of par's width, against that at which the biases were learned.

    A bias is learned with what scale factor and mounting make of the motion at that time: only the difference counts, and it does not average out.
    """
    c = total.shape[0] - MOTION
    errors_at(
        rules.H, (total[c] - before[c]) / span - learned[c], (total[c + 1] - before[c + 1]) / span - learned[c + 1],
        (total[c + 2] - before[c + 2]) / span - learned[c + 2], rules.errors[SCALE2], rules.errors[TILT2], st.vec[ERROR2],
    )  # fmt: skip


@inner
def begin_anew(st: GlrState) -> None:
    """Begin all windows at the present moment."""
    st.ints[ANEW] = 0
    for level in range(st.ring.shape[0]):
        st.ring[level, 0] = 0
        st.ring[level, 1] = 0
        remember(st, level)


@inner
def whiten(V: F, d: int, nu: F, S: F, u: F, t: F) -> bool:
    """t = L^-1 nu, u = L^-1 V with S = L L', in place; False: S is not positive definite. S is destroyed."""
    n = V.shape[1]
    for r in range(d):
        for c in range(r + 1):
            a = S[r, c]
            for k in range(c):
                a -= S[r, k] * S[c, k]
            if r == c:
                if not a > 0.0:
                    return False
                S[r, r] = np.sqrt(a)
            else:
                S[r, c] = a / S[c, c]
        a = nu[r]
        for k in range(r):
            a -= S[r, k] * t[k]
        t[r] = a / S[r, r]
        for i in range(n):
            a = V[r, i]
            for k in range(r):
                a -= S[r, k] * u[k, i]
            u[r, i] = a / S[r, r]
    return True


@inner
def wander(st: GlrState, rules: GlrRules, i: int, count: int) -> float:
    """Variance of the step of a sensor's drift: of one that is open, as if it changed by `restless` of its size whenever its age has grown e-fold."""
    if st.whole[STATE, i] == CLOSED:
        return float(st.vec[WALK, i])
    return float(st.vec[WALK, i] + (rules.restless * st.vec[JUMP, i]) ** 2 / max(count - st.whole[OPENED_AT, i], 1))
