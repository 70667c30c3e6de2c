"""What the array says of its IMUs: redundancy, silence, clocks out of step, and the parameters that fit imu_fusion."""

from __future__ import annotations

import numpy as np
import yaml

from riins_core.settings import build
from riins_imu_fusion.array_align import ArrayAligner
from riins_imu_fusion.array_config import ArrayConfig
from riins_imu_fusion.array_mounting import MountingEstimator
from riins_imu_fusion.array_reporting import Changes, diagnosis, parameter_file
from riins_imu_fusion.config import FusionConfig

START = 1_700_000_000_000_000_000


def feed(aligner: ArrayAligner, imus: tuple[int, ...], begin: int, end: int, offset_s: tuple[float, ...] = (0.0, 0.0, 0.0)) -> None:
    for k in range(begin, end):
        for i in imus:
            value = np.full(3, np.sin(0.1 * k))
            aligner.add(i, START + 10_000_000 * k + 1_000_000 * i + round(offset_s[i] * 1e9), value, value)


def test_silence_return_and_a_clock_out_of_step_are_told_once() -> None:
    aligner = ArrayAligner(ArrayConfig())
    changes = Changes(aligner, None)
    feed(aligner, (0, 1, 2), 1, 100)
    assert changes.drain() == [] and diagnosis(aligner, None)[0][1:3] == ("ok", "3 IMUs: a fault is isolated, also one of a whole IMU")
    feed(aligner, (0, 1), 100, 200)
    assert changes.drain() == ["imu_2/raw silent"] and changes.drain() == []
    array, *each = diagnosis(aligner, None)
    assert array[1:3] == ("warn", "two IMUs: a fault is detected, not isolated") and [status[1] for status in each] == ["ok", "ok", "error"]
    assert each[2][3]["received"] == 99 and each[2][3]["silent"] > 80
    feed(aligner, (0, 1, 2), 200, 300)
    assert changes.drain() == ["imu_2/raw is back"]
    feed(aligner, (0, 1, 2), 300, 400, (0.0, -30.0, 0.0))
    assert changes.drain() == ["imu_1/raw left out: its clock is out of step"]
    assert diagnosis(aligner, None)[2][3]["clock out of step"] >= 90


def test_one_imu_says_that_there_is_no_redundancy_and_none_that_it_was_never_heard() -> None:
    one = ArrayAligner(ArrayConfig(topics=("a",)))
    assert diagnosis(one, None)[1][1:3] == ("error", "never heard")
    feed(one, (0,), 1, 50)
    assert diagnosis(one, None)[0][1:3] == ("warn", "one IMU, no redundancy: a fault is not seen")


def test_a_mounting_is_reported_with_its_directions() -> None:
    config = ArrayConfig(topics=("a", "b"))
    status = diagnosis(ArrayAligner(config), MountingEstimator(config))
    assert "mounting" not in status[1][3] and status[2][3]["mounting"].startswith("0 of 3 directions")


def test_the_parameters_are_those_of_the_fusion() -> None:
    config = ArrayConfig(mounting_rpy_deg=(0.0, 0.0, 0.0, 10.0, 0.0, 90.0, 180.0, 0.0, 0.0), gyro_sigma=(1e-3, 2e-3, 3e-3))
    given = yaml.safe_load(parameter_file(config))["/imu_fusion"]["ros__parameters"]
    fusion = build(FusionConfig, given)
    np.testing.assert_allclose(fusion.array().H * [1.0, -1.0, -1.0], config.geometry(), atol=1e-15)
    np.testing.assert_array_equal(fusion.sigma(), config.sigma())
    assert fusion.groups == (0, 0, 0, 1, 1, 1, 2, 2, 2)
