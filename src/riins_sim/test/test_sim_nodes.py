"""The nodes as processes: what they publish is, to the bit, what the sensors of the scenario read."""

import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

rclpy = pytest.importorskip("rclpy")
msgs = pytest.importorskip("riins_msgs.msg")

from domain_coordinator import domain_id  # noqa: E402
from geometry_msgs.msg import TwistWithCovarianceStamped  # noqa: E402
from nav_msgs.msg import Odometry  # noqa: E402
from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from sensor_msgs.msg import NavSatFix  # noqa: E402

from riins_msgs.srv import ClearFaults, InjectFault  # noqa: E402
from riins_node import qos  # noqa: E402
from riins_node.convert import read_doppler, read_initial_state, read_nav_state, read_position_aid, read_redundant_imu, to_ns, to_stamp  # noqa: E402
from riins_sim.initial import initial_state  # noqa: E402
from riins_sim.sensors import DopplerSim, PositionSim, RedundantImuSim  # noqa: E402

S = 1_000_000_000
RATE = 4.0
PERIOD = 12  # of the outages, s; two seconds each
FAULTS = [
    {"target": "gyro_2", "type": "ramp", "slope_deg_h_s": 2.0, "start_s": 1.0},
    {"target": "gps", "type": "step", "size_m": 60.0, "start_s": 5.0},
]
TOPICS = {
    "rimu/raw": (msgs.RedundantImu, qos.imu(4000)),
    "gps/fix": (NavSatFix, qos.aid()),
    "gps/velocity": (TwistWithCovarianceStamped, qos.aid()),
    "doppler/velocity": (TwistWithCovarianceStamped, qos.aid()),
    "truth/state": (msgs.NavState, qos.navigation()),
    "truth/odometry": (Odometry, qos.navigation()),
    "nav/initial_state": (msgs.InitialState, qos.latched()),
    "truth/faults": (msgs.FaultArray, qos.latched(10)),
}


