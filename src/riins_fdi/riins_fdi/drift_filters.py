"""Kernels of drift compensation: one filter step for EKF, AEKF, AEKPF (two proposals) and PF, and the feedback loop around them.

Lives here: arithmetic on plain arrays, sample by sample, with the random numbers handed in.
Does not live here: settings, state and meaning (drift).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from riins_core.jit import inner, jit

Array = NDArray[np.float64]

EKF, AEKF, AEKPF, AEKPF_OPTIMAL, PF = 0, 1, 2, 3, 4
_FLOOR = 0.01  # least drift factor, thesis below (4-72)
_RESAMPLE = 2.0 / 3.0  # of the particles: fewer effective ones are resampled, thesis 4.3.2.1 (4)


@jit
def linearize(x: Array, z: Array, V: Array, votes: Array, H: Array, y: Array) -> None:
    """Innovation y (d + n,) and Jacobian H (d + n, n) of thesis (4-49) at x: parity z against V x, zero against (c_i x) x_i."""
    n, d = x.shape[0], z.shape[0]
    for r in range(d):
        s = 0.0
        for i in range(n):
            s += V[r, i] * x[i]
            H[r, i] = V[r, i]
        y[r] = z[r] - s
    for j in range(n):
        c = 0.0
        for i in range(n):
            c += votes[j, i] * x[i]
        for i in range(n):
            H[d + j, i] = votes[j, i] * x[j]
        H[d + j, j] += c
        y[d + j] = -c * x[j]


@jit
def update(x: Array, P: Array, H: Array, y: Array, R: Array) -> None:
    """Kalman update in place, one measurement after the other about one linearization; (4-51) to (4-53) for a diagonal R."""
    n = x.shape[0]
    dx, ph = np.zeros(n), np.empty(n)
    for r in range(R.shape[0]):
        s, e = R[r], y[r]
        for i in range(n):
            a = 0.0
            for j in range(n):
                a += P[i, j] * H[r, j]
            ph[i] = a
        for i in range(n):
            s += H[r, i] * ph[i]
            e -= H[r, i] * dx[i]
        for i in range(n):
            dx[i] += ph[i] * e / s
            for j in range(n):
                P[i, j] -= ph[i] * ph[j] / s
    for i in range(n):
        x[i] += dx[i]


@jit
def fading(P: Array, H: Array, y: Array, R: Array) -> float:
    """Fading factor (4-55) to (4-57): trace of the squared innovation over trace of its covariance, at least 1."""
    found, expected = 0.0, 0.0
    for r in range(R.shape[0]):
        found += y[r] * y[r]
        expected += R[r]
        for i in range(P.shape[0]):
            for j in range(P.shape[0]):
                expected += H[r, i] * P[i, j] * H[r, j]
    return max(1.0, found / expected)


@jit
def bound(P: Array, most: float) -> None:
    """Scale rows and columns of P so that no standard deviation exceeds `most`; correlations stay."""
    for i in range(P.shape[0]):
        if P[i, i] > most * most:
            f = most / math.sqrt(P[i, i])
            for j in range(P.shape[0]):
                P[i, j] *= f
                P[j, i] *= f


@jit
def cholesky(P: Array, L: Array) -> None:
    """Lower factor of P; directions without variance get a trifle."""
    for i in range(P.shape[0]):
        for j in range(i + 1):
            s = P[i, j]
            for k in range(j):
                s -= L[i, k] * L[j, k]
            if i == j:
                L[i, i] = math.sqrt(max(s, 1e-14))
            else:
                L[i, j] = s / L[j, j]


@jit
def resample(cloud: Array, weights: Array, uniform: float) -> None:
    """Systematic resampling where the effective number of particles, 1 / sum w^2, has fallen below two thirds."""
    count, square = cloud.shape[0], 0.0
    for p in range(count):
        square += weights[p] * weights[p]
    if 1.0 / square >= _RESAMPLE * count:
        return
    chosen = np.empty_like(cloud)
    j, total = 0, weights[0]
    for p in range(count):
        while j < count - 1 and total < (p + uniform) / count:
            j += 1
            total += weights[j]
        chosen[p] = cloud[j]
    cloud[:] = chosen
    weights[:] = 1.0 / count


@jit
def particles(
    kind: int, z: Array, u: Array, V: Array, votes: Array, R: Array, process: float, most: float, draws: Array, x: Array, P: Array,
    cloud: Array, weights: Array,
) -> None:  # fmt: skip
    """One step of a particle filter: x, P, cloud and weights in place.

    PF draws from the transition N(d + u, Q). AEKPF draws from an EKF update of each particle: as printed with the covariance of the whole cloud
    (step 5) plus Q, without which a cloud that has collapsed stays so; locally optimal with that of the particle's own transition, lambda Q. The
    fading widens the transition in (4-58) too, or a jump of the drift weighs the particles by how far each happened to go.
    """
    count, n = cloud.shape
    H, y = np.empty((R.shape[0], n)), np.empty(R.shape[0])
    ahead, own, L = np.zeros((n, n)), np.empty((n, n)), np.zeros((n, n))
    widened = process * process
    if kind != PF:
        for i in range(n):
            for j in range(n):
                ahead[i, j] = P[i, j] if kind == AEKPF else 0.0
            ahead[i, i] += process * process
        linearize(x + u, z, V, votes, H, y)
        widening = fading(ahead, H, y, R)
        widened *= widening
        ahead *= widening
        bound(ahead, most)
    d, mean = np.empty(n), np.empty(n)
    largest = -np.inf
    for p in range(count):
        for i in range(n):
            mean[i] = cloud[p, i] + u[i]
            d[i] = mean[i]
        log = math.log(weights[p]) if weights[p] > 0.0 else -1e300
        if kind == PF:
            for i in range(n):
                d[i] += process * draws[p * n + i]
        else:
            linearize(d, z, V, votes, H, y)
            own[:] = ahead
            update(d, own, H, y, R)
            cholesky(own, L)
            for i in range(n):
                for j in range(i + 1):
                    d[i] += L[i, j] * draws[p * n + j]
                log += 0.5 * draws[p * n + i] ** 2 + math.log(L[i, i])  # 1 / q
            for i in range(n):
                log -= 0.5 * (d[i] - mean[i]) ** 2 / widened
        linearize(d, z, V, votes, H, y)
        for r in range(R.shape[0]):
            log -= 0.5 * y[r] * y[r] / R[r]
        weights[p] = log
        largest = max(largest, log)
        cloud[p] = d
    total = 0.0
    for p in range(count):
        weights[p] = math.exp(weights[p] - largest)
        total += weights[p]
    x[:] = 0.0
    P[:] = 0.0
    for p in range(count):
        weights[p] /= total
        for i in range(n):
            x[i] += weights[p] * cloud[p, i]
    for p in range(count):
        for i in range(n):
            for j in range(n):
                P[i, j] += weights[p] * (cloud[p, i] - x[i]) * (cloud[p, j] - x[j])
    resample(cloud, weights, 0.5 * math.erfc(-draws[count * n] / math.sqrt(2.0)))


@jit
def drift_factor(D: Array, x: Array, change: Array, alpha: Array) -> None:
    """Drift factor alpha in place: mean change so far (4-67) times |D d^| (4-70, which lacks the absolute value), normalized, at least 0.01."""
    n = D.shape[0]
    before, now = 0.0, 0.0
    for i in range(n):
        change[i] += alpha[i] * abs(x[i])
        before += change[i]
        now += abs(D[i] * x[i])
    if before <= 0.0 or now <= 0.0:
        return
    total = 0.0
    for i in range(n):
        total += change[i] / before * (abs(D[i] * x[i]) / now)
    if total > 0.0:
        for i in range(n):
            alpha[i] = max(_FLOOR, change[i] / before * (abs(D[i] * x[i]) / now) / total)


@inner
def loop_step(
    m: Array, V: Array, votes: Array, gain: float, process: float, most: float, R: Array, kind: int, factor: bool, draws: Array, x: Array, P: Array,
    D: Array, alpha: Array, change: Array, cloud: Array, weights: Array, H: Array, y: Array, z: Array, u: Array,
) -> None:  # fmt: skip
    """One sample m (n,), already without D; gain = K dt, the rest as in `loop`, and room for (d + n, n), (d + n,), (d,), (n,)."""
    n, d = D.shape[0], V.shape[0]
    for i in range(n):
        u[i] = -gain * alpha[i] * x[i]
    for r in range(d):
        s = 0.0
        for i in range(n):
            s += V[r, i] * m[i]
        z[r] = s
    if kind >= AEKPF:
        particles(kind, z, u, V, votes, R, process, most, draws, x, P, cloud, weights)
    else:
        for i in range(n):
            x[i] += u[i]
        linearize(x, z, V, votes, H, y)
        if kind == AEKF:
            P *= fading(P, H, y, R)
        for i in range(n):
            P[i, i] += process * process
        bound(P, most)
        update(x, P, H, y, R)
    if factor:
        drift_factor(D, x, change, alpha)
    for i in range(n):
        D[i] += gain * alpha[i] * x[i]


@jit
def loop(
    m: Array, V: Array, votes: Array, settings: Array, kind: int, factor: bool, draws: Array, x: Array, P: Array, D: Array, alpha: Array,
    change: Array, cloud: Array, weights: Array, out_m: Array, out_d: Array, out_x: Array, out_alpha: Array,
) -> None:  # fmt: skip
    """The feedback loop over a block; settings = gain, dt, sigma, process sigma, vote sigma, bound. State in place."""
    gain, dt, sigma, process, vote, most = settings
    n, d = D.shape[0], V.shape[0]
    H, y, z, u, R = np.empty((d + n, n)), np.empty(d + n), np.empty(d), np.empty(n), np.empty(d + n)
    R[:d] = sigma * sigma
    R[d:] = vote * vote
    for k in range(m.shape[0]):
        for i in range(n):
            out_m[k, i] = m[k, i] - D[i]
        loop_step(
            out_m[k], V, votes, gain * dt, process, most, R, kind, factor, draws[k], x, P, D, alpha, change, cloud, weights, H, y, z, u
        )  # fmt: skip
        for i in range(n):
            out_d[k, i] = D[i]
            out_x[k, i] = x[i]
            out_alpha[k, i] = alpha[i]
