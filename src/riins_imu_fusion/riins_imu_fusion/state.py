"""The arrays and codes that the fusion kernel and the pipeline share.

Lives here: input, output, rules, tables and memory of the loop as tuples of plain arrays, and the meaning of their elements.
Does not live here: what is done with them (kernel.py, pipeline.py, tables.py).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from riins_fdi.health import ALWAYS_NS, NEVER_NS
from riins_imu_fusion.glr_kf_state import GlrRules, GlrState
from riins_imu_fusion.sequences import SequenceState

F = NDArray[np.float64]
I = NDArray[np.int64]  # noqa: E741
U = NDArray[np.uint64]
B = NDArray[np.bool_]

# why fuse_samples came back
DONE, EVENT, TICK, RESTART, COMMAND, NEED_TABLE, NEED_DRIFT = 0, 1, 2, 4, 8, 16, 32
# verdicts
NONE, GOOD, BAD = 0, 1, 2
# alarms
QUIET, RESOLVED, UNRESOLVED = 0, 1, 2
# reasons, as types.Reason
PARITY, STUCK, NOT_FINITE, SATURATED, INVALID = 1, 2, 3, 4, 5
# elements of State.clock
LAST, HAVE, SEQUENCE, NEXT_COMMAND, FORCE_STATUS, SOLUTION, COMPENSATED = 0, 1, 2, 3, 4, 5, 6
CLOCK_SIZE = 7
# elements of Past.place
OPEN, FILLED, NEWEST = 0, 1, 2
# what is missing, State.need[1]
TABLE, TEST, SEQUENCES = 0, 1, 2
# rows of DriftState.vec
ESTIMATE, STEP, COMPENSATION, TOTAL, WALK = 0, 1, 2, 3, 4
# elements of Rules.drift
FORGETTING, SOFTENING, MEMORY, FEEDBACK = 0, 1, 2, 3
# elements of State.counts
RECEIVED, FUSED, LOST, REJECTED_LENGTH, REJECTED_STAMP, REJECTED_NO_SOLUTION, RESTARTS = 0, 1, 2, 3, 4, 5, 6
COUNTS_SIZE = 7


class Block(NamedTuple):
    """Input: m samples of 2 n sensors."""

    stamp: I
    sequence: NDArray[np.uint32]
    gyro: F
    accel: F
    gyro_valid: U
    accel_valid: U


class Output(NamedTuple):
    """Room for m fused samples; leading axis 2: rate, force."""

    stamp: I
    sequence: NDArray[np.uint32]
    fused: F  # (2, m, 3)
    used: U  # (2, m)
    statistic: F  # (2, m)
    drift: F  # (2, m, n), removed
    excess: F  # (2, m, 3, 3), covariance beyond that of the stated white noise


def room(m: int, n: int) -> Output:
    """Output of m samples of n sensors of each kind, not filled."""
    whole, words = np.empty(m, np.int64), np.empty(m, np.uint32)
    return Output(
        whole, words, np.empty((2, m, 3)), np.empty((2, m), np.uint64), np.empty((2, m)), np.empty((2, m, n)), np.empty((2, m, 3, 3))
    )  # fmt: skip


class Rules(NamedTuple):
    """What does not change during a run."""

    H: F  # (n, 3)
    limit: F  # (2,)
    group: I  # (n,), unit of each sensor; -1: none
    grouped: bool  # there are units
    fusion: int  # number of the fusion method, corrections.FUSION
    test: int  # of the parity test, judges.PARITY_TESTS
    sequential: int  # of the test over many samples, sequences.SEQUENTIAL_TESTS
    threshold: F  # (n - 2,), of the GLT by degrees of freedom; [0] is infinite
    judge_threshold: float  # of one normalized squared residual
    max_delay: int  # ns
    lost_limit: int  # a larger jump of the sequence is a new numbering
    stuck: int  # equal samples; 0: never
    status_period: int  # ns; 0: no ticks
    doubt_time: int  # ns
    period: float  # s, nominal
    record: int  # ns, length of a record of the past; 0: none is kept
    glr: tuple[GlrRules, GlrRules]
    drift: F  # (4,), of opt, aopt and optdc
    noise: bool  # the noise is estimated
    moving: bool  # scale factor and mounting errors are in the tests
    errors: F  # (2, 2), their variances, elements as in riins_fdi.motion


class Tables(NamedTuple):
    """Tests and estimators of the sets of sensors met so far; axes (kind, slot, ...)."""

    key: U  # (2, s), set of sensors as bits
    filled: I  # (2,), slots in use
    dof: I  # (2, s), -1: no solution
    W: F  # (2, s, 3, n)
    whitened: F  # (2, s, d, n)
    gain: F  # (2, s, n)
    pick: F  # (2, s, n), weight by which the parity test names a sensor
    rows: F  # (2, s, q, n), equations of unit variance that the parity test looks at
    members: U  # (2, s, q), sensors of each
    level: F  # (2, s), threshold of the largest of them; negative: not made yet
    isolable: B  # (2, s, n)
    member: F  # (2, s, n), 1: in the set
    V: F  # (2, s, d, n), parity matrix scaled to unit white noise
    reach: F  # (2, s, n), 1 / variance of the residual of a sensor outside the set
    extra: F  # (2, s, 3, 3), covariance of the fused white noise as estimated, less that of the noise stated


class Past(NamedTuple):
    """Ring of records of what was fused lately. A record ends at a grid of stamps, and where the set of sensors used changes."""

    place: I  # (3,), the open record, records filled, stamp of the newest sample
    end: I  # (r,), stamp of the grid at which it ends
    last: I  # (r,), stamp of its last sample
    span: F  # (r, 2), sums of dt [s] and dt^2
    used: U  # (r, 2)
    sum: F  # (r, 2, n), sum of dt z


class DriftState(NamedTuple):
    """Memory of opt, aopt and optdc, and what rfdc and irfdc say of the sample at hand, leading axis 2."""

    vec: F  # (2, 5, n), drift left in the readings, variance of its step, part taken out of them, sum of that part's absolute steps, step as stated
    P: F  # (2, n, n), covariance of the drift
    kept: F  # (2, n, n), as it is said: aopt
    past: F  # (2, 2), trace of the innovation covariance, samples so far: aopt
    spread: F  # (2, 3, 3), covariance of the fused sample from what is left of the drifts: rfdc, irfdc

    @classmethod
    def of(cls, n: int) -> DriftState:
        """Zeros for n sensors."""
        return cls(np.zeros((2, 5, n)), np.zeros((2, n, n)), np.zeros((2, n, n)), np.zeros((2, 2)), np.zeros((2, 3, 3)))


class NoiseState(NamedTuple):
    """Memory of the noise estimation, leading axis 2; see noise_estimation.autocovariance_block."""

    key: U  # (2,), set of sensors it works with
    V: F  # (2, d, n)
    s: F  # (2, d)
    ring: F  # (2, N, d)
    sums: F  # (2, N, d, d)
    number: F  # (2, 2 + N)


class State(NamedTuple):
    """All that the loop remembers from sample to sample; axes (kind, sensor)."""

    clock: I
    counts: I
    value: F
    repeat: I
    base: B  # in use by the health machine
    judged: B  # out, but on the way back
    wake: I  # (2, 2, n), stamps from which a passed [0] and a failed [1] test concern the health machine
    calm: U  # (2,), sensors in use if all of them are healthy and nobody is on the way back; else the empty set
    mean_sum: F
    mean_count: I
    verdict: I
    why: I  # reason of a failed check or verdict, 0: none
    wakes: B
    left_out: I  # (2, n, 8)
    z: F  # measurements of the last sample, 0 where there is none
    tested: F  # (2, n), measurements without the drifts known before
    clean: F  # (2, n), without what is removed
    x: F  # (2, 3)
    valid: U  # (2,), sensors with a value that can be used
    key: U  # (2,), set tested
    slot: I  # (2,), its table
    used: U  # (2,), set fused
    used_slot: I
    statistic: F  # (2,)
    alarm: I  # (2,)
    leave: U  # (2,), sensors left out by the parity test
    suspect: I  # (2,)
    doubt: I  # (2,), 1: doubtful
    doubt_last: I  # (2,), stamp of the last unresolved alarm
    need: I  # (2,), kind of the table that is missing, and what of it
    need_key: U  # (1,)
    past: Past
    glr: tuple[GlrState, GlrState]
    drift: DriftState
    sequence: SequenceState
    noise: NoiseState


def fresh_state(n: int, records: int, glr: tuple[GlrState, GlrState], drift: DriftState, sequence: SequenceState, noise: NoiseState) -> State:
    """State before the first sample of n sensors of each kind, with room for `records` of the past."""

    def whole(*shape: int) -> NDArray[np.int64]:
        return np.zeros(shape, np.int64)

    clock = whole(CLOCK_SIZE)
    clock[NEXT_COMMAND] = NEVER_NS
    clock[SOLUTION] = 1
    clock[COMPENSATED] = ALWAYS_NS
    return State(
        clock=clock,
        counts=whole(COUNTS_SIZE),
        value=np.full((2, n), np.nan),
        repeat=whole(2, n),
        base=np.ones((2, n), np.bool_),
        judged=np.zeros((2, n), np.bool_),
        wake=whole(2, 2, n),
        calm=np.zeros(2, np.uint64),
        mean_sum=np.zeros((2, n)),
        mean_count=whole(2, n),
        verdict=whole(2, n),
        why=whole(2, n),
        wakes=np.zeros((2, n), np.bool_),
        left_out=whole(2, n, 8),
        z=np.zeros((2, n)),
        tested=np.zeros((2, n)),
        clean=np.zeros((2, n)),
        x=np.zeros((2, 3)),
        valid=np.zeros(2, np.uint64),
        key=np.zeros(2, np.uint64),
        slot=whole(2),
        used=np.zeros(2, np.uint64),
        used_slot=whole(2),
        statistic=np.full(2, np.nan),
        alarm=whole(2),
        leave=np.zeros(2, np.uint64),
        suspect=np.full(2, -1, np.int64),
        doubt=whole(2),
        doubt_last=whole(2),
        need=whole(2),
        need_key=np.zeros(1, np.uint64),
        past=Past(
            place=whole(3),
            end=whole(records),
            last=whole(records),
            span=np.zeros((records, 2)),
            used=np.zeros((records, 2), np.uint64),
            sum=np.zeros((records, 2, n)),
        ),
        glr=glr,
        drift=drift,
        sequence=sequence,
        noise=noise,
    )
