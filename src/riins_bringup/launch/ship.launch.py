"""Launch the graph of a simulated ship, or the replay of a bag: `ros2 launch riins_bringup ship.launch.py scenario:=harbour`.

Lives here: the translation of `riins_bringup.graph` into launch actions.
Does not live here: any knowledge of nodes, topics or parameters; `ros2 launch riins_bringup ship.launch.py --show-args` lists the arguments.
"""

import dataclasses
import tempfile
import time

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, LogInfo, OpaqueFunction, Shutdown, TimerAction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from riins_bringup.graph import Graph, GraphSettings, NodeSpec, build_graph, settings_from_words, write_files

SETTLING_S = 5.0  # from the last measurement to the shutdown: the filters settle, the recorder writes


def generate_launch_description() -> LaunchDescription:
    """All arguments of the graph, each with its description, then the nodes."""
    arguments = []
    for field in dataclasses.fields(GraphSettings):
        unit = f" [{field.metadata['unit']}]" if field.metadata["unit"] else ""
        more = {"choices": list(field.metadata["choices"])} if field.metadata["choices"] else {}
        arguments.append(DeclareLaunchArgument(field.name, default_value=str(field.default), description=field.metadata["doc"] + unit, **more))
    return LaunchDescription([*arguments, OpaqueFunction(function=start_graph)])


def start_graph(context: LaunchContext) -> list:
    """Actions of one run; called when the arguments are known."""
    words = {field.name: LaunchConfiguration(field.name).perform(context) for field in dataclasses.fields(GraphSettings)}
    settings = settings_from_words(words)
    # one start for all simulated sensors, far enough ahead for every process to be there
    graph = build_graph(settings, time.time_ns() + round(settings.start_delay_s * 1e9))
    directory = tempfile.mkdtemp(prefix="riins-")
    return [LogInfo(msg=f"riins: {graph.title}, parameter files in {directory}"), *(node_action(graph, spec, directory) for spec in graph.nodes)]


def node_action(graph: Graph, spec: NodeSpec, directory: str) -> Node:
    """One node: a listener that ends takes the graph down at once, the source of IMU samples some seconds later, an aid never."""
    ending = [Shutdown(reason=f"node {spec.name} has ended")]
    if spec.role == "source":
        ending = [TimerAction(period=SETTLING_S, actions=ending)] if "rimu/raw" in spec.publishes else []
    return Node(
        package=spec.package,
        executable=spec.executable,
        name=spec.name,
        namespace=spec.namespace or None,
        parameters=[str(write_files(spec, directory))],
        remappings=list(spec.remappings),
        ros_arguments=["--log-level", spec.log_level],
        output="screen",
        on_exit=ending,
    )
