"""Alignment of a moored or anchored ship in waves: vectors in the inertial frame, then the filter goes over the stored data from the beginning.

Lives here: `SwayingSettings`, `align_swaying`. What it uses of the ship is only that she stays where she is, within the swing of her moorings.
Does not live here: the vectors (inertial_frame.py), the filter (stored.py), a ship under way (riins_federated.alignment_in_motion).
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray

from ..earth import earth_rate_n, gravity
from ..settings import setting
from .inertial_frame import Fit, accumulate, body_integrals, fit, navigation_turn
from .result import Alignment, AlignmentError, TooSoon, check_latitude
from .stationary import ImuNoise
from .stored import Aids, Pass, Start, check_biases, prior, run_stored, start_of_end

Array = NDArray[np.float64]

_LEAST_SWING = 0.1
"""m"""


@dataclasses.dataclass(frozen=True)
class SwayingSettings:
    """Alignment of a ship that sways about one place."""

    coarse_s: float = setting(300.0, "data of the vectors in the inertial frame", "s", low=60.0, high=3600.0)
    swing_m: float = setting(
        1.5, "largest 1-sigma swing about the mean place, waves and moorings together; less where less is seen", "m", low=0.01, high=100.0
    )
    correlation_s: float = setting(5.0, "time after which the swing is taken as new: interval of the measurements of place", "s", 0.1, 300.0)
    velocity_mps: float = setting(1.0, "1-sigma velocity in waves", "m/s", low=0.01, high=20.0)
    passes: int = setting(2, "passes over the stored data", "", low=1, high=5)


def coarse(rate: Array, force: Array, dt: float, lat: float, step: float = 0.5) -> Fit:
    """Attitude before the first sample from the data of a body that stays about one place; parameters as in `align_swaying`, `step` between
    vectors, s.

    Notes
    -----
    In n0, d v / dt + w_ie x v = C_n0b0 C_b0b f + C_n0n g. Integrated twice, what nobody knows of v is a bounded displacement, the first place and
    the first velocity; the last two are a polynomial. Displacements of 1 m are 3 arcmin of heading after 300 s, velocities of 0.5 m/s half a degree.
    """
    every = max(1, round(step / dt))
    _, u = body_integrals(rate, force, dt, every)
    step = every * dt
    turn = navigation_turn(np.tile(earth_rate_n(lat), (len(u) - 1, 1)), step)
    upward = -float(gravity(lat, 0.0)) * turn[:, :, 2]
    return fit(accumulate(u, step), accumulate(accumulate(upward, step), step), 1)


def align_swaying(
    rate: Array, force: Array, dt: float, lat: float, imu: ImuNoise, settings: SwayingSettings | None = None, lon: float = 0.0, h: float = 0.0
) -> tuple[Alignment, Pass]:
    """Alignment in waves at one place.

    Parameters
    ----------
    rate, force : (m, 3), body rate [rad/s] and specific force [m/s^2], means over dt
    dt : s
    lat, lon, h : rad, rad, m
    imu : noise and biases of an axis
    settings : None: 300 s of vectors, then two passes

    Returns
    -------
    Alignment at the end of the data, the last Pass

    Raises
    ------
    AlignmentError
        Too few data; not finite; beyond 85 deg; the ship does not stay about one place, or the latitude is wrong: neither can be told from the other.

    Notes
    -----
    A steady speed cannot be felt: that of a gyrocompass, v_N / (R W cos L), stays in the heading (0.17 deg for 1 m/s at 45 deg). A ship that is not
    moored aligns with `riins_federated.alignment_in_motion`.
    """
    settings = settings or SwayingSettings()
    check_latitude(lat)
    rate, force = np.ascontiguousarray(rate, dtype=np.float64), np.ascontiguousarray(force, dtype=np.float64)
    m, per = len(rate), max(1, round(settings.correlation_s / dt))
    n = round(settings.coarse_s / dt)
    if m < n:
        raise TooSoon(f"{m * dt:.3g} s of data are not enough: alignment in waves needs {settings.coarse_s:.0f} s")
    if not (np.all(np.isfinite(rate)) and np.all(np.isfinite(force))):
        raise AlignmentError("the IMU data contain values that are not finite")
    first = coarse(rate[:n], force[:n], dt, lat)
    time = n * dt
    # what biases may bend in the path of the vectors beyond what an attitude explains: a tenth of what they grow to
    slack = 0.1 * (imu.bias_a * time**2 / 2.0 + imu.bias_g * float(gravity(lat, 0.0)) * time**3 / 6.0)
    if first.rms > 4.0 * settings.swing_m + slack:
        raise AlignmentError(
            f"the vectors do not fit: {first.rms:.0f} m are left where {settings.swing_m:g} m of swing are allowed: under way, or a wrong latitude"
        )
    index = np.arange(per, m + 1, per, dtype=np.int64)
    swing = settings.swing_m
    P = prior(settings.swing_m, settings.velocity_mps, math.radians(1.0), math.radians(5.0), imu)
    C, found = first.C, None
    turn_n = navigation_turn(np.tile(earth_rate_n(lat) * m * dt, (1, 1)), 1.0)[1]
    for i in range(settings.passes):
        place = Aids("place", index, np.zeros((len(index), 3)), np.full(3, swing))
        found = run_stored(rate, force, dt, Start(lat, lon, h, np.zeros(3), C, P), imu, place)
        if found.refused > 0.02 * len(index) + 1:
            raise AlignmentError(
                f"{found.refused} of {len(index)} times the ship was not where she should be: she is under way, or a sensor is broken"
            )
        if i + 1 < settings.passes:
            turn_b = body_integrals(rate - found.bias_g, force, dt, m)[0][1]
            C = start_of_end(found.C_end, turn_n, turn_b)
            # half as much again as she was seen to swing: what is left after the first pass hardly knows the attitude any more
            swing = min(swing, max(_LEAST_SWING, 1.5 * swing * math.sqrt(float(np.mean(found.nis)) / 3.0)))
    assert found is not None
    check_biases(found, imu)
    return Alignment("swaying", found.C_end, found.P[6:9, 6:9], m * dt, found.bias_g, found.bias_a), found
