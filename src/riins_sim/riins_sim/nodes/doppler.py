"""Node `doppler`: the Doppler log of a scenario on /doppler/velocity.

Lives here: what its message holds. Without bottom lock there is no message.
Does not live here: parameters and pacing (aid.py), what the log reads (riins_sim.sensors).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from geometry_msgs.msg import TwistWithCovarianceStamped

from riins_node import fields

from ..sensors import DopplerSim
from .aid import Served, serve


def content(stamp_ns: int, block: Any, i: int) -> fields.Fields:
    """Row i of a block as a message."""
    return fields.doppler(stamp_ns, block.v_b[i], block.covariance)


def main(args: Sequence[str] | None = None) -> int:
    """Entry point."""
    return serve(Served("doppler", "doppler/velocity", TwistWithCovarianceStamped, DopplerSim, content), args)


if __name__ == "__main__":
    raise SystemExit(main())
