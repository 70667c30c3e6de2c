"""The shipped unaligned harbour, shortened, as a live graph: nothing is known of the attitude, a gyro drifts away, she aligns and sails; law 2.

Lives here: phases, validity and isolation as another stack sees them, the recording navigated again.
Does not live here: the methods and bad cases (riins_federated/test/test_fed_aligner.py), the action (test_fed_align_node.py).
"""

from __future__ import annotations

import math
from itertools import groupby
from pathlib import Path

import pytest
import yaml
from harness import Listener, by_stamp, ns, own_domain, settled_distance, wait_until

from riins_bag.bag import BagReader
from riins_bringup.graph import GraphSettings, build_graph
from riins_bringup.live import LiveRun
from riins_eval import offline
from riins_msgs.msg import AlignmentStatus, InertialFdi, NavState
from riins_sim.scenario_file import find

DATA_S, END_S = 90.0, 105.0


def shortened(directory: Path) -> Path:
    """The scenario with an IMU that can be hurried, half of the data, and a limit that fits them."""
    scenario = yaml.safe_load(Path(find("harbour_unaligned")).read_text())
    scenario |= {"imu_rate_hz": 25, "duration_s": END_S + 0.5, "scoring": {"from_s": DATA_S + 2.0}, "expect": {}}
    scenario["legs"][0]["straight_s"] = DATA_S + 2.0
    scenario["bds"] = scenario["doppler"] = {"enabled": False}  # two processes less; at a quay the GPS is enough
    scenario["navigator"] = {"alignment": {"method": "auto", "data_s": DATA_S}, "validity": {"heading_deg": 3.0, "heading_invalid_deg": 5.0}}
    scenario["faults"][0] |= {"start_s": 20.0, "end_s": 45.0}
    path = directory / "unaligned.yaml"
    path.write_text(yaml.safe_dump(scenario))
    return path


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    directory = tmp_path_factory.mktemp("unaligned")
    topics = {"/nav/state": NavState, "/nav/alignment": AlignmentStatus, "/truth/state": NavState, "/fdi/status": InertialFdi}
    with own_domain(directory):
        graph = build_graph(GraphSettings(scenario=str(shortened(directory)), record=str(directory / "bag"), rate=6.0))
        with Listener(topics, latched=("/nav/alignment",)) as listener, LiveRun(graph, directory / "logs") as live:
            live.start()
            wait_until(lambda: live.finished() or live.dead(), 120.0, "the end of the scenario")
            assert live.dead() is None, live.dead()
            start_ns = live.graph.start_at_ns
            assert set(live.processes.stop().values()) == {0}
        yield directory / "bag", listener.messages, start_ns


def test_she_aligns_at_the_quay_and_sails(run):
    _, messages, start_ns = run
    statuses = messages["/nav/alignment"]
    phases = [phase for phase, _ in groupby(m.phase for m in statuses)]
    assert phases[-1] == AlignmentStatus.NAVIGATING and phases == sorted(phases) and AlignmentStatus.FINE in phases
    texts = " ".join(m.text for m in statuses)
    assert "swaying at one place" in texts and "aligned by swaying" in texts and "heading settled after" in texts
    last = statuses[-1]
    assert last.code == AlignmentStatus.CODE_FULL and DATA_S <= last.settle_time <= DATA_S + 1.5 and last.heading_bound < last.heading_limit
    states = messages["/nav/state"]
    before = [m for m in states if m.mode == NavState.MODE_ALIGNMENT]
    assert len(before) > 60 and {m.heading_validity for m in before} == {NavState.INVALID}
    after = [m for m in states if m.mode == NavState.MODE_NAVIGATING]
    assert ns(after[0].header.stamp) > start_ns + DATA_S * 1e9 and {m.mode for m in states} == {NavState.MODE_ALIGNMENT, NavState.MODE_NAVIGATING}
    truth = {ns(m.header.stamp): m for m in messages["/truth/state"]}
    scaled = [
        math.remainder(m.heading - truth[ns(m.header.stamp)].heading, 2.0 * math.pi) / m.sigma_heading for m in after if ns(m.header.stamp) in truth
    ]
    assert len(scaled) > 20 and max(map(abs, scaled)) < 4.0


def test_the_gyro_was_isolated_meanwhile(run):
    _, messages, start_ns = run
    isolated = [m for m in messages["/fdi/status"] if m.gyro.state[2] in (2, 4)]  # isolated, or used without its drift
    assert isolated and ns(isolated[0].header.stamp) < start_ns + 45e9
    assert all(state == 0 for m in messages["/fdi/status"] for i, state in enumerate(m.gyro.state) if i != 2)


def test_live_equals_offline(run):
    bag, _, _ = run
    again = bag.with_name("again")
    result = offline.navigate(bag, again, record="nav")
    with BagReader(bag) as reader:
        assert "/nav/initial_state" not in reader.topics
    live, computed = by_stamp(bag, "/nav/settled"), by_stamp(again, "/nav/settled")
    assert len(live) >= 9 and set(live) <= set(computed)
    assert max(settled_distance(live[stamp], computed[stamp]) for stamp in live) <= 1e-9
    said = [(ns(m.header.stamp), m.phase, m.method, m.text) for m in by_stamp(bag, "/nav/alignment").values()]
    computed_said = [(ns(m.header.stamp), m.phase, m.method, m.text) for m in by_stamp(again, "/nav/alignment").values()]
    assert said == computed_said[: len(said)] and len(said) > 90
    assert result.score["alignment"]["aligned"] and abs(result.score["alignment"]["heading_error_arcmin"]) < 60.0
