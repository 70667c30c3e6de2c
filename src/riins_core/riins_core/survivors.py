"""What a sensor geometry can still do when sensors of it are isolated: the worst choice, in the worst direction.

Lives here: `worst_case_after_isolation`, `worst_sigma_by_direction`.
Does not live here: the geometry and its figures of merit (imu_array), which sensor is isolated and why (riins_fdi).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .imu_array import ImuArray

Array = NDArray[np.float64]

_ALIKE = 1e-9
"""Relative difference below which two choices are equally bad: symmetric geometries have many."""


class IsolationRow(NamedTuple):
    """Accuracy left after isolating the worst choice of sensors."""

    isolated: int
    """number of sensors taken out"""
    gdop: float
    """largest GDOP of any choice; inf when a choice leaves fewer than three axes"""
    sigma_worst: float
    """largest standard deviation in any direction, in units of one sensor's sigma; inf likewise"""
    accuracy_figure: float
    """least J_p of any choice"""
    singular: int
    """choices that leave fewer than three axes"""
    choices: int
    sensors: tuple[int, ...]
    """the choice with `sigma_worst`, from 0; the first in order where several are equally bad"""
    direction: tuple[float, float, float] | None
    """unit vector in body axes along which that choice has `sigma_worst`, its largest component positive; None: it is the same in every direction"""
    alike: int
    """choices as bad as `sensors`"""


def worst_case_after_isolation(array: ImuArray, isolated: tuple[int, ...] = (0, 1, 2, 3)) -> list[IsolationRow]:
    """Worst accuracy over every choice of sensors taken out.

    Parameters
    ----------
    array : the geometry
    isolated : numbers of sensors taken out

    Returns
    -------
    one row for each number

    Raises
    ------
    ValueError
        Fewer than three sensors would be left.
    """
    rows = []
    for count in isolated:
        outs, sigma, gdop, figure, direction = [], [], [], [], []
        for out, h in _survivors(array, count):
            information, axes = np.linalg.eigh(h.T @ h)
            lost = _covariance(array, out) is None
            outs.append(out)
            sigma.append(math.inf if lost else 1.0 / math.sqrt(information[0]))
            gdop.append(math.inf if lost else math.sqrt(float(np.sum(1.0 / information))))
            figure.append(0.0 if lost else float(np.prod(information)))
            isotropic = information[2] - information[0] < _ALIKE * information[2]
            direction.append(None if isotropic else np.round(axes[:, 0] * np.sign(axes[np.argmax(np.abs(axes[:, 0])), 0]), 12) + 0.0)
        worst = max(sigma)
        alike = [i for i, value in enumerate(sigma) if value == worst or value >= worst * (1.0 - _ALIKE)]
        first = alike[0]
        toward = direction[first]
        along = None if toward is None else (float(toward[0]), float(toward[1]), float(toward[2]))
        singular = sum(math.isinf(value) for value in sigma)
        rows.append(IsolationRow(count, max(gdop), worst, min(figure), singular, len(outs), outs[first], along, len(alike)))
    return rows


def worst_sigma_by_direction(array: ImuArray, directions: ArrayLike, isolated: int) -> Array:
    """Standard deviation of the least-squares estimate along each direction, the worst over every choice of sensors taken out.

    Parameters
    ----------
    array : the geometry
    directions : (k, 3), unit vectors in body axes
    isolated : number of sensors taken out

    Returns
    -------
    (k,), in units of one sensor's sigma; inf everywhere when a choice leaves fewer than three axes

    Raises
    ------
    ValueError
        Fewer than three sensors would be left.
    """
    toward = np.asarray(directions, dtype=np.float64)
    worst = np.zeros(len(toward))
    for out, _ in _survivors(array, isolated):
        covariance = _covariance(array, out)
        if covariance is None:
            return np.full(len(toward), np.inf)
        worst = np.maximum(worst, np.sqrt(np.einsum("ki,ij,kj->k", toward, covariance, toward)))
    return worst


def _survivors(array: ImuArray, count: int) -> Iterator[tuple[tuple[int, ...], Array]]:
    if not 0 <= count <= array.n - 3:
        raise ValueError(f"cannot isolate {count} of {array.n} sensors and keep three")
    for out in itertools.combinations(range(array.n), count):
        yield out, np.delete(array.H, out, axis=0)


def _covariance(array: ImuArray, out: tuple[int, ...]) -> Array | None:
    """Covariance of what is left, None where it does not span three axes."""
    use = np.ones(array.n, dtype=bool)
    use[list(out)] = False
    try:
        return array.covariance(use)
    except ValueError:
        return None
