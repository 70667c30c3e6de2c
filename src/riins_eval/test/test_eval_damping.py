"""The inertial solution beside the corrected one: recorded, navigated again to the bit, and damped in the study."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from riins_bag.bag import BagReader
from riins_eval import offline, plots
from riins_eval.bag_record import read_record
from riins_eval.studies import ship_damping
from riins_sim.scenario import load

SETTINGS = {"feedback_period_s": 20.0, "damping": {"aid": "doppler"}}


def short(**navigator: object):
    return dataclasses.replace(load("harbour"), duration_s=30.0, faults=(), outages=(), expect={}, navigator=navigator)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    bag = tmp_path_factory.mktemp("damped") / "bag"
    return offline.sail(short(**SETTINGS), bag=bag, record="all", twins=False).record, bag


def test_the_inertial_solution_is_recorded_and_navigated_again_to_the_bit(run):
    record, bag = run
    again = offline.navigate(bag).record
    for name in ("stamp_ns", "lat", "lon", "h", "v_n", "rph"):
        assert np.array_equal(getattr(again.inertial, name), getattr(record.inertial, name)), name
        assert np.array_equal(getattr(again.settled, name), getattr(record.settled, name)), name
    with BagReader(bag) as reader:
        columns = reader.columns("/nav/inertial", ("header.stamp", "sequence", "velocity_north", "sigma_north"))
        settled = reader.columns("/nav/settled", ("header.stamp", "sequence", "velocity_north", "sigma_north"))
    assert np.array_equal(columns["sequence"], settled["sequence"]) and np.array_equal(columns["velocity_north"], record.inertial.v_n[:, 0])
    assert (columns["sigma_north"] >= settled["sigma_north"]).all() and (columns["velocity_north"] != settled["velocity_north"]).any()
    assert np.array_equal(record.inertial.v_n[19], record.settled.v_n[19])  # fed back after 20 s


def test_the_report_shows_how_far_it_is_off(run):
    record, bag = run
    read = read_record(bag, twins=False)
    assert np.allclose(read.inertial.v_n, record.inertial.v_n, atol=1e-12) and np.array_equal(read.inertial.stamp_ns, record.settled.stamp_ns)
    found = next(f for f in plots.figures(read) if f.key == "inertial")
    apart = found.panels[1].traces[0].y
    assert apart[18] == pytest.approx(np.hypot(*(record.inertial.v_n[18] - record.settled.v_n[18])[:2])) and apart[18] > 1e-3 and apart[19] < 1e-9


def test_with_continuous_feedback_there_is_none(tmp_path):
    record = offline.sail(short(), bag=tmp_path / "bag", twins=False).record
    with BagReader(tmp_path / "bag") as reader:
        assert record.inertial is None and "/nav/settled" in reader.topics and "/nav/inertial" not in reader.topics


def test_rows_of_the_study(run):
    """Of records whose velocities are set: free and damped in their places, and outputs that are apart are a miss."""
    record = run[0]
    one, two = (
        dataclasses.replace(record, inertial=dataclasses.replace(record.inertial, v_n=record.truth.v_n + np.array([v, 0.0, 0.0]))) for v in (0.5, 0.1)
    )
    rows = ship_damping.rows([(one, two)])
    assert [r.value for r in rows[:2]] == pytest.approx([0.5, 0.1]) and rows[-1].value == 0.0 and rows[-1].ok
    moved = dataclasses.replace(record, settled=dataclasses.replace(record.settled, lat=record.settled.lat + 1e-6))
    assert ship_damping.rows([(one, moved)])[-1].ok is False
