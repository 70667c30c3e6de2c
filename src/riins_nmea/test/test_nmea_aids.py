"""Sentences that come in: what each becomes, and that nothing wrong gets through, or gets out as an exception.

Lives here: AidReader, Lines, time of day, the message fields of readings.
Does not live here: sockets (test_nmea_links.py), the node (test_nmea_node.py).
"""

from __future__ import annotations

import functools
import math
import operator
from datetime import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from riins_core.settings import SettingError, build
from riins_nmea import messages
from riins_nmea.aids import AidReader, Lines, nearest_day
from riins_nmea.config import NmeaConfig
from riins_nmea.sentences import Form, Picture, gga, ths, vbw
from riins_node import readings

pytest.importorskip("pynmeagps")

DAY = 86_400_000_000_000
NOON = 19_000 * DAY + DAY // 2
EVERY = {
    "inputs": ["udp://0.0.0.0:10111"], "position": {"sentence": "GGA"}, "velocity": {"sentence": "RMC"}, "log": {"sentence": "VBW"},
    "water_log": {"sentence": "VBW"}, "heading": {"sentence": "THS"},
}  # fmt: skip


def reader(**changes) -> AidReader:
    return AidReader(build(NmeaConfig, {**EVERY, **changes}))


def line(content: str) -> bytes:
    """Content with $ and checksum."""
    return f"${content}*{functools.reduce(operator.xor, content.encode()):02X}".encode()


GGA = "GPGGA,120000.00,5424.50000,N,01012.30000,W,1,08,2.0,12.5,M,40.0,M,,"
RMC = "GPRMC,120000.00,A,5424.50000,N,01012.30000,W,10.0,090.0,010124,,,A"


def test_gga_becomes_a_position() -> None:
    one = reader(position={"sentence": "GGA", "sigma_m": 1.5, "sigma_height_m": 4.0})
    (got,) = one.read(line(GGA), NOON + 300_000_000)
    assert (got.aid, got.stamp_ns, got.ok, got.talker) == ("position", NOON, True, "GP")
    np.testing.assert_allclose(np.degrees(got.z[:2]), [54.0 + 24.5 / 60, -10.0 - 12.3 / 60], atol=1e-9)
    assert got.z[2] == 52.5 and got.sigma.tolist() == [3.0, 3.0, 8.0]
    fix = messages.nav_sat_fix(got, "gps_link")
    assert fix["latitude"] == pytest.approx(54.0 + 24.5 / 60, abs=1e-9) and fix["status"] == {"status": 0, "service": 1}
    assert fix["position_covariance"].tolist() == [9.0, 0, 0, 0, 9.0, 0, 0, 0, 64.0] and fix["header"] == {"stamp": NOON, "frame_id": "gps_link"}


def test_rmc_becomes_a_velocity_and_a_position() -> None:
    one = reader(position={"sentence": "RMC"}, geoid_separation_m=40.0)
    got = {reading.aid: reading for reading in one.read(line(RMC), NOON)}
    assert set(got) == {"position", "velocity"} and got["position"].z[2] == 40.0
    np.testing.assert_allclose(got["velocity"].z[:2], [0.0, 10.0 * 1852 / 3600], atol=1e-12)
    twist = messages.ground_velocity(got["velocity"], "map")["twist"]["twist"]["linear"]
    assert twist["x"] == pytest.approx(10.0 * 1852 / 3600) and twist["y"] == pytest.approx(0.0, abs=1e-12) and math.isnan(twist["z"])


def test_vbw_becomes_both_speeds_and_ths_a_heading() -> None:
    """Forward and starboard in; FLU out, the third not measured; heading as yaw from east."""
    one = reader(log={"sentence": "VBW", "delay_s": 0.25})
    got = {reading.aid: reading for reading in one.read(line("VDVBW,5.0,-1.0,A,6.0,2.0,A,,V,,V"), NOON)}
    assert got["log"].stamp_ns == NOON - 250_000_000 and got["water_log"].stamp_ns == NOON
    np.testing.assert_allclose(got["log"].z[:2], np.array([6.0, 2.0]) * 1852 / 3600)
    np.testing.assert_allclose(got["water_log"].z[:2], np.array([5.0, -1.0]) * 1852 / 3600)
    twist = messages.body_velocity(got["log"], "doppler_link")["twist"]["twist"]["linear"]
    assert twist["y"] == pytest.approx(-2.0 * 1852 / 3600) and math.isnan(twist["z"])
    (got_heading,) = one.read(line("HETHS,30.00,A"), NOON)
    pose = messages.heading_pose(got_heading, "map")["pose"]
    q = pose["pose"]["orientation"]
    assert math.degrees(2.0 * math.atan2(q["z"], q["w"])) == pytest.approx(60.0) and pose["covariance"][35] == pytest.approx(math.radians(0.5) ** 2)
    assert one.accepted == {"log": 1, "water_log": 1, "heading": 1} and not one.rejected


