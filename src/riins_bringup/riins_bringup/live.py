"""A live run: start the graph, wait until it is connected, let time begin, watch it, stop it, sum it up.

Lives here: `run_live` and `LiveRun`.
Does not live here: the nodes (graph.py), processes (processes.py), observation (monitor.py, watch.py), drawing (table.py).
"""

from __future__ import annotations

import dataclasses
import json
import math
import os
import signal
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import FrameType, TracebackType
from typing import Any

from rich.console import Console
from rich.live import Live

from riins_bringup.graph import Graph, NodeSpec, write_files
from riins_bringup.monitor import Monitor
from riins_bringup.processes import Exit, GraphError, Processes
from riins_bringup.table import change_line, live_table, not_comparable, plain_line, summary_table
from riins_bringup.watch import Watcher

DISCOVERY_S = 1.0
"""So long the launcher looks whether another graph is in its domain."""
READY_TIMEOUT_S = 180.0  # cold kernels compile in the nodes' on_configure
MATCHING_S = 1.0  # that we see two endpoints does not mean that they have seen each other; a player's first message must not be lost
_QUIET_S = 1.5  # no navigation state for this long at the end: all is settled
_STALLED_S = 60.0
_SILENT_S = 5.0  # a run whose navigation ends this much before it is not complete
_PLAIN_PERIOD_S = 5.0


@dataclass
class Outcome:
    """How a run ended: `status` 0 (scenario end or on the user's word) or 1, one line, the dead node if one died, whether all had started.

    A node interrupted while Python still imports its modules cannot end with status 0.
    """

    status: int
    ended: str
    dead: Exit | None = None
    started: bool = True


class Interrupt:
    """Remembers SIGINT and SIGTERM instead of dying of them, as often as they come."""

    def __init__(self) -> None:
        self.event = threading.Event()
        self._before: dict[int, Any] = {}

    def __enter__(self) -> Interrupt:
        for number in (signal.SIGINT, signal.SIGTERM):
            self._before[number] = signal.signal(number, self._received)
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _received(self, number: int, frame: FrameType | None) -> None:
        self.event.set()


def run_directory(title: str) -> Path:
    """A new directory for parameter files and logs, where ROS keeps its logs (ROS_LOG_DIR, else ROS_HOME/log, else ~/.ros/log)."""
    home = Path(os.environ.get("ROS_HOME") or Path.home() / ".ros")
    base = Path(os.environ.get("ROS_LOG_DIR") or home / "log")
    stem = Path(title).stem or "run"
    return base / f"riins-{stem}-{time.strftime('%Y%m%d-%H%M%S')}-{os.getpid()}"


