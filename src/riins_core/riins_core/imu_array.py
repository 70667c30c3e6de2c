"""N single-axis inertial sensors: geometry H, parity matrix V, least squares, and the figures of merit of a configuration.

Lives here: the four six-sensor configurations of the thesis, any n x 3 geometry, tables 2.1 to 2.3 as plain data.
Does not live here: what is left when sensors are isolated (survivors), fault detection (riins_fdi.parity), estimated noise (riins_imu_fusion).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Mask = ArrayLike | int | None
"""Which sensors are used: booleans (n,), an integer with bit i for sensor i, or None for all."""

DODECAHEDRON_ANGLE = math.atan((math.sqrt(5.0) - 1.0) / 2.0)
"""31.71747 deg. The rounded 31.7 of the literature leaks 431 ug of parity per g."""
CONE1_ANGLE = math.acos(1.0 / math.sqrt(3.0))
"""54.7356 deg, where J_p of cone 1 is largest."""
CONE2_ANGLE = math.asin(1.0 / math.sqrt(3.0))
"""35.2644 deg, where J_p of cone 2 is largest; the thesis prints 35.7356, with the row (0.5774, 0, 0.8165) that belongs to 35.2644."""

_UNIT_TOLERANCE = 1e-6
_RANK_TOLERANCE = 1e-8


def orthogonal() -> Array:
    """Two sensors along each axis, (6, 3); thesis table 2.2. A fault is seen but not isolated within its pair."""
    return np.repeat(np.eye(3), 2, axis=0)


def cone1(angle: float = CONE1_ANGLE) -> Array:
    """Six sensors on one cone about z, (6, 3); thesis (2-31). `angle` [rad] between z and each axis."""
    turn = np.arange(6) * math.pi / 3.0
    return np.column_stack([math.sin(angle) * np.cos(turn), math.sin(angle) * np.sin(turn), np.full(6, math.cos(angle))])


def cone2(angle: float = CONE2_ANGLE) -> Array:
    """Three sensors in the plane xy and three on a cone about z, (6, 3); thesis (2-32).

    Table 2.2 has row 3 as (-0.5, 0.8660, 0), which repeats row 2; by (2-32) it is (-0.5, -0.8660, 0). It also has 0.2884 for 0.2887.
    """
    turn = np.arange(3) * 2.0 * math.pi / 3.0
    flat = np.column_stack([np.cos(turn), np.sin(turn), np.zeros(3)])
    return np.vstack([flat, np.column_stack([math.sin(angle) * flat[:, :2], np.full(3, math.cos(angle))])])


def dodecahedron() -> Array:
    """Normals of a regular dodecahedron's faces, (6, 3), in the order of thesis (2-33) and table 4.1; (4-83) relabels the axes."""
    s, c = math.sin(DODECAHEDRON_ANGLE), math.cos(DODECAHEDRON_ANGLE)
    return np.array([[s, 0, c], [-s, 0, c], [c, s, 0], [c, -s, 0], [0, c, s], [0, c, -s]])


CONFIGURATIONS: dict[str, Array] = {"dodecahedron": dodecahedron(), "cone1": cone1(), "cone2": cone2(), "orthogonal": orthogonal()}
"""The thesis' configurations: rows are sensing axes; its x, y, z are taken as body forward, starboard, down (FRD)."""


