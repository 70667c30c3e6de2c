"""Which method fuses and which tests judge: names, what holds from a stamp on, and the operator's commands that wait for theirs.

Lives here: `Selection`, the check of its names, `Commands`, a queue by effective stamp.
Does not live here: what a command changes (pipeline.py), the methods and tests themselves.
"""

from __future__ import annotations

import heapq
from typing import NamedTuple

from riins_core.settings import nearest
from riins_fdi.health import NEVER_NS
from riins_fdi.parity import MOST_RELATED
from riins_imu_fusion.config import KINDS
from riins_imu_fusion.corrections import FUSION
from riins_imu_fusion.judges import PARITY_TESTS
from riins_imu_fusion.known_bias import Calibration
from riins_imu_fusion.rfdc import too_few_or_many
from riins_imu_fusion.sequences import SEQUENTIAL_TESTS

CAUTION = dict.fromkeys(("rfdc", "irfdc"), "whose drift it is is a guess, and one that looks like a body rate stays in")
"""What an operator should know of some fusion methods."""
CHOICES = {"fusion": tuple(FUSION), "parity_test": tuple(PARITY_TESTS), "sequential_test": tuple(SEQUENTIAL_TESTS)}


class Selection(NamedTuple):
    """What is chosen, by name."""

    fusion: str
    parity_test: str
    sequential_test: str
    adapt_noise: bool

    def text(self) -> str:
        """For an operator."""
        noise = "estimated" if self.adapt_noise else "stated"
        caution = f" ({CAUTION[self.fusion]})" if self.fusion in CAUTION else ""
        return f"fusion {self.fusion}{caution}, parity test {self.parity_test}, sequential test {self.sequential_test}, noise as {noise}"


def refusal(fusion: str, parity_test: str, sequential_test: str, n: int) -> str:
    """Why these names cannot be selected with n sensors; '' when they can. An empty name is no change."""
    for word, name in (("fusion", fusion), ("parity_test", parity_test), ("sequential_test", sequential_test)):
        if name and name not in CHOICES[word]:
            return f'no {word.replace("_", " ")} "{name}"{nearest(name, CHOICES[word])}: {", ".join(CHOICES[word])}'
    if parity_test == "direct_comparison" and n > MOST_RELATED:
        return f"direct_comparison takes at most {MOST_RELATED} sensors, not {n}"
    return too_few_or_many(fusion, n) if fusion in CAUTION else ""


class UseSensor(NamedTuple):
    """Exclude a sensor, or let it return."""

    kind: int
    sensor: int
    use: bool

    @classmethod
    def of(cls, target: str, use: bool, n: int) -> UseSensor | None:
        """By name, gyro_0 .. accel_(n - 1); None: there is no such sensor."""
        kind, _, number = target.rpartition("_")
        known = kind in KINDS and number.isdigit() and int(number) < n
        return cls(KINDS.index(kind), int(number), use) if known else None


class Commands:
    """Commands and calibrations that wait for the first sample with their stamp or a later one; of equal stamps the one given first comes first."""

    def __init__(self) -> None:
        self._queue: list[tuple[int, int, UseSensor | Selection | Calibration]] = []
        self._given = 0

    @property
    def next_ns(self) -> int:
        """Stamp at which one is due."""
        return self._queue[0][0] if self._queue else NEVER_NS

    def put(self, effective_ns: int, command: UseSensor | Selection | Calibration) -> None:
        """Let a command wait."""
        heapq.heappush(self._queue, (effective_ns, self._given, command))
        self._given += 1

    def take(self, stamp_ns: int) -> UseSensor | Selection | Calibration | None:
        """The next one due at a stamp."""
        return heapq.heappop(self._queue)[2] if self._queue and self._queue[0][0] <= stamp_ns else None

    def selection(self, effective_ns: int, now: Selection) -> Selection:
        """What will hold at a stamp when all that waits has been obeyed; `now` holds at present."""
        for stamp, _, command in sorted(self._queue, key=lambda entry: entry[:2]):
            if isinstance(command, Selection) and stamp <= effective_ns:
                now = command
        return now
