"""Frames: FRD/NED inside, FLU/ENU at the ROS boundary (REP-103), geodetic coordinates and a local tangent plane.

Lives here: every change of axes of the workspace, vectors, covariances and attitudes alike.
Does not live here: rotation algebra (rotation.py), ROS messages (riins_node.convert).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .earth import E2, A, B, radii
from .rotation import dcm_from_quat, quat_from_dcm, rotate

Array = NDArray[np.float64]

FLU_FROM_FRD: Array = np.diag([1.0, -1.0, -1.0])
"""Turns FRD into FLU; its own inverse."""
ENU_FROM_NED: Array = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
"""Turns NED into ENU; its own inverse."""


def frd_to_flu(v: ArrayLike) -> Array:
    """Vectors (..., 3) from FRD to FLU, or back: the map is its own inverse."""
    return np.asarray(np.asarray(v, dtype=np.float64) * np.array([1.0, -1.0, -1.0]) + 0.0)  # + 0: no negative zeros


def ned_to_enu(v: ArrayLike) -> Array:
    """Vectors (..., 3) from NED to ENU, or back: the map is its own inverse."""
    v = np.asarray(v, dtype=np.float64)
    return np.stack([v[..., 1], v[..., 0], -v[..., 2] + 0.0], axis=-1)


flu_to_frd = frd_to_flu
enu_to_ned = ned_to_enu


def frd_to_flu_covariance(P: ArrayLike) -> Array:
    """Covariances (..., 3, 3) from FRD to FLU, or back."""
    signs = np.array([1.0, -1.0, -1.0])  # not a product of matrices: a NaN of what was not measured must not spread
    return np.asarray(np.asarray(P, dtype=np.float64) * np.outer(signs, signs)) + 0.0


def ned_to_enu_covariance(P: ArrayLike) -> Array:
    """Covariances (..., 3, 3) from NED to ENU, or back."""
    order, signs = [1, 0, 2], np.array([1.0, 1.0, -1.0])
    return np.asarray(np.asarray(P, dtype=np.float64)[..., order, :][..., order] * np.outer(signs, signs)) + 0.0


flu_to_frd_covariance = frd_to_flu_covariance
enu_to_ned_covariance = ned_to_enu_covariance


def attitude_to_enu(c_nb: ArrayLike) -> Array:
    """Quaternion of the FLU body in local ENU, as ROS has it.

    Parameters
    ----------
    c_nb : (..., 3, 3), FRD to NED

    Returns
    -------
    (..., 4), x, y, z, w, w >= 0

    Notes
    -----
    Heading 0 (north) is a yaw of +90 deg: a heading is never put into a quaternion as it is.
    """
    return quat_from_dcm(ENU_FROM_NED @ np.asarray(c_nb, dtype=np.float64) @ FLU_FROM_FRD)


def attitude_from_enu(quat: ArrayLike) -> Array:
    """C_nb (..., 3, 3) of a quaternion (..., 4) of the FLU body in local ENU; the inverse of `attitude_to_enu`."""
    return np.asarray(ENU_FROM_NED @ dcm_from_quat(quat) @ FLU_FROM_FRD)


def ecef_from_geodetic(lat: ArrayLike, lon: ArrayLike, h: ArrayLike) -> Array:
    """Earth-centred, Earth-fixed position.

    Parameters
    ----------
    lat, lon, h : (...), rad, rad, m

    Returns
    -------
    (..., 3), m
    """
    lat, lon, h = np.broadcast_arrays(*(np.asarray(a, dtype=np.float64) for a in (lat, lon, h)))
    r_n = radii(lat)[1]
    p = (r_n + h) * np.cos(lat)
    return np.stack([p * np.cos(lon), p * np.sin(lon), (r_n * (1.0 - E2) + h) * np.sin(lat)], axis=-1)


def geodetic_from_ecef(r: ArrayLike) -> tuple[Array, Array, Array]:
    """Latitude, longitude [rad] and height [m] of Earth-fixed positions (..., 3) [m], above -6000 km.

    Notes
    -----
    Bowring (1976), repeated three times: rounding is reached at any height a ship, an aircraft or a satellite has. Valid at the poles.
    """
    r = np.asarray(r, dtype=np.float64)
    p, z = np.hypot(r[..., 0], r[..., 1]), r[..., 2]
    reduced = np.arctan2(A * z, B * p)
    for _ in range(3):
        s, c = np.sin(reduced), np.cos(reduced)
        lat = np.arctan2(z + E2 / (1.0 - E2) * B * s**3, p - E2 * A * c**3)
        reduced = np.arctan2(B * np.sin(lat), A * np.cos(lat))
    s = np.sin(lat)
    h = p * np.cos(lat) + z * s - A * np.sqrt(1.0 - E2 * s * s)
    return lat, np.arctan2(r[..., 1], r[..., 0]), h


def dcm_en(lat: ArrayLike, lon: ArrayLike) -> Array:
    """C_en (..., 3, 3), turns NED at a place into Earth-fixed axes."""
    lat, lon = np.broadcast_arrays(np.asarray(lat, dtype=np.float64), np.asarray(lon, dtype=np.float64))
    sl, cl, so, co = np.sin(lat), np.cos(lat), np.sin(lon), np.cos(lon)
    rows = [[-sl * co, -so, -cl * co], [-sl * so, co, -cl * so], [cl, np.zeros_like(cl), -sl]]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


class LocalFrame:
    """The ROS frame `map`: the plane tangent to the ellipsoid at a datum, axes east, north, up.

    Parameters
    ----------
    lat0, lon0, h0 : the datum, rad, rad, m

    Raises
    ------
    ValueError
        The datum is not finite or its latitude is beyond +-90 deg.
    """

    def __init__(self, lat0: float, lon0: float, h0: float) -> None:
        if not all(map(math.isfinite, (lat0, lon0, h0))) or abs(lat0) > 0.5 * math.pi:
            raise ValueError(f"not a place on the Earth: latitude {lat0} rad, longitude {lon0} rad, height {h0} m")
        self.lat0, self.lon0, self.h0 = lat0, lon0, h0
        self._origin = ecef_from_geodetic(lat0, lon0, h0)
        self._enu_from_e: Array = ENU_FROM_NED @ dcm_en(lat0, lon0).T

    def to_enu(self, lat: ArrayLike, lon: ArrayLike, h: ArrayLike) -> Array:
        """Positions (..., 3) in the datum's ENU axes [m] of geodetic positions [rad, rad, m]."""
        return rotate(self._enu_from_e, ecef_from_geodetic(lat, lon, h) - self._origin)

    def to_geodetic(self, enu: ArrayLike) -> tuple[Array, Array, Array]:
        """Latitude, longitude [rad] and height [m] of positions (..., 3) in the datum's ENU axes [m]."""
        return geodetic_from_ecef(rotate(self._enu_from_e.T, enu) + self._origin)

    def vector(self, lat: ArrayLike, lon: ArrayLike, v_n: ArrayLike) -> Array:
        """NED vectors (..., 3) at a place, in the datum's ENU axes: the meridians there are not parallel to those at the datum."""
        return rotate(self._enu_from_n(lat, lon), v_n)

    def covariance(self, lat: ArrayLike, lon: ArrayLike, P: ArrayLike) -> Array:
        """Covariances (..., 3, 3) in NED at a place, in the datum's ENU axes."""
        c = self._enu_from_n(lat, lon)
        return np.asarray(c @ np.asarray(P, dtype=np.float64) @ np.swapaxes(c, -1, -2))

    def attitude(self, lat: ArrayLike, lon: ArrayLike, c_nb: ArrayLike) -> Array:
        """Quaternion (..., 4) of base_link (FLU) in the datum's ENU axes of C_nb (..., 3, 3) at a place."""
        return quat_from_dcm(self._enu_from_n(lat, lon) @ np.asarray(c_nb, dtype=np.float64) @ FLU_FROM_FRD)

    def c_nb(self, lat: ArrayLike, lon: ArrayLike, quat: ArrayLike) -> Array:
        """C_nb (..., 3, 3) at a place of a quaternion (..., 4) of base_link in the datum's ENU axes; the inverse of `attitude`."""
        return np.asarray(np.swapaxes(self._enu_from_n(lat, lon), -1, -2) @ dcm_from_quat(quat) @ FLU_FROM_FRD)

    def _enu_from_n(self, lat: ArrayLike, lon: ArrayLike) -> Array:
        return np.asarray(self._enu_from_e @ dcm_en(lat, lon))


