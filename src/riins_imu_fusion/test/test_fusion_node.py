"""The node imu_fusion over DDS in one process: what another stack sees, and what it does with bad input."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs ROS 2")
pytest.importorskip("riins_msgs.msg", reason="needs riins_msgs built by colcon and its environment")

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.srv import SetParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from sensor_msgs.msg import Imu

from riins_core.frames import frd_to_flu
from riins_core.sensor_errors import normal
from riins_imu_fusion.node import ImuFusionNode, main
from riins_imu_fusion.pipeline import FusionPipeline
from riins_imu_fusion.selection import Selection
from riins_msgs.msg import FusedImu, FusionMethod, InertialFdi, RedundantImu, SensorUse, TriadFdi
from riins_msgs.srv import SetFusionMethod, SetSensorUse
from riins_node import convert, fields, qos

os.environ["ROS_DOMAIN_ID"] = str(100 + os.getpid() % 80)
os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")

DT, START = 10_000_000, 1_700_000_000_000_000_000
RATE, FORCE = np.array([0.01, -0.02, 0.03]), np.array([0.1, 0.2, -9.8])


class Bench:
    """The node, and beside it another one that feeds it and listens."""

    def __init__(self, node: ImuFusionNode) -> None:
        self.node = node
        self.other = rclpy.create_node("bench")
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(node)
        self.executor.add_node(self.other)
        self.got: dict[str, list[Any]] = {"fused": [], "raw": [], "status": [], "diagnostics": []}
        kinds = {
            "fused": (FusedImu, "imu/fused", qos.imu()),
            "raw": (Imu, "imu/data_raw", qos.imu()),
            "status": (InertialFdi, "fdi/status", qos.latched(100)),
            "diagnostics": (DiagnosticArray, "/diagnostics", qos.navigation()),
        }
        for name, (kind, topic, profile) in kinds.items():
            self.other.create_subscription(kind, topic, self.got[name].append, profile)
        self.out = self.other.create_publisher(RedundantImu, "rimu/raw", qos.imu())
        self.use = self.other.create_client(SetSensorUse, "imu_fusion/set_sensor_use")
        self.array, self.sigma = node._config.array(), node._config.sigma()
        self.until(lambda: self.out.get_subscription_count() == 1 and self.use.service_is_ready())
        self.until(lambda: all(self.other.count_publishers(topic) for _, topic, _ in kinds.values()))

    def until(self, condition: Callable[[], bool], seconds: float = 10.0) -> None:
        """Spin until the condition holds; never a sleep of a guessed length."""
        end = time.monotonic() + seconds
        while not condition():
            assert time.monotonic() < end, "timed out"
            self.executor.spin_once(timeout_sec=0.02)

    def sample(self, k: int, spoil: Callable[[dict[str, Any]], None] | None = None) -> None:
        values = {
            "stamp_ns": START + k * DT,
            "sequence": k,
            "gyro": self.array.H @ RATE + self.sigma[0] * normal(3, 0, k, 1, 6)[0],
            "accel": self.array.H @ FORCE + self.sigma[1] * normal(3, 1, k, 1, 6)[0],
            "gyro_valid": 63,
            "accel_valid": 63,
        }
        if spoil:
            spoil(values)
        self.out.publish(convert.fill(RedundantImu, fields.redundant_imu(**values)))

    def feed(self, start: int, stop: int, spoil: Callable[[dict[str, Any]], None] | None = None) -> None:
        """Samples start .. stop - 1, and wait until the node has received them."""
        received = self.node._pipeline.counters.received + stop - start
        for k in range(start, stop):
            self.sample(k, spoil)
        self.until(lambda: self.node._pipeline.counters.received == received)
        fused = self.node._pipeline.counters.fused
        self.until(lambda: len(self.got["fused"]) == len(self.got["raw"]) == fused)

    def last_text(self) -> str:
        return next((m.text for m in reversed(self.got["status"]) if m.text), "")


@pytest.fixture
def bench(request: pytest.FixtureRequest) -> Iterator[Bench]:
    arguments = ["-p", "health.hold_s:=1", "-p", "health.probation_s:=1.0", "-p", "imu_timeout_s:=0.3", *getattr(request, "param", [])]
    rclpy.init(args=["--ros-args", *arguments])
    node = ImuFusionNode()
    node.start()
    made = Bench(node)
    yield made
    made.executor.shutdown()
    made.other.destroy_node()
    node.destroy_node()
    rclpy.try_shutdown()


@pytest.mark.parametrize("bench", [["-p", "method:=wls"]], indirect=True)  # glr_kf would take it out of the samples
def test_what_a_failed_sensor_put_in_is_announced_once(bench: Bench) -> None:
    """Beside the sample that is free of it, not in it: the rate stays smooth."""
    def ramp(values: dict[str, Any]) -> None:
        values["gyro"][2] += 6.0 * bench.sigma[0, 2] * max(0.0, values["sequence"] / 100.0 - 3.0)

    for start in range(0, 700, 100):
        bench.feed(start, start + 100, ramp)
    announced = [m for m in bench.got["fused"] if convert.to_ns(m.recall_onset)]
    recall = bench.got["fused"][0] if not announced else announced[0]
    column = frd_to_flu(bench.array.least_squares()[:, 2])
    angle = np.array([recall.angle_recall.x, recall.angle_recall.y, recall.angle_recall.z])
    age = (convert.to_ns(recall.header.stamp) - START) * 1e-9 - 3.0
    assert len(announced) == 1 and not recall.gyro_used & 0b100
    assert abs(convert.to_ns(recall.recall_onset) - START - 3_000_000_000) < 500_000_000
    np.testing.assert_allclose(angle, column * 3.0 * bench.sigma[0, 2] * age**2, rtol=0, atol=0.25 * 3.0 * bench.sigma[0, 2] * age**2)
    bench.until(lambda: any("recalled" in m.text for m in bench.got["status"]))
    rates = np.array([m.angular_velocity.x for m in bench.got["raw"]])
    assert np.abs(np.diff(rates)).max() < 10.0 * bench.sigma[0, 0]


def test_what_another_stack_sees(bench: Bench) -> None:
    bench.feed(0, 101)
    raw, fused, status = bench.got["raw"], bench.got["fused"], bench.got["status"]
    assert [m.sequence for m in fused] == list(range(101)) and [convert.to_ns(m.header.stamp) for m in raw] == [START + k * DT for k in range(101)]
    message = raw[-1]
    assert message.header.frame_id == fused[-1].header.frame_id == "imu_link" and message.orientation_covariance[0] == -1.0
    sigma = bench.sigma[0, 0] / np.sqrt(2.0)
    got = np.array([message.angular_velocity.x, message.angular_velocity.y, message.angular_velocity.z])
    np.testing.assert_allclose(got, frd_to_flu(RATE), rtol=0, atol=6 * sigma)
    np.testing.assert_allclose(np.reshape(message.angular_velocity_covariance, (3, 3)), np.eye(3) * sigma**2, rtol=1e-9, atol=1e-20)
    assert message.linear_acceleration.z == pytest.approx(9.8, abs=0.01)  # REP-145: +g at rest
    assert message.linear_acceleration.y == pytest.approx(-0.2, abs=0.01)
    assert fused[-1].gyro_used == fused[-1].accel_used == 63 and list(fused[-1].gyro_drift) == [0.0] * 6
    bench.until(lambda: len(status) >= 11)
    assert [(convert.to_ns(m.header.stamp) - START) // DT for m in status] == list(range(0, 101, 10))  # 10 Hz of measurement time
    triad = status[-1].gyro
    assert len(triad.parity) == 3 and triad.dof == 3 and triad.capability == TriadFdi.ISOLATES and triad.threshold == pytest.approx(33.3, abs=0.05)
    assert triad.statistic == pytest.approx(np.sum(np.square(triad.parity)) / bench.sigma[0, 0] ** 2, rel=1e-9)


def test_nan_in_one_gyro_costs_this_gyro_alone(bench: Bench) -> None:
    def spoil(values: dict[str, Any]) -> None:
        values["gyro"][2] = np.nan

    bench.feed(0, 10)
    bench.feed(10, 20, spoil)
    fused = bench.got["fused"]
    assert [m.gyro_used for m in fused] == [63] * 10 + [63 - 4] * 10 and all(m.accel_used == 63 for m in fused)
    assert np.isfinite([m.angular_velocity.x for m in fused]).all()
    bench.until(lambda: bench.last_text() == "gyro_2 suspect -> isolated (not finite)")
    told = [m for m in bench.got["status"] if m.text][-1]
    assert told.gyro.state[2] == TriadFdi.ISOLATED and told.gyro.reason[2] == TriadFdi.REASON_NOT_FINITE
    assert convert.to_ns(told.gyro.since[2]) == START + 12 * DT == convert.to_ns(told.header.stamp)


def test_a_lying_accelerometer_is_isolated_and_returns(bench: Bench) -> None:
    def spoil(values: dict[str, Any]) -> None:
        values["accel"][5] += 0.5

    bench.feed(0, 50)
    bench.feed(50, 60, spoil)
    bench.feed(60, 400)
    used = np.array([bool(m.accel_used >> 5 & 1) for m in bench.got["fused"]])
    assert used[:50].all() and not used[50:252].any() and used[300:].all()
    bench.until(lambda: bench.last_text() == "accel_5 probation -> healthy (consistent again)")


def test_wrong_length_and_stamps_back_are_counted(bench: Bench) -> None:
    def short(values: dict[str, Any]) -> None:
        values["accel"] = values["accel"][:5]

    def back(values: dict[str, Any]) -> None:
        values["stamp_ns"] -= 50 * DT

    bench.feed(0, 60)
    bench.feed(60, 63, short)
    bench.feed(63, 65, back)
    bench.feed(65, 72)
    bench.until(lambda: bench.got["status"][-1].received == 71)
    status = bench.got["status"][-1]
    assert (status.rejected_length, status.rejected_stamp, status.fused, status.lost, status.restarts) == (3, 2, 66, 0, 0)
    assert bench.last_text() == "rejected: 6 gyros and 5 accelerometers instead of 6 each"


def test_a_jump_restarts_announced(bench: Bench) -> None:
    bench.feed(0, 20)
    bench.feed(20, 30, lambda values: values.update(stamp_ns=values["stamp_ns"] + 5_000_000_000))
    bench.until(lambda: bench.last_text() == "restart: the stamp jumped by +5.010 s")
    assert bench.got["status"][-1].restarts == 1 and len(bench.got["fused"]) == 30


def test_operator_service(bench: Bench) -> None:
    def call(target: str, use: bool, stamp_ns: int = 0) -> SetSensorUse.Response:
        future = bench.use.call_async(SetSensorUse.Request(target=target, use=use, effective=convert.to_stamp(stamp_ns)))
        bench.until(future.done)
        return future.result()

    bench.feed(0, 10)
    assert call("gyro_0", False, START + 15 * DT).success
    assert not call("gyro_0", False, START).success and not call("gps", False).success
    bench.feed(10, 20)
    assert [m.gyro_used & 1 for m in bench.got["fused"]] == [1] * 15 + [0] * 5
    bench.until(lambda: bench.last_text() == "gyro_0 healthy -> excluded (operator)")
    told = next(m for m in bench.got["status"] if m.text.startswith("gyro_0"))
    assert told.gyro.state[0] == TriadFdi.EXCLUDED and convert.to_ns(told.header.stamp) == START + 15 * DT


def test_accepted_commands_are_published_with_the_stamp_that_holds(bench: Bench) -> None:
    def call(target: str, use: bool, stamp_ns: int = 0) -> None:
        future = bench.use.call_async(SetSensorUse.Request(target=target, use=use, effective=convert.to_stamp(stamp_ns)))
        bench.until(future.done)

    call("accel_3", False)  # before the first sample
    bench.feed(0, 10)
    call("gyro_0", False, START + 15 * DT)
    call("gyro_0", False, START)  # refused: that time has passed
    call("gps", False)  # refused: not a sensor of this node
    call("gyro_0", True, 0)
    heard: list[SensorUse] = []
    bench.other.create_subscription(SensorUse, "nav/commands", heard.append, qos.latched(100))  # late, as a recorder may be
    bench.until(lambda: len(heard) >= 3)
    assert [(m.target, m.use, convert.to_ns(m.header.stamp)) for m in heard] == [
        ("accel_3", False, 0), ("gyro_0", False, START + 15 * DT), ("gyro_0", True, START + 9 * DT + 1),
    ]  # fmt: skip


def test_a_method_is_chosen_while_running_and_published_with_the_stamp_that_holds(bench: Bench) -> None:
    client = bench.other.create_client(SetFusionMethod, "imu_fusion/set_fusion_method")
    bench.until(client.service_is_ready)

    def call(**request: Any) -> SetFusionMethod.Response:
        future = client.call_async(SetFusionMethod.Request(**request))
        bench.until(future.done)
        return future.result()

    start = bench.node._config.method
    bench.feed(0, 10)
    answer = call(fusion="opt", sequential_test="cusum", effective=convert.to_stamp(START + 15 * DT))
    assert answer.success and answer.message.startswith("fusion opt, parity test glt, sequential test cusum, noise as stated from ")
    refused = [call(fusion="optt"), call(parity_test="svd", effective=convert.to_stamp(START))]
    assert [r.success for r in refused] == [False, False] and '(did you mean "opt"?)' in refused[0].message and "passed" in refused[1].message
    bench.feed(10, 30)
    grown = [m.angular_velocity_covariance[0] > 1.5 * bench.got["raw"][0].angular_velocity_covariance[0] for m in bench.got["raw"]]
    assert grown == [False] * 15 + [True] * 15  # what opt does not know of the drifts is in its covariance
    heard: list[FusionMethod] = []
    bench.other.create_subscription(FusionMethod, "fdi/method", heard.append, qos.latched(100))  # late, as a recorder may be
    bench.until(lambda: len(heard) >= 2)
    assert [(m.fusion, m.parity_test, m.sequential_test, m.adapt_noise, convert.to_ns(m.header.stamp)) for m in heard] == [
        (start, "glt", "none", False, 0), ("opt", "glt", "cusum", False, START + 15 * DT),
    ]  # fmt: skip
    other = bench.other.create_publisher(FusionMethod, "fdi/method", qos.latched(100))  # a recording that is played
    bench.until(lambda: other.get_subscription_count() >= 2)
    other.publish(convert.fill(FusionMethod, fields.fusion_method(START + 40 * DT, Selection("wls", "svd", "none", True))))
    bench.until(lambda: bench.node._pipeline.selected(START + 40 * DT).fusion == "wls")
    bench.feed(30, 45)
    assert bench.node._pipeline.selected() == ("wls", "svd", "none", True)


@pytest.mark.parametrize("bench", [["-p", "method:=irfdc", "-p", "drift.rfdc.filter:=aekpf", "-p", "drift.rfdc.particles:=20"]], indirect=True)
def test_the_node_runs_irfdc_and_publishes_what_the_pipeline_says_offline(bench: Bench) -> None:
    """By parameter from the first sample, by service from a stamp on to rfdc; the same samples in one block give the same numbers."""
    drift = 3.0 * bench.sigma[0, 1]

    def spoil(values: dict[str, Any]) -> None:
        values["gyro"][1] += drift

    client = bench.other.create_client(SetFusionMethod, "imu_fusion/set_fusion_method")
    bench.until(client.service_is_ready)
    bench.feed(0, 40, spoil)
    future = client.call_async(SetFusionMethod.Request(fusion="rfdc", effective=convert.to_stamp(START + 60 * DT)))
    bench.until(future.done)
    assert future.result().success and "fusion rfdc (whose drift it is is a guess" in future.result().message
    bench.feed(40, 90, spoil)
    heard: list[FusionMethod] = []
    bench.other.create_subscription(FusionMethod, "fdi/method", heard.append, qos.latched(100))
    bench.until(lambda: len(heard) >= 2)
    assert [(m.fusion, convert.to_ns(m.header.stamp)) for m in heard] == [("irfdc", 0), ("rfdc", START + 60 * DT)]
    offline = FusionPipeline(bench.node._config)
    assert offline.config.drift.rfdc.filter == "aekpf" and offline.set_method("rfdc", effective_ns=START + 60 * DT).success
    k = np.arange(90)
    gyro = bench.array.H @ RATE + bench.sigma[0] * normal(3, 0, 0, 90, 6)
    gyro[:, 1] += drift
    accel = bench.array.H @ FORCE + bench.sigma[1] * normal(3, 1, 0, 90, 6)
    block = offline.process(START + k * DT, k, gyro, accel, np.full(90, 63), np.full(90, 63))
    rates = np.array([[m.angular_velocity.x, m.angular_velocity.y, m.angular_velocity.z] for m in bench.got["fused"]])
    np.testing.assert_allclose(rates, frd_to_flu(block.rate), rtol=0, atol=1e-15)
    assert np.any(block.gyro_drift[59] != 0.0) and np.all(block.gyro_drift[60] == 0.0)


@pytest.mark.parametrize(("name", "value"), [("method", "opt"), ("parity_test", "svd"), ("sequential_test", "cusum"), ("adapt_noise", True)])
def test_a_parameter_set_while_running_is_refused_with_the_service_that_changes_it(bench: Bench, name: str, value: Any) -> None:
    client = bench.other.create_client(SetParameters, "imu_fusion/set_parameters")  # what `ros2 param set` calls
    bench.until(client.service_is_ready)
    answer = client.call_async(SetParameters.Request(parameters=[Parameter(name, value=value).to_parameter_msg()]))
    bench.until(answer.done)
    result = answer.result().results[0]
    assert not result.successful and result.reason == f'"{name}" is what the node starts with; call /imu_fusion/set_fusion_method to change it'
    assert bench.node.get_parameter(name).value != value


def test_diagnostics_say_that_there_is_no_imu(bench: Bench) -> None:
    def levels() -> dict[str, tuple[bytes, str]]:
        return {s.name: (s.level, s.message) for s in bench.got["diagnostics"][-1].status}

    bench.until(lambda: bool(bench.got["diagnostics"]) and levels()["imu_fusion"] == (b"\x02", "no IMU: nothing on rimu/raw"))
    k = 0
    count = len(bench.got["diagnostics"])
    while len(bench.got["diagnostics"]) == count:
        bench.feed(k, k + 1)
        k += 1
    assert levels()["imu_fusion"] == (b"\x00", "all samples fused") and levels()["imu_fusion: gyro"] == (b"\x00", "all 6 healthy")


def test_lifecycle_deactivates_and_comes_back(bench: Bench) -> None:
    bench.feed(0, 5)
    bench.node.trigger_deactivate()
    bench.sample(5)
    bench.executor.spin_once(timeout_sec=0.3)
    assert bench.node._pipeline.counters.received == 5
    bench.node.trigger_activate()
    bench.feed(6, 10)
    assert bench.got["fused"][-1].sequence == 9 and bench.node._pipeline.counters.lost == 1
    bench.node.trigger_deactivate()
    bench.node.trigger_cleanup()
    assert not list(bench.node.subscriptions)
    bench.until(lambda: bench.other.count_publishers("imu/fused") == 0)


@pytest.mark.parametrize(
    ("parameter", "message"),
    [
        ("gyro_sigm:=[1e-5]", 'unknown parameter "gyro_sigm" (did you mean "gyro_sigma"?)'),
        ("gyro_sigma:=[1e-5, 1e-5]", "1 or 6 elements"),
        ("rate_hz:=-1", "rate_hz"),
        ("geometry:=[1.0, 0.0]", "three elements"),
    ],
)
def test_bad_parameters_end_with_status_2_and_one_line(parameter: str, message: str, capfd: pytest.CaptureFixture[str]) -> None:
    assert main(["--ros-args", "-p", parameter]) == 2
    lines = [line for line in capfd.readouterr().err.splitlines() if line.startswith("imu_fusion: error:")]
    assert len(lines) == 1 and message in lines[0]
