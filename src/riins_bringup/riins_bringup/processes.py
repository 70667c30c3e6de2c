"""Nodes as processes: start them from their installed executables, see who died, stop them in order.

Lives here: `Processes`, `find_executable`, `node_environment`, `GraphError`.
Does not live here: which nodes there are (graph.py), when time starts and what is shown (live.py).
"""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import time
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import NamedTuple

from riins_bringup.graph import NodeSpec, write_files

# SIGABRT makes Python's fault handler print where a node hangs, into its log
_STOP_SIGNALS = ((signal.SIGINT, 10.0), (signal.SIGTERM, 4.0), (signal.SIGABRT, 2.0), (signal.SIGKILL, 5.0))


class GraphError(Exception):
    """The graph cannot be started or did not become ready; one line."""


class Exit(NamedTuple):
    """A node that has ended: its name, its exit status (negative: the signal), the last lines it printed."""

    name: str
    status: int
    lines: list[str]

    def __str__(self) -> str:
        how = f"was killed by {signal.Signals(-self.status).name}" if self.status < 0 else f"ended with status {self.status}"
        return f'node "{self.name}" {how}'


def find_executable(package: str, executable: str, environment: Mapping[str, str] = os.environ) -> Path:
    """Path of the file that `ros2 run PACKAGE EXECUTABLE` runs.

    Raises
    ------
    GraphError
        The package or the executable is not under AMENT_PREFIX_PATH.
    """
    prefixes = [Path(p) for p in environment.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if p]
    for prefix in prefixes:
        path = prefix / "lib" / package / executable
        if os.access(path, os.X_OK) and path.is_file():
            return path
    raise GraphError(f'no executable "{executable}" of package "{package}" under AMENT_PREFIX_PATH; is the workspace built and its environment set?')


def loopback_profile(environment: Mapping[str, str] = os.environ) -> Path | None:
    """The installed Fast DDS profile that keeps traffic on this machine, or the one beside the sources; None if neither is there."""
    candidates = [Path(p) / "share/riins_bringup" for p in environment.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if p]
    candidates.append(Path(__file__).resolve().parents[1])
    return next((c / "config/fastdds_loopback.xml" for c in candidates if (c / "config/fastdds_loopback.xml").is_file()), None)


def node_environment(directory: Path, environment: Mapping[str, str] = os.environ) -> dict[str, str]:
    """Environment of a node: what the caller has, local discovery unless he chose another, logs under the run directory."""
    result = dict(environment)
    discovery = result.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    profile = loopback_profile(environment)
    if discovery == "LOCALHOST" and profile is not None:
        result.setdefault("FASTRTPS_DEFAULT_PROFILES_FILE", str(profile))
    result.setdefault("ROS_LOG_DIR", str(directory / "ros_log"))
    # one thread a process: on two cores nine processes with a BLAS pool each starve one another
    result.setdefault("OMP_NUM_THREADS", "1")
    result.setdefault("OPENBLAS_NUM_THREADS", "1")
    result["PYTHONUNBUFFERED"] = result["PYTHONFAULTHANDLER"] = "1"
    return result


def choose_network(beyond: bool) -> None:
    """Set this process's environment for discovery: this machine alone, or the subnet when `beyond`."""
    if not beyond:
        return
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "SUBNET"
    if os.environ.get("FASTRTPS_DEFAULT_PROFILES_FILE", "").endswith("fastdds_loopback.xml"):
        del os.environ["FASTRTPS_DEFAULT_PROFILES_FILE"]


class Processes:
    """The running nodes of one graph.

    Parameters
    ----------
    directory : run directory, made if missing; parameter files and one NAME.log a node go there
    environment : variables to start from; default: this process's
    """

    def __init__(self, directory: str | Path, environment: Mapping[str, str] | None = None) -> None:
        self.directory = Path(directory)
        self.directory.mkdir(parents=True, exist_ok=True)
        self.environment = node_environment(self.directory, os.environ if environment is None else environment)
        self._running: dict[str, subprocess.Popen[bytes]] = {}
        self._specs: dict[str, NodeSpec] = {}

    def __enter__(self) -> Processes:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all nodes ever started, in order."""
        return tuple(self._running)

    def start(self, *specs: NodeSpec) -> None:
        """Start nodes; returns when the processes exist, not when the nodes are ready.

        Raises
        ------
        GraphError
            An executable is missing.
        """
        commands = [(spec, find_executable(spec.package, spec.executable, self.environment)) for spec in specs]
        for spec, executable in commands:
            command = [*_tied_to_parent(self.environment), str(executable), *spec.arguments(write_files(spec, self.directory))]
            with open(self.log(spec.name), "ab") as log:
                # an own session: Ctrl-C in the terminal reaches the launcher alone, which stops the nodes in order
                # SIGINT waits until the node can take it (riins_node.entry): Python alone dies of one that comes while it starts
                mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
                try:
                    self._running[spec.name] = subprocess.Popen(
                        command, stdin=subprocess.DEVNULL, stdout=log, stderr=log, env=self.environment, start_new_session=True
                    )
                finally:
                    signal.pthread_sigmask(signal.SIG_SETMASK, mask)
            self._specs[spec.name] = spec

    def log(self, name: str) -> Path:
        """Path of what a node prints."""
        return self.directory / f"{name}.log"

    def tail(self, name: str, lines: int = 10) -> list[str]:
        """Last lines a node printed."""
        try:
            return self.log(name).read_text(errors="replace").rstrip().splitlines()[-lines:]
        except FileNotFoundError:
            return []

    def alive(self, name: str) -> bool:
        """True while the process runs."""
        return self._running[name].poll() is None

    def pid(self, name: str) -> int:
        """Process number of a node."""
        return self._running[name].pid

    def status(self, name: str) -> int | None:
        """Exit status; None while it runs."""
        return self._running[name].poll()

    def exited(self) -> list[Exit]:
        """Nodes that have ended, in starting order."""
        return [Exit(name, process.returncode, self.tail(name)) for name, process in self._running.items() if process.poll() is not None]

    def signal(self, name: str, number: int = signal.SIGINT) -> None:
        """Send a signal to one node; nothing happens if it has ended."""
        process = self._running[name]
        if process.poll() is None:
            process.send_signal(number)

    def wait(self, name: str, timeout: float) -> int | None:
        """Wait for the end of one node; its status, None when it still runs after `timeout` seconds."""
        try:
            return self._running[name].wait(timeout)
        except subprocess.TimeoutExpired:
            return None

    def stop(self, *names: str) -> dict[str, int]:
        """Stop nodes (default all: sources, then consumers, then observers), kindly first; status by name."""
        chosen = names or self.names
        for role in ("source", "consumer", "observer"):
            self._stop_together([n for n in chosen if self._specs[n].role == role])
        return {name: self._running[name].returncode for name in chosen}

    def _stop_together(self, names: Iterable[str]) -> None:
        waiting = [n for n in names if self.alive(n)]
        for number, patience in _STOP_SIGNALS:
            for name in waiting:
                self.signal(name, number)
            deadline = time.monotonic() + patience
            while waiting and time.monotonic() < deadline:
                time.sleep(0.02)
                waiting = [n for n in waiting if self.alive(n)]
            if not waiting:
                return


def _tied_to_parent(environment: Mapping[str, str]) -> list[str]:
    """Words before a command that make the kernel end it when the launcher is killed; none where util-linux is not installed."""
    setpriv = shutil.which("setpriv", path=environment.get("PATH"))
    return [setpriv, "--pdeathsig", "TERM", "--"] if setpriv else []
