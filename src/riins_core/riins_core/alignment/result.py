"""What an alignment hands back, when it refuses, and the limits no alignment from the IMU alone can beat.

Lives here: `Alignment`, `AlignmentError`, `TooSoon`, `check_latitude`, `bounds`, `settled_after`, `attitude_error`, `bias_covariance`,
`bias_response`.
Does not live here: any method (the other modules of this package).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ..earth import OMEGA_IE, gravity
from ..rotation import euler_from_dcm, log_so3

Array = NDArray[np.float64]

MAX_LATITUDE = math.radians(85.0)
"""Beyond it the horizontal Earth rate is below 9 % of the whole, and the local level frame turns with every step."""


class AlignmentError(ValueError):
    """No attitude can be given; the message says why in one line."""


class TooSoon(AlignmentError):
    """No attitude yet: more data may give it."""


@dataclass(frozen=True)
class Alignment:
    """Result of an alignment.

    Attributes
    ----------
    method : name
    C_nb : (3, 3), body FRD to NED at `time`
    P : (3, 3), covariance of the attitude error phi (NED; computed C_nb = (I - [phi x]) true C_nb), rad^2, with what the biases do that cannot be
    seen
    time : s since the first sample's interval began
    bias_g, bias_a : (3,), estimated biases in the body, measured - true, rad/s and m/s^2; zero where the method has none
    phase : "coarse" or "fine"
    """

    method: str
    C_nb: Array
    P: Array
    time: float
    bias_g: Array = field(default_factory=lambda: np.zeros(3))
    bias_a: Array = field(default_factory=lambda: np.zeros(3))
    phase: str = "fine"

    @property
    def euler(self) -> tuple[float, float, float]:
        """Roll, pitch and heading, rad."""
        roll, pitch, heading = euler_from_dcm(self.C_nb)
        return float(roll), float(pitch), float(heading)

    @property
    def sigma(self) -> Array:
        """(3,), standard deviations of phi, rad: tilts about north and east, heading."""
        return np.sqrt(np.diag(self.P))


def check_latitude(lat: float) -> None:
    """Refuse a latitude at which heading from the Earth rate makes no sense.

    Raises
    ------
    AlignmentError
        Not finite, beyond a pole, or beyond `MAX_LATITUDE`.
    """
    if not math.isfinite(lat) or abs(lat) > 0.5 * math.pi:
        raise AlignmentError(f"the latitude {math.degrees(lat):.6g} deg is not one")
    if abs(lat) > MAX_LATITUDE:
        raise AlignmentError(
            f"the latitude {math.degrees(lat):.2f} deg is beyond {math.degrees(MAX_LATITUDE):.0f} deg: no heading from the Earth rate"
        )


def bounds(lat: float, sigma_g: float, sigma_a: float) -> tuple[float, float]:
    """What a static alignment is left with, whatever the filter: level bias / g and heading eps / (W cos L).

    Parameters
    ----------
    lat : rad
    sigma_g, sigma_a : standard deviations of the fused triad's biases, rad/s and m/s^2

    Returns
    -------
    level, heading : rad
    """
    return sigma_a / float(gravity(lat, 0.0)), sigma_g / (OMEGA_IE * math.cos(lat))


def settled_after(t: Array, sigma: Array, limit: float, factor: float = 2.0) -> float:
    """Time [s] from which the heading's error bound stays inside a limit, as IMO A.821(19) and A.424(XI) ask of a gyrocompass.

    Parameters
    ----------
    t : (k,), s
    sigma : (k,), standard deviation of the heading at these times, rad
    limit : rad
    factor : the bound is factor sigma

    Returns
    -------
    s; infinite where the last bound is outside
    """
    outside = np.flatnonzero(factor * np.asarray(sigma) > limit)
    if not len(outside):
        return float(t[0])
    return float(t[outside[-1] + 1]) if outside[-1] + 1 < len(t) else math.inf


def bias_covariance(lat: float, C_nb: Array, cov_g: Array, cov_a: Array) -> Array:
    """Covariance of phi that biases leave at rest, (3, 3).

    Parameters
    ----------
    lat : rad
    C_nb : (3, 3)
    cov_g, cov_a : (3, 3), covariances of the biases in the body, (rad/s)^2 and (m/s^2)^2

    Notes
    -----
    phi_N = a_E / g, phi_E = -a_N / g, phi_D = (C b_g)_E / (W cos L) - tan L a_E / g: thesis (3-6) in our signs.
    """
    by_g, by_a = bias_response(lat, C_nb)
    return np.asarray(by_a @ cov_a @ by_a.T + by_g @ cov_g @ by_g.T)


def bias_response(lat: float, C_nb: Array) -> tuple[Array, Array]:
    """phi (3, 3) that a unit of each gyro's [rad/s] and each accelerometer's [m/s^2] bias leaves at rest; see `bias_covariance`."""
    g, north = float(gravity(lat, 0.0)), OMEGA_IE * math.cos(lat)
    by_a = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, -math.tan(lat), 0.0]]) / g @ C_nb
    by_g = np.zeros((3, 3))
    by_g[2] = C_nb[1] / north
    return by_g, np.asarray(by_a)


def attitude_error(C_nb: Array, true: Array) -> Array:
    """phi (3,), rad, of a computed attitude: exp(phi) C_nb = true."""
    return log_so3(true @ C_nb.T)
