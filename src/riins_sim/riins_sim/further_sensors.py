"""What the further sensors of a car or an aircraft read: odometer, altimeter, star sensor.

Lives here: `OdometerSim`, `AltimeterSim`, `StarTrackerSim` and their blocks; like all sensors functions of scenario, seed and sample number.
Does not live here: IMU, satellite receivers and Doppler log (sensors.py), what aids have in common (aid.py), faults (faults.py).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from riins_core.jit import jit
from riins_core.noise import GaussMarkov, normal
from riins_core.rotation import exp_so3_into
from riins_core.sensor_errors import ARCSEC, PPM

from .aid import RowAidSim, sensor_velocity, turned
from .faults import FaultSchedule
from .sensors import VelocityBlock
from .trajectory import Trajectory, Truth

if TYPE_CHECKING:
    from .scenario import Scenario

Array = NDArray[np.float64]
Stamps = NDArray[np.int64]


@dataclass(frozen=True)
class HeightBlock:
    """Measurements of the altimeter.

    Attributes
    ----------
    k : (m,), numbers of the measurements
    stamp_ns : (m,), since the start of the scenario
    h : (m,), height of the sensor above the ellipsoid, m
    variance : of the white error, m^2
    valid : (m,), False: no message
    """

    k: Stamps
    stamp_ns: Stamps
    h: Array
    variance: float
    valid: NDArray[np.bool_]


@dataclass(frozen=True)
class AttitudeBlock:
    """Measurements of the star sensor.

    Attributes
    ----------
    k : (m,), numbers of the measurements
    stamp_ns : (m,), since the start of the scenario
    rph : (m, 3), roll, pitch, heading of the sensor's axes, which are nearly the body's, rad
    covariance : (3, 3), of the white error about the axes forward, starboard, down, rad^2
    valid : (m,), False: no stars, no message
    """

    k: Stamps
    stamp_ns: Stamps
    rph: Array
    covariance: Array
    valid: NDArray[np.bool_]


class OdometerSim(RowAidSim):
    """An odometer: speed ahead with a scale factor error; sideways and down it says 0, with the sigma at which a wheel is believed to hold.

    Parameters
    ----------
    scenario : its odometer section and the seed are read
    trajectory : the motion; None: made here

    Attributes
    ----------
    true_scale : scale factor error
    covariance : (3, 3), FRD, (m/s)^2
    """

    def __init__(self, scenario: Scenario, trajectory: Trajectory | None = None) -> None:
        settings = scenario.odometer
        super().__init__(scenario, "odometer", settings.period_s, settings.lever_arm_m, trajectory)
        self._sigma = settings.sigma_mps
        self.true_scale = float(settings.scale_ppm * PPM * normal(scenario.seed, "odometer/constant", 0, 1, 1)[0, 0])
        self.covariance = np.diag([self._sigma, settings.sideways_sigma_mps, settings.down_sigma_mps]) ** 2

    def block(self, k0: int, m: int, faults: FaultSchedule | None = None) -> VelocityBlock:
        """Measurements k0 .. k0 + m - 1.

        Parameters
        ----------
        k0, m : k0 >= 1; k0 + m - 1 <= samples
        faults : None: the fault-free twin (outages remain)

        Returns
        -------
        VelocityBlock; the same bits however the measurements are split into blocks
        """
        k, stamp, _, v_b, valid = self._read(k0, m, faults)
        return VelocityBlock(k, stamp, v_b, self.covariance, valid)

    def _clean(self, k0: int, truth: Truth) -> Array:
        m = truth.t.size
        v_b, reading = np.empty((m, 3)), np.zeros((m, 3))
        sensor_velocity(truth.C_nb, truth.v_n, truth.rate_nb_b, self._lever, v_b)
        reading[:, 0] = (1.0 + self.true_scale) * v_b[:, 0] + self._sigma * normal(self._seed, "odometer/white", k0, m, 1)[:, 0]
        return reading


class AltimeterSim(RowAidSim):
    """A barometric altimeter: height with a constant, a slowly varying (weather) and a white error.

    Parameters
    ----------
    scenario : its altimeter section and the seed are read
    trajectory : the motion; None: made here

    Attributes
    ----------
    true_bias : the constant error, m
    """

    def __init__(self, scenario: Scenario, trajectory: Trajectory | None = None) -> None:
        settings = scenario.altimeter
        super().__init__(scenario, "altimeter", settings.period_s, settings.lever_arm_m, trajectory)
        self._sigma, slow = settings.sigma_m, settings.markov_sigma_m
        self._markov = GaussMarkov(slow, settings.markov_time_s, settings.period_s, scenario.seed, "altimeter/markov", 1) if slow else None
        self.true_bias = float(settings.bias_m * normal(scenario.seed, "altimeter/constant", 0, 1, 1)[0, 0])
        self.variance = self._sigma**2

    def block(self, k0: int, m: int, faults: FaultSchedule | None = None) -> HeightBlock:
        """Measurements k0 .. k0 + m - 1; arguments as for `OdometerSim.block`."""
        k, stamp, _, h, valid = self._read(k0, m, faults)
        return HeightBlock(k, stamp, h[:, 0], self.variance, valid)

    def _clean(self, k0: int, truth: Truth) -> Array:
        m = truth.t.size
        lever_n = np.zeros((m, 3))
        turned(truth.C_nb, np.tile(self._lever, (m, 1)), lever_n)
        h = (truth.h - lever_n[:, 2] + self.true_bias)[:, None] + self._sigma * normal(self._seed, "altimeter/white", k0, m, 1)
        if self._markov is not None:
            h += self._markov.block(k0, m)
        return np.asarray(h)


class StarTrackerSim(RowAidSim):
    """A star sensor: attitude against the local level, with a mounting error and white noise, where there are stars and the turn is slow enough.

    Parameters
    ----------
    scenario : its star_tracker section and the seed are read
    trajectory : the motion; None: made here

    Attributes
    ----------
    true_misalignment : (3,), rotation from the body's axes to the sensor's, FRD, rad

    Notes
    -----
    It sees the stars, so its attitude is against inertial space; that it is told here against the level takes position and time, whose errors are
    left out: 30 m are an arcsecond.
    """

    def __init__(self, scenario: Scenario, trajectory: Trajectory | None = None) -> None:
        settings = scenario.star_tracker
        super().__init__(scenario, "star_tracker", settings.period_s, (0.0, 0.0, 0.0), trajectory)
        self._sigma = np.array(settings.sigma_arcsec) * ARCSEC
        self._fastest = math.radians(settings.max_rate_deg_s)
        self.true_misalignment = settings.misalignment_arcsec * ARCSEC * normal(scenario.seed, "star_tracker/constant", 0, 1, 3)[0]
        self.covariance = np.diag(self._sigma**2)

    def block(self, k0: int, m: int, faults: FaultSchedule | None = None) -> AttitudeBlock:
        """Measurements k0 .. k0 + m - 1; arguments as for `OdometerSim.block`."""
        k, stamp, truth, rph, valid = self._read(k0, m, faults)
        slow = np.square(truth.rate_nb_b).sum(axis=1) <= self._fastest**2
        return AttitudeBlock(k, stamp, rph, self.covariance, valid & slow)

    def _clean(self, k0: int, truth: Truth) -> Array:
        m = truth.t.size
        turn = self.true_misalignment + self._sigma * normal(self._seed, "star_tracker/white", k0, m, 3)
        rph = np.empty((m, 3))
        _turned_attitude(truth.C_nb, turn, rph)
        return rph


@jit
def _turned_attitude(c_nb: Array, turn: Array, rph: Array) -> None:
    """Roll, pitch and heading (0 .. 2 pi) of C_nb exp([turn x]) row by row; turn (m, 3) in the body."""
    small, c = np.empty((3, 3)), np.empty((3, 3))
    for i in range(turn.shape[0]):
        exp_so3_into(turn[i, 0], turn[i, 1], turn[i, 2], small)
        for a in range(3):
            for b in range(3):
                c[a, b] = c_nb[i, a, 0] * small[0, b] + c_nb[i, a, 1] * small[1, b] + c_nb[i, a, 2] * small[2, b]
        rph[i, 0] = math.atan2(c[2, 1], c[2, 2])
        rph[i, 1] = math.atan2(-c[2, 0], math.sqrt(c[2, 1] * c[2, 1] + c[2, 2] * c[2, 2]))
        rph[i, 2] = math.atan2(c[1, 0], c[0, 0]) % (2.0 * math.pi)
