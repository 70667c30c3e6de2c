"""Alignment under way from unknown heading, with velocity of GNSS (NED) or of a Doppler log (body): vectors, then the filter over the stored data.

Lives here: `InMotionSettings`, `align_in_motion`, the coarse attitude from velocity-aided vectors.
Does not live here: vectors and filter themselves (riins_core.alignment), a ship at her moorings (riins_core.alignment.swaying), a saved heading.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray

from riins_core.alignment.inertial_frame import Fit, body_integrals, fit, navigation_turn
from riins_core.alignment.result import Alignment, AlignmentError, TooSoon, check_latitude
from riins_core.alignment.stationary import ImuNoise
from riins_core.alignment.stored import Aids, Pass, Start, check_biases, prior, run_stored, start_of_end
from riins_core.earth import OMEGA_IE, earth_rate_n, gravity, transport_rate_n
from riins_core.settings import setting

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class InMotionSettings:
    """Alignment under way."""

    shortest_s: float = setting(60.0, "least length of data", "s", low=10.0, high=3600.0)
    coarse_s: float = setting(600.0, "longest stretch of data of the coarse attitude", "s", low=10.0, high=3600.0)
    place_m: float = setting(100.0, "1-sigma error of the given place", "m", low=0.1, high=1e5)
    heading_limit_deg: float = setting(2.0, "1-sigma heading error beyond which there is no result", "deg", low=0.01, high=60.0)
    passes: int = setting(2, "passes over the stored data", "", low=1, high=5)


def coarse(rate: Array, force: Array, dt: float, lat: float, h: float, aids: Aids) -> tuple[Fit, Array]:
    """Attitude before the first sample of a body whose velocity is measured; parameters as in `align_in_motion`.

    Returns
    -------
    Fit, velocity NED (k, 3) at the measurements as this attitude has it

    Notes
    -----
    In n0: d v / dt + w_ie x v = C_n0b0 C_b0b f + C_n0n g, integrated once; the velocity at the first measurement is unknown but for its own error,
    so a constant is left open. A log has v in b: w_ie x v needs the attitude, which the first of two fits gives.
    """
    times = np.asarray(aids.index * dt, dtype=np.float64)
    C, u = body_integrals(rate[: aids.index[-1]], force[: aids.index[-1]], dt, 1)
    C, u = C[aids.index], u[aids.index]
    steps = np.diff(times)
    log = aids.kind == "log"
    rates = rate[np.maximum(aids.index - 1, 0)]
    v_b = aids.value - np.cross(rates, aids.lever) if log else np.zeros((len(times), 3))
    v_n = np.zeros((len(times), 3)) if log else aids.value
    result, w_ie = None, earth_rate_n(lat)
    for _ in range(2 if log else 1):
        n_rate = w_ie + transport_rate_n(lat, h, v_n)
        turn = _turns(n_rate, times)
        down = float(gravity(lat, h)) * turn[:, :, 2]
        coriolis = np.einsum("kij,kj->ki", turn, np.cross(w_ie, v_n))
        moved = np.einsum("kij,kj->ki", turn, v_n)
        reference = _integral(coriolis - down, steps)
        body = u
        if log:
            body = u - np.einsum("kij,kj->ki", C, v_b)
        else:
            reference = reference + moved
        result = fit(body, reference, 0)
        if log:
            v_n = np.einsum("kji,jl,klm,km->ki", turn, result.C, C, v_b)
    assert result is not None
    return result, v_n


def _turns(rate_n: Array, times: Array) -> Array:
    """C_n0n (k, 3, 3) at the measurements, n0 that before the first sample."""
    steps = np.diff(times, prepend=0.0)
    middle = np.vstack([rate_n[:1], 0.5 * (rate_n[1:] + rate_n[:-1])])
    return navigation_turn(middle * steps[:, None], 1.0)[1:]


def _integral(values: Array, steps: Array) -> Array:
    out = np.zeros_like(values)
    np.cumsum(0.5 * steps[:, None] * (values[1:] + values[:-1]), axis=0, out=out[1:])
    return out


def align_in_motion(
    rate: Array,
    force: Array,
    dt: float,
    place: tuple[float, float, float],
    imu: ImuNoise,
    aids: Aids,
    settings: InMotionSettings | None = None,
) -> tuple[Alignment, Pass]:
    """Alignment under way; nothing is known of the attitude.

    Parameters
    ----------
    rate, force : (m, 3), body rate [rad/s] and specific force [m/s^2], means over dt
    dt : s
    place : latitude, longitude [rad], height [m] at the start
    imu : noise and biases of an axis
    aids : velocity NED of GNSS (kind "velocity") or in the body of a log (kind "log"); only healthy ones
    settings : None: up to 600 s of vectors, two passes

    Returns
    -------
    Alignment at the last sample, the last Pass

    Raises
    ------
    AlignmentError
        Too few data; not finite; beyond 85 deg; velocities that do not fit the IMU (wrong latitude, wrong axes, a broken sensor); or data that do
        not give the heading: gyros too coarse for the Earth rate and no change of velocity, or not long enough.

    Notes
    -----
    Heading comes from the Earth rate, and with NED velocity from every change of velocity besides. A good IMU needs no motion for it, a poor one gets
    nowhere without: what decides is the filter's own sigma.
    """
    settings = settings or InMotionSettings()
    lat, lon, h = place
    check_latitude(lat)
    if aids.kind not in ("velocity", "log"):
        raise ValueError(f'alignment under way needs "velocity" or "log", not {aids.kind!r}')
    rate, force = np.ascontiguousarray(rate, dtype=np.float64), np.ascontiguousarray(force, dtype=np.float64)
    total = len(rate) * dt
    if total < settings.shortest_s or len(aids.index) < 10 or (aids.index[-1] - aids.index[0]) * dt < 0.5 * settings.shortest_s:
        raise TooSoon(f"{total:.3g} s of data with {len(aids.index)} velocities are not enough: {settings.shortest_s:.0f} s are needed")
    if not (np.all(np.isfinite(rate)) and np.all(np.isfinite(force)) and np.all(np.isfinite(aids.value))):
        raise AlignmentError("the IMU data or velocities contain values that are not finite")
    first = aids.index * dt <= settings.coarse_s
    times = np.asarray(aids.index * dt, dtype=np.float64)
    begun, v_n = coarse(rate, force, dt, lat, h, dataclasses.replace(aids, index=aids.index[first], value=aids.value[first]))
    time = float(times[first][-1])
    drift = imu.bias_a * time + 0.5 * imu.bias_g * float(gravity(lat, h)) * time**2
    if begun.rms > 5.0 * float(np.max(aids.sigma)) + drift:
        raise AlignmentError(f"velocity and IMU do not fit: {begun.rms:.2g} m/s are left: wrong latitude or axes, or a broken sensor")
    heading = max(math.radians(5.0), 3.0 * math.sqrt(begun.P[2, 2]), min(imu.bias_g / (OMEGA_IE * math.cos(lat)), 0.5))
    P = prior(settings.place_m, 2.0 * float(np.max(aids.sigma)) + 0.1, math.radians(1.0), heading, imu)
    turn_n = _turns(earth_rate_n(lat) + transport_rate_n(lat, h, np.vstack([v_n, v_n[-1:]])), np.append(times[first], total))[-1]
    C, v, found = begun.C, v_n[0], None
    for i in range(settings.passes):
        found = run_stored(rate, force, dt, Start(lat, lon, h, v, C, P), imu, aids)
        if found.refused > 0.1 * len(aids.index):
            raise AlignmentError(f"{found.refused} of {len(aids.index)} velocities do not fit the IMU: wrong latitude or axes, or a broken sensor")
        if i + 1 < settings.passes:
            turn_b = body_integrals(rate - found.bias_g, force, dt, len(rate))[0][1]
            C = start_of_end(found.C_end, turn_n, turn_b)
    assert found is not None
    check_biases(found, imu)
    sigma = math.sqrt(found.P[8, 8])
    if not sigma <= math.radians(settings.heading_limit_deg):
        raise TooSoon(
            f"the data do not give the heading: 1-sigma {math.degrees(sigma):.2g} deg after {total:.0f} s; better gyros, changes of velocity or time"
        )
    return Alignment(f"in motion, {aids.kind}", found.C_end, found.P[6:9, 6:9], total, found.bias_g, found.bias_a), found
