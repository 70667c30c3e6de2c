"""Heave: a phase-corrected high-pass filter of the vertical velocity, sample by sample, in plain floats.

Lives here: `HeaveFilter`, `transfer` (its frequency response) and the gain of a slow velocity error to an error of heave.
Does not live here: which point of the ship, validity (motion.py), ROS (nodes/motion.py).
"""

from __future__ import annotations

import functools
import math

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

Array = NDArray[np.float64]

_B1, _B2 = 2.0 * math.cos(math.pi / 8.0) + 2.0 * math.cos(3.0 * math.pi / 8.0), 2.0 + math.sqrt(2.0)
"""Coefficients of the Butterworth polynomial s^4 + b1 s^3 + b2 s^2 + b1 s + 1."""
SETTLING_PERIODS = 2.3
"""Cut-off periods until a step of the mean level has fallen to 1 % for good (measured by a test)."""


class HeaveFilter:
    """Heave and its rate from vertical velocity.

    Parameters
    ----------
    cutoff_period_s : Tc; motion slower than this is mean level

    Notes
    -----
    From true vertical displacement to heave, with w = 2 pi / Tc,

        H(s) = s^2 (s^2 + b1 w s + b2 w^2) / (s^4 + b1 w s^3 + b2 w^2 s^2 + b1 w^3 s + w^4),

    and from vertical velocity H(s) / s. A plain high-pass s^n / D(s) leads by about b1 w / omega: a wave of 10 s with Tc = 80 s would be out by
    a fifth of itself, which is why a heave sensor without phase correction needs a cut-off of many minutes and lets as much drift through. Here
    the two numerator terms take the first two powers of w / omega out of H - 1 = -(b1 w^3 s + w^4) / D(s), which falls with the third power.
    The price is that of the double zero at s = 0 that remains: a constant velocity error gives no heave, a constant acceleration error `a`
    gives b2 a / w^2. The vertical channel of the navigator, bound to the mean sea level, has none; what slow error it has is `drift_gain`.

    Realised in controllable form with the velocity linear between samples, so the interval may change from sample to sample.
    """

    def __init__(self, cutoff_period_s: float) -> None:
        self._w = 2.0 * math.pi / cutoff_period_s
        self._x = [0.0, 0.0, 0.0, 0.0]
        self._u = 0.0

    def start(self, velocity: float) -> None:
        """Begin anew, at heave zero, with this vertical velocity [m/s, up]."""
        self._x, self._u = [0.0, 0.0, 0.0, 0.0], velocity

    def step(self, dt_ns: int, velocity: float) -> tuple[float, float]:
        """Take one sample.

        Parameters
        ----------
        dt_ns : time since the last sample, > 0, ns
        velocity : vertical velocity at the sample, up, m/s

        Returns
        -------
        heave [m], its rate [m/s], up positive
        """
        a, b, c = _discrete(self._w, dt_ns)
        x, u0, u1 = self._x, self._u, velocity
        self._x = [r[0] * x[0] + r[1] * x[1] + r[2] * x[2] + r[3] * x[3] + p * u0 + q * u1 for r, p, q in zip(a, b, c, strict=True)]
        self._u = u1
        w, x = self._w, self._x
        heave = x[3] + _B1 * w * x[2] + _B2 * w * w * x[1]
        return heave, u1 - _B1 * w**3 * x[1] - w**4 * x[0]


def transfer(period_s: float, cutoff_period_s: float) -> complex:
    """H(j omega) of `HeaveFilter` from true displacement to heave, at a wave period [s]."""
    s = 1j * cutoff_period_s / period_s
    return (s**4 + _B1 * s**3 + _B2 * s**2) / (s**4 + _B1 * s**3 + _B2 * s**2 + _B1 * s + 1.0)


def drift_gain(cutoff_period_s: float, correlation_time_s: float) -> tuple[float, float]:
    """Sigma of heave [m] and of its rate [m/s] per sigma of a first-order Gauss-Markov error of the vertical velocity [m/s].

    Parameters
    ----------
    cutoff_period_s : of the filter
    correlation_time_s : of the velocity error

    Returns
    -------
    two gains, [s] and dimensionless, from the Lyapunov equation of filter and error together
    """
    w = 2.0 * math.pi / cutoff_period_s
    A = np.zeros((5, 5))
    A[:4, :4], A[3, 4], A[4, 4] = _dynamics(w), 1.0, -1.0 / correlation_time_s
    Q = np.zeros((5, 5))
    Q[4, 4] = 2.0 / correlation_time_s
    P = scipy.linalg.solve_continuous_lyapunov(A, -Q)
    outputs = np.array([[0.0, _B2 * w * w, _B1 * w, 1.0, 0.0], [-(w**4), -_B1 * w**3, 0.0, 0.0, 1.0]])
    heave, rate = np.sqrt(np.diag(outputs @ P @ outputs.T))
    return float(heave), float(rate)


def _dynamics(w: float) -> Array:
    A = np.diag(np.ones(3), 1)
    A[3] = [-(w**4), -_B1 * w**3, -_B2 * w * w, -_B1 * w]
    return A


@functools.lru_cache(maxsize=256)
def _discrete(w: float, dt_ns: int) -> tuple[list[list[float]], list[float], list[float]]:
    """x(k+1) = a x(k) + b u(k) + c u(k+1), exact for u linear in between."""
    dt = dt_ns * 1e-9
    M = np.zeros((6, 6))
    M[:4, :4], M[3, 4], M[4, 5] = _dynamics(w) * dt, dt, 1.0
    E = scipy.linalg.expm(M)
    return E[:4, :4].tolist(), (E[:4, 4] - E[:4, 5]).tolist(), E[:4, 5].tolist()
