"""The nodes `nmea` and `motion` over DDS in one process: states in, sentences out of a UDP port; sentences in, aids on topics; bad parameters.

Lives here: what a bridge and another stack see.
Does not live here: single sentences (test_nmea_sentences.py), heave (test_nmea_heave.py).
"""

from __future__ import annotations

import math
import os
import socket
import sys
import time
from collections.abc import Callable, Iterator
from typing import Any

import pynmea2
import pytest

pytest.importorskip("rclpy", reason="needs ROS 2")
pytest.importorskip("riins_msgs.msg", reason="needs riins_msgs built by colcon and its environment")

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseWithCovarianceStamped, TwistWithCovarianceStamped
from rclpy.executors import SingleThreadedExecutor
from rclpy.lifecycle import TransitionCallbackReturn
from sensor_msgs.msg import NavSatFix

from riins_msgs.msg import AlignmentStatus, FederatedStatus, NavState, SubfilterStatus, VesselMotion
from riins_nmea.nodes import motion, nmea
from riins_nmea.sentences import sentence
from riins_node import convert, qos

os.environ["ROS_DOMAIN_ID"] = str(100 + (os.getpid() + 45) % 80)
os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")

START = 1_700_000_000_000_000_000  # 22:13:20 UTC
DT = 20_000_000


