"""RFDC and IRFDC of the thesis in the pipeline: their settings, memory and random numbers for both kinds of sensor.

Lives here: `RfdcSettings`, and `Rfdc`, which takes the drifts found out of one sample after the other.
Does not live here: the loop and its filters (riins_fdi.drift), the arithmetic of a sample (rfdc_kernel.py), who judges (kernel.py).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from riins_core.imu_array import ImuArray
from riins_core.noise import normal
from riins_core.settings import setting
from riins_fdi.drift import FILTERS, voting_rows
from riins_fdi.drift_filters import AEKPF
from riins_fdi.parity import MOST_RELATED
from riins_imu_fusion import state as K
from riins_imu_fusion.rfdc_kernel import LoopState, compensate

F = NDArray[np.float64]

_CHUNK = 64  # samples whose random numbers are drawn at once
_SMOOTH_S = 1.0  # over which the mean square of the fused sample is averaged
_MOST_SETS = 256
LEAST = 5
"""Sensors that a vote on each takes: with four every parity relation has all of them."""


def too_few_or_many(name: str, n: int) -> str:
    """Why rfdc or irfdc (`name`) cannot work on n sensors; '' when it can."""
    return "" if LEAST <= n <= MOST_RELATED else f"{name} takes {LEAST} to {MOST_RELATED} sensors, not {n}"


@dataclass(frozen=True)
class RfdcSettings:
    """Settings of rfdc and irfdc, in sigma of a sample, process and vote as the thesis has them; its K of 40 is for drifts of fifty sigma."""

    filter: str = setting("ekf", "filter that estimates what is left of the drifts", choices=tuple(FILTERS))
    gain: float = setting(1.0, "feedback gain K; K dt is at most 1, beyond it overshoots", "1/s", 0.0, 1e4)
    process: float = setting(0.5, "random walk of a drift in one sample", "sigma", 1e-6, 1e3)
    vote: float = setting(6.25, "noise of the pseudo-measurements that vote on whose drift it is", "sigma^2", 1e-6, 1e6)
    most: float = setting(8.0, "bound of the standard deviation of a drift: about there a test isolates", "sigma", 1e-3, 1e6)
    particles: int = setting(100, "particles of aekpf, aekpf_optimal and pf", "", 2, 10_000)
    seed: int = setting(1, "of the particles", "", 0, 2**31 - 1)


class Rfdc:
    """The loops of gyros and accelerometers.

    Parameters
    ----------
    array : geometry
    settings : of the loop
    sigma : (2, n), white noise of a sample as stated: the unit of the settings is its root mean square
    rate_hz : sample rate

    Notes
    -----
    A sensor that leaves the set for a sample only does not vote and has no say in parity; its drift is kept. When health takes a sensor out or
    lets it in, the loop of its kind begins anew: what a fault had put into the drifts of the others must not stay. Four sensors have one parity
    relation, and nothing to vote with: the drifts found are held. Random numbers are addressed by the number of the sample since the loop began.
    """

    def __init__(self, array: ImuArray, settings: RfdcSettings, sigma: F, rate_hz: float) -> None:
        self._array, self._kind = array, FILTERS[settings.filter]
        self._seed = settings.seed
        self._unit = np.sqrt(np.mean(sigma**2, axis=1))
        gain = min(settings.gain / rate_hz, 1.0)
        self._numbers = np.array([gain, settings.process, settings.most, settings.vote, max(1.0, _SMOOTH_S * rate_hz)])
        particles = settings.particles if self._kind >= AEKPF else 1
        self._particles = particles
        self._drawn = particles * array.n + 1 if self._kind >= AEKPF else 0
        self._votes: dict[int, F | None] = {}
        self._none = np.zeros((array.n, array.n))
        self.fresh()

    def fresh(self) -> None:
        """Forget every sample, and the numbering of samples."""
        self._k = 0
        self._draws: list[F] = [np.zeros((0, 0)), np.zeros((0, 0))]
        self._memory = [self._begin(), self._begin()]

    def begin(self, kind: int) -> None:
        """Other sensors are in use: what is known of the drifts of this kind is forgotten."""
        self._memory[kind] = self._begin()

    def step(self, state: K.State, tables: K.Tables, improved: bool) -> None:
        """Work a sample that the loop has tested in; its drifts and their covariance go to state.drift.

        Parameters
        ----------
        state : z, alarm, sets and slots of the sample
        tables : of the sets
        improved : with the drift factor, IRFDC
        """
        for kind, memory in enumerate(self._memory):
            slot, fused = int(state.slot[kind]), int(state.used_slot[kind])
            votes = self._voting(int(state.key[kind])) if int(tables.dof[kind, slot]) > 1 else None
            learning = votes is not None and int(state.alarm[kind]) == K.QUIET
            if memory.seen[0] == 0.0:
                memory.alpha[:] = 1.0 / self._array.n if improved else 1.0
            compensate(
                state.z[kind], self._unit[kind], tables.V[kind, slot, : max(0, tables.dof[kind, slot])],
                self._none if votes is None else votes, tables.W[kind, fused], tables.member[kind, fused], self._numbers, self._kind, improved,
                learning, self._draw(kind), memory, state.drift.vec[kind, K.COMPENSATION], state.drift.spread[kind],
            )  # fmt: skip
        self._k += 1

    def warm_up(self) -> None:
        """Compile or load the kernel by a sample that nobody sees."""
        n = self._array.n
        compensate(
            np.zeros(n), self._unit[0], np.zeros((max(1, n - 3), n)), self._none, np.zeros((3, n)), np.ones(n), self._numbers, self._kind, True,
            True, np.zeros(self._drawn), self._begin(), np.zeros(n), np.zeros((3, 3)),
        )  # fmt: skip

    def _begin(self) -> LoopState:
        n = self._array.n
        return LoopState(
            x=np.zeros(n),
            P=np.eye(n) * self._numbers[1] ** 2,
            D=np.zeros(n),
            alpha=np.ones(n),
            change=np.zeros(n),
            cloud=np.zeros((self._particles, n)),
            weights=np.full(self._particles, 1.0 / self._particles),
            mean=np.zeros((3, 3)),
            said=np.zeros((3, 3)),
            seen=np.zeros(1),
        )

    def _draw(self, kind: int) -> F:
        """Random numbers of the sample at hand."""
        row = self._k % _CHUNK
        if row == 0 and self._drawn:
            self._draws[kind] = normal(self._seed, f"drift particles {kind}", self._k, _CHUNK, self._drawn)
        return self._draws[kind][row] if self._drawn else np.zeros(0)

    def _voting(self, mask: int) -> F | None:
        """Voting rows of a set of sensors; None: it has none."""
        if mask not in self._votes:
            if len(self._votes) >= _MOST_SETS:
                self._votes.clear()
            try:
                self._votes[mask] = voting_rows(self._array, mask)
            except ValueError:
                self._votes[mask] = None
        return self._votes[mask]
