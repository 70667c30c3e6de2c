"""The detection and fusion methods once more, in NumPy alone and one sample at a time: what compiled code is compared with.

Lives here: a function for each method, readings (m, n) in, what the method of the packages gives out; no numba, no ROS.
Does not live here: timing (fusion_cost.py), the methods in use (riins_fdi, riins_imu_fusion).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def fit(z: Array, W: Array, whitened: Array, gain: Array, threshold: float) -> tuple[Array, Array]:
    """Least squares and generalized likelihood test: x (m, 3), statistic (m,). The sensor that explains an alarm is left to the caller."""
    x, statistic = np.empty((len(z), 3)), np.empty(len(z))
    for k, row in enumerate(z):
        p = whitened @ row
        statistic[k] = p @ p
        if statistic[k] > threshold:
            np.argmax((whitened.T @ p) ** 2 * gain)
        x[k] = W @ row
    return x, statistic


def glt(z: Array, whitened: Array, gain: Array) -> tuple[Array, Array]:
    """Statistic and sensor."""
    statistic, sensor = np.empty(len(z)), np.empty(len(z), int)
    for k, row in enumerate(z):
        p = whitened @ row
        statistic[k] = p @ p
        sensor[k] = np.argmax((whitened.T @ p) ** 2 * gain)
    return statistic, sensor


def largest(z: Array, rows: Array) -> tuple[Array, Array]:
    """Largest |rows z| and where it is: optimal parity vectors (rows c_i'V), and the residual of singular value decomposition without its length."""
    statistic, which = np.empty(len(z)), np.empty(len(z), int)
    for k, row in enumerate(z):
        r = np.abs(rows @ row)
        which[k] = np.argmax(r)
        statistic[k] = r[which[k]]
    return statistic, which


def svd(z: Array, projector: Array) -> tuple[Array, Array]:
    """Length of the residual and its largest component."""
    statistic, sensor = np.empty(len(z)), np.empty(len(z), int)
    for k, row in enumerate(z):
        r = projector @ row
        statistic[k] = r @ r
        sensor[k] = np.argmax(np.abs(r))
    return statistic, sensor


def direct_comparison(z: Array, relations: Array, member: NDArray[np.bool_], threshold: float) -> tuple[Array, Array]:
    """Largest residual, and the one sensor in every broken equation; -1: none or several."""
    statistic, sensor = np.empty(len(z)), np.full(len(z), -1)
    for k, row in enumerate(z):
        r = np.abs(relations @ row)
        statistic[k] = r.max()
        broken = r > threshold
        if broken.any():
            explains = np.flatnonzero(member[broken].all(axis=0))
            if explains.size == 1:
                sensor[k] = explains[0]
    return statistic, sensor


def cusum(z: Array, whitened: Array, u: Array, reference: float) -> tuple[Array, Array]:
    """Largest sum and its sensor."""
    g = np.zeros((len(u), 2))
    statistic, sensor = np.empty(len(z)), np.full(len(z), -1)
    for k, row in enumerate(z):
        s = u @ (whitened @ row)
        g = np.maximum(0.0, g + np.column_stack([s, -s]) - reference)
        best = np.argmax(g)
        statistic[k] = g.flat[best]
        sensor[k] = best // 2 if statistic[k] > 0.0 else -1
    return statistic, sensor


def windowed_glr(z: Array, whitened: Array, u: Array, lengths: NDArray[np.int64]) -> tuple[Array, Array]:
    """Largest likelihood ratio over sensors and windows, and its sensor."""
    size = int(lengths[-1]) + 1
    sums = np.zeros((size, len(whitened)))
    statistic, sensor = np.empty(len(z)), np.empty(len(z), int)
    for k, row in enumerate(z):
        now = (k + 1) % size
        sums[now] = sums[k % size] + whitened @ row
        w = lengths[: np.searchsorted(lengths, k + 1, side="right")]
        s = (sums[now] - sums[(now - w) % size]) @ u.T
        s = s * s / w[:, None]
        best = np.argmax(s)
        statistic[k] = s.flat[best]
        sensor[k] = best % len(u)
    return statistic, sensor


def wls(z: Array, W: Array, R: Array, P: Array, Q: Array) -> tuple[Array, Array]:
    """Least squares with its covariance."""
    P = P.copy()
    x, covariance = np.empty((len(z), 3)), np.empty((len(z), 3, 3))
    for k, row in enumerate(z):
        P += Q
        x[k], covariance[k] = W @ row, W @ (R + P) @ W.T
    return x, covariance


def _kalman(d: Array, P: Array, p: Array, V: Array, RV: Array) -> tuple[Array, Array]:
    K = np.linalg.solve(V @ P @ V.T + RV, V @ P).T
    A = np.eye(len(d)) - K @ V
    return d + K @ (p - V @ d), A @ P @ A.T + K @ RV @ K.T


def opt(z: Array, W: Array, R: Array, P: Array, Q: Array, V: Array, RV: Array) -> tuple[Array, Array]:
    """Kalman filter on the parity, least squares of what is left."""
    d, P = np.zeros(len(Q)), P.copy()
    x, covariance = np.empty((len(z), 3)), np.empty((len(z), 3, 3))
    for k, row in enumerate(z):
        d, P = _kalman(d, P + Q, V @ row, V, RV)
        x[k], covariance[k] = W @ (row - d), W @ (R + P) @ W.T
    return x, covariance


def aopt(z: Array, W: Array, R: Array, P: Array, Q: Array, V: Array, RV: Array, settings: Any) -> tuple[Array, Array]:
    """The same with Sage and Husa's process noise and a fading factor."""
    d, P, kept, q, V0 = np.zeros(len(Q)), P.copy(), P.copy(), np.diag(Q).copy(), 0.0
    b, noise = settings.forgetting, np.trace(RV)
    x, covariance = np.empty((len(z), 3)), np.empty((len(z), 3, 3))
    for k, row in enumerate(z):
        p = V @ row
        e = p - V @ d
        M = V @ P @ V.T
        V0 = e @ e if k == 0 else (settings.memory * V0 + e @ e) / (1.0 + settings.memory)
        before, old, seen = d, np.diag(P).copy(), np.trace(M)
        if seen > 0.0 and V0 - settings.softening * noise > seen:
            P = P + ((V0 - settings.softening * noise) / seen - 1.0) * (V @ P).T @ np.linalg.solve(M, V @ P)
        d, P = _kalman(d, P + np.diag(q), p, V, RV)
        K = P @ V.T @ np.linalg.inv(RV)
        A = np.eye(len(Q)) - K @ V
        kept = A @ (kept + Q) @ A.T + K @ RV @ K.T
        weight = (1.0 - b) / (1.0 - b ** (k + 1.0))
        q = np.maximum(0.0, (1.0 - weight) * q + weight * ((d - before) ** 2 + np.diag(P) - old))
        x[k], covariance[k] = W @ (row - d), W @ (R + kept) @ W.T
    return x, covariance


def optdc(z: Array, W: Array, R: Array, P: Array, Q: Array, V: Array, RV: Array, step: float) -> tuple[Array, Array]:
    """Drifts fed back into the readings, each by its drift factor."""
    n = len(Q)
    d, D, total, P = np.zeros(n), np.zeros(n), np.zeros(n), P.copy()
    x, covariance = np.empty((len(z), 3)), np.empty((len(z), 3, 3))
    for k, row in enumerate(z):
        left = row - D
        d, P = _kalman(d, P + Q, V @ left, V, RV)
        x[k], covariance[k] = W @ (left - d), W @ (R + P) @ W.T
        alpha = total * np.abs(D * d)
        alpha = alpha / alpha.sum() if alpha.sum() > 0.0 else np.full(n, 1.0 / n)
        u = np.minimum(step * alpha, 1.0) * d
        D, d, total = D + u, d - u, total + np.abs(u)
    return x, covariance


def _linearized(x: Array, z: Array, V: Array, votes: Array) -> tuple[Array, Array]:
    c = votes @ x
    return np.concatenate([z - V @ x, -c * x]), np.vstack([V, votes * x[:, None] + np.diag(c)])


def _bounded(P: Array, most: float) -> Array:
    f = np.minimum(1.0, most / np.sqrt(np.diag(P)))
    return P * f[:, None] * f


def rfdc(z: Array, V: Array, votes: Array, config: Any, adaptive: bool) -> tuple[Array, Array]:
    """Feedback compensation with EKF or AEKF: drift compensated and estimated; with `config.drift_factor` IRFDC."""
    n, d = len(votes), len(V)
    x, D, P = np.zeros(n), np.zeros(n), np.eye(n) * config.process_sigma**2
    alpha, change = np.full(n, 1.0 / n if config.drift_factor else 1.0), np.zeros(n)
    R = np.diag(np.concatenate([np.full(d, config.sigma**2), np.full(n, config.vote_sigma**2)]))
    out_d, out_x = np.empty_like(z), np.empty_like(z)
    for k, row in enumerate(z):
        x = x - config.gain * alpha * x * config.dt
        y, H = _linearized(x, V @ (row - D), V, votes)
        if adaptive:
            P = P * max(1.0, (y @ y) / np.trace(H @ P @ H.T + R))
        P = _bounded(P + np.eye(n) * config.process_sigma**2, config.most)
        K = np.linalg.solve(H @ P @ H.T + R, H @ P).T
        x, P = x + K @ y, P - K @ H @ P
        if config.drift_factor:
            change = change + alpha * np.abs(x)
            alpha = _factor(change, D, x, alpha)
        D = D + config.gain * alpha * x * config.dt
        out_d[k], out_x[k] = D, x
    return out_d, out_x


def _factor(change: Array, D: Array, x: Array, alpha: Array) -> Array:
    before, now = change.sum(), np.abs(D * x)
    product = change / before * (now / now.sum()) if before > 0.0 and now.sum() > 0.0 else np.zeros(len(x))
    return np.maximum(0.01, product / product.sum()) if product.sum() > 0.0 else alpha


def pf(z: Array, V: Array, votes: Array, config: Any, draws: Array) -> tuple[Array, Array]:
    """Feedback compensation with a particle filter that draws from the transition; `draws` (m, particles n + 1), standard normal."""
    n, count = len(votes), config.particles
    x, D, cloud, weights = np.zeros(n), np.zeros(n), np.zeros((count, n)), np.full(count, 1.0 / count)
    alpha, change = np.full(n, 1.0 / n if config.drift_factor else 1.0), np.zeros(n)
    out_d, out_x = np.empty_like(z), np.empty_like(z)
    from scipy.special import ndtr

    for k, row in enumerate(z):
        u = -config.gain * alpha * x * config.dt
        cloud = cloud + u + config.process_sigma * draws[k, :-1].reshape(count, n)
        parity = V @ (row - D) - cloud @ V.T
        vote = (cloud @ votes.T) * cloud
        log = np.log(np.maximum(weights, 1e-300)) - 0.5 * ((parity**2).sum(1) / config.sigma**2 + (vote**2).sum(1) / config.vote_sigma**2)
        weights = np.exp(log - log.max())
        weights /= weights.sum()
        x = weights @ cloud
        (weights[:, None] * (cloud - x)).T @ (cloud - x)  # the covariance, which the filter reports
        if 1.0 / (weights @ weights) < 2.0 / 3.0 * count:
            places = (np.arange(count) + ndtr(draws[k, -1])) / count
            cloud = cloud[np.minimum(np.searchsorted(np.cumsum(weights), places, side="right"), count - 1)]
            weights = np.full(count, 1.0 / count)
        if config.drift_factor:
            change = change + alpha * np.abs(x)
            alpha = _factor(change, D, x, alpha)
        D = D + config.gain * alpha * x * config.dt
        out_d[k], out_x[k] = D, x
    return out_d, out_x


def glr_kf(z: Array, W: Array, V: Array, rules: Any, prior: Array, levels: int, slots: int) -> tuple[Array, Array]:
    """What `glr_kf` does as long as there is no alarm: fused value and covariance.

    Parity Kalman filter, the filter of every moment remembered, and the likelihood ratio of a change there for each sensor.
    """
    n, d, batch = V.shape[1], len(V), rules.batch
    R, _, step, floor = rules.each
    x, P, total, C = np.zeros(n), prior.copy(), np.zeros(n), np.zeros((n, n))
    past: list[list[tuple[int, Array, Array, Array, Array, Array, Array]]] = [[] for _ in range(levels)]
    parity, done = np.zeros(d), np.zeros(d)
    fused, covariance = np.empty((len(z), 3)), np.empty((len(z), 3, 3))
    for k, row in enumerate(z, start=1):
        parity = parity + V @ row
        if k % batch == 0:
            mean, done = (parity - done) / batch, parity
            P = P + np.diag(batch * step)
            total, C = total + batch * x, C + batch * P
            S = V @ P @ V.T + np.eye(d) / batch
            K, G, e = np.linalg.solve(S, V @ P).T, np.linalg.solve(S, V @ C.T).T, mean - V @ x
            C, total, x, P = C - G @ V @ P, total + G @ e, x + K @ e, P - K @ V @ P
            if _windows(k, parity, V, past, rules, step, floor) > rules.alarm:
                raise RuntimeError("an alarm: this code ends where it begins")
            for level in range(levels):
                if (k // batch) % (1 << level):
                    break
                past[level] = [*past[level][-slots + 1 :], (k, parity, V @ x, x, P, total, C)]
        fused[k - 1], covariance[k - 1] = W @ row, W @ (np.diag(R) + P) @ W.T
    return fused, covariance


def _windows(k: int, parity: Array, V: Array, past: Any, rules: Any, step: Array, floor: Array) -> float:
    most, least = 0.0, min(rules.again, rules.alarm)
    for level, moments in enumerate(past):
        span = rules.batch << level
        if k % span:
            break
        for then, sums, expected, _, P, _, _ in moments:
            w = k - then
            if w < 1 or (level > 0 and w < 4 * span):
                continue
            e = (parity - sums) / w - expected
            if e @ e * w <= least:
                continue
            S = np.eye(len(V)) / w + V @ (P + np.diag(step * w / 3.0 + floor)) @ V.T
            L = np.linalg.cholesky(S)
            t, u = np.linalg.solve(L, e), np.linalg.solve(L, V)
            most = max(most, float(np.max((t @ u) ** 2 / np.sum(u * u, axis=0))))
    return most
