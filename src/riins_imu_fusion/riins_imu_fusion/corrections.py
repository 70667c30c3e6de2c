"""What is taken out of the readings before least squares: the drifts that a filter on the parity vector has found.

Lives here: the kernels by which the fusion loop asks the filter of each kind of sensor, lets it learn, and adds its uncertainty.
Does not live here: the filters (glr_kf_kernel.py, optimal.py, adaptive.py), the loop (kernel.py), what follows from their findings (compensation.py).
"""

from __future__ import annotations

import numpy as np

from riins_core.jit import inner
from riins_imu_fusion.adaptive import adaptive_step
from riins_imu_fusion.drift_compensated import feed_back
from riins_imu_fusion.glr_kf_kernel import hold, other_set, step

# isort: off
from riins_imu_fusion.glr_kf_state import (
    ACTIVE, CALL, CHANGED, COV, NONE, OPEN, REMOVED, STATE, USED, GlrRules, GlrState, I, X,
)  # fmt: skip

# isort: on
from riins_imu_fusion.optimal import optimal_step
from riins_imu_fusion.state import COMPENSATION, ESTIMATE, FEEDBACK, FORGETTING, MEMORY, QUIET, SOFTENING, STEP, TOTAL, WALK, DriftState, F

WLS, GLR_KF, OPT, AOPT, OPTDC, RFDC, IRFDC = 0, 1, 2, 3, 4, 5, 6
FUSION = {"wls": WLS, "glr_kf": GLR_KF, "opt": OPT, "aopt": AOPT, "optdc": OPTDC, "rfdc": RFDC, "irfdc": IRFDC}
"""Number of each fusion method by the name that methods.METHODS gives it; rfdc and irfdc: riins_fdi.drift."""


@inner
def known(kind: int, ints: I, vec: F, z: F, tested: F) -> None:
    """Measurements without the drifts that glr_kf knew before this sample; those of the others stay in: they answer for no threshold."""
    for i in range(z.shape[1]):
        tested[kind, i] = z[kind, i]
        if ints[ACTIVE] == 1 and vec[USED, i] > 0.0:
            tested[kind, i] -= vec[X, i]


@inner
def follow(
    kind: int, fusion: int, alarm: int, dof: int, V: F, member: F, W: F, z: F, numbers: F, st: DriftState, clean: F, removed: F, excess: F
) -> None:  # fmt: skip
    """Opt, aopt or optdc: let the filter see the sample, take the drifts from it, add the covariance of what is left of them.

    Parameters
    ----------
    V : (d, n), parity matrix of the sensors in use, scaled to white noise of unit variance
    member, W : (n,), (3, n), of the sensors fused
    z, clean : (2, n)
    numbers : see state.Rules
    removed, excess : (n,), (3, 3), written and added to
    """
    n = z.shape[1]
    d, Q, D, total, P = st.vec[kind, ESTIMATE], st.vec[kind, STEP], st.vec[kind, COMPENSATION], st.vec[kind, TOTAL], st.P[kind]
    said = st.kept[kind] if fusion == AOPT else P
    left = np.empty(n)
    for i in range(n):
        left[i] = z[kind, i] - D[i]
    if alarm != QUIET or dof < 1:  # not even the sensors in use agree: nothing to learn
        for i in range(n):
            P[i, i] += Q[i]
            st.kept[kind, i, i] += st.vec[kind, WALK, i]
    else:
        p, dz, S, e, RV = np.empty(dof), np.empty(dof), np.empty((dof, dof)), np.empty(dof), np.eye(dof)
        if fusion == AOPT:
            b, beta, rho = numbers[FORGETTING], numbers[SOFTENING], numbers[MEMORY]
            adaptive_step(
                d, P, Q, st.past[kind], st.vec[kind, WALK], said, b, beta, rho, V[:dof], RV, left, p, dz, S, e, np.empty(n), np.empty(n)
            )  # fmt: skip
        else:
            optimal_step(d, P, Q, V[:dof], RV, left, p, dz, S, e)
    for i in range(n):
        removed[i] = (D[i] + d[i]) * member[i]
        clean[kind, i] = left[i] - d[i]
    if fusion == OPTDC:
        feed_back(d, D, total, numbers[FEEDBACK], np.empty(n))
    for i in range(n):
        for j in range(n):
            for a in range(3):
                for b in range(3):
                    excess[a, b] += W[a, i] * said[i, j] * W[b, j]


@inner
def take_out(kind: int, member: F, st: DriftState, z: F, clean: F, removed: F, excess: F) -> None:
    """Rfdc or irfdc: what rfdc.py has said of this sample; parameters as in `follow`."""
    for i in range(z.shape[1]):
        removed[i] = st.vec[kind, COMPENSATION, i] * member[i]
        clean[kind, i] = z[kind, i] - removed[i]
    for a in range(3):
        for b in range(3):
            excess[a, b] += st.spread[kind, a, b]


@inner
def learn(
    kind: int, alarm: int, dof: int, member: F, z: F, glr: GlrState, rules: GlrRules, clean: F, drift: F
) -> bool:  # fmt: skip
    """Let the filter see the sample and take the drifts from it; True: it asks for an answer, or a sensor was closed or found dead."""
    n = z.shape[1]
    if alarm != QUIET or dof < 1:
        hold(glr)  # not even the sensors in use agree: nothing to learn
    elif not other_set(glr, rules, member):
        step(z[kind], glr, rules)
    if glr.ints[ACTIVE] == 0:
        return bool(glr.ints[CALL] != NONE)
    for i in range(n):
        clean[kind, i] = z[kind, i] - glr.vec[REMOVED, i]
        if glr.whole[STATE, i] == OPEN and member[i] > 0.0:
            drift[i] = glr.vec[X, i]
    return bool(glr.ints[CALL] != NONE or glr.ints[CHANGED] == 1)


@inner
def add_excess(glr: GlrState, rules: GlrRules, W: F, excess: F) -> None:
    """Mean square that what is removed adds to the error of the fused sample.

    That of drifts and biases, W P W', less that of the ordinary bias of the fused output which no parity sees and the sample has in any case;
    and what is put into this sample to make up for earlier ones.
    """
    n = W.shape[1]
    repaid = np.zeros(3)
    for i in range(n):
        for a in range(3):
            repaid[a] += W[a, i] * (glr.vec[REMOVED, i] - glr.vec[X, i])
    for a in range(3):
        for b in range(a + 1):
            s = repaid[a] * repaid[b] - rules.common[a, b]
            for i in range(n):
                for j in range(n):
                    s += W[a, i] * glr.mat[COV, i, j] * W[b, j]
            excess[a, b] += s
            if a != b:
                excess[b, a] += s
