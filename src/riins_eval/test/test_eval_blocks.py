"""Columns of messages hold what the message-by-message mapping of riins_node holds."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from riins_bag.bag import deserialize, serialize, typestore
from riins_bag.cdr import pack
from riins_core.frames import LocalFrame
from riins_core.rotation import dcm_from_euler
from riins_eval import blocks
from riins_eval.recording import FIX, NAV_COVARIANCE, NAV_STATE, ODOMETRY, RunWriter
from riins_node import fields


def make_solution(seed: int) -> SimpleNamespace:
    """A NavSolution of random numbers."""
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(20, 20))
    rph = np.array([rng.normal(0, 0.1), rng.normal(0, 0.1), rng.uniform(0, 6.28)])
    return SimpleNamespace(
        stamp_ns=1_600_000_000_000_000_000 + seed * 1_000_000_007, lat=rng.uniform(-1, 1), lon=rng.uniform(-3, 3), h=rng.normal(),
        v_n=rng.normal(size=3), rph=rph, C_nb=dcm_from_euler(*rph), rate_b=rng.normal(size=3), force_b=rng.normal(size=3), bias_g=rng.normal(size=3),
        bias_a=rng.normal(size=3), P=root @ root.T, mode=2, validity=(0, 1, 2), protection_radius=rng.uniform(),
        protection_heading=rng.uniform(), reset_count=3, reset=(1.0, 2.0, 3.0),
    )  # fmt: skip


def test_nav_states_of_arrays_equal_those_of_riins_node():
    solutions = [make_solution(seed) for seed in range(5)]
    columns = blocks.solution_states(solutions, 7)
    for row, solution in enumerate(solutions):
        single = fields.nav_state(solution, 7 + row)
        assert set(single) == set(columns)
        for name, value in single.items():
            if name != "header":
                column = np.broadcast_to(columns[name], (5,))
                assert column[row] == pytest.approx(value, rel=1e-13, abs=1e-15), name
    assert columns["header"]["stamp"].tolist() == [s.stamp_ns for s in solutions]
    assert columns["header"]["frame_id"] == "map_ned"


def test_odometry_and_fixes_of_arrays_equal_those_of_riins_node():
    solutions = [make_solution(seed) for seed in range(4)]
    solutions[1].validity = (2, 2, 2)
    frame = LocalFrame(0.3, 1.0, 10.0)
    for msgtype, columns, single in (
        (ODOMETRY, blocks.odometries(solutions, frame), [fields.odometry(s, frame) for s in solutions]),
        (FIX, blocks.nav_fixes(solutions), [fields.nav_fix(s) for s in solutions]),
    ):
        packed = [deserialize(msgtype, row.tobytes()) for row in pack(typestore(), msgtype, columns, 4)]
        for made, plain in zip(packed, single, strict=True):
            assert flat(made) == pytest.approx(flat(deserialize(msgtype, serialize(msgtype, plain))), rel=1e-12, abs=1e-9)


def flat(msg) -> list[float]:
    """All numbers of a message in order."""
    if isinstance(msg, str):
        return [float(len(msg))]
    if isinstance(msg, np.ndarray):
        return msg.astype(float).tolist()
    if isinstance(msg, int | float | np.number):
        return [float(msg)]
    return [v for name in msg.__dataclass_fields__ if name != "__msgtype__" for v in flat(getattr(msg, name))]


def test_the_fast_covariance_message_is_the_plain_one(tmp_path):
    labels = [f"state {i} [m]" for i in range(20)]
    with RunWriter(tmp_path / "bag", "nav") as writer:
        for seed in (1, 2):
            solution = make_solution(seed)
            assert writer._covariance_cdr(solution, labels) == serialize(NAV_COVARIANCE, fields.nav_covariance(solution, labels))
    state = deserialize(NAV_STATE, serialize(NAV_STATE, fields.nav_state(make_solution(1), 1)))
    assert state.header.frame_id == "map_ned"
