"""The truth in the shape of a navigation solution, so that it is published and recorded by the same code as the navigator's.

Lives here: `TrueSolution`, `true_solution`.
Does not live here: messages (riins_node.fields), the kinematics (trajectory.py).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from riins_core.rotation import euler_from_dcm

from .trajectory import Truth

Array = NDArray[np.float64]

_NAVIGATING = 2
"""riins_msgs/NavState.MODE_NAVIGATING."""


@dataclass(frozen=True)
class TrueSolution:
    """Truth at one time with the attributes of a NavSolution.

    Attributes
    ----------
    stamp_ns : int
    lat, lon, h : rad, rad, m
    v_n : (3,), NED, m/s
    rph : (3,), roll, pitch, heading, rad
    C_nb : (3, 3)
    rate_b : (3,), w_nb in FRD, rad/s
    force_b : (3,), specific force in FRD, m/s^2
    bias_g, bias_a : (3,), true biases of the fused triad, rad/s, m/s^2; zeros where not given
    P : (15, 15), zeros
    mode, validity, protection_radius, protection_heading, reset_count, reset : navigating, valid, none
    """

    stamp_ns: int
    lat: float
    lon: float
    h: float
    v_n: Array
    rph: Array
    C_nb: Array
    rate_b: Array
    force_b: Array
    bias_g: Array = field(default_factory=lambda: np.zeros(3))
    bias_a: Array = field(default_factory=lambda: np.zeros(3))
    P: Array = field(default_factory=lambda: np.zeros((15, 15)))
    mode: int = _NAVIGATING
    validity: tuple[int, int, int] = (0, 0, 0)
    protection_radius: float = 0.0
    protection_heading: float = 0.0
    reset_count: int = 0
    reset: tuple[float, float, float] = (0.0, 0.0, 0.0)


def true_solution(truth: Truth, i: int, stamp_ns: int, bias_g: Array | None = None, bias_a: Array | None = None) -> TrueSolution:
    """Row i of a Truth as a solution.

    Parameters
    ----------
    truth : kinematics
    i : row
    stamp_ns : of that row
    bias_g, bias_a : (3,), true biases of the fused triad, FRD; None: zeros
    """
    rph = np.array([float(angle) for angle in euler_from_dcm(truth.C_nb[i])])
    return TrueSolution(
        stamp_ns,
        float(truth.lat[i]),
        float(truth.lon[i]),
        float(truth.h[i]),
        truth.v_n[i],
        rph,
        truth.C_nb[i],
        truth.rate_nb_b[i],
        truth.force_b[i],
        np.zeros(3) if bias_g is None else bias_g,
        np.zeros(3) if bias_a is None else bias_a,
    )
