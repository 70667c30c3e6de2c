"""What happens when parts die: aids, the recorder, the IMU, the scenario file, the bag.

Lives here: coasting after the loss of every aid, recovery of a killed recording, missing nodes, a restarted sensor.
Does not live here: wrong values (test_graph_bad_input.py), a launcher that sees its node die (riins_bringup/test).
"""

from __future__ import annotations

import math
import signal

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from harness import Listener, ns, own_domain, short_scenario, wait_until
from sensor_msgs.msg import NavSatFix

from riins_bag.bag import BagError, BagReader
from riins_bag.recover import recover
from riins_bringup.cli import main
from riins_bringup.graph import GraphSettings, build_graph
from riins_bringup.live import LiveRun
from riins_bringup.processes import Processes
from riins_bringup.watch import Watcher
from riins_eval import offline
from riins_msgs.msg import FederatedStatus, InitialState, NavState, RedundantImu, SubfilterStatus

TOPICS = {"/nav/state": NavState, "/nav/subfilters": FederatedStatus, "/gps/fix": NavSatFix, "/rimu/raw": RedundantImu, "/truth/state": NavState}


@pytest.fixture(scope="module")
def losses(tmp_path_factory):
    """A live run whose aids are killed one after the other, then its recorder (kill -9); GPS comes back in the end."""
    directory = tmp_path_factory.mktemp("losses")
    with own_domain(directory):
        path = short_scenario(directory, duration_s="60.0", faults="[]")
        path.write_text("\n".join(line for line in path.read_text().splitlines() if not line.startswith("  - {target")))
        graph = build_graph(GraphSettings(scenario=str(path), record=str(directory / "bag")))
        seen: dict = {"directory": directory, "graph": graph}
        with Listener(TOPICS) as listener, LiveRun(graph, directory / "logs") as live:
            live.start()
            processes = live.processes
            wait_until(lambda: len(listener.messages["/nav/state"]) > 350, 60.0, "navigation")
            seen["before"] = listener.last("/nav/state")
            processes.signal("gps", signal.SIGKILL)
            seen["dead"] = wait_until(live.dead, 20.0, "the death to be seen")
            for name in ("bds", "doppler"):
                processes.signal(name, signal.SIGKILL)
            seen["killed"] = listener.last("/nav/state")
            coasting = wait_until(
                lambda: [m for m in listener.messages["/nav/state"] if m.mode == NavState.MODE_COASTING and m.sequence > seen["killed"].sequence],
                20.0,
                "coasting",
            )
            seen["coasting"] = coasting[0]
            wait_until(lambda: listener.last("/nav/state").sequence > coasting[0].sequence + 150, 20.0, "more coasting")
            seen["status"] = listener.last("/nav/subfilters")
            seen["end_of_coasting"] = listener.last("/nav/state")
            processes.signal("recorder", signal.SIGKILL)
            processes.wait("recorder", 5.0)
            seen["killed_at_ns"] = ns(listener.last("/nav/state").header.stamp)
            # the sensor is started again in mid-run, by another launcher
            with Processes(directory / "again") as again:
                again.start(live.graph.node("gps"))
                wait_until(lambda: listener.last("/nav/state").mode == NavState.MODE_NAVIGATING, 30.0, "navigation with GPS again")
                seen["back"] = listener.last("/nav/state")
                wait_until(lambda: ns(listener.last("/gps/fix").header.stamp) > ns(seen["coasting"].header.stamp), 20.0, "a fix to be heard here")
            seen["start_ns"] = live.graph.start_at_ns
            seen["messages"] = {topic: list(messages) for topic, messages in listener.messages.items()}
        yield seen


def test_launcher_names_the_dead_node(losses):
    assert losses["dead"].name == "gps" and str(losses["dead"]) == 'node "gps" was killed by SIGKILL'


def test_navigator_coasts_when_every_aid_is_gone(losses):
    assert losses["before"].mode == NavState.MODE_NAVIGATING
    # absent after 3.5 intervals of 1 s by IMU stamps
    waited = (ns(losses["coasting"].header.stamp) - ns(losses["killed"].header.stamp)) * 1e-9
    assert 1.5 < waited < 5.0
    assert losses["status"].mode == NavState.MODE_COASTING
    states = {s.name: s.state for s in losses["status"].subfilters}
    assert {states[name] for name in ("gps", "bds", "doppler")} == {SubfilterStatus.ABSENT}
    assert losses["end_of_coasting"].sigma_north > losses["coasting"].sigma_north


def test_height_does_not_run_away_while_coasting(losses):
    height = [m.height for m in losses["messages"]["/nav/state"] if m.mode == NavState.MODE_COASTING]
    assert np.max(np.abs(np.array(height) - 40.0)) < 5.0


def test_no_imu_sample_is_lost_when_aids_die(losses):
    assert np.all(np.diff([m.sequence for m in losses["messages"]["/nav/state"]]) == 1)