def wrap_longitude(lon: ArrayLike) -> Array:
    """Longitudes or differences of them, brought into -pi .. pi; values inside are left untouched to the bit."""
    lon = np.asarray(lon, dtype=np.float64)
    return np.where(np.abs(lon) <= np.pi, lon, np.mod(lon + np.pi, 2.0 * np.pi) - np.pi)


def ned_difference(
    lat: ArrayLike, lon: ArrayLike, h: ArrayLike, lat_ref: ArrayLike, lon_ref: ArrayLike, h_ref: ArrayLike
) -> Array:
    """Position minus reference in metres along the meridian, the parallel and down.

    Parameters
    ----------
    lat, lon, h : (...), rad, rad, m
    lat_ref, lon_ref, h_ref : (...), rad, rad, m

    Returns
    -------
    (..., 3), (dL (R_M + h), dl (R_N + h) cos L, -dh) with radii at the reference, m; longitudes may lie on either side of 180 deg
    """
    lat_ref, h_ref = np.asarray(lat_ref, dtype=np.float64), np.asarray(h_ref, dtype=np.float64)
    r_m, r_n = radii(lat_ref)
    dlon = wrap_longitude(np.asarray(lon, dtype=np.float64) - np.asarray(lon_ref, dtype=np.float64))
    north = (np.asarray(lat, dtype=np.float64) - lat_ref) * (r_m + h_ref)
    east = dlon * (r_n + h_ref) * np.cos(lat_ref)
    down = h_ref - np.asarray(h, dtype=np.float64)
    return np.stack(np.broadcast_arrays(north, east, down), axis=-1)


def ned_offset(lat: ArrayLike, lon: ArrayLike, h: ArrayLike, d_n: ArrayLike) -> tuple[Array, Array, Array]:
    """Geodetic position displaced by a short vector (a lever arm, an error); the inverse of `ned_difference` at that reference.

    Parameters
    ----------
    lat, lon, h : (...), rad, rad, m
    d_n : (..., 3), NED, m

    Returns
    -------
    latitude, longitude, height : (...), rad, rad, m
    """
    lat, h, d = (np.asarray(a, dtype=np.float64) for a in (lat, h, d_n))
    r_m, r_n = radii(lat)
    moved = np.asarray(lon, dtype=np.float64) + d[..., 1] / ((r_n + h) * np.cos(lat))
    return np.asarray(lat + d[..., 0] / (r_m + h)), wrap_longitude(moved), np.asarray(h - d[..., 2])
