"""The fusion methods by name.

Lives here: `METHODS` and `make`, by which nodes, studies and tests select a method.
Does not live here: the methods themselves, each in its own module.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from .adaptive import AdaptiveFusion
from .drift_compensated import DriftCompensatedFusion
from .glr_kf import GlrKalman
from .method import FusionMethod, TriadModel
from .optimal import OptimalFusion
from .wls import WeightedLeastSquares

METHODS: dict[str, Callable[..., FusionMethod]] = {
    method.name: method for method in (WeightedLeastSquares, OptimalFusion, AdaptiveFusion, DriftCompensatedFusion, GlrKalman)
}
"""Classes by name; `name`, `title` and `oracle` (True: the model must name the bad sensors) are attributes of each."""


def make(name: str, model: TriadModel, *settings: Any) -> FusionMethod:
    """A method by its name.

    Parameters
    ----------
    name : of `METHODS`
    model : what is known of the sensors beforehand
    settings : the method's own settings, where it has some; none: its defaults

    Raises
    ------
    ValueError
        There is no such method.
    """
    if name not in METHODS:
        raise ValueError(f'there is no fusion method "{name}"; there are {", ".join(METHODS)}')
    return METHODS[name](model, *settings)
