"""Measures of a navigation solution against a reference, on plain arrays.

Lives here: errors, RMS, normalized errors (NEES, NIS), distances between two runs, detection of faults; errors are computed minus true.
Does not live here: which epochs count and what the numbers are called (score.py).
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from riins_core.frames import ned_difference
from riins_core.ins_error import State
from riins_core.rotation import dcm_from_euler, log_so3

from .run_record import ABSENT, COMPENSATED, ISOLATED, FaultInterval, HealthChange, Judged, Track, is_imu_sensor

Floats = NDArray[np.float64]

NEES7 = (State.POS_N, State.POS_E, State.VEL_N, State.VEL_E, State.PHI_N, State.PHI_E, State.PHI_D)
"""States of the normalized error of a marine navigator, whose vertical channel is slaved (conventions.md)."""


def rms(error: Floats) -> float:
    """Root of the mean square of vectors or scalars, not-a-number epochs left out.

    Parameters
    ----------
    error : (m,) or (m, d); of vectors the root of the mean squared length is taken

    Returns
    -------
    float, NaN where no epoch counts
    """
    square = np.square(error) if error.ndim == 1 else np.sum(np.square(error), axis=1)
    square = square[np.isfinite(square)]
    return float(np.sqrt(np.mean(square))) if len(square) else float("nan")


def wrap(angle: Floats) -> Floats:
    """Angles brought to [-pi, pi)."""
    return (np.asarray(angle) + np.pi) % (2.0 * np.pi) - np.pi


def position_error(track: Track, truth: Track) -> Floats:
    """Computed minus true position in metres.

    Parameters
    ----------
    track, truth : m epochs at the same stamps

    Returns
    -------
    (m, 3), NED, m
    """
    return np.asarray(ned_difference(track.lat, track.lon, track.h, truth.lat, truth.lon, truth.h), dtype=np.float64)


def attitude_error(track: Track, truth: Track) -> Floats:
    """Attitude error phi of computed C_nb = (I - [phi x]) true C_nb, to all orders.

    Parameters
    ----------
    track, truth : m epochs at the same stamps

    Returns
    -------
    (m, 3), rad, about N, E, D; the heading error computed minus true is -phi_D
    """
    computed, true = dcm_from_euler(*track.rph.T), dcm_from_euler(*truth.rph.T)
    phi = np.full((len(track), 3), np.nan)
    known = np.isfinite(truth.rph).all(axis=1) & np.isfinite(track.rph).all(axis=1)
    if known.any():
        phi[known] = -log_so3(computed[known] @ np.swapaxes(true[known], 1, 2))
    return phi


def heading_error(track: Track, truth: Track) -> Floats:
    """Computed minus true heading.

    Returns
    -------
    (m,), rad, in [-pi, pi)
    """
    return wrap(track.rph[:, 2] - truth.rph[:, 2])


def nees(error: Floats, covariance: Floats) -> Floats:
    """Normalized estimation error squared e' P^-1 e, chi-square of d degrees of freedom for a consistent filter.

    Parameters
    ----------
    error : (m, d)
    covariance : (m, d, d), symmetric positive definite

    Returns
    -------
    (m,), NaN where the error is not known or the covariance is not positive definite

    References
    ----------
    Bar-Shalom, Li, Kirubarajan, Estimation with Applications to Tracking and Navigation, eq. (5.4.2-1).
    """
    result = np.full(len(error), np.nan)
    known = np.asarray(np.isfinite(error).all(axis=1) & np.isfinite(covariance).all(axis=(1, 2)))
    # units differ by ten orders of magnitude between position and attitude: scale to correlations before the solve
    sigma = np.sqrt(np.where(known[:, None], np.einsum("kii->ki", covariance), 1.0).clip(min=0.0))
    index = np.flatnonzero(known & (np.min(sigma, axis=1) > 0.0))
    correlation = covariance[index] / (sigma[index, :, None] * sigma[index, None, :])
    scaled = error[index] / sigma[index]
    try:
        whitened = np.linalg.solve(np.linalg.cholesky(correlation), scaled[..., None])[..., 0]
    except np.linalg.LinAlgError:  # at least one is not positive definite: find out which
        whitened = np.full_like(scaled, np.nan)
        for row, (matrix, vector) in enumerate(zip(correlation, scaled, strict=True)):
            try:
                whitened[row] = np.linalg.solve(np.linalg.cholesky(matrix), vector)
            except np.linalg.LinAlgError:
                continue
    result[index] = np.sum(np.square(whitened), axis=1)
    return result


def nees7(track: Track, truth: Track, covariance: Floats) -> Floats:
    """NEES of the seven states NEES7.

    Parameters
    ----------
    track, truth : m epochs at the same stamps
    covariance : (m, n, n) in the order of State, n >= 15, or (m, 7, 7) in the order of NEES7

    Returns
    -------
    (m,), expected value 7
    """
    position, velocity, phi = position_error(track, truth), track.v_n - truth.v_n, attitude_error(track, truth)
    error = np.column_stack([position[:, :2], velocity[:, :2], phi])
    return nees(error, reduce_covariance(covariance))


def reduce_covariance(covariance: Floats) -> Floats:
    """The (m, 7, 7) block of NEES7 of an (m, n, n) covariance."""
    if covariance.shape[-1] == len(NEES7):
        return covariance
    return covariance[:, np.array(NEES7)[:, None], np.array(NEES7)[None, :]]


def nis_per_dof(judged: Judged, faults: list[FaultInterval]) -> float:
    """Mean NIS over the measured components, accepted measurements outside the faults of this subfilter: 1 for a consistent filter.

    Measurements that were rejected outside a fault count as well: leaving them out would make any filter look consistent. It is that of the master's
    innovations: the statistic of a verdict is the largest of several tests', whose mean is more than one.

    Returns
    -------
    float, NaN when nothing counts
    """
    good = np.isfinite(judged.nis) & ~_in_fault(judged, faults)
    dof = np.isfinite(judged.standardized).sum(axis=1)
    good &= dof > 0
    return float(np.nansum(judged.standardized[good] ** 2) / np.sum(dof[good])) if good.any() else float("nan")


def horizontal_distance(track: Track, other: Track) -> Floats:
    """Horizontal distance of two runs at their common stamps.

    Returns
    -------
    (k,), m
    """
    _, i, j = np.intersect1d(track.stamp_ns, other.stamp_ns, assume_unique=True, return_indices=True)
    difference = position_error(track.take(i), other.take(j))
    return np.hypot(difference[:, 0], difference[:, 1])


@dataclasses.dataclass(frozen=True)
class FaultOutcome:
    """What became of one fault.

    Attributes
    ----------
    detected : the target was declared, or one of its measurements was refused, while the fault was in force
    delay_s : from the first faulty measurement to that, None when not detected or when the measurements are not known
    isolated : the target itself was declared while the fault was in force: isolated, or an inertial sensor that is compensated
    wrong : other, healthy sensors of the same kind that were declared meanwhile
    compensated : the target was kept in use without its drift
    """

    detected: bool
    delay_s: float | None
    isolated: bool
    wrong: tuple[str, ...]
    compensated: bool = False

    @property
    def isolated_right(self) -> bool:
        """The faulty one was declared, and nothing healthy of its kind with it."""
        return self.isolated and not self.wrong


def fault_outcome(fault: FaultInterval, faults: list[FaultInterval], health: list[HealthChange], judged: Judged | None) -> FaultOutcome:
    """Detection and isolation of one fault.

    Parameters
    ----------
    fault : the fault in question
    faults : all faults of the run
    health : all changes of health
    judged : innovations of the target, where it is an aid

    Returns
    -------
    FaultOutcome

    Notes
    -----
    An isolation that began before the fault and lasts into it counts as detected with delay 0: nothing of the fault was used. A sensor that is
    compensated for another fault already counts when the filter says so again.
    """
    during = [c for c in health if fault.start_ns <= c.stamp_ns < fault.end_ns and not c.operator]
    own = [c for c in during if c.target == fault.target]
    gone = (ISOLATED,) if is_imu_sensor(fault.target) else (ISOLATED, ABSENT)
    compensated = [c.stamp_ns for c in own if is_imu_sensor(c.target) and c.state == COMPENSATED]
    declared = [c.stamp_ns for c in own if c.state in gone] + compensated
    before = _state_at(fault.target, fault.start_ns, health)
    isolated = bool(declared) or before in gone
    first_faulty, alarms = fault.start_ns, list(declared)
    if judged is not None:
        faulty = fault.covers(judged.stamp_ns)
        if faulty.any():
            first_faulty = int(judged.stamp_ns[faulty].min())
        alarms += judged.stamp_ns[faulty & ~judged.accepted].tolist()
    if before in gone:
        alarms.append(first_faulty)
    wrong = sorted({c.target for c in during if is_declared(c) and _same_kind(c.target, fault.target) and not _excused(c, faults)})
    delay = max(0.0, (min(alarms) - first_faulty) / 1e9) if alarms else None
    return FaultOutcome(bool(alarms), delay, isolated, tuple(wrong), bool(compensated))


def is_declared(change: HealthChange) -> bool:
    """Whether a change declares a subfilter or sensor faulty: isolated, or an inertial sensor that is kept without its drift."""
    return change.state == ISOLATED or (change.state == COMPENSATED and is_imu_sensor(change.target))


def false_isolations(health: list[HealthChange], faults: list[FaultInterval]) -> list[HealthChange]:
    """Isolations of a sensor or a subfilter, and compensations of a sensor, while no fault was put on it; the operator's word is none."""
    return [c for c in health if is_declared(c) and not c.operator and not _excused(c, faults)]


