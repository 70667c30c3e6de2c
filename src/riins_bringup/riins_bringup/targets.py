"""Where a verb will write at its end, tried before it begins.

Lives here: `writable_file`, `new_directory`, `usable_directory`, callbacks of the options of the command line.
Does not live here: the writing.
"""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

import typer


def writable_file(path: Path | None) -> Path | None:
    """The path of a file to be written at the end, tried now: a long run must not end with a file that cannot be written."""
    if path is not None and (path.is_file() or path.is_dir() or not path.exists()):  # a pipe or a device is not opened twice
        _try_to_write(path, directory=False)
    return path


def new_directory(path: Path | None) -> Path | None:
    """The path of a directory that a run will make, tried now."""
    if path is not None:
        if path.exists():
            raise typer.BadParameter(f"{path} exists already; choose another name or remove it")
        _try_to_write(path, directory=True)
    return path


def usable_directory(path: Path | None) -> Path | None:
    """The path of a directory that is there or will be made, tried now."""
    if path is not None and path.is_dir():
        if not os.access(path, os.W_OK | os.X_OK):
            raise typer.BadParameter(f"cannot write {path}: it is not writable")
    elif path is not None:
        _try_to_write(path, directory=True)
    return path


def _try_to_write(path: Path, directory: bool) -> None:
    """Make a file or directory with what is missing above it, and take away again what was made."""
    made = [p for p in (path, *path.parents) if not p.exists()]
    try:
        (path if directory else path.parent).mkdir(parents=True, exist_ok=not directory)
        if not directory:
            path.open("ab").close()
    except OSError as error:
        raise typer.BadParameter(f"cannot write {path}: {error.strerror or error}") from None
    finally:
        for p in made:
            with contextlib.suppress(OSError):
                p.rmdir() if p.is_dir() else p.unlink(missing_ok=True)
