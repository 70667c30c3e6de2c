"""A voyage as one YAML file: start, legs, sea, sensors and their errors, initial errors, faults, outages, scoring and expectations.

Lives here: `Scenario` and its sections (frozen settings classes), `load`, `from_yaml`.
Does not live here: YAML and line numbers (scenario_file.py), what is made of the sections (trajectory.py, sensors.py, faults.py, riins_eval).
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from riins_core.imu_array import CONFIGURATIONS
from riins_core.sensor_errors import AccelErrors, GyroErrors
from riins_core.settings import SettingError, as_mapping, build, section, setting

from .course import FASTEST_KN, LegSettings
from .faults import AIDS, Fault, FaultSchedule, FaultSettings, FaultType
from .scenario_file import ScenarioError, find, line_of, names, parse
from .vessel import VesselSettings
from .waves import SeaSettings

__all__ = ["Scenario", "ScenarioError", "from_yaml", "load", "names"]

IMU = "imu"
"""The whole redundant IMU, as the target of an outage."""


@dataclass(frozen=True)
class StartSettings:
    """Where and how the ship, car or aircraft is at the start."""

    latitude_deg: float = setting(doc="geodetic latitude, WGS-84", unit="deg", low=-85.0, high=85.0)
    longitude_deg: float = setting(doc="longitude", unit="deg", low=-180.0, high=180.0)
    height_m: float = setting(0.0, "mean height above the ellipsoid", "m", low=-500.0, high=30000.0)
    speed_kn: float = setting(0.0, "speed along the heading", "kn", low=-FASTEST_KN, high=FASTEST_KN)
    heading_deg: float = setting(0.0, "clockwise from true north", "deg", low=-360.0, high=360.0)


@dataclass(frozen=True)
class ImuSettings:
    """The redundant IMU at base_link: geometry and the errors of EACH sensor."""

    configuration: str = setting("dodecahedron", "six-sensor configuration", choices=tuple(CONFIGURATIONS))
    lever_arm_m: tuple[float, ...] = setting((0.0, 0.0, 0.0), "of the IMU in the body; base_link is at the IMU, so zero", "m", 0.0, 0.0, length=3)
    gyro: GyroErrors = section(GyroErrors, "errors of each gyro; a value is the 1-sigma from which the seed draws")
    accel: AccelErrors = section(AccelErrors, "errors of each accelerometer")
    gyro_range_deg_s: float = setting(300.0, "a gyro saturates here", "deg/s", low=1.0)
    accel_range_g: float = setting(10.0, "an accelerometer saturates here", "g", low=1.5)


@dataclass(frozen=True)
class PositionSettings:
    """A satellite receiver."""

    enabled: bool = setting(True, "whether the ship has it")
    period_s: float = setting(1.0, "interval of fixes", "s", low=0.01, high=3600.0)
    sigma_m: tuple[float, ...] = setting((3.0, 3.0, 6.0), "white error north, east, down", "m", 1e-3, 1e5, length=3)
    markov_sigma_m: float = setting(0.0, "slowly varying error of each horizontal axis (atmosphere, multipath)", "m", low=0.0, high=1e5)
    markov_time_s: float = setting(300.0, "correlation time of the slowly varying error", "s", low=1.0)
    velocity_sigma_mps: float = setting(0.1, "white error of each velocity axis", "m/s", low=1e-4, high=100.0)
    lever_arm_m: tuple[float, ...] = setting((0.0, 0.0, 0.0), "of the antenna in the body, FRD", "m", -500.0, 500.0, length=3)


@dataclass(frozen=True)
class DopplerSettings:
    """A Doppler log with bottom lock; it measures along its own axes."""

    enabled: bool = setting(True, "whether the ship has it")
    period_s: float = setting(1.0, "interval of measurements", "s", low=0.01, high=3600.0)
    sigma_kn: tuple[float, ...] = setting((0.1, 0.1, 0.1), "white error forward, starboard, down", "kn", 1e-4, 100.0, length=3)
    misalignment_deg: float = setting(0.0, "1-sigma of the mounting error about the vertical, drawn by the seed", "deg", low=0.0, high=20.0)
    scale_ppm: float = setting(0.0, "1-sigma of the scale factor error, drawn by the seed", "ppm", low=0.0, high=1e5)
    lever_arm_m: tuple[float, ...] = setting((0.0, 0.0, 0.0), "of the log in the body, FRD", "m", -500.0, 500.0, length=3)


@dataclass(frozen=True)
class OdometerSettings:
    """An odometer; sideways and down it says that base_link does not move."""

    enabled: bool = setting(False, "whether the car has it")
    period_s: float = setting(1.0, "interval of measurements", "s", low=0.01, high=3600.0)
    sigma_mps: float = setting(0.1, "white error of the speed", "m/s", low=1e-4, high=100.0)
    scale_ppm: float = setting(0.0, "1-sigma of the scale factor error (tyres), drawn by the seed", "ppm", low=0.0, high=1e5)
    sideways_sigma_mps: float = setting(0.1, "sigma that it states of its zero sideways", "m/s", low=1e-4, high=100.0)
    down_sigma_mps: float = setting(0.1, "sigma that it states of its zero down", "m/s", low=1e-4, high=100.0)
    lever_arm_m: tuple[float, ...] = setting((0.0, 0.0, 0.0), "of the wheel in the body, FRD", "m", -50.0, 50.0, length=3)


@dataclass(frozen=True)
class AltimeterSettings:
    """A barometric altimeter."""

    enabled: bool = setting(False, "whether there is one")
    period_s: float = setting(1.0, "interval of measurements", "s", low=0.01, high=3600.0)
    sigma_m: float = setting(1.0, "white error", "m", low=1e-3, high=1e4)
    bias_m: float = setting(0.0, "1-sigma of the constant error, drawn by the seed", "m", low=0.0, high=1e4)
    markov_sigma_m: float = setting(0.0, "slowly varying error (weather)", "m", low=0.0, high=1e4)
    markov_time_s: float = setting(600.0, "correlation time of the slowly varying error", "s", low=1.0)
    lever_arm_m: tuple[float, ...] = setting((0.0, 0.0, 0.0), "in the body, FRD", "m", -500.0, 500.0, length=3)


@dataclass(frozen=True)
class StarTrackerSettings:
    """A star sensor that gives attitude against the local level; clouds are outages."""

    enabled: bool = setting(False, "whether there is one")
    period_s: float = setting(1.0, "interval of measurements", "s", low=0.01, high=3600.0)
    sigma_arcsec: tuple[float, ...] = setting((5.0, 5.0, 15.0), "white error about forward, starboard, down", "arcsec", 1e-3, 1e5, length=3)
    misalignment_arcsec: float = setting(0.0, "1-sigma of the mounting error about each axis, drawn by the seed", "arcsec", low=0.0, high=1e5)
    max_rate_deg_s: float = setting(2.0, "no measurement while the body turns faster: the stars smear", "deg/s", low=0.01, high=100.0)


@dataclass(frozen=True)
class InitialSettings:
    """1-sigma errors of the state the navigator starts from."""

    given: bool = setting(True, "whether the navigator is given this state; false: it aligns itself, see its section alignment")
    position_m: float = setting(30.0, "of each axis north and east", "m", low=1e-3)
    height_m: float = setting(2.0, "of the height", "m", low=1e-3)
    velocity_mps: float = setting(0.1, "of each axis", "m/s", low=1e-4)
    tilt_arcsec: float = setting(20.0, "of each level axis; self-aligned: beside what the accelerometers' biases do", "arcsec", low=1e-3)
    heading_arcmin: float = setting(5.0, "of the heading; self-aligned: beside what the east gyro does", "arcmin", low=1e-3)
    self_aligned: bool = setting(False, "the attitude comes from the IMU itself: tilt = bias / g, azimuth = east drift / (Earth rate cos L)")


@dataclass(frozen=True)
class OutageSettings:
    """A time in which an aid, or the whole redundant IMU, gives nothing, in the fault-free twin too."""

    target: str = setting(doc="aid, or imu", choices=(IMU, *AIDS))
    start_s: float = setting(doc="since the start", unit="s", low=0.0, high=1e7)
    end_s: float = setting(doc="since the start", unit="s", low=0.0, high=1e7)

    def __post_init__(self) -> None:
        if self.end_s <= self.start_s:
            raise SettingError("an outage must end after it starts", ("end_s",))


@dataclass(frozen=True)
class ScoringSettings:
    """What counts."""

    from_s: float = setting(0.0, "errors count from here on", "s", low=0.0)


@dataclass(frozen=True, kw_only=True)
class Scenario:
    """One voyage. Every quantity of the simulation follows from it and the seed."""

    name: str = setting(doc="short name")
    description: str = setting("", "one sentence")
    seed: int = setting(1, "of all random numbers", low=0, high=2**31 - 1)
    duration_s: float = setting(doc="length of the voyage", unit="s", low=1.0, high=1e6)
    imu_rate_hz: int = setting(100, "samples a second of the IMU", "Hz", low=1, high=2000)
    start: StartSettings = setting(doc="where and how the ship starts")
    legs: tuple[LegSettings, ...] = setting((), "the course, in order; straight on after the last")
    sea: SeaSettings = section(SeaSettings, "waves")
    vessel: VesselSettings = section(VesselSettings, "response of the hull")
    imu: ImuSettings = section(ImuSettings, "redundant IMU")
    gps: PositionSettings = section(PositionSettings, "GPS receiver")
    bds: PositionSettings = section(PositionSettings, "BDS receiver")
    doppler: DopplerSettings = section(DopplerSettings, "Doppler log")
    odometer: OdometerSettings = section(OdometerSettings, "odometer")
    altimeter: AltimeterSettings = section(AltimeterSettings, "altimeter")
    star_tracker: StarTrackerSettings = section(StarTrackerSettings, "star sensor")
    initial: InitialSettings = section(InitialSettings, "errors at the start")
    faults: tuple[FaultSettings, ...] = setting((), "faults, in the order in which they act on a value")
    outages: tuple[OutageSettings, ...] = setting((), "times without an aid, or without the redundant IMU")
    scoring: ScoringSettings = section(ScoringSettings, "what counts")
    navigator: dict = dataclasses.field(default_factory=dict, metadata={"doc": "settings of the navigator that differ from its own defaults"})  # type: ignore[type-arg]
    fusion: dict = dataclasses.field(default_factory=dict, metadata={"doc": "settings of the IMU fusion that differ from its own defaults"})  # type: ignore[type-arg]
    expect: dict = dataclasses.field(default_factory=dict, metadata={"doc": "results by name: {min: .., max: ..}, or the list itself"})  # type: ignore[type-arg]

    def __post_init__(self) -> None:
        if not self.name.replace("_", "").replace("-", "").isalnum():
            raise SettingError(f'"name" must be letters, digits, "_" and "-", not {self.name!r}', ("name",))
        geometry = self.fusion.get("geometry")
        sensors = (len(geometry) // 3 if isinstance(geometry, list) else 0) or CONFIGURATIONS[self.imu.configuration].shape[0]
        for i, fault in enumerate(self.faults):
            word, _, number = fault.target.partition("_")
            if number.isdecimal() and int(number) >= sensors:
                raise SettingError(f"there is no {fault.target}: the IMU has {word}_0 .. {word}_{sensors - 1}", ("faults", str(i), "target"))
        speed = self.start.speed_kn
        for i, leg in enumerate(self.legs):
            speed = speed if leg.speed_kn is None else leg.speed_kn
            if leg.climb_m is not None and speed == 0.0:
                raise SettingError("nothing climbs that stands still", ("legs", str(i), "climb_m"))
        for name, wish in self.expect.items():
            bounds = isinstance(wish, dict) and wish and set(wish) <= {"min", "max"} and all(_is_number(v) for v in wish.values())
            if not isinstance(name, str) or not (bounds or (isinstance(wish, list) and all(isinstance(word, str) for word in wish))):
                raise SettingError(f'"expect.{name}" must be {{min: .., max: ..}} or a list of words, not {wish!r}', ("expect", str(name)))

    def fault_schedule(self) -> FaultSchedule:
        """The scenario's faults with its seed."""
        return FaultSchedule([f.fault() for f in self.faults], self.seed)

    def outage_schedule(self) -> FaultSchedule:
        """The outages of the aids as dropouts; they belong to the fault-free twin too."""
        dropouts = [
            Fault(o.target, FaultType.DROPOUT, start_ns=round(o.start_s * 1e9), end_ns=round(o.end_s * 1e9)) for o in self.outages if o.target != IMU
        ]
        return FaultSchedule(dropouts, self.seed)

    def imu_outages(self) -> list[tuple[int, int]]:
        """Times [start, end) without a sample of the redundant IMU, ns since the start."""
        return [(round(o.start_s * 1e9), round(o.end_s * 1e9)) for o in self.outages if o.target == IMU]

    def with_seed(self, seed: int) -> Scenario:
        """The same voyage with other random numbers; a negative seed changes nothing."""
        return self if seed < 0 else dataclasses.replace(self, seed=seed)

    def to_yaml(self) -> str:
        """The scenario as YAML that `from_yaml` reads back to an equal object; settings that are not given are left out."""
        return str(yaml.safe_dump(_without_none(as_mapping(self)), sort_keys=False, allow_unicode=True, default_flow_style=None, width=150))


def from_yaml(text: str, name: str = "scenario") -> Scenario:
    """Make a scenario of YAML.

    Parameters
    ----------
    text : YAML
    name : of the file, for messages

    Returns
    -------
    Scenario

    Raises
    ------
    ScenarioError
        "NAME:LINE: what is wrong (did you mean ...)": unknown key, wrong unit, type, length or range, a key given twice, no YAML.
    """
    values, lines = parse(text, name)
    try:
        return build(Scenario, values)
    except SettingError as error:
        raise ScenarioError(f"{name}:{line_of(lines, error.path)}: {error}") from None


def load(path_or_name: str | Path) -> Scenario:
    """Read a scenario.

    Parameters
    ----------
    path_or_name : a YAML file, or the name of a shipped scenario (harbour, voyage_12h, ...)

    Returns
    -------
    Scenario

    Raises
    ------
    ScenarioError
        No such file or name, or an error in it.
    """
    path = find(path_or_name)
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ScenarioError(f"{path}: cannot be read: {error}") from None
    return from_yaml(text, str(path))


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _without_none(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _without_none(v) for k, v in value.items() if v is not None}
    if isinstance(value, list):
        return [_without_none(v) for v in value]
    return value
