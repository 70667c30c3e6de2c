"""The figures of a report as data: panels of traces, bands, timelines and shaded faults, already thinned for drawing.

Lives here: `figures`; every number a reader sees in a figure is made here.
Does not live here: what a figure is made of (figure.py), drawing (draw_png.py, draw_html.py), the numbers in the tables (score.py).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from riins_core import earth
from riins_core.ins_error import State

from . import metrics
from .figure import AID_COLORS, AID_NAMES, ESTIMATE, INK, MOST_POINTS, MUTED, REJECTED, Band, Bar, Figure, Floats, Panel, Shade, Trace, thin
from .run_record import SENSOR_STATES, SUBFILTER_STATES, HealthChange, Judged, RunRecord, is_imu_sensor


def figures(record: RunRecord) -> list[Figure]:
    """All figures of a run, those without data left out.

    Parameters
    ----------
    record : of any run

    Returns
    -------
    list of Figure: track, position, velocity, attitude, innovations, health
    """
    clock = _Clock(record)
    made = [
        _track(record),
        _position(record, clock),
        _velocity(record, clock),
        _inertial(record, clock),
        _attitude(record, clock),
        _innovations(record, clock),
        _health(record, clock),
    ]
    return [f for f in made if f is not None]


class _Clock:
    """The time axis of a run: seconds, minutes or hours since its start, whichever reads best."""

    def __init__(self, record: RunRecord) -> None:
        self.start_ns = record.start_ns
        self.stop_ns = int(record.settled.stamp_ns[-1]) if len(record.settled) else self.start_ns
        span = (self.stop_ns - self.start_ns) * 1e-9
        self.unit, self.scale = ("s", 1.0) if span <= 900 else ("min", 60.0) if span <= 3 * 3600 else ("h", 3600.0)
        self.label = f"time since start [{self.unit}]"
        # a gap between the pieces of a recording must not be drawn as a line
        self.gap_ns = 5_000_000_000
        self.shades = [
            Shade(self.at(f.start_ns), self.at(min(f.end_ns, self.stop_ns)), f.target)
            for f in record.faults
            if f.end_ns > self.start_ns and f.start_ns < self.stop_ns
        ]

    def at(self, stamp_ns: int) -> float:
        return (max(stamp_ns, self.start_ns) - self.start_ns) * 1e-9 / self.scale

    def of(self, stamp_ns: NDArray[np.int64]) -> Floats:
        return np.asarray((stamp_ns - self.start_ns) * 1e-9 / self.scale, dtype=np.float64)

    @property
    def x_range(self) -> tuple[float, float]:
        return 0.0, max(self.at(self.stop_ns), 1e-9)

    def line(self, stamp_ns: NDArray[np.int64], y: Floats) -> tuple[Floats, Floats]:
        """A line over time, broken at gaps and thinned."""
        x = self.of(stamp_ns)
        gaps = np.flatnonzero(np.diff(stamp_ns) > self.gap_ns)
        x, y = np.insert(x, gaps + 1, np.nan), np.insert(np.asarray(y, dtype=np.float64), gaps + 1, np.nan)
        if not len(gaps):
            return thin(x, y)
        parts = np.split(np.arange(len(x)), np.flatnonzero(np.isnan(x)))
        thinned = [thin(x[p[1:]] if i else x[p], y[p[1:]] if i else y[p], max(10, MOST_POINTS // len(parts) - 1)) for i, p in enumerate(parts)]
        joined_x: list[Floats] = []
        joined_y: list[Floats] = []
        for px, py in thinned:
            joined_x += [px, np.array([np.nan])]
            joined_y += [py, np.array([np.nan])]
        return np.concatenate(joined_x[:-1]), np.concatenate(joined_y[:-1])


def _error_panel(record: RunRecord, clock: _Clock, label: str, error: Floats, sigma: Floats | None, first: bool) -> Panel:
    stamps = record.settled.stamp_ns
    x, y = clock.line(stamps, error)
    panel = Panel(label, [Trace(x, y, "error", ESTIMATE, legend=first)], shades=clock.shades)
    highest = _scored_peak(record, np.abs(error), np.zeros(0) if sigma is None else 3.0 * sigma)
    panel.y_range = (-highest, highest) if highest else None
    if sigma is not None:
        x, bound = clock.line(stamps, 3.0 * sigma)
        panel.bands.append(Band(x, -bound, bound, "3 sigma", ESTIMATE, legend=first))
    return panel


def _scored_peak(record: RunRecord, *curves: Floats) -> float | None:
    """Height of an axis that shows what is scored, where something before it (a start without aids) would dwarf it; None: show all."""
    if record.pieces or not len(record.settled):
        return None
    scored = record.settled.stamp_ns >= record.scoring_from_ns
    known = [c for c in curves if len(c) == len(scored) and np.isfinite(c).any()]
    inside = [c[scored & np.isfinite(c)] for c in known]
    peak = max((float(c.max()) for c in inside if len(c)), default=0.0)
    everything = max((float(np.nanmax(c)) for c in known), default=0.0)
    return 1.25 * peak if 0.0 < 3.0 * peak < everything else None


def _sigma(record: RunRecord, state: State) -> Floats | None:
    if record.covariance is None:
        return None
    block = metrics.reduce_covariance(record.covariance)
    index = metrics.NEES7.index(state)
    return np.sqrt(np.maximum(block[:, index, index], 0.0))


def _known(*arrays: Floats) -> bool:
    return all(np.isfinite(a).any() for a in arrays)


def _track(record: RunRecord) -> Figure | None:
    if not len(record.settled):
        return None
    lat0, lon0 = float(record.settled.lat[0]), float(record.settled.lon[0])
    r_m, r_n = earth.radii(lat0)

    def plane(lat: Floats, lon: Floats) -> tuple[Floats, Floats]:
        return np.asarray((lon - lon0) * float(r_n) * np.cos(lat0)), np.asarray((lat - lat0) * float(r_m))

    east, north = plane(record.settled.lat, record.settled.lon)
    far = max(np.nanmax(np.abs(east)), np.nanmax(np.abs(north))) > 5000.0
    scale, unit = (1000.0, "km") if far else (1.0, "m")
    panel = Panel(f"north [{unit}]")
    for name, (_, lat, lon) in sorted(record.aid_fixes.items()):
        x, y = plane(lat, lon)
        step = max(1, len(x) // MOST_POINTS + (len(x) > MOST_POINTS))
        near = _plausible(x, y, east, north)
        panel.traces.append(
            Trace(x[near][::step] / scale, y[near][::step] / scale, f"{AID_NAMES.get(name, name)} fixes", AID_COLORS.get(name, MUTED), "dots")
        )
    gaps = np.flatnonzero(np.diff(record.settled.stamp_ns) > 5_000_000_000) + 1
    step = max(1, len(east) // MOST_POINTS + (len(east) > MOST_POINTS))

    def path(x: Floats, y: Floats) -> tuple[Floats, Floats]:
        return np.insert(x, gaps, np.nan)[::step] / scale, np.insert(y, gaps, np.nan)[::step] / scale

    if _known(record.truth.lat):
        panel.traces.append(Trace(*path(*plane(record.truth.lat, record.truth.lon)), "truth", INK, width=2.6))
    panel.traces.append(Trace(*path(east, north), "estimate", ESTIMATE, width=1.6))
    return Figure(
        "track", "Track", "True and estimated track, and the position aids as they reported.", f"east [{unit}]", [panel], equal=True, height=560
    )


def _plausible(x: Floats, y: Floats, east: Floats, north: Floats) -> NDArray[np.bool_]:
    """Fixes within a view of three times the track: a fix 100 km off would shrink the track to a dot."""
    span = 3.0 * max(np.ptp(east), np.ptp(north), 300.0)
    return np.asarray(np.isfinite(x) & (np.abs(x - np.mean(east)) < span) & (np.abs(y - np.mean(north)) < span))


def _position(record: RunRecord, clock: _Clock) -> Figure | None:
    error = metrics.position_error(record.settled, record.truth)
    if not _known(error[:, :2]):
        return None
    panels = [
        _error_panel(record, clock, "north [m]", error[:, 0], _sigma(record, State.POS_N), True),
        _error_panel(record, clock, "east [m]", error[:, 1], _sigma(record, State.POS_E), False),
    ]
    horizontal = Panel(
        "horizontal [m]", [Trace(*clock.line(record.settled.stamp_ns, np.hypot(error[:, 0], error[:, 1])), "error", ESTIMATE, legend=False)]
    )
    horizontal.shades = clock.shades
    peak = _scored_peak(record, np.hypot(error[:, 0], error[:, 1]), np.zeros(0) if record.protection_radius is None else record.protection_radius)
    horizontal.y_range = (0.0, peak) if peak else None
    if record.protection_radius is not None and np.isfinite(record.protection_radius).any():
        x, y = clock.line(record.settled.stamp_ns, record.protection_radius)
        horizontal.traces.append(Trace(x, y, "protection radius", INK, "dash"))
    if record.twin is not None and len(record.twin) == len(record.settled):
        x, y = clock.line(record.settled.stamp_ns, metrics.horizontal_distance(record.settled, record.twin))
        horizontal.traces.append(Trace(x, y, "from the fault-free twin", REJECTED))
    panels.append(horizontal)
    return Figure(
        "position",
        "Position error",
        "Computed minus true, with the 3-sigma bounds the filter claims. The axis covers the part that is scored.",
        clock.label,
        panels,
        x_range=clock.x_range,
    )


def _velocity(record: RunRecord, clock: _Clock) -> Figure | None:
    error = record.settled.v_n - record.truth.v_n
    if not _known(error[:, :2]):
        return None
    panels = [
        _error_panel(record, clock, "north [m/s]", error[:, 0], _sigma(record, State.VEL_N), True),
        _error_panel(record, clock, "east [m/s]", error[:, 1], _sigma(record, State.VEL_E), False),
    ]
    return Figure("velocity", "Velocity error", "Computed minus true, over ground.", clock.label, panels, x_range=clock.x_range)


def _inertial(record: RunRecord, clock: _Clock) -> Figure | None:
    if record.inertial is None:
        return None
    stamps, velocity = record.settled.stamp_ns, (record.inertial.v_n - record.settled.v_n)[:, :2]
    apart = {"position [m]": metrics.horizontal_distance(record.inertial, record.settled), "velocity [m/s]": np.hypot(*velocity.T)}
    panels = [Panel(label, [Trace(*clock.line(stamps, y), "apart", ESTIMATE, legend=False)], shades=clock.shades) for label, y in apart.items()]
    caption = "How far the solution without output correction is from the corrected one, horizontally. It is fed back where it falls to zero."
    return Figure("inertial", "Inertial solution", caption, clock.label, panels, x_range=clock.x_range)


def _attitude(record: RunRecord, clock: _Clock) -> Figure | None:
    phi = metrics.attitude_error(record.settled, record.truth) * 180.0 * 60.0 / np.pi
    if not _known(phi):
        return None

    def arcmin(state: State) -> Floats | None:
        sigma = _sigma(record, state)
        return None if sigma is None else sigma * 180.0 * 60.0 / np.pi

    panels = [
        _error_panel(record, clock, "tilt about north [arcmin]", phi[:, 0], arcmin(State.PHI_N), True),
        _error_panel(record, clock, "tilt about east [arcmin]", phi[:, 1], arcmin(State.PHI_E), False),
        _error_panel(record, clock, "heading [arcmin]", -phi[:, 2], arcmin(State.PHI_D), False),
    ]
    return Figure(
        "attitude", "Attitude error", "Tilt about north and east, and heading computed minus true.", clock.label, panels, x_range=clock.x_range
    )


def _innovations(record: RunRecord, clock: _Clock) -> Figure | None:
    panels = [
        _nis_panel(name, judged, clock, not index) for index, (name, judged) in enumerate(sorted(record.judged.items())) if len(judged.stamp_ns)
    ]
    if not panels:
        return None
    caption = "Normalized innovation squared of each measurement against the threshold of its false-alarm probability; what was not fused is marked."
    return Figure("innovations", "Innovations", caption, clock.label, panels, height=190, x_range=clock.x_range)


def _nis_panel(name: str, judged: Judged, clock: _Clock, first: bool) -> Panel:
    x = clock.of(judged.stamp_ns)
    nis = np.maximum(judged.nis, 1e-2)  # the axis is logarithmic
    fused = np.flatnonzero(judged.accepted & np.isfinite(nis))
    refused = np.flatnonzero(~judged.accepted & np.isfinite(nis))
    fused, refused = (i[:: len(i) // MOST_POINTS + 1] for i in (fused, refused))
    panel = Panel(AID_NAMES.get(name, name), shades=clock.shades, log=True)
    panel.traces.append(Trace(x[fused], nis[fused], "fused", AID_COLORS.get(name, ESTIMATE), "dots", legend=False))
    if len(refused):
        panel.traces.append(Trace(x[refused], nis[refused], "not fused", REJECTED, "crosses", legend=False))
    steps = np.flatnonzero(np.r_[True, np.diff(judged.threshold) != 0])[:MOST_POINTS]
    edges = np.unique(np.r_[steps, np.maximum(steps[1:] - 1, 0), len(x) - 1])
    panel.traces.append(Trace(x[edges], judged.threshold[edges], "threshold", INK, "dash", legend=first))
    top = max(float(np.nanmax(judged.threshold)), float(np.nanmax(nis)) if np.isfinite(nis).any() else 1.0)
    panel.y_range = (5e-3, 20.0 * top)
    return panel


def _health(record: RunRecord, clock: _Clock) -> Figure | None:
    sensors = [f"{kind}_{i}" for kind in ("gyro", "accel") for i in range(record.n_sensors)]
    aids = dict.fromkeys([*AID_NAMES, *record.judged, *(c.target for c in record.health if not is_imu_sensor(c.target))])
    aids.pop("height")  # known, not measured
    rows = sensors + [name for name in aids if name in record.judged or any(c.target == name for c in record.health)]
    if not len(record.settled):
        return None
    panel = Panel("", rows=rows)
    for row in rows:
        panel.bars += _timeline(row, [c for c in record.health if c.target == row], clock)
    for fault in record.faults:
        if fault.target in rows and fault.end_ns > clock.start_ns and fault.start_ns < clock.stop_ns:
            panel.bars.append(Bar(fault.target, clock.at(fault.start_ns), clock.at(min(fault.end_ns, clock.stop_ns)), "fault"))
    caption = "State of health of every sensor and subfilter; the black line under a row is a fault in force."
    return Figure("health", "Health", caption, clock.label, [panel], height=120 + 26 * len(rows), x_range=clock.x_range)


def _timeline(row: str, changes: list[HealthChange], clock: _Clock) -> list[Bar]:
    names = SENSOR_STATES if is_imu_sensor(row) else SUBFILTER_STATES
    bars: list[Bar] = []
    start, state = 0.0, "healthy"
    for change in sorted(changes, key=lambda c: c.stamp_ns):
        at = min(clock.at(change.stamp_ns), clock.x_range[1])
        if names[change.state] == state:
            continue
        if at > start:
            bars.append(Bar(row, start, at, state))
        start, state = at, names[change.state]
    bars.append(Bar(row, start, clock.x_range[1], state))
    return _merge(bars, clock.x_range[1] / 2000.0)


def _merge(bars: list[Bar], shortest: float) -> list[Bar]:
    """Thin a timeline of more than 1000 stretches: those too short to be seen take the state of the longer neighbour."""
    if len(bars) <= 1000:
        return bars
    kept: list[Bar] = []
    for bar in bars:
        if kept and (bar.state == kept[-1].state or bar.stop - bar.start < shortest):
            kept[-1].stop = bar.stop
        else:
            kept.append(bar)
    return kept
