"""What the simulated sensors have in common as nodes: parameters, scenario, pacing, fault services.

Lives here: `SimSettings`, `SimNode`, `SensorNode`.
Does not live here: what a sensor reads (riins_sim.sensors), what a message holds (riins_node.fields).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from rclpy.node import Node

from riins_core.settings import SettingError, setting
from riins_msgs.msg import FaultArray
from riins_msgs.srv import ClearFaults, InjectFault
from riins_node import fields, qos
from riins_node.convert import fill, read_fault
from riins_node.pace import Pacer, Stream
from riins_node.parameters import declare

from .. import scenario as scenarios
from ..faults import Fault, FaultSchedule, FaultType


@dataclass(frozen=True)
class SimSettings:
    """Parameters of a simulated sensor."""

    scenario: str = setting("harbour", "scenario: the name of a shipped one or a YAML file")
    start_at_ns: int = setting(0, "measurement time of sample 0, the same for all sensors of a run; 0: now", "ns", low=0)
    rate: float = setting(1.0, "speed in times real time", low=0.01, high=100.0)
    seed: int = setting(-1, "seed of all noise; -1: the scenario's", low=-1, high=2**31 - 1)
    k_start: int = setting(-1, "first sample to publish; -1: the next that falls due, so a restarted node goes on where it would be", low=-1)


class SimNode(Node):
    """Base of the nodes of a simulated run.

    Parameters
    ----------
    name : of the node
    """

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self.settings = self._declare()
        self.scenario = scenarios.load(self.settings.scenario).with_seed(self.settings.seed)
        self._streams: list[Stream] = []

    def _declare(self) -> SimSettings:
        return declare(self, SimSettings)

    def begin(self) -> None:
        """Start the clock; call it when everything slow (trajectory, compilation) is done."""
        self.pacer = Pacer(self, self.settings.start_at_ns, self.settings.rate)

    def pace(self, period_ns: int, samples: int, emit: Any, k_start: int | None = None) -> Stream:
        """Call `emit(k0, m)` for samples k_start .. samples as they fall due; then the stream ends."""
        first = self.settings.k_start if k_start is None else k_start
        if first == 0 or (first < 0 and self.settings.start_at_ns == 0):
            first = 1  # sample 0 is the start itself, nobody measures there

        def bounded(k0: int, m: int) -> None:
            if k0 <= samples:
                emit(k0, min(m, samples + 1 - k0))
            if k0 + m > samples:
                stream.stop()
                self.get_logger().info(f"end of scenario {self.scenario.name} at sample {samples}")

        stream = self.pacer.stream(period_ns, bounded, first)
        self._streams.append(stream)
        start, rate = self.pacer.start_at_ns, self.settings.rate
        self.get_logger().info(f"{self.scenario.name}: start at {start} ns, first sample {stream.next_k}, {rate:g} x real time")
        return stream


class SensorNode(SimNode, ABC):
    """Base of the simulated sensors, with the services that put faults on them.

    Parameters
    ----------
    name : of the node
    targets : what its faults may be put on: "gyro", "accel" or the name of an aid
    frame_id : of its messages
    """

    def __init__(self, name: str, targets: Sequence[str], frame_id: str) -> None:
        super().__init__(name)
        self.frame_id = frame_id
        self.faults = self.scenario.fault_schedule().only(targets)
        self._targets = targets

    def begin(self) -> None:
        """Start the clock and the fault services."""
        super().begin()
        self._fault_publisher = self.create_publisher(FaultArray, "truth/faults", qos.latched(), qos_overriding_options=qos.overridable())
        self.create_service(InjectFault, "~/inject_fault", self._inject)
        self.create_service(ClearFaults, "~/clear_faults", self._clear)
        self._publish_faults()

    @abstractmethod
    def next_stamp_ns(self) -> int:
        """Stamp of the next sample, ns since the start."""

    def _inject(self, request: InjectFault.Request, response: InjectFault.Response) -> InjectFault.Response:
        try:
            values = read_fault(request.fault, self.pacer.start_at_ns)
            if values["start_ns"] is None:
                values["start_ns"] = self.next_stamp_ns()
            fault = Fault(**{**values, "type": FaultType(values["type"])})
            if not FaultSchedule([fault]).only(self._targets).faults or not self._exists(fault):
                raise SettingError(f"this node has no {fault.target}")
            if not 0 <= fault.start_ns <= round(self.scenario.duration_s * 1e9):  # a ramp of years, or a fault that never comes
                late = f"{fault.start_ns * 1e-9:.3f} s after the start of the run, which lasts {self.scenario.duration_s:g} s"
                raise SettingError(f"the fault is to begin {late}")
        except ValueError as error:
            response.success, response.message = False, str(error)
            return response
        self.faults.add(fault)
        self._publish_faults()
        response.success, response.message = True, f"{fault.type.name.lower()} on {fault.target} from {fault.start_ns * 1e-9:.3f} s"
        self.get_logger().warning(response.message)
        return response

    def _exists(self, fault: Fault) -> bool:
        return True

    def _clear(self, request: ClearFaults.Request, response: ClearFaults.Response) -> ClearFaults.Response:
        word = request.target.partition("_")[0]
        response.success = request.target in ("", *self._targets) or word in self._targets
        response.cleared = self.faults.clear(request.target) if response.success else 0
        response.message = f"{response.cleared} faults cleared" if response.success else f"this node has no {request.target}"
        self._publish_faults()
        return response

    def _publish_faults(self) -> None:
        message = fields.fault_array(max(self.pacer.now_ns(), 0), self.faults.faults, self.pacer.start_at_ns)
        message["header"]["frame_id"] = self.frame_id  # tells the nodes' arrays apart, also an empty one
        self._fault_publisher.publish(fill(FaultArray, message))
