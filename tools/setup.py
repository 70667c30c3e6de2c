"""Sets the workspace up on a fresh machine and keeps it up to date: `.venv`, colcon build, byte code, compiled kernels.

Lives here: `setup` (everything), `build` (only what changed in src/). Standard library only; started by tools/run.sh, which chooses the Python.
Does not live here: what the packages need (tools/requirements), tests (test.py). What goes wrong is said in one sentence with its cure.
"""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
import sysconfig
import time
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))
import numba_cache

ROOT = Path(__file__).resolve().parent.parent
VENV, BUILD, INSTALL, SRC, LOG = (ROOT / name for name in (".venv", "build", "install", "src", "log"))
SUPPORTED = ((3, 11), (3, 12))
CMAKE = (3, 21)
DISK_MB = 2500
FOREIGN = (
    "PYTHONPATH",
    "PYTHONHOME",
    "AMENT_PREFIX_PATH",
    "CMAKE_PREFIX_PATH",
    "COLCON_PREFIX_PATH",
    "LD_LIBRARY_PATH",
    "_ROS_WHEELS_BOOTSTRAP_COMPLETE",
)


class SetupError(Exception):
    """What is missing and how to get it, in one sentence."""


def check_python() -> None:
    """The running Python must be one the lock files were made for, with its headers."""
    if sys.version_info[:2] not in SUPPORTED:
        have = ".".join(map(str, sys.version_info[:2]))
        raise SetupError(
            f"RIINS needs Python 3.11 or 3.12, this is {have}: install one (apt install python3) or name it with PYTHON=/path/to/python3 make ..."
        )
    include = Path(sysconfig.get_paths()["include"])
    if not (include / "Python.h").is_file():
        version = f"python{sys.version_info[0]}.{sys.version_info[1]}"
        raise SetupError(
            f"the headers of {sys.executable} are missing ({include}/Python.h): install them (Debian, Ubuntu: apt install {version}-dev)"
        )


def check_tools() -> None:
    """Compilers that work with these headers, cmake and disk space; asked only when something has to be compiled."""
    source = "#include <Python.h>\n#include <cstdint>\nint main() { return 0; }\n"
    include = sysconfig.get_paths()["include"]
    for names, variable, language in ((("cc", "gcc", "clang"), "CC", "C"), (("c++", "g++", "clang++"), "CXX", "C++")):
        compiler = next((found for name in (os.environ.get(variable, ""), *names) if name and (found := shutil.which(name.split()[0]))), None)
        if compiler is None:
            raise SetupError(f"no {language} compiler was found: install one (Debian, Ubuntu: apt install build-essential) and run make again")
    tried = subprocess.run([compiler, "-x", "c++", "-fsyntax-only", "-I", include, "-"], input=source, text=True, capture_output=True, check=False)
    if tried.returncode:
        said = next((line for line in tried.stderr.splitlines() if "error" in line), f"exit status {tried.returncode}")
        raise SetupError(
            f"the compiler {compiler} cannot compile a one-line program ({said}): repair it (Debian, Ubuntu: apt install --reinstall build-essential)"
        )
    cure = f"install cmake {CMAKE[0]}.{CMAKE[1]} or newer (Debian, Ubuntu: apt install cmake) and run make again"
    if shutil.which("cmake") is None:
        raise SetupError(f"cmake was not found: {cure}")
    said = subprocess.run(["cmake", "--version"], text=True, capture_output=True, check=False).stdout
    version = re.search(r"(\d+)\.(\d+)", said)
    if version is None or (int(version[1]), int(version[2])) < CMAKE:
        raise SetupError(f"cmake is too old or does not run ({said.splitlines()[0] if said else 'no answer'}): {cure}")
    free = shutil.disk_usage(ROOT).free // 2**20
    if free < DISK_MB and not VENV.exists():
        raise SetupError(f"{ROOT} has {free} MB free and the set-up needs {DISK_MB} MB: free some space and run make again")


