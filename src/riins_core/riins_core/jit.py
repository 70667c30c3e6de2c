"""Compilation of kernels: numba's njit with the types of the function kept, and the rules a kernel obeys.

Lives here: `jit`. Kernels work sample by sample on plain arrays, call no BLAS and never use fastmath, so a result cannot depend on the block size.
Does not live here: any mathematics, and the warming of kernels (each algorithm object has its own `warm_up`).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba

Function = TypeVar("Function", bound=Callable[..., Any])


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
    The cache notices a change of the file a kernel stands in, not of kernels it calls in other files: after editing a kernel
    that others call, remove the `__pycache__` directories. Installing anew does that, since it writes every file.
    """
    return cast(Function, numba.njit(cache=True)(function))
