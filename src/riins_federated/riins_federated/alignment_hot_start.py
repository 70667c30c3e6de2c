"""Hot start: a heading saved at switching off, or known otherwise, with the level found anew, and both judged by what the gyros say.

Lives here: `SavedHeading`, `hot_start`, `align_known_heading`. A ship that was turned meanwhile is refused, not started with a wrong heading.
Does not live here: where the heading is kept between runs, alignment from nothing (riins_core.alignment).
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from riins_core.alignment.coarse import check_still, triad
from riins_core.alignment.inertial_frame import body_integrals
from riins_core.alignment.result import Alignment, AlignmentError, TooSoon, bias_covariance, check_latitude
from riins_core.alignment.stationary import ImuNoise
from riins_core.alignment.stored import Aids, Pass, Start, check_biases, prior, run_stored
from riins_core.alignment.swaying import align_swaying
from riins_core.kalman import update
from riins_core.rotation import dcm_from_euler, euler_from_dcm, exp_so3

Array = NDArray[np.float64]

FALSE_ALARM = 1e-4
"""Probability with which a right saved heading is refused."""
LEVEL = math.radians(1.5)
"""1-sigma error of a level that is the mean direction of the specific force, waves and changes of speed included."""


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
    difference, variance = check_heading(Alignment("measured", C, P, total), saved)
    phi, P, _ = update(np.zeros(3), P, np.array([difference]), np.array([[0.0, 0.0, 1.0]]), np.array([[variance]]))
    return Alignment("hot start", exp_so3(phi) @ C, P, total)


def check_heading(measured: Alignment, saved: SavedHeading) -> tuple[float, float]:
    """Saved less measured heading and the variance of the saved one, rad.

    Raises
    ------
    AlignmentError
        They differ by more than chance allows.
    """
    difference = math.remainder(saved.heading - measured.euler[2], 2.0 * math.pi)
    variance = saved.sigma**2 + saved.swing**2
    limit = math.sqrt(chi2.isf(FALSE_ALARM, 1) * (measured.P[2, 2] + variance))
    if abs(difference) > limit:
        raise AlignmentError(
            f"the saved heading is {math.degrees(abs(difference)):.2f} deg off the measured one, {math.degrees(limit):.2f} allowed: she was turned"
        )
    return difference, variance


def align_known_heading(
    rate: Array,
    force: Array,
    dt: float,
    place: tuple[float, ...],
    imu: ImuNoise,
    aids: Aids,
    known: SavedHeading,
    place_m: float,
) -> Pass:
    """Attitude of a ship that moves and whose heading at the beginning is known: of two antennas, a compass, or saved.

    Parameters
    ----------
    rate, force : (m, 3), body rate [rad/s] and specific force [m/s^2], means over dt
    dt : s
    place : latitude, longitude [rad], height [m] at the start
    imu : noise and biases of an axis
    aids : the place where she stays, or velocities
    known : heading at the beginning of the data
    place_m : 1-sigma error of the place, m

    Returns
    -------
    Pass over the data, the known heading in its prior

    Raises
    ------
    AlignmentError
        Too few data (`TooSoon`); not finite; beyond 85 deg; aids that do not fit the IMU; biases it cannot have; or a heading that the gyros move by
        more than chance allows.

    Notes
    -----
    The first pass levels, from the mean direction of the specific force in the first body; the second begins from that level and the known heading
    again, so that what is known counts once. It serves gyros too coarse for the Earth rate as well.
    """
    check_latitude(place[0])
    if not (math.isfinite(known.heading) and known.sigma > 0.0 and known.swing >= 0.0):
        raise AlignmentError("the known heading is not finite, or has no standard deviation")
    m = len(rate)
    if m * dt < 10.0 or len(aids.index) < 2:
        raise TooSoon(f"{m * dt:.3g} s of data with {len(aids.index)} measurements are not enough to level")
    if not (np.all(np.isfinite(rate)) and np.all(np.isfinite(force)) and np.all(np.isfinite(aids.value))):
        raise AlignmentError("the IMU data or velocities contain values that are not finite")
    _, pushed = body_integrals(rate, force, dt, min(m, round(60.0 / dt)))
    up = pushed[1] / np.linalg.norm(pushed[1])
    roll, pitch = math.atan2(-up[1], -up[2]), math.asin(max(-1.0, min(1.0, float(up[0]))))
    sigma = math.hypot(known.sigma, known.swing)
    first = dcm_from_euler(roll, pitch, known.heading)
    v = np.zeros(3) if aids.kind == "place" else aids.value[0] if aids.kind == "velocity" else first @ aids.value[0]
    run: Pass | None = None
    for level in (LEVEL, 0.3 * LEVEL):
        P = prior(place_m, 1.0 if aids.kind == "place" else 2.0 * float(np.max(aids.sigma)) + 0.1, level, sigma, imu)
        run = run_stored(rate, force, dt, Start(place[0], place[1], place[2], v, first, P), imu, aids)
        if run.refused > 0.1 * len(aids.index) + 1:
            raise AlignmentError(
                f"{run.refused} of {len(aids.index)} measurements do not fit the IMU and the heading: she was turned, or a sensor is broken"
            )
        back = run.C_end @ body_integrals(rate - run.bias_g, force, dt, m)[0][1].T  # n turns by arcminutes meanwhile: less than the level is known to
        roll, pitch = (float(a) for a in euler_from_dcm(back)[:2])
        moved = math.remainder(float(euler_from_dcm(back)[2]) - known.heading, 2.0 * math.pi)
        if aids.kind == "place":  # half as much again as she was seen to swing
            swing = float(np.max(aids.sigma))
            swing = min(swing, max(0.1, 1.5 * swing * math.sqrt(float(np.mean(run.nis)) / 3.0)))
            aids = dataclasses.replace(aids, sigma=np.full(3, swing))
        first = dcm_from_euler(roll, pitch, known.heading)
    assert run is not None
    check_biases(run, imu)
    limit = math.sqrt(chi2.isf(FALSE_ALARM, 1)) * math.sqrt(max(sigma**2 - run.P[8, 8], 0.0)) + math.radians(0.2)
    if abs(moved) > limit:
        raise AlignmentError(
            f"the gyros put the heading {math.degrees(abs(moved)):.2f} deg off the known one, {math.degrees(limit):.2f} allowed: she was turned"
        )
    return run