def make_environment() -> bool:
    """Create .venv from the lock of this Python unless it is there and complete; True if it was made."""
    version = f"{sys.version_info[0]}.{sys.version_info[1]}"
    stamp_file, stamp = VENV / "riins.stamp", f"{ROOT} {_venv_version() or version} {_lock_digest(_venv_version() or version)}"
    if stamp_file.is_file() and stamp_file.read_text() == stamp and (VENV / "bin" / "python").exists():
        return False
    check_python()
    check_tools()
    lock = ROOT / "tools" / "requirements" / f"lock-{version}.txt"
    shutil.rmtree(VENV, ignore_errors=True)
    started = time.monotonic()
    uv = _working_uv()
    log = LOG / "setup.txt"
    done = False
    if uv:
        say(f"installing the packages of {lock.name} into .venv with uv")
        done = _logged([uv, "venv", "-q", "--clear", "--python", sys.executable, str(VENV)], log) and _logged(
            [uv, "pip", "install", "-q", "--compile-bytecode", "--require-hashes", "--python", str(VENV / "bin" / "python"), "-r", str(lock)], log
        )
        if not done:
            say("uv did not succeed, trying pip")
            shutil.rmtree(VENV, ignore_errors=True)
    if not done:
        say(f"installing the packages of {lock.name} into .venv with pip (about a minute)")
        if not _logged([sys.executable, "-m", "venv", str(VENV)], log):
            cure = f"install its venv module (Debian, Ubuntu: apt install python{version}-venv) and run make again"
            raise SetupError(f"{sys.executable} cannot make a virtual environment ({_last_line(log)}): {cure}")
        pip = [str(VENV / "bin" / "python"), "-m", "pip", "install", "-q", "--disable-pip-version-check", "--no-input", "--require-hashes"]
        if not _logged([*pip, "-r", str(lock)], log):
            shutil.rmtree(VENV, ignore_errors=True)
            cure = f"check the network or the proxy and run make again; the whole story is in {_short(log)}"
            raise SetupError(f"the Python packages could not be installed ({_last_line(log)}): {cure}")
    stamp_file.write_text(f"{ROOT} {version} {_lock_digest(version)}")
    say(f".venv is ready ({time.monotonic() - started:.0f} s)")
    return True


