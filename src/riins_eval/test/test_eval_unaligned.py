"""The shipped unaligned harbour: what it promises holds, and its recording navigated again is the same, from its own data or from a given state."""

import numpy as np
import pytest

from riins_eval import bag_record, offline
from riins_eval.score import score, table, verdict
from riins_sim import scenario as scenarios


@pytest.fixture(scope="module")
def sailed(tmp_path_factory):
    bag = tmp_path_factory.mktemp("unaligned") / "bag"
    return offline.sail(scenarios.load("harbour_unaligned"), bag=bag, record="all", twins=False), bag


def test_it_holds_what_it_promises(sailed):
    run, bag = sailed
    assert not verdict(run.score, run.expect)
    found = run.score["alignment"]
    assert found["method"] == "swaying" and found["elapsed_s"] == 180.0 and abs(found["heading_error_arcmin"]) < 30.0
    assert run.record.settled.stamp_ns[0] > run.record.start_ns + 180_000_000_000  # nothing is given out before
    assert next(row for row in table(run.score) if row[0] == "alignment")[1] == "swaying, 180 s"
    assert score(bag_record.read_record(bag, twins=False))["alignment"] == found


def test_navigated_again_it_is_the_same(sailed, tmp_path):
    run, bag = sailed
    again = offline.navigate(bag, tmp_path / "again")
    assert again.score["alignment"] == run.score["alignment"] and not verdict(again.score, run.expect)
    for name in ("stamp_ns", "lat", "lon", "v_n", "rph"):
        assert np.array_equal(getattr(again.record.settled, name), getattr(run.record.settled, name))
    other = offline.navigate(bag, overrides={"navigator": {"alignment": {"method": "stationary"}}})
    assert not other.score["alignment"]["aligned"] and "the base moves" in other.score["alignment"]["text"] and other.score["epochs"] == 0
