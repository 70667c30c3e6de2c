"""Parameters of the node `nmea`: what goes out how often and where to, what comes in as which aid.

Lives here: `NmeaConfig` and its sections.
Does not live here: what a sentence holds (sentences.py), how an incoming one is judged (aids.py), addresses (links.py).
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from riins_core.settings import SettingError, section, setting

from .links import parse_link


@dataclass(frozen=True)
class Rates:
    """How often each sentence goes out; 0: not at all."""

    gga: int = setting(1, "position", "Hz", 0, 10)
    vtg: int = setting(1, "course and speed over ground", "Hz", 0, 10)
    ths: int = setting(10, "true heading and its mode", "Hz", 0, 10)
    rot: int = setting(10, "rate of turn", "Hz", 0, 10)
    pashr: int = setting(10, "attitude, heave and their accuracy", "Hz", 0, 10)
    vbw: int = setting(1, "speed along and across the ship, over ground and through the water", "Hz", 0, 10)


@dataclass(frozen=True)
class PositionIn:
    """A receiver's position as sensor_msgs/NavSatFix."""

    sentence: str = setting("", "the sentence it comes in; empty: not used", choices=("", "GGA", "RMC"))
    talker: str = setting("", "take it from this talker alone; empty: any")
    topic: str = setting("gps/fix", "where it is published")
    frame_id: str = setting("gps_link", "frame of the antenna")
    sigma_m: float = setting(3.0, "sigma of each horizontal axis at HDOP 1; it grows with the HDOP of GGA", "m", 1e-3, 1e4)
    sigma_height_m: float = setting(6.0, "sigma of the height at HDOP 1", "m", 1e-3, 1e4)
    stamp: str = setting("sentence", "time of validity: the sentence's UTC, or its arrival less delay_s", choices=("sentence", "arrival"))
    delay_s: float = setting(0.0, "age of the data at arrival, where the stamp is the arrival's", "s", 0.0, 10.0)


@dataclass(frozen=True)
class VelocityIn:
    """A receiver's velocity over ground as geometry_msgs/TwistWithCovarianceStamped, ENU."""

    sentence: str = setting("", "the sentence it comes in; empty: not used", choices=("", "RMC"))
    talker: str = setting("", "take it from this talker alone; empty: any")
    topic: str = setting("gps/velocity", "where it is published")
    sigma_mps: float = setting(0.1, "sigma of each horizontal axis", "m/s", 1e-4, 100.0)
    stamp: str = setting("sentence", "time of validity: the sentence's UTC, or its arrival less delay_s", choices=("sentence", "arrival"))
    delay_s: float = setting(0.0, "age of the data at arrival, where the stamp is the arrival's", "s", 0.0, 10.0)


@dataclass(frozen=True)
class LogIn:
    """A Doppler log over ground as geometry_msgs/TwistWithCovarianceStamped, FLU; VBW carries no time, so the stamp is its arrival less delay_s."""

    sentence: str = setting("", "the sentence it comes in; empty: not used", choices=("", "VBW"))
    talker: str = setting("", "take it from this talker alone; empty: any")
    topic: str = setting("doppler/velocity", "where it is published")
    frame_id: str = setting("doppler_link", "frame of the transducer")
    sigma_mps: float = setting(0.05, "sigma of each axis", "m/s", 1e-4, 100.0)
    delay_s: float = setting(0.0, "age of the data at arrival", "s", 0.0, 10.0)


@dataclass(frozen=True)
class WaterLogIn(LogIn):
    """The same log's speed through the water."""

    topic: str = setting("doppler/water_velocity", "where it is published")


@dataclass(frozen=True)
class HeadingIn:
    """A gyrocompass as geometry_msgs/PoseWithCovarianceStamped; no time in it, so the stamp is its arrival less delay_s."""

    sentence: str = setting("", "the sentence it comes in (THS says whether it is valid, HDT does not); empty: not used", choices=("", "THS", "HDT"))
    talker: str = setting("", "take it from this talker alone; empty: any")
    topic: str = setting("compass/heading", "where it is published")
    sigma_deg: float = setting(0.5, "sigma", "deg", 1e-4, 90.0)
    delay_s: float = setting(0.0, "age of the data at arrival", "s", 0.0, 10.0)


