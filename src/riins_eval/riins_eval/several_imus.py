"""Several IMUs of one recording, each with its own clock and mounting, brought to one clock and into one set of sensing axes.

Lives here: `Imu`, `RecordingSettings`, `to_one_clock`, and what it finds in the data: clock offsets, low-pass, noise of each sensor.
Does not live here: the file (npz_recording.py), units (units.py), the bag (importers.py), fault detection (riins_imu_fusion).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import signal
from scipy.optimize import nnls

from riins_core.settings import setting

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

FIT_HZ = 5.0
"""Clocks are compared by turns slower than this: vibration is not common to the IMUs."""
FIT_RATE_HZ = 100.0
LARGEST_OFFSET_S = 2.0
COMMON_OVER_OWN = 10.0
"""The low-pass ends where what the IMUs share is no longer this much stronger than what each has of its own."""
BANDWIDTH = 1.11
"""Of white noise that the low-pass lets through, over its cut-off."""
SAMPLES_A_CYCLE = 8.0
"""Samples kept in a period of the low-pass: more would only say the same again."""
STUCK = 10
"""Equal values in a row of a sensor that sticks: they pass the low-pass as they are, so that the fusion sees it."""
NOISE_WINDOW_S = 10.0
HOLE = 5.0
"""A sensor without a sample for so many of its intervals is not valid meanwhile."""


@dataclasses.dataclass(frozen=True)
class RecordingSettings:
    """How a recording of several IMUs is prepared; section `recording` of the options of an import."""

    check_units: bool = setting(True, "refuse values that look like g or deg/s")
    lowpass_hz: float = setting(-1.0, "causal low-pass of second order; 0: none, -1: from the data", "Hz", -1.0, 1e4)
    rate_hz: int = setting(0, "samples a second in the bag; 0: eight in a period of the low-pass", "Hz", 0, 100_000)
    fit_clocks: bool = setting(True, "find the offsets of the IMUs' clocks from their turns")
    gyro_turn_on_deg_s: float = setting(0.3, "ordinary turn-on bias of a gyro, which must not alarm", "deg/s", 0.0, 100.0)
    accel_turn_on_mps2: float = setting(0.3, "ordinary turn-on bias of an accelerometer, which must not alarm", "m/s^2", 0.0, 10.0)


@dataclasses.dataclass(frozen=True)
class Imu:
    """One IMU as recorded: t (m,) s, gyro and accel (m, 3) in its own axes, `turn` (3, 3) from its axes into the body's."""

    t: Floats
    gyro: Floats
    accel: Floats
    turn: Floats


@dataclasses.dataclass(frozen=True)
class Stacked:
    """All sensors on one clock.

    Attributes
    ----------
    rate_hz : samples a second
    axes : (n, 3), sensing axes in the body, FRD
    pieces : of each piece (t (m,), gyro (m, n), accel (m, n), valid (m, n))
    offsets : (k,), s, to be added to each IMU's clock
    lowpass_hz, delay_s : 0: none; the delay has been taken off the stamps
    gyro_sigma, accel_sigma : (n,), noise of a sample, without its mean: what is left of motion and vibration is in it
    """

    rate_hz: int
    axes: Floats
    pieces: list[tuple[Floats, Floats, Floats, Bools]]
    offsets: Floats
    lowpass_hz: float
    delay_s: float
    gyro_sigma: Floats
    accel_sigma: Floats


def to_one_clock(pieces: Sequence[Sequence[Imu]], settings: RecordingSettings) -> Stacked:
    """Bring the sensors of several IMUs to the clock of the first one.

    Parameters
    ----------
    pieces : of each piece the IMUs, the same ones in the same order, clocks as recorded
    settings : what is not said in them is found in the data

    Returns
    -------
    Stacked

    Raises
    ------
    ValueError
        The IMUs do not overlap in time.

    Notes
    -----
    Each IMU is filtered on its own clock, then interpolated: linear interpolation of what is slow loses nothing. The stamp of a filtered
    sample is its time less the filter's delay at low frequency, so that it is the time of what was measured.
    """
    turns = [imu.turn for imu in pieces[0]]
    axes = np.concatenate([turn.T for turn in turns])
    longest = max(pieces, key=lambda p: len(p[0].t))
    offsets = clock_offsets(longest) if settings.fit_clocks else np.zeros(len(turns))
    own_rate = min(1.0 / float(np.median(np.diff(imu.t))) for imu in longest)
    cut = settings.lowpass_hz if settings.lowpass_hz >= 0.0 else cutoff(longest, offsets, own_rate)
    cut = cut if cut < 0.45 * own_rate else 0.0
    rate = settings.rate_hz or (_divisor(round(own_rate), SAMPLES_A_CYCLE * cut) if cut else round(own_rate))
    delay = float(np.sqrt(2.0) / (2.0 * np.pi * cut)) if cut else 0.0
    made = [_stack(piece, offsets, cut, delay, rate) for piece in pieces]
    window = round(NOISE_WINDOW_S * rate)
    sigma = noise([gyro for _, gyro, _, _ in made], axes, window), noise([accel for _, _, accel, _ in made], axes, window)
    return Stacked(rate, axes, made, offsets, cut, delay, *sigma)


