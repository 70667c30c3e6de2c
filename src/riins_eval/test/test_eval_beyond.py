"""Target 15 on few seeds, and what the study shows beside it."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.figure import Figure as Canvas

from riins_eval.studies import beyond

SEEDS = 8


@pytest.mark.parametrize(
    ("case", "middle", "high", "right"), [("table", 0.02, 0.04, 1.0), ("staggered", 0.025, 0.06, 0.99), ("wave", 0.03, 0.06, 0.85)]
)
def test_nobody_tells_it_which_sensor(case: str, middle: float, high: float, right: float) -> None:
    made = [beyond.numbers(case, seed, ("glr_kf",))["glr_kf"] for seed in range(SEEDS)]
    ratio = [one[0] for one in made]
    assert np.median(ratio) <= middle and np.percentile(ratio, 95) <= high
    assert np.mean([one[1] for one in made]) >= right
    assert sum(one[2] for one in made) == 0


def test_healthy_sensors_are_not_named_where_the_bank_names_them() -> None:
    made = [beyond.numbers("unequal", seed, ("glr_kf", "bank")) for seed in range(SEEDS)]
    assert sum(one["glr_kf"][2] for one in made) == 0
    assert np.median([one["glr_kf"][0] for one in made]) < np.median([one["bank"][0] for one in made])


def test_rows_and_figure() -> None:
    told: list[float] = []
    rows, figures = beyond.run(2, True, told.append)
    assert told[-1] == pytest.approx(1.0) and len(rows) == 3 * len(beyond.CASES) + 2
    targets = [r for r in rows if r.target == 15]
    assert len(targets) == 2 and all(r.ok for r in targets)
    assert [r.ok for r in rows if r.target == 16] == [True, True]
    canvas = Canvas()
    figures[0].draw(canvas)
    assert canvas.axes[0].get_yscale() == "log"
