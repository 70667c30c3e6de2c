"""riins_node.runner: exit status, one line for an error, clean shutdown on any signal; real processes."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import pytest

NODE = textwrap.dedent(
    """
    import sys
    from dataclasses import dataclass
    from rclpy.lifecycle import TransitionCallbackReturn
    from rclpy.node import Node
    from std_msgs.msg import String
    from riins_core.settings import setting
    from riins_node import parameters, qos, runner

    @dataclass(frozen=True)
    class Config:
        rate_hz: float = setting(100.0, "rate", "Hz", 1.0, 1000.0)
        fail: str = setting("", "where to fail")

    class Plain(Node):
        def __init__(self):
            super().__init__("plain")
            self.config = parameters.declare(self, Config)
            if self.config.fail == "start":
                raise OSError("no such device")
            if self.config.fail == "spin":
                self.create_timer(0.01, lambda: 1 / 0)
            self.create_publisher(String, "t", qos.navigation(), qos_overriding_options=qos.overridable())
            self.create_timer(0.02, lambda: print("up", flush=True))

    class Managed(runner.AutostartLifecycleNode):
        def __init__(self):
            super().__init__("managed")
            self.config = parameters.declare(self, Config)
            self.create_timer(0.02, lambda: print("up" if self.active else "waiting", flush=True))

        def on_configure(self, state):
            if self.config.fail == "bug":
                raise KeyError("lost")
            if self.config.fail == "configure":
                raise parameters.ParameterError('parameter "fail" must not be "configure"')
            if self.config.fail == "refuse":
                return TransitionCallbackReturn.FAILURE
            return TransitionCallbackReturn.SUCCESS

    sys.exit(runner.run({"plain": Plain, "managed": Managed}[sys.argv.pop(1)], name="example"))
    """
)


@pytest.fixture
def script(tmp_path: Path) -> Path:
    file = tmp_path / "example_node.py"
    file.write_text(NODE)
    return file


def finished(script: Path, *words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, str(script), *words], capture_output=True, text=True, timeout=60, check=False)


def started(script: Path, *words: str, until: str = "up") -> subprocess.Popen[str]:
    process = subprocess.Popen([sys.executable, str(script), *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert process.stdout.readline().strip() == until
    return process


@pytest.mark.parametrize("kind", ["plain", "managed"])
@pytest.mark.parametrize(
    "signals", [[signal.SIGINT], [signal.SIGTERM], [signal.SIGINT, signal.SIGINT, signal.SIGINT], [signal.SIGTERM, signal.SIGINT]]
)
def test_signals_end_with_status_0(script: Path, kind: str, signals: list[signal.Signals]) -> None:
    process = started(script, kind)
    for number in signals:
        process.send_signal(number)
        time.sleep(0.01)
    _, errors = process.communicate(timeout=20)
    assert process.returncode == 0, errors
    assert errors.strip() == ""


def test_signal_while_starting_ends_with_status_0(script: Path) -> None:
    text = script.read_text().replace('super().__init__("plain")', "super().__init__(\"plain\"); print('up', flush=True); import time; time.sleep(1)")
    script.write_text(text)
    process = started(script, "plain")
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=20)
    assert process.returncode == 0, errors


@pytest.mark.parametrize(
    ("words", "status", "said"),
    [
        (["plain", "--ros-args", "-p", "rate:=5.0"], 2, 'example: error: unknown parameter "rate" (did you mean "rate_hz"?)'),
        (["plain", "--ros-args", "-p", "rate_hz:=0.0"], 2, "must be in 1.0 .. 1000.0"),
        (["plain", "--ros-args", "-p", "rate_hz:=[1, 2.5, x]"], 2, "example: error: "),
        (["plain", "--ros-args", "-p", "qos_overrides./t.publisher.reliability:=relaible"], 2, "QoS override"),
        (["plain", "--ros-args", "-p", "qos_overrides./u.publisher.depth:=5"], 2, "unknown parameter"),
        (["plain", "--ros-args", "--nonsense"], 2, "example: error: "),
        (["plain", "rate_hz=5"], 2, 'unknown argument "rate_hz=5"'),
        (["plain", "--ros-args", "-p", "fail:=start"], 1, "example: error: OSError: no such device"),
        (["managed", "--ros-args", "-p", "fail:=configure"], 2, 'example: error: parameter "fail" must not be "configure"'),
        (["managed", "--ros-args", "-p", "fail:=bug"], 1, "example: error: KeyError: 'lost'"),
        (["managed", "--ros-args", "-p", "fail:=refuse"], 1, "example: error: configure failed"),
        (["managed", "--ros-args", "-p", "autostart:=maybe"], 2, '"autostart" must be true or false'),
    ],
)
def test_errors_are_one_line_and_a_status(script: Path, words: list[str], status: int, said: str) -> None:
    done = finished(script, *words)
    assert done.returncode == status, done.stderr
    lines = [line for line in done.stderr.splitlines() if line.startswith("example: error:")]
    assert len(lines) == 1, done.stderr
    assert said in lines[0]
    assert "Traceback" not in done.stderr
    if words[0] == "managed":
        assert done.stderr.splitlines() == lines  # not by the logger too


def test_error_in_a_callback_says_where(script: Path) -> None:
    done = finished(script, "plain", "--ros-args", "-p", "fail:=spin")
    assert done.returncode == 1
    assert "ZeroDivisionError" in done.stderr and "Traceback" in done.stderr


def test_example_of_the_readme_runs(tmp_path: Path) -> None:
    readme = Path(__file__).resolve().parents[1] / "README.md"
    code = readme.read_text(encoding="utf-8").split("```python\n")[1].split("```")[0]
    file = tmp_path / "watch.py"
    file.write_text(code.replace("self.config = ", "print('up', flush=True); self.config = "))
    process = started(file)
    time.sleep(0.5)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=20)
    assert process.returncode == 0, errors
    done = finished(file, "--ros-args", "-p", "limit_dsp:=9.0")
    assert done.returncode == 2
    assert 'unknown parameter "limit_dsp" (did you mean "limit_dps"?)' in done.stderr


def test_without_autostart_it_waits_for_a_manager(script: Path) -> None:
    process = started(script, "managed", "--ros-args", "-p", "autostart:=false", until="waiting")
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=20)
    assert process.returncode == 0


def test_help_is_no_mistake(script: Path) -> None:
    done = finished(script, "plain", "--help")
    assert done.returncode == 0 and "usage: example" in done.stdout and "--print-parameters" in done.stdout and not done.stderr


def test_parameters_can_be_printed(script: Path, tmp_path: Path) -> None:
    done = finished(script, "managed", "--print-parameters", "--ros-args", "-p", "rate_hz:=20.0")
    assert done.returncode == 0
    assert "rate_hz: 20.0" in done.stdout and "autostart: true" in done.stdout and "# rate [Hz]; 1 .. 1000" in done.stdout
    file = tmp_path / "parameters.yaml"
    file.write_text(done.stdout)
    process = started(script, "managed", "--ros-args", "--params-file", str(file))
    os.kill(process.pid, signal.SIGTERM)
    process.communicate(timeout=20)
    assert process.returncode == 0
