"""What a live run looks like in a terminal: the table, the plain line, the summary.

Lives here: rendering of `Snapshot` and of a summary.
Does not live here: collecting the figures (monitor.py), deciding when to draw (live.py).
"""

from __future__ import annotations

import math
from typing import Any

from rich.console import Group, RenderableType
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from riins_bringup.monitor import MODES, VALIDITIES, Change, NavRow, Snapshot

_KNOT = 1852.0 / 3600.0
_STYLE = {
    "healthy": "green",
    "suspect": "yellow",
    "probation": "cyan",
    "compensated": "cyan",
    "isolated": "bold red",
    "excluded": "magenta",
    "absent": "red",
}
_VALIDITY_STYLE = ("green", "yellow", "bold red")


def angle(value: float, letters: str) -> str:
    """Degrees and decimal minutes of a latitude ('NS') or longitude ('EW') in rad, as on a chart."""
    minutes = round(abs(math.degrees(value)) * 60.0, 3)
    return f"{int(minutes // 60):02d}° {minutes % 60:06.3f}' {letters[value < 0.0]}"


def live_table(title: str, snapshot: Snapshot, duration_s: float) -> RenderableType:
    """The live table: navigation on the left, health and stream figures on the right."""
    grid = Table.grid(padding=(0, 2), expand=False)
    grid.add_row(_navigation(snapshot), _stream(snapshot))
    parts: list[RenderableType] = [grid, _sensors(snapshot)]
    parts += [Text(change_line(c, snapshot, relative=False), style=_STYLE.get(c.state, "")) for c in snapshot.changes[-4:]]
    return Panel(Group(*parts), title=f"{title}  {snapshot.elapsed_s:.1f} / {duration_s:.0f} s", subtitle="Ctrl-C stops", expand=False)


def _navigation(snapshot: Snapshot) -> Table:
    table = Table.grid(padding=(0, 1))
    nav = snapshot.nav
    if nav is None:
        table.add_row("waiting for the first navigation state")
        return table
    table.add_row("mode", Text(MODES[nav.mode], style="green" if nav.mode == 2 else "yellow"))
    table.add_row("position", Text(f"{angle(nav.latitude, 'NS')}  {angle(nav.longitude, 'EW')}", style=_VALIDITY_STYLE[nav.validity[0]]))
    table.add_row("heading", Text(f"{math.degrees(nav.heading) % 360.0:07.3f}°", style=_VALIDITY_STYLE[nav.validity[2]]))
    table.add_row("speed", Text(f"{_speed(nav) / _KNOT:.2f} kn", style=_VALIDITY_STYLE[nav.validity[1]]))
    table.add_row("protection radius", f"{nav.protection_radius:.1f} m")
    table.add_row("error position", _figure(snapshot.error_m, "m", 2))
    table.add_row("error velocity", _figure(snapshot.velocity_error_mps, "m/s", 3))
    table.add_row("error heading", _figure(snapshot.heading_error_arcmin, "arcmin", 2))
    return table


def _stream(snapshot: Snapshot) -> Table:
    table = Table.grid(padding=(0, 1))
    for topic in ("imu samples", "nav/state", "truth/state"):
        if topic in snapshot.rates_hz:
            table.add_row(f"rate {topic}", f"{snapshot.rates_hz[topic]:.1f} Hz")
    if snapshot.latency_ms:
        table.add_row("latency p50, p99", f"{snapshot.latency_ms['p50']:.1f}, {snapshot.latency_ms['p99']:.1f} ms")
    table.add_row("samples lost", _lost(snapshot.samples))
    for name, s in snapshot.subfilters.items():
        state, reason = snapshot.health.get(name, ("", ""))
        why = f" ({reason})" if state not in ("healthy", "") and reason not in ("none", "") else ""
        text = Text(f"{state + why:<21}", style=_STYLE.get(state, ""))
        counts = f" used {s['accepted']} rejected {s['rejected']} late {s['late']}"
        text.append(f" NIS {s['statistic']:6.1f} / {s['threshold']:.1f} {counts}", style="default")
        table.add_row(name, text)
    return table


