"""Faults put on sensors: steps, ramps, stuck values, noise, scale errors and dropouts, as a function of stamp and value alone.

Lives here: `FaultSettings` (as a scenario writes it), `Fault` (SI), `FaultSchedule`, for simulated sensors, imported recordings and services.
Does not live here: the sensors (sensors.py), what finds the faults.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from riins_core.noise import normal
from riins_core.sensor_errors import ARCMIN, ARCSEC, DEG, DEG_PER_H, KNOT, MICRO_G, PPM
from riins_core.settings import SettingError, nearest, setting

Array = NDArray[np.float64]

AIDS = ("gps", "bds", "doppler", "odometer", "altimeter", "star_tracker")
POSITION_AXES = ("north", "east", "down")
VELOCITY_AXES = ("forward", "starboard", "down")

_KINDS = dict(zip(AIDS, ("position", "position", "velocity", "speed", "height", "attitude"), strict=True))
_AXES = {  # of the values, by kind
    "position": POSITION_AXES,
    "velocity": VELOCITY_AXES,
    "speed": ("forward",),
    "height": ("up",),
    "attitude": ("roll", "pitch", "heading"),
}
_ALL = {"position": 2, "velocity": 2, "speed": 1, "height": 1, "attitude": 3}
"""How many of them, from the first, "all" means for a fault that changes a value."""
_SIZES: dict[str, dict[str, float]] = {  # SI of one unit, by kind of sensor
    "gyro": {"size_deg_h": DEG_PER_H, "size_deg_s": DEG, "size_rad_s": 1.0},
    "accel": {"size_ug": MICRO_G, "size_mg": 1e3 * MICRO_G, "size_mps2": 1.0},
    "position": {"size_m": 1.0, "size_arcmin": ARCMIN},
    "velocity": {"size_kn": KNOT, "size_mps": 1.0},
    "speed": {"size_kn": KNOT, "size_mps": 1.0},
    "height": {"size_m": 1.0},
    "attitude": {"size_arcsec": ARCSEC, "size_arcmin": ARCMIN, "size_deg": DEG},
}
_SLOPES: dict[str, dict[str, float]] = {
    "gyro": {"slope_deg_h_s": DEG_PER_H, "slope_rad_s2": 1.0},
    "accel": {"slope_ug_s": MICRO_G, "slope_mps3": 1.0},
    "position": {"slope_mps": 1.0},
    "velocity": {"slope_kn_s": KNOT, "slope_mps2": 1.0},
    "speed": {"slope_kn_s": KNOT, "slope_mps2": 1.0},
    "height": {"slope_mps": 1.0},
    "attitude": {"slope_arcsec_s": ARCSEC, "slope_deg_s": DEG},
}
_SCALES = {"size_percent": 0.01, "size_ppm": PPM}


class FaultType(IntEnum):
    """What a fault does; the values of riins_msgs/Fault."""

    STEP = 0
    RAMP = 1
    STUCK = 2
    NOISE = 3
    SCALE = 4
    DROPOUT = 5


class Sample(NamedTuple):
    """One row of a sensor: stamp [ns since the start], number, values, and for positions `per_metre` of `FaultSchedule.apply_aid`."""

    stamp_ns: int
    k: int
    values: Array
    per_metre: Array | None = None


Before = Callable[[int], Sample]
"""The last row without faults before a stamp; the first row when there is none."""


@dataclass(frozen=True)
class Fault:
    """One fault in SI.

    Attributes
    ----------
    target : gyro_0.., accel_0.., or one of AIDS
    type : FaultType
    size : rad/s, m/s^2, m, m/s, rad; rad for `angular`; sigma of NOISE; dimensionless for SCALE
    slope : size per second, RAMP only (size is then its value at the start)
    axis : aids: north, east, down, forward, starboard, up, roll, pitch, heading, or all (both horizontal ones, or all there are)
    start_ns, end_ns : in force from start (inclusive) to end (exclusive); None: until cleared
    angular : size is an angle of latitude and of longitude
    """

    target: str
    type: FaultType
    size: float = 0.0
    slope: float = 0.0
    axis: str = "all"
    start_ns: int = 0
    end_ns: int | None = None
    angular: bool = False

    def __post_init__(self) -> None:
        kind = kind_of(self.target)
        axes = ("all", *_AXES.get(kind, ()))
        if self.axis not in axes:
            raise SettingError(f'"axis" of a fault on {self.target} must be one of {", ".join(axes)}, not {self.axis!r}', ("axis",))
        if self.type == FaultType.SCALE and kind in ("position", "height", "attitude"):
            raise SettingError(f"a scale fault has no meaning for the {kind} of {self.target}", ("type",))
        if self.angular and self.axis == "down":
            raise SettingError("an angle has no meaning for the height", ("axis",))
        if not (math.isfinite(self.size) and math.isfinite(self.slope)):
            raise SettingError("size and slope of a fault must be finite", ("size",))
        if self.type == FaultType.NOISE and self.size < 0.0:
            raise SettingError("the sigma of a noise fault must not be negative", ("size",))
        if self.end_ns is not None and self.end_ns <= self.start_ns:
            raise SettingError("a fault must end after it starts", ("end_s",))

    def in_force(self, stamp_ns: int) -> bool:
        """Whether the fault acts on a measurement with that stamp."""
        return self.start_ns <= stamp_ns and (self.end_ns is None or stamp_ns < self.end_ns)


def kind_of(target: str) -> str:
    """Kind of a target: gyro, accel, position, velocity, speed, height or attitude.

    Raises
    ------
    SettingError
        There is no such sensor.
    """
    word, _, number = target.partition("_")
    if word in ("gyro", "accel") and number.isascii() and number.isdecimal() and int(number) < 64:
        return word
    if target in _KINDS:
        return _KINDS[target]
    known = [*AIDS, *(f"{w}_{i}" for w in ("gyro", "accel") for i in range(6))]
    raise SettingError(f'"target" must be gyro_N, accel_N (N from 0), {", ".join(AIDS)}, not {target!r}{nearest(target, known)}', ("target",))


@dataclass(frozen=True)
class FaultSettings:
    """A fault as a scenario writes it: the unit stands in the key of its size and slope."""

    target: str = setting(doc="sensor: gyro_0.., accel_0.., or an aid")
    type: str = setting(doc="what the fault does", choices=("step", "ramp", "stuck", "noise", "scale", "dropout"))
    start_s: float = setting(doc="onset since the start", unit="s", low=0.0, high=1e7)
    end_s: float | None = setting(None, "end since the start; not given: to the end of the voyage", "s", low=0.0, high=1e7)
    axis: str = setting(
        "all", "aids: which component; all: both horizontal ones, of one speed, a height or an attitude what there is",
        choices=("all", "north", "east", "down", "forward", "starboard", "up", "roll", "pitch", "heading"),
    )  # fmt: skip
    size_deg_h: float | None = setting(None, "gyro: step, sigma of noise, or ramp at its start", "deg/h")
    size_deg_s: float | None = setting(None, "gyro", "deg/s")
    size_rad_s: float | None = setting(None, "gyro", "rad/s")
    size_ug: float | None = setting(None, "accelerometer", "ug")
    size_mg: float | None = setting(None, "accelerometer", "mg")
    size_mps2: float | None = setting(None, "accelerometer", "m/s^2")
    size_m: float | None = setting(None, "gps, bds, altimeter", "m")
    size_arcsec: float | None = setting(None, "star_tracker", "arcsec")
    size_arcmin: float | None = setting(None, "star_tracker; gps, bds: angle of latitude and of longitude", "arcmin")
    size_deg: float | None = setting(None, "star_tracker", "deg")
    size_kn: float | None = setting(None, "doppler, odometer", "kn")
    size_mps: float | None = setting(None, "doppler, odometer", "m/s")
    size_percent: float | None = setting(None, "scale fault", "%")
    size_ppm: float | None = setting(None, "scale fault", "ppm")
    slope_deg_h_s: float | None = setting(None, "gyro ramp", "deg/h per s")
    slope_rad_s2: float | None = setting(None, "gyro ramp", "rad/s^2")
    slope_ug_s: float | None = setting(None, "accelerometer ramp", "ug/s")
    slope_mps3: float | None = setting(None, "accelerometer ramp", "m/s^3")
    slope_mps: float | None = setting(None, "gps, bds, altimeter ramp", "m/s")
    slope_arcsec_s: float | None = setting(None, "star_tracker ramp", "arcsec/s")
    slope_deg_s: float | None = setting(None, "star_tracker ramp", "deg/s")
    slope_kn_s: float | None = setting(None, "doppler, odometer ramp", "kn/s")
    slope_mps2: float | None = setting(None, "doppler, odometer ramp", "m/s^2")

    def __post_init__(self) -> None:
        self.fault()

    def fault(self) -> Fault:
        """The fault in SI, times in nanoseconds since the start.

        Raises
        ------
        SettingError
            A unit that the target does not have, a missing or a needless size; `path` names the key.
        """
        kind, shape = kind_of(self.target), FaultType[self.type.upper()]
        sizes = _SCALES if shape == FaultType.SCALE else _SIZES[kind]
        wants_size = shape in (FaultType.STEP, FaultType.NOISE, FaultType.SCALE)
        slope, slope_key = self._one("slope_", _SLOPES[kind] if shape == FaultType.RAMP else {}, shape == FaultType.RAMP)
        size, size_key = self._one("size_", sizes if wants_size or shape == FaultType.RAMP else {}, wants_size)
        angular = kind == "position" and size_key == "size_arcmin"
        if angular and slope_key:
            raise SettingError("a ramp in m/s starts from a size in m (size_m)", (size_key,))
        end = None if self.end_s is None else round(self.end_s * 1e9)
        return Fault(self.target, shape, size, slope, self.axis, round(self.start_s * 1e9), end, angular)

    def _one(self, prefix: str, units: dict[str, float], needed: bool) -> tuple[float, str]:
        given = [key for key in self.__dataclass_fields__ if key.startswith(prefix) and getattr(self, key) is not None]
        for key in given:
            if key not in units:
                cure = f"; give {' or '.join(units)}" if units else f": a {self.type} fault has none"
                raise SettingError(f'"{key}" does not fit a {self.type} fault on {self.target}{cure}', (key,))
        if len(given) > 1:
            raise SettingError(f"give one of {' and '.join(given)}, not both", (given[1],))
        if not given and needed:
            raise SettingError(f"a {self.type} fault on {self.target} needs {' or '.join(units)}")
        return (getattr(self, given[0]) * units[given[0]], given[0]) if given else (0.0, "")


class FaultSchedule:
    """The faults of a run; may change while it runs.

    Parameters
    ----------
    faults : in the order they act on a value
    seed : of the noise faults

    Notes
    -----
    The noise of a fault is addressed by its target, axis and start and by the number of the sample, so it is the same in any block split, in
    another process and after a restart.
    """

    def __init__(self, faults: Iterable[Fault] = (), seed: int = 0) -> None:
        self._faults: tuple[Fault, ...] = tuple(faults)
        self._seed = seed

    @property
    def faults(self) -> tuple[Fault, ...]:
        """All faults, in force or not."""
        return self._faults

    def add(self, fault: Fault) -> None:
        """Add a fault; it acts on measurements made from now on."""
        self._faults = (*self._faults, fault)

    def clear(self, target: str = "") -> int:
        """Remove the faults of a target (empty: all); returns how many there were."""
        kept = tuple(f for f in self._faults if target and f.target != target)
        cleared = len(self._faults) - len(kept)
        self._faults = kept
        return cleared

    def only(self, targets: Sequence[str]) -> FaultSchedule:
        """The faults of these targets ("gyro" and "accel" stand for all sensors of the kind)."""
        return FaultSchedule([f for f in self._faults if f.target in targets or f.target.partition("_")[0] in targets], self._seed)

    def in_force(self, stamp_ns: int) -> tuple[Fault, ...]:
        """Faults that act on a measurement with this stamp [ns since the start]."""
        return tuple(f for f in self._faults if f.in_force(stamp_ns))

    def apply_axes(self, kind: str, stamp_ns: NDArray[np.int64], k0: int, values: Array, before: Before) -> NDArray[np.uint64]:
        """Put the faults on a block of single-axis sensors.

        Parameters
        ----------
        kind : gyro or accel; column i is sensor `kind_i`
        stamp_ns : (m,), ascending, since the start
        k0 : number of the first row; rows are numbered without a gap
        values : (m, n), rad/s or m/s^2, changed in place
        before : for a value that sticks

        Returns
        -------
        (m,), bit i set: sensor i says it is valid
        """
        n = values.shape[1]
        valid = np.ones((values.shape[0], n), dtype=bool)
        for fault in self._faults:
            word, _, number = fault.target.partition("_")
            if word != kind or int(number) >= n:
                continue
            column = int(number)
            self._apply(fault, stamp_ns, k0, values, [column], None, before, (), kind, valid)
        return np.asarray((valid * (np.uint64(1) << np.arange(n, dtype=np.uint64))).sum(axis=1, dtype=np.uint64))

    def apply_aid(
        self, name: str, stamp_ns: NDArray[np.int64], k0: int, values: Array, before: Before, per_metre: Array | None = None
    ) -> NDArray[np.bool_]:
        """Put the faults on a block of an aid.

        Parameters
        ----------
        name : gps, bds (values are latitude, longitude, height), doppler (velocity forward, starboard, down), odometer (speed forward first),
            altimeter (height) or star_tracker (roll, pitch, heading)
        stamp_ns, k0, before : as in `apply_axes`
        values : (m, n), changed in place
        per_metre : (m, 3), latitude, longitude [rad] and height [m] of one metre north, east, down; None for what is no position

        Returns
        -------
        (m,), False: dropped out
        """
        present = np.ones(values.shape, dtype=bool)
        for fault in self._faults:
            if fault.target == name:
                self._apply(fault, stamp_ns, k0, values, _columns(fault), per_metre, before, (), name, present)
        return np.asarray(present.all(axis=1))

    def _apply(
        self,
        fault: Fault,
        stamp_ns: NDArray[np.int64],
        k0: int,
        values: Array,
        columns: list[int],
        unit: Array | None,
        before: Before,
        without: tuple[Fault, ...],
        group: str,
        valid: NDArray[np.bool_],
    ) -> None:
        first = int(np.searchsorted(stamp_ns, fault.start_ns))
        last = stamp_ns.size if fault.end_ns is None else int(np.searchsorted(stamp_ns, fault.end_ns))
        if first >= last:
            return
        rows = slice(first, last)
        if fault.type == FaultType.DROPOUT:
            valid[rows, columns] = False
            return
        held = self._held(fault, values.shape[1], before, without, group) if fault.type == FaultType.STUCK else None
        for column in columns:
            scale = 1.0 if fault.angular or unit is None else unit[rows, column]
            if fault.type == FaultType.STEP:
                values[rows, column] += fault.size * scale
            elif fault.type == FaultType.RAMP:
                elapsed = (stamp_ns[rows] - fault.start_ns) * 1e-9
                values[rows, column] += (fault.size + fault.slope * elapsed) * scale
            elif fault.type == FaultType.NOISE:
                stream = f"fault/{fault.target}/{column}/{fault.start_ns}"
                values[rows, column] += fault.size * scale * normal(self._seed, stream, k0 + first, last - first, 1)[:, 0]
            elif fault.type == FaultType.SCALE:
                values[rows, column] *= 1.0 + fault.size
            elif held is not None:
                values[rows, column] = held[column]

    def _held(self, fault: Fault, width: int, before: Before, without: tuple[Fault, ...], group: str) -> Array:
        """Row at which a value sticks: the last before the onset, with what the other faults made of it."""
        sample = before(fault.start_ns)
        row, stamp = sample.values.reshape(1, width).copy(), np.array([sample.stamp_ns])
        unit = None if sample.per_metre is None else sample.per_metre.reshape(1, width)
        hidden = (*without, fault)
        for other in self._faults:
            word, _, number = other.target.partition("_")
            if any(other is h for h in hidden) or group not in (word, other.target):
                continue
            columns = [int(number)] if group == word and number else _columns(other)
            if columns[-1] < width:
                self._apply(other, stamp, sample.k, row, columns, unit, before, hidden, group, np.ones(row.shape, dtype=bool))
        return np.asarray(row[0])


def _columns(fault: Fault) -> list[int]:
    kind = kind_of(fault.target)
    if fault.axis != "all":
        return [_AXES[kind].index(fault.axis)]
    return list(range(len(_AXES[kind]) if fault.type in (FaultType.STUCK, FaultType.DROPOUT) else _ALL[kind]))
