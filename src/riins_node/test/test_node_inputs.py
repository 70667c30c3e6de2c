"""Two publishers on one input are named."""

from __future__ import annotations

import time

import pytest

pytest.importorskip("rclpy")
import rclpy
from rclpy.node import Node
from std_msgs.msg import String

from riins_node.inputs import several_publishers


def test_a_second_publisher_is_named() -> None:
    context = rclpy.Context()
    rclpy.init(context=context)
    nodes = [Node(name, context=context, namespace="ship") for name in ("one", "other")]
    try:
        nodes[0].create_publisher(String, "gps/fix", 1)
        assert several_publishers(nodes[0], ["gps/fix", "bds/fix"]) == []
        nodes[1].create_publisher(String, "gps/fix", 1)
        deadline = time.monotonic() + 10.0
        while not (lines := several_publishers(nodes[0], ["gps/fix", "bds/fix"])) and time.monotonic() < deadline:
            time.sleep(0.05)
        assert lines == ["gps/fix has 2 publishers: /ship/one, /ship/other"]
    finally:
        for node in nodes:
            node.destroy_node()
        context.try_shutdown()
