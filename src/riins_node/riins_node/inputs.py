"""What a node can see of its inputs' other end.

Lives here: `several_publishers`: two sensors on one topic make a navigation error that nothing else explains; `message_class`.
Does not live here: time-outs and counts of what arrives (each node and its algorithm).
"""

from __future__ import annotations

import importlib
from collections.abc import Iterable
from typing import Any

from rclpy.node import Node

from .parameters import ParameterError


def message_class(name: str, wanted_by: str) -> Any:
    """Class of a message type that is named by a parameter, "sensor_msgs/msg/NavSatFix".

    Raises
    ------
    ParameterError
        Its package is not installed; one line with the type and who wants it.
    """
    package, _, kind = name.split("/")
    try:
        return getattr(importlib.import_module(f"{package}.msg"), kind)
    except (ImportError, AttributeError):
        raise ParameterError(f"{wanted_by} needs {name}, and {package} is not installed here") from None


def several_publishers(node: Node, topics: Iterable[str]) -> list[str]:
    """Topics with more than one publisher, one line each.

    Parameters
    ----------
    node : whose graph is looked at, and in whose namespace relative names are taken
    topics : names of its inputs

    Returns
    -------
    list of str, "imu/fused has 2 publishers: /imu_fusion, /other"; empty when all is well
    """
    lines = []
    for topic in topics:
        if node.count_publishers(topic) > 1:
            found = node.get_publishers_info_by_topic(topic)
            names = sorted(f"{info.node_namespace.rstrip('/')}/{info.node_name}" for info in found)
            lines.append(f"{topic} has {len(names)} publishers: {', '.join(names)}")
    return lines
