"""The shape of the workspace, held by tests: floors, where ROS may be, docstrings, sizes, package manifests."""

from __future__ import annotations

import ast
import re
import subprocess
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
SRC = ROOT / "src"
FLOORS = {
    "riins_msgs": 0,
    "riins_core": 1,
    "riins_node": 1,
    "riins_sim": 2,
    "riins_fdi": 2,
    "riins_bag": 2,
    "riins_nmea": 2,
    "riins_imu_fusion": 3,
    "riins_federated": 4,
    "riins_eval": 5,
    "riins_bringup": 6,
}
SAME_FLOOR = {("riins_node", "riins_core")}  # node plumbing stands on the mathematics' settings and frames
ROS = re.compile(r"^(rclpy|rcl_interfaces|builtin_interfaces|ament_index_python|launch|launch_ros|lifecycle_msgs|rosgraph_msgs|\w+_msgs)(\.|$)")
PIP = ("numba", "mcap", "rosbags", "zstandard", "typer", "rich", "plotly", "pynmeagps")  # no rosdep key on Ubuntu 24.04
_SHARED = ("alignment_fields", "fields", "message_parts", "readings", "status_fields")  # with the offline engine
ROS_FREE_MODULES = {f"riins_node/{name}.py" for name in _SHARED}
LONGEST, LONGEST_NODE = 420, 260  # lines
MODULES = sorted(f for f in SRC.glob("riins_*/riins_*/**/*.py") if "__pycache__" not in f.parts)
NAMES = [str(f.relative_to(SRC).as_posix()).partition("/")[2] for f in MODULES]