@dataclass(frozen=True)
class NmeaConfig:
    """Everything the node needs to know before it starts."""

    outputs: tuple[str, ...] = setting((), "where sentences go: udp://HOST:PORT (unicast, broadcast or multicast), serial:///dev/ttyUSB0?baud=38400")
    inputs: tuple[str, ...] = setting((), "where sentences come from: udp://0.0.0.0:PORT, udp://GROUP:PORT, serial:///dev/ttyUSB1?baud=4800")
    talker: str = setting("IN", "talker identifier of what goes out: two capital letters; IN is an integrated navigation system")
    rate_hz: Rates = section(Rates, "how often each sentence goes out, by measurement time")
    minute_decimals: int = setting(5, "decimals of the minutes of latitude and longitude; 5 is 2 cm, 7 may exceed 82 characters", "", 3, 7)
    reference_point_m: tuple[float, ...] = setting(
        (0.0, 0.0, 0.0), "point whose position and speed go out, from base_link: forward, starboard, down", "m", -500.0, 500.0, length=3
    )
    geoid_separation_m: float = setting(0.0, "geoid above the ellipsoid here; 0: altitudes are heights above the ellipsoid", "m", -200.0, 200.0)
    gnss_aids: tuple[str, ...] = setting(("gps", "bds"), "subfilters of the navigator whose fused fixes make a position more than dead reckoning")
    course_speed_mps: float = setting(0.1, "below this speed over ground there is no course", "m/s", 0.0, 10.0)
    pashr_codes: str = setting(
        "alignment", "last two fields of PASHR: GNSS quality 0-6 and alignment 0-4, or GNSS aiding 0/1 and IMU 0/1", choices=("alignment", "flags")
    )
    simulator: bool = setting(False, "mark what goes out as simulated: GGA quality 8, THS and VTG mode S")
    state_timeout_s: float = setting(1.0, "wall time without nav/state after which invalid sentences go out", "s", 0.2, 60.0)
    heave_wait_s: float = setting(0.2, "PASHR waits this long, by measurement time, for nav/motion; then it goes without heave", "s", 0.0, 10.0)
    max_age_s: float = setting(2.0, "an incoming UTC further than this from the clock makes the sentence stale", "s", 0.05, 3600.0)
    position: PositionIn = section(PositionIn, "position in")
    velocity: VelocityIn = section(VelocityIn, "velocity over ground in")
    log: LogIn = section(LogIn, "log over ground in")
    water_log: WaterLogIn = section(WaterLogIn, "log through the water in; it also fills the water speeds of VBW that goes out")
    heading: HeadingIn = section(HeadingIn, "heading in")

    def __post_init__(self) -> None:
        if not re.fullmatch("[A-Z]{2}", self.talker):
            raise SettingError(f'"talker" must be two capital letters, not {self.talker!r}')
        for name in ("position", "velocity", "log", "water_log", "heading"):
            if not re.fullmatch("([A-Z]{2})?", getattr(self, name).talker):
                raise SettingError(f'"{name}.talker" must be two capital letters or empty')
        for name in ("outputs", "inputs"):
            for i, text in enumerate(getattr(self, name)):
                try:
                    parse_link(text, output=name == "outputs")
                except SettingError as error:
                    raise SettingError(f'"{name}": {error}', (name, str(i))) from None
        if bool(self.inputs) != bool(self.wanted):
            missing = "no aid names a sentence (position.sentence, log.sentence, ...)" if self.inputs else '"inputs" is empty'
            raise SettingError(f"nothing can come in: {missing}")

    @property
    def wanted(self) -> dict[str, str]:
        """Sentence by aid, of the aids that are used."""
        names = ("position", "velocity", "log", "water_log", "heading")
        return {name: getattr(self, name).sentence for name in names if getattr(self, name).sentence}