def build() -> list[str]:
    """Run colcon for the packages that changed since the last time; their names."""
    stamps_file = BUILD / "riins_stamps.json"
    common = _digest([ROOT / "tools" / "fixup.cmake", VENV / "riins.stamp"])
    wanted = {package.name: f"{common[:16]} {_package_digest(package)}" for package in sorted(SRC.iterdir()) if (package / "package.xml").is_file()}
    try:
        have = json.loads(stamps_file.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        have = {}
    if have and next(iter(have.values())).split()[0] != common[:16]:  # another Python, another lock, or the directory was moved
        shutil.rmtree(BUILD, ignore_errors=True)
        shutil.rmtree(INSTALL, ignore_errors=True)
    changed = [name for name, digest in wanted.items() if have.get(name) != digest or not (INSTALL / name / "share" / name / "package.xml").is_file()]
    for name in sorted(have.keys() - wanted.keys()):
        shutil.rmtree(BUILD / name, ignore_errors=True)
        shutil.rmtree(INSTALL / name, ignore_errors=True)
    if not changed:
        return []
    if "riins_msgs" in changed:
        check_tools()
    started = time.monotonic()
    say(f"building {', '.join(changed)}")
    for name in changed:
        shutil.rmtree(BUILD / name / "build", ignore_errors=True)  # or setuptools installs modules that are gone from src/
    command = [str(VENV / "bin" / "python"), "-m", "colcon", "build", "--base-paths", "src", "--packages-select", *changed]
    command += ["--event-handlers", "console_direct-", "console_start_end+", "--cmake-args", "--no-warn-unused-cli"]
    command += [f"-DCMAKE_PROJECT_INCLUDE={ROOT / 'tools' / 'fixup.cmake'}", f"-DPython3_EXECUTABLE={VENV / 'bin' / 'python'}", "-DBUILD_TESTING=ON"]
    command += ["-DCMAKE_BUILD_TYPE=Release"]
    if not _logged(command, LOG / "build.txt", environment()):
        raise SetupError(_build_failure())
    for name in changed:
        _remove_stale(name)
        _pin_interpreter(name)
    subprocess.run([str(VENV / "bin" / "python"), "-m", "compileall", "-q", *_site_packages(changed)], env=environment(), check=False)
    for root, state in ((_installed_packages(), "numba_install.json"), ((p for p in SRC.glob("*/riins_*") if p.is_dir()), "numba_src.json")):
        numba_cache.purge(root, BUILD / state)
    stamps_file.write_text(json.dumps(wanted, indent=0), encoding="utf-8")
    say(f"built {len(changed)} of {len(wanted)} packages ({time.monotonic() - started:.0f} s)")
    return changed


def warm_up() -> None:
    """Compile every kernel into the cache beside the installed modules, unless that was done for this very source."""
    stamp_file = BUILD / "riins_warm"
    stamp = _digest([BUILD / "riins_stamps.json", ROOT / "tools" / "warm_up.py"])
    if stamp_file.is_file() and stamp_file.read_text() == stamp:
        return
    started = time.monotonic()
    say("compiling the kernels into their cache (a minute or two the first time)")
    if not _logged([str(ROOT / "riins"), "exec", "python", str(ROOT / "tools" / "warm_up.py")], LOG / "warm_up.txt"):
        raise SetupError(
            f"the kernels could not be compiled ({_last_line(LOG / 'warm_up.txt')}): the whole story is in {_short(LOG / 'warm_up.txt')}"
        )
    stamp_file.write_text(stamp)
    say(f"kernels are compiled ({time.monotonic() - started:.0f} s)")


def environment() -> dict[str, str]:
    """Environment of the build: this workspace's .venv alone, whatever was sourced in the calling shell."""
    env = {name: value for name, value in os.environ.items() if name not in FOREIGN and name != "PYTHONDONTWRITEBYTECODE"}
    env["PATH"] = f"{VENV / 'bin'}{os.pathsep}{env.get('PATH', '')}"
    env["VIRTUAL_ENV"] = env["AMENT_PREFIX_PATH"] = env["CMAKE_PREFIX_PATH"] = str(VENV)
    return env


def say(text: str) -> None:
    """One line of progress."""
    print(f"setup: {text}", flush=True)


def main(arguments: Sequence[str]) -> int:
    """Entry point; exit status 0, or 1 with one sentence."""
    try:
        if sys.version_info[:2] not in SUPPORTED:
            check_python()
        LOG.mkdir(exist_ok=True)
        with _alone():
            made = make_environment()
            changed = build()
            if list(arguments) != ["build"]:
                warm_up()
        if not made and not changed:
            say("up to date")
    except SetupError as error:
        print(f"setup: {error}", file=sys.stderr)
        return 1
    except OSError as error:
        print(f"setup: {error.strerror or error} ({error.filename}): put that right and run make again", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("setup: interrupted; run make again to go on", file=sys.stderr)
        return 130
    return 0


@contextlib.contextmanager
def _alone() -> Iterator[None]:
    """One set-up at a time."""
    with (LOG / "setup.lock").open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            say("another make is at work here, waiting for it")
            fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def _venv_version() -> str:
    """Version of the Python that .venv was made with, '' if none."""
    try:
        text = (VENV / "riins.stamp").read_text()
    except OSError:
        return ""
    return "" if os.environ.get("PYTHON") and f" {sys.version_info[0]}.{sys.version_info[1]} " not in text else text.rsplit(" ", 2)[1]


def _lock_digest(version: str) -> str:
    return _digest([ROOT / "tools" / "requirements" / f"lock-{version}.txt"])


def _working_uv() -> str | None:
    uv = shutil.which("uv")
    if uv and subprocess.run([uv, "--version"], capture_output=True, check=False).returncode == 0:
        return uv
    return None


def _logged(command: Sequence[str], log: Path, env: dict[str, str] | None = None) -> bool:
    """Run a command with its output in a file; True for exit status 0."""
    if env is None:
        env = {name: value for name, value in os.environ.items() if name not in FOREIGN}
    log.parent.mkdir(exist_ok=True)
    with log.open("w", encoding="utf-8") as stream:
        stream.write(f"$ {' '.join(command)}\n")
        stream.flush()
        try:
            return (
                subprocess.run(command, stdin=subprocess.DEVNULL, stdout=stream, stderr=subprocess.STDOUT, cwd=ROOT, env=env, check=False).returncode
                == 0
            )
        except OSError as error:
            stream.write(f"{error}\n")
            return False


def _last_line(log: Path) -> str:
    """The line of a log that says most: the last one with 'error' in it, else the last."""
    lines = [line.strip() for line in log.read_text(encoding="utf-8", errors="replace").splitlines() if line.strip()]
    telling = [line for line in lines[1:] if re.search(r"error|failed|cannot", line, re.IGNORECASE)]
    return (telling or lines or ["no output"])[-1][:300]


def _build_failure() -> str:
    """Print the last lines of what went wrong and name the package."""
    said = (LOG / "build.txt").read_text(encoding="utf-8", errors="replace")
    failed = re.search(r"^Failed\s+<<<\s+(\S+)", said, re.MULTILINE)
    log = LOG / "latest_build" / failed[1] / "stdout_stderr.log" if failed else LOG / "build.txt"
    log = log if log.is_file() and log.stat().st_size else LOG / "build.txt"
    print("\n".join(log.read_text(encoding="utf-8", errors="replace").splitlines()[-25:]), file=sys.stderr)
    name = f"package {failed[1]}" if failed else "the workspace"
    return f"{name} does not build (its last lines are above, all of them in {_short(log)}): correct that and run make again"


def _short(path: Path) -> str:
    return str(path.relative_to(ROOT))


def _digest(files: Iterable[Path]) -> str:
    digest = hashlib.sha256()
    for file in files:
        digest.update(str(file.relative_to(ROOT)).encode() + b"\0" + (file.read_bytes() if file.is_file() else b"") + b"\0")
    return digest.hexdigest()


def _package_digest(package: Path) -> str:
    """Content of everything that is built or installed: not tests, not READMEs, not caches."""
    skip = {"test", "__pycache__", ".pytest_cache", ".hypothesis", ".mypy_cache", ".ruff_cache"}
    files = (f for f in package.rglob("*") if f.is_file() and not skip & set(f.relative_to(package).parts))
    return _digest(sorted(f for f in files if f.suffix not in (".md", ".nbi", ".nbc")))


def _site_packages(names: Iterable[str]) -> list[str]:
    return [str(path) for name in names for path in INSTALL.glob(f"{name}/lib/python*/site-packages")]


def _installed_packages() -> Iterable[Path]:
    return (path for path in INSTALL.glob("riins_*/lib/python*/site-packages/riins_*") if path.is_dir() and path.name == path.parents[3].name)


def _remove_stale(name: str) -> None:
    """Remove what setuptools left behind of deleted or renamed files; kernels cached beside files that stay are kept."""
    log = BUILD / name / "install.log"
    if not log.is_file():
        return
    kept = set(log.read_text(encoding="utf-8").splitlines())
    for pattern in ("lib/python*/site-packages/riins_*/**/*", f"lib/{name}/*", f"share/{name}/*/*"):
        for file in (INSTALL / name).glob(pattern):
            ours = "__pycache__" not in file.parts and file.parent.name not in ("hook", "environment")
            if ours and file.is_file() and str(file) not in kept:
                file.unlink()


def _pin_interpreter(name: str) -> None:
    """Executables start with .venv's Python even in a shell that has not activated it (setup.cfg says `env python3`, for ROS installations)."""
    for script in (INSTALL / name / "lib" / name).glob("*"):
        first, _, rest = script.read_text(encoding="utf-8").partition("\n")
        if first == "#!/usr/bin/env python3":
            script.write_text(f"#!{VENV / 'bin' / 'python'}\n{rest}", encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
