"""The navigation state of a navigator that has none yet: what an alignment knows, and that the rest is invalid.

Lives here: `state_of`.
Does not live here: the state of a running navigator (solution.py).
"""

from __future__ import annotations

import numpy as np

from riins_core.ins_error import PHI
from riins_core.rotation import dcm_from_euler

from .alignment_settings import AlignmentReport, Phase
from .types import Mode, NavSolution, Validity

UNKNOWN = 1e6
"""Variance of what is not known, in the unit of the state squared."""


def state_of(report: AlignmentReport) -> NavSolution:
    """Mode alignment, or failed, with attitude and place as far as they are known; nothing is valid.

    Parameters
    ----------
    report : of an alignment

    Returns
    -------
    NavSolution; what is not known is zero, with a variance of `UNKNOWN`
    """
    rph, place = np.nan_to_num(report.rph), np.nan_to_num(report.place)
    variance = np.full(15, UNKNOWN)
    variance[PHI] = np.where(np.isfinite(report.sigma), report.sigma**2, np.pi**2)
    zero = np.zeros(3)
    mode = Mode.FAILED if report.phase is Phase.FAILED else Mode.ALIGNMENT
    return NavSolution(
        report.stamp_ns, float(place[0]), float(place[1]), float(place[2]), zero, rph, dcm_from_euler(*rph), zero, zero, zero, zero,
        np.diag(variance), mode, (Validity.INVALID,) * 3, float(np.sqrt(UNKNOWN)), float(np.pi), 0, (0.0, 0.0, 0.0),
    )  # fmt: skip
