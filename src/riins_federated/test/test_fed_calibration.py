"""Calibrations: a function of settled states alone, with the bias and its covariance as the navigator has them."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from riins_core.ins_error import State
from riins_core.settings import SettingError
from riins_federated.calibration import Calibrator
from riins_federated.config import NavigatorConfig
from riins_federated.state_blocks import StateModel
from riins_federated.types import Mode

S = 1_000_000_000


def settled(stamp_ns: int, mode: Mode = Mode.NAVIGATING) -> SimpleNamespace:
    states = StateModel(NavigatorConfig().inertial, ["gyro_markov"])
    P = np.diag(np.arange(1.0, states.n + 1))
    drift = states.places["gyro_markov"].start
    P[State.BG_X, drift] = P[drift, State.BG_X] = -2.0
    return SimpleNamespace(stamp_ns=stamp_ns, bias_g=np.array([1.0, 2.0, 3.0]) * stamp_ns, bias_a=np.array([4.0, 5.0, 6.0]), P=P, mode=mode)


def test_one_of_each_interval_and_none_before_the_second() -> None:
    states = [settled(7 * S + k * S) for k in range(30)]
    whole = Calibrator(NavigatorConfig()).take(states)
    assert [(c.estimated_ns, c.effective_ns) for c in whole] == [(10 * S, 30 * S), (20 * S, 40 * S), (30 * S, 50 * S)]
    one_by_one = Calibrator(NavigatorConfig())
    assert [c.effective_ns for state in states for c in one_by_one.take([state])] == [c.effective_ns for c in whole]
    assert whole[0].gyro_bias.tolist() == [10 * S, 20 * S, 30 * S]
    # gyro bias and Gauss-Markov drift together: variances 10 + 16 and twice the covariance of -2
    assert np.diagonal(whole[0].gyro_covariance).tolist() == [22.0, 28.0, 30.0]
    assert np.diagonal(whole[0].accel_covariance).tolist() == [13.0, 14.0, 15.0]


def test_none_while_there_is_no_solution_or_when_it_is_off() -> None:
    states = [settled(k * S, Mode.ALIGNMENT) for k in range(30)]
    assert not Calibrator(NavigatorConfig()).take(states)
    assert not Calibrator(NavigatorConfig(calibration_period_s=0.0)).take([settled(k * S) for k in range(30)])


def test_a_lead_that_cannot_arrive_in_time_is_refused() -> None:
    with pytest.raises(SettingError, match="calibration_lead_s"):
        NavigatorConfig(calibration_lead_s=2.0)
