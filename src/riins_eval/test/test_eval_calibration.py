"""What the navigator tells the fusion of the biases: recorded, the same when the bag is navigated again, never too late, honest."""

from __future__ import annotations

import dataclasses

import numpy as np

from riins_bag.bag import BagReader
from riins_eval.offline import navigate, sail
from riins_node import readings
from riins_sim import scenario as scenarios
from riins_sim.sensors import RedundantImuSim
from riins_sim.trajectory import Trajectory

TOPIC = "/nav/calibration"


def told(bag):
    with BagReader(bag) as reader:
        return [readings.read_inertial_calibration(message) for _, _, message in reader.read([TOPIC])], reader.start_ns


def test_calibrations_of_a_run_and_of_its_recording_navigated_again(tmp_path):
    ship = dataclasses.replace(scenarios.load("harbour"), duration_s=75.0, faults=(), outages=(), fusion={"method": "glr_kf"})
    sail(ship, bag=tmp_path / "a", record="all", twins=False)
    navigate(tmp_path / "a", tmp_path / "b", record="nav")
    (one, start), (other, _) = told(tmp_path / "a"), told(tmp_path / "b")
    assert [(c["effective_ns"] - start) // 1_000_000_000 for c in one] == [30, 40, 50, 60, 70, 80, 90][: len(one)] and len(one) >= 6
    assert len(one) == len(other)
    for a, b in zip(one, other, strict=True):
        assert a["effective_ns"] == b["effective_ns"]
        for name in a:
            assert np.allclose(a[name], b[name], rtol=1e-9, atol=1e-15)
    with BagReader(tmp_path / "a") as reader:
        last = [message for _, _, message in reader.read(["/fdi/status"])][-1]
    truth = RedundantImuSim(ship, Trajectory(ship)).true_bias(7500)
    for k, triad in enumerate((last.gyro, last.accel)):
        true, bias, sigma = truth[k], np.asarray(triad.bias), np.asarray(triad.bias_sigma)
        assert np.all(np.abs(bias - true) < 4.5 * sigma) and np.all(sigma > 0.0)
