"""One live run of the short scenario as another stack sees it: what the tests of its topics and those of law 2 look at.

Lives here: `observe` and what is expected of every topic; the fixture `run` of conftest.py makes one run for all.
Does not live here: tests.
"""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import TwistWithCovarianceStamped
from harness import Bridge, Listener, own_domain, short_scenario, wait_until
from nav_msgs.msg import Odometry
from sensor_msgs.msg import Imu, NavSatFix
from std_msgs.msg import String

from riins_bringup.graph import GraphSettings, build_graph
from riins_bringup.live import LiveRun
from riins_msgs.msg import (
    FaultArray,
    FederatedStatus,
    FusedImu,
    InertialFdi,
    InitialState,
    Innovation,
    NavCovariance,
    NavState,
    RedundantImu,
    VesselMotion,
)

EXAMPLE = Path(__file__).resolve().parents[1] / "examples/other_stack/navigation_display.py"
DURATION = 15.5  # the last aids come half a second before the last IMU sample: all are judged
TOPICS: dict[str, tuple[type, float, str]] = {
    "/rimu/raw": (RedundantImu, 100.0, "imu_link"),
    "/imu/fused": (FusedImu, 100.0, "imu_link"),
    "/imu/data_raw": (Imu, 100.0, "imu_link"),
    "/imu/data": (Imu, 100.0, "base_link"),
    "/fdi/status": (InertialFdi, 10.0, "imu_link"),
    "/gps/fix": (NavSatFix, 1.0, "gps_link"),
    "/gps/velocity": (TwistWithCovarianceStamped, 1.0, "map"),
    "/bds/fix": (NavSatFix, 1.0, "bds_link"),
    "/bds/velocity": (TwistWithCovarianceStamped, 1.0, "map"),
    "/doppler/velocity": (TwistWithCovarianceStamped, 1.0, "doppler_link"),
    "/nav/state": (NavState, 100.0, "map_ned"),
    "/nav/motion": (VesselMotion, 100.0, "map_ned"),
    "/nav/settled": (NavState, 1.0, "map_ned"),
    "/nav/covariance": (NavCovariance, 1.0, "map_ned"),
    "/nav/innovations": (Innovation, 3.0, ""),
    "/nav/odometry": (Odometry, 20.0, "map"),
    "/nav/fix": (NavSatFix, 20.0, "base_link"),
    "/nav/subfilters": (FederatedStatus, 1.0, ""),
    "/truth/state": (NavState, 10.0, "map_ned"),
    "/truth/odometry": (Odometry, 10.0, "map"),
}
LATCHED = {
    "/nav/initial_state": InitialState,
    "/nav/origin": NavSatFix,
    "/truth/faults": FaultArray,
    "/riins/configuration": String,
    "/fdi/status": InertialFdi,
    "/nav/subfilters": FederatedStatus,
}


@dataclass
class Observed:
    """One finished run."""

    bag: Path
    messages: dict[str, list[Any]]
    late: dict[str, list[Any]]
    qos: dict[str, list[Any]]
    summary: dict[str, Any]
    statuses: dict[str, int]
    example: tuple[int | None, str]
    start_ns: int
    bridge: list[str]


def observe(directory: Path) -> Observed:
    """Live run of the short scenario, recorded, with a listener from the start, one that joins late, and the example node."""
    with own_domain(directory):
        bridge = Bridge()
        nmea = f"udp://127.0.0.1:{bridge.port}"
        graph = build_graph(GraphSettings(scenario=str(short_scenario(directory)), record=str(directory / "bag"), nmea=nmea))
        topics = {name: kind for name, (kind, _, _) in TOPICS.items()} | {"/diagnostics": DiagnosticArray}
        plain = {k: v for k, v in os.environ.items() if k not in ("FASTRTPS_DEFAULT_PROFILES_FILE", "ROS_AUTOMATIC_DISCOVERY_RANGE")}
        example = subprocess.Popen(
            [sys.executable, str(EXAMPLE), "--ros-args", "-p", "lines:=3"], env=plain, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        )
        try:
            with Listener(topics) as listener, LiveRun(graph, directory / "logs") as live:
                live.start()
                wait_until(lambda: len(listener.messages["/nav/state"]) > 900, 60.0, "nine seconds of navigation")
                with Listener(LATCHED, latched=tuple(LATCHED)) as joiner:
                    expected = set(LATCHED) - {"/riins/configuration"}  # that one is in the bag, nobody publishes it live
                    wait_until(lambda: all(joiner.messages[t] for t in expected), 10.0, "latched messages")
                    wait_until(lambda: len(joiner.messages["/truth/faults"]) == 4, 10.0, "the faults of rimu, gps, bds and doppler")
                    late = {topic: list(messages) for topic, messages in joiner.messages.items()}
                qos = {topic: listener.publishers(topic) for topic in [*topics, *LATCHED]}
                wait_until(lambda: live.finished() or live.dead(), 60.0, "the end of the scenario")
                assert live.dead() is None, live.dead()
                start_ns = live.graph.start_at_ns
                statuses = live.processes.stop()
                summary = live.monitor.summary()
            output = example.communicate(timeout=10.0)[0]
        finally:
            example.kill()
            bridge.close()
    ended = (example.returncode, output)
    return Observed(directory / "bag", listener.messages, late, qos, summary, statuses, ended, start_ns, bridge.heard)
