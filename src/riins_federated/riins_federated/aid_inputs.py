"""From a message to a measurement of a declared aid, the same live and offline.

Lives here: `AidInput`, `inputs`, `check_aids`.
Does not live here: the readers (riins_node.readings), subscriptions (node.py), bags (riins_eval.renavigate).
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from riins_core.settings import SettingError
from riins_node.readings import is_for_fusion

from .aiding import AidSettings, Input
from .aids import AID_MODELS
from .types import Aid

_TOPIC = re.compile(r"/?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*")


@dataclass(frozen=True)
class AidInput:
    """What a declared aid listens to.

    Attributes
    ----------
    name : of the aid
    topic : as declared, or NAME/leaf of its type; relative to the namespace unless it begins with a slash
    input : message type and reader
    delay_ns : taken off the stamps of its messages
    """

    name: str
    topic: str
    input: Input
    delay_ns: int

    def read(self, message: Any) -> Aid | None:
        """The measurement in a message, at the time at which it holds; None: the message is not for this aid."""
        reading = self.input.read(message)
        if reading is None:
            return None
        values = dict(reading)
        return Aid(self.name, **{**values, "stamp_ns": values["stamp_ns"] - self.delay_ns})


def inputs(aids: Mapping[str, AidSettings]) -> list[AidInput]:
    """Inputs of the aids that are enabled and come in messages, in their order."""
    found = []
    for name, settings in aids.items():
        model = AID_MODELS[settings.type]
        word = getattr(settings, "message", next(iter(model.inputs)))
        if settings.enabled and not getattr(settings, "detect", False):
            found.append(AidInput(name, settings.topic or f"{name}/{model.leaf}", model.inputs[word], round(settings.delay_s * 1e9)))
    return found


def check_aids(aids: Mapping[str, AidSettings]) -> None:
    """Refuse two aids that would take the same measurements, and names that are those of inertial sensors.

    Raises
    ------
    SettingError
        Two aids have one topic, ROS does not take a topic, or a name begins with gyro_ or accel_: an operator's command would go to the fusion.
    """
    for name in aids:
        if is_for_fusion(name):
            raise SettingError(f'"aids" names "{name}": names that begin with gyro_ or accel_ are those of inertial sensors', ("aids",))
    taken: dict[tuple[str, str], str] = {}
    for one in inputs(aids):
        if not _TOPIC.fullmatch(one.topic):
            wanted = "words of letters, digits and _ with / between them, none beginning with a digit"
            raise SettingError(f'"{one.name}.topic" must be {wanted}, not {one.topic!r}', (one.name, "topic"))
        key = (one.topic.strip("/"), one.input.part)
        if key in taken:
            raise SettingError(f'"{one.name}" has the topic "{one.topic}", which is that of "{taken[key]}"', (one.name, "topic"))
        taken[key] = one.name
