"""Between rclpy and a bag: QoS profiles and message classes.

Lives here: `to_profile`, `from_profile`, `message_class`.
Does not live here: which profile is right (riins_bag.qos).
"""

from __future__ import annotations

import importlib
from typing import Any

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from riins_bag.qos import Qos


def to_profile(qos: Qos) -> QoSProfile:
    """Profile of rclpy; words that are not known become reliable, volatile, keep last."""
    return QoSProfile(
        history=HistoryPolicy.KEEP_ALL if qos.history == "keep_all" else HistoryPolicy.KEEP_LAST,
        depth=max(qos.depth, 1),
        reliability=ReliabilityPolicy.BEST_EFFORT if qos.reliability == "best_effort" else ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if qos.durability == "transient_local" else DurabilityPolicy.VOLATILE,
    )


def from_profile(profile: QoSProfile) -> Qos:
    """What a bag keeps of an offered profile."""
    depth = profile.depth if profile.history == HistoryPolicy.KEEP_LAST else 0
    return Qos(profile.reliability.name.lower(), profile.durability.name.lower(), profile.history.name.lower(), depth)


def message_class(msgtype: str) -> Any:
    """Message class of a full type name.

    Raises
    ------
    ImportError
        The package is not installed or has no such message.
    """
    package, kind, name = msgtype.split("/")
    try:
        return getattr(importlib.import_module(f"{package}.{kind}"), name)
    except AttributeError:
        raise ImportError(f"package {package} has no message {name}") from None
