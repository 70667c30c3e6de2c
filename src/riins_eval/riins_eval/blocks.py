"""Messages of a run as columns: many of one kind at once, for `BagWriter.write_block`.

Lives here: NavState of arrays, and stacking of the dicts of riins_node.fields; a test holds both to the same values.
Does not live here: what a message means (riins_node.fields), which ones are written (recording.py).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from riins_core.rotation import euler_from_dcm
from riins_node.fields import MAP_NED, header
from riins_sim.trajectory import Truth

from .run_record import Stamps, Track

Floats = NDArray[np.float64]
Fields = dict[str, Any]
NAVIGATING = 2


def stack(messages: Sequence[Mapping[str, Any]]) -> Fields:
    """Columns of m messages of the same kind; texts are those of the first."""
    first = messages[0]
    columns: Fields = {}
    for name, value in first.items():
        values = [message[name] for message in messages]
        if isinstance(value, Mapping):
            columns[name] = stack(values)
        elif isinstance(value, str):
            columns[name] = value
        else:
            columns[name] = np.array(values)
    return columns


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
    mode, validity, protection_radius, reset_count, reset : (m,), (m, 3), (m,), (m,), (m, 3) as in riins_federated NavSolution

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
        "reset_count": reset_count,
        "reset_position": reset[:, 0],
        "reset_velocity": reset[:, 1],
        "reset_heading": reset[:, 2],
    }
    sigma = np.sqrt(np.maximum(np.einsum("kii->ki", P), 0.0))
    sigma_euler = _euler_sigmas(roll, pitch, heading, P[:, 6:9, 6:9])
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
        protection_radius=np.array([s.protection_radius for s in solutions]), reset_count=np.array([s.reset_count for s in solutions], np.uint32),
        reset=np.array([s.reset for s in solutions], np.float64),
    )  # fmt: skip


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


def _euler_sigmas(roll: Floats, pitch: Floats, heading: Floats, phi: Floats) -> Floats:
    """Sigmas (m, 3) of roll, pitch, heading of covariances (m, 3, 3) of phi, to first order, as riins_node.fields has them."""
    cosine, sine, zero = np.cos(heading), np.sin(heading), np.zeros_like(heading)
    rows = [
        [cosine / np.cos(pitch), sine / np.cos(pitch), zero],
        [-sine, cosine, zero],
        [cosine * np.tan(pitch), sine * np.tan(pitch), zero + 1.0],
    ]
    jacobian = np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
    variance = np.einsum("kij,kjl,kil->ki", jacobian, phi, jacobian)
    return np.asarray(np.sqrt(np.maximum(variance, 0.0)))
