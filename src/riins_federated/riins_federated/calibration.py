"""What the navigator's aids say of the inertial biases, for those who fuse the redundant sensors: the part that no parity sees.

Lives here: `Calibration`, and `Calibrator`, which makes one of a settled state at whole intervals of measurement time.
Does not live here: what the fusion does with it (riins_imu_fusion.known_bias), the message (riins_node.fields).
"""

from __future__ import annotations

from dataclasses import dataclass

from .config import NavigatorConfig
from .state_blocks import StateModel
from .timeline import to_ns
from .types import Array, Mode, NavSolution


@dataclass(frozen=True)
class Calibration:
    """Bias of the fused body rate and specific force.

    Attributes
    ----------
    effective_ns : measurement time from which it holds; later than anything fused when it is made, so that it is the same for every order of arrival
    estimated_ns : measurement time of the estimate
    gyro_bias, accel_bias : (3,), rad/s, m/s^2, FRD; each with its Gauss-Markov part
    gyro_covariance, accel_covariance : (3, 3)
    """

    effective_ns: int
    estimated_ns: int
    gyro_bias: Array
    gyro_covariance: Array
    accel_bias: Array
    accel_covariance: Array


class Calibrator:
    """Makes calibrations of settled states.

    Parameters
    ----------
    config : `calibration_period_s`, `calibration_lead_s`

    Notes
    -----
    A function of settled states and their stamps alone. The navigator goes on subtracting its bias: what it gives away here must not be
    subtracted from the samples it is fed with, or it would be counted twice.
    """

    def __init__(self, config: NavigatorConfig) -> None:
        self._period, self._lead = to_ns(config.calibration_period_s), to_ns(config.calibration_lead_s)
        self._states = StateModel(config.inertial, config.states)  # its first states are those of the navigator, whatever the aids add
        self._last: int | None = None

    def take(self, solutions: list[NavSolution]) -> list[Calibration]:
        """Calibrations of the first settled state in each interval; none before the second one.

        Parameters
        ----------
        solutions : settled states, in order
        """
        made = []
        for state in solutions if self._period else ():
            interval = state.stamp_ns // self._period
            if self._last is not None and interval != self._last and state.mode in (Mode.NAVIGATING, Mode.COASTING):
                gyro, accel = self._states.bias_covariances(state.P)
                effective_ns = interval * self._period + self._lead
                made.append(Calibration(effective_ns, state.stamp_ns, state.bias_g.copy(), gyro, state.bias_a.copy(), accel))
            self._last = interval
        return made
