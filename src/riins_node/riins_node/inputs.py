"""What a node can see of its inputs' other end.

Lives here: `several_publishers`: two sensors on one topic make a navigation error that nothing else explains.
Does not live here: time-outs and counts of what arrives (each node and its algorithm).
"""

from __future__ import annotations

from collections.abc import Iterable

from rclpy.node import Node


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
