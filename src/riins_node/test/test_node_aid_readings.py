"""Readers of the messages that declared aids come in: frames, angles, what is not known, what is not meant for the aid."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import SimpleNamespace as Message
from typing import Any

import numpy as np
import pytest
from rclpy.node import Node

from riins_core.rotation import dcm_from_euler, dcm_from_quat, exp_so3, log_so3
from riins_core.settings import declared, setting
from riins_node import fields, readings
from riins_node.inputs import message_class
from riins_node.parameters import ParameterError, declare, parameter_file

STAMP = 1_700_000_000_123_456_789
C_NB = dcm_from_euler(0.1, -0.2, 5.0)


@dataclass(frozen=True)
class Round:
    """A kind of section."""

    type: str = setting("round", "kind", choices=("round",))
    size_m: float = setting(1.0, "size", "m", 0.0, 9.0)


@dataclass(frozen=True)
class Square:
    """Another kind."""

    type: str = setting("square", "kind", choices=("square",))
    size_m: float = setting(2.0, "size", "m", 0.0, 9.0)


@dataclass(frozen=True)
class Shapes:
    """Settings with sections that the user names."""

    shapes: tuple[str, ...] = setting(("ball",), "names")
    shape: Mapping[str, Any] = declared("shapes", lambda: {"round": Round, "square": Square}, {"ball": "round"})


def message(content: Any) -> Any:
    """Nested attributes of the nested dicts of riins_node.fields."""
    if isinstance(content, dict):
        if content.keys() >= {"stamp"}:
            content = {**content, "stamp": Message(sec=content["stamp"] // 10**9, nanosec=content["stamp"] % 10**9)}
        return Message(**{name: message(value) for name, value in content.items()})
    return content


def test_attitude_and_heading() -> None:
    covariance = np.diag([1.0, 4.0, 9.0]) * 1e-6  # about forward, starboard, down
    msg = message(fields.attitude(STAMP, [0.1, -0.2, 5.0], covariance))
    stars = readings.read_attitude(msg)
    assert stars["stamp_ns"] == STAMP and stars["frame"] == "map" and stars["ok"]
    assert dcm_from_quat(stars["z"]) == pytest.approx(C_NB, abs=1e-12)
    assert stars["R"] == pytest.approx(C_NB @ covariance @ C_NB.T, abs=1e-18)
    compass = readings.read_heading(msg)
    assert compass["z"] == pytest.approx([5.0]) and compass["R"] == pytest.approx(stars["R"][2:, 2:])
    msg.pose.pose.orientation = Message(x=0.0, y=0.0, z=0.0, w=0.0)
    assert np.isnan(readings.read_attitude(msg)["z"]).all() and np.isnan(readings.read_heading(msg)["z"]).all()
    msg.pose.covariance = np.full(36, -1.0)
    assert not readings.read_attitude(msg)["R"].any() and not readings.read_heading(msg)["R"].any()


def test_the_covariance_of_an_attitude_is_about_north_east_down() -> None:
    """Samples of an orientation with noise about the fixed axes of ENU, as ROS has it."""
    rng = np.random.default_rng(1)
    sigma = np.array([1e-3, 2e-3, 4e-3])  # about east, north, up
    ned = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    turns = [ned @ (sigma * rng.normal(size=3)) for _ in range(4000)]
    spread = np.cov(np.array([log_so3(exp_so3(turn) @ C_NB @ C_NB.T) for turn in turns]).T)
    msg = message(fields.attitude(STAMP, [0.1, -0.2, 5.0], np.zeros((3, 3))))
    msg.pose.covariance = np.diag([0.0, 0.0, 0.0, *sigma**2]).ravel()
    assert np.diag(readings.read_attitude(msg)["R"]) == pytest.approx(np.diag(spread), rel=0.1)


def test_height_and_odometer() -> None:
    height = readings.read_height(message(fields.height(STAMP, 12.5, 4.0)))
    assert (height["z"].tolist(), height["R"].tolist(), height["frame"]) == ([12.5], [[4.0]], "altimeter_link")
    speed = readings.read_odometer(message(fields.doppler(STAMP, np.array([7.0, 0.0, 0.0]), np.diag([0.04, 0.01, 0.02]), "odometer_link")))
    assert speed["z"].tolist() == [7.0] and np.diag(speed["R"]).tolist() == [0.04, 0.01, 0.02] and speed["frame"] == "odometer_link"


def dvl(**changes: Any) -> Any:
    values = {
        "header": Message(stamp=Message(sec=1, nanosec=5), frame_id="dvl_link"), "velocity_mode": 1, "num_good_beams": 4,
        "velocity": Message(x=3.0, y=0.2, z=-0.1), "velocity_covar": np.diag([0.01, 0.02, 0.03]).ravel(), "beam_velocities_valid": True,
        "beam_velocity": [1.0, np.nan, 2.0, 3.0], "beam_velocity_covar": [0.01, -1.0, -1.0, 0.04],
    }  # fmt: skip
    return Message(**{**values, **changes})


def test_dvl_has_its_axes_forward_starboard_down_and_two_modes() -> None:
    ground = readings.read_dvl_bottom(dvl())
    assert ground is not None and ground["z"].tolist() == [3.0, 0.2, -0.1] and np.diag(ground["R"]).tolist() == [0.01, 0.02, 0.03]
    assert readings.read_dvl_water(dvl()) is None and readings.read_dvl_bottom(dvl(velocity_mode=2)) is None
    assert readings.read_dvl_water(dvl(velocity_mode=2)) is not None and readings.read_dvl_beams(dvl(velocity_mode=2)) is None
    few = readings.read_dvl_bottom(dvl(num_good_beams=2, velocity_covar=np.full(9, -1.0)))
    assert few is not None and not few["ok"] and not few["R"].any()
    beams = readings.read_dvl_beams(dvl())
    assert beams is not None and beams["ok"] and beams["z"] == pytest.approx([1.0, np.nan, 2.0, 3.0], nan_ok=True)
    assert np.diag(beams["R"]) == pytest.approx([0.01, 0.0, 0.0, 0.04])
    silent = readings.read_dvl_beams(dvl(beam_velocities_valid=False))
    assert silent is not None and not silent["ok"]


def test_a_message_type_that_is_not_installed_is_one_line() -> None:
    assert message_class("sensor_msgs/msg/NavSatFix", "gps").__name__ == "NavSatFix"
    with pytest.raises(ParameterError, match='aid "dvl" needs no_such_msgs/msg/Dvl, and no_such_msgs is not installed here'):
        message_class("no_such_msgs/msg/Dvl", 'aid "dvl"')


def test_sections_that_a_user_declares_are_parameters(ros: Any) -> None:
    ros("-p", "shapes:=[ball, box]", "-p", "box.type:=square", "-p", "box.size_m:=3")
    node = Node("n")
    config: Any = declare(node, Shapes)
    assert config.shape == {"ball": Round(), "box": Square(size_m=3.0)}
    assert node.get_parameter("box.size_m").value == 3.0 and node.describe_parameter("ball.size_m").description == "size [m]"
    assert 'box.type: "square"' in parameter_file(node)
    node.destroy_node()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["-p", "box.size_m:=3.0"], r'unknown parameter "box.size_m" \(did you mean "ball.size_m"\?\)'),
        (["-p", "shapes:=[ball, box]"], r'"shapes" names "box", but there is no "box.type"'),
        (
            ["-p", "shapes:=[ball, box]", "-p", "box.type:=squar"],
            r'"box.type" must be one of round, square, not \'squar\' \(did you mean "square"\?\)',
        ),
    ],
)
def test_a_wrong_declaration_is_one_line(ros: Any, words: list[str], said: str) -> None:
    ros(*words)
    node = Node("n")
    with pytest.raises(ParameterError, match=said):
        declare(node, Shapes)
    node.destroy_node()
