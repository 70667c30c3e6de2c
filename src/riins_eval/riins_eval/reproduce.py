"""Studies of the papers, run over many seeds and written as one page: each number beside the paper's.

Lives here: the registry of names, and `reproduce`, which runs the studies, two at a time, and writes page, figures and rows.json.
Does not live here: the studies (studies/), the page itself (reproduce_page.py).
"""

from __future__ import annotations

import concurrent.futures
import dataclasses
import importlib
import json
import math
import multiprocessing
import os
import signal
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

from riins_core.settings import nearest

from .studies.rows import Row

Report = Callable[[float, float], None]


class StudyError(ValueError):
    """There is no study of this name, or it cannot be run as asked."""


@dataclasses.dataclass(frozen=True)
class Chapter:
    """One study module: its heading on the page, its share of the computing time, and whether it reads recordings."""

    module: str
    title: str
    weight: float = 1.0
    recordings: bool = False


@dataclasses.dataclass(frozen=True)
class Reproduction:
    """What a name stands for."""

    title: str
    about: str
    chapters: tuple[Chapter, ...]
    beside: str = "thesis"  # what the numbers stand beside
    seeds: int = 50
    quick_seeds: int = 5
    unit: str = "seeds"


@dataclasses.dataclass(frozen=True)
class Drawn:
    """A figure of a study, drawn: file name without suffix, title, PNG."""

    name: str
    title: str
    png: bytes


@dataclasses.dataclass(frozen=True)
class Part:
    """What a chapter gave."""

    chapter: Chapter
    rows: tuple[Row, ...]
    figures: tuple[Drawn, ...]


