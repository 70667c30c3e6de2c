"""The one exception of this package.

Lives here: `BagError`, whose text is one line that a person can act on.
Does not live here: anything else; every other module imports it, so it imports none.
"""

from __future__ import annotations


class BagError(Exception):
    """A bag, a message or a definition cannot be written or read; the text is one line with the cure where there is one."""
