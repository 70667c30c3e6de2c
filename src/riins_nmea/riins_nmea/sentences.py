"""NMEA 0183 sentences of the navigation state: pure functions, text out; what is not valid says so and carries no number.

Lives here: `Picture` (what the bridge may know at a time), one function a sentence, `SENTENCES`, number and angle formats.
Does not live here: when a sentence is due (schedule.py), where it goes (links.py). pynmeagps writes 60.00000 minutes and as many decimals as a
float has, so numbers are written here, in whole units of their last digit.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from riins_core.earth import radii

WAITING, NAVIGATING, COASTING = 0, 2, 3
VALID, DOUBTFUL, INVALID = 0, 1, 2
NO_FIX, AUTONOMOUS, ESTIMATED, SIMULATOR = 0, 1, 6, 8
"""Quality field of GGA."""
KNOT = 1852.0 / 3600.0
_DAY_NS = 86_400_000_000_000


@dataclass(frozen=True)
class Form:
    """How sentences are written; see NmeaConfig for the meaning of each."""

    talker: str = "IN"
    minute_decimals: int = 5
    geoid_separation_m: float = 0.0
    course_speed_mps: float = 0.1
    pashr_codes: str = "alignment"
    simulator: bool = False


@dataclass(frozen=True)
class Picture:
    """What is known at `stamp_ns`, of the reference point; angles rad, FRD and NED, as `readings.read_nav_state` has them.

    `validity` is of position, velocity, heading; `gnss`: a GNSS position is being fused; `heave` [m, up] and `water` (forward, starboard) [m/s]
    are None where unknown; `aligning`: alignment code 0..2 while there is no solution.
    """

    stamp_ns: int
    mode: int = WAITING
    validity: tuple[int, int, int] = (INVALID, INVALID, INVALID)
    lat: float = 0.0
    lon: float = 0.0
    h: float = 0.0
    v_n: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rph: tuple[float, float, float] = (0.0, 0.0, 0.0)
    heading_rate: float = 0.0
    sigma_rph: tuple[float, float, float] = (0.0, 0.0, 0.0)
    gnss: bool = False
    heave: float | None = None
    water: tuple[float, float] | None = None
    aligning: int = 0

    @property
    def navigating(self) -> bool:
        """There is a navigation solution."""
        return self.mode in (NAVIGATING, COASTING)

    def valid(self, which: int) -> int:
        """Validity of position (0), velocity (1), heading (2); invalid without a solution."""
        return self.validity[which] if self.navigating else INVALID


def picture(
    state: Mapping[str, Any],
    point: tuple[float, ...],
    gnss: bool,
    heave: float | None = None,
    water: tuple[float, float] | None = None,
) -> Picture:
    """Picture of a navigation state at a point of the ship.

    Parameters
    ----------
    state : as `riins_node.readings.read_nav_state` gives it
    point : (3,), from base_link, FRD, m
    gnss, heave, water : as in Picture

    Returns
    -------
    Picture; one that says INVALID where a number is not finite
    """
    roll, pitch, heading = (float(angle) for angle in state["rph"])
    p, q, r = (float(one) for one in state["rate_b"])
    cr, sr, cp, sp, ch, sh = math.cos(roll), math.sin(roll), math.cos(pitch), math.sin(pitch), math.cos(heading), math.sin(heading)
    C = np.array([
        [cp * ch, sr * sp * ch - cr * sh, cr * sp * ch + sr * sh],
        [cp * sh, sr * sp * sh + cr * ch, cr * sp * sh - sr * ch],
        [-sp, sr * cp, cr * cp],
    ])  # fmt: skip
    arm = np.asarray(point, np.float64)
    offset, extra = C @ arm, C @ np.cross([p, q, r], arm)
    lat, lon, h = float(state["lat"]), float(state["lon"]), float(state["h"])
    if offset.any():
        meridian, normal = (float(one) for one in radii(lat))
        lat, lon, h = lat + offset[0] / (meridian + h), lon + offset[1] / ((normal + h) * math.cos(lat)), h - offset[2]
    v = np.asarray(state["v_n"], np.float64) + extra
    rate = (q * sr + r * cr) / cp
    validity = tuple(int(one) for one in state["validity"])
    finite = [math.isfinite(lat + lon + h), bool(np.isfinite(v).all()), math.isfinite(roll + pitch + heading + rate)]
    checked = [one if good else INVALID for one, good in zip(validity, finite, strict=True)]
    return Picture(
        int(state["stamp_ns"]),
        int(state["mode"]) if finite[2] else WAITING,
        (checked[0], checked[1], checked[2]),
        lat, lon, h, (float(v[0]), float(v[1]), float(v[2])), (roll, pitch, heading), rate,
        (float(state["sigma_rph"][0]), float(state["sigma_rph"][1]), float(state["sigma_rph"][2])),
        gnss, heave, water,
    )  # fmt: skip


# ---- sentences ----


def gga(now: Picture, form: Form) -> str:
    """Position: quality 1 while a GNSS fix is fused, 6 for dead reckoning or a doubtful position, 0 and no position when invalid, 8 simulated."""
    code = quality(now, form)
    if code == NO_FIX:
        return sentence(f"{form.talker}GGA", utc(now.stamp_ns, 2), "", "", "", "", "0", *[""] * 8)
    latitude, longitude = latitude_field(now.lat, form.minute_decimals), longitude_field(now.lon, form.minute_decimals)
    height = number(now.h - form.geoid_separation_m, 2), "M", number(form.geoid_separation_m, 2), "M"
    # a navigator has neither satellites nor a dilution of its own: null fields
    return sentence(f"{form.talker}GGA", utc(now.stamp_ns, 2), *latitude, *longitude, str(code), "", "", *height, "", "")


def vtg(now: Picture, form: Form) -> str:
    """Course and speed over ground: mode A, E for dead reckoning or doubtful, N and no numbers when invalid, S simulated."""
    mode = _mode(now, form, now.valid(1), "N")
    if mode == "N":
        return sentence(f"{form.talker}VTG", "", "T", "", "M", "", "N", "", "K", "N")
    speed = math.hypot(now.v_n[0], now.v_n[1])
    course = angle(math.atan2(now.v_n[1], now.v_n[0]), 2) if speed >= form.course_speed_mps else ""
    return sentence(f"{form.talker}VTG", course, "T", "", "M", number(speed / KNOT, 2), "N", number(3.6 * speed, 2), "K", mode)


def ths(now: Picture, form: Form) -> str:
    """True heading: mode A when valid, E when doubtful, V and no heading when invalid, S simulated."""
    validity = now.valid(2)
    if validity == INVALID:
        return sentence(f"{form.talker}THS", "", "V")
    return sentence(f"{form.talker}THS", angle(now.rph[2], 2), "S" if form.simulator else "A" if validity == VALID else "E")


def rot(now: Picture, form: Form) -> str:
    """Rate of turn, deg/min, minus: bow to port; status A with a navigation solution, else V."""
    if not now.navigating:
        return sentence(f"{form.talker}ROT", "", "V")
    return sentence(f"{form.talker}ROT", number(math.degrees(now.heading_rate) * 60.0, 1), "A")


def pashr(now: Picture, form: Form) -> str:
    """Heading, roll, pitch [deg], heave [m, up], sigmas of roll, pitch, heading [deg], then the two codes.

    Notes
    -----
    Codes `alignment`, as in the RT300 sentence: GNSS quality as in GGA (0, 1, 6; 8 simulated), and that of riins_msgs/AlignmentStatus: 0 no
    attitude, 1 coarse levelling, 2 degraded (attitude being refined, or nothing but inertial), 3 aligned, 4 full navigation: heading valid.
    Codes `flags`, as position and orientation systems for ships have them: GNSS aiding 0/1 and IMU 0/1.
    """
    heading_known, tilt_known = now.valid(2) != INVALID, now.navigating
    heading = angle(now.rph[2], 2).zfill(6) if heading_known else ""
    tilts = [signed(math.degrees(one), 2) if tilt_known else "" for one in now.rph[:2]]
    heave = signed(now.heave, 2) if tilt_known and now.heave is not None else ""
    known = (tilt_known, tilt_known, heading_known)
    sigmas = [number(min(math.degrees(one), 99.999), 3) if good else "" for one, good in zip(now.sigma_rph, known, strict=True)]
    codes = (quality(now, form), alignment(now))
    if form.pashr_codes == "flags":
        codes = (int(now.gnss and now.mode == NAVIGATING), int(now.navigating))
    return sentence("PASHR", utc(now.stamp_ns, 3), heading, "T", *tilts, heave, *sigmas, *map(str, codes))


def vbw(now: Picture, form: Form) -> str:
    """Speeds through the water and over ground along and across the ship, kn, forward and starboard positive; A when valid, else V and no number."""
    water = (number(now.water[0] / KNOT, 2), number(now.water[1] / KNOT, 2), "A") if now.water is not None else ("", "", "V")
    ground = ("", "", "V")
    if now.valid(1) == VALID and now.valid(2) != INVALID:
        cosine, sine = math.cos(now.rph[2]), math.sin(now.rph[2])
        along, across = now.v_n[0] * cosine + now.v_n[1] * sine, now.v_n[1] * cosine - now.v_n[0] * sine
        ground = (number(along / KNOT, 2), number(across / KNOT, 2), "A")
    return sentence(f"{form.talker}VBW", *water, *ground, "", "V", "", "V")


SENTENCES: dict[str, Callable[[Picture, Form], str]] = {"gga": gga, "vtg": vtg, "ths": ths, "rot": rot, "pashr": pashr, "vbw": vbw}
"""By the name of their rate."""


# ---- codes ----


def quality(now: Picture, form: Form) -> int:
    """Quality field of GGA."""
    validity = now.valid(0)
    if validity == INVALID:
        return NO_FIX
    if form.simulator:
        return SIMULATOR
    return AUTONOMOUS if validity == VALID and now.mode == NAVIGATING and now.gnss else ESTIMATED


def alignment(now: Picture) -> int:
    """Alignment code of PASHR, see `pashr`."""
    if not now.navigating:
        return now.aligning
    if now.mode == COASTING:
        return 2
    return 4 if now.validity[2] == VALID else 3


def _mode(now: Picture, form: Form, validity: int, invalid: str) -> str:
    if validity == INVALID:
        return invalid
    if form.simulator:
        return "S"
    return "A" if validity == VALID and now.mode == NAVIGATING and now.gnss else "E"


# ---- formats ----


def sentence(address: str, *fields: str) -> str:
    """`$ADDRESS,field,...*hh` with CR and LF; the checksum is the exclusive or of what stands between $ and *."""
    content = ",".join((address, *fields))
    checksum = 0
    for byte in content.encode("ascii"):
        checksum ^= byte
    return f"${content}*{checksum:02X}\r\n"


def number(value: float, decimals: int) -> str:
    """Fixed decimals; never a negative zero; empty when not finite."""
    if not math.isfinite(value):
        return ""
    text = f"{value:.{decimals}f}"
    return text.removeprefix("-") if not text.strip("-0.") else text


def signed(value: float, decimals: int) -> str:
    """As `number`, with the sign always there."""
    text = number(value, decimals)
    return text if not text or text.startswith("-") else f"+{text}"


def angle(radians: float, decimals: int) -> str:
    """Degrees 0 .. 360, 360 excluded also after rounding."""
    text = number(math.degrees(radians) % 360.0, decimals)
    return number(0.0, decimals) if text.startswith("360") else text


def utc(stamp_ns: int, decimals: int) -> str:
    """Time of day hhmmss.ss; 23:59:59.999 becomes 000000.00."""
    unit = 10 ** (9 - decimals)
    ticks = (stamp_ns + unit // 2) // unit % (_DAY_NS // unit)
    seconds, fraction = divmod(ticks, 10**decimals)
    minutes, second = divmod(seconds, 60)
    hour, minute = divmod(minutes, 60)
    return f"{hour:02d}{minute:02d}{second:02d}.{fraction:0{decimals}d}"


def latitude_field(lat: float, decimals: int) -> tuple[str, str]:
    """ddmm.mmmmm and N or S of radians."""
    text, negative = _degrees_minutes(min(max(math.degrees(lat), -90.0), 90.0), decimals, 2)
    return text, "S" if negative else "N"


def longitude_field(lon: float, decimals: int) -> tuple[str, str]:
    """dddmm.mmmmm and E or W of radians, -180 .. 180 after wrapping."""
    degrees = math.degrees(lon)
    if abs(degrees) > 180.0:
        degrees = (degrees + 180.0) % 360.0 - 180.0
    text, negative = _degrees_minutes(degrees, decimals, 3)
    return text, "W" if negative else "E"


def _degrees_minutes(degrees: float, decimals: int, width: int) -> tuple[str, bool]:
    units = round(abs(degrees) * 60.0 * 10**decimals)  # whole units of the last digit: minutes that round up to 60 carry over
    minutes, fraction = divmod(units, 10**decimals)
    whole, minute = divmod(minutes, 60)
    return f"{whole:0{width}d}{minute:02d}.{fraction:0{decimals}d}", degrees < 0.0 and units > 0
