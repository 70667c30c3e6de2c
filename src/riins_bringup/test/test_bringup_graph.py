"""The graph as data: arguments, parameter files, one start for all, namespaces.

Lives here: tests of riins_bringup.graph without a running node.
Does not live here: the running graph (test/ at top level).
"""

from __future__ import annotations

import dataclasses

import pytest
import yaml

from riins_bringup.graph import GraphSettings, NodeSpec, build_graph, settings_from_words, write_files
from riins_core.settings import SettingError

START = 1_800_000_000_123_456_789


@pytest.fixture(scope="module")
def harbour():
    return build_graph(GraphSettings(scenario="harbour", record="some/bag", rate=2.0), START)


def test_arguments_name_namespace_and_file():
    spec = NodeSpec("p", "e", "n", namespace="/ship1/", remappings=(("a", "b"),), log_level="warn")
    assert spec.arguments("f.yaml") == [
        "--ros-args", "-r", "__node:=n", "-r", "__ns:=/ship1", "-r", "a:=b", "--log-level", "warn", "--params-file", "f.yaml",
    ]  # fmt: skip
    assert spec.topic("rimu/raw") == "/ship1/rimu/raw"
    assert "__ns" not in " ".join(NodeSpec("p", "e", "n").arguments())
    assert NodeSpec("p", "e", "n").topic("rimu/raw") == "/rimu/raw"


def test_parameter_file_keeps_values_exactly(tmp_path):
    values = {"a.b": 1.0 / 3.0, "tiny": 5e-324, "on": True, "n": 3, "word": "1.0", "list": [1, 0.1], "whole": [1, 2], "none": None, "empty": ()}
    spec = NodeSpec("p", "e", "n", parameters=values, files={"text_file": "hello: 1\n"})
    written = yaml.safe_load(write_files(spec, tmp_path).read_text())["/**"]["ros__parameters"]
    text_file = written.pop("text_file")
    assert open(text_file).read() == "hello: 1\n"
    # the ROS parameter file knows no empty list and no mixed one
    assert written == {"a.b": 1.0 / 3.0, "tiny": 5e-324, "on": True, "n": 3, "word": "1.0", "list": [1.0, 0.1], "whole": [1, 2]}
    assert all(isinstance(v, float) for v in written["list"])


def test_words_become_settings_or_one_error():
    assert settings_from_words({"rate": "3", "seed": "7", "scenario": "calm_12h"}) == GraphSettings(rate=3.0, seed=7, scenario="calm_12h")
    for words, message in (
        ({"rate": "fast"}, "rate"),
        ({"rte": "1"}, 'did you mean "rate"'),
        ({"rate": "0"}, "0.01"),
        ({"log_level": "loud"}, "one of"),
        ({"namespace": "a b"}, "namespace"),
        ({"namespace": "fleet//ship"}, "namespace"),
    ):
        with pytest.raises(SettingError, match=message):
            settings_from_words(words)


@pytest.mark.parametrize("name", ["", "/", "ship1", "/fleet/ship_1/"])
def test_namespaces_of_ros_are_taken(name):
    assert settings_from_words({"namespace": name}).namespace == name


def test_every_setting_has_a_description():
    for field in dataclasses.fields(GraphSettings):
        assert len(field.metadata["doc"]) > 10, field.name


def test_ship_graph_has_the_nodes_of_the_architecture(harbour):
    assert [(n.package, n.executable) for n in harbour.nodes] == [
        ("riins_imu_fusion", "imu_fusion"), ("riins_federated", "navigator"), ("riins_bag", "recorder"),
        ("riins_sim", "rimu"), ("riins_sim", "gps"), ("riins_sim", "bds"), ("riins_sim", "doppler"), ("riins_sim", "truth"),
    ]  # fmt: skip
    assert harbour.duration_s == 150.0 and harbour.wall_stamps


def test_one_start_rate_and_scenario_for_all_sources(harbour):
    sources = harbour.of("source")
    assert {n.parameters["start_at_ns"] for n in sources} == {START}
    assert {n.parameters["rate"] for n in sources} == {2.0}
    assert len({n.files["scenario"] for n in sources}) == 1
    moved = harbour.starting_at(START + 1)
    assert {n.parameters["start_at_ns"] for n in moved.of("source")} == {START + 1} and moved.start_at_ns == START + 1
    assert all("start_at_ns" not in n.parameters for n in moved.of("consumer", "observer"))


