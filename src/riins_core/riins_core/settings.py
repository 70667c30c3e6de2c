"""Settings: frozen dataclasses whose fields carry description, unit and range.

Lives here: `setting`, `build`, `as_mapping`, `SettingError`; every node's ROS parameters and every section of a scenario are such a class.
Does not live here: ROS parameter declaration (riins_node.parameters), reading of YAML files (riins_sim.scenario).
"""

from __future__ import annotations

import dataclasses
import difflib
import math
import types
import typing
from collections.abc import Mapping
from typing import Any, TypeVar

T = TypeVar("T")


class SettingError(ValueError):
    """A setting is unknown, of the wrong type, length or range.

    Attributes
    ----------
    path : tuple of str, where in the nested mapping
    """

    def __init__(self, message: str, path: tuple[str, ...] = ()) -> None:
        super().__init__(message)
        self.path = path


def setting(
    default: Any = dataclasses.MISSING,
    doc: str = "",
    unit: str = "",
    low: float | None = None,
    high: float | None = None,
    choices: tuple[str, ...] | None = None,
    length: int | None = None,
) -> Any:
    """Declare a field of a settings class.

    Parameters
    ----------
    default : value; omitted: the field must be given
    doc : one sentence for `ros2 param describe` and for the error message
    unit : SI symbol or data sheet unit, as the key carries it
    low, high : inclusive range, of the value or of each element
    choices : allowed words
    length : required number of elements of a tuple; None: any

    Returns
    -------
    dataclasses.Field
    """
    metadata = {"doc": doc, "unit": unit, "low": low, "high": high, "choices": choices, "length": length}
    if default is dataclasses.MISSING:
        return dataclasses.field(metadata=metadata)
    return dataclasses.field(default=default, metadata=metadata)


def section(cls: type[T], doc: str = "") -> Any:
    """Declare a nested settings class with all its defaults."""
    return dataclasses.field(default_factory=cls, metadata={"doc": doc})


def nearest(name: str, known: typing.Iterable[str]) -> str:
    """Suggestion for a misspelt name: ' (did you mean "x"?)', or '' when nothing is near."""
    match = difflib.get_close_matches(name, list(known), n=1, cutoff=0.5)
    return f' (did you mean "{match[0]}"?)' if match else ""


def field_types(cls: type) -> dict[str, Any]:
    """Resolved types of a settings class by field name."""
    return typing.get_type_hints(cls)


def build(cls: type[T], values: Mapping[str, Any], path: tuple[str, ...] = ()) -> T:
    """Make a settings object from a nested mapping, checking names, types, lengths and ranges.

    Parameters
    ----------
    cls : a frozen dataclass whose fields were made by `setting` or `section`
    values : mapping of field names; whole numbers are taken for floats
    path : where `values` stands, for messages

    Returns
    -------
    instance of cls

    Raises
    ------
    SettingError
        Unknown name (nearest match named), missing value, wrong type, length or range; `path` says where.
    """
    if not isinstance(values, Mapping):
        raise SettingError(f"{_name(path)} must be a mapping, not {_kind(values)}", path)
    fields = {f.name: f for f in dataclasses.fields(cls)}  # type: ignore[arg-type]
    for key in values:
        if key not in fields:
            raise SettingError(f'unknown setting "{".".join((*path, str(key)))}"{nearest(str(key), fields)}', (*path, str(key)))
    hints = field_types(cls)
    made: dict[str, Any] = {}
    for name, field in fields.items():
        where = (*path, name)
        if name in values:
            made[name] = _convert(hints[name], values[name], field.metadata, where)
        elif field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING:
            raise SettingError(f'"{_name(where)}" is missing{_hint(field.metadata)}', where)
    try:
        return cls(**made)
    except SettingError as error:  # raised by a __post_init__, which does not know where it stands
        raise SettingError(f"{_name(path)}: {error}" if path else str(error), (*path, *error.path)) from None


