"""`python -m riins_bringup`: the command line, interrupted at any time with one line and status 1.

Lives here: what must be in force before anything is imported that takes time.
Does not live here: the verbs (cli.py).
"""

from __future__ import annotations

import os
import signal
import sys
from types import FrameType

_interrupted = False


def _interrupt(number: int, frame: FrameType | None) -> None:
    global _interrupted
    _interrupted = True
    raise KeyboardInterrupt


def run() -> int:
    """Run the command line; exit status."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # a shell may have it ignored
        signal.signal(signal.SIGINT, _interrupt)
    try:
        from riins_bringup.cli import main

        status = main()
    except BaseException as error:
        if not (_interrupted or isinstance(error, KeyboardInterrupt)):  # Python 3.11 wraps one that comes while a class is made
            raise
        print("riins: error: interrupted", file=sys.stderr)
        status = 1
    if _interrupted:  # Python ends by SIGINT when the interrupt came inside an exec of text, though it was caught
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status)
    return status


if __name__ == "__main__":
    sys.exit(run())
