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
COUNT, DOF, ACTIVE, DOUBT, FILLED, STRIDE, FIRST, SECOND, BASED, STRANGE = range(10)
"""samples; rows of V; 1: something has been removed; 1: an alarm is being resolved; entries of the log; samples between its entries; 1 + each of
the sensors taken for the cause for the time being, 0: none; 1: there is a set of sensors; samples in a row with another one"""
INTS = 10
LOG = 24
"""Entries of the log of an alarm."""
# GlrState.open
CLOSED, OPEN = 0, 1


class GlrRules(NamedTuple):
    """What does not change during a run."""

    batch: int  # samples worked in at once: each is 1/batch of the filter's cost
    sigma2: F  # (n,), variance of the white noise of a sample
    prior2: F  # (n,), variance of the ordinary bias
    walk: F  # (n,), variance of the bias' step before each sample, of a healthy sensor
    floor2: F  # (n,), variance of a part of the bias that changes with the motion and does not average out over any window
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
    patience: int  # samples in a row with another set of sensors before it is worked with


class GlrState(NamedTuple):
    """All that the filter remembers, of one kind of sensor."""

    ints: I
    used: F  # (n,), 1: in the set of sensors
    V: F  # (d, n), parity matrix scaled to unit noise; rows beyond DOF and columns of sensors not used are zero
    x: F  # (n,), bias and drift of each sensor
    P: F  # (n, n)
    C: F  # (n, n), covariance of the error of `total` with that of `x`
    total: F  # (n,), integral of the drift: sum over the samples, estimated
    paid: F  # (n,), sum of what has been removed
    walk: F  # (n,)
    open: I  # (n,)
    opened: I  # (n,), count when it was opened the last time
    jump: F  # (n,), drift found then
    noise: F  # (n,), mean square of the residual along the sensor, 1 when all is well
    p: F  # (d,), parity of the last sample
    sum: F  # (d,), of all parities
    done: F  # (d,), of those worked in
    c: F  # (n,), what is removed from the last sample
    ring: I  # (L, 2), next slot, slots filled
    at: I  # (L, SLOTS), count
    r_sum: F  # (L, SLOTS, d)
    r_mean: F  # (L, SLOTS, d), parity expected
    r_x: F
    r_P: F
    r_C: F
    r_total: F
    base_x: F  # the moment before the alarm's onset: (n,)
    base_P: F
    base_C: F
    base_total: F
    base_sum: F
    log_at: I  # (LOG,), counts since; the first is that of the base
    log_sum: F  # (LOG, d)


def fresh(n: int, levels: int) -> GlrState:
    """State before the first sample, without a set of sensors: `rebase` gives it one."""
    d = max(1, n - 3)

    def z(*shape: int) -> F:
        return np.zeros(shape)

    def whole(*shape: int) -> I:
        return np.zeros(shape, np.int64)

    return GlrState(
        ints=whole(INTS), used=z(n), V=z(d, n), x=z(n), P=z(n, n), C=z(n, n), total=z(n), paid=z(n), walk=z(n), open=whole(n), opened=whole(n),
        jump=z(n), noise=np.ones(n), p=z(d), sum=z(d), done=z(d), c=z(n), ring=whole(levels, 2), at=whole(levels, SLOTS), r_sum=z(levels, SLOTS, d),
        r_mean=z(levels, SLOTS, d),
        r_x=z(levels, SLOTS, n), r_P=z(levels, SLOTS, n, n), r_C=z(levels, SLOTS, n, n), r_total=z(levels, SLOTS, n), base_x=z(n), base_P=z(n, n),
        base_C=z(n, n), base_total=z(n), base_sum=z(d), log_at=whole(LOG), log_sum=z(LOG, d),
    )  # fmt: skip
