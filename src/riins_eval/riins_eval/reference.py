"""The motion of a recording: its IMU, and its reference brought from its own epochs to any time with the help of that IMU.

Lives here: `RecordedMotion`, which answers like riins_sim's `Trajectory`, so that simulated sensors can ride on a recording; `fit_reference_lever`.
Does not live here: files (importers.py), sensor errors and faults (riins_sim).
"""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import ArrayLike, NDArray

from riins_core.earth import earth_rate_n, radii, transport_rate_n
from riins_core.frames import ned_difference, ned_offset
from riins_core.jit import jit
from riins_core.rotation import dcm_from_euler, exp_so3, log_so3, skew
from riins_core.strapdown import NAV_SIZE, SUMS_SIZE, strapdown_block
from riins_sim.trajectory import Truth

Floats = NDArray[np.float64]

LONGEST_BRIDGE_S = 30.0
"""Between reference epochs further apart than this the reference is not known."""
REFERENCE_COLUMNS = ("t", "lat", "lon", "h", "vn", "ve", "vd", "roll", "pitch", "yaw")


@jit
def _walk(nav: Floats, rate: Floats, force: Floats, dt: Floats, out: Floats) -> None:
    """Mechanize sample by sample and keep every state, (m, 16)."""
    dtheta, dv, zero, sums = np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(SUMS_SIZE)
    for i in range(rate.shape[0]):
        strapdown_block(nav, dtheta, dv, rate[i : i + 1], force[i : i + 1], dt[i : i + 1], zero, zero, sums)
        out[i] = nav


