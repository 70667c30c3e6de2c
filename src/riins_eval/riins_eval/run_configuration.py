"""The configuration that a bag carries on /riins/configuration, back as objects.

Lives here: `RunConfiguration`, `read_configuration`, `RecordError`.
Does not live here: how the text is made (configure.py), the arrays of a bag (bag_record.py).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import yaml

from riins_bag.bag import BagReader
from riins_core.settings import SettingError, build
from riins_federated.aid_inputs import inputs
from riins_federated.config import NavigatorConfig
from riins_imu_fusion.config import FusionConfig
from riins_sim.scenario import Scenario

from .configure import merged, redeclared


class RecordError(ValueError):
    """A bag lacks what is asked of it; one sentence."""


@dataclasses.dataclass(frozen=True)
class RunConfiguration:
    """What a bag was recorded with.

    Attributes
    ----------
    text : YAML as recorded
    scenario : of a simulated run, or the settings of an import in the same form; None: not known
    recording : of an import: file, what is simulated, pieces, notes; {} for a simulated run
    start_at_ns : measurement time of sample 0, 0: not known
    fusion, navigator : settings
    """

    text: str
    scenario: Scenario | None
    recording: Mapping[str, Any]
    start_at_ns: int
    fusion: FusionConfig
    navigator: NavigatorConfig

    @property
    def simulated(self) -> bool:
        """The whole run can be simulated again."""
        return self.scenario is not None and not self.recording


def read_configuration(reader: BagReader, overrides: Mapping[str, Any] | None = None) -> RunConfiguration:
    """Read the configuration of a bag.

    Parameters
    ----------
    reader : of the bag
    overrides : nested settings that replace the recorded ones: {"navigator": {"gps": {"enabled": False}}}

    Returns
    -------
    RunConfiguration

    Raises
    ------
    RecordError
        The bag has no configuration, or one that cannot be read.
    SettingError
        An override is unknown or out of range.
    """
    text = reader.configuration()
    if text is None:
        raise RecordError(f"{reader.path} has no /riins/configuration: it does not say which geometry and settings belong to it")
    try:
        content = yaml.safe_load(text)
        if not isinstance(content, Mapping):
            raise RecordError("it is no mapping")
        scenario = build(Scenario, content["scenario"], ("scenario",)) if content.get("scenario") else None
        fusion, navigator = content["fusion"], content["navigator"]
        build(FusionConfig, fusion, ("fusion",))
        build(NavigatorConfig, navigator, ("navigator",))
    except (yaml.YAMLError, KeyError, ValueError, RecordError) as error:
        what = f"{error} is missing" if isinstance(error, KeyError) else str(error).splitlines()[0]
        raise RecordError(f"/riins/configuration of {reader.path} cannot be read: {what}") from None
    over = dict(overrides or {})
    unknown = set(over) - {"fusion", "navigator"}
    if unknown:
        raise SettingError(f'"{sorted(unknown)[0]}" cannot be overridden; "fusion" and "navigator" can')
    return RunConfiguration(
        text, scenario, content.get("recording") or {}, int(content.get("start_at_ns") or 0),
        build(FusionConfig, merged(fusion, over.get("fusion", {})), ("fusion",)),
        build(NavigatorConfig, redeclared(navigator, over.get("navigator", {})), ("navigator",)),
    )  # fmt: skip


def aid_topics(reader: BagReader) -> list[str]:
    """Topics of the aids that the configuration of a bag declares, without its namespace; none where it cannot be read."""
    try:
        return [f"/{source.topic.strip('/')}" for source in inputs(read_configuration(reader).navigator.aid)]
    except RecordError:
        return []


def holds(reader: BagReader, topic: str) -> bool:
    """Whether a bag has at least one message of a topic."""
    return topic in reader.topics and reader.topics[topic][1] > 0


def with_settings(configuration: RunConfiguration) -> str:
    """The recorded text with the settings in force, for a bag that was navigated with overrides."""
    from riins_core.settings import as_mapping

    content = dict(yaml.safe_load(configuration.text))
    content["fusion"], content["navigator"] = as_mapping(configuration.fusion), as_mapping(configuration.navigator)
    return str(yaml.safe_dump(content, sort_keys=False, allow_unicode=True, default_flow_style=None, width=150))
