"""Compiles every kernel once, into the cache beside the installed modules, by sailing a short voyage and reporting on it.

Lives here: nothing else. Runs in the workspace's environment; tools/setup.py calls it when the source has changed.
"""

from __future__ import annotations

import dataclasses
import sys
import tempfile
from pathlib import Path

from riins_eval import offline
from riins_eval.bag_record import read_record
from riins_eval.report import write_report
from riins_sim import scenario as scenarios

SECONDS = 40.0


def main() -> int:
    """Sail, navigate from the bag, score, report: what a user does, in small."""
    short = dataclasses.replace(scenarios.load("harbour"), duration_s=SECONDS)
    with tempfile.TemporaryDirectory() as folder:
        bag = Path(folder) / "bag"
        offline.sail(short, bag=bag, record="all")
        offline.navigate(bag, Path(folder) / "again")
        write_report(read_record(bag, twins=False), Path(folder) / "report")
    return 0


if __name__ == "__main__":
    sys.exit(main())
