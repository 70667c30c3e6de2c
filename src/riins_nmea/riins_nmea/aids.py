"""Sentences that come in, as measurements: each accepted, or rejected and counted under its reason.

Lives here: `Lines` (bytes to lines), `AidReader` (a line to a `Reading`), `REASONS`.
Does not live here: sockets and serial lines (links.py), messages (messages.py). What a field means is left to pynmeagps.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from datetime import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .config import NmeaConfig
from .sentences import KNOT

Array = NDArray[np.float64]

REASONS = ("checksum", "malformed", "not valid", "stale", "repeated", "too long")
"""Why a sentence was rejected; `unused` ones are counted too, which is no fault."""
FIXES = (1, 2, 3, 4, 5, 9)
"""Qualities of GGA that are a satellite fix; 6 estimated, 7 manual and 8 simulated must not be taken for one."""
_LONGEST = 1024
_QUIET_CALLS = 5
_DAY_NS = 86_400_000_000_000
_HEADER = re.compile(r"\$(P|[A-Z]{2})([A-Z0-9]{3,})[,*]")


@dataclass(frozen=True)
class Reading:
    """A measurement.

    Attributes
    ----------
    aid : position, velocity, log, water_log or heading
    stamp_ns : time of validity
    z : latitude, longitude [rad], height above the ellipsoid [m]; or velocity NED or FRD, the third NaN where not measured [m/s]; or heading [rad]
    sigma : 1-sigma of each
    ok : False: the receiver says that it has no fix (`z` is NaN)
    talker : of the sentence
    """

    aid: str
    stamp_ns: int
    z: Array
    sigma: Array
    ok: bool = True
    talker: str = ""


class Lines:
    """Bytes to lines; what has no line end for too long is dropped and counted by the caller."""

    def __init__(self) -> None:
        self._rest = b""
        self.too_long = 0

    def feed(self, data: bytes, end: bool) -> list[bytes]:
        """Whole lines; `end`: a datagram ends here, and with it the line."""
        *lines, self._rest = re.split(b"[\r\n]+", self._rest + data)
        if end:
            lines.append(self._rest)
            self._rest = b""
        if len(self._rest) > _LONGEST:
            self._rest = b""
            self.too_long += 1
        return [line for line in lines if line]


class AidReader:
    """Reads lines as the aids that are configured.

    Parameters
    ----------
    config : NmeaConfig

    Attributes
    ----------
    accepted : readings by aid
    rejected : lines by (sentence, reason); the sentence is "" where it could not be told
    unused : lines no aid wanted
    wanted : sentence by aid

    Raises
    ------
    ImportError
        pynmeagps is missing.
    """

    def __init__(self, config: NmeaConfig) -> None:
        from pynmeagps import NMEAReader, nmeahelpers

        self._parse, self._checksum = NMEAReader.parse, nmeahelpers.calc_checksum
        self._config = config
        self.wanted = config.wanted
        self._last: dict[str, int] = {}
        self._told: dict[str, tuple[int, int, int]] = {}
        self.accepted: Counter[str] = Counter()
        self.rejected: Counter[tuple[str, str]] = Counter()
        self.unused = 0

    def read(self, line: bytes, arrival_ns: int) -> list[Reading]:
        """Take one line.

        Parameters
        ----------
        line : without its end; what stands before the last `$` (a tag block, half a sentence) is skipped
        arrival_ns : the clock when it came

        Returns
        -------
        readings, none when it was rejected or is of no use
        """
        if len(line) > _LONGEST:
            return self._reject("", "too long")
        start = line.rfind(b"$")
        if start < 0:
            if line.startswith(b"!"):  # an encapsulated sentence, AIS
                self.unused += 1
                return []
            return self._reject("", "malformed")
        text = line[start:].decode("ascii", "replace").strip()
        header = _HEADER.match(text)
        if header is None:
            return self._reject("", "malformed")
        talker, kind = header.groups()
        content, star, checksum = text[1:].rpartition("*")
        if not star or checksum.upper() != self._checksum(content):
            return self._reject(kind if kind in self.wanted.values() else "", "checksum")
        aids = [aid for aid, sentence in self.wanted.items() if sentence == kind and getattr(self._config, aid).talker in ("", talker)]
        if not aids:
            self.unused += 1
            return []
        try:
            parsed = self._parse(text.encode("ascii"))
        except Exception:  # whatever a line from outside does to the parser, it is counted and the node goes on
            return self._reject(kind, "malformed")
        readings: list[Reading] = []
        for aid in aids:
            readings += self._judge(aid, kind, talker, parsed, arrival_ns)
        return readings

    def news(self, aid: str, sentence: str) -> str:
        """What has happened to an aid in the last calls: "" something accepted, "rejected" only rejections, "silent" nothing in five of them."""
        bad = sum(number for (kind, _), number in self.rejected.items() if kind == sentence)
        good_before, bad_before, quiet = self._told.get(aid, (0, 0, 0))
        quiet = 0 if self.accepted[aid] > good_before else quiet + 1
        self._told[aid] = (self.accepted[aid], bad, quiet)
        if quiet and bad > bad_before:
            return "rejected"
        return "silent" if quiet >= _QUIET_CALLS else ""

    def _judge(self, aid: str, kind: str, talker: str, parsed: Any, arrival_ns: int) -> list[Reading]:
        settings = getattr(self._config, aid)
        stamp = arrival_ns - round(settings.delay_s * 1e9)
        timed = getattr(settings, "stamp", "arrival") == "sentence"
        if timed:
            of_day = getattr(parsed, "time", None)
            if not isinstance(of_day, time):
                return self._reject(kind, "not valid" if _says_invalid(kind, parsed) else "malformed")
            stamp = nearest_day(of_day, arrival_ns)
            if abs(stamp - arrival_ns) > self._config.max_age_s * 1e9:
                return self._reject(kind, "stale")
        try:
            reading = _READERS[aid](parsed, stamp, talker, self._config)
        except (AttributeError, TypeError, ValueError):
            return self._reject(kind, "malformed")
        if reading is None:
            return self._reject(kind, "not valid")
        if timed and stamp <= self._last.get(aid, stamp - 1) <= stamp + _DAY_NS // 2:
            return self._reject(kind, "repeated")
        self._last[aid] = stamp
        if reading.ok:
            self.accepted[aid] += 1
        else:
            self._reject(kind, "not valid")
        return [reading]

    def _reject(self, kind: str, reason: str) -> list[Reading]:
        self.rejected[kind, reason] += 1
        return []


def nearest_day(of_day: time, arrival_ns: int) -> int:
    """Stamp [ns] with this UTC time of day that is nearest to the arrival: midnight may lie between the two, either way."""
    since_midnight = ((of_day.hour * 60 + of_day.minute) * 60 + of_day.second) * 1_000_000_000 + of_day.microsecond * 1000
    day = (arrival_ns - since_midnight + _DAY_NS // 2) // _DAY_NS
    return day * _DAY_NS + since_midnight


def _says_invalid(kind: str, parsed: Any) -> bool:
    return getattr(parsed, "quality", None) == 0 if kind == "GGA" else getattr(parsed, "status", None) == "V"


def _number(value: Any, low: float, high: float) -> float:
    """A number within limits; ValueError for anything else (an empty field is '')."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
        raise ValueError(f"{value!r}")
    return float(value)


