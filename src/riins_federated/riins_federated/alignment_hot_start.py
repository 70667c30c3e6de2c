"""Hot start: the heading saved at switching off, with the level found anew, and both judged by what the gyros say.

Lives here: `SavedHeading`, `hot_start`. A ship that was turned at her berth meanwhile is refused, not started with a wrong heading.
Does not live here: where the heading is kept between runs, alignment from nothing (riins_core.alignment).
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from riins_core.alignment.coarse import check_still, triad
from riins_core.alignment.result import Alignment, AlignmentError, bias_covariance, check_latitude
from riins_core.alignment.stationary import ImuNoise
from riins_core.alignment.swaying import align_swaying
from riins_core.kalman import update
from riins_core.rotation import euler_from_dcm, exp_so3

Array = NDArray[np.float64]

FALSE_ALARM = 1e-4
"""Probability with which a right saved heading is refused."""


@dataclasses.dataclass(frozen=True)
class SavedHeading:
    """What the last run left.

    Attributes
    ----------
    heading, sigma : rad, with its standard deviation then
    swing : standard deviation of how far she may have turned at her moorings since, rad
    """

    heading: float
    sigma: float
    swing: float = math.radians(0.5)


def hot_start(rate: Array, force: Array, dt: float, lat: float, imu: ImuNoise, saved: SavedHeading, swaying: bool = False) -> Alignment:
    """Attitude after a few seconds, from a saved heading.

    Parameters
    ----------
    rate, force : (m, 3), body rate [rad/s] and specific force [m/s^2], means over dt
    dt : s
    lat : rad
    imu : noise and biases of an axis
    saved : heading of the last run
    swaying : whether she lies in waves: then the alignment is that of `swaying.align_swaying`, with its length, and the saved heading sharpens it

    Returns
    -------
    Alignment; its heading is the weighted mean of what was saved and what the gyros say, its covariance that of both

    Raises
    ------
    AlignmentError
        As `check_still` or `align_swaying`; or saved and measured heading differ by more than chance allows: she was turned, or a gyro is broken.

    Notes
    -----
    A few seconds give a heading of degrees from the gyros' noise: enough to find a ship berthed the other way round, and no harm to a good saved
    heading.
    """
    check_latitude(lat)
    if not (math.isfinite(saved.heading) and saved.sigma > 0.0 and saved.swing >= 0.0):
        raise AlignmentError("the saved heading is not finite, or has no standard deviation")
    total = len(rate) * dt
    if swaying:
        found, _ = align_swaying(rate, force, dt, lat, imu)
        C, P = found.C_nb, found.P
    else:
        check_still(rate, force, dt, lat, imu.arw, imu.vrw, imu.bias_g, imu.bias_a)
        C = triad(force.mean(axis=0), rate.mean(axis=0), lat)
        P = bias_covariance(lat, C, (imu.bias_g**2 + imu.arw**2 / total) * np.eye(3), (imu.bias_a**2 + imu.vrw**2 / total) * np.eye(3))
    difference = math.remainder(saved.heading - float(euler_from_dcm(C)[2]), 2.0 * math.pi)
    variance = saved.sigma**2 + saved.swing**2
    limit = math.sqrt(chi2.isf(FALSE_ALARM, 1) * (P[2, 2] + variance))
    if abs(difference) > limit:
        raise AlignmentError(
            f"the saved heading is {math.degrees(abs(difference)):.2f} deg off the measured one, {math.degrees(limit):.2f} allowed: she was turned"
        )
    phi, P, _ = update(np.zeros(3), P, np.array([difference]), np.array([[0.0, 0.0, 1.0]]), np.array([[variance]]))
    return Alignment("hot start", exp_so3(phi) @ C, P, total)