@pytest.mark.parametrize(
    ("text", "sentence", "reason"),
    [
        (line(GGA)[:-1] + b"0", "GGA", "checksum"),
        (line(GGA)[:-3], "GGA", "checksum"),
        (line(GGA.replace("120000.00", "120003.00")), "GGA", "stale"),
        (line(GGA.replace("120000.00", "")), "GGA", "malformed"),
        (line(GGA.replace("120000.00", "126000.00")), "GGA", "malformed"),
        (line(GGA.replace("5424.50000", "9124.50000")), "GGA", "malformed"),
        (line(GGA.replace("5424.50000", "5460.00000")), "GGA", "malformed"),
        (line(GGA.replace("5424.50000", "nan")), "GGA", "malformed"),
        (line(GGA.replace("5424.50000", "")), "GGA", "malformed"),
        (line(GGA.replace(",N,", ",E,")), "GGA", "malformed"),
        (line(GGA.replace(",2.0,", ",nan,")), "GGA", "malformed"),
        (line("GPGGA,120000.00,5424"), "GGA", "malformed"),
        (line("GPGGA,,,,,,0,,,,M,,M,,"), "GGA", "not valid"),
        (line("HETHS,,V"), "THS", "not valid"),
        (line("HETHS,30.0,E"), "THS", "not valid"),
        (line("HETHS,361.0,A"), "THS", "malformed"),
        (line("HETHS,A"), "THS", "malformed"),
        (line("VDVBW,,,V,,,V,,V,,V"), "VBW", "not valid"),
        (line("VDVBW,,,A,,,A,,V,,V"), "VBW", "malformed"),
        (line(RMC.replace(",A,5424", ",V,5424")), "RMC", "not valid"),
        (line(RMC[:-1] + "E"), "RMC", "not valid"),
        (line(RMC.replace(",090.0,", ",,")), "RMC", "malformed"),
        (b"$GP\xff\xfe,1*00", "", "malformed"),
        (b"hello", "", "malformed"),
        (b"$" + b"x" * 2000, "", "too long"),
    ],
)
def test_what_is_wrong_is_counted_by_reason(text: bytes, sentence: str, reason: str) -> None:
    one = reader()
    assert one.read(text, NOON) == []
    assert set(one.rejected) == {(sentence, reason)} and not one.accepted


@pytest.mark.parametrize("code", ["0", "6", "7", "8"])
def test_a_receiver_without_a_fix_says_so(code: str) -> None:
    """Dead-reckoned, manual and simulated positions are passed on as no fix, never as one."""
    one = reader()
    (got,) = one.read(line(GGA.replace(",W,1,", f",W,{code},")), NOON)
    fix = messages.nav_sat_fix(got, "gps_link")
    assert not got.ok and fix["status"]["status"] == -1 and math.isnan(fix["latitude"]) and one.rejected == {("GGA", "not valid"): 1}


def test_a_frozen_receiver_is_heard_once_and_midnight_is_no_return() -> None:
    one = reader(max_age_s=5.0)
    for k, arrival in enumerate((0.0, 0.5, 1.0)):
        assert len(one.read(line(GGA), NOON + round(arrival * 1e9))) == (k == 0)
    assert one.rejected == {("GGA", "repeated"): 2}
    other = reader()
    midnight = 19_001 * DAY
    stamps = [got.stamp_ns for text, at in (("235959.50", -0.4), ("000000.50", 0.6)) for got in
              other.read(line(GGA.replace("120000.00", text)), midnight + round(at * 1e9))]  # fmt: skip
    assert stamps == [midnight - 500_000_000, midnight + 500_000_000]


