"""Faults drawn at random on the aids of a ship under way, through the whole navigator: what is fused of them, and how far it is drawn.

Lives here: voyages whose IMU is simulated and fused once, faults that are drawn and sailed on copies of the navigator, and the rows.
Does not live here: the figures (fault_draws_figures.py), the same in the platform form for every structure (ship_faults.py).
"""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from riins_core.noise import normal
from riins_eval import blocks, configure, metrics
from riins_eval.lane import Lane
from riins_eval.run_record import Track
from riins_eval.simulated_aids import aids_of
from riins_federated.config import ValidityLimits
from riins_federated.navigator import Navigator
from riins_federated.types import Aid, InitialState
from riins_imu_fusion.pipeline import FusionPipeline
from riins_sim.faults import Fault, FaultSchedule, FaultType
from riins_sim.initial import initial_state
from riins_sim.scenario import Scenario, load
from riins_sim.sensors import DopplerSim, PositionSim, RedundantImuSim
from riins_sim.trajectory import Trajectory

from .rows import Figure, Progress, Row, row

Array = NDArray[np.float64]

AIDS = ("gps", "bds", "doppler")
TYPES = (FaultType.STEP, FaultType.RAMP, FaultType.NOISE, FaultType.STUCK)
TOO_LARGE = 8.0
"""A fault of so many sigmas of the innovation must not be fused."""
SMALLEST, LARGEST = 3.0, 1000.0
DRAWS_A_VOYAGE = 10
BEGIN_S, LAST_ONSET_S, DURATION_S = 900.0, 1500.0, 2400.0
"""Copies part at the first, onsets lie between it and the second."""
LEAST_S, MOST_S = 30.0, 600.0
"""Duration of a fault."""
SOON_S = 60.0
DEG = float(np.radians(1.0))
RISK = ValidityLimits().integrity_risk
"""That the error is beyond its protection level."""
STRIDE_S = 10.0
IMU_HZ = 50


class Outcome(NamedTuple):
    """What became of one fault.

    Attributes
    ----------
    aid, kind : index into AIDS, FaultType
    size : largest error put on the aid, in sigmas of the innovation
    shift : largest horizontal distance from the fault-free twin, m
    heading : largest difference of heading from it, rad
    large, fused : faulty measurements above TOO_LARGE; those of them that were fused
    delay_s : from the first fault above the threshold of the gate to the first measurement refused; NaN: none was refused
    found : a measurement was refused or the aid isolated while the fault lasted
    nees : normalized squared error of seven states SOON_S after the end of the fault
    integrity : (4, e), see `integrity`
    """

    aid: int
    kind: int
    size: float
    shift: float
    heading: float
    large: int
    fused: int
    delay_s: float
    found: bool
    nees: float
    integrity: Array


class _Lane(Lane):
    """One that keeps the protection level of the heading too."""

    def __init__(self, navigator: Navigator) -> None:
        super().__init__(navigator)
        self.protection_heading: list[float] = []

    def drain(self) -> None:
        """Take out what is settled."""
        super().drain()
        self.protection_heading += [s.protection_heading for s in self.solutions]


def voyage(seed: int) -> Scenario:
    """Forty minutes of the ship paper's voyage with a turn every six, no outages and no faults."""
    ship = load("voyage_12h")
    straight, turn = ship.legs[:2]
    legs = (dataclasses.replace(straight, straight_s=300.0), turn) * 6
    return dataclasses.replace(
        ship, name="fault_draws", seed=seed, duration_s=DURATION_S, imu_rate_hz=IMU_HZ, legs=legs, faults=(), outages=(), expect={}
    )


