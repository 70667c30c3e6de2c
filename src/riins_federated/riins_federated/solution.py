"""What the navigator says of its state: modes and validity flags.

Lives here: `solution`, which turns nominal state, error estimate and covariance into a NavSolution.
Does not live here: the filter (integrated_filter.py), the message (riins_node.fields).
"""

from __future__ import annotations

import math

import numpy as np

from riins_core.earth import OMEGA_IE, radii_s
from riins_core.jit import jit
from riins_core.rotation import euler_from_dcm
from riins_fdi.eraim import largest_horizontal
from riins_fdi.innovation import nis_threshold

from .config import ValidityLimits
from .state_blocks import StateModel
from .types import Array, Mode, NavSolution, Validity

P95 = nis_threshold(0.05, 2)
"""Square of the 95 % radius of a circular unit normal."""


@jit
def body_rate(nav: Array, rate_ib: Array) -> Array:
    """Rate of the body relative to NED, (3,), rad/s, FRD, from its inertial rate less bias."""
    r_m, r_n = radii_s(nav[0])
    east = nav[4] / (r_n + nav[2])
    north, down = OMEGA_IE * math.cos(nav[0]) + east, -OMEGA_IE * math.sin(nav[0]) - east * math.tan(nav[0])
    west = -nav[3] / (r_m + nav[2])
    out = np.empty(3)
    for i in range(3):
        out[i] = rate_ib[i] - (nav[6 + i] * north + nav[9 + i] * west + nav[12 + i] * down)
    return out


def solution(
    stamp_ns: int,
    nav: Array,
    parameters: Array,
    states: StateModel,
    rate: Array,
    force: Array,
    x: Array,
    P: Array,
    mode: Mode,
    limits: ValidityLimits,
    protection: tuple[float, float],
    reset_count: int,
    reset: tuple[float, float, float],
) -> NavSolution:
    """Corrected navigation state with its accuracy and validity.

    Parameters
    ----------
    stamp_ns : measurement time
    nav, parameters : (16,), (n - 9,), nominal state and estimated parameters
    states : the assembled error state
    rate, force : (3,), last sample as it came, rad/s, m/s^2, FRD
    x, P : (n,), (n, n), estimated error state and covariance
    mode, limits, reset_count, reset : as in NavSolution
    protection : radius [m] and heading [rad], see NavSolution

    Returns
    -------
    NavSolution
    """
    nav, parameters = nav.copy(), parameters.copy()
    if x.any():
        states.correct(nav, parameters, x)
    C_nb = nav[6:15].reshape(3, 3)
    roll, pitch, heading = euler_from_dcm(C_nb)
    bias_g, bias_a = states.biases(parameters)
    lon = (nav[1] + math.pi) % (2.0 * math.pi) - math.pi
    return NavSolution(
        stamp_ns,
        float(nav[0]),
        lon,
        float(nav[2]),
        nav[3:6].copy(),
        np.array([roll, pitch, heading]),
        C_nb.copy(),
        body_rate(nav, states.rate(parameters, rate)),
        states.force(parameters, force),
        bias_g.copy(),
        bias_a.copy(),
        P.copy(),
        mode,
        validity(P, float(nav[0]), mode, limits),
        *protection,
        reset_count,
        reset,
    )


def validity(P: Array, lat: float, mode: Mode, limits: ValidityLimits) -> tuple[Validity, Validity, Validity]:
    """Validity of position, velocity and heading (MSC.252(83)).

    A datum is valid while its 95 % error is within the limit and an aid supports it; doubtful beyond that or while coasting; invalid
    beyond the outer limit or without a solution. The heading of an inertial system does not need the aids from minute to minute,
    so coasting alone does not make it doubtful.
    """
    if mode not in (Mode.NAVIGATING, Mode.COASTING):
        return (Validity.INVALID,) * 3
    secant = 1.0 / max(math.cos(lat), 1e-6)
    position = math.sqrt(P95 * largest_horizontal(P[0, 0], P[1, 1], P[0, 1]))
    velocity = math.sqrt(P95 * largest_horizontal(P[3, 3], P[4, 4], P[3, 4]))
    heading = 1.96 * math.degrees(math.sqrt(P[8, 8]))
    supported = mode is Mode.NAVIGATING

    def judge(error: float, limit: float, outer: float, supported: bool) -> Validity:
        if not error <= outer:
            return Validity.INVALID
        return Validity.VALID if error <= limit and supported else Validity.DOUBTFUL

    return (
        judge(position, limits.position_m, limits.position_invalid_m, supported),
        judge(velocity, limits.velocity_mps, limits.velocity_invalid_mps, supported),
        judge(heading, limits.heading_deg * secant, limits.heading_invalid_deg * secant, True),
    )
