"""Which sentences are due at a state, by measurement time, and which state waits for its heave.

Lives here: `Schedule`.
Does not live here: what a sentence holds (sentences.py), the wall clock (nodes/nmea.py).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping

_MOTIONS_KEPT = 400


class Schedule:
    """Grids of measurement time, one a sentence, and the pairing of a state with the motion of the same stamp.

    Parameters
    ----------
    rates : Hz by sentence; 0: never
    heave_wait_s : PASHR of a state goes out without heave when states this much later have come
    """

    def __init__(self, rates: Mapping[str, int], heave_wait_s: float) -> None:
        self._rates = {name: rate for name, rate in rates.items() if rate > 0}
        self._cells: dict[str, int] = {}
        self._wait_ns = round(heave_wait_s * 1e9)
        self._waiting: deque[int] = deque()
        self._heaves: dict[int, float | None] = {}

    def due(self, stamp_ns: int) -> list[str]:
        """Sentences whose grid this stamp is the first of a cell of; also when stamps go back."""
        names = []
        for name, rate in self._rates.items():
            cell = stamp_ns * rate // 1_000_000_000
            if self._cells.get(name) != cell:
                self._cells[name] = cell
                names.append(name)
        return names

    def wait(self, stamp_ns: int) -> None:
        """The state of this stamp waits for its heave."""
        self._waiting.append(stamp_ns)

    def motion(self, stamp_ns: int, heave: float | None) -> None:
        """A motion has come; None: its heave is not valid."""
        self._heaves[stamp_ns] = heave
        if len(self._heaves) > _MOTIONS_KEPT:
            del self._heaves[next(iter(self._heaves))]

    def ready(self, newest_ns: int) -> list[tuple[int, float | None]]:
        """Waiting stamps that are to go out now, oldest first, with their heave; `newest_ns` is the newest state's stamp."""
        out: list[tuple[int, float | None]] = []
        while self._waiting:
            stamp = self._waiting[0]
            if stamp in self._heaves:
                out.append((stamp, self._heaves[stamp]))
            elif not 0 <= newest_ns - stamp < self._wait_ns:
                out.append((stamp, None))
            else:
                break
            self._waiting.popleft()
        return out