class Voyage:
    """One voyage: what the fusion makes of the IMU, the navigator at the parting, and the twin.

    Parameters
    ----------
    scenario : without faults
    overrides : settings of the navigator beside the scenario's
    """

    def __init__(self, scenario: Scenario, overrides: dict[str, Any] | None = None) -> None:
        scenario = dataclasses.replace(scenario, navigator=configure.merged(scenario.navigator, overrides or {}))
        self.trajectory = Trajectory(scenario)
        self.seed = scenario.seed
        self.sensors: dict[str, Any] = {name: PositionSim(scenario, name, self.trajectory) for name in AIDS[:2]}
        self.sensors["doppler"] = DopplerSim(scenario, self.trajectory)
        drawn = initial_state(scenario, self.trajectory)
        names = [f.name for f in dataclasses.fields(InitialState) if f.name not in ("stamp_ns", "source") and hasattr(drawn, f.name)]
        lane = _Lane(Navigator(configure.navigator_config(scenario)))
        lane.navigator.set_initial_state(InitialState(stamp_ns=drawn.stamp_ns, source="study", **{n: getattr(drawn, n) for n in names}))
        self._parts = list(self._fused(scenario))
        self._first = next(i for i, part in enumerate(self._parts) if part[0][-1] >= round(BEGIN_S * 1e9))
        self._sail(lane, 0, self._first, None)
        self._start = lane
        self.twin = self.fly()

    def _fused(self, scenario: Scenario) -> Iterator[tuple[Any, ...]]:
        """Arguments of Navigator.add_imu, a stride at a time."""
        imu = RedundantImuSim(scenario, self.trajectory)
        pipeline = FusionPipeline(configure.fusion_config(scenario))
        stride = round(STRIDE_S * IMU_HZ)
        for k0 in range(1, imu.samples + 1, stride):
            raw = imu.block(k0, min(stride, imu.samples + 1 - k0))
            block = pipeline.process(raw.stamp_ns, (raw.k & 0xFFFFFFFF).astype(np.uint32), raw.gyro, raw.accel, raw.gyro_valid, raw.accel_valid)
            pipeline.drain_events()
            yield block.stamp_ns, block.sequence, block.rate, block.force, (), *blocks.covariances(block, pipeline)

    def measured(self, name: str, faults: FaultSchedule | None) -> Any:
        """Every measurement of an aid."""
        return self.sensors[name].block(1, self.sensors[name].samples, faults)

    def _sail(self, lane: _Lane, first: int, last: int, faults: FaultSchedule | None) -> None:
        measured = {name: self.measured(name, faults) for name in AIDS}
        aids = sorted((aid for name, block in measured.items() for aid in aids_of(name, block.stamp_ns, block)), key=lambda a: a.stamp_ns)
        after = self._parts[first - 1][0][-1] if first else 0
        for part in self._parts[first:last]:
            _give(lane.navigator, [a for a in aids if after < a.stamp_ns <= part[0][-1]])
            lane.navigator.add_imu(*part)
            lane.drain()
            after = part[0][-1]

    def fly(self, *faults: Fault) -> _Lane:
        """The rest of the voyage on a copy of the navigator."""
        lane = copy.deepcopy(self._start)
        self._sail(lane, self._first, len(self._parts), FaultSchedule(faults, self.seed) if faults else None)
        lane.finish()
        return lane

    def truth(self, track: Track) -> Track:
        """True states at the stamps of a track."""
        return blocks.track_of_truth(self.trajectory.truth(track.stamp_ns * 1e-9), track.stamp_ns)


def _give(navigator: Navigator, aids: list[Aid]) -> None:
    for aid in aids:
        navigator.add_aid(aid)


