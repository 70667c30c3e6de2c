"""The kernel cache: an entry is used again by another process, and not after a change of a file the kernel depends on."""

import os
import subprocess
import sys
from pathlib import Path

import riins_core
from riins_core.jit import source_stamp

ROOT = Path(riins_core.__file__).parent

CALLEE = """
from riins_core.jit import jit

FACTOR = {factor}

@jit
def scaled(x: float) -> float:
    return FACTOR * x
"""
CALLER = """
from riins_core.jit import jit

from .callee import scaled

@jit
def kernel(x: float) -> float:
    return scaled(x) + 1.0

print(kernel(10.0), len(kernel.stats.cache_hits))
"""


def run(folder):
    path = os.pathsep.join([str(folder), str(ROOT.parent), os.environ.get("PYTHONPATH", "")])
    # no byte code: Python's own cache sees dates of whole seconds only
    environment = dict(os.environ, PYTHONPATH=path, PYTHONDONTWRITEBYTECODE="1")
    done = subprocess.run([sys.executable, "-m", "riins_probe.caller"], env=environment, capture_output=True, text=True, check=True)
    value, hits = done.stdout.split()
    return float(value), int(hits)


def test_cache_follows_changes_of_other_files(tmp_path):
    package = tmp_path / "riins_probe"
    package.mkdir()
    (package / "__init__.py").touch()
    (package / "caller.py").write_text(CALLER, encoding="utf-8")
    (package / "callee.py").write_text(CALLEE.format(factor=2.0), encoding="utf-8")
    assert run(tmp_path) == (21.0, 0)
    assert run(tmp_path) == (21.0, 1)
    (package / "callee.py").write_text(CALLEE.format(factor=3.0), encoding="utf-8")
    assert run(tmp_path) == (31.0, 0)  # numba alone goes on with 21


def test_stamp_covers_indirect_imports_and_ignores_dates(tmp_path):
    files = {"a": "from . import b\n", "b": "import math\nfrom .c import X\n", "c": "X = 1\n", "d": "Y = 1\n", "__init__": ""}
    package = tmp_path / "riins_stamped"
    package.mkdir()
    code = (
        "import sys; sys.path[:0] = [{!r}, {!r}]\n"
        "from pathlib import Path\n"
        "from riins_core.jit import source_stamp\n"
        "print(source_stamp(Path({!r})))"
    )

    def stamp(**changed):
        for name, text in {**files, **changed}.items():
            (package / f"{name}.py").write_text(text, encoding="utf-8")
        program = code.format(str(tmp_path), str(ROOT.parent), str(package / "a.py"))
        return subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout

    first = stamp()
    assert stamp() == first
    assert stamp(c="X = 2\n") != first
    assert stamp(d="Y = 2\n") == first


def test_the_strapdown_depends_on_the_earth_and_the_noise_does_not(monkeypatch):
    from riins_core import jit

    before = {name: source_stamp(ROOT / f"{name}.py") for name in ("strapdown", "ins_error", "noise")}
    real = jit._contents
    monkeypatch.setattr(jit, "_contents", lambda path: real(path) + (b"\n# changed" if path.name == "earth.py" else b""))
    after = {name: source_stamp(ROOT / f"{name}.py") for name in before}
    assert [name for name in before if before[name] != after[name]] == ["strapdown", "ins_error"]
