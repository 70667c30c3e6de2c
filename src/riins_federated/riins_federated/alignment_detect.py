"""At rest, swaying at one place, or under way: what an alignment takes for granted, tested.

Lives here: `Motion`, `detect`. The statistics and their thresholds are in its docstring.
Does not live here: which method follows from it (aligner.py).
"""

from __future__ import annotations

import math
from enum import IntEnum

import numpy as np
from scipy.stats import chi2

from riins_core.alignment.stationary import ImuNoise
from riins_core.alignment.stored import Aids

from .alignment_aids import Fixes
from .alignment_settings import AlignmentSettings
from .alignment_store import Window
from .types import Array


class Motion(IntEnum):
    """What the ship does."""

    REST = 0
    SWAYING = 1
    UNDER_WAY = 2


def detect(window: Window, imu: ImuNoise, fixes: Fixes | None, speeds: Aids | None, settings: AlignmentSettings) -> tuple[Motion, str]:
    """The strongest motion in any stretch of a window.

    Parameters
    ----------
    window : IMU data
    imu : noise of an axis
    fixes, speeds : positions and velocities within the window, None: there are none
    settings : length of a stretch, false-alarm probability, swing of a moored ship

    Returns
    -------
    Motion, one line why

    Notes
    -----
    At rest the 1 s means of rate and of force scatter within a stretch by the sensors' noise: their sum of squares over the variance is chi-square
    with 3 (m - 1) degrees of freedom. About one place the horizontal mean velocity of a stretch of T s has the variance
    sigma^2 / n + 2 swing^2 / T^2, and the difference of the mean places of two stretches 2 (sigma^2 / n + slow^2 + swing^2); over it, the square of
    either is chi-square with two degrees of freedom. A stretch with motion is one beyond the quantile of the false-alarm probability.
    """
    p = settings.false_alarm_probability
    speed = _speed(window, speeds, settings, p)
    if speed:
        return Motion.UNDER_WAY, speed
    way = _way(fixes, settings, p)
    if way:
        return Motion.UNDER_WAY, way
    per = max(1, round(1.0 / window.dt))
    stretch = max(2, round(settings.detect_s))
    for values, density, what in ((window.rate, imu.arw, "rate"), (window.force, imu.vrw, "force")):
        m = len(values) // per
        means = values[: m * per].reshape(m, per, 3).mean(axis=1)
        for first in range(0, max(m - 1, 0), stretch):
            part = means[first : first + stretch]
            if len(part) < 2:
                continue
            statistic = float(np.sum((part - part.mean(axis=0)) ** 2)) * per * window.dt / density**2
            if statistic > chi2.isf(p, 3 * (len(part) - 1)):
                times = math.sqrt(statistic / (3 * (len(part) - 1)))
                return Motion.SWAYING, f"the {what} varies {times:.1f} times as much from second to second as the sensors' noise"
    return Motion.REST, "rate and force vary by the sensors' noise alone"


def _speed(window: Window, speeds: Aids | None, settings: AlignmentSettings, p: float) -> str:
    if speeds is None:
        return ""
    stretch, limit = settings.detect_s, chi2.isf(p, 2)
    number = (speeds.index * window.dt // stretch).astype(int)
    for k in np.unique(number):
        part = speeds.value[number == k, :2]
        mean = part.mean(axis=0)
        variance = float(np.max(speeds.sigma[:2])) ** 2 / len(part) + 2.0 * (settings.swing_m / stretch) ** 2
        if len(part) >= 3 and float(mean @ mean) / variance > limit:
            source = "log" if speeds.kind == "log" else "GNSS velocity"
            return f"the {source} says {float(np.linalg.norm(mean)):.1f} m/s"
    return ""


def _way(fixes: Fixes | None, settings: AlignmentSettings, p: float) -> str:
    if fixes is None or len(fixes.stamp_ns) < 6:
        return ""
    ned: Array = fixes.offset(fixes.place[0])[:, :2]
    number = ((fixes.stamp_ns - fixes.stamp_ns[0]) * 1e-9 // settings.detect_s).astype(int)
    base = fixes.slow.max() ** 2 + settings.swing_m**2 + float(np.max(np.sum(fixes.lever**2, axis=1))) * math.radians(2.0) ** 2
    means = [(ned[number == k].mean(axis=0), float(fixes.variance[number == k, :2].max()) / int(np.sum(number == k))) for k in np.unique(number)]
    for mean, variance in means[1:]:
        d = mean - means[0][0]
        if float(d @ d) / (variance + means[0][1] + 2.0 * base) > chi2.isf(p, 2):
            return f"the fixes have moved by {float(np.linalg.norm(d)):.0f} m"
    return ""