class Graph:
    """Processes of simulated sensors on a domain of their own, and a listener that keeps every message."""

    def __init__(self, scenario, directory, domain: int) -> None:
        self.scenario = scenario
        self._path = directory / "scenario.yaml"
        self._path.write_text(scenario.to_yaml())
        self._environment = {**os.environ, "ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
        os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
        self._context = rclpy.Context()
        rclpy.init(context=self._context, domain_id=domain)
        self.node = rclpy.create_node("listener", context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self.got: dict[str, list] = {topic: [] for topic in TOPICS}
        for topic, (kind, profile) in TOPICS.items():
            self.node.create_subscription(kind, topic, self.got[topic].append, profile)
        self.start_at_ns = time.time_ns() + 5 * S
        self._processes: list[subprocess.Popen] = []

    def start(self, name: str, *parameters: str) -> subprocess.Popen:
        words = [f"scenario:={self._path}", f"start_at_ns:={self.start_at_ns}", f"rate:={RATE}", *parameters]
        arguments = [word for parameter in words for word in ("-p", parameter)]
        command = [sys.executable, "-m", f"riins_sim.nodes.{name}", "--ros-args", *arguments]
        process = subprocess.Popen(command, env=self._environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        self._processes.append(process)
        return process

    def until(self, condition, seconds: float = 30.0) -> None:
        end = time.monotonic() + seconds
        while not condition():
            assert time.monotonic() < end, {topic: len(messages) for topic, messages in self.got.items()}
            self._executor.spin_once(timeout_sec=0.05)

    def drain(self, topic: str) -> None:
        """Forget the messages of a topic whose publisher is gone, those under way too."""
        while self.got[topic]:
            self.got[topic].clear()
            for _ in range(5):
                self._executor.spin_once(timeout_sec=0.05)

    def call(self, kind, service: str, request):
        client = self.node.create_client(kind, service)
        self.until(client.service_is_ready)
        future = client.call_async(request)
        self.until(future.done)
        return future.result()

    def close(self) -> None:
        for process in self._processes:
            process.kill()
            process.communicate()
        self.node.destroy_node()
        rclpy.shutdown(context=self._context)


@pytest.fixture(scope="module")
def graph(tmp_path_factory):
    import yaml
    from sim_voyage import BASE

    from riins_sim.scenario import from_yaml

    outages = [{"target": name, "start_s": t, "end_s": t + 2.0} for name in ("gps", "doppler") for t in np.arange(2.0, 400.0, PERIOD).tolist()]
    scenario = from_yaml(yaml.safe_dump({**BASE, "duration_s": 400.0, "faults": FAULTS, "outages": outages}))
    with domain_id() as domain:
        made = Graph(scenario, tmp_path_factory.mktemp("nodes"), int(domain))
        try:
            made.rimu = made.start("rimu")
            for name in ("gps", "doppler", "truth"):
                made.start(name)
            # a whole period of outages, wherever it begins: on a busy machine the nodes may be late
            made.until(lambda: all(made.got.values()) and len(made.got["gps/fix"]) >= PERIOD and len(made.got["doppler/velocity"]) >= PERIOD, 60.0)
            yield made
        finally:
            made.close()


def _check_imu(graph, received):
    imu = RedundantImuSim(graph.scenario)
    k = np.array([m.sequence for m in received])
    assert np.all(np.diff(k) == 1)
    block = imu.block(int(k[0]), len(k), graph.scenario.fault_schedule())
    for i, message in enumerate(received):
        sample = read_redundant_imu(message)
        assert sample["stamp_ns"] == graph.start_at_ns + k[i] * 10_000_000
        assert np.array_equal(sample["gyro"], block.gyro[i]) and np.array_equal(sample["accel"], block.accel[i])
        assert sample["gyro_valid"] == sample["accel_valid"] == 63
    return k


def test_imu_is_the_scenarios_and_a_restarted_node_goes_on_with_the_same_noise(graph):
    graph.until(lambda: len(graph.got["rimu/raw"]) > 600)
    first = _check_imu(graph, graph.got["rimu/raw"])
    assert graph.got["rimu/raw"][0].header.frame_id == "imu_link"
    graph.rimu.send_signal(signal.SIGINT)
    assert graph.rimu.wait(10) == 0
    graph.until(lambda: graph.node.count_publishers("rimu/raw") == 0)
    graph.drain("rimu/raw")
    graph.rimu = graph.start("rimu")
    graph.until(lambda: len(graph.got["rimu/raw"]) > 100)
    again = _check_imu(graph, graph.got["rimu/raw"])
    assert again[0] > first[-1]


def test_gps_is_the_scenarios_and_an_outage_is_no_fix(graph):
    fixes = graph.got["gps/fix"]
    first = round((to_ns(fixes[0].header.stamp) - graph.start_at_ns) / S)
    block = PositionSim(graph.scenario, "gps").block(first, len(fixes), graph.scenario.fault_schedule())
    assert not np.all(block.has_fix)
    for i, message in enumerate(fixes):
        reading = read_position_aid(message)
        assert message.header.frame_id == "gps_link" and message.status.service == 1
        assert reading["stamp_ns"] == graph.start_at_ns + (first + i) * S
        assert reading["ok"] == block.has_fix[i] == ((first + i) % PERIOD not in (2, 3))
        if reading["ok"]:
            # degrees in the message: one rounding of 1e-16 relative each way
            assert reading["z"] == pytest.approx([block.lat[i], block.lon[i], block.h[i]], rel=1e-15)
            assert np.diag(reading["R"]) == pytest.approx([5.0, 10.0, 16.0])
        else:
            assert np.all(np.isnan(reading["z"]))
    moving = [(to_ns(m.header.stamp) - graph.start_at_ns) // S % PERIOD for m in graph.got["gps/velocity"]]
    assert moving and not {2, 3} & set(moving)


def test_log_is_the_scenarios_and_an_outage_is_silence(graph):
    log = DopplerSim(graph.scenario)
    readings = [read_doppler(m) for m in graph.got["doppler/velocity"]]
    numbers = [round((r["stamp_ns"] - graph.start_at_ns) / S) for r in readings]
    assert [n for n in range(numbers[0], numbers[-1] + 1) if n % PERIOD not in (2, 3)] == numbers
    for number, reading in zip(numbers, readings, strict=True):
        block = log.block(number, 1)
        assert np.array_equal(reading["z"], block.v_b[0]) and reading["R"] == pytest.approx(block.covariance)
    assert graph.got["doppler/velocity"][0].header.frame_id == "doppler_link"


def test_truth_and_the_initial_state(graph):
    imu = RedundantImuSim(graph.scenario)
    drawn = initial_state(graph.scenario, imu.trajectory)
    state = read_initial_state(graph.got["nav/initial_state"][0])
    assert state["stamp_ns"] == graph.start_at_ns and state["source"] == "scenario"
    assert state["lat"] == pytest.approx(drawn.lat, rel=1e-15) and np.array_equal(state["rph"], drawn.rph)
    assert np.array_equal(state["covariance"], drawn.covariance)
    states = [read_nav_state(m) for m in graph.got["truth/state"]]
    assert np.all(np.diff([s["stamp_ns"] for s in states]) == S // 10)
    some = states[5]
    truth = imu.trajectory.truth((some["stamp_ns"] - graph.start_at_ns) * 1e-9)
    assert np.array_equal(some["v_n"], truth.v_n[0]) and some["lat"] == pytest.approx(truth.lat[0], rel=1e-15)
    assert np.array_equal(some["bias_g"], imu.fused_bias(round((some["stamp_ns"] - graph.start_at_ns) * 1e-7))[0])
    odometry = graph.got["truth/odometry"][0]
    assert odometry.header.frame_id == "map" and odometry.child_frame_id == "base_link"
    speed = odometry.twist.twist.linear.x
    assert speed == pytest.approx(7.7, abs=1.0)


def test_faults_are_latched_injected_and_cleared(graph):
    def of(frame):
        return [m for m in graph.got["truth/faults"] if m.header.frame_id == frame]

    ramp = of("imu_link")[0].faults[0]
    assert (ramp.target, ramp.type) == ("gyro_2", msgs.Fault.RAMP)
    assert to_ns(ramp.start) == graph.start_at_ns + S and to_ns(ramp.end) == 0
    assert ramp.slope == pytest.approx(np.deg2rad(2.0 / 3600.0))
    seen = len(of("doppler_link"))
    fault = msgs.Fault(target="doppler", type=msgs.Fault.STEP, size=3.0, axis="starboard")
    answer = graph.call(InjectFault, "doppler/inject_fault", InjectFault.Request(fault=fault))
    assert answer.success and "step on doppler" in answer.message
    graph.until(lambda: len(of("doppler_link")) > seen)
    injected = of("doppler_link")[-1].faults[0]
    onset = to_ns(injected.start) - graph.start_at_ns
    graph.until(lambda: to_ns(graph.got["doppler/velocity"][-1].header.stamp) - graph.start_at_ns >= onset)
    last = read_doppler(graph.got["doppler/velocity"][-1])
    clean = DopplerSim(graph.scenario).block(round((last["stamp_ns"] - graph.start_at_ns) / S), 1).v_b[0]
    assert last["z"] - clean == pytest.approx([0.0, 3.0, 0.0], abs=1e-12)
    answer = graph.call(ClearFaults, "doppler/clear_faults", ClearFaults.Request())
    assert answer.success and answer.cleared == 1
    graph.until(lambda: not of("doppler_link")[-1].faults)

    late = to_stamp(graph.start_at_ns + S)
    for bad, words in (
        (msgs.Fault(target="gps", type=0, size=1.0), "no gps"),
        (msgs.Fault(target="doppler", type=9, size=1.0), "9"),
        (msgs.Fault(target="doppler", type=0, size=1.0, axis="north"), "axis"),
        (msgs.Fault(target="doppler", type=0, size=1.0, end=late), "end after"),
        (msgs.Fault(target="doppler", type=1, slope=1.0, start=to_stamp(graph.start_at_ns - S)), "-1.000 s after the start of the run"),
        (msgs.Fault(target="doppler", type=0, size=1.0, start=to_stamp(graph.start_at_ns + 10**8 * S)), "which lasts 400 s"),
    ):
        answer = graph.call(InjectFault, "doppler/inject_fault", InjectFault.Request(fault=bad))
        assert not answer.success and words in answer.message
    answer = graph.call(ClearFaults, "doppler/clear_faults", ClearFaults.Request(target="gps"))
    assert not answer.success and answer.message == "this node has no gps"


@pytest.mark.parametrize(
    ("text", "words"),
    [("scenario:=harbur", 'did you mean "harbour"'), ("scenari:=harbour", 'did you mean "scenario"'), ("rate:=-1.0", "rate")],
)
def test_bad_use_ends_with_status_2_and_one_line(text, words):
    command = [sys.executable, "-m", "riins_sim.nodes.bds", "--ros-args", "-p", text]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 2
    assert words in done.stderr and len(done.stderr.strip().splitlines()) == 1
