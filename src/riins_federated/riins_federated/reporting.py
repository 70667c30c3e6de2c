"""What the navigator tells the operator: what changed, diagnostics, and when it is due by measurement time.

Lives here: `Grid`, `what_changed`, `diagnosis`.
Does not live here: messages (riins_node.fields), the counters themselves (navigator.py).
"""

from __future__ import annotations

from typing import Any

from riins_fdi.health import SUBFILTER_CODE

from .types import FederatedReport, Mode, Reason

STATE_NAME = {code: state.name.lower() for state, code in SUBFILTER_CODE.items()}
HEALTHY = 0


class Grid:
    """Says once in every period of measurement time that something is due.

    Parameters
    ----------
    period_s : 0: at every stamp
    """

    def __init__(self, period_s: float) -> None:
        self._period = round(period_s * 1e9)
        self._cell: int | None = None
        self._stamp: int | None = None

    def due(self, stamp_ns: int) -> bool:
        """True for the first stamp in each cell of the grid, also when stamps go back."""
        cell = stamp_ns // self._period if self._period else stamp_ns
        if cell == self._cell:
            return False
        self._cell, self._stamp = cell, stamp_ns
        return True

    def now(self, stamp_ns: int) -> bool:
        """`due` was true at this very stamp, or is."""
        return self._stamp == stamp_ns or self.due(stamp_ns)


def what_changed(before: FederatedReport | None, report: FederatedReport) -> str | None:
    """One line on changes of mode and health; '' when only a measurement was judged; None when nothing happened."""
    if before is None:
        return ""
    lines = []
    if report.mode is not before.mode:
        lines.append(f"{before.mode.name.lower()} -> {report.mode.name.lower()}")
    if report.restarts != before.restarts:
        lines.append("IMU stamp jumped: run restarted")
    for old, new in zip(before.subfilters, report.subfilters, strict=True):
        if new.state != old.state:
            reason = f" ({new.reason.name.lower()})" if new.reason is not Reason.NONE else ""
            lines.append(f"{new.name}: {STATE_NAME[old.state]} -> {STATE_NAME[new.state]}{reason}")
    if lines:
        return "; ".join(lines)
    return "" if report.subfilters != before.subfilters else None


def diagnosis(report: FederatedReport, refused_initial_states: int, refused_commands: int = 0) -> list[tuple[str, str, str, dict[str, Any]]]:
    """Statuses for diagnostic_msgs: (name, level, message, values), the navigator's and one for each subfilter."""
    counts: dict[str, Any] = {name: getattr(report, name) for name in ("imu_received", "imu_lost", "imu_rejected", "restarts", "rollbacks")}
    counts["initial_states_refused"], counts["commands_refused"] = refused_initial_states, refused_commands
    apart = report.cross_check > report.cross_check_threshold
    if report.cross_check_threshold:
        counts["cross-check of the receivers"] = f"{report.cross_check:.2f} (threshold {report.cross_check_threshold:.2f})"
    level = "ok" if report.mode is Mode.NAVIGATING else "warn" if report.mode in (Mode.COASTING, Mode.WAITING, Mode.ALIGNMENT) else "error"
    word = {Mode.COASTING: "coasting: no aid is fused", Mode.WAITING: "waiting for an initial state"}.get(report.mode, report.mode.name.lower())
    if apart:
        level, word = ("warn" if level == "ok" else level), f"{word}; the satellite receivers contradict each other"
    statuses = [("navigator", level, word, counts)]
    for sub in report.subfilters:
        values = {
            "statistic": f"{sub.statistic:.3f}",
            "threshold": f"{sub.threshold:.3f}",
            "separation": f"{sub.separation:.2f} (threshold {sub.separation_threshold:.2f})",
            "reason of last rejection": sub.reason.name.lower(),
            "accepted": sub.accepted,
            "rejected": sub.rejected,
            "late": sub.late,
            "malformed": sub.malformed,
            "no fix": sub.no_fix,
        }
        statuses.append((f"navigator: {sub.name}", "ok" if sub.state == HEALTHY else "warn", STATE_NAME[sub.state], values))
    return statuses
