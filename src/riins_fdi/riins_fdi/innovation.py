"""Fault tests on the innovation of a Kalman filter.

Lives here: the chi-square test of one epoch (normalized innovation squared, NIS).
Does not live here: the innovation itself (riins_core.kalman.update), what follows from a failed test (riins_fdi.health).
"""

from __future__ import annotations

import functools

from scipy.stats import chi2


@functools.lru_cache(maxsize=1024)
def nis_threshold(pfa: float, dof: int) -> float:
    """Threshold of the normalized innovation squared.

    Parameters
    ----------
    pfa : probability that a good measurement exceeds it, 0 < pfa < 1
    dof : components of the innovation

    Returns
    -------
    T with P(chi-square(dof) > T) = pfa; `isf`, not `ppf(1 - pfa)`, which has no digits left below 1e-15

    Raises
    ------
    ValueError
        pfa outside (0, 1) or dof < 1.
    """
    if not 0.0 < pfa < 1.0:
        raise ValueError(f"the false-alarm probability must be in (0, 1), not {pfa}")
    if dof < 1:
        raise ValueError(f"the test needs at least one degree of freedom, not {dof}")
    return float(chi2.isf(pfa, dof))
