"""Settings of the federated structure: separation of solutions, information sharing, and how an aid is judged beside its NIS.

Lives here: `SolutionSeparation`, `Sharing`, `AidJudging` and the names of the structures.
Does not live here: the structures (structures.py, separated_masters.py), the other settings of the navigator (config.py).
"""

from __future__ import annotations

from dataclasses import dataclass

from riins_core.settings import setting
from riins_fdi.innovation_tests import INNOVATION_TESTS

STRUCTURES = ("separated", "information", "fusion_reset", "no_reset", "partial")
NO_TEST = "none"


@dataclass(frozen=True)
class SolutionSeparation:
    """How an aid is isolated by the separation of solutions, and taken in again; structure separated."""

    left_out: int = setting(
        2,
        "masters for every set that leaves out up to so many aids. 1: leave-one-out. 2: another aid may fail too, and its leave-one-out master is "
        "still one that never saw the first; it also tells which aid it is. 0: as structure information",
        "", 0, 3,
    )  # fmt: skip
    false_alarm_probability: float = setting(1e-5, "of one test of the horizontal position, and of one of the whole solution", "", 1e-15, 0.5)
    margin: float = setting(
        10.0, "what is still parted without the aid to blame must be below that without any other by this much: 10 is a likelihood of 150 to 1",
        "", 0.0, 1e6,
    )  # fmt: skip
    confirm_after: int = setting(
        3, "an aid with so many failed tests in a row is tested with confirm_false_alarm_probability: what it put in before goes too", "", 1, 1000
    )
    confirm_false_alarm_probability: float = setting(1e-2, "of the test of an aid that its own tests suspect", "", 1e-15, 0.5)
    worst: float = setting(10.0, "an aid is not isolated where the sigma of the position would grow by more than this factor", "", 1.0, 1e6)
    evidence_memory: float = setting(20.0, "measurements of an aid over which its innovations are averaged for the IMU's word on it", "", 1.0, 1e6)
    evidence_false_alarm_probability: float = setting(
        1e-6, "that a mean of good innovations is held to contradict the IMU; decides whether one aid is wrong or all others are", "", 1e-15, 0.5
    )
    readmit_after: int = setting(30, "measurements in a row that an isolated aid must pass before it is compared", "", 1, 1_000_000)
    readmit_false_alarm_probability: float = setting(0.1, "probability that a good aid fails that comparison and begins again", "", 1e-6, 0.9)


@dataclass(frozen=True)
class Sharing:
    """Information shares of the local filters; structures fusion_reset, no_reset and partial."""

    kind: str = setting(
        "equal", "equal; fixed: as given in shares; trace: by the local covariances; innovation: by the innovations (004)",
        choices=("equal", "fixed", "trace", "innovation"),
    )  # fmt: skip
    shares: tuple[float, ...] = setting((), "fixed: of the aids in their order; what they lack of one is that of the known height", "", 1e-6, 1.0)


@dataclass(frozen=True)
class AidJudging:
    """How one aid is judged beside the innovation test of a single epoch."""

    adaptive_noise: bool = setting(False, "widen its noise when its innovations show more than it reports: steps and ramps are not taken for noise")
    further_test: str = setting(
        NO_TEST,
        "a test over many innovations as well; for an aid whose errors are white to the filter",
        choices=(NO_TEST, *INNOVATION_TESTS),
    )
    further_test_interval_h: float = setting(300.0, "mean time between false alarms of the further test", "h", 1e-3, 1e6)
