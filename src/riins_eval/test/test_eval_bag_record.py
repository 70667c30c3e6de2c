"""What is read from the bag of a run: score, changes of health, faults, reference."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from eval_voyage import near

from riins_bag.bag import BagReader, BagWriter
from riins_eval import bag_record, metrics, offline
from riins_eval.lane import size_text
from riins_eval.run_record import Track
from riins_eval.score import score_bag
from riins_node import fields
from riins_sim.faults import Fault, FaultType


def test_the_bag_gives_the_same_score(run, bag):
    again = score_bag(bag)
    assert near({**again, "realtime_factor": None}, {**run.score, "realtime_factor": None}) == []
    record = bag_record.read_record(bag)
    assert [(c.stamp_ns, c.target, c.state, c.reason) for c in record.health] == [
        (c.stamp_ns, c.target, c.state, c.reason) for c in run.record.health
    ]
    assert metrics.horizontal_distance(record.settled, run.record.settled).max() < 1e-6
    assert record.expect == run.expect and record.origin_ns == offline.START_NS


def test_changes_of_health_are_read_from_fields_not_from_texts(bag):
    """What was settled counts, not what a state showed before; without events, as in older recordings, the states are what there is."""
    with BagReader(bag) as reader:
        told = bag_record._subfilter_health(reader, 2**62)
        statuses = [m for _, _, m in reader.read(("/nav/subfilters",))]
    assert [(c.target, c.state) for c in told] == [("gps", 1), ("gps", 2)]

    def read(of):
        return bag_record._subfilter_health(SimpleNamespace(read=lambda _: [("", 0, of(m)) for m in statuses]), 2**62)

    def events(m):
        return [SimpleNamespace(stamp=e.stamp, target=e.target, state=e.state, reason=e.reason, text="") for e in m.events]

    def shown(m):
        return [SimpleNamespace(name=s.name, state=1, since=s.since, reason=0) for s in m.subfilters]

    assert read(lambda m: SimpleNamespace(header=m.header, subfilters=shown(m), events=events(m), text="")) == told
    assert read(lambda m: SimpleNamespace(header=m.header, subfilters=m.subfilters, text="")) == told


def test_faults_cleared_under_way_end_there(tmp_path):
    both = [Fault("gps", FaultType.STEP, 5.0), Fault("gps", FaultType.RAMP, slope=1.0, start_ns=10**9)]
    with BagWriter(tmp_path / "faults", flush_period_s=0.0) as writer:
        for stamp, faults, source in ((10**18, both, "gps_link"), (10**18 + 4 * 10**9, both[:1], "gps_link"), (10**18 + 5 * 10**9, [], "imu_link")):
            content = fields.fault_array(stamp, faults, 10**18)
            content["header"]["frame_id"] = source
            writer.write_message("/truth/faults", "riins_msgs/msg/FaultArray", content, stamp)
    with BagReader(tmp_path / "faults") as reader:
        found = bag_record.read_faults(reader, 10**18)
    assert [(f.type, f.end_ns) for f in found] == [(FaultType.STEP, None), (FaultType.RAMP, 4 * 10**9)]
    assert size_text(found[1]) == "+1 m per s"


def test_the_reference_is_interpolated_between_neighbours_only():
    t = np.array([0, 100, 200, 5200]) * 10_000_000
    x = 5.0 * t * 1e-9  # 5 m/s to the north along a circle of 6.36e6 m
    z = np.zeros(4)
    reference = Track(
        t, 0.7 + x / 6.3617e6, z + 2.0, z, np.column_stack([z + 5.0, z, z]), np.column_stack([z, z, z + np.array([6.27, 0.01, 0.02, 0.0])])
    )
    at = np.array([0, 50, 150, 200, 3000, 5200, 6000]) * 10_000_000
    made = bag_record.reference_at(reference, at)
    assert np.isfinite(made.lat).tolist() == [True, True, True, True, False, True, False]
    assert (made.lat[:4] - 0.7) * 6.3617e6 == pytest.approx([0.0, 2.5, 7.5, 10.0], abs=0.02)
    assert made.lat[0] == reference.lat[0] and made.lat[5] == reference.lat[3]
    assert np.sin(made.rph[1, 2]) == pytest.approx(np.sin(0.5 * (0.01 + 6.27 - 2 * np.pi)), abs=1e-6)
