"""ROS parameters of a node, made of a settings class: declared, described, ranged, and refused in one line when wrong.

Lives here: `declare`, `check_names`, `parameter_file`, `ParameterError`; the only code of the workspace that declares parameters.
Does not live here: types, ranges and units themselves (riins_core.settings and the settings class of each package).
"""

from __future__ import annotations

import array
import dataclasses
import json
import sys
import types
import typing
from collections.abc import Iterable, Mapping
from typing import Any, TypeVar

import yaml
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter

from riins_core.settings import SettingError, as_mapping, build, declared_sections, field_types, flatten, nearest, unflatten

T = TypeVar("T")

# Names that rclpy declares itself; `autostart` is that of AutostartLifecycleNode.
ROS_NAMES = frozenset({"use_sim_time", "start_type_description_service", "autostart"})
QOS_PREFIX = "qos_overrides."
_TYPES = {float: Parameter.Type.DOUBLE, int: Parameter.Type.INTEGER, str: Parameter.Type.STRING, bool: Parameter.Type.BOOL}
_ARRAYS = {float: Parameter.Type.DOUBLE_ARRAY, int: Parameter.Type.INTEGER_ARRAY, str: Parameter.Type.STRING_ARRAY, bool: Parameter.Type.BOOL_ARRAY}
_INT64 = 2**63


class ParameterError(ValueError):
    """A parameter is unknown, of the wrong type, length or range; the message is one line."""


@dataclasses.dataclass(frozen=True)
class _Leaf:
    type: Parameter.Type
    metadata: Mapping[str, Any]
    optional: bool


def declare(
    node: Node, config_class: type[T], overrides: Mapping[str, Any] | None = None, also: Iterable[str] = (), services: Mapping[str, str] | None = None
) -> T:  # fmt: skip
    """Declare one read-only parameter per leaf of a settings class and return the settings that hold.

    Parameters
    ----------
    node : the node whose command line and parameter files are looked at
    config_class : settings class (riins_core.settings); sections become dotted names
    overrides : values by dotted name that take the place of the class's defaults, below what the user gives
    also : further parameter names that the node declares itself
    services : services by the name of the parameter they change while the node runs; an attempt to set it is refused in a line that names them

    Returns
    -------
    config_class, checked

    Raises
    ------
    ParameterError
        Unknown name (nearest match named), wrong type, length or range.

    Notes
    -----
    rclpy accepts unknown names silently and refuses a whole number for a floating point parameter; both are put right here.
    """
    told = {**(overrides or {}), **{name: _plain(p.value) for name, p in node._parameter_overrides.items()}}
    try:
        leaves = _leaves(config_class, _declarations(config_class, told))
    except SettingError as error:
        raise ParameterError(f"parameter {error}") from None
    lists: dict[str, list[Any]] = {name: [] for name, leaf in leaves.items() if leaf.type in _ARRAYS.values()}  # an empty list comes without a value
    given = {name: _plain(lists.get(name) if p.value is None else p.value) for name, p in node._parameter_overrides.items()}
    given = {name: value for name, value in given.items() if value is not None}
    known = {*leaves, *also, *ROS_NAMES, *node._parameters}
    check_names([name for name in given if not name.startswith(QOS_PREFIX)], known)
    values = {**(overrides or {}), **{name: value for name, value in given.items() if name in leaves}}
    try:
        config = build(config_class, unflatten(values))
    except SettingError as error:
        raise ParameterError(f"parameter {error}") from None
    flat = flatten(as_mapping(config))
    services = services or {}
    for name, leaf in leaves.items():
        node._parameter_overrides.pop(name, None)
        value = flat[name]
        if leaf.optional:
            node.declare_parameter(name, value, _descriptor(leaf))
        elif value == []:  # rclpy takes an empty list for one of bytes, so it is put in behind a declaration by type
            node.declare_parameter(name, leaf.type, _descriptor(leaf))
            node._parameters[name] = Parameter(name, leaf.type, [])
        else:
            node.declare_parameter(name, value, _descriptor(leaf))
    if services:
        for name in services:  # rclpy refuses to set a read-only parameter before it asks us, and says no more than that
            node._descriptors[name].read_only = False
        node.add_on_set_parameters_callback(lambda given: _refuse(node, services, given))
    return config


def _refuse(node: Node, services: Mapping[str, str], given: Iterable[Parameter]) -> SetParametersResult:
    for parameter in given:
        if parameter.name in services:
            service = services[parameter.name].replace("~", node.get_fully_qualified_name())
            return SetParametersResult(successful=False, reason=f'"{parameter.name}" is what the node starts with; call {service} to change it')
    return SetParametersResult(successful=True)


def check_names(names: Iterable[str], known: Iterable[str]) -> None:
    """Refuse a name that is not known.

    Raises
    ------
    ParameterError
        One line with the nearest known name.
    """
    known = sorted(known)
    for name in names:
        if name not in known:
            raise ParameterError(f'unknown parameter "{name}"{nearest(name, known)}')


def check_qos_names(node: Node) -> None:
    """Refuse QoS overrides for endpoints that the node does not have; call it when all endpoints exist.

    Raises
    ------
    ParameterError
        One line with the nearest known name.
    """
    given = [name for name in node._parameter_overrides if name.startswith(QOS_PREFIX)]
    check_names(given, [name for name in node._parameters if name.startswith(QOS_PREFIX)])


