"""The command `riins`: verbs that call the packages below and print what they give.

Lives here: arguments, help, exit status (0 success, 1 bad result, 2 bad use), one-line errors.
Does not live here: any logic of its own; heavy imports stay inside the verbs, so that help comes at once.
"""

from __future__ import annotations

import enum
import errno
import sys
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.exceptions import TyperException

from riins_bringup.bag_verbs import BagArgument, bag_app
from riins_bringup.targets import new_directory, usable_directory, writable_file
from riins_bringup.terminal import BAD_RESULT, BAD_USE, OK, Progress, complain, console, judge, read_mapping, write_json

# by name: importing the classes would import what raises them
_USER_ERRORS = {"SettingError", "ScenarioError", "BagError", "ImportFailure", "ParameterError", "RecordError", "StudyError"}
_FAILURES = {"GraphError"}
_FULL = {errno.ENOSPC, errno.EDQUOT, errno.EIO}
"""A disk that ends a run which was asked for rightly."""
_INTERRUPTED = 130  # what typer returns for a KeyboardInterrupt, which it keeps to itself

LARGEST_SEED = 2**31 - 1

app = typer.Typer(
    name="riins",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    help="Redundant inertial navigation with fault isolation for ships: live over ROS 2, offline, or on recorded data.\n\n"
    "Example: [bold]riins up harbour --record out/harbour[/bold] runs the graph live, [bold]riins report out/harbour[/bold] draws what happened.",
)


app.add_typer(bag_app, name="bag")


class Record(enum.StrEnum):
    """What an offline run writes to its bag."""

    none = "none"
    nav = "nav"
    raw = "raw"
    all = "all"


ScenarioArgument = Annotated[str, typer.Argument(help="name of a shipped scenario or YAML file", metavar="SCENARIO")]
JsonOption = Annotated[
    Path | None, typer.Option("--json", help="write the figures to this file, as documented in docs/json.md", metavar="FILE", callback=writable_file)
]
TwinsOption = Annotated[
    bool | None, typer.Option("--twins/--no-twins", help="sail the fault-free twin and the oracle too (default: where it is cheap)")
]

NamespaceOption = Annotated[str | None, typer.Option(help="namespace of the recorded topics (default: the one there is)")]


@app.command()
def geometry(
    file: Annotated[
        Path | None, typer.Argument(help="n x 3 numbers, one unit sensing axis a row: text, .csv, .yaml, .npz or .npy", metavar="[FILE]")
    ] = None,
    survivors: Annotated[list[int] | None, typer.Option(help="sensors that must work, for the reliability; repeatable (default: 3, 4 and 5)")] = None,
    plot: Annotated[Path | None, typer.Option(help="draw the accuracy by direction to this PNG file", metavar="FILE", callback=writable_file)] = None,
    json_file: Annotated[Path | None, typer.Option("--json", help="write the figures to this file", metavar="FILE", callback=writable_file)] = None,
) -> int:
    """Figures of merit of sensor geometries: the thesis' tables 2.1 to 2.3, or those of your own n x 3 file.

    Example: [bold]riins geometry --plot accuracy.png[/bold] or [bold]riins geometry my_axes.csv --survivors 4[/bold]
    """
    from riins_bringup.geometry import SURVIVORS, describe_geometry, describe_thesis
    from riins_core.imu_array import CONFIGURATIONS, ImuArray

    if file is None:
        arrays = {name: ImuArray(H) for name, H in CONFIGURATIONS.items()}
        tables, figures = describe_thesis(survivors or SURVIVORS)
    else:
        from riins_bringup.geometry_file import read_geometry

        arrays = {file.name: read_geometry(file)}
        tables, figures = describe_geometry(file.name, arrays[file.name], survivors or SURVIVORS)
    for table in tables:
        console().print(table)
    if plot is not None:
        from riins_bringup.geometry_plot import draw_accuracy

        draw_accuracy(arrays, plot)
    write_json(json_file, figures)
    return OK


