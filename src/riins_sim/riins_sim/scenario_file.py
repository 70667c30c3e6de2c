"""YAML of a scenario with line numbers, and where shipped scenarios are found.

Lives here: `ScenarioError`, `parse` (text to mapping and the line of every key), `find` (name to path).
Does not live here: what the keys mean (scenario.py).
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from riins_core.settings import SettingError, nearest

_DEEPEST = 20

Lines = Mapping[tuple[str, ...], int]


class ScenarioError(SettingError):
    """A scenario cannot be found or read; one line: FILE:LINE: what is wrong and what may have been meant."""


class _Loader(yaml.SafeLoader):
    """Safe YAML that also reads 1e-3 as a number, as YAML 1.2 does."""


_Loader.add_implicit_resolver("tag:yaml.org,2002:float", re.compile(r"^[-+]?[0-9]+(\.[0-9]*)?[eE][-+]?[0-9]+$"), list("-+0123456789"))


def parse(text: str, name: str) -> tuple[dict[str, Any], dict[tuple[str, ...], int]]:
    """Read a YAML mapping and remember where each key stands.

    Parameters
    ----------
    text : YAML
    name : of the file, for messages

    Returns
    -------
    the mapping, and the line of each path (list items by their number as text)

    Raises
    ------
    ScenarioError
        No YAML, no mapping, a key given twice, or a merge that YAML cannot make.
    """
    loader: _Loader | None = None
    try:
        loader = _Loader(text)
        node = loader.get_single_node()
        lines: dict[tuple[str, ...], int] = {}
        if not isinstance(node, yaml.MappingNode):
            raise ScenarioError(
                f"{name}:1: a scenario is a mapping of sections; this file {'is empty' if node is None else 'holds a list or a word'}"
            )
        _walk(node, (), lines, name)
        values: dict[str, Any] = loader.construct_document(node)
    except yaml.MarkedYAMLError as error:
        line = error.problem_mark.line + 1 if error.problem_mark else 1
        raise ScenarioError(f"{name}:{line}: {error.problem or error.context}") from None
    except yaml.YAMLError as error:
        raise ScenarioError(f"{name}:1: {str(error).splitlines()[0]}") from None
    except ScenarioError:
        raise
    except ValueError as error:  # a date that is none, a number of thousands of digits
        raise ScenarioError(f"{name}: a value cannot be read: {error}") from None
    finally:
        if loader is not None:
            loader.dispose()
    return values, lines


def _walk(node: yaml.Node, path: tuple[str, ...], lines: dict[tuple[str, ...], int], name: str) -> None:
    if len(path) > _DEEPEST:  # an alias may contain itself
        raise ScenarioError(f"{name}:{node.start_mark.line + 1}: nested too deeply")
    if isinstance(node, yaml.MappingNode):
        for key, value in node.value:
            here = (*path, str(key.value))
            if here in lines:
                raise ScenarioError(f'{name}:{key.start_mark.line + 1}: "{key.value}" is given twice, first in line {lines[here]}')
            lines[here] = key.start_mark.line + 1
            _walk(value, here, lines, name)
    elif isinstance(node, yaml.SequenceNode):
        for i, item in enumerate(node.value):
            here = (*path, str(i))
            lines[here] = item.start_mark.line + 1
            _walk(item, here, lines, name)


def line_of(lines: Lines, path: tuple[str, ...]) -> int:
    """Line of a path, or of the nearest section around it."""
    while path and path not in lines:
        path = path[:-1]
    return lines.get(path, 1)


def directories() -> list[Path]:
    """Directories of shipped scenarios: of the installed riins_bringup, then of the source tree."""
    prefixes = [Path(p) / "share" / "riins_bringup" / "scenarios" for p in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if p]
    # an installed riins_sim stands in PREFIX/lib/python3.x/site-packages, a source tree has src/riins_sim/riins_sim beside src/riins_bringup
    here = Path(__file__).resolve()
    beside = [parent / "riins_bringup" / "scenarios" for parent in here.parents[2:3]]
    installed = [parent / "share" / "riins_bringup" / "scenarios" for parent in here.parents[4:5]]
    isolated = [parent / "riins_bringup" / "share" / "riins_bringup" / "scenarios" for parent in here.parents[5:6]]
    return [d for d in (*prefixes, *beside, *installed, *isolated) if d.is_dir()]


def names() -> list[str]:
    """Names of the shipped scenarios, sorted."""
    return sorted({path.stem for directory in directories() for path in directory.glob("*.yaml")})


def find(path_or_name: str | Path) -> Path:
    """File of a scenario.

    Parameters
    ----------
    path_or_name : a YAML file, or the name of a shipped scenario

    Raises
    ------
    ScenarioError
        There is none; the shipped names are listed, the nearest first.
    """
    word = str(path_or_name)
    path = Path(word)
    if path.is_file():
        return path
    if path.suffix not in (".yaml", ".yml") and len(path.parts) <= 1:
        for directory in directories():
            shipped = directory / f"{word}.yaml"
            if shipped.is_file():
                return shipped
        known = names()
        what = f'no scenario "{word}"{nearest(word, known)}' if word else "no scenario is named"
        raise ScenarioError(f"{what}; shipped: {', '.join(known) or 'none found'}")
    wrong = "a directory" if path.is_dir() else "no regular file" if path.exists() else "no such file"
    raise ScenarioError(f"{word}: {wrong}; a YAML file or the name of a shipped scenario is wanted: {', '.join(names()) or 'none found'}")
