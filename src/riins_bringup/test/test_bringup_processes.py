"""Processes of a graph: found, started, watched, stopped in order.

Lives here: tests of riins_bringup.processes with toy executables.
Does not live here: tests with real nodes (test/ at top level).
"""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import textwrap
import time

import pytest

from riins_bringup.graph import NodeSpec
from riins_bringup.processes import GraphError, Processes, find_executable, node_environment

WELL_BEHAVED = """
import signal, sys, time
signal.signal(signal.SIGINT, lambda *_: (open(sys.argv[-1] + ".stopped", "w").write(str(time.time())), sys.exit(0)))
signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
print("up", flush=True)
while True: time.sleep(0.01)
"""
DYING = "import sys; print('first line'); print('kernel: no such geometry'); sys.exit(3)"
STUBBORN = """
import signal, time
signal.signal(signal.SIGINT, signal.SIG_IGN); signal.signal(signal.SIGTERM, signal.SIG_IGN)
print("up", flush=True)
while True: time.sleep(0.01)
"""


@pytest.fixture
def toys(tmp_path):
    folder = tmp_path / "prefix/lib/toys"
    folder.mkdir(parents=True)
    for name, text in (("good", WELL_BEHAVED), ("dying", DYING), ("stubborn", STUBBORN)):
        path = folder / name
        path.write_text(f"#!{sys.executable}\n{textwrap.dedent(text)}")
        path.chmod(0o755)
    return {**os.environ, "AMENT_PREFIX_PATH": str(tmp_path / "prefix")}


def wait_until(condition, timeout=10.0):
    deadline = time.monotonic() + timeout
    while not condition():
        assert time.monotonic() < deadline, "waited too long"
        time.sleep(0.01)


def test_missing_executable_is_one_clear_error(toys):
    with pytest.raises(GraphError, match='no executable "rimu" of package "toys"'):
        find_executable("toys", "rimu", toys)


def test_nothing_starts_when_one_executable_is_missing(toys, tmp_path):
    with Processes(tmp_path / "run", toys) as processes:
        with pytest.raises(GraphError):
            processes.start(NodeSpec("toys", "good", "a"), NodeSpec("toys", "none", "b"))
        assert processes.names == ()


def test_dead_node_tells_its_last_lines(toys, tmp_path):
    with Processes(tmp_path / "run", toys) as processes:
        processes.start(NodeSpec("toys", "dying", "fusion"))
        assert processes.wait("fusion", 10.0) == 3
        (end,) = processes.exited()
    assert end.lines == ["first line", "kernel: no such geometry"]
    assert str(end) == 'node "fusion" ended with status 3'


def test_sources_stop_before_consumers_before_observers(toys, tmp_path):
    roles = {"recorder": "observer", "navigator": "consumer", "gps": "source"}
    with Processes(tmp_path / "run", toys) as processes:
        processes.start(*(NodeSpec("toys", "good", name, role) for name, role in roles.items()))
        wait_until(lambda: all(processes.tail(name) == ["up"] for name in roles))
        assert processes.exited() == []
        assert processes.stop() == dict.fromkeys(roles, 0)
    when = [float((tmp_path / f"run/{name}.params.yaml.stopped").read_text()) for name in ("gps", "navigator", "recorder")]
    assert when == sorted(when)


def test_stubborn_node_is_killed_and_reported(toys, tmp_path, monkeypatch):
    monkeypatch.setattr("riins_bringup.processes._STOP_SIGNALS", ((signal.SIGINT, 0.2), (signal.SIGTERM, 0.2), (signal.SIGKILL, 5.0)))
    with Processes(tmp_path / "run", toys) as processes:
        processes.start(NodeSpec("toys", "stubborn", "x"))
        wait_until(lambda: processes.tail("x") == ["up"])
        assert processes.stop() == {"x": -signal.SIGKILL}
        assert str(processes.exited()[0]) == 'node "x" was killed by SIGKILL'


@pytest.mark.skipif(shutil.which("setpriv") is None, reason="setpriv of util-linux is not installed")
def test_killed_launcher_leaves_no_node_behind(toys, tmp_path):
    code = (
        "from riins_bringup.processes import Processes; from riins_bringup.graph import NodeSpec; import time\n"
        f"p = Processes({str(tmp_path / 'run')!r}); p.start(NodeSpec('toys', 'good', 'x'))\n"
        "while p.tail('x') != ['up']: time.sleep(0.05)\n"  # it is tied to its parent by then
        "print(p.pid('x'), flush=True); time.sleep(60)"
    )
    with subprocess.Popen([sys.executable, "-c", code], env=toys, stdout=subprocess.PIPE, text=True) as launcher:
        pid = int(launcher.stdout.readline())
        launcher.kill()
        launcher.wait()

    def gone() -> bool:
        try:
            return open(f"/proc/{pid}/stat").read().rsplit(")", 1)[1].split()[0] == "Z"
        except FileNotFoundError:
            return True

    wait_until(gone)


def test_environment_keeps_what_the_user_chose(tmp_path):
    environment = node_environment(tmp_path, {"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"})
    assert environment["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "SUBNET" and "FASTRTPS_DEFAULT_PROFILES_FILE" not in environment
    environment = node_environment(tmp_path, {"AMENT_PREFIX_PATH": os.environ["AMENT_PREFIX_PATH"]})
    assert environment["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "LOCALHOST"
    assert environment["FASTRTPS_DEFAULT_PROFILES_FILE"].endswith("config/fastdds_loopback.xml")
