"""Node `doppler`: the Doppler log of a scenario on /doppler/velocity.

Lives here: parameters in, messages out. Without bottom lock there is no message.
Does not live here: what the log reads (riins_sim.sensors).
"""

from __future__ import annotations

from collections.abc import Sequence

from geometry_msgs.msg import TwistWithCovarianceStamped

from riins_node import fields, qos
from riins_node.convert import fill
from riins_node.parameters import ParameterError
from riins_node.runner import run

from ..sensors import DopplerSim
from .common import SimNode


class DopplerNode(SimNode):
    """Publishes geometry_msgs/TwistWithCovarianceStamped in doppler_link (FLU)."""

    def __init__(self) -> None:
        super().__init__("doppler", ("doppler",), "doppler_link")
        if not self.scenario.doppler.enabled:
            raise ParameterError(f"scenario {self.scenario.name} has doppler disabled")
        self._log = DopplerSim(self.scenario)
        self._log.block(1, 1, self.faults)  # compiles
        self._publisher = self.create_publisher(TwistWithCovarianceStamped, "doppler/velocity", qos.aid(), qos_overriding_options=qos.overridable())
        self.begin()
        self._stream = self.pace(self._log.period_ns, self._log.samples, self._emit)

    def next_stamp_ns(self) -> int:
        """Stamp of the next measurement, ns since the start."""
        return self._stream.next_k * self._log.period_ns

    def _emit(self, k0: int, m: int) -> None:
        block = self._log.block(k0, m, self.faults)
        for i in range(m):
            if block.valid[i]:
                message = fields.doppler(self.pacer.start_at_ns + int(block.stamp_ns[i]), block.v_b[i], block.covariance, self.frame_id)
                self._publisher.publish(fill(TwistWithCovarianceStamped, message))


def main(args: Sequence[str] | None = None) -> int:
    """Entry point."""
    return run(DopplerNode, args, "doppler")


if __name__ == "__main__":
    raise SystemExit(main())
