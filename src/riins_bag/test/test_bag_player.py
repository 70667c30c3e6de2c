"""The player as a process: what another node sees of a recorded bag."""

from __future__ import annotations

import signal
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from bag_graph import Graph
from bag_helpers import DT_NS, EPOCH_NS, fill_bag, make_bag
from rclpy.qos import DurabilityPolicy, QoSProfile
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import NavSatFix
from std_msgs.msg import String

from riins_bag.bag import BagWriter
from riins_msgs.msg import RedundantImu, SensorUse


@pytest.fixture
def graph(tmp_path: Path) -> Iterator[Graph]:
    made = Graph(tmp_path)
    yield made
    made.close()


def stamp_ns(message: RedundantImu | NavSatFix) -> int:
    return message.header.stamp.sec * 10**9 + message.header.stamp.nanosec


class Sink:
    """Keeps what it receives, with the time of receipt."""

    def __init__(self, graph: Graph) -> None:
        self.raw: list[tuple[float, RedundantImu]] = []
        self.fixes: list[NavSatFix] = []
        self.clock: list[int] = []
        graph.node.create_subscription(RedundantImu, "/rimu/raw", lambda m: self.raw.append((time.monotonic(), m)), 1000)
        graph.node.create_subscription(NavSatFix, "/gps/fix", self.fixes.append, 100)
        graph.node.create_subscription(Clock, "/clock", lambda m: self.clock.append(m.clock.sec * 10**9 + m.clock.nanosec), 1000)


def test_a_bag_is_played_as_recorded(graph: Graph) -> None:
    bag = make_bag(graph.folder / "bag", 1000)
    player = graph.start("player", {"path": str(bag), "rate": 4.0, "publish_clock": True, "wait_for": ["/rimu/raw", "/gps/fix"]})
    graph.until(lambda: any(name == "/rimu/raw" for name, _ in graph.node.get_topic_names_and_types()))
    time.sleep(0.5)
    assert player.poll() is None  # it waits for us
    sink = Sink(graph)
    configuration: list[str] = []
    graph.until(lambda: len(sink.raw) > 300)
    late = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)  # joins in the middle, gets the latched one
    graph.node.create_subscription(String, "/riins/configuration", lambda m: configuration.append(m.data), late)
    graph.until(lambda: len(sink.raw) == 1000 and len(sink.fixes) == 10 and sink.clock[-1:] == [EPOCH_NS + 1000 * DT_NS])
    topics = {name for name, _ in graph.node.get_topic_names_and_types()}
    out, err = player.communicate(timeout=20)
    assert player.returncode == 0, (out, err)
    assert configuration == ["scenario: {name: test}\n"]
    assert "/nav/innovations" not in topics and {"/rimu/raw", "/gps/fix", "/clock"} <= topics  # results are not played
    assert [m.sequence for _, m in sink.raw] == list(range(1, 1001))
    assert [stamp_ns(m) for _, m in sink.raw] == [EPOCH_NS + k * DT_NS for k in range(1, 1001)]
    np.testing.assert_array_equal(sink.raw[9][1].gyro, 10 + np.arange(6) / 16.0)
    times = np.array([t for t, _ in sink.raw])
    assert times[-1] - times[0] == pytest.approx(9.99 / 4.0, abs=1.0)  # paced by log time, without drift
    pace = times - np.arange(1000) * 0.01 / 4.0
    assert np.percentile(pace, 90) - pace.min() < 1.0
    assert sink.clock == sorted(sink.clock) and sink.clock[-1] == EPOCH_NS + 1000 * DT_NS and len(sink.clock) > 900


def test_start_offset_keeps_what_was_latched_and_loop_begins_again(graph: Graph) -> None:
    bag = graph.folder / "bag"
    with BagWriter(bag) as writer:
        writer.write_configuration("early: 1\n", EPOCH_NS - 60_000_000_000)  # the recorder waited for a minute: the player does not
        fill_bag(writer, 600)
    sink = Sink(graph)
    configuration: list[str] = []
    graph.node.create_subscription(String, "/riins/configuration", lambda m: configuration.append(m.data), 10)
    player = graph.start(
        "player", {"path": str(bag), "rate": 5, "start_offset_s": 4.0, "loop": True, "wait_for": ["/rimu/raw", "/riins/configuration"]}
    )
    graph.until(lambda: len(sink.raw) > 300)
    status, _, err = graph.stop(player, signal.SIGINT)
    assert status == 0, err
    sequence = [m.sequence for _, m in sink.raw]
    assert sequence[:200] == list(range(401, 601)) and sequence[200:300] == list(range(401, 501))
    assert configuration == ["scenario: {name: test}\n"]


