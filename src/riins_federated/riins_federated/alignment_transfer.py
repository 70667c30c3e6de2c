"""Transfer alignment: attitude, velocity and place of another INS, then its velocity matched over a minute.

Lives here: `align_transfer`.
Does not live here: the filter (riins_core.alignment.stored), where the master's states come from (the node).
"""

from __future__ import annotations

import numpy as np

from riins_core.alignment.result import AlignmentError, TooSoon, check_latitude
from riins_core.alignment.stationary import ImuNoise
from riins_core.alignment.stored import Aids, Pass, Start, check_biases, run_stored
from riins_core.ins_error import BA, BG, PHI, POS, VEL

from .alignment_aids import moved
from .alignment_settings import MasterState
from .alignment_store import Window
from .types import Array

LEAST_MPS = 0.05
"""A master's velocity is not taken for better than this: its errors are slow, not white."""
SHORTEST_S = 10.0


def align_transfer(window: Window, states: list[MasterState], imu: ImuNoise, mounting: float, lever: Array) -> tuple[Pass, Array]:
    """Begin from the master's first state, and let its velocity correct what the mounting differs by.

    Parameters
    ----------
    window : samples after the first state
    states : of the master, in order of stamp
    imu : noise and biases of an axis
    mounting : 1-sigma misalignment of the axes to the master's, rad, each axis
    lever : (3,), master from the IMU, m, FRD

    Returns
    -------
    Pass at the last sample, place (3,) there: latitude, longitude [rad], height [m]

    Raises
    ------
    AlignmentError
        Too few states (`TooSoon`); beyond 85 deg; velocities that do not fit the IMU; biases it cannot have.

    Notes
    -----
    Level errors show as acceleration at once; the heading's only when the ship changes her velocity, and slowly by the Earth rate: without a
    manoeuvre it stays the master's and the mounting's. The covariance says which.
    """
    first, last = states[0], states[-1]
    check_latitude(first.lat)
    if window.length_s < SHORTEST_S or len(states) < 3:
        raise TooSoon(f"{window.length_s:.3g} s of data with {len(states)} states of the master are not enough")
    used = [state for state in states if state.stamp_ns > window.edges[0]]
    index = window.index(np.array([state.stamp_ns for state in used], np.int64))
    keep = np.concatenate([np.diff(index) > 0, [True]]) & (index > 0)
    sigma = np.maximum(np.mean([state.sigma_velocity for state in used], axis=0), LEAST_MPS)
    aids = Aids("velocity", index[keep], np.array([state.v_n for state in used])[keep], sigma, lever)
    P = np.zeros((15, 15))
    P[POS, POS], P[VEL, VEL] = np.diag(first.sigma_position**2), np.diag(sigma**2)
    P[PHI, PHI] = np.diag(first.sigma_attitude**2 + mounting**2)
    P[BG, BG], P[BA, BA] = imu.bias_g**2 * np.eye(3), imu.bias_a**2 * np.eye(3)
    v = first.v_n - first.C_nb @ np.cross(window.rate[0], lever)
    start = moved(np.array([first.lat, first.lon, first.h]), -first.C_nb @ lever)
    run = run_stored(window.rate, window.force, window.dt, Start(float(start[0]), float(start[1]), float(start[2]), v, first.C_nb, P), imu, aids)
    if run.refused > 0.1 * len(aids.index):
        raise AlignmentError(f"{run.refused} of {len(aids.index)} velocities of the master do not fit the IMU: wrong axes, or one is broken")
    check_biases(run, imu)
    behind = (window.end_ns - last.stamp_ns) * 1e-9
    ahead = moved(np.array([last.lat, last.lon, last.h]), last.v_n * behind - run.C_end @ lever)
    return run, ahead
