"""Law 2 on one live run: what was settled live is what the offline engine and replays make of its recording.

Lives here: live = offline, replay = offline at other paces, in namespaces, with commands.
Does not live here: the run itself (live_ship.py), what is on its topics (test_graph_live.py), law 2 without DDS (riins_eval).
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pytest
from harness import Listener, by_stamp, ns, own_domain, settled_distance, wait_until

from riins_bag.bag import BagReader, BagWriter
from riins_bag.recording import RAW_TOPICS, selected
from riins_bringup.graph import GraphSettings, build_graph
from riins_bringup.live import LiveRun
from riins_eval import offline
from riins_msgs.msg import FederatedStatus, InertialFdi, NavState, SubfilterStatus, TriadFdi
from riins_node import fields


@pytest.fixture(scope="module")
def offline_bag(run):
    """What the offline engine makes of the live recording."""
    out = run.bag.with_name("offline")
    offline.navigate(run.bag, out, record="nav")
    return out


def assert_law_2(settled: dict[int, Any], reference: dict[int, Any]) -> None:
    """Every settled state is there, within 1e-9; the offline engine alone settles what no later sample could change any more."""
    assert len(settled) >= 12 and set(settled) <= set(reference)
    assert max(settled_distance(settled[stamp], reference[stamp]) for stamp in settled) <= 1e-9


def decisions(statuses: list[Any], until_ns: int) -> list[tuple[int, int, int, int]]:
    """Every state of health of every gyro and accelerometer with its beginning, in order."""
    seen: list[tuple[int, int, int, int]] = []
    for message in statuses:
        for kind, triad in enumerate((message.gyro, message.accel)):
            for i, state in enumerate(triad.state):
                entry = (ns(triad.since[i]), kind, i, int(state))
                if entry not in seen and entry[0] <= until_ns:
                    seen.append(entry)
    return sorted(seen)


def settled_events(statuses: Iterable[Any], until_ns: int) -> set[tuple[int, int, str, int, int]]:
    """What the navigator told as settled up to a stamp."""
    events = [e for message in statuses for e in message.events]
    return {(ns(e.stamp), int(e.kind), e.target, int(e.state), int(e.reason)) for e in events if ns(e.stamp) <= until_ns}


def test_live_equals_offline(run, offline_bag):
    settled = {ns(m.header.stamp): m for m in run.messages["/nav/settled"]}
    assert by_stamp(run.bag, "/nav/settled").keys() == settled.keys()
    assert_law_2(settled, by_stamp(offline_bag, "/nav/settled"))
    until = max(settled)
    recorded = list(by_stamp(offline_bag, "/fdi/status").values())
    assert decisions(run.messages["/fdi/status"], until) == decisions(recorded, until)
    told = settled_events(run.messages["/nav/subfilters"], until)
    with BagReader(offline_bag) as reader:
        assert told == settled_events([m for _, _, m in reader.read(["/nav/subfilters"])], until)
    assert {(target, state) for _, _, target, state, _ in told} >= {("gps", SubfilterStatus.ISOLATED), ("", 0)}


def test_live_counters_equal_offline(run, offline_bag):
    live = {s.name: (s.accepted, s.rejected, s.late, s.malformed) for s in run.messages["/nav/subfilters"][-1].subfilters}
    with_offline = list(by_stamp(offline_bag, "/nav/subfilters").values())[-1]
    assert live == {s.name: (s.accepted, s.rejected, s.late, s.malformed) for s in with_offline.subfilters}


def told(source: Path, out: Path, start_ns: int) -> None:
    """The raw topics of a recording as one made in a namespace, with commands that came behind the stamps from which they hold."""
    commands = [("gyro_5", False, 0), ("bds", False, 4.0), ("accel_1", False, 5.005), ("bds", True, 8.0), ("gyro_5", True, 9.0)]
    with BagReader(source) as reader, BagWriter(out, flush_period_s=0.0) as writer:
        for topic, msgtype, data, log_ns in reader.messages([t for t in reader.topics if selected(t, RAW_TOPICS)]):
            name = topic if topic == "/riins/configuration" else f"/fleet/ship2{topic}"
            writer.write(name, msgtype, data, log_ns, reader.qos(topic) or "navigation")
        for target, use, at_s in commands:
            stamp = start_ns + round(at_s * 1e9) if at_s else 0
            content = fields.sensor_use(stamp, target, use)
            writer.write_message("/fleet/ship2/nav/commands", "riins_msgs/msg/SensorUse", content, (stamp or start_ns) + 50_000_000, "commands")


@pytest.mark.parametrize(("rate", "namespace", "commanded"), [(1.0, "ship1", False), (3.0, "", True)])
def test_replay_equals_offline(run, offline_bag, rate, namespace, commanded, tmp_path):
    """At the recorded pace, in a namespace, and at three times the pace a recording of another namespace, with commands."""
    prefix, bag = f"/{namespace}" if namespace else "", run.bag
    if commanded:
        bag, offline_bag = tmp_path / "told", tmp_path / "offline"
        told(run.bag, bag, run.start_ns)
        offline.navigate(bag, offline_bag, record="nav")
    with own_domain(tmp_path):
        graph = build_graph(GraphSettings(bag=str(bag), rate=rate, namespace=namespace))
        topics = {f"{prefix}/nav/settled": NavState, f"{prefix}/fdi/status": InertialFdi, f"{prefix}/nav/subfilters": FederatedStatus}
        with Listener(topics) as listener, LiveRun(graph, tmp_path / "logs") as live:
            live.start()
            wait_until(lambda: live.finished() or live.dead(), 60.0, "the end of the bag")
            assert live.dead() is None, live.dead()
            assert live.processes.stop() == {"imu_fusion": 0, "navigator": 0, "player": 0}
    last = listener.last(f"{prefix}/nav/subfilters")
    assert (last.imu_lost, last.restarts, sum(s.late for s in last.subfilters)) == (0, 0, 0), "not comparable"
    settled = {ns(m.header.stamp): m for m in listener.messages[f"{prefix}/nav/settled"]}
    assert_law_2(settled, by_stamp(offline_bag, "/nav/settled"))
    until = max(settled)
    recorded = decisions(list(by_stamp(offline_bag, "/fdi/status").values()), until)
    assert decisions(listener.messages[f"{prefix}/fdi/status"], until) == recorded
    if commanded:
        excluded = {(kind, i) for _, kind, i, state in recorded if state == TriadFdi.EXCLUDED}
        assert excluded == {(0, 5), (1, 1)}
        health = {s.state for m in listener.messages[f"{prefix}/nav/subfilters"] for s in m.subfilters if s.name == "bds"}
        assert SubfilterStatus.EXCLUDED in health
