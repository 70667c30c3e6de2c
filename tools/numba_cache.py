"""Drops compiled kernels that numba would wrongly keep.

Lives here: `purge`. numba recompiles a kernel when its own file changes, not when a kernel it calls in another file does. So each module has a
fingerprint of itself and of every RIINS module it imports, directly or not; where that changed, its cached kernels are removed.
Does not live here: where the cache is (beside the installed modules, so that it serves `ros2 run` as well), warming it (warm_up.py).
"""

from __future__ import annotations

import ast
import hashlib
import json
from collections.abc import Iterable
from pathlib import Path


def purge(packages: Iterable[Path], state_file: Path) -> int:
    """Remove cached kernels of modules that changed, themselves or in what they import.

    Parameters
    ----------
    packages : directories of Python packages, e.g. install/riins_core/lib/python3.11/site-packages/riins_core
    state_file : JSON with the fingerprints of the last call; written anew

    Returns
    -------
    number of files removed
    """
    modules = {name: file for package in packages for name, file in _modules(package)}
    contents = {name: file.read_bytes() for name, file in modules.items()}
    imports = {name: _imports(name, modules[name], contents[name], modules) for name in modules}
    fingerprints = {name: _fingerprint(name, contents, imports) for name in modules}
    try:
        before = json.loads(state_file.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        before = {}
    removed = 0
    for name, file in modules.items():
        if before.get(str(file)) != fingerprints[name]:
            for cached in file.parent.glob(f"__pycache__/{file.stem}.*.nb[ic]"):
                cached.unlink(missing_ok=True)
                removed += 1
    state_file.parent.mkdir(parents=True, exist_ok=True)
    state_file.write_text(json.dumps({str(modules[name]): value for name, value in fingerprints.items()}, indent=0), encoding="utf-8")
    return removed


def _modules(package: Path) -> Iterable[tuple[str, Path]]:
    for file in sorted(package.rglob("*.py")):
        parts = (package.name, *file.relative_to(package).with_suffix("").parts)
        yield ".".join(parts[:-1] if parts[-1] == "__init__" else parts), file


def _imports(name: str, file: Path, content: bytes, modules: dict[str, Path]) -> set[str]:
    parents = name.split(".") if file.name == "__init__.py" else name.split(".")[:-1]
    found: set[str] = set()
    for node in ast.walk(ast.parse(content)):
        if isinstance(node, ast.Import):
            found.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            stem = parents[: len(parents) - node.level + 1] if node.level else []
            base = ".".join([*stem, *([node.module] if node.module else [])])
            found.add(base)
            found.update(f"{base}.{alias.name}" for alias in node.names)
    return {one for one in found if one in modules}


def _fingerprint(name: str, contents: dict[str, bytes], imports: dict[str, set[str]]) -> str:
    reached, todo = {name}, [name]
    while todo:
        fresh = imports[todo.pop()] - reached
        reached |= fresh
        todo += fresh
    digest = hashlib.sha256()
    for one in sorted(reached):
        digest.update(one.encode() + b"\0" + contents[one] + b"\0")
    return digest.hexdigest()