def _minutes(field: str) -> None:
    """ValueError unless (d)ddmm.mmm has minutes below 60, which pynmeagps does not look at."""
    _number(float(field[field.index(".") - 2 :]), 0.0, math.nextafter(60.0, 0.0))


def _position(parsed: Any, stamp: int, talker: str, config: NmeaConfig) -> Reading | None:
    sigma = np.array([config.position.sigma_m, config.position.sigma_m, config.position.sigma_height_m])
    fix, hdop, height = _rmc_valid(parsed) if config.position.sentence == "RMC" else parsed.quality in FIXES, 1.0, config.geoid_separation_m
    if not fix:
        return Reading("position", stamp, np.full(3, math.nan), sigma, False, talker)
    lat, lon = _number(parsed.lat, -90.0, 90.0), _number(parsed.lon, -180.0, 180.0)
    if parsed.NS not in ("N", "S") or parsed.EW not in ("E", "W"):
        raise ValueError("hemisphere")
    for hemisphere in (parsed.NS, parsed.EW):
        _minutes(parsed.payload[parsed.payload.index(hemisphere) - 1])
    if config.position.sentence == "GGA":
        hdop = _number(parsed.HDOP, 0.0, 100.0) if parsed.HDOP != "" else 1.0
        hdop = hdop if hdop > 0.0 else 1.0  # some receivers write 0 for unknown
        separation = _number(parsed.sep, -200.0, 200.0) if parsed.sep != "" else config.geoid_separation_m
        height = _number(parsed.alt, -1e4, 1e5) + separation if parsed.alt != "" else separation
    return Reading("position", stamp, np.array([math.radians(lat), math.radians(lon), height]), sigma * hdop, True, talker)


