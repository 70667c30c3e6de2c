"""Threshold of the innovation test."""

from __future__ import annotations

import math

import pytest

from riins_fdi.innovation import nis_threshold


def test_closed_form_with_two_degrees_of_freedom() -> None:
    for pfa in (0.5, 1e-3, 1e-9, 1e-18):  # chi-square(2) is exponential: T = -2 ln pfa
        assert nis_threshold(pfa, 2) == pytest.approx(-2.0 * math.log(pfa), rel=1e-12)


def test_live_default_of_ten_hours_at_100_hz() -> None:
    assert nis_threshold(1.0 / (10 * 3600 * 100), 3) == pytest.approx(33.3, abs=0.05)


@pytest.mark.parametrize(("pfa", "dof"), [(0.0, 3), (1.0, 3), (-0.1, 3), (float("nan"), 3), (0.1, 0)])
def test_nonsense_is_refused(pfa: float, dof: int) -> None:
    with pytest.raises(ValueError):
        nis_threshold(pfa, dof)