def parameter_file(node: Node, describe: bool = True) -> str:
    """Text of a ROS parameter file with every parameter of the node as it is now, described in comments.

    Parameters
    ----------
    node : a node whose parameters are declared
    describe : put description, unit and range above each value

    Returns
    -------
    YAML text that `--params-file` takes
    """
    lines = [f"{node.get_fully_qualified_name()}:", "  ros__parameters:"]
    for name in sorted(node._parameters):
        descriptor = node.describe_parameter(name)
        note = "; ".join(text for text in (descriptor.description, _range_text(descriptor), descriptor.additional_constraints) if text)
        if note and describe:
            lines.append(f"    # {note}")
        value = _plain(node.get_parameter(name).value)
        if value is None:
            lines.append(f"    # {name}:")
        else:
            text = f"[{', '.join(map(_word, value))}]" if isinstance(value, list) else _word(value)
            lines.append(f"    {name}: {text}")
    return "\n".join(lines) + "\n"


def _declarations(cls: type, told: Mapping[str, Any]) -> dict[str, Any]:
    """What is said of the sections that a user names: their lists, and the type of each."""
    lists = {field.metadata["declared"] for field in dataclasses.fields(cls) if "declared" in field.metadata}
    said = {name: [] if value is None else value for name, value in told.items() if name in lists}
    types_of = {name.removesuffix(".type"): {"type": value} for name, value in told.items() if name.endswith(".type") and name.count(".") == 1}
    return {**types_of, **said}


def _leaves(cls: type, values: Mapping[str, Any], prefix: str = "") -> dict[str, _Leaf]:
    """Parameters of a settings class, and of the sections that the values given declare."""
    leaves: dict[str, _Leaf] = {}
    hints = field_types(cls)
    for field in dataclasses.fields(cls):
        if "declared" in field.metadata:
            for name, kind in declared_sections(cls, values).items():
                leaves.update(_leaves(kind, {}, f"{prefix}{name}."))
            continue
        kind, optional = hints[field.name], False
        if typing.get_origin(kind) in (typing.Union, types.UnionType):
            kind, optional = next(a for a in typing.get_args(kind) if a is not type(None)), True
        name = prefix + field.name
        if dataclasses.is_dataclass(kind):
            leaves.update(_leaves(typing.cast(type, kind), {}, f"{name}."))
        elif typing.get_origin(kind) is tuple:
            leaves[name] = _Leaf(_ARRAYS[typing.get_args(kind)[0]], field.metadata, optional)
        else:
            leaves[name] = _Leaf(_TYPES[kind], field.metadata, optional)
    return leaves


def _descriptor(leaf: _Leaf) -> ParameterDescriptor:
    metadata = leaf.metadata
    unit = f" [{metadata['unit']}]" if metadata.get("unit") else ""
    descriptor = ParameterDescriptor(description=f"{metadata.get('doc', '')}{unit}", read_only=True, dynamic_typing=leaf.optional)
    low, high = metadata.get("low"), metadata.get("high")
    constraints = []
    if low is not None or high is not None:
        if leaf.type is Parameter.Type.DOUBLE and not leaf.optional:
            largest = sys.float_info.max
            bounds = FloatingPointRange(from_value=float(-largest if low is None else low), to_value=float(largest if high is None else high))
            descriptor.floating_point_range = [bounds]
        elif leaf.type is Parameter.Type.INTEGER and not leaf.optional:
            limits = IntegerRange(from_value=int(-_INT64 if low is None else low), to_value=int(_INT64 - 1 if high is None else high))
            descriptor.integer_range = [limits]
        else:  # ROS has ranges for single numbers only
            constraints.append(f"each in {'-inf' if low is None else low} .. {'inf' if high is None else high}")
    if metadata.get("length") is not None:
        constraints.append(f"{metadata['length']} elements")
    if metadata.get("choices"):
        constraints.append(f"one of {', '.join(metadata['choices'])}")
    descriptor.additional_constraints = "; ".join(constraints)
    return descriptor


def _range_text(descriptor: ParameterDescriptor) -> str:
    largest = sys.float_info.max
    for bounds in descriptor.floating_point_range:
        low = "-inf" if bounds.from_value == -largest else f"{bounds.from_value:g}"
        high = "inf" if bounds.to_value == largest else f"{bounds.to_value:g}"
        return f"{low} .. {high}"
    for limits in descriptor.integer_range:
        low = "-inf" if limits.from_value == -_INT64 else str(limits.from_value)
        high = "inf" if limits.to_value == _INT64 - 1 else str(limits.to_value)
        return f"{low} .. {high}"
    return ""


def _word(value: Any) -> str:
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)  # always quoted: the ROS parser takes a bare y or n for true or false
    return yaml.safe_dump(value).removesuffix("...\n").strip()  # safe_dump ends a bare scalar with a document mark


def _plain(value: Any) -> Any:
    return list(value) if isinstance(value, array.array | tuple) else value


__all__ = ["ParameterError", "check_names", "check_qos_names", "declare", "parameter_file"]
