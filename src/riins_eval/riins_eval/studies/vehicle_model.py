"""The car of seed 004 as a linear simulation of its errors: drive, MEMS IMU, GNSS, odometer, altimeter, and the filter's innovations of many drives.

Lives here: the drive and its transition matrices, truth and measurements of one seed, faults, noise that varies, `Judge` (innovations and how a
fault shows in them). Does not live here: structures, tests, numbers (vehicle.py), figures (vehicle_figures.py), the strapdown (riins_eval.offline).
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from riins_core.earth import gravity, radii
from riins_core.ins_error import error_dynamics
from riins_core.noise import normal
from riins_core.rotation import dcm_from_euler, skew
from riins_core.sensor_errors import DEG, DEG_PER_H, DEG_PER_SQRT_H, MICRO_G
from riins_federated.aiding import Measurement

Array = NDArray[np.float64]

SECONDS = 450
"""Of the drive, 004; one epoch a second."""
N = 19
"""15 of the INS; scale, yaw and pitch of the odometer against the IMU; slow error of the altimeter."""
ODOMETER_STATES, ALTIMETER_STATE = slice(15, 18), 18
GNSS, ODOMETER, ALTIMETER = range(3)
NAMES = ("GNSS", "odometer", "altimeter")
COLUMNS = (slice(0, 6), slice(6, 9), slice(9, 10))
"""Of each aid in a row of measurements: position and velocity north, east, down; forward, starboard, down; height."""
GNSS_POSITION, GNSS_VELOCITY = (5.0, 5.0, 8.0), 0.2
ODOMETER_SIGMA, ALTIMETER_SIGMA = 0.1, 1.0
SIGMA = np.array([*GNSS_POSITION, *(GNSS_VELOCITY,) * 3, *(ODOMETER_SIGMA,) * 3, ALTIMETER_SIGMA])
"""White noise of each measurement, m and m/s; 004 gives none."""
SCALE, MOUNTING = 5e-3, 0.5 * DEG
WEATHER, WEATHER_TIME = 3.0, 600.0
"""Slow error of the altimeter, m and s."""
GYRO_BIAS, ARW, ACCEL_BIAS, VRW = 10.0 * DEG_PER_H, 0.3 * DEG_PER_SQRT_H, 2000.0 * MICRO_G, 100.0 * MICRO_G
"""MEMS IMU; what the MSI3200 of 004 has is not told."""
LOUDER = ((GNSS, 100, 170, 3.0), (ODOMETER, 200, 270, 4.0), (ALTIMETER, 300, 370, 4.0))
"""Where the noise of an aid grows and nobody tells: houses, slipping wheels, wind; aid, seconds, factor."""
_SPEEDS = ((10, 15.0, 1.0), (90, 8.0, -1.0), (130, 18.0, 1.0), (250, 12.0, -1.0), (330, 16.0, 1.0))
"""Changes of speed: second, new speed m/s, acceleration m/s^2."""


class Fault(NamedTuple):
    """A fault of GNSS's north position between two epochs: a step [m] and a slope [m/s]."""

    first: int
    last: int
    step: float = 0.0
    slope: float = 0.0

    def at(self, epoch: int) -> float:
        """What it adds, m."""
        return self.step + self.slope * (epoch - self.first + 1) if self.first <= epoch < self.last else 0.0


@dataclass(frozen=True)
class Model:
    """Transitions (seconds, N, N), square roots of the process noise, covariance of the start and its root, (seconds, 10, N) of the measurements."""

    Phi: Array
    Qd: Array
    root: Array
    A: Array
    P: Array
    H: Array
    speed: Array


def speeds() -> tuple[Array, Array]:
    """Speed [m/s] at the end of each second and the acceleration [m/s^2] within it, (seconds,)."""
    acceleration = np.zeros(SECONDS)
    now = 0.0
    for second, speed, rate in _SPEEDS:
        acceleration[second : second + round((speed - now) / rate)] = rate
        now = speed
    return np.cumsum(acceleration), acceleration


@functools.cache
def model() -> Model:
    """The straight drive near Nanjing, level, heading 60 deg, with changes of speed; errors computed - true, NED."""
    C = dcm_from_euler(0.0, 0.0, np.radians(60.0))
    q = np.zeros(N)
    q[3:6], q[6:9], q[ALTIMETER_STATE] = VRW**2, ARW**2, 2.0 * WEATHER**2 / WEATHER_TIME
    lat, height, one = np.radians(32.0), 20.0, np.eye(N)
    speed, acceleration = speeds()
    Phi, Qd, H = np.empty((SECONDS, N, N)), np.empty((SECONDS, N, N)), np.zeros((SECONDS, SIGMA.size, N))
    for k in range(SECONDS):
        v_n = C @ [speed[k], 0.0, 0.0]
        f_b = np.array([acceleration[k], 0.0, -float(gravity(lat, height))])
        F = np.zeros((N, N))
        F[:15, :15] = error_dynamics(np.array([lat, 0.0, height, *v_n]), C @ f_b, C)
        F[ALTIMETER_STATE, ALTIMETER_STATE] = -1.0 / WEATHER_TIME
        Phi[k] = one + F @ (one + F @ (one / 2.0 + F / 6.0))
        Qd[k] = 0.5 * (Phi[k] * q @ Phi[k].T + np.diag(q))
        lat += v_n[0] / (float(radii(lat)[0]) + height)
        H[k, COLUMNS[GNSS], :6] = np.eye(6)
        H[k, COLUMNS[ODOMETER], 3:6], H[k, COLUMNS[ODOMETER], 6:9] = C.T, -C.T @ skew(v_n)  # computed v_b = C_bn (I + [phi x]) (v + dv)
        H[k, COLUMNS[ODOMETER], ODOMETER_STATES] = -speed[k] * np.eye(3)  # the travel is not along the IMU's forward axis
        H[k, COLUMNS[ALTIMETER], 2], H[k, COLUMNS[ALTIMETER], ALTIMETER_STATE] = -1.0, -1.0
    scale = np.sqrt(np.maximum(Qd.diagonal(axis1=1, axis2=2), 1e-60))
    values, vectors = np.linalg.eigh(Qd / (scale[:, :, None] * scale[:, None, :]))
    root = scale[:, :, None] * vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]
    start = np.zeros(N)
    start[:15] = [5.0] * 3 + [0.2] * 3 + [0.15 * DEG] * 2 + [1.0 * DEG] + [GYRO_BIAS] * 3 + [ACCEL_BIAS] * 3
    start[ODOMETER_STATES], start[ALTIMETER_STATE] = (SCALE, MOUNTING, MOUNTING), WEATHER
    return Model(Phi, Qd, root, np.diag(start), np.diag(start**2), H, speed)


