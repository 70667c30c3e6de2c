"""What the verbs say: lines of error, progress, verdicts, JSON files.

Lives here: `complain`, `console`, `judge`, `Progress`, `read_mapping`, `write_json` and the exit status; heavy imports stay inside.
Does not live here: the verbs (cli.py, bag_verbs.py), tables (printing.py).
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import typer

OK, BAD_RESULT, BAD_USE = 0, 1, 2


def complain(text: str) -> None:
    """One line of error."""
    print("riins: error: " + " ".join(text.split()), file=sys.stderr)


def console() -> Any:
    """The terminal, or what stands in its place."""
    from rich.console import Console

    return Console()


def judge(result: dict[str, Any], expect: dict[str, Any], json_file: Path | None) -> int:
    """Print a score and its verdict; exit status by the verdict."""
    from riins_bringup.printing import fault_table, score_table, sensor_table
    from riins_eval.score import verdict

    failures = verdict(result, expect)
    unscored = "no epoch could be scored: no reference (/truth/state) at the navigator's epochs in the time that counts"
    if result["epochs"] or result.get("scored") == "sensors":
        unscored = ""
    found = result.get("alignment")
    if not result["epochs"] and found is not None and not found["aligned"]:
        unscored = "no epoch to score: the last alignment did not end in a state"
    screen = console()
    screen.print(score_table(result))
    if result["faults"]:
        screen.print(fault_table(result))
    if any(s["first_change_s"] is not None for s in result.get("sensors", ())):
        screen.print(sensor_table(result))
    for line in failures:
        screen.print(f"not as expected: {line}", style="bold red", markup=False, highlight=False)
    if unscored:
        screen.print(unscored, style="bold red", markup=False, highlight=False, soft_wrap=True)
        failures = [unscored, *failures]
    if expect and not failures:
        screen.print("as the scenario expects", style="green")
    for note in result["notes"]:
        screen.print(f"note: {note}", markup=False, highlight=False, soft_wrap=True)
    write_json(json_file, {**result, "verdict": {"passed": not failures, "failures": failures}})
    return BAD_RESULT if failures else OK


def read_mapping(path: Path | None) -> dict[str, Any]:
    """Sections of a YAML file; nothing without a file."""
    if path is None:
        return {}
    import yaml

    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (yaml.YAMLError, ValueError) as error:  # also a date that is none
        raise typer.BadParameter(f"{path}: {' '.join(str(error).split())}") from None
    if not isinstance(content, dict):
        raise typer.BadParameter(f"{path}: a mapping of sections is needed")
    return content


def write_json(path: Path | None, figures: Any) -> None:
    """Write figures to a file, if one is named."""
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            path.write_text(json.dumps(figures, indent=2, allow_nan=False, default=str) + "\n", encoding="utf-8")
        except OSError as error:  # one of writing, not of opening, does not say where
            raise OSError(error.errno, error.strerror, str(path)) from None


class Progress:
    """A progress bar, with the speed in times real time unless told; nothing where the output is no terminal."""

    def __init__(self, title: str, speed: bool = True) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

        console = Console(stderr=True)
        columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[speed]}"), TimeRemainingColumn())
        self._bar = Progress(*columns, console=console, transient=True, disable=not console.is_terminal)
        self._title, self._speed = title, speed

    def __enter__(self) -> Progress:
        self._bar.start()
        self._task = self._bar.add_task(self._title, total=None, speed="")
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    def __call__(self, done: float, total: float) -> None:
        """`done` of `total` are computed: seconds of measurement time where the speed is shown."""
        elapsed = (self._bar.tasks[0].elapsed or 0.0) if self._speed else 0.0
        self._bar.update(self._task, completed=done, total=total, speed=f"{done / elapsed:.0f} x real time" if elapsed > 0.2 else "")