class LiveRun:
    """The running graph with its observer; a context manager that leaves no process behind.

    Parameters
    ----------
    graph : what to start
    directory : run directory
    say : where one-line news go
    """

    def __init__(self, graph: Graph, directory: Path, say: Callable[[str], None] = print) -> None:
        self.graph = graph
        self.say = say
        self.processes = Processes(directory)
        os.environ.update(
            {k: v for k, v in self.processes.environment.items() if k in ("ROS_AUTOMATIC_DISCOVERY_RANGE", "FASTRTPS_DEFAULT_PROFILES_FILE")}
        )
        self.monitor = Monitor(0, graph.wall_stamps, graph.rate, graph.score_from_s)
        self._watcher: Watcher | None = None
        self._began = math.inf

    def __enter__(self) -> LiveRun:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Stop every node, then leave the graph."""
        self.processes.stop()
        if self._watcher is not None:
            self._watcher.close()
            self._watcher = None

    def start(self, check: Callable[[], None] = lambda: None) -> None:
        """Start the listeners, wait until they listen, then start the sources and with them time.

        Parameters
        ----------
        check : called while waiting; may raise to give up

        Raises
        ------
        GraphError
            A node died or was not ready in time.
        """

        def alive() -> None:
            check()
            if dead := self.dead():
                raise GraphError(describe(dead))

        self._watcher = Watcher(self.graph.namespace, self.monitor)
        if taken := self._watcher.taken(self.graph.of("source", "consumer"), DISCOVERY_S):
            domain = os.environ.get("ROS_DOMAIN_ID", "0")
            raise GraphError(f"{taken[0]} in ROS domain {domain}: stop that graph, or set ROS_DOMAIN_ID to another number")
        began = time.monotonic()
        consumers, observers = self.graph.of("consumer"), self.graph.of("observer")
        self.processes.start(*consumers, *map(_held, observers))
        if missing := self._watcher.wait_for(consumers, READY_TIMEOUT_S, alive):
            raise GraphError(f"the graph was not ready after {READY_TIMEOUT_S:.0f} s: {missing[0]}")
        needed = time.monotonic() - began
        # the sources need about as long to start as the listeners did, and the recorder must have found them when time begins
        delay = min(max(8.0, 3.0 * needed), 25.0)
        if self.graph.wall_stamps:
            # on a whole second, so that stamps read well and outputs on a grid of time fall on samples
            self.graph = self.graph.starting_at(math.ceil(time.time() + delay) * 1_000_000_000)
            self.monitor.start_at_ns = self.graph.start_at_ns
        self.say(f"listeners ready after {needed:.1f} s; time starts " + (f"in {delay:.1f} s" if self.graph.wall_stamps else "with the player"))
        self._start_sources(alive)

    def _start_sources(self, alive: Callable[[], None]) -> None:
        """Start sources and the recorder; players stay silent until everyone, the recorder too, has subscribed to them."""
        sources, observers = self.graph.of("source"), self.graph.of("observer")
        players = () if self.graph.wall_stamps else sources
        self.processes.start(*(_held(s) if s in players else s for s in sources))
        for observer in observers:
            write_files(_held(observer), self.processes.directory)  # what it records first says when time starts
            self._transition(observer, "configure", alive)
            self._transition(observer, "activate", alive)
        for player in players:
            self._transition(player, "configure", alive)
        self._all_there(alive)
        if players:
            self._pause(MATCHING_S, alive)
        for player in players:
            self._transition(player, "activate", alive)
        self._began = time.monotonic()
        if self.graph.wall_stamps and time.time_ns() > self.graph.start_at_ns:
            self.say("the sensors started late: first samples may be missing (counted as lost)")

    def _pause(self, seconds: float, alive: Callable[[], None]) -> None:
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline:
            alive()
            time.sleep(0.05)

    def _transition(self, spec: NodeSpec, label: str, alive: Callable[[], None]) -> None:
        assert self._watcher is not None
        if not self._watcher.transition(spec, label, READY_TIMEOUT_S, alive):
            raise GraphError(f'node "{spec.name}" could not {label}; its last lines: {" / ".join(self.processes.tail(spec.name, 3))}')

    def _all_there(self, alive: Callable[[], None]) -> None:
        """Wait for the endpoints of the sources, and for the recorder's subscription to all that anyone publishes."""
        assert self._watcher is not None
        everything = tuple(t for n in self.graph.of("source", "consumer") for t in n.publishes)
        observers = (dataclasses.replace(n, subscribes=everything) for n in self.graph.of("observer"))
        if missing := self._watcher.wait_for([*self.graph.of("source"), *observers], READY_TIMEOUT_S, alive):
            raise GraphError(f"the graph was not ready after {READY_TIMEOUT_S:.0f} s: {missing[0]}")

    def dead(self) -> Exit | None:
        """The first node that ended and should not have."""
        for end in self.processes.exited():
            source = end.name in {s.name for s in self.graph.of("source")}
            if end.status != 0 or not source or not self.due():
                return end
        return None

    def due(self) -> bool:
        """True when the sources may be at their end."""
        if self.graph.wall_stamps:
            return time.time_ns() * 1e-9 > self.graph.start_at_ns * 1e-9 + self.graph.duration_s / self.graph.rate - 1.0
        return True  # a player ends with status 0 at the end of its bag

    def finished(self) -> bool:
        """True when the run's time is over and what was under way has arrived."""
        monitor = self.monitor
        if monitor.newest_ns == 0:
            quiet = time.monotonic() - self._began > _QUIET_S  # a short bag: what it gave may still be on its way
            return not self.graph.wall_stamps and quiet and self._sources_ended()
        reached = (monitor.newest_ns - monitor.start_at_ns) * 1e-9
        if not self.graph.wall_stamps and reached >= self.graph.duration_s:
            return True
        quiet = time.time_ns() - monitor.last_arrival_ns > _QUIET_S * 1e9
        return quiet and (self._sources_ended() or (self.graph.wall_stamps and self.due()))

    def stalled(self) -> bool:
        """True when the run should have ended long ago, or never began."""
        if not self.graph.wall_stamps:
            return False
        last = self.monitor.last_arrival_ns * 1e-9
        end = self.graph.start_at_ns * 1e-9 + self.graph.duration_s / self.graph.rate
        return time.time() > max(end, last) + _STALLED_S

    def _sources_ended(self) -> bool:
        return all(not self.processes.alive(s.name) for s in self.graph.of("source") if s.name in self.processes.names)


def _held(spec: NodeSpec) -> NodeSpec:
    """A lifecycle node that waits to be configured and activated by us."""
    return dataclasses.replace(spec, parameters={**spec.parameters, "autostart": False})


