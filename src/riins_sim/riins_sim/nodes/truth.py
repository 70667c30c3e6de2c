"""Node `truth`: the true motion of a scenario for evaluation, and the initial state the navigator starts from.

Lives here: parameters in, messages out on /truth/state, /truth/odometry and, latched, /nav/initial_state.
Does not live here: the motion (riins_sim.trajectory), the errors of the initial state (riins_sim.initial).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from nav_msgs.msg import Odometry

from riins_core.frames import LocalFrame
from riins_core.settings import setting
from riins_msgs.msg import InitialState, NavState
from riins_node import fields, qos
from riins_node.convert import fill
from riins_node.parameters import declare
from riins_node.runner import run

from ..initial import initial_state
from ..sensors import RedundantImuSim
from ..solution import true_solution
from .common import SimNode, SimSettings


@dataclass(frozen=True)
class TruthSettings(SimSettings):
    """Parameters of the truth."""

    state_period_s: float = setting(0.1, "interval of the true states", "s", low=0.01, high=60.0)


class TruthNode(SimNode):
    """Publishes riins_msgs/NavState and nav_msgs/Odometry of base_link as it truly is; no filter subscribes to them."""

    def __init__(self) -> None:
        super().__init__("truth")
        self._imu = RedundantImuSim(self.scenario)
        self._trajectory = self._imu.trajectory
        drawn = initial_state(self.scenario, self._trajectory)
        start = self.scenario.start
        self._frame = LocalFrame(np.radians(start.latitude_deg), np.radians(start.longitude_deg), start.height_m)
        overridable = qos.overridable()
        self._state = self.create_publisher(NavState, "truth/state", qos.navigation(), qos_overriding_options=overridable)
        self._odometry = self.create_publisher(Odometry, "truth/odometry", qos.navigation(), qos_overriding_options=overridable)
        self._initial = self.create_publisher(InitialState, "nav/initial_state", qos.latched(), qos_overriding_options=overridable)
        self.begin()
        stamped = dataclasses.replace(drawn, stamp_ns=self.pacer.start_at_ns + drawn.stamp_ns)
        if self.scenario.initial.given:
            self._initial.publish(fill(InitialState, fields.initial_state(stamped)))
        self.pace(self._period_ns, int(self.scenario.duration_s * 1e9) // self._period_ns, self._emit, -1)

    def _declare(self) -> TruthSettings:
        settings = declare(self, TruthSettings)
        self._period_ns = round(settings.state_period_s * 1e9)
        return settings

    def _emit(self, k0: int, m: int) -> None:
        for k in range(k0, k0 + m):
            t = k * self._period_ns
            newest = min(round(t * 1e-9 / self._trajectory.dt), self._imu.samples)
            solution = true_solution(self._trajectory.truth(t * 1e-9), 0, self.pacer.start_at_ns + t, *self._imu.fused_bias(newest))
            self._state.publish(fill(NavState, fields.nav_state(solution, k)))
            self._odometry.publish(fill(Odometry, fields.odometry(solution, self._frame)))


def main(args: Sequence[str] | None = None) -> int:
    """Entry point."""
    return run(TruthNode, args, "truth")


if __name__ == "__main__":
    raise SystemExit(main())
