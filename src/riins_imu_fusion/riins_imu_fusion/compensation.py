"""What joins the filter `glr_kf` to the fusion pipeline: its settings and memory for both kinds of sensor, its findings as changes of health.

Lives here: `Compensation`, which follows the filters with the health machines.
Does not live here: the filter (glr_kf*.py), the samples (kernel.py), what is announced (pipeline.py).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from riins_fdi.health import Change, HealthMachine
from riins_imu_fusion.config import FusionConfig
from riins_imu_fusion.glr_kf import make_rules, make_state
from riins_imu_fusion.glr_kf_answer import answer, forgive
from riins_imu_fusion.glr_kf_resolve import resolve, take_in
from riins_imu_fusion.glr_kf_state import BASED, BEFORE, CALL, CHANGED, DEAD, NOISE, OPEN, OTHER_SET, STRANGE, USED, GlrRules, GlrState
from riins_imu_fusion.known_bias import Calibration, KnownBias
from riins_imu_fusion.method import TriadModel
from riins_imu_fusion.state import Tables
from riins_imu_fusion.types import Reason

_UNIT = ("rad/s", "m/s^2")


class Compensation:
    """The filters of gyros and accelerometers.

    Parameters
    ----------
    config : settings; an ordinary bias that is not known is taken for as large as the noise of a sample

    Attributes
    ----------
    rules : of gyros and accelerometers
    known : biases of gyros and accelerometers
    """

    def __init__(self, config: FusionConfig) -> None:
        array, sigma = config.array(), config.sigma()
        bias = (config.gyro_bias_sigma, config.accel_bias_sigma)
        self._settings = config.glr
        self._models = [
            TriadModel(array, sigma[k], bias[k] or sigma[k], config.glr.walk * sigma[k], 1.0 / config.rate_hz, *config.motion_errors()[k])
            for k in range(2)
        ]
        self.change_noise(sigma)
        self.known = [KnownBias(rules) for rules in self.rules]

    def change_noise(self, sigma: NDArray[np.float64]) -> None:
        """Rules for another noise (2, n) of the samples; what the filters know goes on after `go_on`."""
        models = [replace(model, sigma=sigma[k]) for k, model in enumerate(self._models)]
        self.rules: tuple[GlrRules, GlrRules] = (make_rules(models[0], self._settings), make_rules(models[1], self._settings))

    def go_on(self, states: tuple[GlrState, GlrState]) -> None:
        """Work on with what is known and the parity matrices of the noise that holds now."""
        for state in states:
            state.ints[BASED] = 0

    def fresh(self) -> tuple[GlrState, GlrState]:
        """Memory before the first sample; what was known of the sensors is forgotten."""
        for known in self.known:
            known.forget()
        return make_state(self._models[0], self._settings), make_state(self._models[1], self._settings)

    def warm_up(self) -> None:
        """Compile or load what answers the filter: it may be selected at any time."""
        glr, rules = self.fresh()[0], self.rules[0]
        d, n = glr.V.shape
        resolve(glr, rules, np.empty((d, d)), np.empty((d, n)), np.empty(d))
        take_in(glr, rules, -1, -1, 0, 0)

    def answer(self, kind: int, glr: GlrState, tables: Tables, slot: int) -> None:
        """Do what the filter asks for after a sample of the set of sensors in `slot`."""
        if glr.ints[CALL]:
            V, member, known = tables.V[kind, slot, : tables.dof[kind, slot]], tables.member[kind, slot], self.known[kind]
            if glr.ints[CALL] == OTHER_SET:
                for index in np.flatnonzero((glr.vec[USED] > 0.0) & (member == 0.0)).tolist():
                    known.leave(glr, index)
            answer(glr, self.rules[kind], V, member, tables.W[kind, slot], known.returning())

    def calibrate(self, calibration: Calibration) -> None:
        """A calibration holds from now on."""
        for kind, known in enumerate(self.known):
            known.fused = calibration.bias[kind], calibration.covariance[kind]

    def findings(self, kind: int, glr: GlrState, machines: Sequence[HealthMachine], stamp_ns: int) -> list[tuple[int, Change, str]]:
        """Step the health of the sensors the filter has opened or closed after a sample: (sensor, change, what to say of it)."""
        made = []
        drifted = glr.x - glr.vec[BEFORE]
        for index, machine in enumerate(machines):
            if glr.open[index] == OPEN:
                change, note = machine.compensate(stamp_ns, int(Reason.PARITY)), f", drift of {drifted[index]:+.3g} {_UNIT[kind]} removed"
            else:
                change, note = machine.recover(stamp_ns), ""
            if change is not None:
                made.append((index, change, note))
        return made

    def deaths(self, kind: int, glr: GlrState, machines: Sequence[HealthMachine], stamp_ns: int) -> list[tuple[int, Change, str]]:
        """Isolate the sensors the filter has found dead, before the sample of `stamp_ns`: it is the first without them."""
        glr.ints[CHANGED] = 0
        made = []
        for index, machine in enumerate(machines):
            if glr.whole[DEAD, index] and (change := machine.isolate(stamp_ns, int(Reason.PARITY))) is not None:
                noisy = glr.vec[NOISE, index] > self.rules[kind].noise_limit
                drifted = glr.x[index] - glr.vec[BEFORE, index]
                made.append((index, change, ", too noisy" if noisy else f", drift of {drifted:+.3g} {_UNIT[kind]} too large"))
        return made

    def recalled(self, kind: int, glr: GlrState, index: int) -> None:
        """What a sensor that leaves has put in is taken out at once by those who integrate: nothing of it is owed."""
        forgive(glr, index, self.rules[kind])

    def go_over(self, kind: int, glr: GlrState) -> None:
        """Another set of sensors is in use: the filter goes over to it at the next sample."""
        glr.ints[STRANGE] = self.rules[kind].patience


def drift(glr: GlrState) -> NDArray[np.float64]:
    """Drift removed from each sensor (n,)."""
    return np.where((glr.open == OPEN) & (glr.vec[USED] > 0.0), glr.x, 0.0)