def draw(number: int, sigma: dict[str, Array]) -> Fault:
    """A fault, from uniform numbers addressed by its number.

    Parameters
    ----------
    number : of the draw
    sigma : of each aid, that of the innovation, m or m/s
    """
    u = np.asarray(chi2.cdf(normal(1, f"fault draw {number}", 0, 1, 6)[0] ** 2, 1))
    aid, kind = AIDS[int(u[0] * len(AIDS))], TYPES[int(u[1] * len(TYPES))]
    size = SMALLEST * (LARGEST / SMALLEST) ** u[2] * float(sigma[aid][0])
    start, lasts = BEGIN_S + u[3] * (LAST_ONSET_S - BEGIN_S), LEAST_S * (MOST_S / LEAST_S) ** u[4]
    axis = (("forward", "starboard") if aid == "doppler" else ("north", "east"))[int(u[5] * 2)]
    times = {"start_ns": round(start * 1e9), "end_ns": round((start + lasts) * 1e9)}
    if kind is FaultType.STUCK:
        return Fault(aid, kind, **times)
    if kind is FaultType.RAMP:
        return Fault(aid, kind, slope=size / lasts, axis=axis, **times)
    return Fault(aid, kind, size, axis=axis, **times)


def errors(voyage: Voyage, fault: Fault) -> tuple[NDArray[np.int64], Array]:
    """What a fault adds to the measurements of its aid: stamps, and (m, 2) in m or m/s, along the axes of the innovation."""
    clean, faulty = voyage.measured(fault.target, None), voyage.measured(fault.target, FaultSchedule([fault], voyage.seed))
    inside = np.array([fault.in_force(int(t)) for t in clean.stamp_ns])
    if fault.target == "doppler":
        return clean.stamp_ns[inside], (faulty.v_b - clean.v_b)[inside, :2]
    apart = metrics.ned_difference(faulty.lat, faulty.lon, faulty.h, clean.lat, clean.lon, clean.h)
    return clean.stamp_ns[inside], np.asarray(apart)[inside, :2]


def integrity(lane: _Lane, truth: Track) -> Array:
    """Horizontal error and protection radius [m], error of the heading and its protection level [rad] at each settled epoch, (4, e)."""
    error = np.hypot(*metrics.position_error(lane.track, truth)[:, :2].T)
    return np.array([error, lane.protection_radius, np.abs(metrics.heading_error(lane.track, truth)), lane.protection_heading])


def outcome(voyage: Voyage, fault: Fault, lane: _Lane) -> Outcome:
    """Compare a run with the fault-free twin and with the truth."""
    stamps, error = errors(voyage, fault)
    ours, twins = lane.judged_arrays[fault.target], voyage.twin.judged_arrays[fault.target]
    at, there = np.searchsorted(ours.stamp_ns, stamps), np.searchsorted(twins.stamp_ns, stamps)
    sizes = np.linalg.norm(error / twins.sigma[there][:, :2], axis=1) if len(stamps) else np.zeros(1)
    accepted = ours.accepted[at]
    large = sizes > TOO_LARGE if len(stamps) else np.zeros(0, bool)
    refused = np.flatnonzero(~accepted)
    apart = metrics.position_error(lane.track, voyage.twin.track)[:, :2]
    turned = metrics.wrap(lane.track.rph[:, 2] - voyage.twin.track.rph[:, 2])
    truth = voyage.truth(lane.track)
    # the gate alone sees a fault of 4.8 sigmas for certain: a delay counts from there
    plain = np.flatnonzero(sizes > np.sqrt(ours.threshold[at]))
    delay = (stamps[refused[0]] - stamps[plain[0]]) * 1e-9 if len(refused) and len(plain) else np.nan
    nees = metrics.nees7(lane.track, truth, lane.covariance)
    soon = min(int(np.searchsorted(lane.track.stamp_ns, (fault.end_ns or 0) + round(SOON_S * 1e9))), len(nees) - 1)
    return Outcome(
        AIDS.index(fault.target), int(fault.type), float(sizes.max()), float(np.hypot(*apart.T).max()), float(np.abs(turned).max()),
        int(large.sum()), int((accepted & large).sum()), float(max(delay, 0.0)), bool(len(refused)), float(nees[soon]), integrity(lane, truth),
    )  # fmt: skip


def innovation_sigma(lane: Lane) -> dict[str, Array]:
    """Sigma of the innovation of each aid over a run, median, m or m/s."""
    return {name: np.median(one.sigma, axis=0) for name, one in lane.judged_arrays.items()}


