"""First lines of every node's process: a signal while Python still imports ends it with status 0, as one that runs does.

Lives here: `start`, `node_runs`. Nothing that takes time to import may be imported here.
Does not live here: the end of a node that has been made (runner.py).
"""

from __future__ import annotations

import importlib
import os
import signal
import sys
from types import FrameType

_runs = False


def start(module: str) -> None:
    """Import a node's module, call its `main` and end the process with what it returns; executables consist of this call.

    Parameters
    ----------
    module : absolute name, e.g. `riins_sim.nodes.gps`
    """
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # a shell has it ignored for what it starts in the background
        signal.signal(signal.SIGINT, _end)
    signal.signal(signal.SIGTERM, _end)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})  # the launcher starts nodes with it blocked
    sys.exit(importlib.import_module(module).main())


def node_runs() -> None:
    """From now on there is something to clean up: SIGINT raises KeyboardInterrupt, SIGTERM is left to rclpy."""
    global _runs
    _runs = True


def _end(number: int, frame: FrameType | None) -> None:
    if not _runs:
        os._exit(0)  # an exception could be swallowed by what is being imported
    if number == signal.SIGINT:
        raise KeyboardInterrupt
