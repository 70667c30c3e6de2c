"""The verbs `riins bag ...`: look into bags, recover them, play them.

Lives here: arguments and help of these verbs.
Does not live here: bags (riins_bag), the other verbs (cli.py); heavy imports stay inside the verbs.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from riins_bringup.targets import writable_file
from riins_bringup.terminal import OK, console, write_json

BagArgument = Annotated[Path, typer.Argument(help="bag directory", metavar="BAG")]
bag_app = typer.Typer(no_args_is_help=True, help="Look into, repair and play bags.\n\nExample: [bold]riins bag info out/harbour[/bold]")


@bag_app.command(name="info")
def bag_info(
    bag: BagArgument,
    json_file: Annotated[Path | None, typer.Option("--json", help="write it to this file", metavar="FILE", callback=writable_file)] = None,
) -> int:
    """Topics, counts, rates and lost samples of a bag.

    Example: [bold]riins bag info out/harbour[/bold]
    """
    from riins_bag.info import describe

    info = describe(bag)
    for line in info.lines():
        console().print(line, markup=False, highlight=False, soft_wrap=True)
    write_json(json_file, info.as_mapping())
    return OK


@bag_app.command(name="recover")
def bag_recover(
    bag: Annotated[Path, typer.Argument(help="damaged bag directory or .mcap file", metavar="BAG")],
    out: Annotated[Path | None, typer.Option("--out", help="new bag directory (default: BAG_recovered)", metavar="DIR")] = None,
    replace: Annotated[bool, typer.Option("--replace", help="put the recovered bag in the place of the damaged one")] = False,
) -> int:
    """Rebuild a bag whose recorder was killed: every complete chunk is kept.

    Example: [bold]riins bag recover out/harbour[/bold]
    """
    from riins_bag.recover import recover

    for line in recover(bag, out, replace=replace).lines():
        console().print(line, markup=False, highlight=False, soft_wrap=True)
    return OK


@bag_app.command(name="play")
def bag_play(
    bag: BagArgument,
    rate: Annotated[float, typer.Option(help="speed in times real time")] = 1.0,
    start: Annotated[float, typer.Option(help="begin this long after the start of the bag \\[s]")] = 0.0,
    loop: Annotated[bool, typer.Option("--loop", help="begin anew at the end")] = False,
    all_topics: Annotated[bool, typer.Option("--all", help="play every topic, not the raw ones alone")] = False,
    namespace: Annotated[str, typer.Option(help="namespace of the topics")] = "",
) -> int:
    """Publish the raw topics of a bag, and /clock, at the recorded pace; the player waits for its first subscribers.

    Example: [bold]riins bag play out/harbour --rate 2 --start 30[/bold], beside [bold]ros2 run riins_imu_fusion imu_fusion[/bold]
    """
    from riins_bringup.graph import GraphSettings
    from riins_bringup.play import play
    from riins_core.settings import build

    build(GraphSettings, {"namespace": namespace})
    return play(bag, rate=rate, start=start, loop=loop, all_topics=all_topics, namespace=namespace)