def test_killed_recording_is_recovered_but_for_two_seconds(losses):
    bag = losses["directory"] / "bag"
    with pytest.raises(BagError):
        BagReader(bag).close()
    report = recover(bag, losses["directory"] / "recovered")
    with BagReader(report.out) as reader:
        stamps = [ns(m.header.stamp) for _, _, m in reader.read(["/rimu/raw"])]
        assert reader.configuration() == losses["graph"].starting_at(losses["start_ns"]).node("recorder").files["configuration_file"]
    assert stamps[0] == losses["start_ns"] + 10_000_000 and np.all(np.diff(stamps) == 10_000_000)
    assert (losses["killed_at_ns"] - stamps[-1]) * 1e-9 < 2.0


def test_recovered_bag_can_be_navigated(losses):
    recovered = losses["directory"] / "recovered"
    if not recovered.exists():
        recover(losses["directory"] / "bag", recovered)
    result = offline.navigate(recovered, None, record="none")
    assert result.score["samples"]["lost"] == 0 and result.score["position_rms_m"] < 10.0


def test_restarted_sensor_goes_on_where_it_would_be(losses):
    """Noise is addressed by sample number: the fixes after the restart are those of a sensor that never died."""
    from riins_sim.scenario import from_yaml
    from riins_sim.sensors import PositionSim

    scenario = from_yaml(losses["graph"].node("gps").files["scenario"])
    gps = PositionSim(scenario, "gps")
    fixes = [m for m in losses["messages"]["/gps/fix"] if ns(m.header.stamp) > ns(losses["coasting"].header.stamp)]
    assert fixes
    for message in fixes:
        t = (ns(message.header.stamp) - losses["start_ns"]) * 1e-9
        assert t == pytest.approx(round(t), abs=1e-9)
        sample = gps.block(round(t), 1)
        assert math.radians(message.latitude) == pytest.approx(float(sample.lat[0]), abs=1e-14)


def test_missing_rimu_is_said_and_does_not_hang(tmp_path):
    """Without the IMU node the navigator waits, says so, and still ends with status 0."""
    with own_domain(tmp_path):
        graph = build_graph(GraphSettings(scenario=str(short_scenario(tmp_path)))).without("rimu")
        with (
            Listener({"/diagnostics": DiagnosticArray, "/nav/state": NavState}) as listener,
            Processes(tmp_path / "logs") as processes,
            Watcher() as watcher,
        ):
            processes.start(*graph.nodes)
            assert watcher.wait_for(graph.nodes, 60.0) == []

            def complaints() -> set[str]:
                return {s.name.split(":")[0] for m in listener.messages["/diagnostics"] for s in m.status if "no IMU" in s.message}

            wait_until(lambda: {"navigator", "imu_fusion"} <= complaints(), 20.0, "both nodes to say that there is no IMU")
            assert listener.messages["/nav/state"] == []
            assert set(processes.stop().values()) == {0}


def test_up_with_a_missing_package_is_one_line_and_status_1(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))
    with own_domain(tmp_path):
        status = main(["up", str(short_scenario(tmp_path)), "--logs", str(tmp_path / "logs")])
    assert status == 1
    assert 'no executable "imu_fusion"' in " ".join(capsys.readouterr().out.split())


def test_truncated_bag_is_one_clear_line(tmp_path, capsys):
    path = short_scenario(tmp_path, duration_s="2.0")
    offline.sail(path, bag=tmp_path / "bag", record="all", twins=False)
    (file,) = (tmp_path / "bag").glob("*.mcap")
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    for verb in (["up", "--bag"], ["score"], ["report"], ["bag", "info"], ["bag", "play"]):
        assert main([*verb, str(tmp_path / "bag")]) == 2
        error = capsys.readouterr().err
        assert error.startswith("riins: error: ") and error.count("\n") == 1 and "recover" in error
    assert main(["navigate", str(tmp_path / "bag"), "--out", str(tmp_path / "out")]) == 2
    assert not (tmp_path / "out").exists()


def test_initial_state_is_latched_for_a_navigator_that_starts_late(tmp_path):
    """The navigator is started after the truth has published the initial state."""
    with own_domain(tmp_path):
        graph = build_graph(GraphSettings(scenario=str(short_scenario(tmp_path))))
        with Listener({"/nav/initial_state": InitialState}, ("/nav/initial_state",)) as listener, Processes(tmp_path / "logs") as processes:
            processes.start(graph.node("truth"))
            wait_until(lambda: listener.messages["/nav/initial_state"], 60.0, "the initial state")
            with Watcher() as watcher:
                processes.start(graph.node("navigator"))
                assert watcher.wait_for([graph.node("navigator")], 60.0) == []
            with Listener({"/nav/subfilters": FederatedStatus}, ("/nav/subfilters",)):
                assert set(processes.stop().values()) == {0}
