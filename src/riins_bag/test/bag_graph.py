"""A small graph for the tests of the nodes: its own DDS domain, a node of the test, processes that end with the test.

Lives here: `Graph`.
Does not live here: any test.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import domain_coordinator
import rclpy
import yaml
from rclpy.executors import SingleThreadedExecutor


class Graph:
    """Node of the test and processes under test in one domain that nobody else uses."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._domain = domain_coordinator.domain_id()
        self.domain = self._domain.__enter__()
        self.environment = os.environ | {
            "ROS_DOMAIN_ID": str(self.domain),
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
            "ROS_LOG_DIR": str(folder / "log"),
        }
        os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
        self.context = rclpy.Context()
        self.context.init(domain_id=int(self.domain))
        self.node = rclpy.create_node("tester", context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.processes: list[subprocess.Popen[str]] = []

    def start(self, module: str, parameters: Mapping[str, Any], **options: Any) -> subprocess.Popen[str]:
        """Start a node of this package; its output goes into a pipe."""
        file = self.folder / f"parameters_{len(self.processes)}.yaml"
        file.write_text(yaml.safe_dump({"/**": {"ros__parameters": dict(parameters)}}))
        command = [sys.executable, "-m", f"riins_bag.nodes.{module}", "--ros-args", "--params-file", str(file)]
        process = subprocess.Popen(command, env=self.environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **options)
        self.processes.append(process)
        return process

    def until(self, done: Callable[[], object], timeout_s: float = 20.0) -> None:
        """Spin the test's node until something holds."""
        end = time.monotonic() + timeout_s
        while not done():
            assert time.monotonic() < end, "waited in vain"
            self.executor.spin_once(timeout_sec=0.01)

    def stop(self, process: subprocess.Popen[str], number: signal.Signals = signal.SIGINT) -> tuple[int, str, str]:
        """Send a signal and wait: (status, stdout, stderr)."""
        process.send_signal(number)
        out, err = process.communicate(timeout=20)
        return process.returncode, out, err

    def close(self) -> None:
        """End what is left."""
        for process in self.processes:
            if process.poll() is None:
                process.kill()
            process.communicate()
        self.executor.shutdown()
        self.node.destroy_node()
        self.context.try_shutdown()
        self._domain.__exit__(None, None, None)
