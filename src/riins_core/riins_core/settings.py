"""Settings: frozen dataclasses whose fields carry description, unit and range.

Lives here: `setting`, `section`, `declared`, `build`, `as_mapping`, `SettingError`; node parameters and sections of a scenario are such classes.
Does not live here: ROS parameter declaration (riins_node.parameters), reading of YAML files (riins_sim.scenario).
"""

from __future__ import annotations

import dataclasses
import difflib
import math
import sys
import types
import typing
from collections.abc import Callable, Mapping
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


def declared(names: str, kinds: Callable[[], Mapping[str, type]], defaults: Mapping[str, str]) -> Any:
    """Declare sections that the user names: a field of type Mapping[str, Any], the settings by name.

    Parameters
    ----------
    names : the field (a tuple of words) that lists them; each stands beside that field under its own name, and its setting `type` says what it is
    kinds : gives the settings class of each type
    defaults : types of names that need none
    """

    def make() -> dict[str, Any]:
        return {name: kinds()[kind]() for name, kind in defaults.items()}

    return dataclasses.field(default_factory=make, metadata={"declared": names, "kinds": kinds, "defaults": defaults})


def declared_sections(cls: type, values: Mapping[str, Any], path: tuple[str, ...] = ()) -> dict[str, type]:
    """Settings class of every section that `values` declare for a settings class, by name; nothing for a class without such sections.

    Raises
    ------
    SettingError
        A section is missing, named twice, or its name cannot be one; an unknown type (nearest one named).
    """
    fields = {f.name: f for f in dataclasses.fields(cls)}
    found: dict[str, type] = {}
    for field in fields.values():
        if "declared" not in field.metadata:
            continue
        listed, kinds = field.metadata["declared"], field.metadata["kinds"]()
        where = (*path, listed)
        names = values.get(listed, fields[listed].default)
        if not isinstance(names, list | tuple) or not all(isinstance(name, str) for name in names):
            raise SettingError(f'"{_name(where)}" must be a list of names, not {names!r}', where)
        for name in names:
            own = values.get(name)
            if name in fields:
                raise SettingError(f'"{_name(where)}" names "{name}", which cannot be the name of a section: it is that of a setting', where)
            if not (name.isidentifier() and name.isascii()):
                raise SettingError(
                    f'"{_name(where)}" names {name!r}, which cannot be the name of a section: letters, digits and _ are wanted, no digit first', where
                )
            if name in found:
                raise SettingError(f'"{_name(where)}" names "{name}" twice', where)
            kind = own.get("type") if isinstance(own, Mapping) else None
            kind = field.metadata["defaults"].get(name) if kind is None else kind
            if kind is None:
                raise SettingError(
                    f'"{_name(where)}" names "{name}", but there is no "{_name((*path, name))}.type"; types are {", ".join(kinds)}', where
                )
            if not isinstance(kind, str) or kind not in kinds:
                said = f'"{_name((*path, name))}.type" must be one of {", ".join(kinds)}, not {kind!r}{nearest(str(kind), kinds)}'
                raise SettingError(said, (*path, name, "type"))
            found[name] = kinds[kind]
    return found


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
    sections = declared_sections(cls, values, path)
    known = [*(name for name, field in fields.items() if "declared" not in field.metadata), *sections]
    for key in values:
        if key not in known:
            raise SettingError(
                f'unknown setting "{".".join((*path, str(key)))}"{nearest(str(key), known)}{_undeclared(fields, values[key])}', (*path, str(key))
            )
    hints = field_types(cls)
    made: dict[str, Any] = {}
    for name, field in fields.items():
        where = (*path, name)
        if "declared" in field.metadata:
            made[name] = {one: build(kind, values.get(one, {}), (*path, one)) for one, kind in sections.items()}
        elif name in values:
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
        value = getattr(config, field.name)
        if "declared" in field.metadata:
            result.update({name: as_mapping(one) for name, one in value.items()})
        else:
            result[field.name] = _plain(value)
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


def _undeclared(fields: Mapping[str, Any], value: Any) -> str:
    lists = [field.metadata["declared"] for field in fields.values() if "declared" in field.metadata]
    return f', or is it a section that "{lists[0]}" should name?' if lists and isinstance(value, Mapping) else ""


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
        value = float(value) if abs(value) <= sys.float_info.max else math.inf if value > 0 else -math.inf
    if not isinstance(value, kind) or (kind is not bool and isinstance(value, bool)):
        words = {float: "a number", int: "a whole number", str: "a word", bool: "true or false"}
        raise SettingError(f'"{_name(path)}" must be {words.get(kind, "a mapping of names to values")}, not {value!r}{_hint(metadata)}', path)
    if isinstance(value, float) and not math.isfinite(value):
        raise SettingError(f'"{_name(path)}" must be finite, not {value!r}{_hint(metadata)}', path)
    low, high = metadata.get("low"), metadata.get("high")
    if isinstance(value, int | float) and ((low is not None and value < low) or (high is not None and value > high)):
        span = f"{'-inf' if low is None else low} .. {'inf' if high is None else high}"
        raise SettingError(f'"{_name(path)}" must be in {span}, not {value!r}{_hint(metadata)}', path)
    choices = metadata.get("choices")
    if choices and value not in choices:
        named = ", ".join(word or '"" (none)' for word in choices)
        raise SettingError(f'"{_name(path)}" must be one of {named}, not {value!r}{nearest(str(value), choices)}', path)
    return value
