"""Kernels of the trajectory: the panel polynomial, and the body rate and specific force that belong to it.

Lives here: `integrate_course`, `truth_kernel`, `increment_kernel`. Scratch arrays are the caller's, so nothing is allocated per sample.
Does not live here: the objects people use (trajectory.py), what the ship does (course.py, vessel.py).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from riins_core.earth import E2, OMEGA_IE, gravity_s, radii_s
from riins_core.jit import jit

from .course import climb_at, course_at
from .vessel import motion

Array = NDArray[np.float64]

COLUMNS = 24
"""Of a row of `truth_kernel`: lat, lon, h | v_n 3 | C_nb 9, row-major | w_nb_b 3 | w_ib_b 3 | f_b 3."""

_GAUSS = (0.5 - 0.5 * math.sqrt(0.6), 0.5, 0.5 + 0.5 * math.sqrt(0.6))
_WEIGHT = (5.0 / 18.0, 8.0 / 18.0, 5.0 / 18.0)


@jit
def _path_rates(t: float, lat: float, h: float, course: Array) -> tuple[float, float, float, float]:
    """Derivatives of latitude, longitude [rad/s], north and east way [m/s] of the ship without waves; h is the height at the start."""
    heading, _, _, _, speed, _ = course_at(t, course)
    h += climb_at(t, course)[0]
    r_m, r_n = radii_s(lat)
    north, east = speed * math.cos(heading), speed * math.sin(heading)
    return north / (r_m + h), east / ((r_n + h) * math.cos(lat)), north, east


@jit
def integrate_course(start: Array, panels: int, length: float, course: Array) -> Array:
    """Position of the ship without waves at the panel ends, by Runge-Kutta of fourth order.

    Parameters
    ----------
    start : (3,), latitude, longitude [rad], height [m]
    panels : how many
    length : of a panel, s
    course : table of `course.segments`

    Returns
    -------
    (panels + 1, 6): latitude, longitude [rad], north and east way from the start [m], then latitude and longitude gained in the panel that
    begins here (kept apart because the difference of two latitudes has lost nine digits)
    """
    path = np.zeros((panels + 1, 6))
    path[0, 0], path[0, 1] = start[0], start[1]
    h = start[2]
    lost_lat, lost_lon = 0.0, 0.0  # compensated (Kahan) sums: rounding of 400 000 equal steps all goes one way
    for p in range(panels):
        t, lat = p * length, path[p, 0]
        a = _path_rates(t, lat, h, course)
        b = _path_rates(t + 0.5 * length, lat + 0.5 * length * a[0], h, course)
        c = _path_rates(t + 0.5 * length, lat + 0.5 * length * b[0], h, course)
        d = _path_rates(t + length, lat + length * c[0], h, course)
        sixth = length / 6.0
        path[p, 4] = sixth * (a[0] + 2.0 * (b[0] + c[0]) + d[0])
        path[p, 5] = sixth * (a[1] + 2.0 * (b[1] + c[1]) + d[1])
        gain = path[p, 4] - lost_lat
        path[p + 1, 0] = lat + gain
        lost_lat = (path[p + 1, 0] - lat) - gain
        gain = path[p, 5] - lost_lon
        path[p + 1, 1] = path[p, 1] + gain
        lost_lon = (path[p + 1, 1] - path[p, 1]) - gain
        path[p + 1, 2] = path[p, 2] + sixth * (a[2] + 2.0 * (b[2] + c[2]) + d[2])
        path[p + 1, 3] = path[p, 3] + sixth * (a[3] + 2.0 * (b[3] + c[3]) + d[3])
    return path


@jit
def _radius_slopes(lat: float, r_m: float, r_n: float) -> tuple[float, float]:
    """Derivatives of R_M and R_N by latitude, m/rad."""
    s = math.sin(lat)
    x = E2 * s * math.cos(lat) / (1.0 - E2 * s * s)
    return 3.0 * r_m * x, r_n * x


@jit
def _knot(p: int, length: float, h0: float, path: Array, course: Array, waves: Array, heel: float, scratch: Array, knot: Array) -> None:
    """Coordinates at panel end p: latitude, longitude beyond `path` [rad], height [m], roll, pitch, heading [rad]; value, two derivatives."""
    t = p * length
    heading, r, r1, r2, speed, acceleration = course_at(t, course)
    gained, up, up1, up2 = climb_at(t, course)
    h = h0 + gained
    ch, sh = math.cos(heading), math.sin(heading)
    vn, ve = speed * ch, speed * sh
    an, ae = acceleration * ch - ve * r, acceleration * sh + vn * r
    place, turn, m = scratch[0], scratch[1], scratch[2:8]
    place[0], place[1], place[2], place[3], place[4], place[5] = path[p, 2], path[p, 3], vn, ve, an, ae
    turn[0], turn[1], turn[2] = heading, r, r1
    motion(t, place, turn, waves, m[:, :3])
    # surge and sway turn with the heading
    su, su1, su2, sw, sw1, sw2 = m[4, 0], m[4, 1], m[4, 2], m[5, 0], m[5, 1], m[5, 2]
    x1, y1 = su1 - r * sw, sw1 + r * su
    x2, y2 = su2 - 2.0 * r * sw1 - r1 * sw - r * r * su, sw2 + 2.0 * r * su1 + r1 * su - r * r * sw
    dn, dn1, dn2 = su * ch - sw * sh, x1 * ch - y1 * sh, x2 * ch - y2 * sh
    de, de1, de2 = su * sh + sw * ch, x1 * sh + y1 * ch, x2 * sh + y2 * ch
    # metres to radians at the place of the ship without waves; the scale changes as she moves
    lat = path[p, 0]
    r_m, r_n = radii_s(lat)
    slope_m, slope_n = _radius_slopes(lat, r_m, r_n)
    cl, sl = math.cos(lat), math.sin(lat)
    a = 1.0 / (r_m + h)
    b = 1.0 / ((r_n + h) * cl)
    lat1 = a * vn
    a1 = -a * a * slope_m * lat1 - a * a * up
    b1 = -b * b * (slope_n * cl - (r_n + h) * sl) * lat1 - b * b * cl * up
    knot[0, 0], knot[0, 1], knot[0, 2] = a * dn, a * (vn + dn1) + a1 * dn, a * (an + dn2) + a1 * (vn + 2.0 * dn1)
    knot[1, 0], knot[1, 1], knot[1, 2] = b * de, b * (ve + de1) + b1 * de, b * (ae + de2) + b1 * (ve + 2.0 * de1)
    knot[2, 0], knot[2, 1], knot[2, 2] = h + m[3, 0], up + m[3, 1], up1 + m[3, 2]
    lean = -heel * speed  # outward; r is zero while the speed changes
    knot[3, 0], knot[3, 1], knot[3, 2] = m[0, 0] + lean * r, m[0, 1] + lean * r1, m[0, 2] + lean * r2
    knot[4, 0], knot[4, 1], knot[4, 2] = m[1, 0], m[1, 1], m[1, 2]
    if up != 0.0:  # the nose is along the path: tan(pitch) = up / speed
        knot[4, 0] += math.atan(up / speed)
        knot[4, 1] += up1 / speed
        knot[4, 2] += (up2 * speed - up1 * acceleration) / (speed * speed)
    knot[5, 0], knot[5, 1], knot[5, 2] = heading + m[2, 0], r + m[2, 1], r1 + m[2, 2]


@jit
def _panel(p: int, length: float, path: Array, first: Array, second: Array, coefficients: Array) -> None:
    """Quintic Hermite polynomials in u = 0..1 between two knots; latitude and longitude relative to `path[p]`."""
    for i in range(6):
        gain = second[i, 0] - first[i, 0]
        if i < 2:
            gain += path[p, 4 + i]
        v0, v1 = first[i, 1] * length, second[i, 1] * length
        a0, a1 = first[i, 2] * length * length, second[i, 2] * length * length
        d = gain - v0 - 0.5 * a0
        e = v1 - v0 - a0
        f = a1 - a0
        coefficients[i, 0] = first[i, 0]
        coefficients[i, 1] = v0
        coefficients[i, 2] = 0.5 * a0
        coefficients[i, 3] = 10.0 * d - 4.0 * e + 0.5 * f
        coefficients[i, 4] = -15.0 * d + 7.0 * e - f
        coefficients[i, 5] = 6.0 * d - 3.0 * e + 0.5 * f


@jit
def _state(u: float, length: float, lat0: float, lon0: float, coefficients: Array, q: Array, out: Array) -> None:
    """Row of COLUMNS numbers at u of a panel: the exact kinematics of its polynomials."""
    w = 1.0 / length
    for i in range(6):
        c0, c1, c2 = coefficients[i, 0], coefficients[i, 1], coefficients[i, 2]
        c3, c4, c5 = coefficients[i, 3], coefficients[i, 4], coefficients[i, 5]
        q[i, 0] = c0 + u * (c1 + u * (c2 + u * (c3 + u * (c4 + u * c5))))
        q[i, 1] = (c1 + u * (2.0 * c2 + u * (3.0 * c3 + u * (4.0 * c4 + u * (5.0 * c5))))) * w
        q[i, 2] = (2.0 * c2 + u * (6.0 * c3 + u * (12.0 * c4 + u * (20.0 * c5)))) * (w * w)
    lat, lon, h = lat0 + q[0, 0], lon0 + q[1, 0], q[2, 0]
    lat1, lon1, h1 = q[0, 1], q[1, 1], q[2, 1]
    r_m, r_n = radii_s(lat)
    slope_m, slope_n = _radius_slopes(lat, r_m, r_n)
    cl, sl = math.cos(lat), math.sin(lat)
    m, n = r_m + h, r_n + h
    vn, ve, vd = m * lat1, n * cl * lon1, -h1
    an = (slope_m * lat1 + h1) * lat1 + m * q[0, 2]
    ae = ((slope_n * lat1 + h1) * cl - n * sl * lat1) * lon1 + n * cl * q[1, 2]
    ad = -q[2, 2]
    # rates of NED: Earth and transport; in the angles' own derivatives
    wie_n, wie_d = OMEGA_IE * cl, -OMEGA_IE * sl
    wen_n, wen_e, wen_d = lon1 * cl, -lat1, -lon1 * sl
    cn, ce, cd = 2.0 * wie_n + wen_n, wen_e, 2.0 * wie_d + wen_d
    fn = an + ce * vd - cd * ve
    fe = ae + cd * vn - cn * vd
    fd = ad + cn * ve - ce * vn - gravity_s(lat, h)
    sr, cr, sp, cp = math.sin(q[3, 0]), math.cos(q[3, 0]), math.sin(q[4, 0]), math.cos(q[4, 0])
    sh, ch = math.sin(q[5, 0]), math.cos(q[5, 0])
    c00, c01, c02 = cp * ch, sr * sp * ch - cr * sh, cr * sp * ch + sr * sh
    c10, c11, c12 = cp * sh, sr * sp * sh + cr * ch, cr * sp * sh - sr * ch
    c20, c21, c22 = -sp, sr * cp, cr * cp
    roll1, pitch1, heading1 = q[3, 1], q[4, 1], q[5, 1]
    bx = roll1 - heading1 * sp
    by = pitch1 * cr + heading1 * sr * cp
    bz = -pitch1 * sr + heading1 * cr * cp
    wn, we, wd = wie_n + wen_n, wen_e, wie_d + wen_d
    out[0], out[1], out[2], out[3], out[4], out[5] = lat, lon, h, vn, ve, vd
    out[6], out[7], out[8], out[9], out[10], out[11], out[12], out[13], out[14] = c00, c01, c02, c10, c11, c12, c20, c21, c22
    out[15], out[16], out[17] = bx, by, bz
    out[18] = bx + c00 * wn + c10 * we + c20 * wd
    out[19] = by + c01 * wn + c11 * we + c21 * wd
    out[20] = bz + c02 * wn + c12 * we + c22 * wd
    out[21] = c00 * fn + c10 * fe + c20 * fd
    out[22] = c01 * fn + c11 * fe + c21 * fd
    out[23] = c02 * fn + c12 * fe + c22 * fd


@jit
def truth_kernel(t: Array, length: float, h0: float, path: Array, course: Array, waves: Array, heel: float, out: Array) -> None:
    """Kinematics at any times.

    Parameters
    ----------
    t : (m,), s, each within the panels of `path`
    length : of a panel, s
    h0 : height at the start without waves, m
    path, course, waves, heel : tables of the trajectory
    out : (m, COLUMNS), written
    """
    first, second, coefficients = np.zeros((6, 3)), np.zeros((6, 3)), np.zeros((6, 6))
    scratch, q = np.zeros((8, 6)), np.zeros((6, 3))
    current = -1
    for i in range(t.shape[0]):
        p = min(max(math.floor(t[i] / length), 0), path.shape[0] - 2)
        if p != current:
            _knot(p, length, h0, path, course, waves, heel, scratch, first)
            _knot(p + 1, length, h0, path, course, waves, heel, scratch, second)
            _panel(p, length, path, first, second, coefficients)
            current = p
        _state((t[i] - p * length) / length, length, path[p, 0], path[p, 1], coefficients, q, out[i])


@jit
def increment_kernel(
    k0: int, per_panel: int, length: float, h0: float, path: Array, course: Array, waves: Array, heel: float, rate: Array, force: Array
) -> None:
    """Mean body rate and specific force over sample intervals, by three-point Gauss quadrature.

    Parameters
    ----------
    k0 : number of the first sample, >= 1; sample k covers (t_{k-1}, t_k]
    per_panel : samples in a panel
    length : of a panel, s
    h0 : height at the start without waves, m
    path, course, waves, heel : tables of the trajectory
    rate, force : (m, 3), written: FRD, rad/s and m/s^2

    Notes
    -----
    No panel end lies inside a sample, so the integrand is smooth; the error of the quadrature is f^(6) dt^6 / 2016000, 1e-15 m/s^2 at 100 Hz.
    """
    first, second, coefficients = np.zeros((6, 3)), np.zeros((6, 3)), np.zeros((6, 6))
    scratch, q, row = np.zeros((8, 6)), np.zeros((6, 3)), np.zeros(COLUMNS)
    current = -2
    for i in range(rate.shape[0]):
        k = k0 + i - 1
        p = k // per_panel
        if p != current:
            if p == current + 1:
                first, second = second, first
            else:
                _knot(p, length, h0, path, course, waves, heel, scratch, first)
            _knot(p + 1, length, h0, path, course, waves, heel, scratch, second)
            _panel(p, length, path, first, second, coefficients)
            current = p
        wx, wy, wz, fx, fy, fz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for g in range(3):
            u = (k - p * per_panel + _GAUSS[g]) / per_panel
            _state(u, length, path[p, 0], path[p, 1], coefficients, q, row)
            w = _WEIGHT[g]
            wx += w * row[18]
            wy += w * row[19]
            wz += w * row[20]
            fx += w * row[21]
            fy += w * row[22]
            fz += w * row[23]
        rate[i, 0], rate[i, 1], rate[i, 2] = wx, wy, wz
        force[i, 0], force[i, 1], force[i, 2] = fx, fy, fz
