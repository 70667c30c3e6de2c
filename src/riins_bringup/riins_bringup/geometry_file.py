"""A sensor geometry from a file.

Lives here: `read_geometry`, for text, CSV, YAML and NumPy files.
Does not live here: the geometry itself and its checks (riins_core.imu_array), what is printed of it (geometry.py).
"""

from __future__ import annotations

import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from riins_core.imu_array import ImuArray
from riins_core.settings import SettingError

_NAMES = ("geometry", "H", "axes")
"""Under which a YAML mapping or a .npz may hold it among other things."""


def read_geometry(path: Path) -> ImuArray:
    """A geometry from a file.

    Parameters
    ----------
    path : one sensing axis a row, body axes.
        .yaml, .yml: a list of rows, or a mapping with one under `geometry`, `H` or `axes`; .npz: an n x 3 array of one of these names, or the only
        n x 3 array in it; .npy; anything else is text or CSV: three numbers a line, divided by blanks, commas or semicolons, '#' begins a
        comment, and a first line without any number is a heading

    Raises
    ------
    SettingError
        The file does not hold n x 3 numbers, a row is not of unit length, or the axes do not span space.
    OSError
        The file cannot be read.
    """
    reader: Callable[[Path], Any] = {".yaml": _yaml, ".yml": _yaml, ".npz": _npz, ".npy": _npy}.get(path.suffix.lower(), _text)
    try:
        return ImuArray(_rows(reader(path)))
    except (ValueError, TypeError, EOFError, yaml.YAMLError, zipfile.BadZipFile) as error:
        raise SettingError(f"{path}: {' '.join(str(error).split())}") from None


def _rows(content: Any) -> list[list[float]]:
    rows = list(content)
    for number, row in enumerate(rows, start=1):
        if not isinstance(row, list | tuple | np.ndarray) or len(row) != 3:
            raise ValueError(f"row {number} of the geometry must be three numbers")
    return [[float(value) for value in row] for row in rows]


def _text(path: Path) -> list[list[str]]:
    lines = path.read_text(encoding="utf-8-sig").splitlines()
    words = [line.split("#")[0].replace(",", " ").replace(";", " ").split() for line in lines]
    rows = [row for row in words if row]
    return rows[1:] if rows and not any(_number(word) for word in rows[0]) else rows


def _number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _yaml(path: Path) -> Any:
    content = yaml.safe_load(path.read_text(encoding="utf-8"))
    if isinstance(content, dict):
        found = [content[name] for name in _NAMES if name in content]
        if len(found) != 1:
            raise ValueError(f"the mapping must hold the geometry under one of {', '.join(_NAMES)}")
        content = found[0]
    if not isinstance(content, list):
        raise ValueError("a list of rows of three numbers is needed")
    return content


def _npz(path: Path) -> Any:
    if path.is_file() and not zipfile.is_zipfile(path):
        raise ValueError("this is no .npz file")  # NumPy would advise to unpickle it
    with np.load(path, allow_pickle=False) as file:
        named = [name for name in _NAMES if name in file.files]
        fitting = named or [name for name in file.files if file[name].ndim == 2 and file[name].shape[1] == 3]
        if len(fitting) != 1:
            names = ", ".join(file.files) or "no arrays"
            raise ValueError(f"the geometry must be the only n x 3 array, or be called one of {', '.join(_NAMES)}; there are {names}")
        return _matrix(file[fitting[0]])


def _npy(path: Path) -> Any:
    with path.open("rb") as file:
        if file.read(6) != b"\x93NUMPY":
            raise ValueError("this is no .npy file")
    return _matrix(np.load(path, allow_pickle=False))


def _matrix(array: Any) -> Any:
    if array.ndim != 2 or array.shape[1] != 3:
        raise ValueError(f"the geometry must be n x 3, not {' x '.join(map(str, array.shape)) or 'one number'}")
    if array.dtype.kind not in "fiu":
        raise ValueError(f"the geometry must be real numbers, not {array.dtype}")
    return array
