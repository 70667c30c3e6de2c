"""The voyage as it truly is: position, velocity, attitude at any time, and exactly the IMU increments that belong to them.

Lives here: `Trajectory`, `Truth`. Between knots 0.1 s apart the truth *is* a quintic polynomial in position, roll, pitch and heading, twice
continuously differentiable; velocity, body rate and specific force are its exact kinematics: nothing is lost between what is said and sensed.
Does not live here: the kernels (kinematics.py), the ship (course.py, vessel.py), errors of sensors (sensors.py).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from riins_core.earth import STANDARD_GRAVITY
from riins_core.sensor_errors import KNOT

from .course import segments
from .kinematics import COLUMNS, increment_kernel, integrate_course, truth_kernel
from .vessel import response_table
from .waves import WaveField

if TYPE_CHECKING:
    from .scenario import Scenario

Array = NDArray[np.float64]

_PANEL_S = 0.1
"""Wanted length of a panel: a wave of 2 rad/s is followed to 1e-9 of its amplitude."""


@dataclass(frozen=True)
class Truth:
    """Kinematics of base_link.

    Attributes
    ----------
    t : (m,), s since the start of the scenario
    lat, lon, h : (m,), rad, rad, m
    v_n : (m, 3), velocity over ground in NED, m/s
    C_nb : (m, 3, 3), body FRD to NED
    rate_nb_b : (m, 3), body rate with respect to NED in FRD, rad/s
    rate_ib_b : (m, 3), body rate with respect to inertial space in FRD, rad/s
    force_b : (m, 3), specific force in FRD, m/s^2
    """

    t: Array
    lat: Array
    lon: Array
    h: Array
    v_n: Array
    C_nb: Array
    rate_nb_b: Array
    rate_ib_b: Array
    force_b: Array


class Trajectory:
    """Motion of the ship of a scenario.

    Parameters
    ----------
    scenario : start, legs, sea and vessel are read

    Attributes
    ----------
    waves : WaveField
    dt : interval of the IMU, s
    duration : s; the truth is defined for 0..duration
    """

    def __init__(self, scenario: Scenario) -> None:
        start = scenario.start
        self.duration = scenario.duration_s
        self.dt = 1.0 / scenario.imu_rate_hz
        self._per_panel = max(1, round(_PANEL_S * scenario.imu_rate_hz))
        self._length = self._per_panel / scenario.imu_rate_hz
        self._h0 = start.height_m
        self._course = segments(scenario.legs, np.deg2rad(start.heading_deg), start.speed_kn * KNOT)
        panels = int(np.ceil(scenario.duration_s / self._length)) + 2
        position = np.array([np.deg2rad(start.latitude_deg), np.deg2rad(start.longitude_deg), start.height_m])
        self._path = integrate_course(position, panels, self._length, self._course)
        self.waves = WaveField.draw(scenario.sea, scenario.seed)
        self._waves = response_table(self.waves, scenario.vessel)
        self._heel = scenario.vessel.heel_rad_per_g / STANDARD_GRAVITY

    @property
    def samples(self) -> int:
        """Number of the last IMU sample within the duration."""
        return int(np.floor(self.duration / self.dt + 1e-6))

    def truth(self, t: ArrayLike) -> Truth:
        """Kinematics at any times.

        Parameters
        ----------
        t : (m,), s, within 0..duration (1 ms beyond is allowed for rounding)

        Returns
        -------
        Truth

        Raises
        ------
        ValueError
            A time is outside the voyage or not finite.
        """
        t = np.atleast_1d(np.asarray(t, dtype=np.float64))
        if t.size and not (t.min() >= -1e-3 and t.max() <= self.duration + 1e-3):
            raise ValueError(f"time {t.min()} .. {t.max()} s is outside the voyage of 0 .. {self.duration} s")
        out = np.empty((t.size, COLUMNS))
        truth_kernel(t, self._length, self._h0, self._path, self._course, self._waves, self._heel, out)
        return Truth(
            t,
            out[:, 0].copy(),
            out[:, 1].copy(),
            out[:, 2].copy(),
            out[:, 3:6].copy(),
            out[:, 6:15].reshape(-1, 3, 3).copy(),
            out[:, 15:18].copy(),
            out[:, 18:21].copy(),
            out[:, 21:24].copy(),
        )

    def increments(self, k0: int, m: int) -> tuple[Array, Array]:
        """Integrals of body rate and specific force over sample intervals, divided by dt.

        Parameters
        ----------
        k0 : first sample, >= 1; sample k covers (t_{k-1}, t_k], t_k = k dt
        m : number of samples; k0 + m - 1 <= samples

        Returns
        -------
        rate, force : (m, 3), FRD at base_link, of w_ib [rad/s] and f [m/s^2]; the same bits however the samples are split into blocks

        Raises
        ------
        ValueError
            A sample is outside the voyage.
        """
        if k0 < 1 or m < 0 or k0 + m - 1 > self.samples:
            raise ValueError(f"samples {k0} .. {k0 + m - 1} are outside the voyage of 1 .. {self.samples}")
        rate, force = np.empty((m, 3)), np.empty((m, 3))
        increment_kernel(k0, self._per_panel, self._length, self._h0, self._path, self._course, self._waves, self._heel, rate, force)
        return rate, force
