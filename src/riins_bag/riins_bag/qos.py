"""Quality of service as a recording keeps it: the offered profiles of each topic.

Lives here: `Qos` and its YAML form of rosbag2 metadata version 9, named profiles for bags written offline, what a recorder should ask for.
Does not live here: rclpy's QoSProfile (nodes/ convert).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import yaml

FOREVER = {"sec": 9223372036, "nsec": 854775807}  # rmw's "infinite"


@dataclass(frozen=True)
class Qos:
    """What matters of one offered profile; words as in rosbag2 ("unknown" history: a subscriber cannot see it)."""

    reliability: str = "reliable"
    durability: str = "volatile"
    history: str = "unknown"
    depth: int = 0

    def as_mapping(self) -> dict[str, Any]:
        """Entry of offered_qos_profiles, metadata version 9."""
        return {
            "history": self.history,
            "depth": self.depth,
            "reliability": self.reliability,
            "durability": self.durability,
            "deadline": dict(FOREVER),
            "lifespan": dict(FOREVER),
            "liveliness": "automatic",
            "liveliness_lease_duration": dict(FOREVER),
            "avoid_ros_namespace_conventions": False,
        }


NAMED = {
    "imu": Qos(history="keep_last", depth=400),
    "aid": Qos(history="keep_last", depth=50),
    "navigation": Qos(history="keep_last", depth=400),
    "latched": Qos(durability="transient_local", history="keep_last", depth=1),
    "commands": Qos(durability="transient_local", history="keep_last", depth=100),
    "sensor_data": Qos(reliability="best_effort", history="keep_last", depth=5),
}
LATCHED_TOPICS = ("/riins/configuration", "/truth/faults", "/nav/initial_state", "/nav/origin")
NUMBERS = {
    "history": {1: "keep_last", 2: "keep_all"},
    "reliability": {1: "reliable", 2: "best_effort"},
    "durability": {1: "transient_local", 2: "volatile"},
}  # rmw's enums, which metadata up to version 8 uses


def of_topic(topic: str) -> Qos:
    """Profile of a topic of our graph that is written without naming one."""
    if topic in LATCHED_TOPICS:
        return NAMED["latched"]
    if topic in ("/nav/commands", "/fdi/method"):
        return NAMED["commands"]
    return NAMED["imu" if topic == "/rimu/raw" else "navigation"]


def dump(profiles: Sequence[Qos]) -> str:
    """YAML text that the MCAP channel carries."""
    return yaml.safe_dump([p.as_mapping() for p in profiles], sort_keys=False).strip() if profiles else ""


def parse(value: Any) -> tuple[Qos, ...]:
    """Profiles of a channel's YAML text or of the metadata's list; what cannot be read counts as not offered."""
    try:
        entries = yaml.safe_load(value) if isinstance(value, str) else value
    except yaml.YAMLError:
        return ()
    if not isinstance(entries, list):
        return ()
    return tuple(_profile(entry) for entry in entries if isinstance(entry, Mapping))


def request(offered: Iterable[Qos], depth: int) -> Qos:
    """Profile to subscribe with so that every offer matches: as strong as the weakest of them."""
    offers = list(offered)
    weak_reliability = any(o.reliability != "reliable" for o in offers)
    weak_durability = any(o.durability != "transient_local" for o in offers) or not offers
    return Qos("best_effort" if weak_reliability else "reliable", "volatile" if weak_durability else "transient_local", "keep_last", depth)


def replay(recorded: Sequence[Qos], depth: int) -> Qos:
    """Profile to publish a recorded topic with: the strongest that was recorded, unseen history as keep_last(depth)."""
    offers = list(recorded) or [Qos()]
    first = next((o for o in offers if o.reliability == "reliable"), offers[0])
    durability = "transient_local" if any(o.durability == "transient_local" for o in offers) else "volatile"
    known = first.history in ("keep_last", "keep_all") and (first.depth > 0 or first.history == "keep_all")
    chosen = first if known else replace(first, history="keep_last", depth=depth)
    reliability = chosen.reliability if chosen.reliability in ("reliable", "best_effort") else "reliable"
    return replace(chosen, durability=durability, reliability=reliability)


def _profile(entry: Mapping[str, Any]) -> Qos:
    def word(key: str) -> str:
        value = entry.get(key, "unknown")
        return NUMBERS[key].get(value, "unknown") if isinstance(value, int) else str(value).lower()

    depth = entry.get("depth", 0)
    return Qos(word("reliability"), word("durability"), word("history"), depth if isinstance(depth, int) else 0)
