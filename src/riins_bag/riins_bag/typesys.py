"""Message types without ROS: definitions, type hashes, CDR of single messages.

Lives here: `typestore` (the standard messages of Jazzy and riins_msgs), `schema_text`, `type_hash`, `message`, `serialize`, `deserialize`.
Does not live here: blocks of messages as arrays (cdr.py), files (bag.py).
"""

from __future__ import annotations

import functools
import os
import re
import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, TypesysError, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from riins_bag.errors import BagError

OWN_PACKAGE = "riins_msgs"
TIME_TYPES = ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration")
NUMPY_TYPES = {"bool": np.bool_, "byte": np.uint8, "char": np.uint8, "float32": np.float32, "float64": np.float64} | {
    name: np.dtype(name).type for name in ("int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64")
}
Maker = Callable[[Any], Any]
_SEPARATOR = "=" * 80


def definition_files(package: str) -> dict[str, Path]:
    """Files `NAME.msg` of a message package by full type name: installed (AMENT_PREFIX_PATH, sys.prefix), else in this source tree."""
    prefixes = [Path(p) for p in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if p] + [Path(sys.prefix)]
    folders = [prefix / "share" / package / "msg" for prefix in prefixes]
    folders += [parent / package / "msg" for parent in Path(__file__).resolve().parents]
    for folder in folders:
        files = sorted(folder.glob("*.msg"))
        if files:
            return {f"{package}/msg/{file.stem}": file for file in files}
    return {}


@functools.cache
def typestore() -> Typestore:
    """Shared store of the message types: those of ROS 2 Jazzy and of riins_msgs where its .msg files are found."""
    store = get_typestore(Stores.ROS2_JAZZY)
    _register_package(store, OWN_PACKAGE)
    return store


def require(msgtype: str, store: Typestore | None = None) -> Typestore:
    """Make sure that a type is in the store, reading the .msg files of its package if needed.

    Raises
    ------
    BagError
        No definition is found; the text says what to do.
    """
    store = typestore() if store is None else store
    if msgtype not in store.fielddefs:
        package = msgtype.split("/")[0]
        _register_package(store, package)
        if msgtype not in store.fielddefs:
            raise BagError(f"no definition of message type {msgtype}: build or source the workspace that has the package {package}")
        for _, (node, detail) in store.fielddefs[msgtype][1]:
            nested = _nested_type(node, detail)
            if nested:
                require(nested, store)
    return store


def schema_text(msgtype: str, store: Typestore | None = None) -> str:
    """Definition in the concatenated ros2msg form that MCAP embeds; our own messages keep their comments (units, frames)."""
    store = require(msgtype, store)
    generated, _ = store.generate_msgdef(msgtype, ros_version=2)
    own = definition_files(OWN_PACKAGE) if store is typestore() else {}
    first, *others = re.split(rf"^{_SEPARATOR}\n", generated, flags=re.MULTILINE)
    parts = [own[msgtype].read_text(encoding="utf-8") if msgtype in own else first]
    for other in others:
        name = other.split("\n", 1)[0].removeprefix("MSG: ")
        full = name.replace("/", "/msg/", 1)
        parts.append(f"MSG: {name}\n{own[full].read_text(encoding='utf-8')}" if full in own else other)
    return f"{_SEPARATOR}\n".join(part if part.endswith("\n") else part + "\n" for part in parts)


def type_hash(msgtype: str, store: Typestore | None = None) -> str:
    """RIHS01 hash of a type (REP-2016), equal to what rclpy announces."""
    return require(msgtype, store).hash_rihs01(msgtype)


def store_of_schemas(schemas: Mapping[str, str]) -> Typestore:
    """Store in which the given ros2msg schemas (by type name) win over what this machine has installed.

    A bag is read by its own definitions, so that an old recording stays readable after a message has changed.
    """
    base = get_typestore(Stores.ROS2_JAZZY)
    found: dict[str, Any] = {}
    for msgtype, text in schemas.items():
        try:
            for name, part in _split_schema(msgtype, text):
                found.update(get_types_from_msg(part, name))
        except Exception as error:
            raise BagError(f"the bag's definition of {msgtype} cannot be read: {error}") from None
    store = Typestore()
    store.register(found)
    missing = {name: fields for name, fields in base.fielddefs.items() if name not in store.fielddefs}
    store.fielddefs.update(missing)
    store.types.update({name: base.types[name] for name in missing})
    return store


def message(msgtype: str, fields: Any, store: Typestore | None = None) -> Any:
    """Message object for `serialize` from a nested mapping of its fields, or from any object with these attributes.

    Parameters
    ----------
    msgtype : full name, e.g. "riins_msgs/msg/NavState"
    fields : mapping (or object such as a rclpy message); a Time may be given as integer nanoseconds; missing fields are 0, "", empty

    Returns
    -------
    message object of rosbags

    Raises
    ------
    BagError
        Unknown field, value that does not fit.
    """
    store = require(msgtype, store)
    if getattr(fields, "__msgtype__", None) == msgtype and not isinstance(fields, Mapping):
        return fields
    try:
        return _maker(store, msgtype)(fields)
    except (TypeError, ValueError, AttributeError, OverflowError) as error:
        raise BagError(f"{msgtype}: {error}") from None