def describe(dead: Exit) -> str:
    """Which node died and its last lines, one paragraph."""
    return "\n    ".join([f"{dead}; its last lines:", *(dead.lines or ["(it printed nothing)"])])


def run_live(graph: Graph, *, console: Console, directory: Path | None = None, record: str = "", json_file: Path | None = None) -> dict[str, Any]:
    """Run a graph to its end, to Ctrl-C or to the death of a node.

    Parameters
    ----------
    graph : what to run
    console : where the table is drawn; plain lines where it is not a terminal
    directory : run directory; None: a new one where ROS keeps its logs
    record : bag directory, for the summary
    json_file : the summary is written there too

    Returns
    -------
    summary; `status` 0 when the run ended as it should, 1 when a node died or the graph did not start
    """
    directory = run_directory(graph.title) if directory is None else directory
    with Interrupt() as interrupt, LiveRun(graph, directory, lambda line: console.print(line, highlight=False)) as run:
        outcome = _run(run, console, interrupt.event)
        console.print("stopping the nodes", highlight=False)
        run.processes.stop()
        time.sleep(0.2)  # the last messages of the stopped nodes are still on their way to the monitor
        bad = [e for e in run.processes.exited() if e.status != 0]
        if outcome.status == 0 and outcome.started and bad:
            outcome = Outcome(1, f"{bad[0]} when it was stopped", bad[0])
        summary = {
            "title": graph.title,
            "status": outcome.status,
            "ended": outcome.ended,
            "bag": record or None,
            "logs": str(directory),
            **run.monitor.summary(),
        }
        summary["nodes"] = {e.name: e.status for e in run.processes.exited()}
    if outcome.dead is not None:
        console.print(describe(outcome.dead), style="bold red", markup=False, highlight=False, soft_wrap=True)
    console.print(summary_table(summary))
    if graph.wall_stamps and (warning := not_comparable(summary["samples"])):
        console.print(warning, style="bold red", markup=False, highlight=False, soft_wrap=True)
    if json_file is not None:
        json_file.parent.mkdir(parents=True, exist_ok=True)
        json_file.write_text(json.dumps(summary, indent=2) + "\n")
    return summary


class _Stopped(Exception):
    """The user asked to stop while the graph was starting."""


def _run(run: LiveRun, console: Console, stop: threading.Event) -> Outcome:
    def check() -> None:
        if stop.is_set():
            raise _Stopped

    try:
        run.start(check)
    except _Stopped:
        return Outcome(0, "stopped by the user while starting", started=False)
    except GraphError as error:
        dead = run.dead()
        return Outcome(1, str(dead) if dead else str(error), dead, started=False)
    with _display(run, console) as draw:
        while True:
            if stop.wait(0.1):
                return Outcome(0, "stopped by the user")
            draw()
            if dead := run.dead():
                return Outcome(1, str(dead), dead)
            if run.finished():
                return _completed(run)
            if run.stalled():
                return Outcome(1, "no navigation state for a minute")


def _completed(run: LiveRun) -> Outcome:
    """A simulated run is complete if it navigated to its end."""
    newest_ns = run.monitor.newest_ns
    if not newest_ns:
        return Outcome(1, "the navigator published nothing")
    missing_s = run.graph.duration_s - (newest_ns - run.monitor.start_at_ns) * 1e-9
    if run.graph.wall_stamps and missing_s > _SILENT_S * run.graph.rate:
        return Outcome(1, f"navigation ended {missing_s:.0f} s before the run did")
    return Outcome(0, "completed")


class _display:
    """Draws the table four times a second, or a plain line every five seconds and each change of health at once."""

    def __init__(self, run: LiveRun, console: Console) -> None:
        self._run, self._console = run, console
        self._live = Live(console=console, auto_refresh=False) if console.is_terminal else None
        self._next = -math.inf
        self._told = 0

    def __enter__(self) -> Callable[[], None]:
        if self._live is not None:
            self._live.start()
        return self._draw

    def __exit__(self, *_: object) -> None:
        if self._live is not None:
            self._live.stop()

    def _draw(self) -> None:
        now = time.monotonic()
        monitor = self._run.monitor
        if self._live is None:
            snapshot = monitor.snapshot(time.time_ns())
            news = monitor.changes_since(self._told)
            self._told += len(news)
            for change in news:
                self._console.print(change_line(change, snapshot), markup=False, highlight=False)
        if now < self._next:
            return
        if self._live is not None:
            self._next = now + 0.25
            self._live.update(live_table(self._run.graph.title, monitor.snapshot(time.time_ns()), self._run.graph.duration_s), refresh=True)
        else:
            self._next = now + _PLAIN_PERIOD_S
            self._console.print(plain_line(snapshot), markup=False, highlight=False, soft_wrap=True)
