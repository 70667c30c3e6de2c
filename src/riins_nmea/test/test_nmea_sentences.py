"""Sentences that go out, read back by a parser that is not ours (pynmea2) and by plain arithmetic, over drawn states.

Lives here: round trips, validity, codes, formats.
Does not live here: the node (test_nmea_node.py), what comes in (test_nmea_aids.py).
"""

from __future__ import annotations

import dataclasses
import math
import re

import numpy as np
import pynmea2
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from riins_core.frames import LocalFrame
from riins_core.rotation import dcm_from_euler
from riins_nmea.sentences import COASTING, INVALID, NAVIGATING, SENTENCES, Form, Picture, angle, latitude_field, longitude_field, number, picture, utc

DAY = 86_400_000_000_000
FORM = Form()
NOW = 1_700_000_000_250_000_000
LAYOUT = {"gga": 15, "vtg": 10, "ths": 3, "rot": 3, "pashr": 12, "vbw": 11}
"""Fields, the address with them, as the standard has them."""


def state(**changes):
    """A navigation state as `read_nav_state` gives it."""
    made = {
        "stamp_ns": NOW, "mode": NAVIGATING, "validity": (0, 0, 0), "lat": 0.9, "lon": 0.2, "h": 40.0, "v_n": np.array([3.0, -2.0, 0.1]),
        "rph": np.array([0.02, -0.01, 2.0]), "rate_b": np.array([0.01, -0.02, 0.005]), "sigma_rph": np.array([1e-4, 1e-4, 1e-3]),
    }  # fmt: skip
    return {**made, **changes}


def split(text: str) -> list[str]:
    """Fields of a sentence whose frame is right: $, checksum over what lies between, CR LF."""
    match = re.fullmatch(r"\$([^*$\r\n]+)\*([0-9A-F]{2})\r\n", text)
    assert match is not None, text
    assert np.bitwise_xor.reduce(np.frombuffer(match[1].encode("ascii"), np.uint8)) == int(match[2], 16)
    return match[1].split(",")


def degrees(text: str, hemisphere: str, width: int) -> float:
    """(d)ddmm.mmm as the standard defines it."""
    match = re.fullmatch(rf"(\d{{{width}}})(\d\d)(\.\d+)", text)
    assert match is not None and float(match[2] + match[3]) < 60.0
    return (int(match[1]) + float(match[2] + match[3]) / 60.0) * (-1.0 if hemisphere in "SW" else 1.0)


angles = st.floats(-math.pi, math.pi)
pictures = st.builds(
    Picture,
    stamp_ns=st.integers(0, 4 * 10**18),
    mode=st.sampled_from([NAVIGATING, COASTING]),
    validity=st.tuples(*[st.sampled_from([0, 1])] * 3),
    lat=st.floats(-math.pi / 2, math.pi / 2),
    lon=angles,
    h=st.floats(-100.0, 9000.0),
    v_n=st.tuples(*[st.floats(-50.0, 50.0)] * 3),
    rph=st.tuples(st.floats(-1.5, 1.5), st.floats(-1.5, 1.5), st.floats(0.0, 2 * math.pi)),
    heading_rate=st.floats(-0.5, 0.5),
    sigma_rph=st.tuples(*[st.floats(0.0, 3.0)] * 3),
    gnss=st.booleans(),
    heave=st.none() | st.floats(-20.0, 20.0),
    water=st.none() | st.tuples(st.floats(-20.0, 20.0), st.floats(-20.0, 20.0)),
)
EDGE = Picture(NOW, NAVIGATING, (0, 0, 0), gnss=True)