STUDIES: dict[str, Reproduction] = {
    "thesis": Reproduction(
        "The redundant IMU of the thesis",
        "Tables, curves and experiments of chapters 2, 4, 5 and 6, and what goes beyond them, computed anew with simulated sensors over many seeds.",
        (
            Chapter("riins_eval.studies.thesis_configuration", "Chapter 2: how many sensors, and how they are mounted", 0.01),
            Chapter("riins_eval.studies.thesis_detection", "Chapter 4: detection, isolation, drift compensation"),
            Chapter("riins_eval.studies.thesis_fusion", "Chapters 5 and 6: fusion of the redundant sensors, and with other navigation"),
            Chapter("riins_eval.studies.beyond", "Beyond the thesis: drifts that begin under way, on sensors that nobody names", 1.5),
        ),
    ),
    "beyond": Reproduction(
        "Beyond the thesis: drifts of two sensors that nobody names",
        "glr_kf beside weighted least squares, isolation, the thesis' drift compensation and adaptive filters, sparse drifts, a bank of filters.",
        (Chapter("riins_eval.studies.beyond", "Drifts that begin under way, one after the other or together, constant or not"),),
        beside="reference",
    ),
    "alignment": Reproduction(
        "Alignment: at rest, in waves, under way",
        "Seed 001 (12, 10 and 7 states), chapter 3 of the thesis (raw redundant outputs), a moored ship in waves, and heading found under way.",
        (
            Chapter("riins_eval.studies.alignment", "At rest: reduced-order filters, raw outputs, all twelve sensors"),
            Chapter("riins_eval.studies.alignment_at_sea", "A ship: moored in waves, and under way from unknown heading", 1.5),
            Chapter("riins_eval.studies.alignment_recording", "The sea recording: under way, nothing known", 0.5, True),
        ),
        beside="paper",
    ),
    "real": Reproduction(
        "Detection on real sensors",
        "Four small IMUs on a drone, whose twelve gyros and twelve accelerometers disagree, and a fibre-optic IMU at sea projected on six axes. "
        "Every method finds what is wrong with them, and the same faults put into the recordings, on one sensor and on two. All are told a noise, "
        "one number for each kind of sensor, with which they alarm equally often on the recording without these faults: the noise of real sensors is "
        "coloured and grows with the motion, so that no threshold from chi-square holds.",
        (
            Chapter("riins_eval.studies.real_sensors", "The drone: twelve real sensors of each kind", 1.0, True),
            Chapter("riins_eval.studies.sea_sensors", "The sea: real motion, six axes of each kind, simulated white noise", 1.5, True),
        ),
        beside="expected",
        seeds=200,
        quick_seeds=20,
        unit="cases",
    ),
    "ship": Reproduction(
        "The ship with GPS, BDS and Doppler log",
        "Section 3 of seed 003 in the damped platform form, every federated structure and fault test against the oracle; the same in full strapdown.",
        (
            Chapter("riins_eval.studies.ship", "The voyage: outages, gross faults, accuracy against the oracle"),
            Chapter("riins_eval.studies.ship_faults", "Small and slow faults"),
            Chapter("riins_eval.studies.ship_strapdown", "Full strapdown at 100 Hz in waves, through the whole navigator", 2.0),
            Chapter("riins_eval.studies.ship_compared", "Full strapdown: inertial alone, position reset, three fixes, output correction", 1.5),
        ),
        beside="paper",
        seeds=20,
        quick_seeds=4,
    ),
    "faults": Reproduction(
        "Faults of the aids, drawn at random, and spoofing",
        "The whole navigator of a ship under way: steps, ramps, noise and stuck values of 3 to 1000 sigma on GPS, BDS and log; positions pulled.",
        (
            Chapter("riins_eval.studies.fault_draws", "Faults drawn at random"),
            Chapter("riins_eval.studies.spoofing", "Spoofing: positions pulled away", 0.4),
        ),
        beside="wanted",
        seeds=1000,
        quick_seeds=24,
        unit="draws",
    ),
    "aircraft": Reproduction(
        "The aircraft with GPS, Doppler and star sensor",
        "Trajectory, table 1 and table 2 of seed 002 in a linear simulation of 36 error states, with and without the star sensor, with white and "
        "correlated GPS.",
        (Chapter("riins_eval.studies.aircraft", "Twenty minutes of flight"),),
        beside="paper",
        quick_seeds=4,
    ),
    "vehicle": Reproduction(
        "The car with GNSS, odometer and altimeter",
        "Seed 004: shares by innovations and the improved chi-square test, with a step and a ramp of GNSS, at equal false-alarm rate. The equations "
        "of both, the table of faults and every figure are lost, and no data sheet of the sensors is given: what is used instead stands in "
        "studies/vehicle_model.py and in the notes of riins_fdi.innovation_tests.",
        (
            Chapter("riins_eval.studies.vehicle", "The drive of 450 s"),
            Chapter("riins_eval.studies.innovations", "The tests on white innovations of three components", 0.5),
        ),
        beside="paper",
        seeds=20,
        quick_seeds=4,
    ),
}
RECORDINGS = Path("../shared/data")
"""Where recordings are looked for if nothing else is said."""


def reproduce(
    name: str,
    seeds: int | None = None,
    quick: bool = False,
    out: str | Path | None = None,
    progress: Report | None = None,
    processes: int | None = None,
    data: str | Path | None = None,
) -> list[Row]:
    """Run the studies of a name.

    Parameters
    ----------
    name : key of STUDIES
    seeds : of everything random, or cases; None: as many as the study says, fewer with `quick`
    quick : fewer epochs and methods where a study knows which can be spared
    out : directory for index.html, rows.json and NAME.png of each figure, made if needed; None: nothing is written
    progress : called with (part done, 1.0)
    processes : chapters that run at a time; None: two where two cores are there
    data : directory of recordings; None: the environment's RIINS_DATA, else RECORDINGS. A chapter whose recording is not there says so

    Returns
    -------
    rows in the order of the chapters

    Raises
    ------
    StudyError
        Unknown name (the nearest is named), no seed.
    OSError
        The directory cannot be made.
    """
    if name not in STUDIES:
        raise StudyError(f"unknown study {name!r}{nearest(name, STUDIES)}; known: {', '.join(STUDIES)}")
    reproduction = STUDIES[name]
    seeds = seeds if seeds is not None else reproduction.quick_seeds if quick else reproduction.seeds
    if seeds < 1:
        raise StudyError(f"a study needs at least one seed, not {seeds}")
    where = Path(data or os.environ.get("RIINS_DATA") or RECORDINGS)
    if out is not None:
        Path(out).mkdir(parents=True, exist_ok=True)  # what cannot be written is known before minutes of computing, not after
    processes = min(2, len(os.sched_getaffinity(0))) if processes is None else processes
    run = _run_here if min(processes, len(reproduction.chapters)) < 2 else _run_apart
    parts = run(reproduction.chapters, _Asked(seeds, quick, where), progress or (lambda done, total: None), processes)
    if out is not None:
        from .reproduce_page import page

        directory = Path(out)
        for figure in (f for part in parts for f in part.figures):
            (directory / f"{figure.name}.png").write_bytes(figure.png)
        rows = [r for part in parts for r in part.rows]
        (directory / "rows.json").write_text(json.dumps(as_json(rows), indent=2, allow_nan=False) + "\n", encoding="utf-8")
        (directory / "index.html").write_text(page(name, reproduction, parts, seeds, quick), encoding="utf-8")
    return [r for part in parts for r in part.rows]


