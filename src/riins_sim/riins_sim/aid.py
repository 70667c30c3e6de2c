"""What simulated aids have in common: numbering and stamps, outages, and where and how fast a sensor beside base_link is.

Lives here: `AidSim`, the base of the aids, `RowAidSim`, that of those whose measurement is a row of numbers, and kernels.
Does not live here: the sensors (sensors.py, further_sensors.py), faults (faults.py).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from riins_core.earth import radii_s
from riins_core.jit import jit

from .faults import FaultSchedule, Sample
from .trajectory import Trajectory, Truth

if TYPE_CHECKING:
    from .scenario import Scenario

Array = NDArray[np.float64]
Stamps = NDArray[np.int64]


class AidSim:
    """What aids have in common: sample j has the stamp j x period, j >= 1."""

    def __init__(self, scenario: Scenario, name: str, period_s: float, lever_arm: tuple[float, ...], trajectory: Trajectory | None) -> None:
        self.name = name
        self.trajectory = trajectory or Trajectory(scenario)
        self.period_ns = round(period_s * 1e9)
        self.samples = round(scenario.duration_s * 1e9) // self.period_ns
        self._lever = np.array(lever_arm)
        self._seed = scenario.seed
        self._outages = scenario.outage_schedule().only([name])

    def _span(self, k0: int, m: int) -> tuple[Stamps, Stamps, Truth]:
        if k0 < 1 or m < 0 or k0 + m - 1 > self.samples:
            raise ValueError(f"samples {k0} .. {k0 + m - 1} of {self.name} are outside the voyage of 1 .. {self.samples}")
        k = np.arange(k0, k0 + m, dtype=np.int64)
        stamp = k * self.period_ns
        return k, stamp, self.trajectory.truth(stamp * 1e-9)

    def _last_before(self, stamp_ns: int) -> int:
        return min(max((stamp_ns - 1) // self.period_ns, 1), self.samples)

    def _dropouts(self, stamp: Stamps, k0: int) -> NDArray[np.bool_]:
        values = np.zeros((stamp.size, 3))
        return self._outages.apply_aid(self.name, stamp, k0, values, _never)


class RowAidSim(AidSim, ABC):
    """An aid of which each measurement is one row of numbers."""

    @abstractmethod
    def _clean(self, k0: int, truth: Truth) -> Array:
        """Readings without faults, from number k0 on, one for each row of the truth: (m, d)."""

    def _read(self, k0: int, m: int, faults: FaultSchedule | None) -> tuple[Stamps, Stamps, Truth, Array, NDArray[np.bool_]]:
        """Numbers, stamps, truth, readings (m, d) and whether there is a message, of measurements k0 .. k0 + m - 1."""
        k, stamp, truth = self._span(k0, m)
        values = self._clean(k0, truth)
        valid = self._dropouts(stamp, k0)
        if faults is not None and faults.faults:
            valid &= faults.apply_aid(self.name, stamp, k0, values, self._before)
        return k, stamp, truth, values, valid

    def _before(self, stamp_ns: int) -> Sample:
        k = self._last_before(stamp_ns)
        _, stamp, truth = self._span(k, 1)
        return Sample(int(stamp[0]), k, self._clean(k, truth)[0])


@jit
def sensor_velocity(c_nb: Array, v_n: Array, rate: Array, lever: Array, v_b: Array) -> None:
    """Velocity over ground of a sensor in the body, FRD, m/s: v_b + w_nb x l."""
    for i in range(v_n.shape[0]):
        for j in range(3):
            v_b[i, j] = c_nb[i, 0, j] * v_n[i, 0] + c_nb[i, 1, j] * v_n[i, 1] + c_nb[i, 2, j] * v_n[i, 2]
        v_b[i, 0] += rate[i, 1] * lever[2] - rate[i, 2] * lever[1]
        v_b[i, 1] += rate[i, 2] * lever[0] - rate[i, 0] * lever[2]
        v_b[i, 2] += rate[i, 0] * lever[1] - rate[i, 1] * lever[0]


@jit
def turned(c: Array, v: Array, out: Array) -> None:
    """out += c v row by row; c is (m, 3, 3), or (1, 3, 3) for all rows."""
    for i in range(v.shape[0]):
        k = i if c.shape[0] > 1 else 0
        for j in range(3):
            out[i, j] += c[k, j, 0] * v[i, 0] + c[k, j, 1] * v[i, 1] + c[k, j, 2] * v[i, 2]


@jit
def displaced(lat: Array, lon: Array, h: Array, offset: Array, place: Array, per_metre: Array) -> None:
    """Positions moved by offsets north, east, down [m], and what a metre is in latitude, longitude and height there."""
    for i in range(lat.shape[0]):
        r_m, r_n = radii_s(lat[i])
        per_metre[i, 0] = 1.0 / (r_m + h[i])
        per_metre[i, 1] = 1.0 / ((r_n + h[i]) * np.cos(lat[i]))
        per_metre[i, 2] = -1.0
        place[i, 0] = lat[i] + offset[i, 0] * per_metre[i, 0]
        place[i, 1] = lon[i] + offset[i, 1] * per_metre[i, 1]
        place[i, 2] = h[i] - offset[i, 2]


def _never(stamp_ns: int) -> Sample:
    raise AssertionError("an outage holds no value")