@app.command()
def sail(
    scenario: ScenarioArgument,
    seed: Annotated[int | None, typer.Option(help="seed of all noise (default: the scenario's)", min=0, max=LARGEST_SEED)] = None,
    out: Annotated[Path | None, typer.Option("--out", help="bag directory to write", metavar="BAG")] = None,
    record: Annotated[Record | None, typer.Option(help="what goes into the bag (default: nav with --out)")] = None,
    twins: Annotated[bool, typer.Option("--twins/--no-twins", help="sail the fault-free twin and the oracle too")] = True,
    json_file: JsonOption = None,
) -> int:
    """Simulate, fuse, navigate and score a voyage offline, far faster than real time.

    Example: [bold]riins sail voyage_12h --out out/voyage --json out/voyage.json[/bold]
    """
    kind = record or (Record.nav if out else Record.none)
    if out is None and kind is not Record.none:
        raise typer.BadParameter("--record needs --out BAG")
    from riins_eval import offline

    with Progress(f"sail {scenario}") as progress:
        run = offline.sail(scenario, seed=seed, bag=out if kind is not Record.none else None, record=kind.value, progress=progress, twins=twins)
    return judge(run.score, run.expect, json_file)


@app.command()
def navigate(
    bag: BagArgument,
    out: Annotated[Path, typer.Option("--out", help="bag directory to write", metavar="BAG")],
    record: Annotated[Record, typer.Option(help="what goes into the new bag")] = Record.nav,
    namespace: NamespaceOption = None,
    json_file: JsonOption = None,
    align: Annotated[str, typer.Option(help="alignment method that finds the state instead of the one recorded: auto, in_motion ...")] = "",
) -> int:
    """Fuse and navigate from the raw topics of a recorded bag, offline.

    Example: [bold]riins navigate out/harbour --out out/harbour_again[/bold]
    """
    from riins_eval import offline

    if align == "none":
        raise typer.BadParameter("--align wants a method, such as auto; without --align the recorded state is used")
    with Progress(f"navigate {bag.name}") as progress:
        over = {"navigator": {"alignment": {"method": align}}} if align else None
        run = offline.navigate(bag, out, record=record.value, progress=progress, overrides=over, namespace=namespace)
    return judge(run.score, run.expect, json_file)


@app.command()
def score(bag: BagArgument, twins: TwinsOption = None, namespace: NamespaceOption = None, json_file: JsonOption = None) -> int:
    """Score a recorded run against its truth: errors, consistency, faults found and missed.

    Exit status 1 when what the scenario expects does not hold. Example: [bold]riins score out/harbour --json out/score.json[/bold]
    """
    from riins_eval import score as scoring
    from riins_eval.bag_record import read_record

    with Progress(f"score {bag.name}") as progress:
        record = read_record(bag, twins=twins, progress=progress, namespace=namespace)
        result = scoring.score(record)
    return judge(result, record.expect, json_file)


@app.command()
def report(
    bag: BagArgument,
    out: Annotated[
        Path | None, typer.Option("--out", help="directory of the report (default: BAG_report)", metavar="DIR", callback=usable_directory)
    ] = None,
    twins: TwinsOption = None,
    namespace: NamespaceOption = None,
) -> int:
    """Write one self-contained HTML page and PNG figures of a recorded run.

    Example: [bold]riins report out/harbour[/bold], then open out/harbour_report/index.html
    """
    from riins_eval.report import report as write

    with Progress(f"report {bag.name}") as progress:
        page = write(bag, out or bag.with_name(f"{bag.name}_report"), twins=twins, progress=progress, namespace=namespace)
    console().print(f"report: {page}", highlight=False, soft_wrap=True)
    return OK


