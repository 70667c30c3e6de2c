"""Reference motion for the strapdown tests: position and Euler angles as sums of sinusoids, exact kinematics, IMU means by quadrature.

Lives here: an independent derivation of rates and specific force from closed forms. Does not live here: the simulator's trajectory (riins_sim).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from riins_core import earth
from riins_core.rotation import dcm_from_euler, rotate

NODES, WEIGHTS = np.polynomial.legendre.leggauss(4)


@dataclass(frozen=True)
class Wave:
    """offset + slope t + sum a sin(w t + p), with two derivatives."""

    offset: float = 0.0
    slope: float = 0.0
    a: tuple[float, ...] = ()
    w: tuple[float, ...] = ()
    p: tuple[float, ...] = ()

    def __call__(self, t):
        a, w, p = (np.array(x)[:, None] for x in (self.a, self.w, self.p))
        s, c = np.sin(w * t + p), np.cos(w * t + p)
        value = self.offset + self.slope * t + (a * s).sum(0)
        return value, self.slope + (a * w * c).sum(0), -(a * w * w * s).sum(0)


@dataclass(frozen=True)
class Motion:
    lat: Wave
    lon: Wave
    h: Wave
    roll: Wave
    pitch: Wave
    heading: Wave

    def state(self, t):
        """nav rows (m, 15) and kinematics (w_ib^b, f^b), each (m, 3)."""
        t = np.atleast_1d(np.asarray(t, dtype=float))
        (lat, lat1, lat2), (lon, lon1, lon2), (h, h1, h2) = self.lat(t), self.lon(t), self.h(t)
        s, c = np.sin(lat), np.cos(lat)
        r_m, r_n = earth.radii(lat)
        w2 = 1 - earth.E2 * s * s
        r_m_dot = 3 * earth.E2 * s * c / w2 * r_m * lat1
        r_n_dot = earth.E2 * s * c / w2 * r_n * lat1
        v = np.stack([(r_m + h) * lat1, (r_n + h) * c * lon1, -h1], -1)
        vdot = np.stack(
            [(r_m_dot + h1) * lat1 + (r_m + h) * lat2, ((r_n_dot + h1) * c - (r_n + h) * s * lat1) * lon1 + (r_n + h) * c * lon2, -h2], -1
        )
        (roll, roll1, _), (pitch, pitch1, _), (heading, heading1, _) = self.roll(t), self.pitch(t), self.heading(t)
        c_nb = dcm_from_euler(roll, pitch, heading)
        w_nb = np.stack(
            [
                roll1 - heading1 * np.sin(pitch),
                pitch1 * np.cos(roll) + heading1 * np.cos(pitch) * np.sin(roll),
                -pitch1 * np.sin(roll) + heading1 * np.cos(pitch) * np.cos(roll),
            ],
            -1,
        )
        w_ie = earth.earth_rate_n(lat)
        w_en = earth.transport_rate_n(lat, h, v)
        c_bn = np.swapaxes(c_nb, -1, -2)
        rate = w_nb + rotate(c_bn, w_ie + w_en)
        g = np.zeros_like(v)
        g[:, 2] = earth.gravity(lat, h)
        force = rotate(c_bn, vdot + np.cross(2 * w_ie + w_en, v) - g)
        nav = np.concatenate([np.stack([lat, lon, h], -1), v, c_nb.reshape(-1, 9)], axis=1)
        return nav, rate, force

    def means(self, k0, m, dt):
        """Mean rate and specific force over (t_{k-1}, t_k], k = k0 .. k0 + m - 1, (m, 3) each."""
        rate, force = np.zeros((m, 3)), np.zeros((m, 3))
        middle = (np.arange(k0, k0 + m) - 0.5) * dt
        for node, weight in zip(NODES, WEIGHTS, strict=True):
            _, w, f = self.state(middle + 0.5 * dt * node)
            rate += 0.5 * weight * w
            force += 0.5 * weight * f
        return rate, force


def ship_in_waves(seed=0, lat=0.6, speed=7.0, course=0.7):
    """A ship under way in a heavy sea: about 5 deg roll, 2 deg pitch, 1.3 m heave."""
    rng = np.random.default_rng(seed)

    def waves(rms, n=6):
        a = rng.uniform(0.5, 1.0, n)
        a *= rms * np.sqrt(2.0 / np.sum(a * a))
        return tuple(a), tuple(rng.uniform(0.4, 1.1, n)), tuple(rng.uniform(0, 2 * np.pi, n))

    radius = 6.38e6
    return Motion(
        Wave(lat, speed * np.cos(course) / radius, *waves(0.8 / radius)),
        Wave(2.0, speed * np.sin(course) / radius / np.cos(lat), *waves(0.8 / radius)),
        Wave(12.0, 0.0, *waves(1.3)),
        Wave(0.0, 0.0, *waves(np.deg2rad(5.0))),
        Wave(0.01, 0.0, *waves(np.deg2rad(2.0))),
        Wave(course, 0.0, *waves(np.deg2rad(1.5))),
    )


def coning(amplitude, frequency):
    """A moored hull whose mast describes a cone: roll and pitch of `amplitude` [rad] in quadrature at `frequency` [Hz]."""
    w = 2 * np.pi * frequency
    still = Wave(0.9), Wave(-1.0), Wave(0.0)
    return Motion(
        *(Wave(x.offset, 0.0, (0.0,), (1.0,), (0.0,)) for x in still),
        Wave(0.0, 0.0, (amplitude,), (w,), (0.0,)),
        Wave(0.0, 0.0, (amplitude,), (w,), (0.5 * np.pi,)),
        Wave(1.0, 0.0, (0.0,), (1.0,), (0.0,)),
    )
