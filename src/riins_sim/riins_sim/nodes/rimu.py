"""Node `rimu`: the redundant IMU of a scenario on /rimu/raw.

Lives here: parameters in, messages out.
Does not live here: what the sensors read (riins_sim.sensors).
"""

from __future__ import annotations

from collections.abc import Sequence

from riins_msgs.msg import RedundantImu
from riins_node import fields, qos
from riins_node.convert import fill
from riins_node.runner import run

from ..faults import Fault
from ..sensors import RedundantImuSim
from .common import SensorNode


class RimuNode(SensorNode):
    """Publishes riins_msgs/RedundantImu at the IMU rate."""

    def __init__(self) -> None:
        super().__init__("rimu", ("gyro", "accel"), "imu_link")
        self._imu = RedundantImuSim(self.scenario)
        self._imu.block(1, 1, self.faults)  # compiles
        self._publisher = self.create_publisher(RedundantImu, "rimu/raw", qos.imu(), qos_overriding_options=qos.overridable())
        self.begin()
        self._stream = self.pace(int(self._imu.stamp_ns(1)), self._imu.samples, self._emit)

    def next_stamp_ns(self) -> int:
        """Stamp of the next sample, ns since the start."""
        return int(self._imu.stamp_ns(self._stream.next_k))

    def _exists(self, fault: Fault) -> bool:
        return int(fault.target.partition("_")[2]) < self._imu.array.n

    def _emit(self, k0: int, m: int) -> None:
        block = self._imu.block(k0, m, self.faults)
        for i in range(len(block.k)):
            message = fields.redundant_imu(
                self.pacer.start_at_ns + int(block.stamp_ns[i]),
                int(block.k[i]) & 0xFFFFFFFF,
                block.gyro[i],
                block.accel[i],
                int(block.gyro_valid[i]),
                int(block.accel_valid[i]),
                self.frame_id,
            )
            self._publisher.publish(fill(RedundantImu, message))


def main(args: Sequence[str] | None = None) -> int:
    """Entry point."""
    return run(RimuNode, args, "rimu")


if __name__ == "__main__":
    raise SystemExit(main())
