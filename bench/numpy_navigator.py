"""What the navigator has compiled, once more in NumPy alone: strapdown, transition, masters, separation of solutions, protection level.

Lives here: functions and a `Stack` with the signatures of the kernels, as one writes them in NumPy, and `without_kernels`, which puts them in.
Does not live here: the kernels (riins_core.strapdown, riins_federated, riins_fdi.eraim), the timing (navigator_cost.py).
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator
from typing import Any
from unittest import mock

import numpy as np
from numpy.typing import NDArray

from riins_core import ins_error
from riins_core.earth import earth_rate_n, gravity, radii, transport_rate_n
from riins_core.rotation import skew
from riins_fdi import eraim
from riins_federated import aiding, integrated_filter, sample_noise, separated_masters, solution, structures
from riins_federated.stacked import Innovations, Rows, Stack

Array = NDArray[np.float64]
SINGULAR = 1e-3


def rotation(v: Array) -> Array:
    """exp([v x])."""
    angle = math.sqrt(v @ v)
    S = skew(v)
    if angle < 1e-4:
        return np.eye(3) + (1.0 - angle**2 / 6.0) * S + (0.5 - angle**2 / 24.0) * S @ S
    return np.eye(3) + math.sin(angle) / angle * S + (1.0 - math.cos(angle)) / angle**2 * S @ S


def strapdown_block(
    nav: Array, dtheta_prev: Array, dv_prev: Array, rate: Array, force: Array, dt: Array, bias_g: Array, bias_a: Array, sums: Array
) -> None:
    """As riins_core.strapdown.strapdown_block."""
    for k in range(len(dt)):
        T = float(dt[k])
        a, b = (rate[k] - bias_g) * T, (force[k] - bias_a) * T
        ratio = 2.0 * T * T / (nav[15] * (nav[15] + T)) if nav[15] > 0.0 else 0.0
        A, p, q = skew(a), ratio * dtheta_prev, ratio * dv_prev
        turn = rotation(a - A @ p / 12.0)
        square = a @ a
        s = A @ b
        u = b + (0.5 - square / 24.0) * s + (1.0 / 6.0 - square / 120.0) * (A @ s) + (skew(p) @ b - A @ q) / 12.0
        C = nav[6:15].reshape(3, 3).copy()
        f, v = C @ u, nav[3:6].copy()
        r_m, _ = radii(nav[0])
        lat, h = nav[0] + 0.5 * T * v[0] / (r_m + nav[2]), nav[2] - 0.5 * T * v[2]
        r_m, r_n = radii(lat)
        g, w_ie = np.array([0.0, 0.0, float(gravity(lat, h))]), earth_rate_n(lat)
        middle = v + 0.5 * (f + (g - skew(2.0 * w_ie + transport_rate_n(lat, h, v)) @ v) * T)
        w_en = transport_rate_n(lat, h, middle)
        z = (w_ie + w_en) * T
        gained = f - 0.5 * skew(z) @ f
        after = v + gained + (g - skew(2.0 * w_ie + w_en) @ middle) * T
        mean = 0.5 * (v + after) * T
        nav[0] += mean[0] / (r_m + h)
        nav[1] = (nav[1] + mean[1] / ((r_n + h) * math.cos(lat)) + math.pi) % (2.0 * math.pi) - math.pi
        nav[2] -= mean[2]
        nav[3:6] = after
        D = rotation(-z) @ (C @ turn)
        D = 1.5 * D - 0.5 * (D @ D.T) @ D
        nav[6:15] = D.ravel()
        dtheta_prev[:], dv_prev[:], nav[15] = a, b, T
        sums[0:3] += gained
        sums[3:12] += 0.5 * T * (C + D).ravel()
        sums[12] += T


def transition(nav: Array, sums: Array, swing: Array, density: Array, decay: Array, column: Rows, factor: Rows, Phi: Array, Qd: Array) -> None:
    """As riins_federated.error_filter.transition."""
    T, m = sums[12], ins_error.N_STATES + len(column)
    F = np.zeros((ins_error.N_STATES, ins_error.N_STATES))
    ins_error.fill_dynamics(F, nav[0], nav[2], nav[3:6], sums[0:3] / T, sums[3:12].reshape(3, 3) / T)
    A = np.hstack([F[:9] * T, F[:9, column] * np.append(T, swing)[factor]])
    kept = np.exp(-decay * T)
    square = A[:, :9] @ A
    square[:, 9:] -= A[:, 9:] * decay[9:m] * T
    Phi[:] = np.diag(kept)
    Phi[:9, :m] += A + 0.5 * square
    safe = np.where(decay > 0.0, decay, 1.0)
    Qd[:] = np.diag(density * np.where(decay > 0.0, 0.5 * (1.0 - kept**2) / safe, T))
    block = 0.5 * T * (Phi[:9] * density) @ Phi.T
    block[:, :9] += 0.5 * T * np.diag(density[:9])
    block[:, 9:] = 0.5 * T * Phi[:9, 9:] * density[9:] * kept[9:]
    Qd[:9], Qd[9:, :9] = block, block[:, 9:].T


class PlainStack(Stack):
    """`Stack` in NumPy."""

    def predict(self, Phi: Array, Q: Array, scale: Array) -> None:
        """As in `Stack`; all filters in one product."""
        on = scale > 0.0
        P = Phi @ self.P[on] @ Phi.T + scale[on, None, None] * Q
        self.P[on] = 0.5 * (P + P.transpose(0, 2, 1))
        self.X[on] = self.X[on] @ Phi.T

    def judge(self, rows: Rows, z: Array, H: Array, R: Array) -> Innovations:
        """As in `Stack`."""
        dz = z - self.X[rows] @ H.T
        S = H @ self.P[rows] @ H.T + R
        L = np.linalg.cholesky(S)
        u = np.linalg.solve(L, dz[:, :, None])[:, :, 0]
        information = H[:, :6].T @ np.linalg.solve(R, H[:, :6])
        traces = np.array([np.trace(information[:3, :3]), np.trace(information[3:, 3:])])
        return Innovations(dz, np.sqrt(np.diagonal(S, axis1=1, axis2=2)), u, np.sum(u * u, axis=1), traces)

    def update(self, rows: Rows, z: Array, H: Array, R: Array) -> None:
        """As in `Stack`: Joseph form."""
        X, P = self.X[rows], self.P[rows]
        PH = P @ H.T
        K = np.linalg.solve(H @ PH + R, PH.transpose(0, 2, 1)).transpose(0, 2, 1)
        A = np.eye(X.shape[1]) - K @ H
        P = A @ P @ A.transpose(0, 2, 1) + K @ R @ K.transpose(0, 2, 1)
        self.P[rows] = 0.5 * (P + P.transpose(0, 2, 1))
        self.X[rows] = X + (K @ (z - X @ H.T)[:, :, None])[:, :, 0]


def separation_into(x: Array, P: Array, x_loo: Array, P_loo: Array, states: Rows, D: Array) -> tuple[float, int]:
    """As riins_fdi.eraim.separation_into, but for D."""
    cut = np.ix_(states, states)
    scale = 1.0 / np.sqrt(np.diag(P)[states])
    w, V = np.linalg.eigh((P_loo[cut] - P[cut]) * np.outer(scale, scale))
    tested = w > SINGULAR
    return float(np.sum((V[:, tested].T @ ((x - x_loo)[states] * scale)) ** 2 / w[tested])), int(tested.sum())


def separations_into(X: Array, P: Array, rows: Rows, states: Rows, statistic: Array, dof: NDArray[np.int64]) -> None:
    """As riins_fdi.eraim.separations_into."""
    for k, row in enumerate(rows):
        statistic[k], dof[k] = separation_into(X[0], P[0], X[row], P[row], states, np.empty(0))


def protection_levels(X: Array, P: Array, rows: Rows, position: Rows, heading: int, unseen: Array, quantile: Array) -> tuple[float, float]:
    """As riins_fdi.eraim.protection_levels."""
    cut = np.ix_(position, position)

    def largest(M: Array) -> float:
        return max(float(np.linalg.eigvalsh(M[cut])[-1]), 0.0)

    level, angle = math.sqrt(quantile[0] * largest(P[0])), math.sqrt(quantile[1] * P[0, heading, heading])
    for r in rows:
        bias = max(math.sqrt(unseen[0] * largest(P[r] - P[0])), float(np.linalg.norm((X[0] - X[r])[position])))
        level = max(level, bias + math.sqrt(quantile[0] * largest(P[r])))
        bias = max(math.sqrt(unseen[1] * max(P[r, heading, heading] - P[0, heading, heading], 0.0)), abs(X[0, heading] - X[r, heading]))
        angle = max(angle, bias + math.sqrt(quantile[1] * P[r, heading, heading]))
    return level, angle


def body_rate(nav: Array, rate_ib: Array) -> Array:
    """As riins_federated.solution.body_rate."""
    return np.asarray(rate_ib - nav[6:15].reshape(3, 3).T @ (earth_rate_n(nav[0]) + transport_rate_n(nav[0], nav[2], nav[3:6])))


def positive(R: Array) -> bool:
    """As the kernel of aiding.reported_covariance_ok."""
    return bool(np.isfinite(R).all() and np.allclose(R, R.T, rtol=0.0, atol=1e-9 * np.abs(R).max()) and np.linalg.eigvalsh(R)[0] > 0.0)


def weighted(d: Array, S: Array) -> float:
    """As the kernel of eraim.cross_check."""
    return float(d @ np.linalg.solve(S, d))


def gather(state: Array, covariance: Array, dt: Array, density: float) -> None:
    """As the kernel of SampleNoise.gather where no covariance is known, as here."""
    state[sample_noise.SUM] += density * dt.sum() * np.eye(3)


@contextlib.contextmanager
def without_kernels() -> Iterator[None]:
    """The navigator with these in the place of its kernels."""
    places: list[tuple[Any, str, Any]] = [
        (integrated_filter, "strapdown_block", strapdown_block), (integrated_filter, "transition", transition), (structures, "Stack", PlainStack),
        (separated_masters, "separation_into", separation_into), (separated_masters, "separations_into", separations_into),
        (separated_masters, "protection_levels", protection_levels), (integrated_filter, "body_rate", body_rate), (solution, "body_rate", body_rate),
        (aiding, "_positive", positive), (eraim, "_weighted", weighted), (sample_noise, "_gather", gather),
    ]  # fmt: skip
    with contextlib.ExitStack() as stack:
        for module, name, plain in places:
            stack.enter_context(mock.patch.object(module, name, plain))
        yield
