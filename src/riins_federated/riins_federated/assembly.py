"""The structure that the settings ask for, for a state and its aids.

Lives here: `make_structure`, `gate_probability`, `LAYOUT` of the navigator's error state.
Does not live here: the structures (structures.py, separated_masters.py), their settings (structure_settings.py).
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from riins_core.ins_error import State
from riins_core.settings import SettingError
from riins_fdi.innovation_tests import INNOVATION_TESTS
from riins_fdi.parity import false_alarm_probability

from .config import NavigatorConfig
from .separated_masters import SeparatedMasters
from .structure_settings import NO_TEST
from .structures import FederatedFilter, Gate, Layout, Structure
from .types import Array

LAYOUT = Layout(
    position=(State.POS_N, State.POS_E),
    navigation=(State.POS_N, State.POS_E, State.VEL_N, State.VEL_E, State.PHI_N, State.PHI_E, State.PHI_D),
    heading=State.PHI_D,
)
SATELLITE = "satellite"
"""What receivers of any satellite system have in common: one spoofer can pull them all."""
RETENTION = {"fusion_reset": 0.0, "no_reset": 1.0}


def make_structure(config: NavigatorConfig, P0: Array, aids: Sequence[Any]) -> Structure:
    """The structure at the start.

    Parameters
    ----------
    config : NavigatorConfig
    P0 : (n, n), covariance of the error state, which is zero
    aids : settings of each aid, in the order of the subfilters

    Raises
    ------
    SettingError
        Fixed shares that do not leave a positive one for the known height.
    """
    gates = [Gate(gate_probability(config, aid), _test(aid), hold=0) for aid in aids]  # how long it is held is the health machine's
    adaptive = [aid.adaptive_noise for aid in aids]
    x0 = np.zeros(len(P0))
    if config.structure in ("separated", "information"):
        settings = config.separation if config.structure == "separated" else replace(config.separation, left_out=0)
        kinds = [SATELLITE if aid.type.startswith("gnss") else f"{i}" for i, aid in enumerate(aids)]
        return SeparatedMasters(x0, P0, len(aids), settings, layout=LAYOUT, gate=gates, adaptive=adaptive, kinds=kinds)
    sharing, beta = config.sharing, None
    if sharing.kind == "fixed":
        beta = np.append(sharing.shares, 1.0 - sum(sharing.shares))
        if len(beta) != len(aids) + 1 or not beta[-1] > 0.0:
            raise SettingError(f'"sharing.shares" needs one share for each of {len(aids)} aids, and must leave some of one for the known height')
    return FederatedFilter(
        x0, P0, len(aids), retention=RETENTION.get(config.structure, config.retention), beta=beta, common=True,
        sharing="fixed" if sharing.kind == "equal" else sharing.kind, layout=LAYOUT, gate=gates, adaptive=adaptive,
    )  # fmt: skip


def gate_probability(config: NavigatorConfig, aid: Any) -> float:
    """False-alarm probability of one innovation test of an aid: its own, or of a mean time between false alarms, else those of section isolation."""
    common = config.isolation
    if aid.false_alarm_probability:
        return float(aid.false_alarm_probability)
    hours = aid.mean_time_between_false_alarms_h or common.mean_time_between_false_alarms_h
    return min(false_alarm_probability(hours, 1.0 / aid.period_s), 0.5) if hours else common.false_alarm_probability


def _test(aid: Any) -> Any:
    if aid.further_test == NO_TEST:
        return None
    return functools.partial(INNOVATION_TESTS[aid.further_test], epochs=max(aid.further_test_interval_h * 3600.0 / aid.period_s, 2.0))