@settings(max_examples=60, deadline=None)
@given(pictures)
@example(dataclasses.replace(EDGE, lat=math.radians(-59.9999999999), lon=math.pi))
@example(dataclasses.replace(EDGE, lat=-0.0, lon=-math.pi, v_n=(-0.0, -0.0, -0.0), heave=-0.0, heading_rate=-1e-9))
@example(dataclasses.replace(EDGE, lat=-math.pi / 2, lon=-1e-12, rph=(-1e-9, -1e-9, math.radians(359.996)), stamp_ns=DAY - 1))
def test_every_sentence_comes_back(now: Picture) -> None:
    """What is read back is what went in, to half of the last digit; every field count and checksum is right; the length is that of the standard."""
    read = {name: split(make(now, FORM)) for name, make in SENTENCES.items()}
    assert {name: len(fields) for name, fields in read.items()} == LAYOUT
    for make in SENTENCES.values():
        assert len(make(now, FORM)) <= 82 and "nan" not in make(now, FORM) and not re.search(r",-0?\.?0*,", make(now, FORM))
        if make(now, FORM)[3:6] != "THS":  # pynmea2 does not know it
            pynmea2.parse(make(now, FORM), check=True)
    fix = pynmea2.parse(SENTENCES["gga"](now, FORM), check=True)
    assert fix.latitude == pytest.approx(math.degrees(now.lat), abs=0.51e-5 / 60)
    assert (fix.longitude - math.degrees(now.lon) + 180.0) % 360.0 - 180.0 == pytest.approx(0.0, abs=0.51e-5 / 60)
    assert degrees(read["gga"][2], read["gga"][3], 2) == pytest.approx(math.degrees(now.lat), abs=0.51e-5 / 60)
    assert degrees(read["gga"][4], read["gga"][5], 3) == pytest.approx(fix.longitude, abs=1e-9)
    assert float(fix.altitude) == pytest.approx(now.h, abs=0.0051)
    seconds = fix.timestamp.hour * 3600 + fix.timestamp.minute * 60 + fix.timestamp.second + fix.timestamp.microsecond * 1e-6
    assert (seconds - now.stamp_ns % DAY * 1e-9 + 43200.0) % 86400.0 - 43200.0 == pytest.approx(0.0, abs=0.0051)
    course = pynmea2.parse(SENTENCES["vtg"](now, FORM), check=True)
    speed = math.hypot(now.v_n[0], now.v_n[1])
    assert float(course.spd_over_grnd_kmph) == pytest.approx(3.6 * speed, abs=0.0051)
    assert float(course.spd_over_grnd_kts) == pytest.approx(speed * 3600.0 / 1852.0, abs=0.0051)
    assert (course.true_track is not None) == (speed >= 0.1)
    if course.true_track is not None:
        v = float(course.spd_over_grnd_kmph) / 3.6 * np.exp(1j * math.radians(course.true_track))
        assert abs(v - complex(now.v_n[0], now.v_n[1])) < 0.003 + 1e-4 * speed
        assert 0.0 <= course.true_track < 360.0
    heading = float(read["ths"][1])
    assert 0.0 <= heading < 360.0 and (heading - math.degrees(now.rph[2]) + 180.0) % 360.0 - 180.0 == pytest.approx(0.0, abs=0.0051)
    assert float(read["rot"][1]) == pytest.approx(math.degrees(now.heading_rate) * 60.0, abs=0.051)
    tilt = pynmea2.parse(SENTENCES["pashr"](now, FORM), check=True)
    assert (tilt.roll, tilt.pitch) == pytest.approx(np.degrees(now.rph[:2]), abs=0.0051)
    assert tilt.true_heading == heading and tilt.is_true_heading == "T" and re.fullmatch(r"\d{3}\.\d\d", read["pashr"][2])
    assert all(re.fullmatch(r"[+-]\d+\.\d\d", field) for field in read["pashr"][4:6])
    assert (tilt.heave is None) == (now.heave is None) and (now.heave is None or tilt.heave == pytest.approx(now.heave, abs=0.0051))
    assert tilt.roll_accuracy == pytest.approx(min(math.degrees(now.sigma_rph[0]), 99.999), abs=0.00051)
    speeds = pynmea2.parse(SENTENCES["vbw"](now, FORM), check=True)
    assert speeds.data_validity_water_spd == ("A" if now.water is not None else "V")
    if now.water is not None:
        assert (float(speeds.lon_water_spd), float(speeds.trans_water_spd)) == pytest.approx(np.array(now.water) * 3600 / 1852, abs=0.0051)
    assert speeds.data_validity_grnd_spd == ("A" if now.validity[1] == 0 else "V")
    if now.validity[1] == 0:
        made = complex(float(speeds.lon_grnd_spd), float(speeds.trans_grnd_spd)) * np.exp(1j * now.rph[2]) * 1852 / 3600
        assert abs(made - complex(now.v_n[0], now.v_n[1])) < 0.004


