"""Compilation of kernels: numba's njit with the types of the function kept, and a cache that notices every change.

Lives here: `jit`, `inner`. Kernels work sample by sample on plain arrays, call no BLAS, never use fastmath: no result depends on the block size.
Does not live here: any mathematics, and the warming of kernels (each algorithm object has its own `warm_up`).
"""

from __future__ import annotations

import ast
import functools
import hashlib
import importlib.util
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

import numba

Function = TypeVar("Function", bound=Callable[..., Any])

_OURS = "riins_"  # prefix of the packages whose sources count


def jit(function: Function) -> Function:
    """Compile `function` on first use, cached on disk beside its source.

    Parameters
    ----------
    function : a function of scalars and arrays in the subset numba compiles

    Returns
    -------
    the compiled function, with the signature of the original for type checkers

    Notes
    -----
    numba's own cache looks at the date of the file a kernel stands in, so it misses an edit of a kernel or a constant in another file and
    goes on with old code. Here an entry is good for the contents of the file and of all files of ours it imports, directly or not.
    """
    return _cached(function, numba.njit(nogil=True, no_cfunc_wrapper=True)(function))


def inner(function: Function) -> Function:
    """Compile `function` as `jit` does, for calls from other kernels alone.

    Parameters
    ----------
    function : as in `jit`

    Raises
    ------
    TypeError
        At a call from Python.

    Notes
    -----
    To take a tuple of arrays apart for a call from Python is more code than many a kernel is: without it kernels compile sooner.
    """

    def keep(result: Any) -> None:
        compiled.overloads[tuple(result.signature.args)] = result  # what numba does besides, to enter it for calls from Python, would end in a crash

    def refuse(*args: Any, **kwargs: Any) -> None:
        raise TypeError(f"{function.__name__} is for calls from other kernels")

    compiled = cast(Any, numba.njit(nogil=True, no_cpython_wrapper=True, no_cfunc_wrapper=True)(function))
    compiled.add_overload, compiled._compile_for_args = keep, refuse
    return _cached(function, compiled)


def _cached(function: Function, compiled: Any) -> Function:
    compiled.enable_caching()
    # numba has no public way to say what an entry depends on; test_core_jit.py fails if this stops working
    compiled._cache._cache_file._source_stamp = source_stamp(Path(function.__code__.co_filename))
    return cast(Function, compiled)


def source_stamp(file: Path) -> str:
    """Hash of the contents of a source file and of every file of ours it imports, directly or through others."""
    found: set[Path] = set()
    waiting = [file]
    while waiting:
        path = waiting.pop()
        if path not in found:
            found.add(path)
            waiting += _imports(path)
    digest = hashlib.blake2b(digest_size=16)
    for name, path in sorted((_module_name(path), path) for path in found):
        digest.update(f"{name}\n".encode() + _contents(path))
    return digest.hexdigest()


def _module_name(path: Path) -> str:
    """Dotted name by where the file stands: `__name__` is of no use in a module run as a program."""
    parts = [path.stem]
    while (path.parent / "__init__.py").is_file() and len(parts) < 10:
        path = path.parent
        parts.insert(0, path.name)
    return ".".join(parts)


@functools.cache
def _contents(path: Path) -> bytes:
    return path.read_bytes() if path.is_file() else b""


@functools.cache
def _imports(path: Path) -> tuple[Path, ...]:
    """Files of ours a file imports."""
    names: set[str] = set()
    module = _module_name(path)
    for node in ast.walk(ast.parse(_contents(path))):
        if isinstance(node, ast.Import):
            names.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            parent = ".".join(module.split(".")[: -node.level]) if node.level else ""
            base = ".".join(part for part in (parent, node.module) if part)
            names.add(base)
            names.update(f"{base}.{alias.name}" for alias in node.names)  # a module, or a name in one: the latter has no file
    return tuple(file for name in sorted(names) if name.startswith(_OURS) for file in _files(name))


@functools.cache
def _files(name: str) -> tuple[Path, ...]:
    try:
        spec = importlib.util.find_spec(name)
    except (ImportError, ValueError):
        return ()
    return (Path(spec.origin),) if spec is not None and spec.origin is not None and spec.origin.endswith(".py") else ()