@app.command()
def up(
    scenario: Annotated[str | None, typer.Argument(help="name of a shipped scenario or YAML file", metavar="SCENARIO")] = None,
    bag: Annotated[Path | None, typer.Option("--bag", help="replay the raw topics of this bag instead of simulating", metavar="BAG")] = None,
    rate: Annotated[float, typer.Option(help="speed in times real time")] = 1.0,
    record: Annotated[
        Path | None, typer.Option("--record", help="record every topic to this bag directory", metavar="DIR", callback=new_directory)
    ] = None,
    duration: Annotated[float, typer.Option(help="stop after this much measurement time \\[s] (0: all of it)")] = 0.0,
    seed: Annotated[int, typer.Option(help="seed of all noise (-1: the scenario's)")] = -1,
    namespace: Annotated[str, typer.Option(help="namespace of all nodes and topics")] = "",
    nmea: Annotated[
        str, typer.Option(help="send NMEA 0183 there: udp://HOST:PORT, serial:///dev/NAME?baud=N; several by commas", metavar="ADDRESS")
    ] = "",
    motion: Annotated[bool, typer.Option("--motion", help="heave and attitude at the IMU rate on /nav/motion (with --nmea in any case)")] = False,
    log_level: Annotated[str, typer.Option(help="least severe message the nodes log: debug, info, warn, error, fatal")] = "info",
    logs: Annotated[
        Path | None,
        typer.Option(help="directory for logs and parameter files (default: a new one under ~/.ros/log)", metavar="DIR", callback=usable_directory),
    ] = None,
    network: Annotated[bool, typer.Option("--network", help="let other machines on the subnet see the topics")] = False,
    json_file: Annotated[Path | None, typer.Option("--json", help="write the summary to this file", metavar="FILE", callback=writable_file)] = None,
) -> int:
    """Start the graph as live ROS 2 nodes, watch it in a table, and stop it at the end or on Ctrl-C.

    Exit status 1 when a node died. Example: [bold]riins up harbour --record out/harbour[/bold], or [bold]riins up --bag out/harbour --rate 3[/bold]
    """
    if (scenario is None) == (bag is None):
        raise typer.BadParameter("give a SCENARIO or --bag BAG, one of them")
    from riins_bringup.graph import GraphSettings, build_graph
    from riins_bringup.processes import choose_network
    from riins_core.settings import build

    values: dict[str, Any] = {"rate": rate, "duration_s": duration, "seed": seed, "namespace": namespace, "log_level": log_level}
    values |= {"nmea": nmea, "motion": motion}
    values |= {"bag": str(bag)} if bag is not None else {"scenario": scenario}
    values |= {"record": str(record)} if record is not None else {}
    graph = build_graph(build(GraphSettings, values))
    choose_network(network)
    from riins_bringup.live import run_live

    summary = run_live(graph, console=console(), directory=logs, record=str(record or ""), json_file=json_file)
    return OK if summary["status"] == 0 else BAD_RESULT


@app.command(name="import")
def import_file(
    file: Annotated[Path, typer.Argument(help="recording in the common .npz layout", metavar="FILE")],
    out: Annotated[Path, typer.Option("--out", help="bag directory to write", metavar="BAG")],
    seed: Annotated[int, typer.Option(help="seed of the simulated noise and GNSS", min=0, max=LARGEST_SEED)] = 1,
    noise: Annotated[bool, typer.Option("--noise/--no-noise", help="sensor-level noise on the six axes (without it parity is exactly zero)")] = True,
    faults: Annotated[
        Path | None, typer.Option(help="YAML list of faults to put in, as in a scenario, times from each piece's start", metavar="FILE")
    ] = None,
    options: Annotated[
        Path | None, typer.Option(help="YAML with sections of a scenario: imu, gps, bds, doppler, navigator, ..., and recording", metavar="FILE")
    ] = None,
    withhold: Annotated[list[str] | None, typer.Option(help="leave this aid out: gps, bds or doppler; may be repeated", metavar="AID")] = None,
    check_units: Annotated[bool, typer.Option("--check-units/--no-check-units", help="refuse values that look like g or deg/s")] = True,
) -> int:
    """Make a bag of a foreign recording: its IMU on six axes, or its several IMUs as they are; its log; simulated GPS and BDS where it has none.

    Example: [bold]riins import snapir_open.npz --out out/sea[/bold], then [bold]riins up --bag out/sea[/bold]
    """
    from riins_eval import importers

    sections = read_mapping(options)
    for aid in withhold or ():
        if aid not in ("gps", "bds", "doppler"):
            raise typer.BadParameter(f"--withhold takes gps, bds or doppler, not {aid}")
        sections[aid] = {**sections.get(aid, {}), "enabled": False}
    if not check_units:
        sections["recording"] = {**sections.get("recording", {}), "check_units": False}
    with Progress(f"import {file.name}") as progress:
        lines = importers.import_npz(file, out, seed=seed, noise=noise, faults=faults, options=sections, progress=progress)
    for line in lines:
        console().print(line, markup=False, highlight=False, soft_wrap=True)
    return OK


