"""Memory and rules of the filter `glr_kf`: plain arrays, so that a copy is a roll-back.

Lives here: `GlrState`, `GlrRules`, their making, the change to another set of sensors.
Does not live here: what is done with them (glr_kf_kernel.py), the settings a user sees (glr_kf.py).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

F = NDArray[np.float64]
I = NDArray[np.int64]  # noqa: E741

SLOTS = 8
"""Moments remembered on each level."""

# elements of GlrState.ints
COUNT, DOF, ACTIVE, DOUBT, FILLED, STRIDE, FIRST, SECOND, BASED, STRANGE, CHANGED, SINCE, CALL, LEVEL, SLOT, ANEW, LONG = range(17)
"""samples; rows of V; 1: something has been removed; 1: an alarm is being resolved; entries of the log; samples between its entries; 1 + each of
the sensors taken for the cause for the time being, 0: none; 1: there is a set of sensors; samples in a row with another one;
1: a sensor was opened, closed or found dead; count at the beginning of the alarm; what the loop asks for;
level and slot of an alarm; 1: all windows begin with the next sample;
1: an alarm has gone on for long and nobody is taken for its cause"""
INTS = 17
# values of CALL
NONE, ALARM, RESOLVE, OTHER_SET, NOTE = 0, 1, 2, 3, 4
LOG = 24
"""Entries of the log of an alarm."""
# rows of GlrState.vec
X, TOTAL, PAID, WALK, JUMP, NOISE, REMOVED, USED, BASE_X, BASE_TOTAL, BEFORE, ERROR2 = range(12)
"""bias and drift; its integral: sum over the samples, estimated; sum of what has been removed; variance of the step; drift found at the last opening;
mean square of the residual along the sensor, 1 when all is well; removed from the last sample; 1: in the set of sensors;
X and TOTAL at the base of the log; X before the sensor was opened; variance that the motion in question adds to FLOOR2"""
# matrices of GlrState.mat
COV, CROSS, BASE_COV, BASE_CROSS = range(4)
"""covariance of X; covariance of the error of TOTAL with that of X; both at the base of the log"""
# rows of GlrState.par
PARITY, SUM, DONE, BASE_SUM, LEARNED, BASE_LEARNED = range(6)
"""of the last sample; sum of all; of those worked in; at the base of the log. The last three columns: likewise of the least-squares solution, the
motion, where errors that grow with it are in the model; only those: motion at which the biases were learned, now and at the base of the log"""
MOTION = 3
"""Columns of the motion."""
WEIGHT = 0
"""Column of par[LEARNED]: variance of the mean, in that of a sample's noise; 0: nothing is learned yet."""
# rows of GlrState.whole
STATE, OPENED_AT, SMALL_FOR, DEAD = range(4)
CLOSED, OPEN = 0, 1
"""values of STATE; SMALL_FOR: samples for which the drift of an open sensor has been gone; DEAD, 1: too noisy or too far to be kept"""
# columns of GlrState.ring, and what is remembered of each moment
NEXT, KEPT, AT = 0, 1, 2
SUM_THEN, EXPECTED = 0, 1
X_THEN, TOTAL_THEN = 0, 1
COV_THEN, CROSS_THEN = 0, 1
# rows of GlrRules.each
SIGMA2, PRIOR2, STEP2, FLOOR2 = range(4)
"""variance of the white noise of a sample; of the ordinary bias; of its step before each sample; of a part of it that changes with the motion,
which does not average out over any window"""


class GlrRules(NamedTuple):
    """What does not change during a run."""

    batch: int  # samples worked in at once: each is 1/batch of the filter's cost
    each: F  # (4, n)
    H: F  # (n, 3)
    errors: F  # (2,), variances of scale factor and tilt, elements as in riins_fdi.motion
    moving: bool  # not both are zero
    common: F  # (3, 3), covariance of the ordinary bias of the fused output, which no parity sees
    alarm: float  # threshold of a statistic with one degree of freedom
    sure: float  # below it nobody is opened for the first time: too little to tell one sensor from two
    again: float  # of a sensor that is open already
    margin: float  # by which the best explanation must beat the next one to be final
    lead: float  # and to be acted on for the time being
    bonus: float  # advantage of a sensor that is open already
    twice: float  # and that one sensor changed twice, if this much more than that it did so once
    parsimony: float  # two sensors explain an alarm only if they take this much more off the statistic than one
    diffuse: float  # standard deviation of a newly opened drift, in that of the noise
    restless: float  # part of its size by which an open drift changes as its age grows e-fold
    payback: float  # part of the debt paid at each sample
    noise_gain: float  # of the running mean square of an open sensor's residual
    noise_limit: float  # which an open sensor's mean square must not exceed
    drift_limit: float  # nor its drift this, in sigma of its noise
    close: int  # samples after which a sensor whose drift is gone is closed
    doubt: int  # samples of an unresolved alarm until it is said
    patience: int  # samples in a row with another set of sensors before it is worked with


class GlrState(NamedTuple):
    """All that the filter remembers, of one kind of sensor; few arrays, for a compiler takes each one apart at every call."""

    ints: I
    V: F  # (d, n), parity matrix scaled to unit noise; rows beyond DOF and columns of sensors not used are zero
    W: F  # (3, n), estimator of the set of sensors
    vec: F  # (12, n)
    mat: F  # (4, n, n)
    par: F  # (6, d + 3)
    whole: I  # (4, n)
    ring: I  # (L, 2 + SLOTS), of each level: next slot, slots kept, counts
    r_par: F  # (L, SLOTS, 2, d + 3)
    r_vec: F  # (L, SLOTS, 2, n)
    r_mat: F  # (L, SLOTS, 2, n, n)
    log_at: I  # (LOG,), counts since an alarm; the first is that of the base
    log_sum: F  # (LOG, d + 3)
    owed: F  # (3,), sum over the samples of what sensors that have left put into the fused output, still to be removed

    @property
    def x(self) -> F:
        """Bias and drift of each sensor (n,)."""
        return self.vec[X]

    @property
    def P(self) -> F:
        """Its covariance (n, n)."""
        return self.mat[COV]

    @property
    def open(self) -> I:
        """Which sensors are open (n,)."""
        return self.whole[STATE]


def fresh(n: int, levels: int) -> GlrState:
    """State before the first sample, without a set of sensors: the first one gives it."""
    d = max(1, n - 3)
    state = GlrState(
        ints=np.zeros(INTS, np.int64),
        V=np.zeros((d, n)),
        W=np.zeros((3, n)),
        vec=np.zeros((12, n)),
        mat=np.zeros((4, n, n)),
        par=np.zeros((6, d + MOTION)),
        whole=np.zeros((4, n), np.int64),
        ring=np.zeros((levels, 2 + SLOTS), np.int64),
        r_par=np.zeros((levels, SLOTS, 2, d + MOTION)),
        r_vec=np.zeros((levels, SLOTS, 2, n)),
        r_mat=np.zeros((levels, SLOTS, 2, n, n)),
        log_at=np.zeros(LOG, np.int64),
        log_sum=np.zeros((LOG, d + MOTION)),
        owed=np.zeros(3),
    )
    state.vec[NOISE] = 1.0
    return state
