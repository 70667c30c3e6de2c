"""The set-up: what it says on a machine that lacks something, and that compiled kernels are kept when they may be and dropped when they must."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import sysconfig
import time
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).resolve().parents[1]
BASE_PYTHON = Path(sys._base_executable).resolve()  # type: ignore[attr-defined]


@pytest.fixture
def bare(tmp_path: Path) -> Path:
    """A workspace with nothing but tools/, and a PATH of its own in bin/ with sh, dirname and a working Python."""
    shutil.copytree(ROOT / "tools", tmp_path / "tools", ignore=shutil.ignore_patterns("__pycache__"))
    (tmp_path / "src").mkdir()
    programs = tmp_path / "bin"
    programs.mkdir()
    for name in ("sh", "dirname"):
        (programs / name).symlink_to(str(shutil.which(name)))
    (programs / "python3").symlink_to(BASE_PYTHON)
    return tmp_path


def fake(bare: Path, name: str, text: str) -> None:
    """Put a shell script on the PATH."""
    file = bare / "bin" / name
    file.unlink(missing_ok=True)
    file.write_text(f"#!{bare / 'bin' / 'sh'}\n{text}\n")
    file.chmod(0o755)


def set_up(bare: Path, **variables: str) -> str:
    """Run the set-up, which must fail, and return the one sentence it says."""
    env = {"PATH": str(bare / "bin"), "HOME": str(bare), **variables}
    command = [bare / "bin" / "sh", "tools/run.sh", "tools/setup.py", "setup"]
    done = subprocess.run(command, cwd=bare, env=env, capture_output=True, text=True, check=False)
    assert done.returncode == 1, done.stdout + done.stderr
    assert "Traceback" not in done.stderr
    lines = done.stderr.strip().splitlines()
    assert len(lines) == 1, done.stderr
    assert lines[0].startswith("setup: ")
    return lines[0]


def real(bare: Path, *names: str) -> None:
    """Put programs of this machine on the PATH."""
    for name in names:
        target = shutil.which(name)
        assert target, f"this machine has no {name}"
        (bare / "bin" / name).symlink_to(target)


def test_no_python(bare: Path) -> None:
    fake(bare, "python3", 'echo "pyenv: python3: command not found" >&2; exit 127')
    assert "needs Python 3.11 or 3.12 and none was found: install one" in set_up(bare)


def test_shim_that_fails_is_passed_over(bare: Path) -> None:
    fake(bare, "python3.12", 'echo "pyenv: python3.12: command not found" >&2; exit 127')
    assert "no C compiler" in set_up(bare)  # it got as far as the next thing missing


def test_no_compiler(bare: Path) -> None:
    assert "no C compiler was found: install one (Debian, Ubuntu: apt install build-essential)" in set_up(bare)
    real(bare, "gcc")
    assert "no C++ compiler was found" in set_up(bare)


def test_compiler_that_does_not_compile(bare: Path) -> None:
    real(bare, "gcc")
    fake(bare, "g++", 'echo "fatal error: cc1plus not found" >&2; exit 1')
    said = set_up(bare)
    assert "cannot compile a one-line program (fatal error: cc1plus not found)" in said and "apt install" in said


def test_no_cmake_or_an_old_one(bare: Path) -> None:
    real(bare, "gcc", "g++", "as", "ld")
    assert "cmake was not found: install cmake 3.21 or newer" in set_up(bare)
    fake(bare, "cmake", 'echo "cmake version 3.10.2"')
    assert "cmake is too old or does not run (cmake version 3.10.2): install cmake 3.21 or newer" in set_up(bare)


def test_failed_download(bare: Path) -> None:
    real(bare, "gcc", "g++", "as", "ld", "cmake")
    nowhere = {"PIP_INDEX_URL": "http://127.0.0.1:9/simple", "PIP_EXTRA_INDEX_URL": "", "PIP_CONFIG_FILE": os.devnull}
    said = set_up(bare, PIP_RETRIES="0", PIP_TIMEOUT="2", PIP_NO_CACHE_DIR="1", **nowhere)
    assert "the Python packages could not be installed (" in said and "check the network or the proxy and run make again" in said
    assert not (bare / ".venv").exists()  # the next call starts afresh


@pytest.fixture
def tool(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """tools/setup.py as a module."""
    monkeypatch.syspath_prepend(str(ROOT / "tools"))
    sys.modules.pop("setup", None)
    import setup

    return setup


def test_missing_headers(tool: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(sysconfig, "get_paths", lambda: {"include": str(tmp_path)})
    with pytest.raises(tool.SetupError, match=r"the headers of .* are missing .*: install them .*apt install python3\.1[12]-dev"):
        tool.check_python()


def test_old_python(tool: ModuleType, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(sys, "version_info", (3, 8, 10))
    assert tool.main(["setup"]) == 1
    assert "needs Python 3.11 or 3.12, this is 3.8: install one" in capsys.readouterr().err


def test_nothing_changed_is_quick() -> None:
    started = time.monotonic()
    done = subprocess.run(["sh", "tools/run.sh", "tools/setup.py", "build"], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "up to date" in done.stdout or "built" in done.stdout
    assert time.monotonic() - started < 60.0 if "built" in done.stdout else 10.0


def test_rebuilding_an_unchanged_file_keeps_its_kernels() -> None:
    """numba knows a file by time and size: the installed file has those of the source, so installing it again changes nothing."""
    installed = next((ROOT / "install" / "riins_core").glob("lib/python*/site-packages/riins_core"))
    source = ROOT / "src" / "riins_core" / "riins_core"
    same = [f for f in installed.glob("*.py") if (source / f.name).is_file() and f.read_bytes() == (source / f.name).read_bytes()]
    assert same
    for file in same:
        assert int(file.stat().st_mtime) == int((source / file.name).stat().st_mtime), file.name
    assert list(installed.glob("__pycache__/strapdown.*.nbi")), "the kernels of the strapdown are not compiled beside the installed module"


def test_kernels_are_dropped_when_a_kernel_they_call_changes(tmp_path: Path) -> None:
    """numba alone would run the old callee; with the purge of the set-up the new one runs, and kernels that do not depend on it stay."""
    package = tmp_path / "riins_made_up"
    package.mkdir()
    (package / "__init__.py").write_text('"""Made up."""\n')
    (package / "callee.py").write_text("import numba\n\n\n@numba.njit(cache=True)\ndef f(x):\n    return x + 1.0\n")
    (package / "caller.py").write_text("import numba\nfrom .callee import f\n\n\n@numba.njit(cache=True)\ndef g(x):\n    return 2.0 * f(x)\n")
    (package / "other.py").write_text("import numba\n\n\n@numba.njit(cache=True)\ndef h(x):\n    return 3.0 * x\n")
    program = (
        f"import sys; sys.path[:0] = [{str(tmp_path)!r}, {str(ROOT / 'tools')!r}]\n"
        "import numba_cache; from pathlib import Path\n"
        f"if sys.argv[1] == 'purge': numba_cache.purge([Path({str(package)!r})], Path({str(tmp_path / 'state.json')!r}))\n"
        "from riins_made_up import caller, other\n"
        "print(caller.g(1.0), other.h(1.0), sum(other.h.stats.cache_hits.values()))\n"
    )

    def run(mode: str) -> list[float]:
        done = subprocess.run([sys.executable, "-c", program, mode], capture_output=True, text=True, check=True)
        return [float(word) for word in done.stdout.split()]

    assert run("purge") == [4.0, 3.0, 0.0]
    callee = package / "callee.py"
    callee.write_text(callee.read_text().replace("1.0", "10.0"))
    assert run("leave") == [4.0, 3.0, 1.0]  # this is what numba does by itself: the old callee
    assert run("purge") == [22.0, 3.0, 1.0]