def serialize(msgtype: str, fields: Any, store: Typestore | None = None) -> bytes:
    """CDR (little endian, with encapsulation header) of a message object or of what `message` takes."""
    store = require(msgtype, store)
    try:
        return bytes(store.serialize_cdr(message(msgtype, fields, store), msgtype, little_endian=True))
    except (SerdeError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise BagError(f"{msgtype} cannot be serialized: {error}") from None
    except Exception as error:  # struct.error is not a public part of what rosbags promises
        raise BagError(f"{msgtype} cannot be serialized: {type(error).__name__}: {error}") from None


def deserialize(msgtype: str, cdr: bytes | memoryview, store: Typestore | None = None) -> Any:
    """Message object (attributes named as the fields, arrays as numpy) of its CDR."""
    store = require(msgtype, store)
    try:
        return store.deserialize_cdr(cdr, msgtype)
    except SerdeError as error:
        raise BagError(f"a message of type {msgtype} is malformed: {error}") from None


@functools.lru_cache(maxsize=512)
def _maker(store: Typestore, msgtype: str) -> Maker:
    """Function from a mapping or object to a message object, its conversions looked up once."""
    members = [(name, _member(store, node, detail)) for name, (node, detail) in store.fielddefs[msgtype][1]]
    known, cls = {name for name, _ in members}, store.types[msgtype]

    def from_mapping(fields: Any) -> Any:
        if not isinstance(fields, Mapping):
            return cls(*[make(getattr(fields, name, None)) for name, make in members])
        if not known.issuperset(fields):
            raise BagError(f"{msgtype} has no field {', '.join(str(key) for key in fields if key not in known)}")
        return cls(*[make(fields.get(name)) for name, make in members])

    def time(fields: Any) -> Any:
        if isinstance(fields, int | np.integer):
            return cls(*divmod(int(fields), 1_000_000_000))
        return from_mapping(fields)

    return time if msgtype in TIME_TYPES else from_mapping


def _nested_type(node: Any, detail: Any) -> str | None:
    if node == Nodetype.NAME:
        return str(detail)
    if node in (Nodetype.ARRAY, Nodetype.SEQUENCE):
        return _nested_type(*detail[0])
    return None


def _member(store: Typestore, node: Any, detail: Any) -> Maker:
    if node == Nodetype.NAME:
        nested = _maker(store, detail)
        return lambda value: nested({} if value is None else value)
    if node == Nodetype.BASE:
        return _SCALARS.get(detail[0], _SCALARS["float64"] if detail[0].startswith("float") else _integer)
    (inner, inner_detail), length = detail
    if inner == Nodetype.NAME or inner_detail[0] == "string":
        return _list_maker(_member(store, inner, inner_detail), length if node == Nodetype.ARRAY else None)
    return _array_maker(np.dtype(NUMPY_TYPES[inner_detail[0]]), length if node == Nodetype.ARRAY else None)


def _list_maker(element: Maker, length: int | None) -> Maker:
    def make(value: Any) -> list[Any]:
        items = [None] * (length or 0) if value is None else value
        return [element(item) for item in _checked(items, length)]

    return make


def _array_maker(dtype: np.dtype[Any], length: int | None) -> Maker:
    def make(value: Any) -> Any:
        if value is None:
            return np.zeros(length or 0, dtype)
        if not (type(value) is np.ndarray and value.dtype == dtype and value.ndim == 1 and value.flags.c_contiguous):
            value = np.ascontiguousarray(value, dtype).ravel()
        return _checked(value, length)

    return make


def _checked(items: Any, length: int | None) -> Any:
    if length is not None and len(items) != length:
        raise ValueError(f"an array of {length} elements got {len(items)}")
    return items


def _integer(value: Any) -> int:
    if isinstance(value, bytes):  # rclpy has `byte` as bytes of length 1
        return value[0]
    return 0 if value is None else int(value)


_SCALARS: dict[str, Maker] = {
    "string": lambda value: "" if value is None else str(value),
    "bool": bool,
    "float64": lambda value: 0.0 if value is None else float(value),
}


def _register_package(store: Typestore, package: str) -> None:
    found: dict[str, Any] = {}
    for name, file in definition_files(package).items():
        try:
            found.update(get_types_from_msg(file.read_text(encoding="utf-8"), name))
        except TypesysError:
            continue  # a definition that rosbags cannot parse is missed only if it is asked for
    new = {name: fields for name, fields in found.items() if name not in store.fielddefs}
    if new:
        store.register(new)


def _split_schema(msgtype: str, text: str) -> Iterator[tuple[str, str]]:
    first, *others = re.split(r"^=+\n", text, flags=re.MULTILINE)
    yield msgtype, first
    for other in others:
        head, _, body = other.partition("\n")
        name = head.removeprefix("MSG: ").strip()
        yield name if "/msg/" in name else name.replace("/", "/msg/", 1), body
