"""Node `odometer`: the odometer of a scenario on /odometer/velocity.

Lives here: what its message holds. A dropped-out odometer sends no message.
Does not live here: parameters and pacing (aid.py), what the sensor reads (riins_sim.further_sensors).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from geometry_msgs.msg import TwistWithCovarianceStamped

from riins_node import fields

from ..further_sensors import OdometerSim
from .aid import Served, serve


def content(stamp_ns: int, block: Any, i: int) -> fields.Fields:
    """Row i of a block as a message."""
    return fields.doppler(stamp_ns, block.v_b[i], block.covariance, "odometer_link")


def main(args: Sequence[str] | None = None) -> int:
    """Entry point."""
    return serve(Served("odometer", "odometer/velocity", TwistWithCovarianceStamped, OdometerSim, content), args)


if __name__ == "__main__":
    raise SystemExit(main())
