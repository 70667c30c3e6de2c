"""A live run with toy nodes: readiness, time, latency, end, death of a node, signals.

Lives here: tests of riins_bringup.live and riins_bringup.watch with rclpy toys on a domain of their own.
Does not live here: the real nodes (test/ at top level).
"""

from __future__ import annotations

import io
import json
import os
import signal
import subprocess
import sys
import textwrap
import threading
import time
from types import SimpleNamespace

import pytest
from rich.console import Console

pytest.importorskip("rclpy")
pytest.importorskip("riins_msgs")

from riins_bringup.graph import Graph, NodeSpec
from riins_bringup.live import _completed, run_live

FILTER = """
from riins_msgs.msg import NavState, RedundantImu
node = Node("filter")
publisher = node.create_publisher(NavState, "nav/state", 400)
def received(imu):
    publisher.publish(NavState(header=imu.header, sequence=imu.sequence, mode=2, latitude=54.0))
node.create_subscription(RedundantImu, "rimu/raw", received, 400)
{extra}
spin(node)
"""
SENSOR = """
from riins_msgs.msg import RedundantImu
node = Node("sensor")
start = node.declare_parameter("start_at_ns", 0).value
duration = node.declare_parameter("duration_s", 0.0).value
publisher = node.create_publisher(RedundantImu, "rimu/raw", 400)
for k in range(1, round(duration * 100) + 1):
    stamp = start + k * 10_000_000
    while time.time_ns() < stamp and rclpy.ok(): rclpy.spin_once(node, timeout_sec=0.002)
    message = RedundantImu(sequence=k)
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 10**9)
    publisher.publish(message)
    if not rclpy.ok(): break
time.sleep(0.2)
"""
FRAME = """#!{python}
import os, sys, time, rclpy
from rclpy.node import Node
ENDS = (KeyboardInterrupt, rclpy.executors.ExternalShutdownException)
sys.excepthook = lambda kind, *rest: os._exit(0) if issubclass(kind, ENDS) else sys.__excepthook__(kind, *rest)
def spin(node):
    try: rclpy.spin(node)
    except ENDS: pass
rclpy.init()
{body}
"""
DIES = "node.create_timer(1.5, lambda: (print('covariance lost its symmetry', flush=True), sys.exit(4)))"


@pytest.fixture
def domain(monkeypatch):
    domain_coordinator = pytest.importorskip("domain_coordinator")
    with domain_coordinator.domain_id() as number:
        monkeypatch.setenv("ROS_DOMAIN_ID", str(number))
        yield number


@pytest.fixture
def toys(tmp_path, monkeypatch, domain):
    folder = tmp_path / "prefix/lib/toys"
    folder.mkdir(parents=True)
    for name, body in (("filter", FILTER.format(extra="")), ("dying", FILTER.format(extra=DIES)), ("sensor", SENSOR)):
        path = folder / name
        path.write_text(FRAME.format(python=sys.executable, body=textwrap.dedent(body)))
        path.chmod(0o755)
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"{tmp_path / 'prefix'}{os.pathsep}{os.environ['AMENT_PREFIX_PATH']}")
    return tmp_path


def graph(listener: str = "filter", duration_s: float = 2.0, namespace: str = "") -> Graph:
    nodes = (
        NodeSpec("toys", listener, "filter", "consumer", subscribes=("rimu/raw",), publishes=("nav/state",), namespace=namespace),
        NodeSpec("toys", "sensor", "sensor", "source", {"start_at_ns": 0, "duration_s": duration_s}, publishes=("rimu/raw",), namespace=namespace),
    )
    return Graph(nodes, "toy", duration_s, wall_stamps=True, namespace=namespace)