@app.command()
def reproduce(
    name: Annotated[
        str,
        typer.Argument(help="study: thesis, beyond, alignment, ship, aircraft, vehicle, faults, real (faults put into recordings)", metavar="NAME"),
    ],
    quick: Annotated[bool, typer.Option("--quick", help="a tenth of the seeds and fewer epochs, for a first look")] = False,
    seeds: Annotated[int | None, typer.Option(help="seeds of everything random, or cases (default: thesis 50, real 200)", min=1)] = None,
    out: Annotated[
        Path | None, typer.Option("--out", help="directory of the page (default: out/reproduce_NAME)", metavar="DIR", callback=usable_directory)
    ] = None,
    json_file: Annotated[
        Path | None, typer.Option("--json", help="write the rows to this file, as documented in docs/json.md", metavar="FILE", callback=writable_file)
    ] = None,
    data: Annotated[Path | None, typer.Option(help="directory of recordings (default: $RIINS_DATA, else ../shared/data)", metavar="DIR")] = None,
) -> int:
    """Run the experiments of a paper anew and write one page: its numbers beside ours, with spread and figures.

    Exit status 1 when a number misses its target. Example: [bold]riins reproduce thesis --quick[/bold], then open out/reproduce_thesis/index.html
    """
    from riins_eval import reproduce as study

    directory = out or Path("out") / f"reproduce_{name}"
    with Progress(f"reproduce {name}", speed=False) as progress:
        rows = study.reproduce(name, seeds=seeds, quick=quick, out=directory, progress=progress, data=data)
    for row in rows:
        if row.n == 0 and row.remark:
            console().print(row.remark, markup=False, highlight=False, soft_wrap=True)
    missed = study.missed(rows)
    for row in rows:
        if row.target is not None and row.n:
            word, style = ("missed: ", "red") if row.ok is False else ("", "")
            console().print(
                f"target {row.target} {word}{row.name}: {row.value:.4g} ({row.p05:.4g} .. {row.p95:.4g}), n = {row.n}",
                style=style, markup=False, highlight=False, soft_wrap=True,
            )  # fmt: skip
    aimed = sum(row.target is not None and row.ok is not None for row in rows)
    console().print(
        f"{aimed - len(missed)} of {aimed} rows reach their target; page: {directory / 'index.html'}", markup=False, highlight=False, soft_wrap=True
    )
    write_json(json_file, study.as_json(rows))
    if rows and all(row.n == 0 and row.remark for row in rows):
        return BAD_USE  # every recording is somewhere else
    return BAD_RESULT if missed else OK


@app.command()
def demo(
    out: Annotated[Path, typer.Option("--out", help="directory for bags and reports, made anew", metavar="DIR", callback=usable_directory)] = Path(
        "out/demo"
    ),
    duration: Annotated[float, typer.Option(help="length of the live run \\[s] (0: all of the scenario)")] = 0.0,
) -> int:
    """The whole house in under four minutes: live harbour run with recording, 12 h voyage offline, report, one table.

    Example: [bold]riins demo --out out/demo[/bold]
    """
    from riins_bringup.demo import run_demo

    return run_demo(out, console(), duration)


def main(arguments: list[str] | None = None) -> int:
    """Run the command line.

    Parameters
    ----------
    arguments : words behind `riins`; None: those of the process

    Returns
    -------
    exit status: 0 success, 1 bad result, 2 bad use
    """
    try:
        status = app(args=arguments, prog_name="riins", standalone_mode=False)
    except TyperException as error:  # what typer itself found wrong with the words
        if str(error):
            complain(error.format_message() if hasattr(error, "format_message") else str(error))
        return BAD_USE
    except (KeyboardInterrupt, typer.Abort):
        complain("interrupted")
        return BAD_RESULT
    except BrokenPipeError:
        sys.stderr.close()
        return OK
    except OSError as error:
        complain(_message(error))
        return BAD_RESULT if error.errno in _FULL else BAD_USE
    except Exception as error:
        names = {cls.__name__ for cls in type(error).__mro__}
        if names & (_USER_ERRORS | _FAILURES):
            complain(_message(error))
            return BAD_USE if names & _USER_ERRORS else BAD_RESULT
        raise
    if status == _INTERRUPTED:
        complain("interrupted")
        return BAD_RESULT
    return status if isinstance(status, int) else OK


def _message(error: Exception) -> str:
    if isinstance(error, OSError) and error.strerror:
        return f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    return str(error)


if __name__ == "__main__":
    sys.exit(main())