def test_bow_to_port_is_negative_and_starboard_positive() -> None:
    """Signs by the definitions: a turn to port, a drift to starboard, starboard down, bow up."""
    now = dataclasses.replace(EDGE, rph=(0.1, 0.2, 0.0), heading_rate=-0.01, v_n=(5.0, 1.0, 0.0), heave=1.5)
    read = {name: split(make(now, FORM)) for name, make in SENTENCES.items()}
    assert float(read["rot"][1]) < 0.0 and float(read["vbw"][5]) > 0.0 and float(read["vbw"][4]) > 0.0
    assert [read["pashr"][i][0] for i in (4, 5, 6)] == ["+", "+", "+"]


@pytest.mark.parametrize("mode", [0, 1])
@pytest.mark.parametrize("form", [FORM, Form(simulator=True), Form(pashr_codes="flags")])
def test_without_navigation_no_number_leaves(mode: int, form: Form) -> None:
    """However good the numbers look, without a solution every sentence says invalid and holds none."""
    good = dataclasses.replace(picture(state(mode=mode), (0.0, 0.0, 0.0), True, 1.0), aligning=mode)
    read = {name: split(make(good, form)) for name, make in SENTENCES.items()}
    assert read["gga"][2:] == ["", "", "", "", "0", *[""] * 8] and read["vtg"][1:] == ["", "T", "", "M", "", "N", "", "K", "N"]
    assert read["ths"][1:] == ["", "V"] and read["rot"][1:] == ["", "V"] and read["vbw"][1:] == ["", "", "V", "", "", "V", "", "V", "", "V"]
    assert read["pashr"][2:10] == ["", "T", *[""] * 6] and read["pashr"][10] == "0"
    assert read["pashr"][11] == ("0" if form.pashr_codes == "flags" else str(mode))


@pytest.mark.parametrize(
    ("mode", "validity", "gnss", "simulator", "codes"),
    [
        (NAVIGATING, (0, 0, 0), True, False, ("1", "A", "A", "A", "A", "1", "4")),
        (NAVIGATING, (0, 0, 0), False, False, ("6", "E", "A", "A", "A", "6", "4")),  # on the log alone
        (COASTING, (0, 0, 0), True, False, ("6", "E", "A", "A", "A", "6", "2")),
        (NAVIGATING, (1, 1, 1), True, False, ("6", "E", "E", "A", "V", "6", "3")),
        (NAVIGATING, (2, 0, 0), True, False, ("0", "A", "A", "A", "A", "0", "4")),
        (NAVIGATING, (0, 2, 0), True, False, ("1", "N", "A", "A", "V", "1", "4")),
        (NAVIGATING, (0, 0, 2), True, False, ("1", "A", "V", "A", "V", "1", "3")),
        (NAVIGATING, (0, 0, 0), True, True, ("8", "S", "S", "A", "A", "8", "4")),
        (NAVIGATING, (2, 2, 2), True, True, ("0", "N", "V", "A", "V", "0", "3")),
    ],
)
def test_validity_in_the_fields_of_the_standard(mode, validity, gnss, simulator, codes) -> None:
    """GGA quality, VTG mode, THS mode, ROT status, VBW ground status, PASHR quality and alignment."""
    now = picture(state(mode=mode, validity=validity), (0.0, 0.0, 0.0), gnss)
    read = {name: split(make(now, Form(simulator=simulator))) for name, make in SENTENCES.items()}
    assert (read["gga"][6], read["vtg"][9], read["ths"][2], read["rot"][2], read["vbw"][6], *read["pashr"][10:]) == codes
    flags = split(SENTENCES["pashr"](now, Form(pashr_codes="flags")))[10:]
    assert flags == [str(int(gnss and mode == NAVIGATING)), "1"]


