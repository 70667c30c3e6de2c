"""The ship of seed 003 as a linear simulation of its errors: voyage, sensors, aids, faults, drawn for one seed.

Lives here: the path and its transition matrices, the truth of the 17 platform error states, measurements of GPS, BDS and Doppler log, faults.
Does not live here: filters and numbers (ship.py), the error model (riins_core.platform_error), the full strapdown (riins_eval.offline).
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from riins_core.earth import radii_s
from riins_core.noise import normal
from riins_core.platform_error import N_PLATFORM, Damping, PlatformNoise, PlatformState, platform_dynamics, self_aligned
from riins_core.sensor_errors import ARCMIN, KNOT
from riins_federated.aiding import Measurement

Array = NDArray[np.float64]

HOURS = 12
PERIOD = 10
"""Of the aids and of an epoch, s; the transition is made of steps of one second."""
EPOCHS = HOURS * 3600 // PERIOD
BEGIN = 2 * 3600 // PERIOD
"""Epoch at which the filters begin; before, the INS is alone."""
LATITUDE = math.radians(40.0 + 40.0 / 60.0)
SPEED = 15.0 * KNOT
TURN_EVERY, TURN_S = 5400, 90
SIGMA = (30.0, 100.0, 0.25 * KNOT)
"""GPS, BDS [m], log [m/s], an axis."""
ROWS = (
    (PlatformState.POS_N, PlatformState.POS_E),
    (PlatformState.POS_N, PlatformState.POS_E),
    (PlatformState.VEL_E, PlatformState.VEL_N),
)
GPS, BDS, LOG = range(3)
NOISE = PlatformNoise()
DAMPED = Damping()


class Fault(NamedTuple):
    """A fault of one aid between two epochs: a constant and a slope [unit of the aid, /s] on each component."""

    aid: int
    first: int
    last: int
    step: tuple[float, float] = (0.0, 0.0)
    slope: tuple[float, float] = (0.0, 0.0)

    def covers(self, epoch: int) -> bool:
        """Whether it is on."""
        return self.first <= epoch < self.last

    def at(self, epoch: int) -> Array:
        """What it adds (2,)."""
        return np.array(self.step) + np.array(self.slope) * PERIOD * (epoch - self.first + 1)


def epoch_of(hours: float) -> int:
    """Epoch at a time of the voyage."""
    return round(hours * 3600.0 / PERIOD)


SEED_FAULTS = (
    Fault(LOG, epoch_of(5.0), epoch_of(5.0) + 30, (10.0 * KNOT, 10.0 * KNOT)),
    Fault(GPS, epoch_of(9.0), epoch_of(9.0) + 30, (10.0 * ARCMIN * 6.36e6, 10.0 * ARCMIN * 4.84e6)),
)
"""003: 10 kn on the log at 5 h, 10 arcmin of latitude and longitude at 9 h, five minutes each; its heading fault of GPS has no observation in H1."""


def outage(aid: int, epoch: int) -> bool:
    """003: GPS away from the second to the third hour, the log from the third to the fourth."""
    return (aid == GPS and epoch_of(2.0) <= epoch < epoch_of(3.0)) or (aid == LOG and epoch_of(3.0) <= epoch < epoch_of(4.0))


@dataclass(frozen=True)
class Model:
    """Transitions of a voyage and what is drawn from them.

    Phi, Qd, root: (epochs, 17, 17) to each epoch, root root' = Qd; A: square root of the covariance at the start; P: covariance when the filters
    begin.
    """

    Phi: Array
    Qd: Array
    root: Array
    A: Array
    P: Array


def _path(straight: bool) -> tuple[Array, Array, Array, Array]:
    """Heading changes by 90 deg at 1 deg/s every 1.5 h; latitude, velocity east and north, centripetal force each second."""
    seconds = EPOCHS * PERIOD
    t = np.arange(seconds)
    number, since = np.divmod(t, TURN_EVERY)  # the first leg ends with the first turn
    turned = np.where(number > 0, 90.0 * (number - 1) + np.clip(since + 1, 0, TURN_S), 0.0) * (not straight)
    heading = np.radians(turned)
    rate = np.gradient(heading)
    v_n, v_e = SPEED * np.cos(heading), SPEED * np.sin(heading)
    lat = LATITUDE + np.concatenate([[0.0], np.cumsum(v_n[:-1])]) / radii_s(LATITUDE)[0]
    return lat, v_e, v_n, rate


@functools.lru_cache(maxsize=4)
def model(damping: Damping = DAMPED, straight: bool = False) -> Model:
    """The voyage's transitions, computed once: fourth order over each second, the noise by the trapezoid rule."""
    lat, v_e, v_n, rate = _path(straight)
    q = np.diag(NOISE.density())
    one = np.eye(N_PLATFORM)
    Phi, Qd = np.empty((EPOCHS, N_PLATFORM, N_PLATFORM)), np.empty((EPOCHS, N_PLATFORM, N_PLATFORM))
    for k in range(EPOCHS):
        steady = not rate[k * PERIOD : (k + 1) * PERIOD].any()
        total, noise = one, np.zeros_like(one)
        for second in range(k * PERIOD, (k + 1) * PERIOD):
            if not steady or second == k * PERIOD:
                f_e, f_n = v_n[second] * rate[second], -v_e[second] * rate[second]
                F = platform_dynamics(lat[second], v_e[second], v_n[second], f_e, f_n, damping, NOISE.markov_time)
                step = one + F @ (one + F @ (one / 2.0 + F @ (one / 6.0 + F / 24.0)))
            noise = step @ (noise + 0.5 * q) @ step.T + 0.5 * q
            total = step @ total
        Phi[k], Qd[k] = total, noise
    scale = np.sqrt(np.maximum(Qd.diagonal(axis1=1, axis2=2), 1e-60))
    values, vectors = np.linalg.eigh(Qd / (scale[:, :, None] * scale[:, None, :]))
    root = scale[:, :, None] * vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]
    A = self_aligned(LATITUDE, NOISE)
    P = A @ A.T
    for k in range(BEGIN):
        P = Phi[k] @ P @ Phi[k].T + Qd[k]
    return Model(Phi, Qd, root, A, 0.5 * (P + P.T))


