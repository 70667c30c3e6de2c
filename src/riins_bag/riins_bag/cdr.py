"""Blocks of messages of one type as arrays: CDR in and out without a loop over messages.

Lives here: `Layout` (where each field of a message lies once the lengths of its strings and sequences are known), `pack`, `Unpacker`.
Does not live here: single messages (typesys.py), files (bag.py).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Nodetype
from rosbags.typesys.store import Typestore

from riins_bag.errors import BagError
from riins_bag.typesys import NUMPY_TYPES, TIME_TYPES, require

HEADER = b"\x00\x01\x00\x00"  # encapsulation: plain CDR, little endian; alignment counts from behind it
COUNT = ".count"  # suffix of the column that has the number of elements of a sequence
LengthOf = Callable[[str, int], int]


@dataclass
class Layout:
    """Byte positions of the fields of one message type at given lengths of its strings and sequences.

    Attributes
    ----------
    size : bytes, with the encapsulation header
    fields : dotted path -> (offset, dtype, shape of the element); text has dtype S with its closing zero
    lengths : dotted path -> (offset, value) of the 32-bit length in front of every string and sequence
    """

    size: int = len(HEADER)
    fields: dict[str, tuple[int, np.dtype[Any], tuple[int, ...]]] = field(default_factory=dict)
    lengths: dict[str, tuple[int, int]] = field(default_factory=dict)

    def template(self) -> NDArray[np.uint8]:
        """Message of zeros with its header and lengths set."""
        row = np.zeros(self.size, np.uint8)
        row[: len(HEADER)] = np.frombuffer(HEADER, np.uint8)
        for offset, value in self.lengths.values():
            row[offset : offset + 4] = np.frombuffer(np.uint32(value).tobytes(), np.uint8)
        return row

    def view(self, rows: NDArray[np.uint8], path: str) -> NDArray[Any]:
        """Column `path` of rows (m, >= size) as a view (m,) or (m, k)."""
        offset, dtype, shape = self.fields[path]
        if shape == (0,):
            return np.empty((len(rows), 0), dtype)
        column = rows[:, offset : offset + dtype.itemsize * (shape[0] if shape else 1)].view(dtype)
        return column if shape else column[:, 0]

    def matches(self, rows: NDArray[np.uint8]) -> NDArray[np.bool_]:
        """Which rows (m, L) have exactly the lengths of this layout: bool (m,)."""
        good = np.ones(len(rows), np.bool_)
        for offset, value in self.lengths.values():
            good &= rows[:, offset : offset + 4].view("<u4")[:, 0] == value
        return good


def _align(size: int, width: int) -> int:
    return len(HEADER) + (size - len(HEADER) + width - 1) // width * width


def layout(store: Typestore, msgtype: str, length_of: LengthOf) -> Layout:
    """Walk a message type; `length_of(path, offset)` gives the length of each string (with closing zero) and sequence met."""
    found = Layout()
    _walk(store, found, "", Nodetype.NAME, msgtype, length_of)
    return found


def _walk(store: Typestore, found: Layout, path: str, node: Any, detail: Any, length_of: LengthOf) -> None:
    if node == Nodetype.NAME:
        for name, (inner, inner_detail) in require(detail, store).fielddefs[detail][1]:
            _walk(store, found, f"{path}.{name}" if path else name, inner, inner_detail, length_of)
    elif node == Nodetype.BASE and detail[0] == "string":
        length = _length(found, path, length_of)
        if length:  # some writers give an empty text no closing zero
            _put(found, path, np.dtype(f"S{length}"), ())
    elif node == Nodetype.BASE:
        _put(found, path, np.dtype(NUMPY_TYPES[detail[0]]), ())
    else:
        (inner, inner_detail), count = detail
        if node == Nodetype.SEQUENCE:
            count = _length(found, path, length_of)
        if inner == Nodetype.BASE and inner_detail[0] != "string":
            dtype = np.dtype(NUMPY_TYPES[inner_detail[0]])
            if count:
                _put(found, path, dtype, (count,))
            else:
                found.fields[path] = (found.size, dtype, (0,))  # an empty sequence has no padding behind its length
        else:
            for index in range(count):
                _walk(store, found, f"{path}.{index}", inner, inner_detail, length_of)


def _length(found: Layout, path: str, length_of: LengthOf) -> int:
    offset = found.size = _align(found.size, 4)
    value = length_of(path, offset)
    found.lengths[path] = (offset, value)
    found.size += 4
    return value


def _put(found: Layout, path: str, dtype: np.dtype[Any], shape: tuple[int, ...]) -> None:
    width = 1 if dtype.kind == "S" else dtype.itemsize
    offset = _align(found.size, width)
    found.fields[path] = (offset, dtype, shape)
    found.size = offset + dtype.itemsize * (shape[0] if shape else 1)


def pack(store: Typestore, msgtype: str, values: Mapping[str, Any], m: int) -> NDArray[np.uint8]:
    """CDR of m messages of one type.

    Parameters
    ----------
    store : type store
    msgtype : full type name
    values : nested mapping of field names; a scalar field takes (m,) or one value for all, an array or sequence field (m, k) or (k,) for all,
        text one str for all, a Time int64 nanoseconds, a message of plain numbers (Vector3) also (m, members) or (members,);
        missing fields are 0, "", empty
    m : number of messages

    Returns
    -------
    (m, size) uint8

    Raises
    ------
    BagError
        Unknown field, wrong shape or kind of value.
    """
    flat: dict[str, Any] = {}
    _flatten(store, msgtype, values, "", m, flat)

    def length_of(path: str, _: int) -> int:
        value = flat.get(path)
        if isinstance(value, bytes):
            return len(value) + 1
        return 0 if value is None else int(value.shape[-1])

    def text_or_sequence(path: str, offset: int) -> int:
        return length_of(path, offset) if path in flat else _default_length(store, msgtype, path)

    plan = layout(store, msgtype, text_or_sequence)
    rows = np.empty((m, plan.size), np.uint8)
    rows[:] = plan.template()
    for path, value in flat.items():
        column = plan.view(rows, path)
        try:
            column[...] = value
        except (TypeError, ValueError, OverflowError) as error:
            raise BagError(f"{msgtype}: field {path}: {error}") from None
    return rows


def _default_length(store: Typestore, msgtype: str, path: str) -> int:
    return 1 if _kind_at(store, msgtype, path.split(".")) == "text" else 0  # "" is one closing zero


def _kind_at(store: Typestore, msgtype: str, names: list[str]) -> str:
    kind: tuple[Any, Any] = next(kind for name, kind in store.fielddefs[msgtype][1] if name == names[0])
    node, detail = kind
    for index, name in enumerate(names[1:], start=1):
        if node == Nodetype.NAME:
            return _kind_at(store, detail, names[index:])
        if name.isdigit():
            node, detail = detail[0]
    return "text" if node == Nodetype.BASE else "sequence"


def _flatten(store: Typestore, msgtype: str, values: Any, prefix: str, m: int, flat: dict[str, Any]) -> None:
    members: Any = require(msgtype, store).fielddefs[msgtype][1]
    if not isinstance(values, Mapping):
        values = _split_members(msgtype, members, values, prefix)
    known = {name for name, _ in members}
    unknown = [str(name) for name in values if name not in known]
    if unknown:
        raise BagError(f"{msgtype} has no field {', '.join(unknown)}")
    for name, (node, detail) in members:
        if name not in values:
            continue
        path, value = prefix + name, values[name]
        if node == Nodetype.NAME:
            _flatten(store, detail, value, f"{path}.", m, flat)
        elif node == Nodetype.BASE and detail[0] == "string":
            flat[path] = _text(msgtype, path, value)
        elif node == Nodetype.BASE:
            flat[path] = _shaped(msgtype, path, value, m, 0)
        elif detail[0][0] == Nodetype.NAME or detail[0][1][0] == "string":
            raise BagError(f"{msgtype}: field {path} is a list of messages or texts: write it message by message")
        else:
            array = _shaped(msgtype, path, value, m, 1)
            if node == Nodetype.ARRAY and array.shape[-1] != detail[1]:
                raise BagError(f"{msgtype}: field {path} has {detail[1]} elements, not {array.shape[-1]}")
            flat[path] = array


def _split_members(msgtype: str, members: Any, values: Any, prefix: str) -> dict[str, Any]:
    array = np.asarray(values)
    if msgtype in TIME_TYPES and array.dtype.kind in "iu":
        seconds = array // 1_000_000_000
        return {"sec": seconds, "nanosec": array - seconds * 1_000_000_000}
    plain = all(node == Nodetype.BASE and detail[0] != "string" for _, (node, detail) in members)
    if plain and array.ndim in (1, 2) and array.shape[-1] == len(members):
        return {name: array[..., index] for index, (name, _) in enumerate(members)}
    raise BagError(f"field {prefix.rstrip('.')} is a {msgtype}: give a mapping of its fields" + (f" or (m, {len(members)})" if plain else ""))


def _text(msgtype: str, path: str, value: Any) -> bytes:
    if not isinstance(value, str):
        raise BagError(f"{msgtype}: field {path} is one text for the whole block, not {type(value).__name__}")
    return value.encode()


def _shaped(msgtype: str, path: str, value: Any, m: int, ndim: int) -> NDArray[Any]:
    array = np.asarray(value)
    if array.ndim == ndim or (array.ndim == ndim + 1 and len(array) == m):
        return array
    wanted = f"({m},) or one value" if ndim == 0 else f"({m}, k) or (k,)"
    raise BagError(f"{msgtype}: field {path} must have shape {wanted}, not {array.shape}")


class Unpacker:
    """Columns of many messages of one type, fed as matrices of equally long CDR.

    Parameters
    ----------
    store : type store
    msgtype : full type name
    fields : dotted paths or their beginnings ("header.stamp", "gyro", "subfilters.0"); None: every field but text
    """

    def __init__(self, store: Typestore, msgtype: str, fields: tuple[str, ...] | None = None) -> None:
        require(msgtype, store)
        self.store, self.msgtype, self.fields = store, msgtype, fields
        self._layouts: dict[int, list[Layout]] = {}
        self._pieces: list[tuple[NDArray[np.intp], dict[str, NDArray[Any]]]] = []
        self._kinds: dict[str, tuple[np.dtype[Any], tuple[int, ...]]] = {}
        self.rows = 0

    def feed(self, rows: NDArray[np.uint8]) -> None:
        """Take rows (m, L) uint8; each row is the CDR of one message."""
        if rows.shape[1] < len(HEADER) or np.any(rows[:, 1] != 1):
            raise BagError(f"a message of type {self.msgtype} is not little-endian CDR")
        left = np.arange(self.rows, self.rows + len(rows), dtype=np.intp)
        self.rows += len(rows)
        plans = self._layouts.setdefault(rows.shape[1], [])
        index = 0
        while len(rows):
            if index == len(plans):
                plans.append(self._measure(rows[0]))
            plan = plans[index]
            index += 1
            good = plan.matches(rows)
            if good.all():
                self._take(plan, rows, left)
                return
            if good.any():
                self._take(plan, rows[good], left[good])
                rows, left = rows[~good], left[~good]

    def columns(self) -> dict[str, NDArray[Any]]:
        """Columns in the order fed: (m,) or (m, k); shorter sequences padded with NaN or 0, their lengths in NAME.count."""
        result: dict[str, NDArray[Any]] = {}
        for name, (dtype, shape) in self._kinds.items():
            if len(self._pieces) == 1 and name in self._pieces[0][1]:
                result[name] = self._pieces[0][1][name]
                continue
            column = np.full((self.rows, *shape), np.nan if dtype.kind == "f" else b"" if dtype.kind == "S" else 0, dtype)
            for where, piece in self._pieces:
                if name in piece:
                    value = piece[name]
                    target = column[:, : value.shape[1]] if shape else column
                    if len(where) and where[-1] - where[0] == len(where) - 1:  # contiguous: a slice is much faster
                        target[where[0] : where[-1] + 1] = value
                    else:
                        target[where] = value
            result[name] = column
        return {name: np.char.decode(column) if column.dtype.kind == "S" else column for name, column in result.items()}

    def _measure(self, row: NDArray[np.uint8]) -> Layout:
        def length_of(path: str, offset: int) -> int:
            value = int(np.frombuffer(row[offset : offset + 4].tobytes().ljust(4, b"\xff"), "<u4")[0])
            if value > len(row):
                raise BagError(f"a message of type {self.msgtype} is malformed: {path} claims {value} elements in {len(row)} bytes")
            return value

        plan = layout(self.store, self.msgtype, length_of)
        if not plan.size <= len(row) < plan.size + 4:
            raise BagError(f"a message of type {self.msgtype} is malformed: {len(row)} bytes instead of {plan.size}")
        return plan

    def _wanted(self, path: str, dtype: np.dtype[Any]) -> bool:
        if self.fields is None:
            return dtype.kind != "S"
        return any(path == name or path.startswith(f"{name}.") for name in self.fields)

    def _take(self, plan: Layout, rows: NDArray[np.uint8], where: NDArray[np.intp]) -> None:
        piece: dict[str, NDArray[Any]] = {}
        for path, (_, dtype, shape) in plan.fields.items():
            if self._wanted(path, dtype):
                piece[path] = plan.view(rows, path).copy()
                if path in plan.lengths and dtype.kind != "S":
                    piece[path + COUNT] = np.full(len(rows), shape[0], np.int32)
        for name, column in piece.items():
            dtype, shape = self._kinds.get(name, (column.dtype, column.shape[1:]))
            wider = tuple(max(a, b) for a, b in zip(shape, column.shape[1:], strict=True))
            self._kinds[name] = (np.promote_types(dtype, column.dtype), wider)
        self._pieces.append((where, piece))
