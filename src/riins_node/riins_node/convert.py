"""Messages of rclpy made of the dicts of fields.py; the readers of readings.py beside them, so that a node imports one module.

Lives here: `fill`, `to_stamp`.
Does not live here: what a message holds (fields.py), what a reading means (readings.py).
"""

from __future__ import annotations

import functools
import importlib
import re
from array import array
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

import numpy as np
from builtin_interfaces.msg import Time

from riins_node.readings import (
    is_for_fusion,
    read_attitude,
    read_doppler,
    read_dvl_beams,
    read_dvl_bottom,
    read_dvl_water,
    read_fault,
    read_fused_imu,
    read_fusion_method,
    read_heading,
    read_height,
    read_imu,
    read_inertial_calibration,
    read_initial_state,
    read_nav_state,
    read_odometer,
    read_position_aid,
    read_redundant_imu,
    read_sensor_use,
    read_velocity,
    to_ns,
)

M = TypeVar("M")
_TYPECODES = {
    "double": "d",
    "float": "f",
    "int8": "b",
    "uint8": "B",
    "int16": "h",
    "uint16": "H",
    "int32": "i",
    "uint32": "I",
    "int64": "q",
    "uint64": "Q",
}
_ARRAY = re.compile(r"(?P<item>.+)\[(?P<length>\d+)\]")
_SEQUENCE = re.compile(r"sequence<(?P<item>[^,]+)(, \d+)?>")
Maker = Callable[[Any], Any]


def to_stamp(ns: int) -> Time:
    """builtin_interfaces/Time of integer nanoseconds."""
    sec, nanosec = divmod(int(ns), 1_000_000_000)
    return Time(sec=sec, nanosec=nanosec)


def fill(msg_class: type[M], fields: Mapping[str, Any]) -> M:
    """Make a rclpy message of a nested mapping of its fields.

    Parameters
    ----------
    msg_class : message class
    fields : values by name, numpy or plain; a Time as integer nanoseconds; fields left out keep their default

    Returns
    -------
    msg_class

    Raises
    ------
    ValueError
        Unknown field, or a fixed array of the wrong length.

    Notes
    -----
    Values are turned into exactly the type the field has: rclpy checks nothing here, and would read a whole number put into a float64 as rubbish.
    """
    plan: dict[str, Maker] = _plan(msg_class)  # type: ignore[arg-type]
    if not fields.keys() <= plan.keys():
        raise ValueError(f"{msg_class.__name__} has no field {', '.join(sorted(fields.keys() - plan.keys()))}")
    return msg_class(**{name: plan[name](value) for name, value in fields.items()})


@functools.cache
def _plan(msg_class: Any) -> dict[str, Maker]:
    return {name: _maker(kind) for name, kind in msg_class.get_fields_and_field_types().items()}


def _maker(kind: str) -> Maker:
    if kind == "builtin_interfaces/Time":
        return lambda value: fill(Time, value) if isinstance(value, Mapping) else to_stamp(value)
    if match := _ARRAY.fullmatch(kind):
        return _array(match["item"], int(match["length"]))
    if match := _SEQUENCE.fullmatch(kind):
        item = match["item"]
        if item in _TYPECODES:
            code = _TYPECODES[item]
            return lambda value: array(code, np.asarray(value, code).tobytes())
        make = _maker(item)
        return lambda value: [make(one) for one in value]
    if "/" in kind:
        package, name = kind.split("/")
        cls = getattr(importlib.import_module(f"{package}.msg"), name)
        return lambda value: fill(cls, value) if isinstance(value, Mapping) else value
    if kind in ("double", "float"):
        return float
    if kind in ("boolean", "bool"):
        return bool
    if kind.startswith("string"):
        return str
    if kind in ("octet", "byte"):
        return bytes
    return int


def _array(item: str, length: int) -> Maker:
    if item not in _TYPECODES:
        make = _maker(item)
        return lambda value: [make(one) for one in value]
    code = _TYPECODES[item]

    def make_array(value: Any) -> Any:
        made = np.array(value, code)
        if made.shape != (length,):
            raise ValueError(f"an array of {length} elements got shape {made.shape}")
        return made

    return make_array


__all__ = [
    "fill",
    "is_for_fusion",
    "read_attitude",
    "read_doppler",
    "read_dvl_beams",
    "read_dvl_bottom",
    "read_dvl_water",
    "read_fault",
    "read_fused_imu",
    "read_fusion_method",
    "read_heading",
    "read_height",
    "read_imu",
    "read_inertial_calibration",
    "read_initial_state",
    "read_nav_state",
    "read_odometer",
    "read_position_aid",
    "read_redundant_imu",
    "read_sensor_use",
    "read_velocity",
    "to_ns",
    "to_stamp",
]