def lowpass(values: Floats, cut_hz: float, rate_hz: float) -> Floats:
    """Causal Butterworth low-pass of second order along the first axis, begun at rest at the mean of the first quarter period."""
    sections = signal.butter(2, cut_hz, fs=rate_hz, output="sos")
    start = values[: max(1, round(0.25 * rate_hz / cut_hz))].mean(axis=0)
    state = signal.sosfilt_zi(sections)[:, :, None] * start
    return np.asarray(signal.sosfilt(sections, values, axis=0, zi=state)[0])


def clock_offsets(imus: Sequence[Imu]) -> Floats:
    """What must be added to each IMU's clock so that all turn together, (k,) s, the first is 0.

    A coarse offset from the correlation of the lengths of the rates, then w_i(t) = w_0(t) + tau dw_0/dt + bias by least squares. Where the offset is
    below five times its sigma, or the IMUs hardly turn alike, the clock is taken as it is.
    """
    rates = [imu.gyro @ imu.turn.T for imu in imus]
    begin, end = max(i.t[0] for i in imus), min(i.t[-1] for i in imus)
    offsets = np.zeros(len(imus))
    if end - begin < 2.0 * LARGEST_OFFSET_S:
        return offsets
    grid = np.arange(begin, end, 1.0 / FIT_RATE_HZ)
    sections = signal.butter(2, FIT_HZ, fs=FIT_RATE_HZ, output="sos")

    def slow(k: int, shift: float) -> Floats:
        raw = np.column_stack([np.interp(grid - shift, imus[k].t, column) for column in rates[k].T])
        return np.asarray(signal.sosfiltfilt(sections, raw, axis=0))

    reference = slow(0, 0.0)
    slope = np.gradient(reference, 1.0 / FIT_RATE_HZ, axis=0)
    length = np.linalg.norm(reference, axis=1)
    length = length - length.mean()
    for k in range(1, len(imus)):
        own = np.linalg.norm(slow(k, 0.0), axis=1)
        product = signal.correlate(length, own - own.mean(), "same")
        product /= max(float(np.linalg.norm(length) * np.linalg.norm(own - own.mean())), 1e-300)
        middle, reach = len(grid) // 2, round(LARGEST_OFFSET_S * FIT_RATE_HZ)
        best = int(np.argmax(product[middle - reach : middle + reach + 1])) - reach
        if product[middle + best] < 0.8:
            continue
        tau = best / FIT_RATE_HZ
        for _ in range(2):
            missed = slow(k, tau) - reference
            missed -= missed.mean(axis=0)
            rest = slope - slope.mean(axis=0)
            energy = float(np.sum(rest * rest))
            step = float(np.sum(rest * missed)) / energy
            tau += step
        left = missed - step * rest
        # what is left is as slow as the low-pass: so many samples are independent
        sigma = float(np.sqrt(np.mean(left**2) / energy * 0.5 * FIT_RATE_HZ / FIT_HZ))
        if abs(tau) > 5.0 * sigma:
            offsets[k] = tau
    return offsets