@dataclass(frozen=True)
class Voyage:
    """One seed: truth (epochs, 17) and the measurements' noise (epochs, 3, 2), INS minus aid."""

    truth: Array
    noise: Array

    def measurements(self, epoch: int, faults: tuple[Fault, ...] = (), outages: bool = True, louder: float = 1.0) -> list[Measurement | None]:
        """What the aids give at an epoch; `louder` scales the noise of GPS. The measurement is INS - aid, so H is the seed's."""
        made: list[Measurement | None] = []
        for aid, rows in enumerate(ROWS):
            if outages and outage(aid, epoch):
                made.append(None)
                continue
            z = self.truth[epoch, rows] - self.noise[epoch, aid] * (louder if aid == GPS else 1.0)
            for fault in faults:
                if fault.aid == aid and fault.covers(epoch):
                    z = z - fault.at(epoch)
            made.append(Measurement(z, _H[aid], _R[aid]))
        return made


_H = [np.eye(N_PLATFORM)[list(rows)] for rows in ROWS]
_R = [sigma**2 * np.eye(2) for sigma in SIGMA]


def voyage(seed: int, made: Model) -> Voyage:
    """Draw the truth and the noise of one seed."""
    x = made.A @ normal(seed, "ship start", 0, 1, N_PLATFORM)[0]
    drive = normal(seed, "ship process", 0, EPOCHS, N_PLATFORM)
    truth = np.empty((EPOCHS, N_PLATFORM))
    for k in range(EPOCHS):
        x = made.Phi[k] @ x + made.root[k] @ drive[k]
        truth[k] = x
    noise = normal(seed, "ship aids", 0, EPOCHS, 6).reshape(EPOCHS, 3, 2) * np.array(SIGMA)[:, None]
    return Voyage(truth, noise)
