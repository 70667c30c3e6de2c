"""The recorder as a process: every topic without a gap, kill -9, signals, full disk, bad use."""

from __future__ import annotations

import resource
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from bag_graph import Graph
from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosbags.highlevel import AnyReader
from std_msgs.msg import String

from riins_bag.bag import BagError, BagReader
from riins_bag.info import describe
from riins_bag.recover import recover
from riins_msgs.msg import RedundantImu


@pytest.fixture
def graph(tmp_path: Path) -> Iterator[Graph]:
    made = Graph(tmp_path)
    yield made
    made.close()


def stream(graph: Graph, publisher: object, rate_hz: float, count: int, first: int = 0) -> None:
    """Publish numbered samples, paced; a late one is not dropped."""
    message = RedundantImu(gyro=[0.1] * 6, accel=[0.2] * 6)
    begin = time.monotonic()
    for k in range(first, first + count):
        wait = begin + (k - first) / rate_hz - time.monotonic()
        if wait > 0:
            time.sleep(wait)
        message.sequence = k
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(time.time_ns(), 10**9)
        publisher.publish(message)


def test_kill_9_loses_at_most_two_seconds(graph: Graph) -> None:
    bag = graph.folder / "bag"
    recorder = graph.start("recorder", {"path": str(bag)})
    publisher = graph.node.create_publisher(RedundantImu, "/rimu/raw", 400)
    graph.until(publisher.get_subscription_count)
    stream(graph, publisher, 200.0, 600)
    recorder.kill()
    killed_ns = time.time_ns()
    recorder.wait()
    with pytest.raises(BagError, match="riins bag recover"):
        BagReader(bag)
    report = recover(bag)
    with BagReader(report.out) as reader:
        columns = reader.columns("/rimu/raw", ["sequence", "header.stamp"])
    assert columns["sequence"].tolist() == list(range(len(columns["sequence"])))  # from the first sample on, no gap
    assert (killed_ns - columns["header.stamp"][-1]) * 1e-9 <= 2.0
    assert len(columns["sequence"]) >= 200


def test_every_topic_is_recorded_as_offered(graph: Graph) -> None:
    node, bag = graph.node, graph.folder / "bag"
    latched = node.create_publisher(String, "/truth/faults", QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL))
    latched.publish(String(data="before the recorder was there"))
    (graph.folder / "run.yaml").write_text("scenario: harbour\n")
    recorder = graph.start("recorder", {"path": str(bag), "configuration_file": str(graph.folder / "run.yaml"), "exclude": ["/secret*"]})
    raw = node.create_publisher(RedundantImu, "/rimu/raw", 1000)
    loose = node.create_publisher(String, "/loose", QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT))
    secret = node.create_publisher(String, "/secret/key", 10)
    statuses: list[DiagnosticArray] = []
    node.create_subscription(DiagnosticArray, "/diagnostics", statuses.append, 10)
    graph.until(lambda: raw.get_subscription_count() and loose.get_subscription_count() and latched.get_subscription_count())
    loose.publish(String(data="one"))
    secret.publish(String(data="no"))
    stream(graph, raw, 1000.0, 2000)
    later = node.create_publisher(String, "/later", 10)
    graph.until(later.get_subscription_count)
    later.publish(String(data="two"))
    weak = node.create_publisher(RedundantImu, "/rimu/raw", QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT))
    graph.until(weak.get_subscription_count)  # a reliable subscription never matches it: the recorder must ask for less
    weak.publish(RedundantImu(sequence=2000))
    graph.until(lambda: statuses)
    graph.until(lambda: latched.wait_for_all_acked())
    time.sleep(0.2)
    status, out, err = graph.stop(recorder)
    assert status == 0 and out.startswith(f"recorder: {bag}: ") and " 0 lost" in out, (out, err)
    with BagReader(bag) as reader:
        texts = {topic: m.data for topic, _, m in reader.read(["/truth/faults", "/loose", "/later", "/secret/key"])}
        assert texts == {"/truth/faults": "before the recorder was there", "/loose": "one", "/later": "two"}
        assert reader.columns("/rimu/raw", ["sequence"])["sequence"].tolist() == list(range(2001))
        assert next(reader.messages()).topic == "/riins/configuration" and reader.configuration() == "scenario: harbour\n"
        assert reader.qos("/loose")[0].reliability == "best_effort" and reader.qos("/truth/faults")[0].durability == "transient_local"
        columns = reader.columns("/rimu/raw", ["header.stamp"])
        delay = (columns["log_time"] - columns["header.stamp"])[:2000] * 1e-9
        assert np.all(delay > 0.0) and np.median(delay) < 0.05  # the log time is the time of receipt
    with AnyReader([bag]) as other:
        assert other.topics["/rimu/raw"].msgcount == 2001
        recorded = next(c for c in other.connections if c.topic == "/rimu/raw")
    announced = node.get_publishers_info_by_topic("/rimu/raw")[0]
    assert recorded.digest == str(announced.topic_type_hash)
    values = {entry.key: entry.value for entry in statuses[-1].status[0].values}
    assert values["bag"] == str(bag) and int(values["lost"]) == 0 and "rate_hz /rimu/raw" in values