@pytest.mark.parametrize("name", ["lat", "h", "v_n", "rph", "rate_b"])
def test_what_is_not_finite_is_invalid(name: str) -> None:
    bad = np.full(3, np.nan) if name in ("v_n", "rph", "rate_b") else math.nan
    now = picture(state(**{name: bad}), (1.0, 2.0, 3.0), True, math.nan)
    text = "".join(make(now, FORM) for make in SENTENCES.values())
    assert "nan" not in text.lower() and (now.valid(0) == INVALID or name == "v_n")


@settings(max_examples=40, deadline=None)
@given(angles, st.floats(-0.5, 0.5), st.floats(0.0, 6.28), st.tuples(*[st.floats(-80.0, 80.0)] * 3), st.tuples(*[st.floats(-0.3, 0.3)] * 3))
def test_reference_point_moves_position_and_velocity(lon, roll, heading, point, rate) -> None:
    """Against the exact plane of riins_core: position by the arm, velocity by rotation."""
    given_state = state(lon=lon, rph=np.array([roll, 0.3, heading]), rate_b=np.array(rate))
    now = picture(given_state, point, True)
    C = dcm_from_euler(roll, 0.3, heading)
    arm = C @ np.array(point)
    moved = LocalFrame(given_state["lat"], lon, given_state["h"]).to_enu(now.lat, now.lon, now.h)
    np.testing.assert_allclose(moved, [arm[1], arm[0], -arm[2]], atol=2e-3)  # curvature over 140 m
    np.testing.assert_allclose(now.v_n, given_state["v_n"] + C @ np.cross(rate, point), atol=1e-12)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10**19), st.integers(1, 3))
def test_time_of_day_is_the_nearest_and_never_sixty(stamp: int, decimals: int) -> None:
    text = utc(stamp, decimals)
    assert re.fullmatch(rf"([01]\d|2[0-3])[0-5]\d[0-5]\d\.\d{{{decimals}}}", text)
    seconds = int(text[:2]) * 3600 + int(text[2:4]) * 60 + float(text[4:])
    assert (seconds - stamp % DAY * 1e-9 + 43200.0) % 86400.0 - 43200.0 == pytest.approx(0.0, abs=0.5001 * 10.0**-decimals)


def test_formats_at_their_edges() -> None:
    """Carry of 59.99999 minutes, 360 degrees, minus zero, midnight."""
    assert latitude_field(math.radians(54.0 + 59.999996 / 60.0), 5) == ("5500.00000", "N")
    assert latitude_field(math.radians(-54.0 - 59.999994 / 60.0), 5) == ("5459.99999", "S")
    assert longitude_field(math.radians(-179.99999999), 5) == ("18000.00000", "W") and longitude_field(math.radians(181.0), 3) == ("17900.000", "W")
    assert latitude_field(-1e-12, 5) == ("0000.00000", "N") and longitude_field(-0.0, 5) == ("00000.00000", "E")
    assert angle(math.radians(359.996), 2) == "0.00" and angle(math.radians(359.99), 2) == "359.99" and angle(-1e-12, 2) == "0.00"
    assert number(-0.004, 2) == "0.00" and number(-0.006, 2) == "-0.01" and number(math.inf, 2) == ""
    assert utc(DAY - 4_000_000, 2) == "000000.00" and utc(DAY - 6_000_000, 2) == "235959.99"
