"""Node `altimeter`: the altimeter of a scenario on /altimeter/height.

Lives here: what its message holds. A dropped-out altimeter sends no message.
Does not live here: parameters and pacing (aid.py), what the sensor reads (riins_sim.further_sensors).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from geometry_msgs.msg import PoseWithCovarianceStamped

from riins_node import fields

from ..further_sensors import AltimeterSim
from .aid import Served, serve


def content(stamp_ns: int, block: Any, i: int) -> fields.Fields:
    """Row i of a block as a message."""
    return fields.height(stamp_ns, float(block.h[i]), block.variance)


def main(args: Sequence[str] | None = None) -> int:
    """Entry point."""
    return serve(Served("altimeter", "altimeter/height", PoseWithCovarianceStamped, AltimeterSim, content), args)


if __name__ == "__main__":
    raise SystemExit(main())