def test_recorder_gets_the_configuration_the_nodes_run_with(harbour):
    text = harbour.node("recorder").files["configuration_file"]
    recorded = yaml.safe_load(text)
    assert {"scenario", "fusion", "navigator"} <= set(recorded)
    assert recorded["start_at_ns"] == START
    moved = yaml.safe_load(harbour.starting_at(START + 7).node("recorder").files["configuration_file"])
    assert moved == {**recorded, "start_at_ns": START + 7}


def test_seed_and_duration_reach_sensors_and_bag():
    graph = build_graph(GraphSettings(scenario="harbour", seed=99, duration_s=20.0, record="bag"), START)
    for node in graph.of("source"):
        scenario = yaml.safe_load(node.files["scenario"])
        assert scenario["seed"] == 99 and scenario["duration_s"] == 20.0
    assert graph.duration_s == 20.0
    assert yaml.safe_load(graph.node("recorder").files["configuration_file"])["scenario"]["seed"] == 99


def test_no_recorder_unless_asked_and_namespace_for_all():
    graph = build_graph(GraphSettings(scenario="harbour", namespace="/ship1"))
    assert "recorder" not in [n.name for n in graph.nodes]
    assert {n.full_namespace for n in graph.nodes} == {"/ship1"}


def test_disabled_aid_has_no_node(tmp_path):
    text = build_graph(GraphSettings(scenario="harbour")).node("rimu").files["scenario"]
    scenario = yaml.safe_load(text)
    scenario["bds"]["enabled"] = False
    path = tmp_path / "no_bds.yaml"
    path.write_text(yaml.safe_dump(scenario))
    names = [n.name for n in build_graph(GraphSettings(scenario=str(path))).nodes]
    assert "bds" not in names and "gps" in names


def test_an_aircraft_has_the_nodes_of_its_aids_and_a_ship_none_of_them():
    graph = build_graph(GraphSettings(scenario="aircraft"))
    assert [n.name for n in graph.of("source")] == ["rimu", "gps", "doppler", "altimeter", "star_tracker", "truth"]
    heard = set(graph.node("navigator").subscribes)
    assert {"gps/fix", "gps/velocity", "doppler/velocity", "altimeter/height", "star_tracker/attitude"} <= heard
    published = {topic for n in graph.of("source") for topic in n.publishes}
    assert {topic for topic in published if not topic.startswith(("rimu", "truth", "nav"))} <= heard
    car = build_graph(GraphSettings(scenario="vehicle"))
    assert [n.name for n in car.of("source")] == ["rimu", "bds", "odometer", "altimeter", "truth"]
    ship = build_graph(GraphSettings(scenario="harbour"))
    assert [n.name for n in ship.of("source")] == ["rimu", "gps", "bds", "doppler", "truth"]


def test_bridge_only_where_asked_and_a_wrong_address_at_once():
    """nmea brings motion with it; neither is there otherwise; both are consumers that hear the navigator."""
    names = [n.name for n in build_graph(GraphSettings(scenario="harbour", motion=True)).of("consumer")]
    assert names == ["imu_fusion", "navigator", "motion"]
    words = {"scenario": "harbour", "nmea": "udp://127.0.0.1:10110, serial:///dev/ttyS0?baud=38400", "motion": "False"}
    graph = build_graph(settings_from_words(words))
    assert [n.name for n in graph.of("consumer")] == ["imu_fusion", "navigator", "motion", "nmea"]
    assert graph.node("nmea").parameters["outputs"] == ["udp://127.0.0.1:10110", "serial:///dev/ttyS0?baud=38400"]
    assert graph.node("nmea").parameters["simulator"] is True
    heard = {topic for n in graph.of("consumer") for topic in n.publishes}
    assert set(graph.node("nmea").subscribes) <= heard
    for nmea, message in (("127.0.0.1:10110", "\"nmea\": '127.0.0.1:10110' is no address; udp://HOST:PORT"), ("udp://a..b:1", "is not known")):
        with pytest.raises(SettingError, match=message):
            build_graph(GraphSettings(scenario="harbour", nmea=nmea))
    with pytest.raises(SettingError, match="true or false"):
        settings_from_words({"motion": "perhaps"})
