"""Node `gps`: see gnss.py.

Lives here: the entry point.
Does not live here: anything else.
"""

from __future__ import annotations

from collections.abc import Sequence

from .gnss import serve


def main(args: Sequence[str] | None = None) -> int:
    """Entry point."""
    return serve("gps", args)


if __name__ == "__main__":
    raise SystemExit(main())
