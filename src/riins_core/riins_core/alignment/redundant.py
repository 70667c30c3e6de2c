"""Alignment at rest on the raw outputs of redundant sensors: least squares of all of them with a prior for common bias, and 3-state filters.

Lives here: `fuse_means`, `align_redundant` (all sensors, then TRIAD), `PairFilter` (the thesis' three states), `AttitudeFilter` (any heading),
`largest_nc`. Does not live here: the geometry (imu_array.py), which sensors are healthy (a mask is given), filters on velocity (stationary.py).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ..earth import OMEGA_IE, earth_rate_n, gravity
from ..imu_array import DODECAHEDRON_ANGLE, ImuArray, Mask
from ..kalman import update
from ..rotation import exp_so3, skew
from .coarse import triad
from .result import Alignment, AlignmentError, bias_covariance, check_latitude

Array = NDArray[np.float64]


def fuse_means(mean: Array, array: ImuArray, noise: float, bias: float, common: float = 0.0, mask: Mask = None) -> tuple[Array, Array, Array]:
    """Weighted least squares of the mean outputs of all healthy sensors, with a prior for their biases.

    Parameters
    ----------
    mean : (n,), mean output of each sensor, U
    array : geometry
    noise : standard deviation of the mean's noise, U
    bias, common : prior standard deviations of each sensor's own bias and of a bias that all have in common, U
    mask : healthy sensors

    Returns
    -------
    x (3,), covariance (3, 3), biases (n,) : the vector, its covariance, and the most probable biases of the sensors used (zero for the others)

    Notes
    -----
    R = (noise^2 + bias^2) I + common^2 1 1'. The thesis' pair differences are the limit of a large `common`, at the price of half the information:
    variance 1.81 sigma^2 against 0.5 with a small one. With six equal priors and no common part this is plain least squares.
    """
    used = array.used(mask)
    H = array.H[used]
    z = np.asarray(mean, dtype=np.float64)[used]
    prior = bias**2 * np.eye(len(used)) + common**2
    R = prior + noise**2 * np.eye(len(used))
    W = np.linalg.solve(R, H)
    P = np.linalg.inv(H.T @ W)
    x = P @ (W.T @ z)
    biases = np.zeros(array.n)
    biases[used] = prior @ np.linalg.solve(R, z - H @ x)
    return x, 0.5 * (P + P.T), biases


def align_redundant(
    gyro: Array,
    accel: Array,
    dt: float,
    lat: float,
    arrays: tuple[ImuArray, ImuArray],
    noise: tuple[float, float],
    bias: tuple[float, float],
    common: tuple[float, float] = (0.0, 0.0),
    masks: tuple[Mask, Mask] = (None, None),
) -> Alignment:
    """Least squares of all sensors, then TRIAD: complete after a few seconds, at every heading.

    Parameters
    ----------
    gyro, accel : (m, n), outputs [rad/s], [m/s^2], means over dt
    dt : s
    lat : rad
    arrays : geometry of gyros and of accelerometers
    noise : densities, rad/sqrt(s) and m/s/sqrt(s)
    bias, common : prior standard deviations of single and of common biases, rad/s and m/s^2
    masks : healthy gyros and accelerometers

    Returns
    -------
    Alignment; `bias_g`, `bias_a` are what the sensors' most probable biases do to the fused triad (zero without a common part)

    Raises
    ------
    AlignmentError
        Latitude beyond 85 deg, data not finite, vectors that give no heading.
    """
    check_latitude(lat)
    vectors, covariances = [], []
    for values, array, density, single, shared, mask in zip((gyro, accel), arrays, noise, bias, common, masks, strict=True):
        mean = np.asarray(values, dtype=np.float64).mean(axis=0)
        if not np.all(np.isfinite(mean[array.used(mask)])):
            raise AlignmentError("the data of a sensor in use are not finite")
        x, P, _ = fuse_means(mean, array, density / math.sqrt(len(values) * dt), single, shared, mask)
        vectors.append(x)
        covariances.append(P)
    C = triad(vectors[1], vectors[0], lat)
    P = bias_covariance(lat, C, covariances[0], covariances[1])
    return Alignment("redundant least squares", C, P, len(gyro) * dt)


class PairFilter:
    """The thesis' filter: roll, pitch and heading from three differences of opposite sensors, (3-39)-(3-47).

    Parameters
    ----------
    lat : rad
    start : (3,), roll, pitch, heading, rad
    start_sigma : (3,), rad
    noise_g, noise_a : standard deviation of one output of a gyro [rad/s] and an accelerometer [m/s^2]
    walk : (3,), process noise of a step, rad (left out in (3-43))

    Attributes
    ----------
    x, P : (3,), (3, 3), roll, pitch, heading, rad

    Notes
    -----
    In NED / FRD with the dodecahedron of (3-25): m1 - m2 = 2 sin(alpha) x and m3 - m4 = 2 sin(alpha) y of force and rate. Of the rate only x is
    used, so heading has no sign and is not observable at 0 and 180 deg ((3-38) is an arccos): start near the truth and away from them. (3-40) has
    the Earth rate twice.
    """

    def __init__(self, lat: float, start: Array, start_sigma: Array, noise_g: float, noise_a: float, walk: Array | None = None) -> None:
        check_latitude(lat)
        self.x = np.array(start, dtype=np.float64)
        self.P = np.diag(np.square(start_sigma))
        self._Q = np.zeros((3, 3)) if walk is None else np.diag(np.square(walk))
        self._R = 2.0 * np.diag([noise_a**2, noise_a**2, noise_g**2])
        self._g, self._north, self._vertical = float(gravity(lat, 0.0)), OMEGA_IE * math.cos(lat), OMEGA_IE * math.sin(lat)

    def predicted(self) -> tuple[Array, Array]:
        """Differences that should be read, (3,), and their Jacobian (3, 3)."""
        roll, pitch, heading = self.x
        sr, cr, sp, cp, sh, ch = math.sin(roll), math.cos(roll), math.sin(pitch), math.cos(pitch), math.sin(heading), math.cos(heading)
        n, v, g = self._north, self._vertical, self._g
        h = np.array([g * sp, -g * sr * cp, n * cp * ch + v * sp])
        J = np.array([[0.0, g * cp, 0.0], [-g * cr * cp, g * sr * sp, 0.0], [0.0, -n * sp * ch + v * cp, -n * cp * sh]])
        return 2.0 * math.sin(DODECAHEDRON_ANGLE) * h, 2.0 * math.sin(DODECAHEDRON_ANGLE) * J

    def update(self, gyro: Array, accel: Array) -> None:
        """One step with the outputs (6,) of gyros and accelerometers."""
        self.P = self.P + self._Q
        z = np.array([accel[0] - accel[1], accel[2] - accel[3], gyro[0] - gyro[1]])
        h, J = self.predicted()
        self.x, self.P, _ = update(self.x, self.P, z - h + J @ self.x, J, self._R)


class AttitudeFilter:
    """Three-state filter on the raw outputs of all healthy sensors, at every attitude and heading.

    Parameters
    ----------
    lat : rad
    arrays : geometry of gyros and of accelerometers
    noise_g, noise_a : standard deviation of one output, rad/s and m/s^2
    bias, common : as in `align_redundant`: of the weights of the sensors among each other, and of the covariance given out
    masks : healthy sensors

    Attributes
    ----------
    C_nb : (3, 3), None before the first update
    P : (3, 3), of phi, from noise alone

    Notes
    -----
    The error is phi in n, so there is no angle to be singular; the first update is least squares and TRIAD, which needs no attitude to begin with.
    The rate of the base adds nothing but the Earth rate: at rest n and b turn alike and the state is constant.
    """

    def __init__(
        self,
        lat: float,
        arrays: tuple[ImuArray, ImuArray],
        noise_g: float,
        noise_a: float,
        bias: tuple[float, float] = (0.0, 0.0),
        common: tuple[float, float] = (0.0, 0.0),
        masks: tuple[Mask, Mask] = (None, None),
    ) -> None:
        check_latitude(lat)
        self.lat, self.arrays, self.masks = lat, arrays, masks
        self._noise, self._bias, self._common = (noise_g, noise_a), bias, common
        self._references = (earth_rate_n(lat), np.array([0.0, 0.0, -float(gravity(lat, 0.0))]))
        self.C_nb: Array | None = None
        self.P: Array = np.zeros((3, 3))

    def isolate(self, masks: tuple[Mask, Mask]) -> None:
        """Go on with these sensors, from nothing: what an isolated one has put in is not kept. A few seconds bring all back."""
        for array, mask in zip(self.arrays, masks, strict=True):
            array.used(mask)
        self.masks, self.C_nb = masks, None

    def update(self, gyro: Array, accel: Array) -> None:
        """One step with the outputs (n,) of gyros and accelerometers."""
        vectors, gains = [], []
        for kind, values in enumerate((gyro, accel)):
            x, _, _ = fuse_means(values, self.arrays[kind], self._noise[kind], self._bias[kind], self._common[kind], self.masks[kind])
            vectors.append(x)
            gains.append(self._white(kind))
        if self.C_nb is None:
            self.C_nb = triad(vectors[1], vectors[0], self.lat)
            self.P = bias_covariance(self.lat, self.C_nb, gains[0], gains[1])
            return
        # computed C x = true C x - phi x (true C x): residual C x - r = [r x] phi + noise. Of the rate its east part alone: the drift of a gyro
        # would tilt the level by what its other parts say
        rows = np.vstack([skew(self._references[1])[:2], skew(self._references[0])[1:2]])
        z = np.concatenate([(self.C_nb @ vectors[1])[:2] - self._references[1][:2], (self.C_nb @ vectors[0])[1:2]])
        R = np.zeros((3, 3))
        R[:2, :2] = (self.C_nb @ gains[1] @ self.C_nb.T)[:2, :2]
        R[2, 2] = self.C_nb[1] @ gains[0] @ self.C_nb[1]
        phi, self.P, _ = update(np.zeros(3), self.P, z, rows, R)
        self.C_nb = exp_so3(phi) @ self.C_nb

    def _white(self, kind: int) -> Array:
        """Covariance (3, 3) of the fused vector's white part: weights are those of `fuse_means`, noise alone goes through them."""
        array = self.arrays[kind]
        n = len(array.used(self.masks[kind]))
        H = array.H[array.used(self.masks[kind])]
        R = (self._noise[kind] ** 2 + self._bias[kind] ** 2) * np.eye(n) + self._common[kind] ** 2
        G = np.linalg.solve(H.T @ np.linalg.solve(R, H), np.linalg.solve(R, H).T)
        return np.asarray(self._noise[kind] ** 2 * G @ G.T)

    def result(self, time: float) -> Alignment:
        """What is known `time` s after the start, the biases in the covariance.

        Raises
        ------
        AlignmentError
            Before the first update.
        """
        if self.C_nb is None:
            raise AlignmentError("no data yet: there is no attitude")
        biases = [
            fuse_means(np.zeros(self.arrays[k].n), self.arrays[k], 0.0, max(self._bias[k], 1e-12), self._common[k], self.masks[k])[1]
            for k in range(2)
        ]
        return Alignment("redundant filter", self.C_nb.copy(), self.P + bias_covariance(self.lat, self.C_nb, biases[0], biases[1]), time)


def largest_nc(lat: float, drift: float, bias: float, angle: float = DODECAHEDRON_ANGLE) -> tuple[float, float]:
    """Largest errors that constant errors of unlike signs (the thesis' NC) leave in `PairFilter`, at pitch 0 and heading 90 deg.

    Parameters
    ----------
    lat : rad
    drift, bias : size of each gyro's drift [rad/s] and each accelerometer's bias [m/s^2]
    angle : inclination of the sensors, rad

    Returns
    -------
    level, heading : rad, (3-50) and (3-58); both zero where opposite sensors have the same error
    """
    check_latitude(lat)
    level = math.asin(bias / (float(gravity(lat, 0.0)) * math.sin(angle)))
    return level, math.asin(drift / (OMEGA_IE * math.cos(lat) * math.sin(angle)))
