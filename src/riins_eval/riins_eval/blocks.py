"""Messages of a run as columns: many of one kind at once, for `BagWriter.write_block`.

Lives here: NavState, Odometry and NavSatFix of many solutions at once; a test holds them to the values of riins_node.fields.
Does not live here: what a message means (riins_node.fields), which ones are written (recording.py).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from riins_core import frames
from riins_core.rotation import euler_from_dcm, skew
from riins_node.fields import (
    BASE,
    MAP,
    MAP_NED,
    STATUS_FIX,
    STATUS_NO_FIX,
    euler_covariance,
    header,
    position_fix,
    quaternion,
    sigmas,
    vector,
)
from riins_sim.trajectory import Truth

from .run_record import Stamps, Track

Floats = NDArray[np.float64]
Fields = dict[str, Any]
NAVIGATING = 2


def nav_states(
    track: Track,
    sequence: int,
    rate: Floats | None = None,
    bias_g: Floats | None = None,
    bias_a: Floats | None = None,
    covariance: Floats | None = None,
    mode: NDArray[Any] | int = NAVIGATING,
    validity: NDArray[Any] | None = None,
    protection_radius: Floats | float = 0.0,
    protection_heading: Floats | float = 0.0,
    reset_count: NDArray[Any] | int = 0,
    reset: Floats | None = None,
) -> Fields:
    """riins_msgs/NavState of m states.

    Parameters
    ----------
    track : m epochs
    sequence : number of the first
    rate, bias_g, bias_a : (m, 3), FRD, rad/s, rad/s, m/s^2; None: zeros
    covariance : (m, n, n), n >= 9, of position, velocity and phi first; None: zeros
    mode, validity, protection_radius, protection_heading, reset_count, reset : (m,), (m, 3), (m,), (m,), (m,), (m, 3) as in NavSolution

    Returns
    -------
    dict of columns
    """
    m = len(track)
    zeros = np.zeros((m, 3))
    roll, pitch, heading = track.rph.T
    P = np.zeros((m, 9, 9)) if covariance is None else covariance[:, :9, :9]
    validity = np.zeros((m, 3), np.uint8) if validity is None else validity
    reset = zeros if reset is None else reset
    columns: Fields = {
        "header": header(track.stamp_ns, MAP_NED),
        "sequence": np.arange(sequence, sequence + m, dtype=np.uint32),
        "mode": mode,
        "position_validity": validity[:, 0],
        "velocity_validity": validity[:, 1],
        "heading_validity": validity[:, 2],
        "latitude": np.degrees(track.lat),
        "longitude": np.degrees(track.lon),
        "height": track.h,
        "roll": roll,
        "pitch": pitch,
        "heading": heading,
        "protection_radius": protection_radius,
        "protection_heading": protection_heading,
        "reset_count": reset_count,
        "reset_position": reset[:, 0],
        "reset_velocity": reset[:, 1],
        "reset_heading": reset[:, 2],
    }
    sigma, sigma_euler = sigmas(P), sigmas(euler_covariance(roll, pitch, heading, P[:, 6:9, 6:9]))
    triples: list[tuple[str, str, Floats]] = [
        ("velocity_", "north east down", track.v_n),
        ("rate_", "x y z", zeros if rate is None else rate),
        ("gyro_bias_", "x y z", zeros if bias_g is None else bias_g),
        ("accel_bias_", "x y z", zeros if bias_a is None else bias_a),
        ("sigma_", "north east down", sigma[:, 0:3]),
        ("sigma_velocity_", "north east down", sigma[:, 3:6]),
        ("sigma_", "roll pitch heading", sigma_euler),
    ]
    for stem, suffixes, values in triples:
        columns.update((f"{stem}{suffix}", values[:, i]) for i, suffix in enumerate(suffixes.split()))
    return columns


def solution_states(solutions: Sequence[Any], sequence: int) -> Fields:
    """riins_msgs/NavState of riins_federated NavSolutions; `sequence` is that of the first."""
    return nav_states(
        track_of(solutions), sequence,
        rate=np.array([s.rate_b for s in solutions]), bias_g=np.array([s.bias_g for s in solutions]), bias_a=np.array([s.bias_a for s in solutions]),
        covariance=np.array([s.P[:9, :9] for s in solutions]), mode=np.array([int(s.mode) for s in solutions], np.uint8),
        validity=np.array([[int(v) for v in s.validity] for s in solutions], np.uint8),
        protection_radius=np.array([s.protection_radius for s in solutions]),
        protection_heading=np.array([s.protection_heading for s in solutions]), reset_count=np.array([s.reset_count for s in solutions], np.uint32),
        reset=np.array([s.reset for s in solutions], np.float64),
    )  # fmt: skip


def odometries(solutions: Sequence[Any], local_frame: frames.LocalFrame) -> Fields:
    """nav_msgs/Odometry of riins_federated NavSolutions, `fields.odometry` for all at once."""
    t = track_of(solutions)
    P = np.array([s.P[:12, :12] for s in solutions])
    c_nb = np.array([s.C_nb for s in solutions])
    c_bn = np.swapaxes(c_nb, 1, 2)
    sign = np.repeat([1.0, -1.0], 3)  # phi turns the other way round than the pose does
    pose_states = np.r_[0:3, 6:9]
    pose = P[:, pose_states[:, None], pose_states] * np.outer(sign, sign)
    for rows in (slice(0, 3), slice(3, 6)):
        for columns in (slice(0, 3), slice(3, 6)):
            pose[:, rows, columns] = local_frame.covariance(t.lat, t.lon, pose[:, rows, columns])
    to_body = np.concatenate([c_bn, -c_bn @ skew(t.v_n)], axis=2)
    twist = np.zeros((len(t), 6, 6))
    twist[:, :3, :3] = frames.frd_to_flu_covariance(to_body @ P[:, 3:9, 3:9] @ np.swapaxes(to_body, 1, 2))
    twist[:, 3:, 3:] = frames.frd_to_flu_covariance(P[:, 9:12, 9:12])
    speed = np.einsum("kij,kj->ki", c_bn, t.v_n)
    return {
        "header": header(t.stamp_ns, MAP),
        "child_frame_id": BASE,
        "pose": {
            "pose": {
                "position": vector(local_frame.to_enu(t.lat, t.lon, t.h)),
                "orientation": quaternion(local_frame.attitude(t.lat, t.lon, c_nb)),
            },
            "covariance": pose.reshape(-1, 36),
        },
        "twist": {
            "twist": {"linear": vector(frames.frd_to_flu(speed)), "angular": vector(frames.frd_to_flu(np.array([s.rate_b for s in solutions])))},
            "covariance": twist.reshape(-1, 36),
        },
    }


def nav_fixes(solutions: Sequence[Any]) -> Fields:
    """sensor_msgs/NavSatFix of riins_federated NavSolutions, `fields.nav_fix` for all at once."""
    t = track_of(solutions)
    content = position_fix(t.stamp_ns, t.lat, t.lon, t.h, np.array([s.P[:3, :3] for s in solutions]), BASE)
    invalid = np.array([int(s.validity[0]) == 2 for s in solutions])
    content["status"]["status"] = np.where(invalid, STATUS_NO_FIX, STATUS_FIX).astype(np.int8)
    return content


def covariances(block: Any, pipeline: Any) -> tuple[Floats, Floats]:
    """Covariances (m, 3, 3) of rate and specific force of a FusedBlock, as its messages carry them."""
    rate = _by_mask(block.gyro_used, pipeline.rate_covariance) + block.gyro_excess
    return rate, _by_mask(block.accel_used, pipeline.force_covariance) + block.accel_excess


def track_of(solutions: Sequence[Any]) -> Track:
    """The states of NavSolutions as arrays."""
    if not solutions:
        return Track.empty()
    return Track(
        np.array([s.stamp_ns for s in solutions], np.int64), np.array([s.lat for s in solutions]), np.array([s.lon for s in solutions]),
        np.array([s.h for s in solutions]), np.array([s.v_n for s in solutions]), np.array([s.rph for s in solutions], np.float64),
    )  # fmt: skip


def track_of_truth(truth: Truth, stamp_ns: Stamps) -> Track:
    """A Truth of riins_sim as a track with these stamps; NaN where it is not known."""
    rph = np.full((len(stamp_ns), 3), np.nan)
    known = np.isfinite(truth.C_nb).all(axis=(1, 2))
    if known.any():
        rph[known] = np.column_stack(euler_from_dcm(truth.C_nb[known]))
    return Track(stamp_ns, truth.lat, truth.lon, truth.h, truth.v_n, rph)


def _by_mask(masks: NDArray[Any], covariance: Any) -> Floats:
    kinds, which = np.unique(masks, return_inverse=True)
    return np.stack([covariance(int(mask)) for mask in kinds])[which] if len(kinds) else np.zeros((0, 3, 3))
