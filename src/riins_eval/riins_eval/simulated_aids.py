"""The simulated aids of a run, and what the navigator's declared aids read of them: the numbers of their messages, to the bit.

Lives here: `SimulatedAids`, `aids_of`.
Does not live here: the sensors (riins_sim), what a message says (riins_node.readings), the engine that feeds them (offline.py).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from riins_federated.aid_inputs import AidInput, inputs
from riins_federated.config import NavigatorConfig
from riins_federated.types import Aid
from riins_node import fields
from riins_sim import suite
from riins_sim.faults import Fault, FaultSchedule
from riins_sim.further_sensors import AttitudeBlock, HeightBlock
from riins_sim.scenario import Scenario
from riins_sim.sensors import PositionBlock, VelocityBlock
from riins_sim.trajectory import Trajectory

Stamps = NDArray[np.int64]
Block = PositionBlock | VelocityBlock | HeightBlock | AttitudeBlock
Found = dict[str, tuple[Stamps, Any]]


class SimulatedAids:
    """The aids of a scenario on one trajectory.

    Parameters
    ----------
    scenario : which aids there are, and their errors
    trajectory : the motion
    config : of the navigator; its declared aids that name a topic of a simulated one are fed
    start_at_ns : measurement time of sample 0

    Attributes
    ----------
    sensors : by name
    """

    def __init__(self, scenario: Scenario, trajectory: Trajectory, config: NavigatorConfig, start_at_ns: int) -> None:
        self.sensors = suite.sensors(scenario, trajectory)
        self._start = start_at_ns
        told = {source.topic.strip("/"): source for source in inputs(config.aid)}
        self._feeds = [(name, topic, told[topic]) for name in self.sensors for topic in suite.TOPICS[name] if topic in told]
        self._sensor_of = {source.name: name for name, _, source in self._feeds}

    def between(self, first_ns: int, last_ns: int, faults: FaultSchedule | None) -> Found:
        """Blocks by sensor with stamps in (first_ns, last_ns] since the start; beside each block its absolute stamps. Without faults: None."""
        found: Found = {}
        for name, sensor in self.sensors.items():
            k0, k1 = first_ns // sensor.period_ns + 1, min(last_ns // sensor.period_ns, sensor.samples)
            if k1 >= k0:
                block = sensor.block(k0, k1 - k0 + 1, faults)
                found[name] = (self._start + block.stamp_ns, block)
        return found

    def read(self, found: Found) -> list[Aid]:
        """What the declared aids read of blocks, in order of stamps."""
        made: list[Aid] = []
        for name, topic, source in self._feeds:
            if name in found:
                stamps, block = found[name]
                fast = (isinstance(block, PositionBlock) and topic == suite.TOPICS[name][0]) or (name == "doppler" and source.input.part == "")
                made += aids_of(source.name, stamps - source.delay_ns, block) if fast else _read(source, topic, stamps, block)
        return sorted(made, key=lambda aid: aid.stamp_ns)

    def lies(self, aid: Aid, faults: Iterable[Fault]) -> bool:
        """Whether a fault is in force on the sensor behind a measurement."""
        sensor = self._sensor_of[aid.name]
        return any(f.target == sensor and f.in_force(aid.stamp_ns - self._start) for f in faults)


def aids_of(name: str, stamp_ns: Stamps, block: PositionBlock | VelocityBlock) -> list[Aid]:
    """Measurements of a receiver's positions or of a log, with the values that its message would carry (degrees)."""
    if isinstance(block, VelocityBlock):
        return [Aid(name, int(t), v, block.covariance) for t, v, good in zip(stamp_ns, block.v_b, block.valid, strict=True) if good]
    z = np.column_stack([np.radians(np.degrees(block.lat)), np.radians(np.degrees(block.lon)), block.h])
    return [Aid(name, int(t), row, block.covariance, bool(good)) for t, row, good in zip(stamp_ns, z, block.has_fix, strict=True)]


def _read(source: AidInput, topic: str, stamp_ns: Stamps, block: Block) -> list[Aid]:
    """The way of a message: what fields.py puts into it, read by the reader of the declared aid; what is not valid is no message."""
    read = (source.read(message) for message in _messages(topic, stamp_ns, block))
    return [aid for aid in read if aid is not None]


def _messages(topic: str, stamp_ns: Stamps, block: Block) -> Iterator[Any]:
    good = np.flatnonzero(block.has_fix if isinstance(block, PositionBlock) else block.valid)
    if not good.size:
        return iter(())
    stamps = stamp_ns[good]
    if isinstance(block, PositionBlock):
        content = fields.velocity(stamps, block.v_n[good], block.velocity_covariance)
    elif isinstance(block, VelocityBlock):
        content = fields.doppler(stamps, block.v_b[good], block.covariance, f"{topic.partition('/')[0]}_link")
    elif isinstance(block, HeightBlock):
        content = fields.height(stamps, block.h[good], block.variance, f"{topic.partition('/')[0]}_link")
    else:
        content = fields.attitude(stamps, block.rph[good], block.covariance)
    return (_row(content, i) for i in range(len(good)))


def _row(content: dict[str, Any], i: int) -> SimpleNamespace:
    """Row i of columns as a message with attributes; a covariance of one dimension is that of all rows."""
    row: dict[str, Any] = {}
    for key, value in content.items():
        if isinstance(value, dict):
            row[key] = _row(value, i)
        elif key == "stamp":
            seconds, nanoseconds = divmod(int(value[i]), 1_000_000_000)
            row[key] = SimpleNamespace(sec=seconds, nanosec=nanoseconds)
        elif isinstance(value, np.ndarray) and (key != "covariance" or value.ndim == 2):
            row[key] = value[i]
        else:
            row[key] = value
    return SimpleNamespace(**row)
