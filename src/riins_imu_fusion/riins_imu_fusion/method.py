"""What every method of fusing n single-axis sensors of one kind has in common: its model, its output, blocks, masks and roll-back.

Lives here: `TriadModel`, `Fused`, `FusionMethod`; a method is an object fed blocks of readings with masks of the sensors to use.
Does not live here: any method (wls.py, optimal.py, ...), their names (methods.py), fault detection and health (pipeline.py).
"""

from __future__ import annotations

import copy
import itertools
from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import ClassVar, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from riins_core.imu_array import ImuArray

Array = NDArray[np.float64]

_MOST_TABLES = 1024


@dataclass(frozen=True)
class TriadModel:
    """What is known beforehand of n sensors of one kind; U stands for rad/s or m/s^2.

    A drift d_i of each sensor begins with standard deviation `drift` and walks by `walk` a sample: thesis (5-61), A = B = C = I.

    Parameters
    ----------
    array : the geometry, body axes FRD
    sigma : one value or (n,), white noise of a sample, U
    drift : likewise, standard deviation of the drift before the first sample (root of the diagonal of P), U
    walk : likewise, standard deviation of the drift's step before each sample (root of the diagonal of Q), U
    dt : sample interval, s
    scale, misalignment : standard deviation of scale factor and of the tilt of a sensing axis about each transverse axis, rad; glr_kf asks for them

    Raises
    ------
    ValueError
        A standard deviation has another length, is negative or not finite, or `sigma` or `dt` is not positive.
    """

    array: ImuArray
    sigma: ArrayLike
    drift: ArrayLike = 0.0
    walk: ArrayLike = 0.0
    dt: float = 0.01
    scale: float = 0.0
    misalignment: float = 0.0
    R: Array = field(init=False)
    P: Array = field(init=False)
    Q: Array = field(init=False)
    """(n,), variances"""

    def __post_init__(self) -> None:
        for name, given in (("R", self.sigma), ("P", self.drift), ("Q", self.walk)):
            value = np.asarray(given, dtype=np.float64)
            if value.ndim > 1 or (value.ndim == 1 and value.shape != (self.array.n,)):
                raise ValueError(f"a standard deviation must be one value or {self.array.n}")
            if not np.all(np.isfinite(value)) or np.any(value < 0.0) or (name == "R" and np.any(value == 0.0)):
                raise ValueError("standard deviations must be finite and not negative, and that of the white noise positive")
            object.__setattr__(self, name, np.broadcast_to(value**2, (self.array.n,)).copy())
        if not self.dt > 0.0:
            raise ValueError("the sample interval must be positive")


class Fused(NamedTuple):
    """Output of a method for m samples; NaN where the sensors used do not span three axes.

    Attributes
    ----------
    x : (m, 3), rate [rad/s] or specific force [m/s^2], body FRD
    covariance : (m, 3, 3), of `x`: white noise and what is left of the drifts, by the method's own model
    drift : (m, n), drift of each sensor as estimated; zeros where a method estimates none
    compensation : (m, n), the part of it taken out of the reading before the filter saw it; zeros where a method compensates none
    """

    x: Array
    covariance: Array
    drift: Array
    compensation: Array


class Table(NamedTuple):
    """What a kernel needs to know of one set of sensors.

    Attributes
    ----------
    used : (n,), 1.0 or 0.0
    V : (dof, n), parity matrix T, zero columns for sensors not used; dof = 0 without redundancy
    R : (dof, dof), T diag(sigma^2) T'. The thesis' (5-66)-(5-70) have R itself, of another size
    W : (3, n), weighted least squares; NaN where there is none
    """

    used: Array
    V: Array
    R: Array
    W: Array


class FusionMethod(ABC):
    """A method of fusing the readings of one kind of sensor.

    Parameters
    ----------
    model : what is known of the sensors beforehand

    Notes
    -----
    Kernels go sample by sample: how samples are split into blocks changes no bit of the result. All memory is in `_state`.
    """

    name: ClassVar[str]
    title: ClassVar[str]
    oracle: ClassVar[bool] = False
    """True where the model must name the bad sensors beforehand."""

    def __init__(self, model: TriadModel) -> None:
        self.model = model
        self._tables: dict[int, Table] = {}
        self._state: tuple[Array, ...] = self._begin()

    @abstractmethod
    def _begin(self) -> tuple[Array, ...]:
        """Memory before the first sample."""

    @abstractmethod
    def _run(self, table: Table, z: Array, out: Fused) -> None:
        """Fuse a run of samples (m, n) of one set of sensors (zeros for those not used) into `out`."""

    def reset(self) -> None:
        """Forget every sample."""
        self._state = self._begin()

    def copy(self) -> Self:
        """Independent object in the same state, for a roll-back."""
        other = copy.copy(self)
        other._state = tuple(array.copy() for array in self._state)
        return other

    def process(self, readings: ArrayLike, mask: ArrayLike | None = None) -> Fused:
        """Fuse a block.

        Parameters
        ----------
        readings : (m, n), along the sensing axes, U
        mask : (m,) or one integer, bit i set: sensor i is used; None: all. A value that is not finite is never used

        Raises
        ------
        ValueError
            The readings are not (m, n).
        """
        n = self.model.array.n
        z = np.array(readings, dtype=np.float64)
        if z.ndim != 2 or z.shape[1] != n:
            raise ValueError(f"readings must be (m, {n})")
        every = (1 << n) - 1
        key = np.full(len(z), every, dtype=np.uint64) if mask is None else np.broadcast_to(np.asarray(mask, dtype=np.uint64), len(z)).copy()
        key &= np.uint64(every)
        finite = np.isfinite(z)
        if not finite.all():
            weight = np.left_shift(np.uint64(1), np.arange(n, dtype=np.uint64))
            key &= np.sum(np.where(finite, weight, np.uint64(0)), axis=1, dtype=np.uint64)
            z[~finite] = 0.0
        out = Fused(np.empty((len(z), 3)), np.empty((len(z), 3, 3)), np.zeros((len(z), n)), np.zeros((len(z), n)))
        for start, stop in _runs(key):
            table = self.table(int(key[start]))
            z[start:stop] *= table.used
            self._run(table, z[start:stop], Fused(*(array[start:stop] for array in out)))
        return out

    def table(self, key: int) -> Table:
        """Table of a set of sensors."""
        if key not in self._tables:
            if len(self._tables) >= _MOST_TABLES:
                self._tables.clear()
            self._tables[key] = _table(self.model, key)
        return self._tables[key]


def _table(model: TriadModel, key: int) -> Table:
    n = model.array.n
    used = np.array([float((key >> i) & 1) for i in range(n)])
    try:
        V = model.array.parity_full(key)
        W = model.array.least_squares(key, np.sqrt(model.R))
    except ValueError:  # they do not span three axes
        V, W = np.zeros((0, n)), np.full((3, n), np.nan)
    return Table(used, V, (V * model.R) @ V.T, W)


def _runs(key: NDArray[np.uint64]) -> Iterator[tuple[int, int]]:
    """Beginning and end of each run of equal values."""
    if len(key):
        edge = [0, *(np.flatnonzero(key[1:] != key[:-1]) + 1).tolist(), len(key)]
        yield from itertools.pairwise(edge)
