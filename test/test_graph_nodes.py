"""Every node by itself, as `ros2 run` starts it: status 0 after SIGINT and SIGTERM, 2 after a wrong parameter, with one line that says why.

Lives here: start, parameters and end of the installed executables.
Does not live here: what they do together (test_graph_live.py).
"""

from __future__ import annotations

import os
import signal
import subprocess
import time
from pathlib import Path

import pytest
from harness import own_domain, short_scenario

from riins_bringup.graph import GraphSettings, NodeSpec, build_graph
from riins_bringup.processes import Processes, find_executable
from riins_bringup.watch import Watcher
from riins_eval import offline

EXECUTABLES = {
    "imu_fusion": "riins_imu_fusion",
    "imu_array": "riins_imu_fusion",
    "navigator": "riins_federated",
    "recorder": "riins_bag",
    "player": "riins_bag",
    "nmea": "riins_nmea",
    "motion": "riins_nmea",
    "rimu": "riins_sim",
    "gps": "riins_sim",
    "bds": "riins_sim",
    "doppler": "riins_sim",
    "odometer": "riins_sim",
    "altimeter": "riins_sim",
    "star_tracker": "riins_sim",
    "truth": "riins_sim",
}
ALIKE = ("bds", "odometer", "altimeter", "star_tracker")
"""Their code is that of gps and doppler but for the sensor: they are stopped in one way only."""
# the simulated sensors: scenari
MISSPELT = {"imu_fusion": "gyro_sgma", "imu_array": "gyro_sgma", "navigator": "max_dela_s", "recorder": "pth", "player": "rat"}
MISSPELT |= {"nmea": "talkr", "motion": "pont_m"}
NEAREST = {"imu_fusion": "gyro_sigma", "imu_array": "gyro_sigma", "navigator": "max_delay_s", "recorder": "path", "player": "rate"}
NEAREST |= {"nmea": "talker", "motion": "point_m"}


@pytest.fixture(scope="module")
def scenario(tmp_path_factory) -> Path:
    """The short scenario with all sensors there are."""
    path = short_scenario(tmp_path_factory.mktemp("scenario"))
    further = [f"{name}: {{enabled: true}}\n" for name in ("odometer", "altimeter", "star_tracker")]
    path.write_text(path.read_text() + "".join(further))
    return path


@pytest.fixture(scope="module")
def raw_bag(scenario) -> Path:
    bag = scenario.with_name("raw")
    offline.sail(scenario, bag=bag, record="raw", twins=False)
    return bag


def every_node(scenario: Path, bag: Path, record: Path) -> list[NodeSpec]:
    ship = build_graph(GraphSettings(scenario=str(scenario), record=str(record), nmea="udp://127.0.0.1:9"))
    player = build_graph(GraphSettings(bag=str(bag))).node("player")
    array = NodeSpec("riins_imu_fusion", "imu_array", "imu_array", subscribes=("imu_0/raw",), publishes=("rimu/fusion_parameters",))
    return [*ship.nodes, array, NodeSpec("riins_bag", "player", "player", "source", {**player.parameters, "loop": True}, publishes=("rimu/raw",))]


def test_every_executable_of_the_workspace_is_installed_and_tested_here(root):
    assert {script.name: script.parents[1].name for script in root.glob("src/*/scripts/*") if script.name != "riins"} == EXECUTABLES
    assert all(os.access(find_executable(package, name), os.X_OK) for name, package in EXECUTABLES.items())


@pytest.mark.parametrize(
    "signals", [(signal.SIGINT,), (signal.SIGTERM,), (signal.SIGINT, signal.SIGINT, signal.SIGINT)], ids=["INT", "TERM", "INT INT INT"]
)
def test_every_node_ends_with_status_0(scenario, raw_bag, tmp_path, signals):
    specs = every_node(scenario, raw_bag, tmp_path / "bag")
    assert {s.name for s in specs} == set(EXECUTABLES)
    if signals != (signal.SIGINT,):
        specs = [s for s in specs if s.name not in ALIKE]
    with own_domain(tmp_path), Processes(tmp_path / "logs") as processes, Watcher() as watcher:
        processes.start(*specs)
        assert watcher.wait_for(specs, 120.0) == []
        assert processes.exited() == []
        for name in processes.names:
            for number in signals:
                processes.signal(name, number)
        assert {name: processes.wait(name, 20.0) for name in processes.names} == {s.name: 0 for s in specs}
        assert not any("Traceback" in line for name in processes.names for line in processes.tail(name, 200))
    assert (tmp_path / "bag/metadata.yaml").is_file()


