"""The filter of `glr_kf`: Kalman update with a parity vector, the moments it remembers, how a drift is expected to wander.

Lives here: the kernels the other two modules build on, in place on the arrays of a `GlrState`.
Does not live here: alarms (glr_kf_kernel.py), who explains one (glr_kf_resolve.py).
"""

from __future__ import annotations

import numpy as np

from riins_core.jit import jit

from .glr_kf_state import CLOSED, COUNT, DOF, SLOTS, F, GlrRules, GlrState


@jit
def absorb(V: F, d: int, p: F, variance: float, x: F, P: F, C: F, total: F) -> None:
    """Kalman update with a parity vector (d,) of unit noise times sqrt(variance), row by row; `total` is carried along by C."""
    n = x.shape[0]
    Ph, Ch = np.empty(n), np.empty(n)
    for r in range(d):
        s = variance
        e = p[r]
        for i in range(n):
            a = 0.0
            b = 0.0
            for j in range(n):
                a += P[i, j] * V[r, j]
                b += C[i, j] * V[r, j]
            Ph[i] = a
            Ch[i] = b
            s += V[r, i] * a
            e -= V[r, i] * x[i]
        g = 1.0 / s
        for i in range(n):
            k = Ph[i] * g
            x[i] += k * e
            total[i] += Ch[i] * g * e
            for j in range(i + 1):
                P[i, j] -= k * Ph[j]
                P[j, i] = P[i, j]
            k = Ch[i] * g
            for j in range(n):
                C[i, j] -= k * Ph[j]


@jit
def remember(st: GlrState, level: int) -> None:
    """Keep the present moment on a level."""
    s = st.ring[level, 0]
    st.ring[level, 0] = (s + 1) % SLOTS
    st.ring[level, 1] = min(SLOTS, st.ring[level, 1] + 1)
    st.at[level, s] = st.ints[COUNT]
    for r in range(st.ints[DOF]):
        st.r_sum[level, s, r] = st.sum[r]
        a = 0.0
        for i in range(st.x.shape[0]):
            a += st.V[r, i] * st.x[i]
        st.r_mean[level, s, r] = a
    st.r_x[level, s] = st.x
    st.r_P[level, s] = st.P
    st.r_C[level, s] = st.C
    st.r_total[level, s] = st.total


@jit
def forget(st: GlrState) -> None:
    """Begin all windows at the present moment."""
    for level in range(st.ring.shape[0]):
        st.ring[level] = 0
        remember(st, level)


@jit
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


@jit
def wander(st: GlrState, rules: GlrRules, i: int, count: int) -> float:
    """Variance of the step of a sensor's drift: of one that is open, as if it changed by `restless` of its size whenever its age has grown e-fold."""
    if st.open[i] == CLOSED:
        return float(st.walk[i])
    return float(st.walk[i] + (rules.restless * st.jump[i]) ** 2 / max(count - st.opened[i], 1))


@jit
def free(st: GlrState, rules: GlrRules, index: int, at: int) -> None:
    """Let the drift of a sensor be anything from now on."""
    st.P[index, index] += rules.sigma2[index] * rules.diffuse**2
