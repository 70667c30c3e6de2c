"""The aircraft of seed 002 on few seeds: targets 42 and 43; the many are in `riins reproduce aircraft`."""

from __future__ import annotations

import numpy as np

from riins_eval.studies import aircraft


def test_accuracy_and_faults() -> None:
    told: list[float] = []
    rows, figures = aircraft.run(2, True, told.append)
    assert told[-1] == 1.0 and not figures
    assert {row.target for row in rows} == {None, 42, 43}
    assert all(row.ok for row in rows if row.target == 42)
    assert all(row.ok for row in rows if row.target == 43 and "latitude" not in row.name)


def test_the_filter_s_errors_are_white_noise_s() -> None:
    """Innovations are what the model says, with correlated GPS only where it is modelled."""
    for known, low, high in ((True, 0.9, 1.1), (False, 0.0, 0.8)):
        nis = aircraft.fly(3, correlated=True, known=known).nis[aircraft.SCORED :, aircraft.GPS]
        assert low < np.mean(nis) / 6.0 < high
