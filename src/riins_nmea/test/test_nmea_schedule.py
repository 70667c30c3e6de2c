"""When sentences are due: by measurement time alone, whatever the rate of the states and the order of states and motions."""

from __future__ import annotations

import numpy as np
import pytest

from riins_nmea.schedule import Schedule

MS = 1_000_000
START = 1_700_000_000_000 * MS


@pytest.mark.parametrize("rate", [1, 3, 7, 10])
@pytest.mark.parametrize("step", [5 * MS, 10 * MS, 33 * MS, 1000 * MS])
def test_one_in_every_cell_of_the_grid(rate: int, step: int) -> None:
    """Ten seconds of states: the wanted rate, or that of the states where it is lower; the same whatever came before."""
    one, other = Schedule({"gga": rate, "vtg": 0}, 0.2), Schedule({"gga": rate}, 0.2)
    other.due(START - 12_345 * MS)
    stamps = np.arange(START, START + 10_000 * MS, step).tolist()
    due = [stamp for stamp in stamps if one.due(stamp)]
    assert len(due) == min(10 * rate, len(stamps)) and due == [stamp for stamp in stamps if other.due(stamp) == ["gga"]]
    assert one.due(START) == ["gga"]  # stamps that go back begin a new run


def test_a_state_gets_the_heave_of_its_own_stamp_in_any_order() -> None:
    """States and motions in either order give the same pairs, oldest first; a motion that does not come is waited for so long and no longer."""
    stamps = [START + k * 100 * MS for k in range(5)]
    for motions_first in (True, False):
        one, out = Schedule({"pashr": 10}, 0.2), []
        for k, stamp in enumerate(stamps):
            if motions_first and k != 2:
                one.motion(stamp, 0.1 * k)
            one.wait(stamp)
            out += one.ready(stamp)
            if not motions_first and k != 2:
                one.motion(stamp, 0.1 * k)
                out += one.ready(stamp)
        assert out == [(stamp, None if k == 2 else 0.1 * k) for k, stamp in enumerate(stamps)]
    late = Schedule({"pashr": 10}, 0.2)
    late.wait(START)
    assert late.ready(START + 199 * MS) == [] and late.ready(START + 200 * MS) == [(START, None)] and late.ready(START + 300 * MS) == []
    back = Schedule({"pashr": 10}, 0.2)
    back.wait(START)
    assert back.ready(START - 1) == [(START, None)]  # the stamps went back: nothing more will come for it