def test_run_to_the_end_loses_nothing_and_measures_latency(toys):
    out = io.StringIO()
    summary = run_live(graph(namespace="ship1"), console=Console(file=out), directory=toys / "run", json_file=toys / "run.json")
    assert summary["status"] == 0 and summary["ended"] == "completed", out.getvalue()
    assert summary["duration_s"] == pytest.approx(2.0) and summary["samples"]["nav_states_lost"] == 0
    assert 0.0 < summary["latency_ms"]["p50"] < 50.0
    assert summary["nodes"] == {"filter": 0, "sensor": 0}
    assert json.loads((toys / "run.json").read_text()) == summary
    assert "navigating" in out.getvalue()


def test_dead_node_ends_the_run_and_is_named(toys):
    out = io.StringIO()
    summary = run_live(graph("dying", 60.0), console=Console(file=out, width=200), directory=toys / "run")
    assert summary["status"] == 1 and summary["ended"] == 'node "filter" ended with status 4'
    assert "covariance lost its symmetry" in out.getvalue()
    assert summary["nodes"]["filter"] == 4


def test_table_in_a_terminal_and_stop_on_signal(toys):
    before = signal.getsignal(signal.SIGINT)
    out = io.StringIO()
    timer = threading.Timer(14.0, lambda: [os.kill(os.getpid(), s) for s in (signal.SIGINT, signal.SIGINT, signal.SIGTERM)])
    timer.start()
    summary = run_live(graph(duration_s=60.0), console=Console(file=out, force_terminal=True, width=150), directory=toys / "run")
    timer.cancel()
    assert summary["status"] == 0 and summary["ended"].startswith("stopped by the user")
    assert "Ctrl-C stops" in out.getvalue()
    assert signal.getsignal(signal.SIGINT) is before


def test_plain_subscriber_without_our_profile_hears_the_graph(toys):
    """Another stack has neither our Fast DDS profile nor our discovery range."""
    code = FRAME.format(
        python="",
        body="from riins_msgs.msg import NavState\nnode = Node('other')\n"
        "node.create_subscription(NavState, '/nav/state', lambda m: sys.exit(0), 10)\nspin(node)",
    )
    environment = {k: v for k, v in os.environ.items() if k not in ("FASTRTPS_DEFAULT_PROFILES_FILE", "ROS_AUTOMATIC_DISCOVERY_RANGE")}
    with subprocess.Popen([sys.executable, "-c", code.split("\n", 1)[1]], env=environment, stdout=subprocess.PIPE, text=True) as other:
        time.sleep(0.5)
        run_live(graph(duration_s=3.0), console=Console(file=io.StringIO()), directory=toys / "run")
        heard = other.poll()
        other.kill()
    assert heard == 0


def test_a_domain_in_use_is_refused(toys):
    import rclpy

    from riins_msgs.msg import RedundantImu

    context = rclpy.Context()
    rclpy.init(context=context)
    other = rclpy.create_node("other", context=context)
    other.create_publisher(RedundantImu, "rimu/raw", 1)
    try:
        summary = run_live(graph(), console=Console(file=io.StringIO()), directory=toys / "logs")
    finally:
        other.destroy_node()
        context.try_shutdown()
    assert summary["status"] == 1
    assert "/rimu/raw is already published in ROS domain" in summary["ended"] and "set ROS_DOMAIN_ID" in summary["ended"]


@pytest.mark.parametrize(("newest_s", "wall", "status"), [(60.0, True, 0), (56.0, True, 0), (0.1, True, 1), (0.1, False, 0), (-100.0, True, 1)])
def test_a_run_whose_navigation_ended_early_is_not_complete(newest_s, wall, status):
    """A navigator that waits for a new initial state after a restart publishes nothing; the graph runs on without it."""
    newest_ns = max(0, round((100.0 + newest_s) * 1e9))
    monitor = SimpleNamespace(newest_ns=newest_ns, start_at_ns=100_000_000_000)
    outcome = _completed(SimpleNamespace(monitor=monitor, graph=SimpleNamespace(duration_s=60.0, rate=1.0, wall_stamps=wall)))
    assert outcome.status == status and (outcome.ended == "completed") == (status == 0)
