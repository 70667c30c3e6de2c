"""The node graph as data: which nodes, with which parameters, for a simulated ship and for the replay of a bag.

Lives here: `GraphSettings`, `NodeSpec`, `Graph`, `build_graph`, `write_files`; launch file, launcher and tests read this.
Does not live here: starting processes (processes.py), watching them (live.py), what the parameters of a filter should be (riins_eval.configure).
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from riins_core.settings import SettingError, as_mapping, build, field_types, flatten, setting

CONFIGURATION = "configuration_file"
"""Parameter of the recorder whose file is written first."""
IMU_TOPIC = "/rimu/raw"
_TRUTH = {"true": True, "false": False}
_NAMESPACE = re.compile(r"/?(?:[A-Za-z_][A-Za-z0-9_]*(?:/[A-Za-z_][A-Za-z0-9_]*)*/?)?")


@dataclass(frozen=True)
class GraphSettings:
    """What a user chooses about a run; the arguments of `ship.launch.py` and of `riins up`."""

    scenario: str = setting("harbour", "scenario to simulate: the name of a shipped one or a YAML file")
    bag: str = setting("", "bag directory whose raw topics are replayed instead of simulating a scenario; empty: simulate")
    rate: float = setting(1.0, "speed of the run in times real time", low=0.01, high=100.0)
    record: str = setting("", "bag directory to record every topic to (must not exist); empty: no recording")
    namespace: str = setting("", "namespace of all nodes and topics, for several ships in one domain; empty: none")
    log_level: str = setting("info", "least severe message the nodes print", choices=("debug", "info", "warn", "error", "fatal"))
    seed: int = setting(-1, "seed of all noise; -1: the scenario's own", low=-1, high=2**31 - 1)
    duration_s: float = setting(0.0, "stop after this much measurement time; 0: the whole scenario or bag", "s", low=0.0)
    motion: bool = setting(False, "heave and attitude at the IMU rate on nav/motion; nmea has it in any case")
    nmea: str = setting("", "send NMEA 0183 there, several separated by commas: udp://HOST:PORT, serial:///dev/NAME?baud=N; empty: nowhere")
    start_delay_s: float = setting(10.0, "wall time from launching to the first sample, for processes to start and to find each other", "s", low=0.0)

    def __post_init__(self) -> None:
        if not _NAMESPACE.fullmatch(self.namespace):
            raise SettingError(
                f'"namespace" must be words of letters, digits and _ with / between them, none beginning with a digit, not {self.namespace!r}',
                ("namespace",),
            )


@dataclass(frozen=True)
class NodeSpec:
    """One node: what `ros2 run PACKAGE EXECUTABLE` starts, with its parameters.

    Attributes
    ----------
    package, executable, name : as `ros2 run` and `--ros-args -r __node:=` take them
    role : consumer (must be ready before time starts), source (starts time), observer (recorder: must see all, stops last)
    parameters : ROS parameters by dotted name
    files : text by parameter name: the text is written to a file and the parameter is its path
    subscribes, publishes : topics relative to the namespace, what the readiness check waits for
    remappings : (from, to) topic names
    """

    package: str
    executable: str
    name: str
    role: str = "consumer"
    parameters: Mapping[str, Any] = field(default_factory=dict)
    files: Mapping[str, str] = field(default_factory=dict)
    subscribes: tuple[str, ...] = ()
    publishes: tuple[str, ...] = ()
    remappings: tuple[tuple[str, str], ...] = ()
    namespace: str = ""
    log_level: str = "info"

    @property
    def full_namespace(self) -> str:
        """Namespace as rclpy reports it: '/' or '/name'."""
        return "/" + self.namespace.strip("/")

    def topic(self, name: str) -> str:
        """Absolute name of a topic of this node."""
        return self.full_namespace.rstrip("/") + "/" + name

    def arguments(self, parameter_file: str | Path | None = None) -> list[str]:
        """Command-line arguments behind the executable."""
        words = ["--ros-args", "-r", f"__node:={self.name}"]
        if self.namespace.strip("/"):
            words += ["-r", f"__ns:={self.full_namespace}"]
        for source, target in self.remappings:
            words += ["-r", f"{source}:={target}"]
        words += ["--log-level", self.log_level]
        if parameter_file is not None:
            words += ["--params-file", str(parameter_file)]
        return words


@dataclass(frozen=True)
class Graph:
    """A set of nodes that make one run.

    Attributes
    ----------
    nodes : in starting order: consumers, observers, sources
    title : scenario name or bag path
    duration_s : measurement time of the run [s]
    rate : times real time
    start_at_ns : measurement time of sample 0 [ns]; 0 for a replay, whose stamps are the bag's
    wall_stamps : stamps are wall-clock times, so that a latency can be measured against the clock
    namespace : of all nodes
    configuration_at : text of `/riins/configuration` for a given start [ns]
    score_from_s : errors count from this long after the start [s]
    """

    nodes: tuple[NodeSpec, ...]
    title: str
    duration_s: float
    rate: float = 1.0
    start_at_ns: int = 0
    wall_stamps: bool = False
    namespace: str = ""
    configuration_at: Callable[[int], str] = str
    score_from_s: float = 0.0

    def of(self, *roles: str) -> tuple[NodeSpec, ...]:
        """Nodes of the given roles, in order."""
        return tuple(n for n in self.nodes if n.role in roles)

    def node(self, name: str) -> NodeSpec:
        """The node of that name; KeyError if there is none."""
        for spec in self.nodes:
            if spec.name == name:
                return spec
        raise KeyError(name)

    def without(self, *names: str) -> Graph:
        """The same graph with some nodes left out (a real sensor takes the place of a simulated one)."""
        return dataclasses.replace(self, nodes=tuple(n for n in self.nodes if n.name not in names))

    def starting_at(self, start_at_ns: int) -> Graph:
        """The same graph with another start: sources that simulate are told, and so is what the recorder writes first."""

        def moved(node: NodeSpec) -> NodeSpec:
            parameters, files = dict(node.parameters), dict(node.files)
            if "start_at_ns" in parameters:
                parameters["start_at_ns"] = start_at_ns
            if CONFIGURATION in files:
                files[CONFIGURATION] = self.configuration_at(start_at_ns)
            return dataclasses.replace(node, parameters=parameters, files=files)

        return dataclasses.replace(self, nodes=tuple(moved(n) for n in self.nodes), start_at_ns=start_at_ns)


def settings_from_words(words: Mapping[str, str]) -> GraphSettings:
    """Make `GraphSettings` of text values, as launch arguments are.

    Raises
    ------
    SettingError
        Unknown name, or a value that is not of the setting's type or range.
    """
    kinds = field_types(GraphSettings)
    values: dict[str, Any] = {}
    for name, word in words.items():
        kind = kinds.get(name, str)
        try:
            values[name] = word if kind is str else _TRUTH[word.lower()] if kind is bool else kind(word)
        except KeyError:
            raise SettingError(f'"{name}" must be true or false, not {word!r}', (name,)) from None
        except ValueError:
            raise SettingError(f'"{name}" must be a number, not {word!r}', (name,)) from None
    return build(GraphSettings, values)


def build_graph(settings: GraphSettings, start_at_ns: int = 0) -> Graph:
    """Graph of a simulated ship, or of the replay of a bag when `settings.bag` is given.

    Parameters
    ----------
    settings : the user's choice
    start_at_ns : measurement time of sample 0 for every simulated sensor [ns]; 0: each sensor takes its own now

    Raises
    ------
    ScenarioError, BagError, SettingError
        The scenario, the bag or a setting is wrong.
    """
    return replay_graph(settings) if settings.bag else ship_graph(settings, start_at_ns)


def ship_graph(settings: GraphSettings, start_at_ns: int = 0) -> Graph:
    """Graph of a simulated vehicle: the sensors of its scenario, fusion, navigator and, if asked, bridge nodes and the recorder."""
    from riins_eval import configure
    from riins_sim import scenario as scenarios

    scenario = scenarios.load(settings.scenario)
    changes: dict[str, Any] = {}
    if settings.seed >= 0:
        changes["seed"] = settings.seed
    if 0.0 < settings.duration_s < scenario.duration_s:
        changes |= {"duration_s": settings.duration_s, "expect": {}}  # what it expects is of the whole voyage
    scenario = dataclasses.replace(scenario, **changes)
    fusion, navigator = configure.simulated_fusion_config(scenario), configure.navigator_config(scenario)

    def configuration_at(start: int) -> str:
        return configure.configuration_text(scenario, start, fusion, navigator)

    start = scenario.start  # the origin of the truth too, so that the two odometries can be compared
    datum = {"datum": [start.latitude_deg, start.longitude_deg, start.height_m]}
    nodes = _consumers(settings, fusion, navigator, configuration_at(start_at_ns), datum)
    # every sensor reads the very text that is recorded, so nobody can edit the scenario between two starts
    common = {"start_at_ns": start_at_ns, "rate": settings.rate, "seed": -1}
    text = scenario.to_yaml()
    for name, publishes in _sources(scenario).items():
        nodes.append(_spec(settings, "riins_sim", name, "source", common, files={"scenario": text}, publishes=publishes))
    return Graph(
        tuple(nodes),
        scenario.name,
        scenario.duration_s,
        settings.rate,
        start_at_ns,
        True,
        settings.namespace,
        configuration_at,
        scenario.scoring.from_s,
    )


def replay_graph(settings: GraphSettings) -> Graph:
    """Graph that replays the raw topics of a bag through the fusion and the navigator it was recorded for.

    Raises
    ------
    BagError, RecordError
        The bag cannot be read or does not say with which settings it is to be navigated.
    """
    from riins_bag.bag import BagError, BagReader
    from riins_bag.recording import RAW_TOPICS, selected
    from riins_eval.run_configuration import read_configuration
    from riins_federated.aid_inputs import inputs

    with BagReader(settings.bag, None) as bag:
        recorded, topics = read_configuration(bag), set(bag.topics)
        if IMU_TOPIC not in topics:
            raise BagError(f"{settings.bag} has no {IMU_TOPIC}: there is nothing to navigate from")
        first_ns, last_ns = bag.span_ns(IMU_TOPIC)
        namespace = bag.namespace
    # a replay neither reads nor keeps a heading of this machine: what was read then is a command of the recording
    alignment = dataclasses.replace(recorded.navigator.alignment, heading_file="")
    nodes = _consumers(settings, recorded.fusion, dataclasses.replace(recorded.navigator, alignment=alignment), recorded.text)
    aids = [f"/{source.topic.strip('/')}" for source in inputs(recorded.navigator.aid)]
    raw = sorted(t for t in topics if selected(t, (*RAW_TOPICS, *aids)))
    # the recorder, too, must hear the first sample
    listeners = {t: sum(t.strip("/") in n.subscribes or n.role == "observer" for n in nodes) for t in raw}
    listeners = {t: number for t, number in listeners.items() if number}
    parameters = {
        "path": str(Path(settings.bag).absolute()),
        "namespace": namespace,
        "rate": settings.rate,
        "wait_for": list(listeners),
        "subscribers": list(listeners.values()),
    }
    moved = tuple((t, f"/{settings.namespace.strip('/')}{t}") for t in raw) if settings.namespace.strip("/") else ()
    publishes = tuple(t.strip("/") for t in raw)
    nodes.append(_spec(settings, "riins_bag", "player", "source", parameters, publishes=publishes, remappings=moved))
    recorded_s = (last_ns - first_ns) * 1e-9
    duration = min(settings.duration_s, recorded_s) if settings.duration_s > 0.0 else recorded_s
    score_from_s = recorded.scenario.scoring.from_s if recorded.scenario else 0.0
    title, text = Path(settings.bag).name, recorded.text
    return Graph(tuple(nodes), title, duration, settings.rate, 0, False, settings.namespace, lambda _: text, score_from_s)


def _sources(scenario: Any) -> dict[str, tuple[str, ...]]:
    """Simulated sensors of a scenario and what they publish at every sample; a disabled aid has no node."""
    from riins_sim import suite

    sources: dict[str, tuple[str, ...]] = {"rimu": ("rimu/raw",)}
    for name in suite.enabled(scenario):
        sources[name] = suite.TOPICS[name][:1]
    sources["truth"] = ("truth/state", "truth/odometry", *(("nav/initial_state",) if scenario.initial.given else ()))
    return sources


def _consumers(settings: GraphSettings, fusion: Any, navigator: Any, configuration: str, datum: Mapping[str, Any] | None = None) -> list[NodeSpec]:
    from riins_federated.aid_inputs import inputs

    aids = tuple(dict.fromkeys(source.topic.strip("/") for source in inputs(navigator.aid)))
    nodes = [
        _spec(
            settings,
            "riins_imu_fusion",
            "imu_fusion",
            "consumer",
            flatten(as_mapping(fusion)),
            subscribes=("rimu/raw", "nav/commands"),
            publishes=("imu/data_raw", "imu/fused", "fdi/status", "fdi/method"),
        ),
        _spec(
            settings,
            "riins_federated",
            "navigator",
            "consumer",
            {**flatten(as_mapping(navigator)), **(datum or {})},
            subscribes=("imu/fused", "nav/initial_state", "nav/commands", "nav/align", *aids),
            publishes=("nav/state", "nav/settled", "nav/inertial", "nav/odometry", "nav/fix", "imu/data", "nav/subfilters", "nav/alignment"),
        ),
    ]
    nodes += _bridge(settings)
    if settings.record:
        parameters = {"path": str(Path(settings.record).absolute())}
        files = {CONFIGURATION: configuration}
        nodes.append(_spec(settings, "riins_bag", "recorder", "observer", parameters, files=files))
    return nodes


def _bridge(settings: GraphSettings) -> list[NodeSpec]:
    """The nodes motion and nmea, where they are asked for; what is simulated or played must not look like this ship, here and now."""
    from riins_nmea.links import LinkError, parse_link, resolve

    nodes = []
    outputs = [word.strip() for word in settings.nmea.split(",") if word.strip()]
    if settings.nmea and not outputs:
        raise SettingError(f'"nmea": {settings.nmea!r} names no address', ("nmea",))
    if settings.motion or outputs:
        nodes.append(_spec(settings, "riins_nmea", "motion", "consumer", {}, subscribes=("nav/state",), publishes=("nav/motion",)))
    if outputs:
        try:  # a wrong address, or a host that is not known, is told before anything starts
            for link in [parse_link(text, output=True) for text in outputs]:
                if not link.device:
                    resolve(link)
        except (SettingError, LinkError) as error:
            raise SettingError(f'"nmea": {error}', ("nmea",)) from None
        listens = ("nav/state", "nav/motion", "nav/subfilters")
        nodes.append(_spec(settings, "riins_nmea", "nmea", "consumer", {"outputs": outputs, "simulator": True}, subscribes=listens))
    return nodes


def _spec(settings: GraphSettings, package: str, executable: str, role: str, parameters: Mapping[str, Any], **more: Any) -> NodeSpec:
    return NodeSpec(
        package, executable, executable, role, dict(parameters), namespace=settings.namespace.strip("/"), log_level=settings.log_level, **more
    )


def write_files(spec: NodeSpec, directory: str | Path) -> Path:
    """Write the parameter file of a node, and the files its parameters name, into a directory.

    Parameters
    ----------
    spec : the node
    directory : an existing directory of the run

    Returns
    -------
    path of the parameter file, as `--params-file` takes it
    """
    directory = Path(directory)
    parameters = dict(spec.parameters)
    for parameter, text in spec.files.items():
        path = directory / f"{spec.name}.{parameter}.yaml"
        path.write_text(text)
        parameters[parameter] = str(path)
    path = directory / f"{spec.name}.params.yaml"
    content = {"/**": {"ros__parameters": {name: _value(value) for name, value in parameters.items() if not _empty(value)}}}
    path.write_text(yaml.safe_dump(content, sort_keys=False, allow_unicode=True))
    return path


def _empty(value: Any) -> bool:
    """True for what a ROS parameter file cannot say (nothing, an empty list); the node's default is the same."""
    return value is None or (isinstance(value, list | tuple) and len(value) == 0)


def _value(value: Any) -> Any:
    """The value as YAML; a list with one float in it becomes all floats, since the ROS parser refuses mixed lists."""
    if isinstance(value, list | tuple):
        values = [_value(v) for v in value]
        return [float(v) for v in values] if any(isinstance(v, float) for v in values) else values
    if hasattr(value, "item"):
        return value.item()
    return value
