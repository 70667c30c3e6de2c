"""The error state of the navigator, assembled from blocks: the fifteen states of the INS, then what the YAML and the aids ask for.

Lives here: `Block`, the blocks of the inertial sensors, `StateModel` (order, labels, start, process noise, coupling, the estimates' feedback).
Does not live here: the kernels (error_filter.py), what the states of an aid do to its measurement (the aid's own file), the fifteen (riins_core).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from riins_core import ins_error
from riins_core.ins_error import BA, BG, N_STATES, PHI, VEL, State
from riins_core.sensor_errors import DEG_PER_H, DEG_PER_SQRT_H, MICRO_G, PPM
from riins_core.settings import SettingError, nearest

from .inertial_model import InertialModel
from .types import Array, InitialState

N_FED_BACK = 9
"""Position, velocity and attitude are fed back into the nominal state, what follows into the estimated parameters."""
NOT, RATE, FORCE = 0, 1, 4
"""A column that enters the INS as it is, times the mean body rate (its first element), times the mean specific force."""


@dataclass(frozen=True)
class Block:
    """States that belong together.

    Attributes
    ----------
    name : "gyro_markov", or of an aid "doppler.scale"
    labels : one for each state, with unit
    sigma : at the start, unit of the state
    time_s : correlation time of a first-order Gauss-Markov process; inf: a constant
    left : it is what is left of a sensor error after the estimate has been subtracted, as BG and BA are; else computed minus true
    column : the states of the INS (BG or BA) whose columns these states have too; None: they are seen by their aid alone
    factor : what that column is multiplied by: NOT, RATE or FORCE
    """

    name: str
    labels: tuple[str, ...]
    sigma: float
    time_s: float = np.inf
    left: bool = False
    column: slice | None = None
    factor: int = NOT

    def __len__(self) -> int:
        """Number of states."""
        return len(self.labels)


def inertial_blocks(model: InertialModel) -> dict[str, Block]:
    """Blocks of the inertial sensors that `states` can name."""

    def block(name: str, short: str, unit: str, sigma: float, time_s: float, column: slice, factor: int) -> Block:
        return Block(name, tuple(f"{short}_{axis} [{unit}]" for axis in "xyz"), sigma, time_s, True, column, factor)

    return {
        "gyro_markov": block("gyro_markov", "gm", "rad/s", model.gyro_markov_deg_h * DEG_PER_H, model.gyro_markov_time_s, BG, NOT),
        "accel_markov": block("accel_markov", "am", "m/s^2", model.accel_markov_ug * MICRO_G, model.accel_markov_time_s, BA, NOT),
        "gyro_scale": block("gyro_scale", "sg", "1", model.gyro_scale_ppm * PPM, np.inf, BG, RATE),
        "accel_scale": block("accel_scale", "sa", "1", model.accel_scale_ppm * PPM, np.inf, BA, FORCE),
    }


INS_LABELS = tuple(
    f"{name.lower()} [{unit}]"
    for name, unit in zip(
        (state.name for state in State), ["m"] * 3 + ["m/s"] * 3 + ["rad"] * 3 + ["rad/s"] * 3 + ["m/s^2"] * 3, strict=True
    )
)  # fmt: skip


def inertial_density(model: InertialModel) -> Array:
    """Diagonal of the continuous process noise of the fifteen states of the INS, unit of the state squared per second."""
    density = np.zeros(N_STATES)
    density[VEL] = (model.accel_vrw_ug_sqrt_hz * MICRO_G) ** 2
    density[PHI] = (model.gyro_arw_deg_sqrt_h * DEG_PER_SQRT_H) ** 2
    density[BG] = (model.gyro_bias_walk_deg_h_sqrt_h * DEG_PER_H) ** 2 / 3600.0
    density[BA] = (model.accel_bias_walk_ug_sqrt_h * MICRO_G) ** 2 / 3600.0
    return density


class StateModel:
    """The assembled error state.

    Parameters
    ----------
    inertial : error model of the fused triad
    states : names of inertial blocks, in their order; one whose sigma is zero is left out
    own : blocks of the aids

    Attributes
    ----------
    n : number of states
    labels : (n,), with unit
    blocks : those that are there, in order
    places : slice of the error state by name of the block
    density : (n,), diagonal of the continuous process noise
    decay : (n,), 1 / correlation time, 0 for what is no Markov process
    column, factor : (k,), of the k states that enter the INS and stand next to its fifteen: whose column they have, times what
    sign : (n - 9,), of the feedback into the estimated parameters: +1 what is left of a sensor error, -1 computed minus true

    Raises
    ------
    SettingError
        `states` names a block that does not exist, or one twice.
    """

    def __init__(self, inertial: InertialModel, states: Iterable[str], own: Iterable[Block] = ()) -> None:
        known, names = inertial_blocks(inertial), list(states)
        for name in names:
            if name not in known:
                raise SettingError(f'"states" names "{name}"{nearest(name, known)}; there are {", ".join(known)}', ("states",))
        if len(set(names)) < len(names):
            raise SettingError('"states" names a block twice', ("states",))
        self.inertial = inertial
        self.blocks = [block for block in (*(known[name] for name in names), *own) if block.sigma > 0.0]
        self.places: dict[str, slice] = {}
        self.n = N_STATES
        for block in self.blocks:
            self.places[block.name] = slice(self.n, self.n + len(block))
            self.n += len(block)
        self.labels = INS_LABELS + tuple(label for block in self.blocks for label in block.labels)
        self.density, self.decay, self._variance = np.zeros(self.n), np.zeros(self.n), np.zeros(self.n)
        self.sign = np.ones(self.n - N_FED_BACK)
        self.density[:N_STATES] = inertial_density(inertial)
        column: list[int] = []
        factor: list[int] = []
        for block in self.blocks:
            place = self.places[block.name]
            self.decay[place] = 1.0 / block.time_s
            self.density[place] = 2.0 * block.sigma**2 * self.decay[place]
            self._variance[place] = block.sigma**2
            self.sign[place.start - N_FED_BACK : place.stop - N_FED_BACK] = 1.0 if block.left else -1.0
            if block.column is not None:
                column += range(block.column.start, block.column.stop)
                factor += [block.factor + axis if block.factor else 0 for axis in range(len(block))]
        self.column, self.factor = np.array(column, dtype=np.int64), np.array(factor, dtype=np.int64)
        self._bias = [[self._parameters(b.name) for b in self.blocks if b.column == column and not b.factor] for column in (BG, BA)]
        self._scale = [[self._parameters(b.name) for b in self.blocks if b.column == column and b.factor] for column in (BG, BA)]
        self.scaled = any(self._scale)

    def _parameters(self, name: str) -> slice:
        place = self.places[name]
        return slice(place.start - N_FED_BACK, place.stop - N_FED_BACK)

    def place(self, name: str) -> slice | None:
        """Where a block stands in the error state, None where it does not."""
        return self.places.get(name)

    def initial_sigma(self) -> Array:
        """Sigma (n,) at the start of the states beyond the fifteen of the INS, of which it is 0 here."""
        return np.sqrt(self._variance)

    def initial_covariance(self, initial: InitialState) -> Array:
        """Covariance (n, n) at the start: that of the initial state, or its sigmas, with the configured ones of the biases where it gives none."""
        model, variance = self.inertial, self._variance.copy()
        bias_g = np.where(np.asarray(initial.sigma_gyro_bias) > 0.0, initial.sigma_gyro_bias, model.gyro_bias_deg_h * DEG_PER_H)
        bias_a = np.where(np.asarray(initial.sigma_accel_bias) > 0.0, initial.sigma_accel_bias, model.accel_bias_ug * MICRO_G)
        variance[:N_STATES] = np.concatenate([initial.sigma_position, initial.sigma_velocity, initial.sigma_attitude, bias_g, bias_a]) ** 2
        P = np.diag(variance)
        if initial.covariance is not None:
            P[:N_STATES, :N_STATES] = initial.covariance
        return P

    def initial_parameters(self, initial: InitialState) -> Array:
        """Estimated parameters (n - 9,) at the start: the biases that are known, nothing else."""
        parameters = np.zeros(self.n - N_FED_BACK)
        parameters[0:3], parameters[3:6] = initial.gyro_bias, initial.accel_bias
        return parameters

    def correct(self, nav: Array, parameters: Array, x: Array) -> None:
        """Take estimated errors x (n,) out of the nominal state (16,) and the estimated parameters (n - 9,), in place."""
        ins_error.correct(nav, x[:N_FED_BACK])
        parameters += self.sign * x[N_FED_BACK:]

    def biases(self, parameters: Array) -> tuple[Array, Array]:
        """Estimated gyro and accelerometer bias (3,), (3,), constant and Markov part together, rad/s, m/s^2."""
        return self._total(parameters, 0), self._total(parameters, 1)

    def _total(self, parameters: Array, kind: int) -> Array:
        """Bias of the gyros (0) or the accelerometers (1)."""
        bias = parameters[3 * kind : 3 * kind + 3]
        for place in self._bias[kind]:
            bias = bias + parameters[place]
        return bias

    def gains(self, parameters: Array) -> tuple[Array, Array]:
        """What a rate and a specific force less bias are multiplied by for the estimated scale factor errors, (3,), (3,)."""
        gains = []
        for places in self._scale:
            gain = np.ones(3)
            for place in places:
                gain /= 1.0 + parameters[place]
            gains.append(gain)
        return gains[0], gains[1]

    def rate(self, parameters: Array, rate: Array) -> Array:
        """A measured body rate without its estimated errors."""
        rate = rate - self._total(parameters, 0)
        return rate * self.gains(parameters)[0] if self.scaled else rate

    def force(self, parameters: Array, force: Array) -> Array:
        """A measured specific force without its estimated errors."""
        force = force - self._total(parameters, 1)
        return force * self.gains(parameters)[1] if self.scaled else force

    def bias_covariances(self, P: Array) -> tuple[Array, Array]:
        """Covariances (3, 3), (3, 3) of the biases that `biases` adds up, of the state's covariance (n, n)."""
        found = []
        for start, places in zip((BG, BA), self._bias, strict=True):
            parts = [start, *(slice(p.start + N_FED_BACK, p.stop + N_FED_BACK) for p in places)]
            found.append(np.asarray(sum(P[a, b] for a in parts for b in parts)))
        return found[0], found[1]