def test_sigterm_closes_the_bag_even_when_repeated(graph: Graph) -> None:
    recorder = graph.start("recorder", {"path": str(graph.folder / "bag"), "topics": ["/rimu/*"]})
    publisher = graph.node.create_publisher(RedundantImu, "/rimu/raw", 400)
    graph.until(publisher.get_subscription_count)
    stream(graph, publisher, 500.0, 100)
    time.sleep(0.2)
    recorder.send_signal(signal.SIGTERM)
    status, out, _ = graph.stop(recorder, signal.SIGTERM)  # twice: a user is impatient
    assert status == 0 and "recorder:" in out
    info = describe(graph.folder / "bag")
    assert info.complete and info.imu[0].received == 100 and [topic.name for topic in info.topics] == ["/rimu/raw"]


def test_lifecycle_decides_what_is_recorded(graph: Graph) -> None:
    bag = graph.folder / "bag"
    recorder = graph.start("recorder", {"path": str(bag), "topics": ["/rimu/raw"], "autostart": False})
    publisher = graph.node.create_publisher(RedundantImu, "/rimu/raw", 400)
    client = graph.node.create_client(ChangeState, "/recorder/change_state")
    graph.until(client.service_is_ready)

    def change(transition: int) -> None:
        future = client.call_async(ChangeState.Request(transition=Transition(id=transition)))
        graph.until(future.done)
        assert future.result().success

    change(Transition.TRANSITION_CONFIGURE)
    assert bag.is_dir() and not publisher.get_subscription_count()
    for first in (0, 100):
        change(Transition.TRANSITION_ACTIVATE)
        graph.until(publisher.get_subscription_count)
        stream(graph, publisher, 500.0, 50, first)
        time.sleep(0.3)
        change(Transition.TRANSITION_DEACTIVATE)
        graph.until(lambda: not publisher.get_subscription_count())
        stream(graph, publisher, 500.0, 50, first + 50)  # not active: not recorded
    change(Transition.TRANSITION_CLEANUP)
    gaps = describe(bag).imu[0]
    assert (gaps.received, gaps.lost, gaps.gaps) == (100, 50, 1)
    assert graph.stop(recorder)[0] == 0


def test_a_full_disk_ends_the_recorder_with_one_line(graph: Graph) -> None:
    bag = graph.folder / "bag"

    def small_disk() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))

    recorder = graph.start(
        "recorder", {"path": str(bag), "topics": ["/rimu/raw"], "chunk_bytes": 4096, "compression_level": 0}, preexec_fn=small_disk
    )
    publisher = graph.node.create_publisher(RedundantImu, "/rimu/raw", 400)
    graph.until(publisher.get_subscription_count)
    stream(graph, publisher, 500.0, 400)
    out, err = recorder.communicate(timeout=20)
    assert recorder.returncode == 1, (out, err)
    lines = [line for line in err.splitlines() if "error" in line]
    assert len(lines) == 1 and "File too large" in lines[0] and "riins bag recover" in lines[0] and "Traceback" not in err
    assert recover(bag).counts["/rimu/raw"] > 50


def test_bad_use_is_refused_in_one_line(graph: Graph) -> None:
    (graph.folder / "there").mkdir()
    (graph.folder / "file").write_text("")
    cases = [
        ({"path": str(graph.folder / "there")}, 2, "exists already"),
        ({"path": str(graph.folder / "file" / "bag")}, 1, "cannot write"),
        ({"path": str(graph.folder / "new"), "configuration_file": "nowhere.yaml"}, 2, "nowhere.yaml"),
        ({"path": str(graph.folder / "new"), "flush_periods": 1.0}, 2, 'did you mean "flush_period_s"'),
        ({"path": str(graph.folder / "new"), "compression_level": 99}, 2, "0 .. 19"),
    ]
    started = [graph.start("recorder", parameters) for parameters, _, _ in cases]
    for process, (_, status, words) in zip(started, cases, strict=True):
        _, err = process.communicate(timeout=60)
        last = err.strip().splitlines()[-1]
        assert process.returncode == status and words in last and last.startswith("recorder: error:"), err
    assert not (graph.folder / "new").exists()


def test_parameters_are_described(graph: Graph) -> None:
    command = [sys.executable, "-m", "riins_bag.nodes.recorder", "--print-parameters"]
    text = subprocess.run(command, env=graph.environment, capture_output=True, text=True, timeout=60, check=True).stdout
    assert "flush_period_s: 1.0" in text and "survives a kill" in text
