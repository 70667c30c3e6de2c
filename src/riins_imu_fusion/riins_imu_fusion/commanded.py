"""What an operator and a navigator may ask of a fusion that runs, each from a stamp on.

Lives here: `Commanded`, the part of the pipeline that takes commands, lets them wait for their stamp, or refuses and counts them.
Does not live here: the queue and the names (selection.py), what a command does when its time has come (pipeline.py).
"""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
from numpy.typing import ArrayLike

from riins_fdi.health import ALWAYS_NS, HealthState
from riins_imu_fusion import state as K
from riins_imu_fusion.known_bias import Calibration
from riins_imu_fusion.running import Methods
from riins_imu_fusion.selection import Commands, Selection, UseSensor, refusal
from riins_imu_fusion.types import CommandResult, Reason

MONTH_NS = 30 * 86_400_000_000_000
"""A command may be for later, and one of a recording that is played comes before its samples; beyond this it has another clock's stamp."""
_REFUSED = ("passed", "lies")


class Commanded(ABC):
    """Commands to a pipeline of n sensors of each kind."""

    _methods: Methods
    _state: K.State

    def __init__(self, n: int) -> None:
        self.n = n
        self._commands = Commands()
        self._commands_refused = self._calibrations_refused = 0

    @property
    @abstractmethod
    def last_stamp_ns(self) -> int | None:
        """Stamp of the last sample accepted; None before the first."""

    @abstractmethod
    def _tell(self, stamp_ns: int, kind: str, index: int, state: HealthState | None, reason: int, text: str) -> None:
        """Make an event."""

    def set_sensor_use(self, target: str, use: bool, effective_ns: int = 0) -> CommandResult:
        """Exclude a sensor on the operator's word, or let it return through probation.

        Parameters
        ----------
        target : gyro_0, accel_5, ...
        use : False: exclude; True: restore
        effective_ns : holds from the first sample with this stamp or a later one; 0: from the next sample on

        Returns
        -------
        CommandResult; refused and counted for an unknown target or a stamp that has passed
        """
        command = UseSensor.of(target, use, self.n)
        if command is None:
            return self._refuse(f'no sensor "{target}": gyro_0 .. gyro_{self.n - 1}, accel_0 .. accel_{self.n - 1}')
        effective_ns, when = self._due(effective_ns)
        if when.startswith(_REFUSED):
            return self._refuse(f"{target}: the effective stamp {when}")
        self._put(effective_ns, command)
        return CommandResult(True, effective_ns, f"{target}: {'probation' if use else 'excluded'} from {when} on")

    def set_method(
        self, fusion: str = "", parity_test: str = "", sequential_test: str = "", adapt_noise: bool = False, effective_ns: int = 0
    ) -> CommandResult:  # fmt: skip
        """Fuse and judge with other methods.

        Parameters
        ----------
        fusion, parity_test, sequential_test : names as in `FusionConfig`; empty: stays
        adapt_noise : the noise estimated while running is used
        effective_ns : holds from the first sample with this stamp or a later one; 0: from the next sample on

        Returns
        -------
        CommandResult; refused and counted for an unknown name or a stamp that has passed. `selected` says what will hold
        """
        if problem := refusal(fusion, parity_test, sequential_test, self.n):
            return self._refuse(problem)
        effective_ns, when = self._due(effective_ns)
        if when.startswith(_REFUSED):
            return self._refuse(f"method: the effective stamp {when}")
        now = self.selected(effective_ns)
        chosen = Selection(fusion or now.fusion, parity_test or now.parity_test, sequential_test or now.sequential_test, adapt_noise)
        self._put(effective_ns, chosen)
        return CommandResult(True, effective_ns, f"{chosen.text()} from {when} on")

    def add_calibration(
        self, effective_ns: int, gyro_bias: ArrayLike, gyro_covariance: ArrayLike, accel_bias: ArrayLike, accel_covariance: ArrayLike
    ) -> CommandResult:  # fmt: skip
        """Take what a navigator says of the bias of the fused output; see known_bias for what it is used for.

        Parameters
        ----------
        effective_ns : holds from the first sample with this stamp or a later one
        gyro_bias, accel_bias : (3,), rad/s, m/s^2, FRD
        gyro_covariance, accel_covariance : (3, 3)

        Returns
        -------
        CommandResult; refused and counted when its stamp has passed, a value is not finite or a covariance is not positive definite
        """
        calibration = Calibration(
            np.array([gyro_bias, accel_bias], np.float64).reshape(2, 3), np.array([gyro_covariance, accel_covariance], np.float64).reshape(2, 3, 3)
        )
        problem, when = calibration.problem(), self._due(effective_ns)[1] if effective_ns else "passed: it has none"
        problem = problem or (f"the effective stamp {when}" if when.startswith(_REFUSED) else "")
        if problem:
            self._calibrations_refused += 1
            self._tell(self.last_stamp_ns or 0, "command", -1, None, Reason.OPERATOR, f"calibration refused: {problem}")
            return CommandResult(False, 0, problem)
        self._put(effective_ns, calibration)
        return CommandResult(True, effective_ns, f"calibration from {when} on")

    def selected(self, effective_ns: int | None = None) -> Selection:
        """Methods in force, or those that will be at a stamp as far as they have been commanded."""
        return self._methods.selection if effective_ns is None else self._commands.selection(effective_ns, self._methods.selection)

    def _due(self, effective_ns: int) -> tuple[int, str]:
        """Stamp from which a command holds, and in words; the words begin with one of _REFUSED when that time has passed, or is another clock's."""
        last = self.last_stamp_ns
        if effective_ns == 0:
            return (ALWAYS_NS if last is None else last + 1), "the next sample"
        if last is not None and effective_ns <= last:
            return effective_ns, f"passed {(last - effective_ns) * 1e-9:.3f} s ago"
        if last is not None and effective_ns - last > MONTH_NS:
            return effective_ns, f"lies {(effective_ns - last) / 86_400e9:.0f} days ahead of the newest sample"
        return effective_ns, "the next sample" if effective_ns == (last or 0) + 1 else f"{effective_ns * 1e-9:.3f} s"

    def _put(self, effective_ns: int, command: UseSensor | Selection | Calibration) -> None:
        self._commands.put(effective_ns, command)
        self._state.clock[K.NEXT_COMMAND] = min(int(self._state.clock[K.NEXT_COMMAND]), effective_ns)

    def _refuse(self, message: str) -> CommandResult:
        self._commands_refused += 1
        stamp = self.last_stamp_ns or 0
        self._tell(stamp, "command", -1, None, Reason.OPERATOR, f"refused: {message}")
        return CommandResult(False, 0, message)
