"""Fixtures of the riins_node tests: a domain of their own, so that tests running beside them are not heard."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator

import pytest
import rclpy

os.environ["ROS_DOMAIN_ID"] = str(20 + os.getpid() % 80)
os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")


@pytest.fixture
def ros() -> Iterator[Callable[..., None]]:
    """Call it with ROS arguments to initialise rclpy; shut down afterwards."""

    def init(*words: str) -> None:
        rclpy.init(args=["test", "--ros-args", *words] if words else [])

    yield init
    rclpy.try_shutdown()