def cutoff(imus: Sequence[Imu], offsets: Floats, rate_hz: float) -> float:
    """Frequency above which the IMUs share no motion: there a sensor's own noise is a tenth of what all have in common. 0: nowhere, no low-pass.

    Parameters
    ----------
    imus, offsets : as in `to_one_clock`
    rate_hz : of the slowest one
    """
    n = 3 * len(imus)
    axes = np.concatenate([imu.turn.T for imu in imus])
    inverse = np.linalg.pinv(axes)
    begin = max(i.t[0] + o for i, o in zip(imus, offsets, strict=True))
    end = min(i.t[-1] + o for i, o in zip(imus, offsets, strict=True))
    grid = np.arange(begin, end, 1.0 / rate_hz)
    edges = np.geomspace(max(0.2, 4.0 / max(end - begin, 1.0)), 0.5 * rate_hz, 25)
    found = []
    for which in ("gyro", "accel"):
        z = np.column_stack([np.interp(grid - o, i.t, c) for i, o in zip(imus, offsets, strict=True) for c in getattr(i, which).T])
        common = z @ inverse.T
        own = z - common @ axes.T
        # medians over the pieces of time: a sensor that fails under way must not set the low-pass
        length = max(16, min(2048, len(grid) // 8))
        frequency, power = signal.welch(common, rate_hz, nperseg=length, axis=0, average="median")
        _, rest = signal.welch(own, rate_hz, nperseg=length, axis=0, average="median")
        band = np.digitize(frequency, edges)
        inside = [band == b for b in range(1, len(edges))]
        shared = np.array([power[rows].sum() / 3.0 for rows in inside])
        alone = np.array([rest[rows].sum() / (n - 3.0) for rows in inside])
        weak = (shared < COMMON_OVER_OWN * alone) & (np.array([rows.sum() for rows in inside]) > 0)
        # a still vehicle shares no motion at all, and there is nothing to be taken from it
        if weak.any() and not weak[0]:
            found.append(float(edges[int(np.argmax(weak))]))
    return min(found, default=0.0)


def noise(pieces: Sequence[Floats], axes: Floats, window: int) -> Floats:
    """Standard deviation of each sensor about its own bias, (n,), from how the sensors contradict each other.

    Parameters
    ----------
    pieces : (m, n) measurements of each piece
    axes : (n, 3)
    window : samples over which a variance is taken; of all windows it is the upper quartile, so that neither the calm nor a fault decides

    Returns
    -------
    (n,). The residuals r = Q z, Q = I - H H^+, have variances (Q o Q) sigma^2: non-negative least squares, not below a third of the median
    """
    n = len(axes)
    Q = np.eye(n) - axes @ np.linalg.pinv(axes)
    windows = [np.array_split(part @ Q, max(1, len(part) // max(window, 2))) for part in pieces]
    variance = np.maximum(np.quantile([np.var(w, axis=0) for part in windows for w in part], 0.75, axis=0), 1e-30)
    squares = Q * Q
    scale = float(np.mean(variance))
    ridge = 1e-3  # two sensors that check only each other share what they disagree in
    solved = nnls(np.vstack([squares, ridge * np.eye(n)]), np.concatenate([variance / scale, ridge * variance / scale / np.diag(Q)]))[0]
    sigma = np.sqrt(solved * scale)
    return np.asarray(np.maximum(sigma, np.median(sigma[sigma > 0.0]) / 3.0))


def _divisor(rate_hz: int, least: float) -> int:
    """The smallest whole number of samples a second that divides the rate and is not below `least`."""
    return min(d for d in range(1, rate_hz + 1) if rate_hz % d == 0 and (d >= least or d == rate_hz))


def _stuck(values: Floats) -> Bools:
    """(m, 3), the value is at least the STUCKth equal one in a row."""
    run = np.zeros(values.shape, dtype=np.int64)
    same = np.diff(values, axis=0) == 0.0
    number = np.arange(1, len(values))[:, None]
    run[1:] = number - np.maximum.accumulate(np.where(same, 0, number), axis=0)
    return np.asarray(run >= STUCK - 1)


def _stack(imus: Sequence[Imu], offsets: Floats, cut: float, delay: float, rate: int) -> tuple[Floats, Floats, Floats, Bools]:
    settle = 1.0 / cut if cut else 0.0
    begin = max(i.t[0] + o for i, o in zip(imus, offsets, strict=True)) + settle
    end = min(i.t[-1] + o for i, o in zip(imus, offsets, strict=True))
    if end - begin < 2.0 / rate:
        raise ValueError("the IMUs have no time in common")
    clock = begin + np.arange(int((end - begin) * rate)) / rate
    gyro: list[Floats] = []
    accel: list[Floats] = []
    valid: list[Bools] = []
    for imu, offset in zip(imus, offsets, strict=True):
        interval = float(np.median(np.diff(imu.t)))
        for values, into in ((imu.gyro, gyro), (imu.accel, accel)):
            smooth = np.where(_stuck(values), values, lowpass(values, cut, 1.0 / interval)) if cut else values
            into.append(np.column_stack([np.interp(clock - offset, imu.t, column) for column in smooth.T]))
        right = np.clip(np.searchsorted(imu.t, clock - offset), 1, len(imu.t) - 1)
        valid.append(np.repeat((imu.t[right] - imu.t[right - 1] <= HOLE * interval)[:, None], 3, axis=1))
    return clock - delay, np.column_stack(gyro), np.column_stack(accel), np.column_stack(valid)
