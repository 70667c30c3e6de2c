"""The node navigator with a Doppler log that speaks marine_acoustic_msgs/Dvl, a package that is not installed where this is developed.

Lives here: a class with the fields of that message and the types rclpy gives them; what the node subscribes to and makes of it.
Does not live here: the readers alone (riins_node), recordings of the message (riins_eval), the models of the aids (test_fed_aids.py).
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs ROS 2")
pytest.importorskip("riins_msgs.msg", reason="needs riins_msgs built by colcon and its environment")

import rclpy
from geometry_msgs.msg import Vector3
from std_msgs.msg import Header

from riins_federated.node import NavigatorNode
from riins_msgs.msg import FusedImu, InitialState
from riins_node import convert, fields

os.environ["ROS_DOMAIN_ID"] = str(100 + (os.getpid() + 66) % 80)
os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")

DT, START = 10_000_000, 1_700_000_000_000_000_000
SPEED = np.array([3.0, 0.2, 0.0])  # forward, starboard, down
CURRENT = np.array([0.0, 0.4, 0.0])  # the water runs to starboard
AZIMUTH = np.radians([45.0, 135.0, 225.0, 315.0])
BEAMS = np.column_stack([0.5 * np.cos(AZIMUTH), 0.5 * np.sin(AZIMUTH), np.full(4, np.sqrt(0.75))])  # forward, starboard, down
SHIP = """
/**:
  ros__parameters:
    aids: [ground, water, beams]
    ground: {type: body_velocity, message: dvl, topic: dvl/dvl, sigma_mps: [0.03, 0.03, 0.03], misalignment_deg: 0.0, use_down: true}
    water: {type: water_velocity, message: dvl, topic: dvl/dvl, sigma_mps: [0.03, 0.03, 0.03], misalignment_deg: 0.0}
    beams: {type: beam_velocity, topic: dvl/dvl, sigma_mps: 0.03, misalignment_deg: 0.0}
"""


@dataclass(slots=True)
class Dvl:
    """Every field of marine_acoustic_msgs/Dvl and no other; axes forward, starboard, down; a covariance of -1 is not known."""

    header: Header = field(default_factory=Header)
    velocity_mode: int = 1  # DVL_MODE_BOTTOM 1, DVL_MODE_WATER 2
    dvl_type: int = 0
    velocity: Vector3 = field(default_factory=Vector3)
    velocity_covar: np.ndarray = field(default_factory=lambda: np.full(9, -1.0))
    altitude: float = 50.0
    course_gnd: float = 0.0
    speed_gnd: float = 0.0
    num_good_beams: int = 4
    sound_speed: float = 1500.0
    beam_ranges_valid: bool = True
    beam_velocities_valid: bool = True
    beam_unit_vec: list[Vector3] = field(default_factory=lambda: [Vector3(x=x, y=y, z=z) for x, y, z in BEAMS.tolist()])
    range: np.ndarray = field(default_factory=lambda: np.full(4, 50.0 / BEAMS[0, 2]))
    range_covar: np.ndarray = field(default_factory=lambda: np.full(4, -1.0, np.float32))
    beam_quality: np.ndarray = field(default_factory=lambda: np.zeros(4, np.float32))
    beam_velocity: np.ndarray = field(default_factory=lambda: np.zeros(4, np.float32))
    beam_velocity_covar: np.ndarray = field(default_factory=lambda: np.full(4, -1.0, np.float32))


def dvl(second: int, v: np.ndarray, **changes: Any) -> Dvl:
    """What a log says that moves at v, forward, starboard, down, m/s."""
    header = Header(stamp=convert.to_stamp(START + second * 1_000_000_000), frame_id="dvl_link")
    beams = (BEAMS @ v).astype(np.float32)
    return Dvl(**{"header": header, "velocity": Vector3(x=v[0], y=v[1], z=v[2]), "beam_velocity": beams, **changes})


@pytest.fixture
def node(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[NavigatorNode, dict[str, list[Callable[[Any], None]]]]]:
    """The node, started, and the callbacks of its subscriptions to Dvl by topic: rclpy itself cannot subscribe to a class of Python."""
    package, messages = ModuleType("marine_acoustic_msgs"), ModuleType("marine_acoustic_msgs.msg")
    messages.Dvl = Dvl  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "marine_acoustic_msgs", package)
    monkeypatch.setitem(sys.modules, "marine_acoustic_msgs.msg", messages)
    taken: dict[str, list[Callable[[Any], None]]] = {}
    subscribe = NavigatorNode.create_subscription

    def create_subscription(self: NavigatorNode, kind: Any, topic: str, callback: Callable[[Any], None], *args: Any, **more: Any) -> Any:
        if kind is Dvl:
            taken.setdefault(topic, []).append(callback)
            return None
        return subscribe(self, kind, topic, callback, *args, **more)

    monkeypatch.setattr(NavigatorNode, "create_subscription", create_subscription)
    file = tmp_path / "ship.yaml"
    file.write_text(SHIP)
    rclpy.init(args=["--ros-args", "--params-file", str(file)])
    made = NavigatorNode()
    made.start()
    yield made, taken
    made.destroy_node()
    rclpy.try_shutdown()


def test_a_dvl_over_ground_through_the_water_and_by_beams(node: Any) -> None:
    navigator, taken = node
    assert {topic: len(callbacks) for topic, callbacks in taken.items()} == {"dvl/dvl": 3}  # one message is for three aids
    judged: list[Any] = []
    navigator._published["nav/innovations"].publish = judged.append
    state = {"header": fields.header(START, "map_ned"), "latitude": 40.0, "longitude": 120.0, "heading": np.pi / 2}  # starboard is south
    state |= {"velocity_north": -SPEED[1], "velocity_east": SPEED[0], "sigma_position": np.full(3, 10.0), "sigma_velocity": np.full(3, 0.02)}
    navigator._on_initial_state(convert.fill(InitialState, {**state, "sigma_attitude": np.full(3, 1e-3)}))
    lost = dvl(1, SPEED).beam_velocity
    lost[2] = np.nan
    known = np.diag([4e-4, 4e-4, 9e-4]).ravel()
    said = [
        dvl(1, SPEED, velocity_covar=known, beam_velocity=lost, beam_velocity_covar=np.full(4, 1e-3, np.float32), num_good_beams=3),
        dvl(2, SPEED - CURRENT, velocity_mode=2),
        dvl(3, SPEED),
        dvl(4, np.zeros(3), num_good_beams=2, beam_velocities_valid=False),  # no bottom: what it says is not to be used
        dvl(5, SPEED * [1.0, -1.0, 1.0]),  # as axes forward, port, up would have it
    ]
    for message in said:
        for callback in taken["dvl/dvl"]:
            callback(message)
    eye, zero, up = np.eye(3), np.zeros(3), np.array([0.0, 0.0, -9.8])
    for k in range(1, 511):
        sample = fields.fused_imu(START + k * DT, k, zero, up, 1e-12 * eye, 1e-8 * eye, 63, 63, zero, zero)
        navigator._on_imu(convert.fill(FusedImu, sample))
    navigator._navigator.finish()
    navigator._publish_settled()
    found = {(m.subfilter, (convert.to_ns(m.header.stamp) - START) // 1_000_000_000): m for m in judged}
    usable = {("ground", 1), ("ground", 3), ("ground", 5), ("beams", 1), ("beams", 3), ("beams", 5), ("water", 2)}
    assert found.keys() == usable
    assert {key for key, m in found.items() if not m.accepted} == {("ground", 5), ("beams", 5)}
    for key in usable - {("ground", 5), ("beams", 5), ("water", 2)}:
        assert np.abs(found[key].innovation).max() < 0.01, key  # what the state says is what the log says
    assert found["water", 2].innovation == pytest.approx([0.0, -CURRENT[1]], abs=0.01)
    assert found["ground", 5].innovation == pytest.approx([0.0, -2.0 * SPEED[1], 0.0], abs=0.02)
    assert len(found["beams", 1].innovation) == 3 and len(found["beams", 3].innovation) == 4  # the lost one is left out
    # the covariance of the message where there is one, else the sigma that is configured; the state's own is larger than 0
    assert 0.02 < found["ground", 1].sigma[0] < 0.03 < found["ground", 1].sigma[2] < 0.04 and found["ground", 3].sigma[0] > 0.03
    assert found["beams", 1].sigma[0] > np.sqrt(1e-3) and 0.03 < found["beams", 3].sigma[0] < found["beams", 1].sigma[0]
    counted = {s.name: (s.accepted, s.no_fix, s.malformed) for s in navigator._navigator.status().subfilters}
    assert counted == {"ground": (2, 1, 0), "water": (1, 0, 0), "beams": (2, 1, 0)}