@settings(max_examples=60, deadline=None)
@given(st.integers(10**18, 4 * 10**18), st.integers(-43_199_000, 43_199_000))
def test_the_day_is_that_of_the_arrival(arrival: int, late_ms: int) -> None:
    """Whatever the age within half a day, the stamp is the one that was meant, over midnight either way."""
    meant = (arrival // 1_000_000 - late_ms) * 1_000_000
    ms = meant // 1_000_000 % 86_400_000
    text = time(ms // 3_600_000, ms // 60_000 % 60, ms // 1000 % 60, ms % 1000 * 1000)
    assert nearest_day(text, arrival) == meant


@settings(max_examples=60, deadline=None)
@given(st.floats(-1.57, 1.57), st.floats(-math.pi, math.pi), st.floats(0.0, 6.28), st.tuples(st.floats(-20, 20), st.floats(-20, 20)))
def test_what_we_send_we_read(lat, lon, heading, v) -> None:
    """Our own sentences through our own reader and the messages' readers: position, heading, ground speed."""
    now = Picture(NOON, 2, (0, 0, 0), lat, lon, 30.0, (*v, 0.0), (0.0, 0.0, heading), gnss=True)
    one = reader(geoid_separation_m=12.0)
    got = {r.aid: r for make in (gga, ths, vbw) for r in one.read(make(now, Form(geoid_separation_m=12.0)).encode(), NOON)}
    assert set(got) == {"position", "heading", "log"} and not set(one.rejected) - {("VBW", "not valid")}
    assert got["position"].z[0] == pytest.approx(lat, abs=2e-9) and got["position"].z[2] == pytest.approx(30.0, abs=0.0051)
    assert math.remainder(got["position"].z[1] - lon, 2 * math.pi) == pytest.approx(0.0, abs=2e-9)
    assert math.remainder(float(got["heading"].z[0]) - heading, 2 * math.pi) == pytest.approx(0.0, abs=1e-4)
    turned = complex(*got["log"].z[:2]) * np.exp(1j * heading)
    assert abs(turned - complex(*v)) < 0.004


@settings(max_examples=200, deadline=None)
@given(st.binary(max_size=90) | st.builds(lambda text: line("GPGGA," + text), st.text("0123456789.,NSEWAV-+e_ ", max_size=70)))
def test_no_bytes_from_outside_raise(data: bytes) -> None:
    one = reader()
    for got in one.read(data, NOON):
        assert np.isfinite(got.sigma).all() and (not got.ok or np.isfinite(got.z[:2]).all())


def test_lines_of_a_stream_and_of_datagrams() -> None:
    """Cut anywhere, a stream gives the same lines; a datagram ends its line; tag blocks and halves of sentences before the $ are skipped."""
    text = b"\r\n".join([line(GGA), line("HETHS,30.00,A"), b""])
    for cut in range(len(text)):
        lines = Lines()
        assert lines.feed(text[:cut], False) + lines.feed(text[cut:], False) == [line(GGA), line("HETHS,30.00,A")]
    assert Lines().feed(line(GGA), True) == [line(GGA)]
    endless = Lines()
    assert endless.feed(b"x" * 3000, False) == [] and endless.too_long == 1 and endless.feed(b"$A\n", False) == [b"$A"]
    for before in (b"\\s:GP0001,n:12*1F\\", b"UdPbC\0\\s:GP0001*51\\", b"$GPGGA,1200"):
        assert [got.aid for got in reader().read(before + line(GGA), NOON)] == ["position"]


def test_other_sentences_and_other_talkers_are_no_fault() -> None:
    one = reader(heading={"sentence": "THS", "talker": "HE"})
    for text in (line("GPGSV,1,1,00"), line("INTHS,30.0,A"), b"!AIVDM,1,1,,A,15M67FC000G?ufbE`FepT@3n00Sa,0*5C"):
        assert one.read(text, NOON) == []
    assert one.unused == 3 and not one.rejected


def test_readers_of_the_navigator_take_what_comes_out() -> None:
    """Position, ground velocity, log and heading come back as numbers of the algorithms; what was not measured stays NaN and spreads nowhere."""

    class Message:
        def __init__(self, fields):
            for name, value in fields.items():
                setattr(self, name, Message(value) if isinstance(value, dict) else value)

    def read(reader_of, fields):
        fields["header"]["stamp"] = {"sec": NOON // 10**9, "nanosec": 0}
        return reader_of(Message(fields))

    one = reader()
    got = {r.aid: r for text in (GGA, RMC, "VDVBW,,,V,6.0,2.0,A,,V,,V", "HETHS,300.0,A") for r in one.read(line(text), NOON)}
    fix = read(readings.read_position_aid, messages.nav_sat_fix(got["position"], "gps_link"))
    assert fix["ok"] and fix["z"] == pytest.approx(got["position"].z, abs=1e-12) and np.diag(fix["R"]) == pytest.approx([36.0, 36.0, 144.0])
    ground = read(readings.read_velocity, messages.ground_velocity(got["velocity"], "map"))
    assert ground["z"][:2] == pytest.approx([0.0, 10.0 * 1852 / 3600], abs=1e-12) and np.isnan(ground["z"][2])
    log = read(readings.read_doppler, messages.body_velocity(got["log"], "doppler_link"))
    assert log["z"][:2] == pytest.approx(np.array([6.0, 2.0]) * 1852 / 3600) and np.isnan(log["z"][2]) and log["R"][0, 0] == pytest.approx(0.05**2)
    heading = messages.heading_pose(got["heading"], "map")
    heading["pose"]["pose"]["orientation"] |= {"x": 0.0, "y": 0.0}
    compass = read(readings.read_heading, heading)
    assert math.remainder(float(compass["z"][0]) - math.radians(300.0), 2 * math.pi) == pytest.approx(0.0, abs=1e-9)
    assert compass["stamp_ns"] == NOON and compass["R"][0, 0] == pytest.approx(math.radians(0.5) ** 2)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"inputs": ["udp://0.0.0.0:1"]}, "no aid names a sentence"),
        ({"heading": {"sentence": "THS"}}, '"inputs" is empty'),
        ({"talker": "I"}, "two capital letters"),
        ({"outputs": ["10.0.0.1:10110"]}, "\"outputs\": '10.0.0.1:10110' is no address; udp://HOST:PORT"),
        ({"inputs": ["udp://ship.example:1"]}, "\"inputs\": 'udp://ship.example:1': IPv4"),
        ({**EVERY, "position": {"sentence": "GLL"}}, "one of"),
        ({"rate_hz": {"gga": 20}}, "0 .. 10"),
    ],
)
def test_wrong_settings_are_one_line(values, message) -> None:
    with pytest.raises(SettingError, match=message) as error:
        build(NmeaConfig, values)
    assert "\n" not in str(error.value)
