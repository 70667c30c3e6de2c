"""Node `star_tracker`: the star sensor of a scenario on /star_tracker/attitude.

Lives here: what its message holds. Without stars there is no message.
Does not live here: parameters and pacing (aid.py), what the sensor reads (riins_sim.further_sensors).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from geometry_msgs.msg import PoseWithCovarianceStamped

from riins_node import fields

from ..further_sensors import StarTrackerSim
from .aid import Served, serve


def content(stamp_ns: int, block: Any, i: int) -> fields.Fields:
    """Row i of a block as a message."""
    return fields.attitude(stamp_ns, block.rph[i], block.covariance)


def main(args: Sequence[str] | None = None) -> int:
    """Entry point."""
    return serve(Served("star_tracker", "star_tracker/attitude", PoseWithCovarianceStamped, StarTrackerSim, content), args)


if __name__ == "__main__":
    raise SystemExit(main())