class ImuArray:
    """Geometry of n single-axis sensors of one kind: m = H x + noise.

    Parameters
    ----------
    H : (n, 3), unit sensing axes in the body frame as rows; renormalised to rounding

    Attributes
    ----------
    H : (n, 3), read-only
    n : int, number of sensors, 3 to 64

    Raises
    ------
    ValueError
        H is not n x 3 with 3 <= n <= 64, not finite, a row is not of unit length (1e-6), or the rank is below 3.
    """

    def __init__(self, H: ArrayLike) -> None:
        axes = np.array(H, dtype=np.float64)
        if axes.ndim != 2 or axes.shape[1] != 3 or not 3 <= axes.shape[0] <= 64:
            raise ValueError(f"the geometry must be n x 3 with 3 <= n <= 64, not {' x '.join(map(str, axes.shape))}")
        if not np.all(np.isfinite(axes)):
            raise ValueError("the geometry contains values that are not finite")
        length = np.linalg.norm(axes, axis=1)
        worst = int(np.argmax(np.abs(length - 1.0)))
        if abs(length[worst] - 1.0) > _UNIT_TOLERANCE:
            raise ValueError(f"the axis of sensor {worst + 1} has length {length[worst]:.7g}, not 1")
        self.H: Array = axes / length[:, None]
        self.H.flags.writeable = False
        self.n = axes.shape[0]
        if _rank(self.H) < 3:
            raise ValueError("the sensing axes lie in a plane: the geometry must have rank 3")

    def used(self, mask: Mask = None) -> NDArray[np.intp]:
        """Indices of the sensors a mask selects, ascending.

        Raises
        ------
        ValueError
            The mask has another length, or the sensors it selects have rank below 3.
        """
        if mask is None:
            chosen = np.ones(self.n, dtype=bool)
        elif isinstance(mask, int | np.integer):
            chosen = np.array([bool((int(mask) >> i) & 1) for i in range(self.n)])
        else:
            chosen = np.asarray(mask, dtype=bool)
        if chosen.shape != (self.n,):
            raise ValueError(f"the mask must have {self.n} elements, not {chosen.shape}")
        index = np.flatnonzero(chosen)
        if index.size < 3 or _rank(self.H[index]) < 3:
            raise ValueError(f"the sensors {[int(i) + 1 for i in index]} do not span three axes")
        return index

    def parity(self, mask: Mask = None) -> Array:
        """Parity matrix V: V H = 0, V V' = I.

        Parameters
        ----------
        mask : sensors used; m of them

        Returns
        -------
        (m - 3, m), columns in ascending order of the sensors used

        Notes
        -----
        Potter's form: upper triangular with positive diagonal (in echelon form where leading sensors have no redundancy), so V is unique and
        does not depend on the linear algebra library. The thesis' (4-84)/(5-106) has V V' = 2 I: every chi-square threshold is then off by two.
        """
        index = self.used(mask)
        m = index.size
        null = np.linalg.svd(self.H[index].T)[2][3:]  # (m - 3, m), orthonormal, but with the library's choice of basis
        pivots: list[int] = []
        for column in range(m):
            if len(pivots) == m - 3:
                break
            basis = np.linalg.qr(null[:, pivots])[0] if pivots else np.zeros((m - 3, 0))
            residual = null[:, column] - basis @ (basis.T @ null[:, column])
            if np.linalg.norm(residual) > _RANK_TOLERANCE:
                pivots.append(column)
        if not pivots:
            return np.zeros((0, m))
        q, r = np.linalg.qr(null[:, pivots])
        v = (q * np.sign(np.diag(r))).T @ null
        for row, column in enumerate(pivots):
            v[row, :column] = 0.0
        return np.asarray(v) + 0.0  # no negative zeros

    def parity_full(self, mask: Mask = None) -> Array:
        """`parity` as (m - 3, n) with zero columns for sensors not used."""
        index = self.used(mask)
        v = np.zeros((index.size - 3, self.n))
        v[:, index] = self.parity(mask)
        return v

    def least_squares(self, mask: Mask = None, sigma: ArrayLike | None = None) -> Array:
        """Estimator of the body vector: x = W m.

        Parameters
        ----------
        mask : sensors used
        sigma : scalar or (n,), standard deviation of each sensor; None: equal

        Returns
        -------
        (3, n), W = (H' R^-1 H)^-1 H' R^-1, zero columns for sensors not used; thesis (2-34)
        """
        index = self.used(mask)
        scale = self._sigma(sigma)[index]
        weighted = self.H[index] / scale[:, None]
        w = np.zeros((3, self.n))
        w[:, index] = np.linalg.solve(weighted.T @ weighted, weighted.T / scale)
        return w

    def covariance(self, mask: Mask = None, sigma: ArrayLike | None = None) -> Array:
        """Covariance (3, 3) of the least-squares estimate, (H' R^-1 H)^-1; thesis (2-35). `sigma` as in `least_squares`, None: 1."""
        index = self.used(mask)
        weighted = self.H[index] / self._sigma(sigma)[index][:, None]
        return np.asarray(np.linalg.inv(weighted.T @ weighted))

    def accuracy_figure(self, mask: Mask = None) -> float:
        """J_p = det(H'H), thesis (2-36); (n / 3)^3 at best."""
        h = self.H[self.used(mask)]
        return float(np.linalg.det(h.T @ h))

    def gdop(self, mask: Mask = None) -> float:
        """Geometric dilution sqrt(trace (H'H)^-1), thesis (2-37); 3 / sqrt(n) at best."""
        return math.sqrt(float(np.trace(self.covariance(mask))))

    def coherence(self, mask: Mask = None) -> float:
        """Largest |h_i . h_j| of two sensors, thesis (2-41); the smaller, the better two faults are told apart."""
        h = self.H[self.used(mask)]
        return float(np.max(np.abs(np.triu(h @ h.T, 1))))

    def _sigma(self, sigma: ArrayLike | None) -> Array:
        full = np.broadcast_to(np.asarray(1.0 if sigma is None else sigma, dtype=np.float64), (self.n,))
        if not np.all(full > 0.0):
            raise ValueError("standard deviations must be positive")
        return full