class Bench:
    """The two nodes and one of ours, spun together."""

    def __init__(self, port: int, entry: int) -> None:
        self.context = rclpy.Context()
        words = [f"outputs:=['udp://127.0.0.1:{port}']", f"inputs:=['udp://127.0.0.1:{entry}']", "state_timeout_s:=0.5", "position.sentence:=GGA"]
        words += ["velocity.sentence:=RMC", "log.sentence:=VBW", "water_log.sentence:=VBW", "heading.sentence:=THS", "cutoff_period_s:=20.0"]
        mine = [word for word in words if "cutoff" not in word]
        rclpy.init(
            args=["--ros-args", *(w for one in mine for w in ("-p", f"nmea:{one}")), "-p", "motion:cutoff_period_s:=20.0"], context=self.context
        )
        self.nmea, self.motion = nmea.NmeaNode(context=self.context), motion.MotionNode(context=self.context)
        self.other = rclpy.create_node("other", context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        for node in (self.nmea, self.motion, self.other):
            self.executor.add_node(node)
        for node in (self.nmea, self.motion):
            node.start()

    def until(self, condition: Callable[[], Any], seconds: float = 15.0) -> None:
        end = time.monotonic() + seconds
        while not condition():
            assert time.monotonic() < end, "timed out"
            self.executor.spin_once(timeout_sec=0.002)

    def close(self) -> None:
        self.executor.shutdown()
        for node in (self.nmea, self.motion, self.other):
            node.destroy_node()
        rclpy.try_shutdown(context=self.context)


def bound() -> socket.socket:
    one = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    one.bind(("127.0.0.1", 0))
    one.setblocking(False)
    return one


@pytest.fixture
def bench() -> Iterator[tuple[Bench, socket.socket, int]]:
    with bound() as ear:
        with bound() as free:
            entry = free.getsockname()[1]
        made = Bench(ear.getsockname()[1], entry)
        yield made, ear, entry
        made.close()


def drain(ear: socket.socket) -> list[str]:
    """Every datagram that has come: one whole sentence each."""
    got = []
    while True:
        try:
            text = ear.recv(2000).decode("ascii")
        except BlockingIOError:
            return got
        assert text.startswith("$") and text.endswith("\r\n") and text.count("$") == 1
        got.append(text)


def fields(texts: list[str], kind: str) -> list[list[str]]:
    return [text[1:].split("*")[0].split(",") for text in texts if text.split(",")[0].endswith(kind)]


def state(k: int, mode: int = NavState.MODE_NAVIGATING) -> NavState:
    """A ship at 54 N 10 E that heads 30 deg at 6 m/s and heaves 1 m at 3 s."""
    t, w = k * DT * 1e-9, 2 * math.pi / 3.0
    made = NavState(sequence=k, mode=mode, latitude=54.0, longitude=10.0, height=1.0 + math.sin(w * t), heading=math.radians(30.0), roll=0.05)
    made.header.stamp = convert.to_stamp(START + k * DT)
    made.velocity_north, made.velocity_east = 6.0 * math.cos(made.heading), 6.0 * math.sin(made.heading)
    made.velocity_down = -w * math.cos(w * t)
    made.sigma_velocity_down, made.sigma_roll, made.sigma_pitch, made.sigma_heading = 0.002, 1e-4, 1e-4, 1e-3
    return made


def test_a_run_of_the_navigator_is_what_the_bridge_reads(bench: tuple[Bench, socket.socket, int]) -> None:
    """Rates by measurement time, values, heave of the same stamp, dead reckoning, and an end of the state that is told."""
    made, ear, _ = bench
    motions: list[VesselMotion] = []
    states = made.other.create_publisher(NavState, "nav/state", qos.navigation())
    alignment = made.other.create_publisher(AlignmentStatus, "nav/alignment", qos.latched())
    health = made.other.create_publisher(FederatedStatus, "nav/subfilters", qos.latched())
    made.other.create_subscription(VesselMotion, "nav/motion", motions.append, qos.navigation())
    made.until(lambda: states.get_subscription_count() == 2 and health.get_subscription_count() == 1 and made.other.count_publishers("nav/motion"))
    made.until(lambda: made.motion._out.get_subscription_count() == 2)
    made.until(lambda: (silent := drain(ear)) and fields(silent, "GGA") and fields(silent, "THS")[-1][1:] == ["", "V"])
    alignment.publish(AlignmentStatus(phase=AlignmentStatus.COARSE, code=AlignmentStatus.CODE_LEVELING))
    made.until(lambda: any(one[4:7] + one[10:] == ["", "", "", "0", "1"] for one in fields(drain(ear), "PASHR")))

    def report(k: int, name: str) -> None:
        one = FederatedStatus(subfilters=[SubfilterStatus(name=name, state=SubfilterStatus.HEALTHY)])
        one.header.stamp = convert.to_stamp(START + k * DT)
        health.publish(one)
        made.until(lambda: made.nmea._status[0] == START + k * DT)

    def sail(first: int, last: int, mode: int = NavState.MODE_NAVIGATING) -> None:
        for k in range(first, last):
            states.publish(state(k, mode))
            if k % 20 == 19:
                made.until(lambda: motions and motions[-1].sequence >= k)  # noqa: B023

    settled = 2400  # 48 s; heave is valid after 46
    report(0, "gps")
    sail(0, settled)
    drain(ear)  # what the buffer kept of the first 48 s
    report(settled, "gps")
    sail(settled, settled + 100)
    made.until(lambda: len(motions) == settled + 100 and made.nmea._newest_ns == START + (settled + 99) * DT)
    got = drain(ear)
    counts = {kind: len(fields(got, kind)) for kind in ("GGA", "VTG", "THS", "ROT", "PASHR", "VBW")}
    assert counts == {"GGA": 2, "VTG": 2, "THS": 20, "ROT": 20, "PASHR": 20, "VBW": 2}
    fix = pynmea2.parse(next(text for text in got if "GGA" in text), check=True)
    assert (fix.latitude, fix.longitude, fix.gps_qual, str(fix.timestamp)[:8]) == (54.0, 10.0, 1, "22:14:08")
    course = pynmea2.parse(next(text for text in got if "VTG" in text), check=True)
    assert (float(course.true_track), float(course.spd_over_grnd_kmph)) == (30.0, 21.6)
    for one in fields(got, "PASHR"):
        seconds = 3600 * int(one[1][:2]) + 60 * int(one[1][2:4]) + float(one[1][4:]) - (22 * 3600 + 13 * 60 + 20)
        assert float(one[6]) == pytest.approx(math.sin(2 * math.pi / 3.0 * seconds), abs=0.03) and one[10:] == ["1", "4"]

    report(settled + 100, "doppler")
    sail(settled + 100, settled + 150)
    made.until(lambda: made.nmea._newest_ns == START + (settled + 149) * DT)
    assert [(one[6]) for one in fields(drain(ear), "GGA")] == ["6"]
    sail(settled + 150, settled + 200, NavState.MODE_FAILED)
    made.until(lambda: len(motions) == settled + 200)
    failed = drain(ear)
    assert {one[2] for one in fields(failed, "THS")} == {"V"} and {tuple(one[4:7]) for one in fields(failed, "PASHR")} == {("", "", "")}
    assert {one[6] for one in fields(failed, "GGA")} == {"0"}
    sail(settled + 200, settled + 203)
    made.until(lambda: made.nmea._newest_ns == START + (settled + 202) * DT)
    drain(ear)
    made.until(lambda: (silent := drain(ear)) and {one[2] for one in fields(silent, "THS")} == {"V"})


def test_sentences_become_aids_and_wrong_ones_are_counted(bench: tuple[Bench, socket.socket, int]) -> None:
    made, _, entry = bench
    seen: dict[str, list[Any]] = {}
    told: dict[str, Any] = {}
    topics = {"gps/fix": NavSatFix, "gps/velocity": TwistWithCovarianceStamped, "doppler/velocity": TwistWithCovarianceStamped}
    topics |= {"doppler/water_velocity": TwistWithCovarianceStamped, "compass/heading": PoseWithCovarianceStamped}
    for topic, kind in topics.items():
        made.other.create_subscription(kind, topic, seen.setdefault(topic, []).append, qos.aid())
    made.other.create_subscription(DiagnosticArray, "/diagnostics", lambda m: told.update({s.name: s for s in m.status}), qos.navigation())
    made.until(lambda: all(one[0].get_subscription_count() == 1 for one in made.nmea._aids.values()))
    now = time.time()
    clock = time.strftime("%H%M%S", time.gmtime(now)) + ".00"
    texts = [
        sentence("GPGGA", clock, "5424.50000", "S", "17959.99999", "W", "1", "08", "1.5", "10.0", "M", "40.0", "M", "", ""),
        sentence("GPRMC", clock, "A", "5424.50000", "S", "17959.99999", "W", "10.0", "180.0", "010124", "", "", "A"),
        sentence("VDVBW", "5.0", "1.0", "A", "6.0", "-1.0", "A", "", "V", "", "V"),
        sentence("HETHS", "270.00", "A"),
        sentence("HETHS", "270.00", "A").replace("*", "*0"),
        sentence("HETHS", "", "V"),
        "nonsense\r\n",
    ]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as mouth:
        mouth.sendto("".join(texts).encode(), ("127.0.0.1", entry))
    made.until(lambda: all(seen.values()))
    fix, velocity, log, water, heading = (seen[topic][0] for topic in topics)
    assert (fix.latitude, fix.longitude, fix.altitude) == pytest.approx((-54.0 - 24.5 / 60, -179.0 - 59.99999 / 60, 50.0), abs=1e-9)
    assert fix.position_covariance[0] == pytest.approx(4.5**2) and fix.header.frame_id == "gps_link" and fix.header.stamp.sec == int(now)
    assert fix.header.stamp.nanosec == 0 and velocity.twist.twist.linear.y == pytest.approx(-10.0 * 1852 / 3600)
    assert (log.twist.twist.linear.x, log.twist.twist.linear.y) == pytest.approx((6.0 * 1852 / 3600, 1852 / 3600))
    assert water.twist.twist.linear.y == pytest.approx(-1852 / 3600) and math.isnan(log.twist.twist.linear.z)
    q = heading.pose.pose.orientation
    assert math.remainder(2.0 * math.atan2(q.z, q.w) - math.pi, 2 * math.pi) == pytest.approx(0.0, abs=1e-9) and heading.pose.covariance[35] > 0.0
    made.until(lambda: "nmea: inputs" in told and any(v.key == "unreadable: malformed" for v in told["nmea: inputs"].values))
    values = {value.key: value.value for value in told["nmea: inputs"].values}
    assert (values["THS: checksum"], values["THS: not valid"], values["unreadable: malformed"]) == ("1", "1", "1")
    made.until(lambda: told["nmea: inputs"].message == "3 sentences rejected so far" and "motion" in told)

    for step in (made.nmea.trigger_deactivate, made.nmea.trigger_cleanup, made.nmea.trigger_configure, made.nmea.trigger_activate):
        assert step() == TransitionCallbackReturn.SUCCESS
    made.until(lambda: made.nmea._aids["heading"][0].get_subscription_count() == 1)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as mouth:
        mouth.sendto(sentence("HETHS", "90.00", "A").encode(), ("127.0.0.1", entry))
    made.until(lambda: len(seen["compass/heading"]) == 2)


@pytest.mark.parametrize(
    ("main", "words", "status", "message"),
    [
        (nmea.main, [], 2, "nothing to do"),
        (nmea.main, ["outputs:=['10.0.0.1:10110']"], 2, "udp://HOST:PORT"),
        (nmea.main, ["outputs:=['udp://ship.invalid:9']"], 1, "udp://ship.invalid:9"),
        (nmea.main, ["inputs:=['udp://0.0.0.0:9']"], 2, "no aid names a sentence"),
        (nmea.main, ["rate_hz.gga:=11"], 2, "0 .. 10"),
        (nmea.main, ["talkr:=GP"], 2, 'did you mean "talker"'),
        (motion.main, ["cutoff_period_s:=1.0"], 2, "20.0 .. 1000.0"),
    ],
)
def test_bad_parameters_end_in_one_line(main: Any, words: list[str], status: int, message: str, capfd: pytest.CaptureFixture[str]) -> None:
    assert main(["--ros-args", *(word for one in words for word in ("-p", one))]) == status
    lines = [line for line in capfd.readouterr().err.splitlines() if ": error:" in line]
    assert len(lines) == 1 and message in lines[0]


def test_without_pynmeagps_one_line_says_how_to_get_it(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setitem(sys.modules, "pynmeagps", None)
    with bound() as free:
        port = free.getsockname()[1]
    assert nmea.main(["--ros-args", "-p", f"inputs:=['udp://127.0.0.1:{port}']", "-p", "heading.sentence:=THS"]) == 1
    assert "pip install pynmeagps" in capfd.readouterr().err
