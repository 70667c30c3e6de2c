"""Legs: what they add up to, and how smooth they are."""

import numpy as np
import pytest

from riins_core.sensor_errors import KNOT
from riins_core.settings import SettingError, build
from riins_sim.course import LegSettings, course_at, segments

LEGS = [
    LegSettings(straight_s=20.0),
    LegSettings(turn_deg=-90.0, rate_deg_s=1.5),
    LegSettings(speed_kn=4.0, acceleration_mps2=0.1),
    LegSettings(turn_deg=5.0, rate_deg_s=1.0),  # too small for its blends
    LegSettings(straight_s=10.0),
    LegSettings(speed_kn=12.0, acceleration_mps2=0.2),
]


def _sample(t, table):
    return np.array([course_at(x, table) for x in t])


def test_legs_add_up():
    table = segments(LEGS, 0.5, 10.0 * KNOT)
    end = _sample([table[-1, 0] + 100.0], table)[0]
    assert end[0] == pytest.approx(0.5 + np.deg2rad(-85.0), abs=1e-12)
    assert end[4] == pytest.approx(12.0 * KNOT, abs=1e-12)
    assert np.all(end[[1, 2, 3, 5]] == 0.0)
    turning = _sample(np.linspace(20.0, 90.0, 2000), table)[:, 1]
    assert turning.min() == pytest.approx(np.deg2rad(-1.5), rel=1e-9)
    accelerating = _sample(np.linspace(0.0, table[-1, 0], 20000), table)[:, 5]
    assert accelerating.min() == pytest.approx(-0.1, rel=1e-3)
    assert accelerating.max() == pytest.approx(0.2, rel=1e-3)
    small = table[3]
    assert small[5] == pytest.approx(5.0) and small[6] == pytest.approx(0.0, abs=1e-12)


def test_course_is_smooth():
    table = segments(LEGS, 0.5, 10.0 * KNOT)
    h = 1e-3
    t = np.arange(h, table[-1, 0] + 5.0, 0.0917)
    before, here, after = _sample(t - h, table), _sample(t, table), _sample(t + h, table)
    for value, slope, tolerance in ((0, 1, 1e-8), (1, 2, 1e-7), (2, 3, 1e-5), (4, 5, 1e-5)):
        assert (after[:, value] - before[:, value]) / (2 * h) == pytest.approx(here[:, slope], abs=tolerance)
    # no jump of the second derivative of heading, nor of the acceleration, where legs meet
    for edge in table[1:, 0]:
        left, right = _sample([edge - 1e-9], table)[0], _sample([edge + 1e-9], table)[0]
        assert left == pytest.approx(right, abs=1e-7)


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({}, "exactly one"),
        ({"straight_s": 1.0, "turn_deg": 3.0, "rate_deg_s": 1.0}, "exactly one"),
        ({"turn_deg": 3.0}, "needs rate_deg_s"),
        ({"speed_kn": 3.0}, "needs acceleration_mps2"),
        ({"straight_s": 3.0, "rate_deg_s": 1.0}, "belongs to a leg with turn_deg"),
        ({"straight_m": 3.0}, "straight_s"),
    ],
)
def test_bad_legs(values, words):
    with pytest.raises(SettingError, match=words):
        build(LegSettings, values)