def missed(rows: Iterable[Row]) -> list[Row]:
    """The rows with a target that do not reach it."""
    return [r for r in rows if r.target is not None and r.ok is False]


def as_json(rows: Iterable[Row]) -> list[dict[str, Any]]:
    """Rows as documented in docs/json.md; what is not finite becomes null."""
    return [{k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in dataclasses.asdict(r).items()} for r in rows]


@dataclasses.dataclass(frozen=True)
class _Asked:
    """How a study is to be run."""

    seeds: int
    quick: bool
    data: Path


def _run_here(chapters: Sequence[Chapter], asked: _Asked, progress: Report, _: int) -> list[Part]:
    total, before, parts = sum(c.weight for c in chapters), 0.0, []

    def within(chapter: Chapter, start: float) -> Callable[[float], None]:
        return lambda part: progress((start + chapter.weight * part) / total, 1.0)

    for chapter in chapters:
        parts.append(_one(chapter, asked, within(chapter, before)))
        before += chapter.weight
    return parts


def _run_apart(chapters: Sequence[Chapter], asked: _Asked, progress: Report, processes: int) -> list[Part]:
    """The longest chapters first, `processes` at a time; what they have done comes back through shared memory."""
    context = multiprocessing.get_context("spawn")  # a fork would copy the locks of whatever threads there are
    shared = context.Array("d", len(chapters) + 1, lock=False)  # the last one tells the others to stop
    total = sum(c.weight for c in chapters)
    with concurrent.futures.ProcessPoolExecutor(processes, context, _begin, (shared, os.getpid())) as pool:
        order = sorted(range(len(chapters)), key=lambda i: -chapters[i].weight)
        tasks = {i: pool.submit(_apart, i, chapters[i], asked) for i in order}
        waiting = set(tasks.values())
        try:
            while waiting:
                finished, waiting = concurrent.futures.wait(waiting, 0.2, concurrent.futures.FIRST_COMPLETED)
                for task in finished:
                    task.result()  # a failure ends the others too
                progress(sum(c.weight * shared[i] for i, c in enumerate(chapters)) / total, 1.0)
        finally:
            shared[-1] = 1.0
            pool.shutdown(wait=False, cancel_futures=True)
        return [tasks[i].result() for i in range(len(chapters))]


class _Stopped(Exception):
    """Another chapter failed, or the user has had enough."""


_shared: Any = None
_parent = 0


def _begin(shared: Any, parent: int) -> None:
    global _shared, _parent
    _shared, _parent = shared, parent
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent gets it and tells


def _apart(index: int, chapter: Chapter, asked: _Asked) -> Part:
    def progress(part: float) -> None:
        if os.getppid() != _parent:
            os._exit(1)  # nobody waits for this any more
        if _shared[-1]:
            raise _Stopped
        _shared[index] = part

    return _one(chapter, asked, progress)


def _one(chapter: Chapter, asked: _Asked, progress: Callable[[float], None]) -> Part:
    from .reproduce_page import draw

    more = {"data": asked.data} if chapter.recordings else {}
    rows, figures = importlib.import_module(chapter.module).run(asked.seeds, asked.quick, progress, **more)
    drawn = tuple(Drawn(f.name, f.title, draw(f)) for f in figures)
    progress(1.0)
    return Part(chapter, tuple(rows), drawn)