def imports(tree: ast.AST) -> Iterator[str]:
    """Absolute module names that a module imports, wherever in it."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            yield node.module


def may_know_ros(name: str) -> bool:
    """Whether ROS may be imported by this module: nodes, the plumbing of nodes, and what starts them."""
    if name in ROS_FREE_MODULES:
        return False
    return name.endswith("/node.py") or "/nodes/" in name or name.startswith(("riins_node/", "riins_bringup/"))


def test_every_package_has_a_floor() -> None:
    assert {path.parent.name for path in SRC.glob("*/package.xml")} == set(FLOORS)


@pytest.mark.parametrize("module", MODULES, ids=NAMES)
def test_imports_go_down(module: Path) -> None:
    package = module.relative_to(SRC).parts[0]
    for name in imports(ast.parse(module.read_text(encoding="utf-8"))):
        other = name.partition(".")[0]
        if other in FLOORS and other != package and (package, other) not in SAME_FLOOR:
            assert FLOORS[other] < FLOORS[package], f"{package} (floor {FLOORS[package]}) imports {name} (floor {FLOORS[other]})"


@pytest.mark.parametrize(("module", "name"), list(zip(MODULES, NAMES, strict=True)), ids=NAMES)
def test_ros_stays_in_the_nodes(module: Path, name: str) -> None:
    found = sorted({one for one in imports(ast.parse(module.read_text(encoding="utf-8"))) if ROS.match(one)})
    assert may_know_ros(name) or not found, f"{name} imports {', '.join(found)}"


@pytest.mark.parametrize("module", MODULES, ids=NAMES)
def test_everything_public_is_described(module: Path) -> None:
    tree = ast.parse(module.read_text(encoding="utf-8"))
    assert ast.get_docstring(tree), "the module has no docstring"
    bare = []
    for node in tree.body:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef) and not node.name.startswith("_"):
            if not ast.get_docstring(node):
                bare.append(node.name)
            if isinstance(node, ast.ClassDef):
                methods = [m for m in node.body if isinstance(m, ast.FunctionDef | ast.AsyncFunctionDef) and not m.name.startswith("_")]
                bare += [f"{node.name}.{m.name}" for m in methods if not ast.get_docstring(m) and not inherited(m)]
    assert not bare, f"without a docstring: {', '.join(bare)}"


def inherited(method: ast.FunctionDef | ast.AsyncFunctionDef) -> bool:
    """Lifecycle callbacks of rclpy and ROS callbacks named on_... are described where they come from."""
    return method.name.startswith("on_") or method.name in ("destroy_node",)


@pytest.mark.parametrize(("module", "name"), list(zip(MODULES, NAMES, strict=True)), ids=NAMES)
def test_files_are_short(module: Path, name: str) -> None:
    node = name.endswith("/node.py") or "/nodes/" in name
    assert len(module.read_text(encoding="utf-8").splitlines()) <= (LONGEST_NODE if node else LONGEST)


@pytest.mark.parametrize("module", [m for m, name in zip(MODULES, NAMES, strict=True) if name.endswith("/node.py") or "/nodes/" in name], ids=str)
def test_nodes_leave_the_attributes_of_rclpy_alone(module: Path) -> None:
    """A node that had a list of its own under the name `_services` answered no `ros2 param` any more."""
    ros_node = pytest.importorskip("rclpy.node", reason="needs ROS 2")
    theirs = re.findall(r"self\.(_[a-z]\w*)\s*[:=]", Path(ros_node.__file__).read_text(encoding="utf-8"))
    ours = re.findall(r"self\.(_[a-z]\w*)\s*[:=]", module.read_text(encoding="utf-8"))
    assert theirs and not set(theirs) & set(ours)


@pytest.mark.parametrize("package", sorted(FLOORS))
def test_manifest_is_honest(package: str) -> None:
    """What a package imports it declares, and it declares no RIINS package that it does not import."""
    manifest = ElementTree.parse(SRC / package / "package.xml").getroot()
    declared = {element.text for tag in ("depend", "exec_depend", "build_depend") for element in manifest.iter(tag)}
    assert manifest.get("format") == "3" and manifest.findtext("license") == "Apache-2.0"
    assert any(element.text in ("python3-pytest", "ament_cmake_pytest") for element in manifest.iter("test_depend"))
    used: set[str] = set()
    for module in MODULES:
        if module.relative_to(SRC).parts[0] == package:
            used |= {name.partition(".")[0] for name in imports(ast.parse(module.read_text(encoding="utf-8")))}
    for name in sorted(used - {package}):
        if name in FLOORS or ROS.match(name):
            assert name in declared, f"{package} imports {name} and does not declare it"
    for name in ("numpy", "scipy", "yaml", "matplotlib", "jinja2", "serial"):
        assert (name in used) == (f"python3-{name}" in declared), f"{package}: {name} is imported or declared, not both"
    listed = (ROOT / "requirements.txt").read_text(encoding="utf-8")
    for name in sorted(used & set(PIP)):
        assert re.search(rf"^{name}\b", listed, re.MULTILINE), f"{name} is not in requirements.txt"
        assert name in (SRC / package / "package.xml").read_text(encoding="utf-8"), f"{package}/package.xml does not speak of {name}"
    unused = {name for name in declared if name in FLOORS} - used
    assert package == "riins_msgs" or not unused, f"{package} declares {', '.join(sorted(unused))} and imports nothing of it"


@pytest.mark.parametrize("package", sorted(FLOORS))
def test_package_introduces_itself(package: str) -> None:
    readme = SRC / package / "README.md"
    assert readme.is_file(), "no README.md"
    lines = readme.read_text(encoding="utf-8").splitlines()
    assert lines[0].startswith("# ") and 10 <= len(lines) <= 90, f"{len(lines)} lines: a screen is wanted"
    assert list((SRC / package / "test").glob("test_*.py")), "no test"


def tracked_files() -> list[Path]:
    """Text files that belong to the project."""
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=False)
    names = listed.stdout.splitlines() if listed.returncode == 0 else []
    return [ROOT / name for name in names if (ROOT / name).is_file() and Path(name).suffix not in (".mcap", ".png", ".npz")]


def test_nothing_of_one_machine_is_in_the_project() -> None:
    """No home or work directory, package host or leftover mark in any file of the project."""
    # put together here so that this file does not hold them itself
    words = ["/" + "work/", "/" + "root/", "/tmp/" + "w/", "/ho" + "me/", "index-" + "url", "TO" + "DO", "FIX" + "ME", "X" * 3]
    pattern = re.compile("|".join(map(re.escape, words)))
    found = []
    for file in tracked_files():
        if file.name == "LICENSE" or "lock-" in file.name:
            continue
        try:
            text = file.read_text(encoding="utf-8")
        except UnicodeDecodeError:
            continue
        found += [f"{file.relative_to(ROOT)}:{n}: {line.strip()[:80]}" for n, line in enumerate(text.splitlines(), 1) if pattern.search(line)]
    assert not found, "\n".join(found)


def test_locks_name_no_host() -> None:
    for version in ("3.11", "3.12"):
        text = (ROOT / "tools" / "requirements" / f"lock-{version}.txt").read_text(encoding="utf-8")
        assert "://" not in text and "--index" not in text
        assert text.count("--hash=sha256:") > 100
