"""What every aid has in common: pose and measurement, settings, lever arm, delay, noise, and states of its own.

Lives here: `Pose`, `Measurement`, `AidSettings`, `AidModel`, `Input`, and the arithmetic of noise.
Does not live here: the aids (aids/, one file a type), the fault test, the filter. Errors are computed minus true: H is minus the seeds'.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Generic, NamedTuple, TypeVar

import numpy as np

from riins_core.earth import radii_s
from riins_core.jit import jit
from riins_core.kalman import cholesky_into
from riins_core.rotation import exp_so3
from riins_core.settings import setting

from .state_blocks import N_FED_BACK, Block, StateModel
from .structure_settings import AidJudging
from .types import Aid, Array, Reason

DELAY_STEP_S = 1e-3
"""Over twice this the rate of a measurement is taken, for the state of its delay."""


class Pose(NamedTuple):
    """Nominal state at the measurement time.

    Attributes
    ----------
    lat, lon, h : rad, rad, m
    v_n : (3,), m/s, NED
    C_nb : (3, 3)
    rate_b : (3,), body rate relative to NED, rad/s, FRD
    a_n : (3,), rate of v_n, m/s^2
    """

    lat: float
    lon: float
    h: float
    v_n: Array
    C_nb: Array
    rate_b: Array
    a_n: Array

    def moved(self, seconds: float) -> Pose:
        """The pose a moment later, with acceleration and body rate as they are."""
        step = self.v_n * seconds + 0.5 * self.a_n * seconds**2
        r_m, r_n = radii_s(self.lat)
        return self._replace(
            lat=self.lat + step[0] / (r_m + self.h), lon=self.lon + step[1] / ((r_n + self.h) * math.cos(self.lat)), h=self.h - step[2],
            v_n=self.v_n + self.a_n * seconds, C_nb=self.C_nb @ exp_so3(self.rate_b * seconds),
        )  # fmt: skip


class Measurement(NamedTuple):
    """z = measured - predicted (m,), H (m, n) with z = H x + noise, and R (m, m)."""

    z: Array
    H: Array
    R: Array


class Input(NamedTuple):
    """A message an aid may come in: its type, the reader that makes numbers of it, and which measurements of a topic it takes."""

    message: str
    """as in "sensor_msgs/msg/NavSatFix" """
    read: Callable[[Any], Mapping[str, Any] | None]
    """gives stamp_ns, z, R, ok and frame, or None for a message that is not for this aid"""
    part: str = ""
    """aids of different parts may share a topic"""


@dataclass(frozen=True)
class AidSettings(AidJudging):
    """What is declared of every aid."""

    type: str = setting("", "kind of aid")
    enabled: bool = setting(True, "use this subfilter")
    topic: str = setting("", "topic of its messages; empty: NAME/fix, NAME/velocity, NAME/heading ... by its type")
    frame: str = setting("", "header.frame_id its messages must have; empty: any")
    period_s: float = setting(10.0, "nominal interval between measurements", "s", 1e-3, 3600.0)
    timeout_s: float = setting(35.0, "absent after this long without a measurement, by IMU time", "s", 0.01, 1e5)
    delay_s: float = setting(0.0, "known delay: a measurement holds this long before the stamp of its message", "s", -10.0, 10.0)
    delay_sigma_s: float = setting(0.0, "sigma of what is not known of the delay, a state; 0: none", "s", 0.0, 10.0)
    false_alarm_probability: float = setting(0.0, "of its innovation test; 0: that of section isolation", "", 0.0, 0.5)
    mean_time_between_false_alarms_h: float = setting(0.0, "of its innovation test, one every period_s; 0: by the probability", "h", 0.0, 1e9)
    isolate_after: int = setting(0, "consecutive failed tests until it is isolated; 0: that of section isolation", "", 0, 1000)
    readmit_after: int = setting(0, "consecutive passed tests on probation until it is fused again; 0: that of section isolation", "", 0, 1000)
    hold_s: float = setting(-1.0, "an isolated subfilter stays so at least this long; -1: that of section isolation", "s", -1.0, 1e5)


@dataclass(frozen=True)
class LeverSettings(AidSettings):
    """An aid that stands away from the IMU."""

    lever_arm_m: tuple[float, ...] = setting((0.0, 0.0, 0.0), "of the sensor from the IMU, forward, starboard, down", "m", -1e3, 1e3, length=3)
    lever_sigma_m: float = setting(0.0, "sigma of each axis of the lever arm, three states; 0: known", "m", 0.0, 100.0)


S = TypeVar("S", bound=AidSettings)


class AidModel(ABC, Generic[S]):
    """Measurement model of one declared aid. A new type is a file in aids/ with a subclass of this.

    Parameters
    ----------
    name : of the aid, as declared
    settings : of its type

    Attributes
    ----------
    kind : name of the type, as in `type:`
    Settings : class of its settings
    leaf : the default topic is NAME/leaf
    inputs : messages it can come in, by the word of its setting `message` where there are several; the first is the default
    size : elements of z in its measurements
    rows : which of them are used
    n : states of the assembled error state
    at : places of its own states in it, those that are on
    """

    kind: ClassVar[str]
    Settings: ClassVar[type[AidSettings]]
    leaf: ClassVar[str]
    inputs: ClassVar[Mapping[str, Input]]

    def __init__(self, name: str, settings: S, size: int = 3, rows: slice = slice(0, 3)) -> None:
        self.name, self.settings = name, settings
        self.size, self.rows = size, rows
        self.n, self.at = 0, {}  # type: ignore[var-annotated]
        self.lever = np.array(getattr(settings, "lever_arm_m", (0.0, 0.0, 0.0)))

    @property
    def frame(self) -> str:
        """Frame of the components of an innovation."""
        return "map_ned"

    def own(self) -> list[Block]:
        """States of this type of aid, by `state`; those of sigma 0 are off."""
        return []

    @abstractmethod
    def difference(self, aid: Aid, pose: Pose, parameters: Array) -> Measurement:
        """Innovation, H and R of the elements `rows`, without regard to a delay that is not known."""

    def state(self, name: str, labels: Mapping[str, str], sigma: float, time_s: float = np.inf) -> Block:
        """A block of its own: labels with their units."""
        return Block(f"{self.name}.{name}", tuple(f"{self.name}_{label} [{unit}]" for label, unit in labels.items()), float(sigma), time_s)

    def blocks(self) -> list[Block]:
        """All states of its own."""
        lever = self.state("lever", dict.fromkeys(("lever_x", "lever_y", "lever_z"), "m"), getattr(self.settings, "lever_sigma_m", 0.0))
        return [*self.own(), lever, self.state("delay", {"delay": "s"}, self.settings.delay_sigma_s)]

    def place(self, states: StateModel) -> None:
        """Be told the assembled state."""
        self.n = states.n
        places = {block.name.removeprefix(f"{self.name}."): states.place(block.name) for block in self.blocks()}
        self.at = {name: place for name, place in places.items() if place is not None}

    def value(self, parameters: Array, state: str) -> Array | float:
        """Estimate of states of its own, 0.0 where they are off."""
        place = self.at.get(state)
        return 0.0 if place is None else np.asarray(parameters[place.start - N_FED_BACK : place.stop - N_FED_BACK])

    def number(self, parameters: Array, state: str) -> float:
        """Estimate of a state of its own that stands alone, 0.0 where it is off."""
        place = self.at.get(state)
        return 0.0 if place is None else float(parameters[place.start - N_FED_BACK])

    def measurement(self, aid: Aid, pose: Pose, parameters: Array) -> Measurement:
        """Innovation, H and R of a measurement that has no `defect`.

        Parameters
        ----------
        aid : z (size,), R (size, size)
        pose : nominal state at its stamp
        parameters : (n - 9,), estimated parameters

        Notes
        -----
        A delay that is a state moves the pose by its estimate; its column of H is the rate of the measurement, by a central difference.
        """
        if "delay" not in self.at:
            return self.difference(aid, pose, parameters)
        delay = self.number(parameters, "delay")
        found = self.difference(aid, pose.moved(-delay), parameters)
        later, before = (self.difference(aid, pose.moved(step - delay), parameters).z for step in (DELAY_STEP_S, -DELAY_STEP_S))
        found.H[:, self.at["delay"].start] = (before - later) / (2.0 * DELAY_STEP_S)
        return found

    def defect(self, aid: Aid) -> Reason:
        """Why a measurement cannot be used at all, NONE if it can."""
        if not aid.ok:
            return Reason.NO_FIX
        if self.settings.frame and aid.frame is not None and aid.frame != self.settings.frame:
            return Reason.FRAME
        if np.shape(aid.z) != (self.size,) or not self.plausible(aid.z):
            return Reason.NOT_FINITE
        return Reason.NONE if self.covariance_ok(aid) else Reason.COVARIANCE

    def plausible(self, z: Array) -> bool:
        """The elements that are used are numbers that such a sensor can give."""
        return bool(np.isfinite(z[self.rows]).all())

    def covariance_ok(self, aid: Aid) -> bool:
        """Its covariance can be used."""
        side = len(aid.R)
        return np.shape(aid.R) == (side, side) and side == self.size and reported_covariance_ok(aid.R, self.rows)


def models_of(modules: Mapping[str, Any]) -> dict[str, type[AidModel[Any]]]:
    """Aid models of modules, by kind."""
    found: dict[str, type[AidModel[Any]]] = {}
    for module in modules.values():
        for one in vars(module).values():
            if isinstance(one, type) and issubclass(one, AidModel) and one.__module__ == module.__name__ and "kind" in vars(one):
                found[one.kind] = one
    return found


def white_inflation(sigma: float, correlation_time: float, period: float) -> float:
    """Variance of a white noise that carries as much information as a first-order Markov noise sampled at `period`.

    Parameters
    ----------
    sigma, correlation_time, period : unit of the measurement, s, s

    Returns
    -------
    float, sigma^2 (1 + r) / (1 - r), r = exp(-period / correlation_time)
    """
    r = np.exp(-period / correlation_time)
    return float(sigma**2 * (1.0 + r) / (1.0 - r))


def noise(R: Array, sigma: Array, floor: float) -> Array:
    """Covariance to use: the reported one, or the configured sigma where it is all zeros, not below the floor.

    Parameters
    ----------
    R : (m, m), reported
    sigma : (m,), configured
    floor : smallest sigma

    Returns
    -------
    (m, m)
    """
    R = np.array(R) if R.any() else np.diag(sigma**2)
    if floor > 0.0:
        for i in range(len(R)):
            R[i, i] = max(R[i, i], floor**2)
    return R


def reported_covariance_ok(R: Array, rows: slice) -> bool:
    """All zeros (unknown), or finite, symmetric and positive definite in the rows that are used."""
    part = np.array(R[rows, rows], dtype=np.float64)
    return _positive(part) or (not R.any() and bool(np.isfinite(part).all()))


@jit
def _positive(R: Array) -> bool:
    """Kernel: finite, symmetric and positive definite."""
    for i in range(R.shape[0]):
        for j in range(i):
            if not abs(R[i, j] - R[j, i]) <= 1e-9 * np.abs(R).max():
                return False
    return cholesky_into(R, np.zeros_like(R))


def skew(v: Array) -> Array:
    """Matrix [v x] of one vector (3,), as riins_core.rotation.skew but without its generality, which costs more than the rest of a measurement."""
    x, y, z = v.tolist()
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def cross(a: Array, b: Array) -> Array:
    """Vector product of two vectors (3,); numpy's own takes ten times as long for so few numbers."""
    (u, v, w), (x, y, z) = a.tolist(), b.tolist()
    return np.array([v * z - w * y, w * x - u * z, u * y - v * x])
