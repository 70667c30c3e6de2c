"""Fine alignment at rest by a Kalman filter on the velocity that should be zero: 12, 10 and 7 states, equivalence operations, staged.

Lives here: the models and mechanization of seed 001, `StationarySettings`, `align_stationary`.
Does not live here: the coarse start (coarse.py), the filter on raw outputs (redundant.py), observability (observability.py).
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray

from ..earth import earth_rate_n, gravity
from ..jit import jit
from ..kalman import predict_into, update_joseph
from ..rotation import exp_so3, exp_so3_into, skew
from ..settings import setting
from .coarse import check_still, triad
from .result import Alignment, AlignmentError, bias_covariance, check_latitude

Array = NDArray[np.float64]

MODELS = (7, 10, 12)


@dataclasses.dataclass(frozen=True)
class StationarySettings:
    """Fine alignment at rest."""

    states: int = setting(7, "7, 10 or 12 states", "", low=7, high=12)
    restarts_s: tuple[float, ...] = setting((60.0, 120.0), "times at which the attitude is corrected and the filter begins anew", "s", 0.0, 1e5)
    coarse_s: float = setting(20.0, "data of the coarse start, where no attitude is given", "s", low=2.0, high=1e4)
    period_s: float = setting(1.0, "interval of the zero-velocity measurements", "s", low=0.01, high=60.0)
    velocity_sigma_mps: float = setting(0.01, "white error of a zero-velocity measurement", "m/s", low=1e-6, high=10.0)
    start_velocity_mps: float = setting(0.1, "1-sigma velocity error at each start", "m/s", low=1e-6, high=100.0)
    start_angle_deg: float = setting(10.0, "1-sigma attitude error at the first start", "deg", low=1e-3, high=180.0)
    restart_angle_deg: float = setting(1.0, "1-sigma attitude error at each restart", "deg", low=1e-3, high=180.0)
    again: bool = setting(False, "goes over the stored data once more, from the attitude found (at rest it is that of the start too)")


@dataclasses.dataclass(frozen=True)
class ImuNoise:
    """What the IMU of an alignment is like: fused triad or single sensors, one sigma of each axis, SI.

    Attributes
    ----------
    arw, vrw : rad/sqrt(s), m/s/sqrt(s)
    bias_g, bias_a : rad/s, m/s^2
    """

    arw: float
    vrw: float
    bias_g: float
    bias_a: float


def model(states: int, lat: float, C_nb: Array, coriolis: bool | None = None) -> tuple[Array, Array, Array]:
    """Dynamics of the errors of a mechanization at rest, seed 001 (6), (15).

    Parameters
    ----------
    states : 12: dv NED, phi NED, b_a xyz, b_g xyz; 10: dv N E, phi NED, b_a x y, b_g xyz; 7: dv N E, phi NED, eps N, eps D
    lat : rad
    C_nb : (3, 3), of the mechanization
    coriolis : whether dv' has -2 w_ie x dv; None: as the seed has it, not with 7 states

    Returns
    -------
    F (n, n), G (n, 6), H (m, n) : x' = F x + G w, w white noise of gyros and accelerometers; z = velocity computed = H x + v

    Notes
    -----
    phi' = -w_ie x phi - C b_g, dv' = f x phi + C b_a with f = (0, 0, -g): position and transport rate are held in the mechanization, so no d w_in
    occurs here (the seed's table 1). With 7 states the gyro biases are eps = C b_g in n: eps_E, a_N and a_E cannot be told from phi and go, and
    heading is opposite in sign to the seed's phi_U.
    """
    if states not in MODELS:
        raise ValueError(f"the stationary model has 7, 10 or 12 states, not {states}")
    g, w_ie = float(gravity(lat, 0.0)), earth_rate_n(lat)
    full = np.zeros((12, 12))
    full[0:3, 3:6] = skew([0.0, 0.0, -g])
    full[0:3, 6:9] = C_nb
    if states != 7 if coriolis is None else coriolis:
        full[0:3, 0:3] = -2.0 * skew(w_ie)
    full[3:6, 3:6] = -skew(w_ie)
    full[3:6, 9:12] = -C_nb
    G = np.zeros((12, 6))
    G[3:6, 0:3] = -C_nb
    G[0:3, 3:6] = C_nb
    if states == 7:
        full[3:6, 9:12] = -np.eye(3)
        keep = [0, 1, 3, 4, 5, 9, 11]
    else:
        keep = [0, 1, 3, 4, 5, 6, 7, 9, 10, 11] if states == 10 else list(range(12))
    H = np.eye(3 if states == 12 else 2, states)
    return full[np.ix_(keep, keep)], G[keep], H


@jit
def mechanize(
    C: Array, rate: Array, force: Array, dt: float, w_ie: Array, g: float, coriolis: bool, vertical: bool, every: int, v: Array, path: Array
) -> None:
    """Kernel: velocity and attitude of a mechanization at rest under the equivalence operations of seed 001, table 1.

    Parameters
    ----------
    C : (3, 3), C_nb at the start; at the end on return
    rate, force : (m, 3), means over dt [s]
    w_ie, g : Earth rate in n and gravity of the known place: position is not updated and there is no transport rate
    coriolis : whether -2 w_ie x v of the mechanization's own v is in it; it must be in the error model too, or in neither
    vertical : whether the vertical velocity is integrated; otherwise it stays zero
    every : samples between two rows of v (k, 3) and path (k, 3, 3), which are written: velocity at the end, attitude at the start of each interval
    """
    turn = np.empty((3, 3))
    step = np.empty((3, 3))
    work = np.empty((3, 3))
    exp_so3_into(-w_ie[0] * dt, -w_ie[1] * dt, -w_ie[2] * dt, turn)
    u = np.zeros(3)
    old = np.zeros(3)
    inc = np.zeros(3)
    for i in range(rate.shape[0]):
        if i % every == 0:
            path[i // every] = C
        ax, ay, az = rate[i, 0] * dt, rate[i, 1] * dt, rate[i, 2] * dt
        bx, by, bz = force[i, 0] * dt, force[i, 1] * dt, force[i, 2] * dt
        inc[0] = bx + 0.5 * (ay * bz - az * by)
        inc[1] = by + 0.5 * (az * bx - ax * bz)
        inc[2] = bz + 0.5 * (ax * by - ay * bx)
        old[:] = u
        for r in range(3):
            u[r] += C[r, 0] * inc[0] + C[r, 1] * inc[1] + C[r, 2] * inc[2]
        # n turns by w_ie dt during the sample, on average by half of it
        zx, zy, zz = 0.5 * w_ie[0] * dt, 0.5 * w_ie[1] * dt, 0.5 * w_ie[2] * dt
        fx, fy, fz = u[0] - old[0], u[1] - old[1], u[2] - old[2]
        u[0] -= zy * fz - zz * fy
        u[1] -= zz * fx - zx * fz
        u[2] += g * dt - (zx * fy - zy * fx)
        if coriolis:
            mx, my, mz = 0.5 * (old[0] + u[0]), 0.5 * (old[1] + u[1]), 0.5 * (old[2] + u[2])
            u[0] -= 2.0 * dt * (w_ie[1] * mz - w_ie[2] * my)
            u[1] -= 2.0 * dt * (w_ie[2] * mx - w_ie[0] * mz)
            u[2] -= 2.0 * dt * (w_ie[0] * my - w_ie[1] * mx)
        if not vertical:
            u[2] = 0.0
        exp_so3_into(ax, ay, az, step)
        for r in range(3):
            for c in range(3):
                work[r, c] = C[r, 0] * step[0, c] + C[r, 1] * step[1, c] + C[r, 2] * step[2, c]
        for r in range(3):
            for c in range(3):
                C[r, c] = turn[r, 0] * work[0, c] + turn[r, 1] * work[1, c] + turn[r, 2] * work[2, c]
        if i % every == every - 1:
            v[i // every] = u


@dataclasses.dataclass(frozen=True)
class History:
    """Estimates along the way: `t` (k,) s, `C_nb` (k, 3, 3) corrected attitude, `sigma` (k, 3) of phi in rad, the unseen biases left out."""

    t: Array
    C_nb: Array
    sigma: Array


def _prior(states: int, settings: StationarySettings, imu: ImuNoise, angle: float) -> Array:
    vertical = 3 if states == 12 else 2
    sigma = [settings.start_velocity_mps] * vertical + [angle] * 3
    sigma += {7: [imu.bias_g] * 2, 10: [imu.bias_a] * 2 + [imu.bias_g] * 3, 12: [imu.bias_a] * 3 + [imu.bias_g] * 3}[states]
    return np.diag(np.square(sigma))


def _stage(
    C: Array, rate: Array, force: Array, dt: float, lat: float, angle: float, imu: ImuNoise, settings: StationarySettings
) -> tuple[Array, Array, Array, Array, Array, Array]:
    """One filter from start to correction: C_nb at the end corrected, P of phi, biases, attitudes and sigmas along the way."""
    n, per = settings.states, max(1, round(settings.period_s / dt))
    m = len(rate) // per
    v, path = np.zeros((m, 3)), np.zeros((m, 3, 3))
    computed = C.copy()
    mechanize(computed, rate[: m * per], force[: m * per], dt, earth_rate_n(lat), float(gravity(lat, 0.0)), n != 7, n == 12, per, v, path)
    axes = 3 if n == 12 else 2
    x, P = np.zeros(n), _prior(n, settings, imu, angle)
    R = settings.velocity_sigma_mps**2 * np.eye(axes)
    dz, S, standardized = np.empty(axes), np.empty((axes, axes)), np.empty(axes)
    density = np.diag([imu.arw**2] * 3 + [imu.vrw**2] * 3)
    step = per * dt
    phi, sigma = np.empty((m, 3)), np.empty((m, 3))
    for k in range(m):
        F, G, H = model(n, lat, path[k])
        A = F * step
        Phi = np.eye(n) + A + 0.5 * A @ A + A @ A @ A / 6.0
        GQ = G @ density @ G.T * step
        predict_into(x, P, Phi, 0.5 * (Phi @ GQ @ Phi.T + GQ))
        if not update_joseph(x, P, v[k, :axes].copy(), H, R, dz, S, standardized):
            raise AlignmentError("the filter broke down: the data are not finite, or not those of a base at rest")
        phi[k], sigma[k] = x[axes : axes + 3], np.sqrt(np.diag(P)[axes : axes + 3])
    after = np.concatenate([path[1:], computed[None]])
    corrected = exp_so3(phi) @ after
    return corrected[-1], P[axes : axes + 3, axes : axes + 3], x, phi, corrected, sigma


def align_stationary(
    rate: Array,
    force: Array,
    dt: float,
    lat: float,
    imu: ImuNoise,
    settings: StationarySettings | None = None,
    start: Array | None = None,
    check: bool = True,
) -> tuple[Alignment, History]:
    """Fine alignment at rest, seed 001.

    Parameters
    ----------
    rate, force : (m, 3), body rate [rad/s] and specific force [m/s^2], means over dt
    dt : s
    lat : rad
    imu : noise and biases of an axis
    settings : None: 7 states, restarts at 60 and 120 s
    start : (3, 3), attitude to begin with; None: none is known, and a coarse alignment comes first
    check : whether data of a base that moves, or of another latitude, are refused (`coarse.check_still`)

    Returns
    -------
    Alignment at the end of the data, History

    Raises
    ------
    AlignmentError
        The base moves, wrong latitude, beyond 85 deg, too few data.

    Notes
    -----
    One correction at the end leaves phi^2 / 2 of the initial misalignment (seed 001, table 2): the model is linear, whatever its order. Restarts
    correct the attitude and begin anew from a small one; the limit is then that of the biases, bias / g and eps_E / (W cos L).
    """
    settings = settings or StationarySettings()
    if settings.states not in MODELS:
        raise AlignmentError(f"the stationary model has 7, 10 or 12 states, not {settings.states}")
    check_latitude(lat)
    rate, force = np.ascontiguousarray(rate, dtype=np.float64), np.ascontiguousarray(force, dtype=np.float64)
    total = len(rate) * dt
    if check:
        check_still(rate, force, dt, lat, imu.arw, imu.vrw, imu.bias_g, imu.bias_a)
    per = max(1, round(settings.period_s / dt))
    if len(rate) < 2 * per or not (np.all(np.isfinite(rate)) and np.all(np.isfinite(force))):
        raise AlignmentError(f"{total:.3g} s of data are not enough, or not finite")
    if start is None:
        m = min(len(rate), max(1, round(settings.coarse_s / dt)))
        C = triad(force[:m].mean(axis=0), rate[:m].mean(axis=0), lat)
    else:
        C = np.array(start, dtype=np.float64)
    begins = [0] + [round(t / dt / per) * per for t in settings.restarts_s if 0.0 < t < total - 2.0 * settings.period_s]
    t, attitudes, sigmas = [], [], []
    result = None
    for stage, (i, j) in enumerate(zip(begins, [*begins[1:], len(rate)], strict=True)):
        angle = math.radians(settings.restart_angle_deg if stage or start is None else settings.start_angle_deg)
        result = _stage(C, rate[i:j], force[i:j], dt, lat, angle, imu, settings)
        C = result[0]
        t.append((i + per * np.arange(1, len(result[4]) + 1)) * dt)
        attitudes.append(result[4])
        sigmas.append(result[5])
    if settings.again:
        result = _stage(C, rate, force, dt, lat, math.radians(settings.restart_angle_deg), imu, settings)
        t.append(t[-1][-1:])
        attitudes.append(result[0][None])
        sigmas.append(result[5][-1:])
    assert result is not None
    C, P, x = result[0], result[1], result[2]
    bias_g = C.T @ [x[5], 0.0, x[6]] if settings.states == 7 else x[-3:]
    unseen = bias_covariance(lat, C, imu.bias_g**2 * np.eye(3), imu.bias_a**2 * np.eye(3)) if settings.states == 7 else np.zeros((3, 3))
    done = Alignment(f"stationary {settings.states} states", C, P + unseen, total, bias_g)
    return done, History(np.concatenate(t), np.concatenate(attitudes), np.concatenate(sigmas))