def reliability(n: int, survivors: int = 3) -> float:
    """Relative mean time between failures theta_n of n sensors that serve until fewer than `survivors` are left.

    Parameters
    ----------
    n : number of sensors, >= survivors
    survivors : least number of sensors the system works with, 3 or more

    Returns
    -------
    theta_n = 3 sum_{k=survivors..n} 1/k, in units of the MTBF of three sensors; thesis (2-28) has the integral
    """
    if not 3 <= survivors <= n:
        raise ValueError("needs 3 <= survivors <= n")
    return 3.0 * math.fsum(1.0 / k for k in range(survivors, n + 1))


class ReliabilityRow(NamedTuple):
    """Row of table 2.1."""

    n: int
    theta: float
    """relative MTBF"""
    delta: float
    """theta_n - theta_{n-1}; 0 in the first row"""
    figure: float
    """F_n = theta_n / n, thesis (2-30)"""


def table_2_1(n_max: int = 16, survivors: int = 3) -> list[ReliabilityRow]:
    """Reliability against the number of sensors, thesis table 2.1 with the figure F_n of figure 2.4.

    Parameters
    ----------
    n_max : largest number of sensors
    survivors : least number of sensors the system works with. The thesis' optimum n = 6 belongs to 3;
        with 4 (detection stays possible) it is 9, with 5 (isolation stays possible) 11.

    Returns
    -------
    rows for n = survivors .. n_max
    """
    rows: list[ReliabilityRow] = []
    for n in range(survivors, n_max + 1):
        theta = reliability(n, survivors)
        rows.append(ReliabilityRow(n, theta, theta - rows[-1].theta if rows else 0.0, theta / n))
    return rows


class AccuracyRow(NamedTuple):
    """Row of table 2.2."""

    name: str
    angle: float | None
    """inclination that makes J_p largest, rad; None where there is none to choose"""
    H: Array
    accuracy_figure: float
    gdop: float
    deviation: float
    """largest element of |H'H - n/3 I|: zero is the thesis' condition of theorem 1"""


def table_2_2() -> list[AccuracyRow]:
    """Best accuracy of the four configurations, thesis table 2.2, with J_p, GDOP and the condition H'H = n/3 I as a number."""
    angles = {"dodecahedron": DODECAHEDRON_ANGLE, "cone1": CONE1_ANGLE, "cone2": CONE2_ANGLE, "orthogonal": None}
    rows = []
    for name in ("orthogonal", "cone1", "cone2", "dodecahedron"):
        array = ImuArray(CONFIGURATIONS[name])
        deviation = float(np.max(np.abs(array.H.T @ array.H - array.n / 3.0 * np.eye(3))))
        rows.append(AccuracyRow(name, angles[name], array.H, array.accuracy_figure(), array.gdop(), deviation))
    return rows


class CoherenceRow(NamedTuple):
    """Row of table 2.3."""

    name: str
    coherence: float
    best: bool


def table_2_3() -> list[CoherenceRow]:
    """Coherence of the four configurations, thesis table 2.3; the smallest is best for telling faults apart."""
    values = {name: ImuArray(CONFIGURATIONS[name]).coherence() for name in ("orthogonal", "cone1", "cone2", "dodecahedron")}
    least = min(values.values())
    return [CoherenceRow(name, value, value == least) for name, value in values.items()]


def _rank(h: Array) -> int:
    return int(np.linalg.matrix_rank(h, tol=_RANK_TOLERANCE))
