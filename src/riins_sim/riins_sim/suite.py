"""The aids of a scenario: which there are, the topics of their messages, and the sensors that make them.

Lives here: `TOPICS`, `sensors`.
Does not live here: the sensors (sensors.py, further_sensors.py), messages (nodes/), what the navigator makes of them.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from .faults import AIDS
from .further_sensors import AltimeterSim, OdometerSim, StarTrackerSim
from .sensors import DopplerSim, PositionSim
from .trajectory import Trajectory

if TYPE_CHECKING:
    from .scenario import Scenario

TOPICS: dict[str, tuple[str, ...]] = {
    "gps": ("gps/fix", "gps/velocity"),
    "bds": ("bds/fix", "bds/velocity"),
    "doppler": ("doppler/velocity",),
    "odometer": ("odometer/velocity",),
    "altimeter": ("altimeter/height",),
    "star_tracker": ("star_tracker/attitude",),
}
"""What the node of each aid publishes, relative to the namespace; the first is always there."""
_MAKERS: dict[str, Callable[..., Any]] = {
    "gps": functools.partial(PositionSim, name="gps"),
    "bds": functools.partial(PositionSim, name="bds"),
    "doppler": DopplerSim,
    "odometer": OdometerSim,
    "altimeter": AltimeterSim,
    "star_tracker": StarTrackerSim,
}


def enabled(scenario: Scenario) -> list[str]:
    """Names of the aids that a scenario has."""
    return [name for name in AIDS if getattr(scenario, name).enabled]


def sensors(scenario: Scenario, trajectory: Trajectory) -> dict[str, Any]:
    """The simulated aids of a scenario by name, on one trajectory."""
    return {name: _MAKERS[name](scenario, trajectory=trajectory) for name in enabled(scenario)}