def _velocity(parsed: Any, stamp: int, talker: str, config: NmeaConfig) -> Reading | None:
    if not _rmc_valid(parsed):
        return None
    speed = _number(parsed.spd, 0.0, 2000.0) * KNOT
    course = math.radians(_number(parsed.cog, 0.0, 360.0)) if parsed.cog != "" or speed > 0.0 else 0.0
    z = np.array([speed * math.cos(course), speed * math.sin(course), math.nan])
    return Reading("velocity", stamp, z, np.full(3, config.velocity.sigma_mps), True, talker)


def _log(parsed: Any, stamp: int, talker: str, config: NmeaConfig) -> Reading | None:
    return _speeds("log", parsed.longgroundspd, parsed.transgroundspd, parsed.groundspdstatus, stamp, config.log.sigma_mps, talker)


def _water_log(parsed: Any, stamp: int, talker: str, config: NmeaConfig) -> Reading | None:
    return _speeds("water_log", parsed.longwaterspd, parsed.transwaterspd, parsed.waterspdstatus, stamp, config.water_log.sigma_mps, talker)


def _speeds(aid: str, along: Any, across: Any, status: Any, stamp: int, sigma: float, talker: str) -> Reading | None:
    if status != "A":
        return None
    z = np.array([_number(along, -200.0, 200.0) * KNOT, _number(across, -200.0, 200.0) * KNOT, math.nan])
    return Reading(aid, stamp, z, np.full(3, sigma), True, talker)


def _heading(parsed: Any, stamp: int, talker: str, config: NmeaConfig) -> Reading | None:
    if config.heading.sentence == "THS":
        if parsed.mi != "A":  # estimated, manual and simulated headings are no measurement
            return None
        degrees = parsed.headt
    else:
        degrees = parsed.headingT
        if degrees == "":
            return None
    z = np.array([math.radians(_number(degrees, 0.0, 360.0))])
    return Reading("heading", stamp, z, np.array([math.radians(config.heading.sigma_deg)]), True, talker)


def _rmc_valid(parsed: Any) -> bool:
    """Status A and, where the receiver says it (since NMEA 2.3), a mode that is a satellite fix."""
    return parsed.status == "A" and getattr(parsed, "posMode", "A") in ("", "A", "D", "F", "P", "R")


_READERS: dict[str, Callable[[Any, int, str, NmeaConfig], Reading | None]] = {
    "position": _position, "velocity": _velocity, "log": _log, "water_log": _water_log, "heading": _heading,
}  # fmt: skip