@pytest.mark.parametrize("delay_s", [0.0, 0.05, 0.2, 0.5])
def test_interrupt_while_python_imports_ends_with_status_0(scenario, raw_bag, tmp_path, delay_s):
    specs = [s for s in every_node(scenario, raw_bag, tmp_path / "bag") if s.name not in ALIKE]
    with own_domain(tmp_path), Processes(tmp_path / "logs") as processes:
        processes.start(*specs)
        time.sleep(delay_s)
        for name in processes.names:
            processes.signal(name)
        assert {name: processes.wait(name, 30.0) for name in processes.names} == {s.name: 0 for s in specs}
        said = {name: processes.tail(name, 200) for name in processes.names}
    assert not any("Traceback" in line for lines in said.values() for line in lines), said


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("name", ["gps", "recorder", "imu_fusion", "navigator"])
def test_alone_it_can_be_interrupted_from_its_first_line_on(tmp_path, name, number):
    with own_domain(tmp_path):
        process = subprocess.Popen([find_executable(EXECUTABLES[name], name)], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        deadline = time.monotonic() + 60.0
        while not catches(process.pid, signal.SIGTERM):  # Python itself catches SIGINT alone
            assert process.poll() is None and time.monotonic() < deadline
            time.sleep(0.001)
        process.send_signal(number)
        assert process.communicate(timeout=60.0)[0] == ""
    assert process.returncode == 0


def test_interrupt_that_was_ignored_at_the_start_stays_ignored_while_importing(tmp_path):
    with own_domain(tmp_path):
        words = ["sh", "-c", 'trap "" INT; exec "$0" "$@"', find_executable("riins_sim", "gps"), "--print-parameters"]
        process = subprocess.Popen(words, stdout=subprocess.PIPE, text=True)
        while process.poll() is None and not catches(process.pid, signal.SIGTERM):
            time.sleep(0.001)
        process.send_signal(signal.SIGINT)
        assert "scenario" in process.communicate(timeout=60.0)[0]
    assert process.returncode == 0


def catches(pid: int, number: int) -> bool:
    """Whether a process has a handler for a signal, as the kernel says."""
    caught = next((line for line in Path(f"/proc/{pid}/status").read_text().splitlines() if line.startswith("SigCgt")), "SigCgt: 0")
    return bool(int(caught.split()[1], 16) >> (number - 1) & 1)


def run_all(tmp_path: Path, arguments: dict[str, list[str]]) -> dict[str, tuple[int, list[str]]]:
    """Start all executables at once with these arguments; status and lines of each."""
    with own_domain(tmp_path):
        started = {
            name: subprocess.Popen(
                [find_executable(package, name), "--ros-args", *arguments[name]], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
            )
            for name, package in EXECUTABLES.items()
        }
        lines = {name: process.communicate(timeout=120.0)[0].strip().splitlines() for name, process in started.items()}
    return {name: (started[name].returncode, lines[name]) for name in started}


def test_unknown_parameter_is_refused_with_the_nearest_name(tmp_path):
    ended = run_all(tmp_path, {name: ["-p", f"{MISSPELT.get(name, 'scenari')}:=1"] for name in EXECUTABLES})
    for name, (status, lines) in ended.items():
        assert status == 2, (name, lines)
        assert len(lines) == 1 and MISSPELT.get(name, "scenari") in lines[0] and f'"{NEAREST.get(name, "scenario")}"' in lines[0], (name, lines)


def test_wrong_type_or_range_is_refused(tmp_path):
    wrong = {
        "imu_fusion": ["-p", "status_period_s:=-1.0"],
        "imu_array": ["-p", "topics:=['a', 'a']"],
        "navigator": ["-p", "gps.sigma_m:=[1.0, 2.0]"],
        "recorder": ["-p", "flush_period_s:=soon"],
        "player": ["-p", "rate:=0.0"],
        "nmea": ["-p", "rate_hz.gga:=11"],
        "motion": ["-p", "cutoff_period_s:=1.0"],
        "rimu": ["-p", "scenario:=harbor"],
        "gps": ["-p", "rate:=1000.0"],
        "bds": ["-p", "seed:=-5"],
        "doppler": ["-p", "start_at_ns:=now"],
        "odometer": ["-p", "rate:=fast"],
        "altimeter": ["-p", "scenario:=harbour"],  # which has none
        "star_tracker": ["-p", "k_start:=-2"],
        "truth": ["-p", "state_period_s:=0.0"],
    }
    for name, (status, lines) in run_all(tmp_path, wrong).items():
        assert status == 2, (name, lines)
        assert len(lines) == 1 and "Traceback" not in lines[0], (name, lines)