@dataclass(frozen=True)
class Drive:
    """One seed: truth (seconds, N) and the noise of the measurements (seconds, 10)."""

    truth: Array
    noise: Array

    def measurements(self, epoch: int, faults: tuple[Fault, ...] = (), louder: bool = False, told: bool = False) -> list[Measurement | None]:
        """What the aids give, INS - aid.

        Parameters
        ----------
        epoch : second of the drive
        faults : of GNSS
        louder : the noise varies as in `LOUDER`
        told : and R says so
        """
        made, H = [], model().H[epoch]
        for aid, rows in enumerate(COLUMNS):
            factor = next((f for a, first, last, f in LOUDER if louder and a == aid and first <= epoch < last), 1.0)
            z = H[rows] @ self.truth[epoch] - factor * self.noise[epoch, rows]
            if aid == GNSS:
                z[0] -= sum(fault.at(epoch) for fault in faults)
            made.append(Measurement(z, H[rows], np.diag((SIGMA[rows] * (factor if told else 1.0)) ** 2)))
        return list(made)


@functools.lru_cache(maxsize=4)
def drive(seed: int) -> Drive:
    """Draw one seed."""
    made = model()
    x = made.A @ normal(seed, "vehicle start", 0, 1, N)[0]
    wander = normal(seed, "vehicle process", 0, SECONDS, N)
    truth = np.empty((SECONDS, N))
    for k in range(SECONDS):
        x = truth[k] = made.Phi[k] @ x + made.root[k] @ wander[k]
    return Drive(truth, SIGMA * normal(seed, "vehicle aids", 0, SECONDS, SIGMA.size))


class Judge:
    """The exact filter of some aids, on many drives at once: without a fault its gains do not depend on what is measured.

    Parameters
    ----------
    aids : those it fuses, GNSS among them, whose innovations it gives

    Attributes
    ----------
    L : (seconds, 6, 6), square root of the covariance of GNSS's innovation
    """

    def __init__(self, aids: tuple[int, ...]) -> None:
        made = model()
        rows = np.concatenate([np.arange(SIGMA.size)[COLUMNS[aid]] for aid in aids])
        self._H, self._sigma = made.H[:, rows], SIGMA[rows]
        self._gain = np.empty((SECONDS, N, rows.size))
        self.L = np.empty((SECONDS, 6, 6))
        P, R = made.P, np.diag(self._sigma**2)
        for k in range(SECONDS):
            P = made.Phi[k] @ P @ made.Phi[k].T + made.Qd[k]
            H = self._H[k]
            S = H @ P @ H.T + R
            K = self._gain[k] = np.linalg.solve(S, H @ P).T
            self.L[k] = np.linalg.cholesky(S[:6, :6])
            left = np.eye(N) - K @ H
            P = left @ P @ left.T + K @ R @ K.T

    def innovations(self, seed: int, drives: int) -> Array:
        """Standardized innovations of GNSS on drives without a fault, (drives, seconds, 6)."""
        made, m = model(), self._sigma.size
        error = normal(seed, "vehicle starts", 0, drives, N) @ made.A.T
        out = np.empty((drives, SECONDS, 6))
        for k in range(SECONDS):
            draw = normal(seed, f"vehicle drives {k}", 0, drives, N + m)
            error = error @ made.Phi[k].T + draw[:, :N] @ made.root[k].T
            z = draw[:, N:] * self._sigma - error @ self._H[k].T
            error = error + z @ self._gain[k].T
            out[:, k] = np.linalg.solve(self.L[k], z[:, :6].T).T
        return out

    def shift(self, fault: Fault) -> Array:
        """What a fault that is fused adds to the standardized innovations, (seconds, 6): the filter follows it."""
        made, error = model(), np.zeros(N)
        out = np.zeros((SECONDS, 6))
        for k in range(fault.first, SECONDS):
            error = made.Phi[k] @ error
            z = -self._H[k] @ error
            z[0] -= fault.at(k)
            error = error + self._gain[k] @ z
            out[k] = np.linalg.solve(self.L[k], z[:6])
        return out


@functools.cache
def judge(aids: tuple[int, ...]) -> Judge:
    """A judge made once."""
    return Judge(aids)