def as_mapping(config: Any) -> dict[str, Any]:
    """Nested plain mapping (lists for tuples) of a settings object; `build` of it gives the object back."""
    result: dict[str, Any] = {}
    for field in dataclasses.fields(config):
        result[field.name] = _plain(getattr(config, field.name))
    return result


def flatten(mapping: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Dotted names of a nested mapping, as ROS parameters have them."""
    flat: dict[str, Any] = {}
    for key, value in mapping.items():
        if isinstance(value, Mapping):
            flat.update(flatten(value, f"{prefix}{key}."))
        else:
            flat[f"{prefix}{key}"] = value
    return flat


def unflatten(flat: Mapping[str, Any]) -> dict[str, Any]:
    """Nested mapping of dotted names; the inverse of `flatten`."""
    nested: dict[str, Any] = {}
    for name, value in flat.items():
        *parents, leaf = name.split(".")
        here = nested
        for parent in parents:
            here = here.setdefault(parent, {})
        here[leaf] = value
    return nested


def _plain(value: Any) -> Any:
    if dataclasses.is_dataclass(value):
        return as_mapping(value)
    if isinstance(value, tuple | list):
        return [_plain(item) for item in value]
    return value


def _name(path: tuple[str, ...]) -> str:
    return ".".join(path) or "the top level"


def _kind(value: Any) -> str:
    return "nothing" if value is None else type(value).__name__


def _hint(metadata: Mapping[str, Any]) -> str:
    unit = f" [{metadata['unit']}]" if metadata.get("unit") else ""
    return f": {metadata['doc']}{unit}" if metadata.get("doc") else unit


def _convert(kind: Any, value: Any, metadata: Mapping[str, Any], path: tuple[str, ...]) -> Any:
    origin, args = typing.get_origin(kind), typing.get_args(kind)
    if origin in (typing.Union, types.UnionType):
        if value is None and type(None) in args:
            return None
        kind = next(a for a in args if a is not type(None))
        return _convert(kind, value, metadata, path)
    if dataclasses.is_dataclass(kind):
        return build(typing.cast(type, kind), value, path)
    if origin is tuple:
        if not isinstance(value, list | tuple):
            raise SettingError(f'"{_name(path)}" must be a list, not {_kind(value)}{_hint(metadata)}', path)
        length = metadata.get("length")
        if length is not None and len(value) != length:
            raise SettingError(f'"{_name(path)}" must have {length} elements, not {len(value)}{_hint(metadata)}', path)
        return tuple(_convert(args[0], item, metadata, (*path, str(i))) for i, item in enumerate(value))
    return _scalar(kind, value, metadata, path)


def _scalar(kind: Any, value: Any, metadata: Mapping[str, Any], path: tuple[str, ...]) -> Any:
    if kind is float and isinstance(value, int) and not isinstance(value, bool):
        value = float(value)
    if not isinstance(value, kind) or (kind is not bool and isinstance(value, bool)):
        words = {float: "a number", int: "a whole number", str: "a word", bool: "true or false"}
        raise SettingError(f'"{_name(path)}" must be {words.get(kind, kind)}, not {value!r}{_hint(metadata)}', path)
    if isinstance(value, float) and not math.isfinite(value):
        raise SettingError(f'"{_name(path)}" must be finite, not {value!r}{_hint(metadata)}', path)
    low, high = metadata.get("low"), metadata.get("high")
    if isinstance(value, int | float) and ((low is not None and value < low) or (high is not None and value > high)):
        span = f"{'-inf' if low is None else low} .. {'inf' if high is None else high}"
        raise SettingError(f'"{_name(path)}" must be in {span}, not {value!r}{_hint(metadata)}', path)
    choices = metadata.get("choices")
    if choices and value not in choices:
        raise SettingError(f'"{_name(path)}" must be one of {", ".join(choices)}, not {value!r}{nearest(str(value), choices)}', path)
    return value