class RecordedMotion:
    """One piece of a recording.

    Parameters
    ----------
    t : (m,), s, ends of the averaging intervals, strictly increasing, any origin; sample 0 is the origin of time here
    rate, force : (m, 3), mean body rate [rad/s] and specific force [m/s^2] over the interval before t, FRD
    reference : (r, 10), REFERENCE_COLUMNS, same clock as t; rows with a NaN do not count
    dt : s, nominal interval

    Attributes
    ----------
    dt : s
    samples : int, number of the last sample, >= 1
    duration : s, time of the last sample
    origin : s, time of sample 0 in the recording's clock
    number : (m,) int64, sample numbers: evenly spaced, a hole is a loss
    known : (first, last) s since the origin within which the reference is known; (0, -1) when nowhere

    Notes
    -----
    Between two epochs of the reference the IMU is mechanized from the first to the second; the difference found there (attitude as a rotation
    vector, velocity and position in n) is given back in proportion to the time. The result passes through every epoch and moves between them
    as the IMU felt it: with epochs 1 s apart and waves of 5 s a spline would be off by centimetres per second.
    """

    def __init__(self, t: Floats, rate: Floats, force: Floats, reference: Floats, dt: float) -> None:
        self.dt = dt
        self.origin = float(t[0])
        steps = np.maximum(1, np.round(np.diff(t) / dt)).astype(np.int64)
        self.number = np.concatenate([[0], np.cumsum(steps)])
        self.samples = int(self.number[-1])
        grid = np.arange(self.samples + 1)
        self._t = np.interp(grid, self.number, t - self.origin)
        self._rate = np.stack([np.interp(grid, self.number, rate[:, i]) for i in range(3)], axis=1)
        self._force = np.stack([np.interp(grid, self.number, force[:, i]) for i in range(3)], axis=1)
        self.duration = float(self._t[-1])
        complete = reference[np.isfinite(reference).all(axis=1)].copy()
        complete[:, 0] -= self.origin
        self._state = np.full((self.samples + 1, NAV_SIZE), np.nan)
        self._densify(complete)
        found = np.flatnonzero(np.isfinite(self._state[:, 0]))
        self.known = (float(self._t[found[0]]), float(self._t[found[-1]])) if len(found) else (0.0, -1.0)

    def times(self, k: ArrayLike) -> Floats:
        """Times of samples k since the origin, s, as recorded."""
        return np.asarray(self._t[np.asarray(k)])

    def increments(self, k0: int, m: int) -> tuple[Floats, Floats]:
        """Mean body rate and specific force of samples k0 .. k0 + m - 1, (m, 3) each; lost samples are interpolated."""
        return self._rate[k0 : k0 + m].copy(), self._force[k0 : k0 + m].copy()

    def truth(self, t: ArrayLike) -> Truth:
        """Reference at any times since the origin; NaN where it is not known.

        Parameters
        ----------
        t : (m,), s

        Returns
        -------
        Truth
        """
        t = np.atleast_1d(np.asarray(t, dtype=np.float64))
        right = np.clip(np.searchsorted(self._t, t - 1e-9), 1, self.samples)
        left = right - 1
        share = np.clip((t - self._t[left]) / (self._t[right] - self._t[left]), 0.0, 1.0)
        outside = (t < self._t[0] - 1e-9) | (t > self._t[-1] + 1e-9)
        a, b = self._state[left], self._state[right]
        # a neighbour that is not known must not spoil a sample that is met exactly
        a, b = np.where((share == 1.0)[:, None], b, a), np.where((share == 0.0)[:, None], a, b)
        nav = a + share[:, None] * (b - a)
        c_a, c_b = a[:, 6:15].reshape(-1, 3, 3), b[:, 6:15].reshape(-1, 3, 3)
        turn = np.zeros((len(t), 3))
        good = np.isfinite(nav[:, 0]) & ~outside
        turn[good] = log_so3(np.swapaxes(c_a[good], 1, 2) @ c_b[good])
        c_nb = c_a @ exp_so3(share[:, None] * turn)
        nav[~good] = np.nan
        c_nb[~good] = np.nan
        rate = self._rate[left] + share[:, None] * (self._rate[right] - self._rate[left])
        force = self._force[left] + share[:, None] * (self._force[right] - self._force[left])
        w_in = earth_rate_n(nav[:, 0]) + transport_rate_n(nav[:, 0], nav[:, 2], nav[:, 3:6])
        rate_nb = rate - np.einsum("kij,ki->kj", c_nb, w_in)
        return Truth(t, nav[:, 0], nav[:, 1], nav[:, 2], nav[:, 3:6], c_nb, rate_nb, rate, force)

    def _densify(self, reference: Floats) -> None:
        for first, second in itertools.pairwise(reference):
            if 0.0 < second[0] - first[0] <= LONGEST_BRIDGE_S:
                self._bridge(first, second)

    def _between(self, first: Floats, second: Floats) -> tuple[int, int, Floats, Floats] | None:
        """Mechanize from one epoch of the reference to the next.

        Returns
        -------
        first sample after the first epoch, first sample after the second, stamps (m,) and states (m, 16) at the samples between and at the second
        epoch; None where the IMU does not cover the whole interval
        """
        t0, t1 = float(first[0]), float(second[0])
        k0 = int(np.searchsorted(self._t, t0, side="right"))
        k1 = int(np.searchsorted(self._t, t1, side="right"))
        if t0 < self._t[0] - self.dt - 1e-9 or k1 > self.samples:
            return None
        # samples k0 .. k1 cover it; the first and the last only in part
        stamps = np.concatenate([self._t[k0:k1], [t1]])
        dt = np.diff(stamps, prepend=t0)
        used = dt > 0.0
        out = np.empty((int(used.sum()), NAV_SIZE))
        _walk(_nav(first), self._rate[k0 : k1 + 1][used], self._force[k0 : k1 + 1][used], dt[used], out)
        return k0, k1, stamps[used], out

    def _bridge(self, first: Floats, second: Floats) -> None:
        """Fill the samples with stamps in [t_first, t_second]."""
        k = int(np.searchsorted(self._t, first[0]))
        if k <= self.samples and self._t[k] == first[0]:
            self._state[k] = _nav(first)
        found = self._between(first, second)
        if found is None:
            return
        k0, k1, stamps, out = found
        end = _nav(second)
        share = ((stamps - first[0]) / (second[0] - first[0]))[:, None]
        missed = ned_difference(end[0], end[1], end[2], out[-1, 0], out[-1, 1], out[-1, 2])
        r_m, r_n = radii(end[0])
        out[:, 0] += share[:, 0] * missed[0] / (r_m + end[2])
        out[:, 1] += share[:, 0] * missed[1] / ((r_n + end[2]) * np.cos(end[0]))
        out[:, 2] -= share[:, 0] * missed[2]
        out[:, 3:6] += share * (end[3:6] - out[-1, 3:6])
        turn = log_so3(end[6:15].reshape(3, 3) @ out[-1, 6:15].reshape(3, 3).T)
        out[:, 6:15] = (exp_so3(share * turn) @ out[:, 6:15].reshape(-1, 3, 3)).reshape(-1, 9)
        self._state[k0:k1] = out[: k1 - k0]

    def rate_nb(self, rows: Floats) -> Floats:
        """Body rate relative to n at rows (r, 10) of the reference, times since the origin: (r, 3), rad/s, FRD, mean over five samples."""
        k = np.clip(np.searchsorted(self._t, rows[:, 0]), 2, self.samples - 2)
        rate = np.mean([self._rate[k + i] for i in range(-2, 3)], axis=0)
        w_in = earth_rate_n(rows[:, 1]) + transport_rate_n(rows[:, 1], rows[:, 3], rows[:, 4:7])
        return np.asarray(rate - np.einsum("kij,ki->kj", dcm_from_euler(*rows[:, 7:10].T), w_in))


