"""What the sensors of the ship read: redundant IMU, satellite receivers, Doppler log.

Lives here: `RedundantImuSim`, `PositionSim`, `DopplerSim` and their blocks. Sample k is a pure function of scenario, seed and k; the fault-free
twin is the same call without faults. Does not live here: motion (trajectory.py), stochastic models (riins_core.sensor_errors), faults (faults.py),
odometer, altimeter and star sensor (further_sensors.py).
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from riins_core.earth import STANDARD_GRAVITY
from riins_core.imu_array import CONFIGURATIONS, ImuArray
from riins_core.noise import GaussMarkov, normal
from riins_core.sensor_errors import KNOT, PPM, SensorErrors

from .aid import AidSim, RowAidSim, displaced, sensor_velocity, turned
from .faults import FaultSchedule, Sample
from .trajectory import Trajectory, Truth

if TYPE_CHECKING:
    from .scenario import Scenario

Array = NDArray[np.float64]
Stamps = NDArray[np.int64]


@dataclass(frozen=True)
class RawBlock:
    """Samples of the redundant IMU.

    Attributes
    ----------
    k : (m,), sample numbers
    stamp_ns : (m,), since the start of the scenario; end of the averaging interval
    gyro, accel : (m, n), mean along each sensing axis, rad/s and m/s^2
    gyro_valid, accel_valid : (m,) uint64, bit i: sensor i says it is valid
    """

    k: Stamps
    stamp_ns: Stamps
    gyro: Array
    accel: Array
    gyro_valid: NDArray[np.uint64]
    accel_valid: NDArray[np.uint64]


@dataclass(frozen=True)
class PositionBlock:
    """Fixes of a satellite receiver, at its antenna.

    Attributes
    ----------
    k : (m,), numbers of the fixes
    stamp_ns : (m,), since the start of the scenario
    lat, lon, h : (m,), rad, rad, m; NaN without a fix
    covariance : (3, 3), NED, m^2, as the receiver states it
    has_fix : (m,), False in an outage or dropout
    v_n : (m, 3), NED, m/s; NaN without a fix
    velocity_covariance : (3, 3), NED, (m/s)^2
    """

    k: Stamps
    stamp_ns: Stamps
    lat: Array
    lon: Array
    h: Array
    covariance: Array
    has_fix: NDArray[np.bool_]
    v_n: Array
    velocity_covariance: Array


@dataclass(frozen=True)
class VelocityBlock:
    """Measurements of the Doppler log.

    Attributes
    ----------
    k : (m,), numbers of the measurements
    stamp_ns : (m,), since the start of the scenario
    v_b : (m, 3), velocity over ground of the log along its own axes, forward, starboard, down, m/s
    covariance : (3, 3), FRD, (m/s)^2
    valid : (m,), False: no bottom lock, no message
    """

    k: Stamps
    stamp_ns: Stamps
    v_b: Array
    covariance: Array
    valid: NDArray[np.bool_]


class RedundantImuSim:
    """The redundant IMU at base_link.

    Parameters
    ----------
    scenario : its imu section, rate and seed are read
    trajectory : the motion; None: made here
    array : geometry; None: the scenario's configuration

    Attributes
    ----------
    array : ImuArray
    gyro_errors, accel_errors : SensorErrors
    samples : int, number of the last sample
    """

    def __init__(self, scenario: Scenario, trajectory: Trajectory | None = None, array: ImuArray | None = None) -> None:
        self.trajectory = trajectory or Trajectory(scenario)
        self.array = array or ImuArray(CONFIGURATIONS[scenario.imu.configuration])
        self.samples = self.trajectory.samples
        self._rate_hz = scenario.imu_rate_hz
        self._outages = scenario.imu_outages()
        self._gyro_limit = float(np.deg2rad(scenario.imu.gyro_range_deg_s))
        self._accel_limit = scenario.imu.accel_range_g * STANDARD_GRAVITY
        dt, seed = self.trajectory.dt, scenario.seed
        self.gyro_errors = SensorErrors(scenario.imu.gyro.si(), self.array.H, dt, seed, "gyro")
        self.accel_errors = SensorErrors(scenario.imu.accel.si(), self.array.H, dt, seed, "accel")

    def stamp_ns(self, k: Stamps | int) -> Stamps:
        """Stamp of sample k since the start, ns: k / rate, rounded."""
        return (np.asarray(k, dtype=np.int64) * 1_000_000_000 + self._rate_hz // 2) // self._rate_hz

    def true_bias(self, k: int = 0) -> tuple[Array, Array]:
        """Bias (constant, Gauss-Markov, random walk) of each gyro [rad/s] and accelerometer [m/s^2] at sample k, each (n,); measured - true."""
        return self.gyro_errors.bias(k, 1)[0], self.accel_errors.bias(k, 1)[0]

    def fused_bias(self, k: int = 0) -> tuple[Array, Array]:
        """`true_bias` as the fused triad has it with all sensors in use and equal weights: gyro, accelerometer, each (3,), FRD."""
        w = self.array.least_squares()
        gyro, accel = self.true_bias(k)
        return w @ gyro, w @ accel

    def block(self, k0: int, m: int, faults: FaultSchedule | None = None) -> RawBlock:
        """Samples k0 .. k0 + m - 1.

        Parameters
        ----------
        k0, m : k0 >= 1; k0 + m - 1 <= samples
        faults : None: the fault-free twin

        Returns
        -------
        RawBlock; the same bits however the samples are split into blocks; without the samples of an outage

        Raises
        ------
        ValueError
            A sample is outside the voyage.
        """
        k = np.arange(k0, k0 + m, dtype=np.int64)
        stamp = self.stamp_ns(k)
        gyro, accel = self._clean(k0, m)
        every = np.uint64((1 << self.array.n) - 1)
        gyro_valid, accel_valid = np.full(m, every), np.full(m, every)
        if faults is not None and faults.faults:
            gyro_valid = faults.apply_axes("gyro", stamp, k0, gyro, lambda t: self._before(t, 0))
            accel_valid = faults.apply_axes("accel", stamp, k0, accel, lambda t: self._before(t, 1))
        np.clip(gyro, -self._gyro_limit, self._gyro_limit, out=gyro)
        np.clip(accel, -self._accel_limit, self._accel_limit, out=accel)
        block = RawBlock(k, stamp, gyro, accel, gyro_valid, accel_valid)
        for start_ns, end_ns in self._outages:
            there = (block.stamp_ns < start_ns) | (block.stamp_ns >= end_ns)
            if not there.all():
                block = RawBlock(*(getattr(block, field.name)[there] for field in fields(RawBlock)))
        return block

    def _clean(self, k0: int, m: int) -> tuple[Array, Array]:
        rate, force = self.trajectory.increments(k0, m)
        return self.gyro_errors.measure(k0, rate), self.accel_errors.measure(k0, force)

    def _before(self, stamp_ns: int, which: int) -> Sample:
        k = -(-stamp_ns * self._rate_hz // 1_000_000_000)
        while k > 1 and int(self.stamp_ns(k)) >= stamp_ns:
            k -= 1
        k = min(max(k, 1), self.samples)
        return Sample(int(self.stamp_ns(k)), k, self._clean(k, 1)[which][0])


class PositionSim(AidSim):
    """A satellite receiver: position and velocity of its antenna with white and slowly varying errors.

    Parameters
    ----------
    scenario : its section of that name and the seed are read
    name : gps or bds
    trajectory : the motion; None: made here

    Attributes
    ----------
    samples : int, number of the last fix
    period_ns : interval, ns
    """

    def __init__(self, scenario: Scenario, name: str, trajectory: Trajectory | None = None) -> None:
        settings = {"gps": scenario.gps, "bds": scenario.bds}[name]
        super().__init__(scenario, name, settings.period_s, settings.lever_arm_m, trajectory)
        self._sigma = np.array(settings.sigma_m)
        self._velocity_sigma = settings.velocity_sigma_mps
        slow = settings.markov_sigma_m
        self._markov = GaussMarkov(slow, settings.markov_time_s, settings.period_s, scenario.seed, f"{name}/markov", 2) if slow else None
        self.covariance = np.diag(self._sigma**2 + np.array([slow, slow, 0.0]) ** 2)
        self.velocity_covariance = self._velocity_sigma**2 * np.eye(3)

    def block(self, k0: int, m: int, faults: FaultSchedule | None = None) -> PositionBlock:
        """Fixes k0 .. k0 + m - 1.

        Parameters
        ----------
        k0, m : k0 >= 1; k0 + m - 1 <= samples
        faults : None: the fault-free twin (outages remain); they act on the position, not on the velocity

        Returns
        -------
        PositionBlock
        """
        k, stamp, truth = self._span(k0, m)
        place, per_metre = self._clean(k0, truth)
        has_fix = self._dropouts(stamp, k0)
        if faults is not None and faults.faults:
            has_fix &= faults.apply_aid(self.name, stamp, k0, place, self._before, per_metre)
        v_n = self._velocity_sigma * normal(self._seed, f"{self.name}/velocity", k0, m, 3)
        v_b = np.empty((m, 3))
        sensor_velocity(truth.C_nb, truth.v_n, truth.rate_nb_b, self._lever, v_b)
        turned(truth.C_nb, v_b, v_n)
        place[~has_fix] = np.nan
        v_n[~has_fix] = np.nan
        return PositionBlock(k, stamp, place[:, 0], place[:, 1], place[:, 2], self.covariance, has_fix, v_n, self.velocity_covariance)

    def _clean(self, k0: int, truth: Truth) -> tuple[Array, Array]:
        m = truth.t.size
        offset = self._sigma * normal(self._seed, f"{self.name}/white", k0, m, 3)
        if self._markov is not None:
            offset[:, :2] += self._markov.block(k0, m)
        turned(truth.C_nb, np.tile(self._lever, (m, 1)), offset)
        place, per_metre = np.empty((m, 3)), np.empty((m, 3))
        displaced(truth.lat, truth.lon, truth.h, offset, place, per_metre)
        return place, per_metre

    def _before(self, stamp_ns: int) -> Sample:
        k = self._last_before(stamp_ns)
        _, stamp, truth = self._span(k, 1)
        place, per_metre = self._clean(k, truth)
        return Sample(int(stamp[0]), k, place[0], per_metre[0])


class DopplerSim(RowAidSim):
    """The Doppler log: velocity over ground at the log, along axes that are not quite the ship's.

    Parameters
    ----------
    scenario : its doppler section and the seed are read
    trajectory : the motion; None: made here

    Attributes
    ----------
    true_misalignment : angle by which the log is turned to starboard, rad
    true_scale : scale factor error
    """

    def __init__(self, scenario: Scenario, trajectory: Trajectory | None = None) -> None:
        settings = scenario.doppler
        super().__init__(scenario, "doppler", settings.period_s, settings.lever_arm_m, trajectory)
        self._sigma = np.array(settings.sigma_kn) * KNOT
        draw = normal(scenario.seed, "doppler/constant", 0, 1, 2)[0]
        self.true_misalignment = float(np.deg2rad(settings.misalignment_deg) * draw[0])
        self.true_scale = float(settings.scale_ppm * PPM * draw[1])
        c, s = np.cos(self.true_misalignment), np.sin(self.true_misalignment)
        self._turn = (1.0 + self.true_scale) * np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
        self.covariance = np.diag(self._sigma**2)

    def block(self, k0: int, m: int, faults: FaultSchedule | None = None) -> VelocityBlock:
        """Measurements k0 .. k0 + m - 1; arguments as for `PositionSim.block`."""
        k, stamp, _, v_b, valid = self._read(k0, m, faults)
        return VelocityBlock(k, stamp, v_b, self.covariance, valid)

    def _clean(self, k0: int, truth: Truth) -> Array:
        reading = self._sigma * normal(self._seed, "doppler/white", k0, truth.t.size, 3)
        v_b = np.empty((truth.t.size, 3))
        sensor_velocity(truth.C_nb, truth.v_n, truth.rate_nb_b, self._lever, v_b)
        turned(self._turn[None], v_b, reading)
        return reading
