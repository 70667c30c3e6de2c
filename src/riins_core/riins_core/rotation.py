"""SO(3): direction cosine matrices, quaternions, rotation vectors, roll, pitch and heading.

Lives here: conversions and algebra on arrays of any leading shape. C_nb turns b into n; quaternions are scalar-last (x, y, z, w) as in ROS.
Does not live here: what the frames are (frames.py), integration of rates (strapdown.py).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .jit import jit

Array = NDArray[np.float64]

_SMALL_ANGLE = 1e-4
"""Below it series to fourth order are exact to rounding, rad."""


def skew(v: ArrayLike) -> Array:
    """Matrix [v x] with [v x] u = v x u.

    Parameters
    ----------
    v : (..., 3)

    Returns
    -------
    (..., 3, 3)
    """
    v = np.asarray(v, dtype=np.float64)
    m = np.zeros((*v.shape, 3))
    m[..., 0, 1], m[..., 0, 2] = -v[..., 2], v[..., 1]
    m[..., 1, 0], m[..., 1, 2] = v[..., 2], -v[..., 0]
    m[..., 2, 0], m[..., 2, 1] = -v[..., 1], v[..., 0]
    return m


def dcm_from_euler(roll: ArrayLike, pitch: ArrayLike, heading: ArrayLike) -> Array:
    """C_nb of roll, pitch and heading.

    Parameters
    ----------
    roll, pitch, heading : (...), rad; heading clockwise from north

    Returns
    -------
    (..., 3, 3), v_n = C_nb v_b, n = NED, b = FRD

    Notes
    -----
    C_nb = Rz(heading) Ry(pitch) Rx(roll). In the thesis (2-5) the elements (1,1) and (2,1) carry cos and sin of the roll
    where the heading belongs.
    """
    roll, pitch, heading = np.broadcast_arrays(*(np.asarray(a, dtype=np.float64) for a in (roll, pitch, heading)))
    sr, cr, sp, cp, sh, ch = np.sin(roll), np.cos(roll), np.sin(pitch), np.cos(pitch), np.sin(heading), np.cos(heading)
    rows = [
        [cp * ch, sr * sp * ch - cr * sh, cr * sp * ch + sr * sh],
        [cp * sh, sr * sp * sh + cr * ch, cr * sp * sh - sr * ch],
        [-sp, sr * cp, cr * cp],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def euler_from_dcm(c_nb: ArrayLike) -> tuple[Array, Array, Array]:
    """Roll, pitch and heading of C_nb; the inverse of `dcm_from_euler`.

    Parameters
    ----------
    c_nb : (..., 3, 3)

    Returns
    -------
    roll (-pi..pi), pitch (-pi/2..pi/2), heading (0..2 pi), each (...), rad

    Notes
    -----
    Heading is atan2(c21, c11); the thesis (2-15) decides the quadrant by c22, which is wrong when the ship rolls over or pitches.
    At pitch = +-90 deg only heading -+ roll is defined; roll is then what atan2 of rounding says.
    """
    c = np.asarray(c_nb, dtype=np.float64)
    roll = np.arctan2(c[..., 2, 1], c[..., 2, 2])
    pitch = np.arctan2(-c[..., 2, 0], np.hypot(c[..., 2, 1], c[..., 2, 2]))
    heading = np.mod(np.arctan2(c[..., 1, 0], c[..., 0, 0]), 2.0 * np.pi)
    return roll, pitch, np.where(heading >= 2.0 * np.pi, 0.0, heading)  # mod of a tiny negative angle rounds to 2 pi


def exp_so3(rotvec: ArrayLike) -> Array:
    """Rotation matrix of a rotation vector (Rodrigues).

    Parameters
    ----------
    rotvec : (..., 3), rad

    Returns
    -------
    (..., 3, 3)
    """
    r = np.asarray(rotvec, dtype=np.float64)
    t2 = np.sum(r * r, axis=-1)
    t = np.sqrt(t2)
    small = t < _SMALL_ANGLE
    safe = np.where(small, 1.0, t)
    half = np.sin(0.5 * safe) / safe
    s = np.where(small, 1.0 - t2 / 6.0, np.sin(safe) / safe)[..., None, None]
    c = np.where(small, 0.5 - t2 / 24.0, 2.0 * half * half)[..., None, None]
    k = skew(r)
    return np.asarray(np.eye(3) + s * k + c * (k @ k))


def log_so3(c: ArrayLike) -> Array:
    """Rotation vector of a rotation matrix, length 0..pi; the inverse of `exp_so3`.

    Parameters
    ----------
    c : (..., 3, 3)

    Returns
    -------
    (..., 3), rad
    """
    return rotvec_from_quat(quat_from_dcm(c))


def quat_from_dcm(c: ArrayLike) -> Array:
    """Unit quaternion (x, y, z, w) of a rotation matrix, w >= 0.

    Parameters
    ----------
    c : (..., 3, 3)

    Returns
    -------
    (..., 4)

    Notes
    -----
    Shepperd's method: of the four squares the largest is taken, so no division by a small number occurs.
    """
    c = np.asarray(c, dtype=np.float64)
    c00, c11, c22 = c[..., 0, 0], c[..., 1, 1], c[..., 2, 2]
    a, b, d = c[..., 2, 1] - c[..., 1, 2], c[..., 0, 2] - c[..., 2, 0], c[..., 1, 0] - c[..., 0, 1]
    e, f, g = c[..., 1, 0] + c[..., 0, 1], c[..., 2, 0] + c[..., 0, 2], c[..., 2, 1] + c[..., 1, 2]
    candidates = np.stack(
        [
            np.stack([1.0 + c00 - c11 - c22, e, f, a], axis=-1),
            np.stack([e, 1.0 - c00 + c11 - c22, g, b], axis=-1),
            np.stack([f, g, 1.0 - c00 - c11 + c22, d], axis=-1),
            np.stack([a, b, d, 1.0 + c00 + c11 + c22], axis=-1),
        ],
        axis=-2,
    )
    pivot = np.argmax(np.stack([c00, c11, c22, c00 + c11 + c22], axis=-1), axis=-1)
    q = np.take_along_axis(candidates, pivot[..., None, None], axis=-2)[..., 0, :]
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    return np.asarray(np.where(q[..., 3:] < 0.0, -q, q))


def dcm_from_quat(q: ArrayLike) -> Array:
    """Rotation matrix of a quaternion (x, y, z, w), normalised here.

    Parameters
    ----------
    q : (..., 4), not zero

    Returns
    -------
    (..., 3, 3)
    """
    q = quat_normalize(q)
    x, y, z, w = q[..., 0], q[..., 1], q[..., 2], q[..., 3]
    rows = [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)],
        [2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)],
        [2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def quat_normalize(q: ArrayLike) -> Array:
    """Quaternion (..., 4) divided by its length."""
    q = np.asarray(q, dtype=np.float64)
    return np.asarray(q / np.linalg.norm(q, axis=-1, keepdims=True))


def quat_multiply(p: ArrayLike, q: ArrayLike) -> Array:
    """Hamilton product: the rotation q followed by p, dcm(p q) = dcm(p) dcm(q).

    Parameters
    ----------
    p, q : (..., 4), scalar last

    Returns
    -------
    (..., 4)
    """
    p, q = np.asarray(p, dtype=np.float64), np.asarray(q, dtype=np.float64)
    pv, pw, qv, qw = p[..., :3], p[..., 3:], q[..., :3], q[..., 3:]
    vector = pw * qv + qw * pv + np.cross(pv, qv)
    return np.concatenate([vector, pw * qw - np.sum(pv * qv, axis=-1, keepdims=True)], axis=-1)


def quat_conjugate(q: ArrayLike) -> Array:
    """Inverse of a unit quaternion (..., 4)."""
    return np.asarray(np.asarray(q, dtype=np.float64) * np.array([-1.0, -1.0, -1.0, 1.0]))


def quat_from_rotvec(rotvec: ArrayLike) -> Array:
    """Unit quaternion (..., 4) of a rotation vector (..., 3) [rad]."""
    r = np.asarray(rotvec, dtype=np.float64)
    t = np.linalg.norm(r, axis=-1, keepdims=True)
    small = t < _SMALL_ANGLE
    safe = np.where(small, 1.0, t)
    scale = np.where(small, 0.5 - t * t / 48.0, np.sin(0.5 * safe) / safe)
    return np.concatenate([scale * r, np.cos(0.5 * t)], axis=-1)


def rotvec_from_quat(q: ArrayLike) -> Array:
    """Rotation vector (..., 3) [rad], length 0..pi, of a quaternion (..., 4)."""
    q = quat_normalize(q)
    q = np.where(q[..., 3:] < 0.0, -q, q)
    s = np.linalg.norm(q[..., :3], axis=-1, keepdims=True)
    small = s < _SMALL_ANGLE
    safe = np.where(small, 1.0, s)
    scale = np.where(small, 2.0 + s * s / 3.0, 2.0 * np.arctan2(safe, q[..., 3:]) / safe)
    return np.asarray(scale * q[..., :3], dtype=np.float64)


def rotate(c: ArrayLike, v: ArrayLike) -> Array:
    """Vectors turned by rotation matrices: c (..., 3, 3), v (..., 3) -> (..., 3)."""
    return np.asarray(np.einsum("...ij,...j->...i", np.asarray(c, dtype=np.float64), np.asarray(v, dtype=np.float64)))


def orthonormalize(c: ArrayLike) -> Array:
    """Rotation matrix nearest to c (..., 3, 3) in the Frobenius norm (polar decomposition)."""
    u, _, vt = np.linalg.svd(np.asarray(c, dtype=np.float64))
    sign = np.sign(np.linalg.det(u @ vt))
    u[..., :, 2] *= sign[..., None]
    return np.asarray(u @ vt)


@jit
def exp_so3_into(x: float, y: float, z: float, out: Array) -> None:
    """Kernel: `exp_so3` of the rotation vector (x, y, z) [rad] written into out (3, 3)."""
    t2 = x * x + y * y + z * z
    if t2 > _SMALL_ANGLE:  # here of the square: the series below are exact to rounding up to 0.01 rad
        t = math.sqrt(t2)
        s = math.sin(t) / t
        half = math.sin(0.5 * t) / t
        c = 2.0 * half * half
    else:
        s = 1.0 - t2 / 6.0 * (1.0 - t2 / 20.0 * (1.0 - t2 / 42.0))
        c = 0.5 - t2 / 24.0 * (1.0 - t2 / 30.0 * (1.0 - t2 / 56.0))
    out[0, 0] = 1.0 - c * (y * y + z * z)
    out[0, 1] = c * x * y - s * z
    out[0, 2] = c * x * z + s * y
    out[1, 0] = c * x * y + s * z
    out[1, 1] = 1.0 - c * (x * x + z * z)
    out[1, 2] = c * y * z - s * x
    out[2, 0] = c * x * z - s * y
    out[2, 1] = c * y * z + s * x
    out[2, 2] = 1.0 - c * (x * x + y * y)
