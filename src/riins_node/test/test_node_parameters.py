"""riins_node.parameters: what a user may write, and what he is told when it is wrong."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest
import rclpy
import yaml
from rclpy.node import Node
from rclpy.parameter import Parameter
from std_msgs.msg import String

from riins_core.settings import as_mapping, flatten, section, setting
from riins_node import qos
from riins_node.parameters import ParameterError, check_qos_names, declare, parameter_file

Ros = Callable[..., None]


@dataclass(frozen=True)
class Filter:
    """A section."""

    sigma_m: tuple[float, ...] = setting((1.0, 2.0, 3.0), "sigma", "m", 0.0, 10.0, length=3)
    enabled: bool = setting(True, "use it")


@dataclass(frozen=True)
class Config:
    """Settings of a node."""

    rate_hz: float = setting(100.0, "samples a second", "Hz", 1.0, 1000.0)
    count: int = setting(3, "how many", "", 0, 10)
    kind: str = setting("wls", "method", choices=("wls", "opt"))
    geometry: tuple[float, ...] = setting((), "row-major, empty: the configuration's")
    names: tuple[str, ...] = setting(("a",), "names")
    open_ended: float = setting(0.0, "no upper limit", "s", low=0.0)
    maybe: float | None = setting(None, "may be left out")
    gps: Filter = section(Filter, "receiver")


def test_defaults_are_declared_with_description_unit_and_range(ros: Ros) -> None:
    ros()
    node = Node("n")
    config = declare(node, Config)
    assert config == Config()
    values = {name: node.get_parameter(name).value for name in flatten(as_mapping(config))}
    assert list(values["gps.sigma_m"]) == [1.0, 2.0, 3.0]
    assert node.get_parameter("geometry").type_ is Parameter.Type.DOUBLE_ARRAY
    assert len(values["geometry"]) == 0
    descriptor = node.describe_parameter("rate_hz")
    assert descriptor.description == "samples a second [Hz]"
    assert (descriptor.floating_point_range[0].from_value, descriptor.floating_point_range[0].to_value) == (1.0, 1000.0)
    assert node.describe_parameter("count").integer_range[0].to_value == 10
    assert node.describe_parameter("kind").additional_constraints == "one of wls, opt"
    assert "3 elements" in node.describe_parameter("gps.sigma_m").additional_constraints
    result = node.set_parameters([Parameter("rate_hz", value=50.0)])[0]
    assert not result.successful and "read-only" in result.reason
    node.destroy_node()


def test_command_line_and_file(ros: Ros, tmp_path: Path) -> None:
    file = tmp_path / "p.yaml"
    file.write_text("/n:\n  ros__parameters:\n    rate_hz: 50\n    gps:\n      sigma_m: [1, 2, 3]\n      enabled: false\n")
    ros("--params-file", str(file), "-p", "geometry:=[1.0, 0.0, 0.0]", "-p", "maybe:=2.5", "-p", "names:=[]")
    node = Node("n")
    config = declare(node, Config)
    assert config.rate_hz == 50.0 and isinstance(config.rate_hz, float)  # a whole number is taken for a float
    assert config.gps == Filter((1.0, 2.0, 3.0), False)
    assert config.geometry == (1.0, 0.0, 0.0)
    assert config.maybe == 2.5 and config.names == ()  # an empty list is not the default
    assert node.get_parameter("rate_hz").value == 50.0
    assert node.get_parameter("gps.enabled").value is False
    node.destroy_node()


def test_overrides_of_the_caller_are_below_the_user(ros: Ros) -> None:
    ros("-p", "count:=4")
    node = Node("n")
    config = declare(node, Config, {"count": 5, "gps.enabled": False})
    assert (config.count, config.gps.enabled) == (4, False)
    node.destroy_node()


@pytest.mark.parametrize(
    ("word", "said"),
    [
        ("rate_hzz:=1.0", 'unknown parameter "rate_hzz" (did you mean "rate_hz"?)'),
        ("gps.sigma:=1.0", '"gps.sigma_m"'),
        ("nosuch:=1", 'unknown parameter "nosuch"'),
        ("rate_hz:=fast", "must be a number"),
        ("rate_hz:=0.5", "must be in 1.0 .. 1000.0"),
        ("rate_hz:=.nan", "must be finite"),
        ("count:=2.5", "must be a whole number"),
        ("kind:=wsl", 'did you mean "wls"?'),
        ("gps.sigma_m:=[1.0, 2.0]", "must have 3 elements, not 2"),
        ("gps.sigma_m:=[]", "must have 3 elements, not 0"),
        ("gps.sigma_m:=[1.0, 2.0, 30.0]", "must be in 0.0 .. 10.0"),
        ("gps.enabled:=1", "must be true or false"),
    ],
)
def test_mistakes_are_refused_in_one_line(ros: Ros, word: str, said: str) -> None:
    ros("-p", word)
    node = Node("n")
    with pytest.raises(ParameterError) as caught:
        declare(node, Config)
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)
    node.destroy_node()


def test_names_of_ros_itself_are_allowed(ros: Ros) -> None:
    ros("-p", "use_sim_time:=false", "-p", "start_type_description_service:=false", "-p", "other:=1")
    node = Node("n")
    node.declare_parameter("other", 2)
    assert declare(node, Config) == Config()
    node.destroy_node()


def test_qos_overrides_work_and_misspelt_topics_are_refused(ros: Ros) -> None:
    ros("-p", "qos_overrides./t.publisher.depth:=7", "-p", "qos_overrides./t.publisher.reliability:=best_effort")
    node = Node("n")
    declare(node, Config)
    publisher = node.create_publisher(String, "t", qos.navigation(), qos_overriding_options=qos.overridable())
    check_qos_names(node)
    assert publisher.qos_profile.depth == 7
    assert publisher.qos_profile.reliability.name == "BEST_EFFORT"
    node.destroy_node()
    rclpy.try_shutdown()
    ros("-p", "qos_overrides./tt.publisher.depth:=7")
    node = Node("n")
    declare(node, Config)
    node.create_publisher(String, "t", qos.navigation(), qos_overriding_options=qos.overridable())
    with pytest.raises(ParameterError, match=r"did you mean \"qos_overrides./t.publisher.depth\""):
        check_qos_names(node)
    node.destroy_node()


def test_parameter_file_can_be_given_back(ros: Ros, tmp_path: Path) -> None:
    ros("-p", "rate_hz:=33.0", "-p", "names:=['x', 'y']")
    node = Node("n")
    before = declare(node, Config)
    text = parameter_file(node)
    assert "# samples a second [Hz]; 1 .. 1000" in text
    assert yaml.safe_load(text)["/n"]["ros__parameters"]["names"] == ["x", "y"]
    node.destroy_node()
    rclpy.try_shutdown()
    file = tmp_path / "dump.yaml"
    file.write_text(text)
    ros("--params-file", str(file))
    node = Node("n")
    assert declare(node, Config) == before
    node.destroy_node()