def _sensors(snapshot: Snapshot) -> Table:
    table = Table.grid(padding=(0, 1))
    for kind in ("gyro", "accel"):
        names = sorted((n for n in snapshot.health if n.startswith(f"{kind}_")), key=lambda n: int(n.rsplit("_", 1)[1]))
        if names:
            table.add_row(kind, *(Text(f"{n.rsplit('_', 1)[1]} {snapshot.health[n][0]}", style=_STYLE.get(snapshot.health[n][0], "")) for n in names))
    return table


def plain_line(snapshot: Snapshot) -> str:
    """One line for a log or a pipe."""
    nav = snapshot.nav
    if nav is None:
        return "waiting for the first navigation state"
    words = [
        f"t {snapshot.elapsed_s:7.1f} s",
        MODES[nav.mode],
        f"{math.degrees(nav.latitude):.6f} {math.degrees(nav.longitude):.6f}",
        f"heading {math.degrees(nav.heading) % 360.0:.2f}",
        f"position {VALIDITIES[nav.validity[0]]}",
    ]
    if not math.isnan(snapshot.error_m):
        words.append(f"error {snapshot.error_m:.2f} m {snapshot.velocity_error_mps:.3f} m/s {snapshot.heading_error_arcmin:.1f} arcmin")
    words.append(f"imu {snapshot.rates_hz.get('imu samples', 0.0):.0f} Hz lost {_lost(snapshot.samples)}")
    if snapshot.latency_ms:
        words.append(f"latency {snapshot.latency_ms['p50']:.1f}/{snapshot.latency_ms['p99']:.1f} ms")
    bad = [f"{n} {s}" for n, (s, _) in snapshot.health.items() if s not in ("healthy", "suspect")]
    return ", ".join(words + bad)


def change_line(change: Change, snapshot: Snapshot, relative: bool = True) -> str:
    """One line about a change of health."""
    start = snapshot.nav.stamp_ns - round(snapshot.elapsed_s * 1e9) if snapshot.nav else change.stamp_ns
    reason = f" ({change.reason})" if change.reason not in ("", "none") and change.state != "healthy" else ""
    return f"{'t ' if relative else ''}{(change.stamp_ns - start) * 1e-9:8.2f} s  {change.target} {change.state}{reason}"


def summary_table(summary: dict[str, Any]) -> Table:
    """The table printed at the end of a run."""
    table = Table(title=f"{summary['title']}: {summary['ended']}", show_header=False, title_justify="left")
    table.add_row("measurement time", f"{summary['duration_s']:.1f} s")
    for name, key, unit, digits in (
        ("position error RMS", "position_rms_m", "m", 2),
        ("position error max", "position_max_m", "m", 2),
        ("velocity error RMS", "velocity_rms_mps", "m/s", 3),
        ("heading error RMS", "heading_rms_arcmin", "arcmin", 2),
    ):
        if summary[key] is not None:
            table.add_row(name, f"{summary[key]:.{digits}f} {unit}")
    if summary["latency_ms"]:
        table.add_row(
            "latency IMU stamp to NavState p50, p99, max", ", ".join(f"{summary['latency_ms'][k]:.1f}" for k in ("p50", "p99", "max")) + " ms"
        )
    samples = summary["samples"]
    table.add_row("IMU samples lost", _lost(samples))
    table.add_row("navigation states received, lost", f"{samples['nav_states']}, {samples['nav_states_lost']}")
    isolated = [f"{i['target']} at {i['at_s']:.1f} s" for i in summary["isolations"]]
    table.add_row("isolated", ", ".join(isolated) or "none")
    if summary["bag"]:
        table.add_row("bag", summary["bag"])
    table.add_row("logs", summary["logs"])
    return table


def not_comparable(samples: dict[str, int]) -> str:
    """One line when a simulated run lost samples or restarted, so that its errors are not those of the scenario; else empty."""
    lost, restarts = int(_lost(samples)), samples.get("restarts", 0)
    return f"not comparable: {lost} samples lost, {restarts} restarts" if lost or restarts else ""


def _lost(samples: dict[str, int]) -> str:
    # the navigator sees the sequence numbers of the source: what the fusion lost is a gap there too
    return str(max(samples.get("lost", 0), samples.get("navigator_lost", 0)))


def _speed(nav: NavRow) -> float:
    return math.hypot(nav.velocity_north, nav.velocity_east)


def _figure(value: float, unit: str, digits: int) -> str:
    return "-" if math.isnan(value) else f"{value:.{digits}f} {unit}"
