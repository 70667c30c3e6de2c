"""Targets 10-14 on few seeds, the flight they are flown on, and the study's rows and figures."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.figure import Figure as Canvas

from riins_eval.studies import thesis_flight, thesis_fusion

SEEDS = 3


@pytest.fixture(scope="module")
def chapter_5() -> dict[str, np.ndarray]:
    made = [thesis_fusion.chapter_5(seed) for seed in range(SEEDS)]
    return {key: np.array([one[key] for one in made]) for key in made[0]}


@pytest.fixture(scope="module")
def chapter_6() -> dict[str, np.ndarray]:
    made = [thesis_fusion.chapter_6(seed) for seed in range(SEEDS)]
    return {key: np.array([one[key] for one in made]) for key in made[0]}


def test_the_flight_closes_and_is_the_thesis_flight() -> None:
    flight = thesis_flight.flight()
    error = thesis_flight.position_error(flight.nav, flight.true)
    assert np.max(np.abs(error)) < 0.01
    assert np.max(np.abs(flight.nav[:, 6:15] - flight.true[:, 6:15])) < 1e-6
    speed = np.linalg.norm(flight.true[:, 3:6], axis=1)
    assert speed[0] < 0.01 and np.all(np.abs(speed[flight.t > 20.0] - thesis_flight.SPEED) < 1e-9)
    pitch = np.degrees(np.arcsin(-flight.true[:, 12]))
    heading = np.degrees(np.unwrap(np.arctan2(flight.true[:, 9], flight.true[:, 6])))
    assert abs(pitch.max() - 10.0) < 1e-6 and abs(pitch.min() + 5.0) < 1e-6
    assert abs(heading.max() - 60.0) < 1e-6 and abs(heading[-1] + 30.0) < 1e-6
    assert flight.t[-1] > 200.0  # the third way of target 13 has an outage


def test_optimal_fusion_told_the_truth(chapter_5: dict[str, np.ndarray]) -> None:
    """Target 10."""
    assert np.all(chapter_5["opt"] <= 0.42)
    assert np.all(chapter_5["optdc"] <= 0.42)
    np.testing.assert_allclose(chapter_5["optdc"], chapter_5["opt"], rtol=1e-6)
    assert np.all(chapter_5["opt_wrong"] > 1.2)


def test_optimal_fusion_told_nothing_is_least_squares(chapter_5: dict[str, np.ndarray]) -> None:
    """Target 11."""
    assert np.all((chapter_5["opt_untold"] > 0.98) & (chapter_5["opt_untold"] < 1.02))
    np.testing.assert_allclose(chapter_5["opt_still"], 1.0, atol=1e-6)
    np.testing.assert_allclose(chapter_5["opt_equal"], 1.0, atol=1e-6)


def test_adaptive_fusion(chapter_5: dict[str, np.ndarray]) -> None:
    """Target 12 in the mean; what it lives on is that the printed P gives gyros 1 and 3 away."""
    assert chapter_5["aopt"].mean() <= 0.80
    assert np.all(chapter_5["aopt_level"] > chapter_5["aopt"]) and chapter_5["aopt_level"].mean() > 0.85


def test_joint_and_two_filters_agree_after_the_fix(chapter_6: dict[str, np.ndarray]) -> None:
    """Target 13, three readings and three experiments."""
    for number in (1, 2, 3):
        for way in range(3):
            ratio = chapter_6[f"{number} po_na {way}"] / chapter_6[f"{number} wls_na {way}"]
            assert np.all(np.abs(ratio - 1.0) < 0.05)
    assert np.all(chapter_6["2 po_na at"] / chapter_6["2 wls_na_without_parity at"] <= 0.60)


def test_estimated_noise_remembers_what_the_fix_taught(chapter_6: dict[str, np.ndarray]) -> None:
    assert np.mean(chapter_6["3 ipo_na 0"]) < 0.5 * np.mean(chapter_6["3 po_na 0"])
    assert np.mean(chapter_6["3 ipo_na 2"]) < np.mean(chapter_6["3 po_na 2"])


def test_noise_estimates_of_the_printed_noise() -> None:
    """Target 14."""
    for seed in range(10):
        made = thesis_fusion.noise_estimates(seed)
        for kind, bad in ((0, (0, 2)), (1, (0, 4))):
            assert np.all(np.abs(made["walk"][kind][list(bad)] - 1.0) < 0.25)
        assert np.all((made["white"] > 0.5) & (made["white"] < 2.0))
        assert np.max(made["still"]) < 0.01  # a constant drift is no process noise


def test_rows_and_figures() -> None:
    told: list[float] = []
    rows, drawn = thesis_fusion.run(1, True, told.append)
    assert told[-1] == 1.0 and told == sorted(told)
    assert {one.target for one in rows} == {None, 10, 11, 12, 13, 14}
    assert all(one.p05 <= one.value <= one.p95 and one.n == 1 for one in rows)
    assert all(one.ok for one in rows if one.target is not None)
    assert len({one.name for one in drawn}) == len(drawn) == 20
    for one in drawn:
        canvas = Canvas()
        one.draw(canvas)
        assert canvas.axes and all(axes.lines for axes in canvas.axes)
