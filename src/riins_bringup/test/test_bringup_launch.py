"""The launch file: its arguments and nodes are those of the graph.

Lives here: tests with stand-ins for launch and launch_ros, and with the real ones where they are installed.
Does not live here: running a launch (needs a full ROS 2 installation).
"""

from __future__ import annotations

import dataclasses
import importlib.util
import sys
import types
from pathlib import Path
from typing import Any

import pytest
import yaml

from riins_bringup.graph import GraphSettings

FILE = Path(__file__).resolve().parents[1] / "launch/ship.launch.py"


class Action:
    """Remembers how it was made; stands for every class of the launch API."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        self.args, self.kwargs = args, kwargs


class Configuration(Action):
    def perform(self, context: dict[str, str]) -> str:
        return context[self.args[0]]


def stand_ins() -> dict[str, types.ModuleType]:
    names = {
        "launch": ("LaunchContext", "LaunchDescription"),
        "launch.actions": ("DeclareLaunchArgument", "LogInfo", "OpaqueFunction", "Shutdown", "TimerAction"),
        "launch.substitutions": (),
        "launch_ros": (),
        "launch_ros.actions": ("Node",),
    }
    modules = {}
    for module, classes in names.items():
        modules[module] = types.ModuleType(module)
        for name in classes:
            setattr(modules[module], name, type(name, (Action,), {}))
    modules["launch.substitutions"].LaunchConfiguration = Configuration
    return modules


def load() -> types.ModuleType:
    spec = importlib.util.spec_from_file_location("ship_launch", FILE)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def launch_file(monkeypatch):
    for name, module in stand_ins().items():
        monkeypatch.setitem(sys.modules, name, module)
    return load()


def context(**changes: str) -> dict[str, str]:
    return {f.name: str(f.default) for f in dataclasses.fields(GraphSettings)} | changes


def test_each_setting_is_an_argument_with_description(launch_file):
    *arguments, last = launch_file.generate_launch_description().args[0]
    assert [a.args[0] for a in arguments] == [f.name for f in dataclasses.fields(GraphSettings)]
    assert all(len(a.kwargs["description"]) > 10 and isinstance(a.kwargs["default_value"], str) for a in arguments)
    assert next(a for a in arguments if a.args[0] == "log_level").kwargs["choices"] == ["debug", "info", "warn", "error", "fatal"]
    assert last.kwargs["function"] is launch_file.start_graph


def test_nodes_of_the_graph_with_their_parameter_files(launch_file):
    actions = launch_file.start_graph(context(scenario="harbour", namespace="ship1", record="/nowhere/bag", start_delay_s="7"))
    nodes = {a.kwargs["name"]: a.kwargs for a in actions[1:]}
    assert set(nodes) == {"rimu", "gps", "bds", "doppler", "truth", "imu_fusion", "navigator", "recorder"}
    starts = set()
    for name, node in nodes.items():
        assert node["namespace"] == "ship1" and node["output"] == "screen" and node["ros_arguments"] == ["--log-level", "info"]
        parameters = yaml.safe_load(Path(node["parameters"][0]).read_text())["/**"]["ros__parameters"]
        if name in ("rimu", "gps", "bds", "doppler", "truth"):
            starts.add(parameters["start_at_ns"])
    assert len(starts) == 1


def test_end_of_a_node_ends_what_needs_it(launch_file):
    nodes = {a.kwargs["name"]: a.kwargs for a in launch_file.start_graph(context(record="/nowhere/bag"))[1:]}
    assert [type(a).__name__ for a in nodes["navigator"]["on_exit"]] == ["Shutdown"]
    assert [type(a).__name__ for a in nodes["rimu"]["on_exit"]] == ["TimerAction"]
    assert nodes["gps"]["on_exit"] == [] and nodes["gps"]["namespace"] is None


def test_real_launch_loads_the_file():
    pytest.importorskip("launch_ros", reason="launch_ros is not installed: it comes with a full ROS 2 installation")
    launch = pytest.importorskip("launch")
    description = load().generate_launch_description()
    assert isinstance(description, launch.LaunchDescription)
    names = [a.name for a in description.get_launch_arguments()]
    assert names == [f.name for f in dataclasses.fields(GraphSettings)]
