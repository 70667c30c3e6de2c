"""The player as a command: `riins bag play`.

Lives here: `play`, which becomes the player node with the parameters of its arguments.
Does not live here: playing (riins_bag.nodes.player).
"""

from __future__ import annotations

import os
import tempfile
from pathlib import Path
from typing import Any

from riins_bringup.graph import NodeSpec, write_files
from riins_bringup.processes import find_executable, node_environment


def play(bag: Path, *, rate: float, start: float, loop: bool, all_topics: bool, namespace: str) -> int:
    """Replace this process by the player node; returns only if that fails.

    Parameters
    ----------
    bag : bag directory
    rate : times real time
    start : s after the start of the bag
    loop : begin anew at the end
    all_topics : every topic, not the raw ones alone
    namespace : of the topics

    Raises
    ------
    BagError
        There is no such bag, or it cannot be read.
    GraphError
        The workspace is not built.
    """
    from riins_bag.reader import BagReader, namespaces
    from riins_bag.recording import RAW_TOPICS
    from riins_eval.run_configuration import aid_topics

    with BagReader(bag) as reader:  # says what is wrong before a node starts
        topics, recorded = sorted(reader.topics), namespaces(reader.topics)
        raw = dict.fromkeys((*RAW_TOPICS, *aid_topics(reader)))
    parameters: dict[str, Any] = {"path": str(bag.absolute()), "rate": rate, "start_offset_s": start, "loop": loop, "publish_clock": True}
    if all_topics:
        parameters["topics"] = ["*"]
    elif recorded:
        parameters["topics"] = ["/riins/configuration", *(f"/{name}{topic}" for name in recorded for topic in raw)]
    moved = tuple((topic, f"/{namespace.strip('/')}{topic}") for topic in topics) if namespace.strip("/") else ()
    spec = NodeSpec("riins_bag", "player", "player", "source", parameters, namespace=namespace, remappings=moved)
    executable = find_executable(spec.package, spec.executable)
    directory = Path(tempfile.mkdtemp(prefix="riins-play-"))
    os.execve(executable, [str(executable), *spec.arguments(write_files(spec, directory))], node_environment(directory))
