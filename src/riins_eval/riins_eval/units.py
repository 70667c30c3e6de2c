"""Whether a recording is in the units it should be in: specific force near 9.8 m/s^2, turns as the reference turns.

Lives here: `implausible`.
Does not live here: the refusal (npz_recording.py), any conversion: who made the file knows its units, we only doubt them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from riins_core.earth import STANDARD_GRAVITY, earth_rate_n, transport_rate_n
from riins_core.rotation import dcm_from_euler, log_so3

Floats = NDArray[np.float64]

FORCE_MPS2 = (7.0, 14.0)
"""Median length of the specific force of anything that does not fall or corner for half of the time."""
MOST_TURN_RAD_S = 9.0
"""Median rate beyond that of any vehicle: 500 deg/s."""
DEGREE = 180.0 / np.pi
LEAST_CORRELATION = 0.7
LONGEST_STEP_S = 2.0
LEAST_STEPS = 10


def implausible(t: Floats, rate: Floats, force: Floats, reference: Floats) -> str:
    """What is wrong with the units of an IMU.

    Parameters
    ----------
    t, rate, force : (m,), (m, 3), (m, 3), s, and what should be rad/s and m/s^2, body axes
    reference : (r, 10), t, lat, lon, h, vn, ve, vd, roll, pitch, yaw, or empty

    Returns
    -------
    a sentence without its subject; "": nothing, or nothing that could be seen
    """
    length = float(np.median(np.linalg.norm(force, axis=1)))
    if not FORCE_MPS2[0] <= length <= FORCE_MPS2[1]:
        for unit, size in (("g", 1.0), ("mg", 1000.0), ("cm/s^2", 100.0 * STANDARD_GRAVITY)):
            if 0.7 * size <= length <= 1.4 * size:
                return f"the specific force has a median of {length:.4g}: it looks like {unit}, m/s^2 is wanted"
        return f"the specific force has a median of {length:.4g} m/s^2, gravity is 9.8"
    scale = rate_scale(t, rate, reference)
    if scale is not None and 0.6 * DEGREE <= scale <= 1.6 * DEGREE:
        return f"the gyros turn {scale:.1f} times as fast as the reference: they look like deg/s, rad/s is wanted"
    turn = float(np.median(np.linalg.norm(rate, axis=1)))
    if turn > MOST_TURN_RAD_S:
        return f"the gyros have a median of {turn:.3g} rad/s: they look like deg/s"
    return ""


def rate_scale(t: Floats, rate: Floats, reference: Floats) -> float | None:
    """Turns of the gyros over those of the reference, Earth rate included; None: they do not show it.

    Between two epochs of the reference the body turns by log(C_1' C_2) + w_in dt; the gyros' sum over the same time, their mean bias taken off
    where the turns are seen without it, is compared by least squares.
    """
    rows = reference[np.isfinite(reference).all(axis=1)]
    if len(rows) < 2:
        return None
    total = np.concatenate([np.zeros((1, 3)), np.cumsum(rate[1:] * np.diff(t)[:, None], axis=0)])
    first, second = rows[:-1], rows[1:]
    span = second[:, 0] - first[:, 0]
    good = (span > 0.0) & (span <= LONGEST_STEP_S) & (first[:, 0] >= t[0]) & (second[:, 0] <= t[-1])
    first, second, span = first[good], second[good], span[good]
    if len(span) < LEAST_STEPS:
        return None
    c_a, c_b = (dcm_from_euler(*end[:, 7:10].T) for end in (first, second))
    w_in = earth_rate_n(first[:, 1]) + transport_rate_n(first[:, 1], first[:, 3], first[:, 4:7])
    back = np.swapaxes(c_a, 1, 2)
    x = log_so3(back @ c_b) + span[:, None] * np.einsum("kij,kj->ki", back, w_in)
    y = np.column_stack([np.interp(second[:, 0], t, c) - np.interp(first[:, 0], t, c) for c in total.T])
    # without the mean a bias does no harm; with it a still gyro of quality shows Earth rate, and a bias is along it by chance once in 200
    for mean, least in ((1.0, LEAST_CORRELATION), (0.0, 0.99)):
        u, v = x - mean * x.mean(axis=0), y - mean * y.mean(axis=0)
        uu, vv, uv = float(np.sum(u * u)), float(np.sum(v * v)), float(np.sum(u * v))
        if uv > least * np.sqrt(uu * vv) > 0.0:
            return uv / uu
    return None
