"""riins_msgs: every field says what it is, and every message and service can be made, sent and read back."""

from __future__ import annotations

import importlib
import re
from pathlib import Path
from typing import Any

import pytest
from rclpy.serialization import deserialize_message, serialize_message

ROOT = Path(__file__).resolve().parents[1]
DEFINITIONS = sorted([*ROOT.glob("msg/*.msg"), *ROOT.glob("srv/*.srv"), *ROOT.glob("action/*.action")])
FIELD = re.compile(r"^\s*[\w/]+(\[\d*\])?\s+[A-Za-z]\w*(\s*=\s*\S+)?")
FRAMES = re.compile(r"frame_id|frame|empty")
IDS = [path.name for path in DEFINITIONS]


@pytest.mark.parametrize("path", DEFINITIONS, ids=IDS)
def test_every_field_has_a_comment(path: Path) -> None:
    bare = [line for line in path.read_text().splitlines() if line.strip() not in ("", "---") and not re.search(r"#\s*\S", line)]
    assert not bare, f"{path.name}: {bare}"


@pytest.mark.parametrize("path", DEFINITIONS, ids=IDS)
def test_header_says_its_frame(path: Path) -> None:
    for line in path.read_text().splitlines():
        if line.startswith("std_msgs/Header"):
            assert FRAMES.search(line) and "stamp" in line, f"{path.name}: {line}"


@pytest.mark.parametrize("path", [p for p in DEFINITIONS if p.suffix == ".msg"], ids=[p.name for p in DEFINITIONS if p.suffix == ".msg"])
def test_message_survives_serialization(path: Path) -> None:
    cls = getattr(importlib.import_module("riins_msgs.msg"), path.stem)
    named = {m[0].split()[1] for line in path.read_text().splitlines() if (m := FIELD.match(line.split("#")[0])) and "=" not in line.split("#")[0]}
    assert set(cls.get_fields_and_field_types()) == named
    message = cls()
    for number, name in enumerate(cls.get_fields_and_field_types(), start=1):
        setattr(message, name, _other(getattr(message, name), number))
    assert deserialize_message(serialize_message(message), cls) == message
    assert message != cls()


@pytest.mark.parametrize("path", [p for p in DEFINITIONS if p.suffix == ".srv"], ids=[p.name for p in DEFINITIONS if p.suffix == ".srv"])
def test_service_answers_success_and_message(path: Path) -> None:
    cls = getattr(importlib.import_module("riins_msgs.srv"), path.stem)
    assert {"success", "message"} <= set(cls.Response.get_fields_and_field_types())
    assert deserialize_message(serialize_message(cls.Request()), cls.Request) == cls.Request()


def test_action_answers_success_and_message() -> None:
    from riins_msgs.action import Align

    assert {"success", "message"} <= set(Align.Result.get_fields_and_field_types())
    assert deserialize_message(serialize_message(Align.Goal()), Align.Goal) == Align.Goal()
    assert set(Align.Feedback.get_fields_and_field_types()) == {"status"}


def test_constants_agree_between_messages() -> None:
    """States of health are one enumeration as far as sensors and subfilters share it; modes start with waiting."""
    from riins_msgs.msg import NavState, SubfilterStatus, TriadFdi

    shared = ("HEALTHY", "SUSPECT", "ISOLATED", "PROBATION", "EXCLUDED")
    assert [getattr(TriadFdi, name) for name in shared] == [getattr(SubfilterStatus, name) for name in shared]
    assert (NavState.MODE_WAITING, NavState.MODE_FAILED) == (0, 4)


def _other(value: Any, number: int) -> Any:
    """A value of the same type that is not the default."""
    if isinstance(value, bool):
        return not value
    if isinstance(value, int):
        return number
    if isinstance(value, float):
        return 0.5 * number
    if isinstance(value, str):
        return f"text {number}"
    if hasattr(value, "get_fields_and_field_types"):
        name = next(iter(value.get_fields_and_field_types()))
        setattr(value, name, _other(getattr(value, name), number))
        return value
    if hasattr(value, "dtype"):
        value[:] = number
        return value
    if hasattr(value, "typecode"):
        value.extend([type(value[0])(1)] if value else [1.0 if value.typecode == "d" else 1])
        return value
    return value