def good_rejected(judged: Judged, faults: list[FaultInterval]) -> int:
    """Measurements refused outside the faults of this subfilter (innovation test, hold)."""
    return int(np.sum(~judged.accepted & ~_in_fault(judged, faults)))


def epochs_accepted(judged: Judged, fault: FaultInterval) -> int:
    """Measurements of a faulty aid that were fused while the fault was in force."""
    return int(np.sum(judged.accepted & fault.covers(judged.stamp_ns)))


def declared_at(fault: FaultInterval, health: list[HealthChange]) -> int | None:
    """Stamp at which the target was first declared while the fault was in force; the start of the fault if it was isolated already; or None."""
    if _state_at(fault.target, fault.start_ns, health) == ISOLATED:
        return fault.start_ns
    stamps = [c.stamp_ns for c in health if c.target == fault.target and is_declared(c) and fault.start_ns <= c.stamp_ns < fault.end_ns]
    return min(stamps) if stamps else None


def _in_fault(judged: Judged, faults: list[FaultInterval]) -> NDArray[np.bool_]:
    inside = np.zeros(len(judged.stamp_ns), dtype=bool)
    for fault in faults:
        inside |= fault.covers(judged.stamp_ns)
    return inside


def _state_at(target: str, stamp_ns: int, health: list[HealthChange]) -> int:
    earlier = [c for c in health if c.target == target and c.stamp_ns < stamp_ns]
    return max(earlier, key=lambda c: c.stamp_ns).state if earlier else 0


def _same_kind(a: str, b: str) -> bool:
    if is_imu_sensor(a) or is_imu_sensor(b):
        return is_imu_sensor(a) and is_imu_sensor(b) and a.split("_")[0] == b.split("_")[0] and a != b
    return a != b


def _excused(change: HealthChange, faults: list[FaultInterval]) -> bool:
    return any(f.target == change.target and f.start_ns <= change.stamp_ns <= f.end_ns for f in faults)
