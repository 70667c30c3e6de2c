"""Nodes `gps` and `bds`: a satellite receiver of a scenario on /NAME/fix and /NAME/velocity.

Lives here: parameters in, messages out. An outage is a NavSatFix with STATUS_NO_FIX.
Does not live here: what a receiver reads (riins_sim.sensors).
"""

from __future__ import annotations

from collections.abc import Sequence

from geometry_msgs.msg import TwistWithCovarianceStamped
from sensor_msgs.msg import NavSatFix

from riins_node import fields, qos
from riins_node.convert import fill
from riins_node.parameters import ParameterError
from riins_node.runner import run

from ..sensors import PositionSim
from .common import SensorNode


class GnssNode(SensorNode):
    """Publishes sensor_msgs/NavSatFix and, with a fix, the velocity of the antenna in ENU."""

    def __init__(self, name: str) -> None:
        super().__init__(name, (name,), f"{name}_link")
        if not getattr(self.scenario, name).enabled:
            raise ParameterError(f"scenario {self.scenario.name} has {name} disabled")
        self._receiver = PositionSim(self.scenario, name)
        self._receiver.block(1, 1, self.faults)  # compiles
        self._fix = self.create_publisher(NavSatFix, f"{name}/fix", qos.aid(), qos_overriding_options=qos.overridable())
        self._velocity = self.create_publisher(TwistWithCovarianceStamped, f"{name}/velocity", qos.aid(), qos_overriding_options=qos.overridable())
        self._service = fields.SERVICE[name]
        self.begin()
        self._stream = self.pace(self._receiver.period_ns, self._receiver.samples, self._emit)

    def next_stamp_ns(self) -> int:
        """Stamp of the next fix, ns since the start."""
        return self._stream.next_k * self._receiver.period_ns

    def _emit(self, k0: int, m: int) -> None:
        block = self._receiver.block(k0, m, self.faults)
        for i in range(m):
            stamp, has_fix = self.pacer.start_at_ns + int(block.stamp_ns[i]), bool(block.has_fix[i])
            place = block.lat[i], block.lon[i], block.h[i]
            fix = fields.position_fix(stamp, *place, block.covariance, self.frame_id, self._service, has_fix)
            self._fix.publish(fill(NavSatFix, fix))
            if has_fix:
                velocity = fields.velocity(stamp, block.v_n[i], block.velocity_covariance)
                self._velocity.publish(fill(TwistWithCovarianceStamped, velocity))


def serve(name: str, args: Sequence[str] | None) -> int:
    """Run the receiver of that name."""
    return run(lambda: GnssNode(name), args, name)