def test_commands_come_before_the_first_sample_and_all_that_were_told_to_wait_for_hear_it(graph: Graph) -> None:
    with BagWriter(graph.folder / "bag") as writer:
        fill_bag(writer, 50)
        for k, target in ((0, "gps"), (20, "gyro_2")):  # recorded behind the stamp from which it holds
            writer.write_message(
                "/nav/commands", "riins_msgs/msg/SensorUse", {"header": {"stamp": EPOCH_NS + k * DT_NS}, "target": target}, EPOCH_NS + 40 * DT_NS
            )
    player = graph.start("player", {"path": str(graph.folder / "bag"), "wait_for": ["/rimu/raw", "/nav/commands"], "subscribers": [2, 1]})
    heard: list[str] = []
    latched = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    graph.node.create_subscription(SensorUse, "/nav/commands", lambda m: heard.append(m.target), latched)
    first: list[int] = []
    graph.node.create_subscription(RedundantImu, "/rimu/raw", lambda m: first.append(m.sequence), 1000)
    graph.until(lambda: graph.node.count_publishers("/rimu/raw") == 1)
    end = time.monotonic() + 0.5
    graph.until(lambda: time.monotonic() > end)
    assert player.poll() is None and not first  # one of two listens
    late: list[tuple[int, int]] = []
    graph.node.create_subscription(RedundantImu, "/rimu/raw", lambda m: late.append((m.sequence, len(heard))), 1000)
    graph.until(lambda: len(late) == 50)
    _, err = player.communicate(timeout=20)
    assert player.returncode == 0, err
    assert first == [k for k, _ in late] == list(range(1, 51)) and heard == ["gps", "gyro_2"]
    assert late[0][1] == 2, "a command came after a sample"


def test_bad_use_is_refused_in_one_line(graph: Graph) -> None:
    bag = str(make_bag(graph.folder / "bag", 100))
    with BagWriter(graph.folder / "old") as old:
        old.add_topic("/rimu/raw", "riins_msgs/msg/RedundantImu", schema="uint32 sequence\n", digest="RIHS01_" + "0" * 64)
        old.write("/rimu/raw", "riins_msgs/msg/RedundantImu", b"\0\1\0\0\1\0\0\0", 5)
    cut = graph.folder / "cut"
    cut.mkdir()
    (cut / "cut_0.mcap").write_bytes((graph.folder / "bag" / "bag_0.mcap").read_bytes()[:-100])
    cases = [
        ({}, 2, '"path" is missing'),
        ({"path": str(graph.folder / "none")}, 2, "no bag at"),
        ({"path": str(cut)}, 2, "riins bag recover"),
        ({"path": bag, "topics": ["/nothing"]}, 2, "has none of /nothing; it has /gps/fix, /nav"),
        ({"path": bag, "wait_for": ["/rimu/rw"]}, 2, 'did you mean "/rimu/raw"'),
        ({"path": bag, "wait_for": ["/rimu/raw"], "subscribers": [1, 2]}, 2, "one number for each of /rimu/raw, not 2"),
        ({"path": bag, "namespace": "ship"}, 2, "nothing in the namespace ship"),
        ({"path": bag, "rate": 0}, 2, "0.001 .. 1000"),
        ({"path": bag, "start_offset_s": 5.0}, 2, "behind the end of the bag"),
        ({"path": bag, "wait_timeout_s": 0.5}, 1, "not enough subscribers on /rimu/raw (0 of 1) after 0.5 s"),
        ({"path": str(graph.folder / "old")}, 1, "differs from the installed one"),
    ]
    for begin in range(0, len(cases), 3):  # a few at once: each start costs a second
        part = cases[begin : begin + 3]
        started = [graph.start("player", parameters) for parameters, _, _ in part]
        for process, (parameters, status, words) in zip(started, part, strict=True):
            _, err = process.communicate(timeout=60)
            last = err.strip().splitlines()[-1]
            assert process.returncode == status and words in last and last.startswith("player: error:"), (parameters, err)
