"""`make test`: ruff, mypy, each package's tests through colcon, then the whole-system tests; one line that sums all at the end.

Lives here: the order, the gate (a package that reports no test fails), the sum.
Does not live here: the tests (src/PKG/test and test/). Runs in the workspace's environment (./riins exec).
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import time
import xml.etree.ElementTree as ElementTree
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
BUILD, SRC, LOG = ROOT / "build", ROOT / "src", ROOT / "log"
SYSTEM_RESULTS = BUILD / "system_tests.xml"
RESULT_LINE = re.compile(
    r"^build/(?P<package>[^/]+)/\S+\.xml: (?P<tests>\d+) tests?, (?P<errors>\d+) errors?, (?P<failures>\d+) failures?, (?P<skipped>\d+) skipped"
)


@dataclass
class Sum:
    """Passed, failed and skipped tests."""

    passed: int = 0
    failed: int = 0
    skipped: int = 0

    def add(self, tests: int, bad: int, skipped: int) -> None:
        """Add one report."""
        self.passed += tests - bad - skipped
        self.failed += bad
        self.skipped += skipped


def lint(total: Sum) -> None:
    """Ruff over everything and mypy over the packages; each counts as one test."""
    for name, command in (("ruff", ["ruff", "check", "--quiet", "--output-format", "concise", "."]), ("mypy", ["mypy"])):
        heading(name)
        good = subprocess.run([sys.executable, "-m", *command], cwd=ROOT, check=False).returncode == 0
        total.add(1, 0 if good else 1, 0)


def packages(total: Sum) -> None:
    """`colcon test` over all packages; one without a single test counts as failed."""
    heading("colcon test")
    names = sorted(path.parent.name for path in SRC.glob("*/package.xml"))
    for old in (*BUILD.glob("*/pytest.xml"), *BUILD.glob("*/test_results/**/*.xml")):
        old.unlink()
    counted, status = colcon_test(names)
    if failed := [name for name, one in counted.items() if one.failed]:
        for name in failed:
            show_failures(name)
        # tests with processes and DDS depend on a busy machine: what fails twice has failed, and the first time is said
        heading(f"second try: {', '.join(failed)}")
        again, status = colcon_test(failed)
        counted.update(again)
    for name, one in counted.items():
        if one == Sum():
            one.failed = 1
            print(f"{name}: no test was found; a package without tests fails the build")
        print(f"{name:18} {one.passed:4} passed, {one.failed} failed, {one.skipped} skipped")
        if one.failed:
            show_failures(name)
        total.add(one.passed + one.failed + one.skipped, one.failed, one.skipped)
    if status and not total.failed:
        total.failed += 1
        print(f"colcon test ended with status {status}; see {(LOG / 'test.txt').relative_to(ROOT)}")


def colcon_test(names: Sequence[str]) -> tuple[dict[str, Sum], int]:
    """Results of the packages by name, and colcon's own status."""
    colcon = [sys.executable, "-m", "colcon"]
    command = [*colcon, "test", "--base-paths", "src", "--packages-select", *names, "--event-handlers", "console_direct-", "console_start_end+"]
    # Without the package's directory on the path, its tests import what is installed, kernels' cache and all.
    env = {**os.environ, "PYTHONSAFEPATH": "1"}
    with (LOG / "test.txt").open("w", encoding="utf-8") as stream:
        process = subprocess.Popen(command, cwd=ROOT, env=env, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        assert process.stdout is not None
        for line in process.stdout:
            stream.write(line)
            if line.startswith(("Finished", "Failed")):
                print(line.rstrip(), flush=True)
        status = process.wait()
    said = subprocess.run(
        [*colcon, "test-result", "--all", "--test-result-base", "build"], cwd=ROOT, capture_output=True, text=True, check=False
    ).stdout
    counted = {name: Sum() for name in names}
    for line in said.splitlines():
        if (match := RESULT_LINE.match(line)) and match["package"] in counted:
            counted[match["package"]].add(int(match["tests"]), int(match["errors"]) + int(match["failures"]), int(match["skipped"]))
    return counted, status


def system(total: Sum) -> None:
    """The whole-system tests of test/; what failed is tried a second time."""
    heading("pytest test/")
    one = system_test()
    if 0 < one.failed <= 10:
        heading("second try of what failed")
        again = system_test("--last-failed", "--last-failed-no-failures", "none")
        if again.failed == 0 and again.passed >= one.failed:
            one.passed, one.failed = one.passed + one.failed, 0
    total.add(one.passed + one.failed + one.skipped, one.failed, one.skipped)


def system_test(*options: str) -> Sum:
    """Results of test/."""
    SYSTEM_RESULTS.unlink(missing_ok=True)
    command = [sys.executable, "-m", "pytest", "test", "-q", f"--junit-xml={SYSTEM_RESULTS}", *options]
    status = subprocess.run(command, cwd=ROOT, check=False).returncode
    try:
        suites = list(ElementTree.parse(SYSTEM_RESULTS).getroot().iter("testsuite"))
    except (OSError, ElementTree.ParseError):
        suites = []
    one = Sum()
    for suite in suites:
        number = {name: int(suite.get(name, "0")) for name in ("tests", "errors", "failures", "skipped")}
        one.add(number["tests"], number["errors"] + number["failures"], number["skipped"])
    if status and not one.failed:
        print(f"pytest ended with status {status}")
        one.failed = 1
    return one


def show_failures(package: str) -> None:
    """What the failing tests of a package said."""
    log = LOG / "latest_test" / package / "stdout_stderr.log"
    if log.is_file():
        text = log.read_text(encoding="utf-8", errors="replace")
        start = text.find("= FAILURES")
        start = text.find("= ERRORS") if start < 0 else start
        print("\n".join((text[start:] if start >= 0 else text).splitlines()[-150:]))


def heading(text: str) -> None:
    """Say what runs."""
    print(f"--- {text}", flush=True)


def main(arguments: Sequence[str]) -> int:
    """Entry point: 0 when nothing failed."""
    started = time.monotonic()
    LOG.mkdir(exist_ok=True)
    total = Sum()
    lint(total)
    if "--lint" not in arguments:
        packages(total)
        system(total)
    heading(f"{time.monotonic() - started:.0f} s")
    print(f"{total.passed} passed, {total.failed} failed, {total.skipped} skipped", flush=True)
    return 1 if total.failed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
