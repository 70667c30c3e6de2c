"""What the compiled loop does with a sample apart from testing and fusing it: axes, numbers, verdicts, records.

Lives here: which axes can be used, sequence numbers, verdicts on sensors in use and on those on the way back, records of the past.
Does not live here: the parity tests (judges.py), the loop (kernel.py), the arrays (state.py).
"""

from __future__ import annotations

import numpy as np

from riins_core.jit import inner, jit
from riins_fdi.motion import SCALE2, TILT2, errors_at

# isort: off
from riins_imu_fusion.state import (
    BAD, FILLED, GOOD, INVALID, LOST, NEWEST, NONE, NOT_FINITE, OPEN, PARITY, RESOLVED, SATURATED, SEQUENCE, STUCK, UNRESOLVED, B, F, I, Rules, U,
)  # fmt: skip
# isort: on


@jit
def note_sequence(clock: I, counts: I, sequence: int, lost_limit: int) -> None:
    """Count the samples missing before this one; a number that runs back or jumps too far is a new numbering."""
    ahead = (sequence - clock[SEQUENCE]) % 4294967296
    if ahead == 0 or ahead >= 2147483648:
        if (4294967296 - ahead) % 4294967296 > lost_limit:
            clock[SEQUENCE] = sequence
        return
    if ahead - 1 <= lost_limit:
        counts[LOST] += ahead - 1
    clock[SEQUENCE] = sequence


@inner
def check_axes(
    kind: int, k: int, raw: F, valid: U, limit: F, stuck: int, value: F, repeat: I, base: B, z: F, why: I, usable: U
) -> np.uint64:  # fmt: skip
    """Which axes of a sample can be used: why[kind, i] = 0, usable[kind]; returns those in use among them. Nothing is remembered yet."""
    key, every = np.uint64(0), np.uint64(0)
    for i in range(raw.shape[1]):
        v = raw[k, i]
        reason = 0
        if (valid[k] >> np.uint64(i)) & np.uint64(1) == np.uint64(0):
            reason = INVALID
        elif not np.isfinite(v):
            reason = NOT_FINITE
        elif abs(v) >= limit[kind]:
            reason = SATURATED
        elif stuck > 0 and v == value[kind, i] and repeat[kind, i] + 1 >= stuck:
            reason = STUCK
        why[kind, i] = reason
        z[kind, i] = v if reason == 0 else 0.0
        if reason == 0:
            every |= np.uint64(1) << np.uint64(i)
            if base[kind, i]:
                key |= np.uint64(1) << np.uint64(i)
    usable[kind] = every
    return key


@inner
def judge_used(kind: int, alarm: int, leave: U, base: B, why: I, left_out: I, verdict: I) -> None:
    """Verdict on the sensors in use; leave[kind]: those left out by the parity test."""
    for i in range(base.shape[1]):
        verdict[kind, i] = NONE
        if not base[kind, i]:
            continue
        if why[kind, i] != 0:
            verdict[kind, i] = BAD
            left_out[kind, i, why[kind, i]] += 1
        elif (leave[kind] >> np.uint64(i)) & np.uint64(1):
            left_out[kind, i, PARITY] += 1
            if alarm == RESOLVED:
                verdict[kind, i] = BAD
                why[kind, i] = PARITY
        elif alarm != UNRESOLVED:
            verdict[kind, i] = GOOD


@inner
def residual_error(i: int, H: F, W: F, x: F, errors: F) -> float:
    """Variance that scale factor and mounting errors add to the residual of sensor i against the estimator W (3, n) of others, at x (3,)."""
    D = np.empty(H.shape[0])
    errors_at(H, x[0], x[1], x[2], errors[SCALE2], errors[TILT2], D)
    total = D[i]
    for j in range(H.shape[0]):
        a = 0.0
        for c in range(3):
            a += H[i, c] * W[c, j]
        total += a * a * D[j]
    return float(total)


@inner
def judge_out(
    kind: int, slot: int, t: int, rules: Rules, judged: B, wake: I, z: F, x: F, W: F, reach: F, mean_sum: F, mean_count: I, why: I, verdict: I
) -> None:
    """Verdict on the sensors that are out and on the way back: their residual against those in use, whose estimator is W (3, n)."""
    for i in range(judged.shape[1]):
        if not judged[kind, i] or (t < wake[0, kind, i] and t < wake[1, kind, i]):
            continue
        if why[kind, i] != 0:
            verdict[kind, i] = BAD
            continue
        r = z[kind, i]
        for a in range(3):
            r -= rules.H[i, a] * x[kind, a]
        scale = reach[kind, slot, i]
        if rules.moving:
            scale = 1.0 / (1.0 / scale + residual_error(i, rules.H, W, x[kind], rules.errors[kind]))
        mean_sum[kind, i] += r * np.sqrt(scale)
        mean_count[kind, i] += 1
        if r * r * scale <= rules.judge_threshold:
            verdict[kind, i] = GOOD
        else:
            verdict[kind, i] = BAD
            why[kind, i] = PARITY


@inner
def wake_up(kind: int, t: int, wake: I, verdict: I, wakes: B) -> bool:
    """Mark the verdicts that concern a health machine; True: there are some."""
    woken = False
    for i in range(verdict.shape[1]):
        v = verdict[kind, i]
        wakes[kind, i] = (v == GOOD and t >= wake[0, kind, i]) or (v == BAD and t >= wake[1, kind, i])
        woken |= wakes[kind, i]
    return woken


@inner
def remember(kind: int, k: int, raw: F, value: F, repeat: I) -> None:
    """Keep the values for the stuck test."""
    for i in range(raw.shape[1]):
        if raw[k, i] == value[kind, i]:
            repeat[kind, i] += 1
        else:
            repeat[kind, i] = 1
            value[kind, i] = raw[k, i]


@inner
def note_past(
    t: int, grid: int, period: float, set0: np.uint64, set1: np.uint64, z: F, place: I, end: I, last: I, span: F, used: U, total: F
) -> None:
    """Add a fused sample to the records of the past."""
    r = place[OPEN]
    dt = period if place[FILLED] == 0 else (t - place[NEWEST]) * 1e-9  # as a consumer that integrates has it
    place[NEWEST] = t
    if place[FILLED] == 0 or t >= end[r] or set0 != used[r, 0] or set1 != used[r, 1]:
        if place[FILLED] > 0:
            r = (r + 1) % end.shape[0]
            place[OPEN] = r
        place[FILLED] = min(place[FILLED] + 1, end.shape[0])
        end[r] = t - t % grid + grid
        used[r, 0] = set0
        used[r, 1] = set1
        span[r, 0] = 0.0
        span[r, 1] = 0.0
        total[r] = 0.0
    last[r] = t
    span[r, 0] += dt
    span[r, 1] += dt * dt
    for kind in range(2):
        for i in range(z.shape[1]):
            total[r, kind, i] += dt * z[kind, i]
