"""What the nodes of aids with one topic have in common: a block of the sensor becomes messages as its samples fall due.

Lives here: `Served`, `AidNode`, `serve`. What is not valid is no message.
Does not live here: what a sensor reads (riins_sim.sensors, riins_sim.further_sensors), what its message holds (the node's own file).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from riins_node import fields, qos
from riins_node.convert import fill
from riins_node.parameters import ParameterError
from riins_node.runner import run

from ..scenario import Scenario
from .common import SensorNode


class Served(NamedTuple):
    """A sensor as a node: its name (of the node, of the scenario's section, of its faults), topic, message type, simulation, and row to message."""

    name: str
    topic: str
    kind: type[Any]
    sensor: Callable[[Scenario], Any]
    content: Callable[[int, Any, int], fields.Fields]


class AidNode(SensorNode):
    """Publishes the measurements of one aid."""

    def __init__(self, served: Served) -> None:
        super().__init__(served.name, (served.name,), f"{served.name}_link")
        if not getattr(self.scenario, served.name).enabled:
            raise ParameterError(f"scenario {self.scenario.name} has {served.name} disabled")
        self._served, self._sensor = served, served.sensor(self.scenario)
        self._sensor.block(1, 1, self.faults)  # compiles
        self._publisher = self.create_publisher(served.kind, served.topic, qos.aid(), qos_overriding_options=qos.overridable())
        self.begin()
        self._stream = self.pace(self._sensor.period_ns, self._sensor.samples, self._emit)

    def next_stamp_ns(self) -> int:
        """Stamp of the next measurement, ns since the start."""
        return int(self._stream.next_k * self._sensor.period_ns)

    def _emit(self, k0: int, m: int) -> None:
        block = self._sensor.block(k0, m, self.faults)
        for i in range(m):
            if block.valid[i]:
                content = self._served.content(self.pacer.start_at_ns + int(block.stamp_ns[i]), block, i)
                self._publisher.publish(fill(self._served.kind, content))


def serve(served: Served, args: Sequence[str] | None) -> int:
    """Run the node."""
    return run(lambda: AidNode(served), args, served.name)
