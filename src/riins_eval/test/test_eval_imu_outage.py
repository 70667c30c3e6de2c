"""A voyage on which the whole redundant IMU is silent twice: sailed, recorded, navigated again.

Lives here: outages of the target imu from the scenario to the score.
Does not live here: what a gap is worth (riins_federated test_fed_gaps.py), outages of aids (test_eval_offline.py).
"""

from __future__ import annotations

import dataclasses

import numpy as np
from eval_voyage import equal

from riins_core.settings import build
from riins_eval import offline
from riins_sim.scenario import OutageSettings
from riins_sim.sensors import RedundantImuSim


def test_a_silent_imu_is_bridged_and_no_aid_is_blamed(scenario, tmp_path, monkeypatch):
    silent = [build(OutageSettings, {"target": "imu", "start_s": a, "end_s": b}) for a, b in ((22.0, 23.0), (41.0, 47.0))]
    voyage = dataclasses.replace(scenario, faults=(), outages=tuple(silent))
    imu = RedundantImuSim(voyage)
    assert (
        np.array_equal(imu.block(2190, 20).k, np.r_[2190:2200]) and len(imu.block(2210, 20).k) == 0
    )  # its start counts
    run = offline.sail(voyage, bag=tmp_path / "bag", record="raw", twins=False)
    assert run.score["samples"]["received"] == 6000 - 700
    assert run.score["false_isolations"] == 0 and run.score["nees_per_dof"] < 2.5 and run.score["position_rms_m"] < 6.0
    assert len(run.record.settled) >= 52  # no state where no sample was
    assert equal(offline.navigate(tmp_path / "bag").record.settled, run.record.settled)
    monkeypatch.setattr(offline, "CHUNK_S", 3.7)
    assert equal(offline.sail(voyage, twins=False).record.settled, run.record.settled)