def sail(draws: int, progress: Progress, draws_a_voyage: int = DRAWS_A_VOYAGE) -> tuple[list[Outcome], list[Array]]:
    """Draw and sail faults; also `integrity` of each voyage without a fault."""
    found: list[Outcome] = []
    quiet: list[Array] = []
    for number in range(draws):
        if number % draws_a_voyage == 0:
            under_way = Voyage(voyage(1 + number // draws_a_voyage))
            twin = under_way.twin
            quiet.append(integrity(twin, under_way.truth(twin.track)))
            sigma = innovation_sigma(twin)
        fault = draw(number, sigma)
        found.append(outcome(under_way, fault, under_way.fly(fault)))
        progress((number + 1) / draws)
    return found, quiet


def inside(nees: Array, dof: int = 7, probability: float = 0.99) -> NDArray[np.bool_]:
    """Whether normalized squared errors lie in the middle of chi-square."""
    low, high = chi2.ppf([0.5 - 0.5 * probability, 0.5 + 0.5 * probability], dof)
    return (nees >= low) & (nees <= high)


def rows(found: Sequence[Outcome], quiet: Sequence[Array]) -> list[Row]:
    """What the draws showed."""
    one = {name: np.array([getattr(o, name) for o in found]) for name in ("kind", "size", "shift", "heading", "large", "fused", "found", "nees")}
    made = [
        row(None, "faulty measurements above 8 sigma fused, all draws together", one["fused"], paper="0", centre=np.sum, ok=lambda r: r.value == 0.0,
            remark=f"of {int(one['large'].sum())}"),
    ]  # fmt: skip
    for name, low, high in (("below 8 sigma", 0.0, TOO_LARGE), ("of 8 to 1000 sigma", TOO_LARGE, np.inf)):
        for kind in TYPES:
            some = (one["kind"] == int(kind)) & (one["size"] >= low) & (one["size"] < high)
            if some.any():
                label = f"{kind.name.lower()} {name}"
                made.append(row(None, f"{label}: largest distance from the fault-free twin, m", one["shift"][some], centre=np.median,
                                remark=f"worst {one['shift'][some].max():.1f} m; heading {np.degrees(one['heading'][some].max()) * 60.0:.2f} arcmin; "
                                       f"found {one['found'][some].mean():.0%}"))  # fmt: skip
    known = one["found"].astype(bool)
    if known.any():
        made.append(row(None, "faults found: NEES a minute after the end inside its 99 % interval", inside(one["nees"][known]), paper=">= .98",
                        ok=lambda r: r.value >= 0.98))  # fmt: skip
    return made + integrity_rows("without a fault", quiet) + integrity_rows("with a fault", [o.integrity for o in found])


def integrity_rows(name: str, voyages: Sequence[Array]) -> list[Row]:
    """Errors beyond their protection levels, of `integrity` of some voyages."""
    made = []
    for what, first, unit, scale in (("horizontal error beyond the protection radius", 0, "m", 1.0), ("heading beyond its level", 2, "deg", DEG)):
        beyond = [float(np.mean(one[first] > one[first + 1])) for one in voyages]
        level = float(np.median(np.concatenate([one[first + 1] for one in voyages]))) / scale
        worst = max(float(np.max(one[first] / one[first + 1])) for one in voyages)
        remark = f"level in the median {level:.3g} {unit}; the error comes to {worst:.0%} of it at most; risk {RISK:g} an epoch"
        label = f"epochs {name}: {what}, share"
        made.append(row(None, label, beyond, paper=f"<= {RISK:g}", centre=np.mean, ok=lambda r: r.value <= RISK, remark=remark))
    return made


def run(seeds: int, quick: bool, progress: Progress) -> tuple[Sequence[Row], Sequence[Figure]]:
    """Rows and figures of so many draws."""
    from .fault_draws_figures import figures

    found, quiet = sail(seeds, progress, 4 if quick else DRAWS_A_VOYAGE)
    return rows(found, quiet), figures(found, quiet)
