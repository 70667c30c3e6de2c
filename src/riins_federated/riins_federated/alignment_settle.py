"""What the bridge is told of the heading: phase, code, bound against limit, and how long it took to settle (A.821).

Lives here: `AlignmentStatus`, `SettleWatch`: a function of settled reports and states alone.
Does not live here: the alignment (aligner.py), the message (riins_node.alignment_fields), the score (riins_eval.score).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from riins_core.ins_error import PHI

from .aligner import BOUND, heading_limit
from .alignment_settings import AlignmentReport, Phase
from .config import NavigatorConfig
from .types import Array, Mode, NavSolution

GNSS_ONLY, LEVELING, DEGRADED, ALIGNED, FULL = range(5)
"""IMU alignment status as the sentence PASHR numbers it."""
_CODES = {Phase.STANDBY: GNSS_ONLY, Phase.COARSE: LEVELING, Phase.FINE: DEGRADED, Phase.FAILED: GNSS_ONLY, Phase.COASTING: DEGRADED}


@dataclass(frozen=True)
class AlignmentStatus:
    """One status.

    Attributes
    ----------
    stamp_ns, phase, method, rph, sigma, elapsed_s, text : as in AlignmentReport
    code : GNSS_ONLY .. FULL
    bound, limit : 95 % error bound of the heading and what it must be inside of, rad; NaN: not known
    settle_s : from the beginning until the bound of a heading given out came to stay inside; -1: it is not
    """

    stamp_ns: int
    phase: Phase
    code: int
    method: str
    rph: Array
    sigma: Array
    bound: float
    limit: float
    elapsed_s: float
    settle_s: float
    text: str

    @classmethod
    def unknown(cls) -> AlignmentStatus:
        """Before anything is known."""
        nan = np.full(3, math.nan)
        return cls(0, Phase.STANDBY, GNSS_ONLY, "", nan, nan, math.nan, math.nan, 0.0, -1.0, "")


class SettleWatch:
    """Makes statuses of settled reports and states.

    Parameters
    ----------
    config : of the navigator

    Notes
    -----
    The bound is 1.96 sigma of the filter's own covariance, the limit `validity.heading_deg` times sec(latitude). Settled is a heading that is given
    out, so the alignment counts in full; one that leaves the limit again has not settled, and begins to count where it comes back.
    """

    def __init__(self, config: NavigatorConfig) -> None:
        self._config = config
        self._begin_ns: int | None = None
        self._inside_ns: int | None = None
        self._method = ""
        self._busy = False  # an alignment beside the navigation speaks for itself

    def take(self, reports: list[AlignmentReport], solutions: list[NavSolution]) -> list[AlignmentStatus]:
        """Statuses of what was settled since the last call, in order of stamp."""
        items: list[AlignmentReport | NavSolution] = sorted([*reports, *solutions], key=lambda one: (one.stamp_ns, isinstance(one, NavSolution)))
        out: list[AlignmentStatus] = []
        for one in items:
            if isinstance(one, AlignmentReport):
                out.append(self._of_report(one))
                self._busy = not one.ended
            else:
                status = self._of_solution(one)
                if not self._busy or status.text:
                    out.append(status)
        return out

    def _of_report(self, report: AlignmentReport) -> AlignmentStatus:
        if report.initial is not None:
            self._begin_ns, self._inside_ns, self._method = report.begin_ns, None, report.method
        elif self._begin_ns is None:
            self._method = report.method
        sigma = float(report.sigma[2])
        limit = heading_limit(self._config, float(report.place[0])) if np.isfinite(report.place[0]) else math.nan
        phase = report.phase
        return AlignmentStatus(
            report.stamp_ns, phase, _CODES.get(phase, ALIGNED), report.method, report.rph, report.sigma, BOUND * sigma, limit,
            report.elapsed_s, self._settle_s(), report.text,
        )  # fmt: skip

    def _of_solution(self, state: NavSolution) -> AlignmentStatus:
        if self._begin_ns is None:
            self._begin_ns = state.stamp_ns
        sigma = np.sqrt(np.diag(state.P)[PHI])
        bound, limit = BOUND * float(sigma[2]), heading_limit(self._config, state.lat)
        text = ""
        if bound <= limit and self._inside_ns is None:
            self._inside_ns = state.stamp_ns
            text = f"heading settled after {self._settle_s():.0f} s: 95 % bound {math.degrees(bound):.2g} deg inside {math.degrees(limit):.2g}"
        elif bound > limit and self._inside_ns is not None:
            self._inside_ns = None
            text = f"heading no longer settled: 95 % bound {math.degrees(bound):.2g} deg, {math.degrees(limit):.2g} asked for"
        phase = Phase.COASTING if state.mode is Mode.COASTING else Phase.NAVIGATING
        code = DEGRADED if phase is Phase.COASTING else FULL if self._inside_ns is not None else ALIGNED
        elapsed = (state.stamp_ns - self._begin_ns) * 1e-9
        return AlignmentStatus(
            state.stamp_ns, phase, code, self._method, state.rph, _euler_sigma(state), bound, limit, elapsed, self._settle_s(), text
        )  # fmt: skip

    def _settle_s(self) -> float:
        if self._inside_ns is None or self._begin_ns is None:
            return -1.0
        return (self._inside_ns - self._begin_ns) * 1e-9


def _euler_sigma(state: NavSolution) -> Array:
    """Standard deviations of roll, pitch and heading, to first order at small pitch."""
    P, heading = state.P[PHI, PHI], float(state.rph[2])
    along = np.array([math.cos(heading), math.sin(heading), 0.0])
    across = np.array([-math.sin(heading), math.cos(heading), 0.0])
    return np.sqrt([along @ P @ along, across @ P @ across, P[2, 2]])