def reference_at_imu(motion: RecordedMotion, reference: Floats, lever: Floats) -> Floats:
    """A reference that holds at a point of the body, moved to the IMU.

    Parameters
    ----------
    motion : the IMU of the piece
    reference : (r, 10), REFERENCE_COLUMNS, clock of the recording
    lever : (3,), of the point from the IMU, FRD, m

    Returns
    -------
    (r, 10)
    """
    moved = reference.copy()
    good = np.flatnonzero(np.isfinite(reference).all(axis=1))
    rows = reference[good] - np.r_[motion.origin, np.zeros(9)]
    c_nb = dcm_from_euler(*rows[:, 7:10].T)
    lat, lon, h = ned_offset(rows[:, 1], rows[:, 2], rows[:, 3], -(c_nb @ lever))
    moved[good, 1], moved[good, 2], moved[good, 3] = lat, lon, h
    moved[good, 4:7] -= np.einsum("kij,kj->ki", c_nb, np.cross(motion.rate_nb(rows), lever))
    return moved


def fit_reference_lever(pieces: list[tuple[RecordedMotion, Floats]]) -> tuple[Floats, Floats, float, float]:
    """Where the point of the reference lies, seen from the IMU.

    Parameters
    ----------
    pieces : motion (of any reference) and reference (r, 10) in the recording's clock

    Returns
    -------
    lever, sigma : (3,), FRD, m; rms of the closures in velocity before and after, m/s. All zeros where nothing can be said

    Notes
    -----
    Mechanized from one epoch to the next the IMU misses the reference's velocity by the change of C_nb (w x l): linear in the lever arm l, which
    every turn shows. Least squares over all intervals of at most 2 s.
    """
    matrices: list[Floats] = []
    misses: list[Floats] = []
    for motion, reference in pieces:
        rows = reference[np.isfinite(reference).all(axis=1)] - np.r_[motion.origin, np.zeros(9)]
        if len(rows) < 2:
            continue
        turns = dcm_from_euler(*rows[:, 7:10].T) @ skew(motion.rate_nb(rows))
        for i, (first, second) in enumerate(itertools.pairwise(rows)):
            found = motion._between(first, second) if 0.0 < second[0] - first[0] <= 2.0 else None
            if found is not None:
                matrices.append(turns[i + 1] - turns[i])
                misses.append(second[4:7] - found[3][-1, 3:6])
    if len(misses) < 10:
        return np.zeros(3), np.zeros(3), 0.0, 0.0
    A, z = np.concatenate(matrices), np.concatenate(misses)
    normal = A.T @ A
    if np.linalg.cond(normal) > 1e8:
        return np.zeros(3), np.zeros(3), 0.0, 0.0
    lever = np.linalg.solve(normal, A.T @ z)
    rest = z - A @ lever
    sigma = np.asarray(np.sqrt(np.mean(rest**2) * np.diag(np.linalg.inv(normal))), dtype=np.float64)
    return np.asarray(lever, dtype=np.float64), sigma, float(np.sqrt(np.mean(z**2))), float(np.sqrt(np.mean(rest**2)))


def _nav(row: Floats) -> Floats:
    nav = np.zeros(NAV_SIZE)
    nav[:6] = row[1:7]
    nav[6:15] = dcm_from_euler(row[7], row[8], row[9]).reshape(9)
    return nav
