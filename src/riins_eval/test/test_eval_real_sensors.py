"""The study on real sensors: equal alarm rates, cases by number, what counts as right; the drone's natural fault where the recording is there."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from riins_core.imu_array import CONFIGURATIONS, ImuArray
from riins_eval.reproduce import reproduce
from riins_eval.studies import real_sensors
from riins_eval.studies.real_cases import Case, Fault, Material, Result, calibrate, draw, episodes, judge, rows_of, shape_of, share, tune
from riins_eval.studies.real_detectors import Finding, Sensors, detectors

DATA = Path(__file__).resolve().parents[3].parent / "shared" / "data"
RATE = 50.0
SIZES = {"step": ((3.0, 12.0), (3.0, 12.0)), "ramp": ((2.0, 8.0), (2.0, 8.0)), "noise": ((6.0, 12.0), (6.0, 12.0))}


def material(minutes: float = 4.0, colour: float = 0.9, seed: int = 1) -> Material:
    """Six sensors of each kind without a fault; noise of unit size, coloured by a first-order filter."""
    rng, array, m = np.random.default_rng(seed), ImuArray(CONFIGURATIONS["dodecahedron"]), round(minutes * 60.0 * RATE)
    white = rng.normal(size=(2, m, 6))
    z = np.zeros((2, m, 6))
    for k in range(1, m):
        z[:, k] = colour * z[:, k - 1] + np.sqrt(1.0 - colour**2) * white[:, k]
    clean = z[0], z[1]
    half = (np.arange(m) * 8 // m) % 2

    def inject(case: Case) -> tuple[np.ndarray, np.ndarray]:
        end = min(m, int(np.ceil(case.end_s * RATE)))
        out, t = [part[:end].copy() for part in clean], np.arange(end) / RATE
        for fault in case.faults:
            column = out[case.kind][:, fault.sensor]
            if fault.type == "stuck":
                k = int(np.argmax(t >= fault.start_s))
                column[k:] = column[k - 1] + 9.0
            else:
                column += shape_of(fault, t, 3)
        return out[0], out[1]

    sensors = Sensors(RATE, array, np.ones((2, 6)), np.zeros(2), 2.0 / (minutes / 60.0))
    return Material(sensors, [clean], [half], inject, SIZES, 5.0)


def test_all_methods_alarm_equally_often_with_the_noise_they_are_told():
    ground = material()
    methods = detectors(ground.sensors, 1.0)
    scales, _ = tune(ground, methods, lambda part: None)
    for method in methods:
        for kind in range(2):
            told = method.alarms(ground.clean[0], float(scales[method.name][kind]))[kind]
            less = method.alarms(ground.clean[0], float(scales[method.name][kind]) / 1.5)[kind]
            assert episodes(told, ground.half[0], RATE).sum() <= 2.0 < episodes(less, ground.half[0], RATE).sum()
    # colour does nothing to a test of one epoch, but much to those that sum
    assert scales["glt"].max() < 1.3 < scales["cusum"].min() and scales["windowed_glr"].min() > 1.5


def test_the_methods_find_what_is_large_and_name_it():
    ground = material(minutes=3.0, colour=0.0)
    methods = detectors(ground.sensors, 1.0)
    scales, alarms = tune(ground, methods, lambda part: None)
    case = Case(1, 0, (Fault(4, "step", 14.0, 60.0),), 65.0)
    results = judge(ground, methods, scales, [case], lambda part: None)
    for method in methods:
        (result,) = results[method.name]
        assert result.detected and result.delay_s < 0.3, method.name
        assert (result.right and not result.wrong) or method.name == "direct_comparison"
    rows = rows_of("x", ground, methods, scales, alarms, results)
    assert len(rows) == 8 * 12 and all(r.n in (0, 1, 2) for r in rows)


def test_cases_come_by_number_and_lie_within_the_recording():
    ground = material(minutes=2.0)
    cases = [draw(ground, i) for i in range(60)]
    assert cases == [draw(ground, i) for i in range(60)]
    assert sum(len(c.faults) == 2 for c in cases) == 20 and sum(c.kind for c in cases) == 30
    singles = [c.faults[0].type for c in cases if len(c.faults) == 1]
    assert len(set(singles)) == 4 and {singles.count(t) for t in set(singles)} <= {9, 10, 11}
    for case in cases:
        assert case.end_s <= 120.0 and len(case.truth) == len(case.faults)
        for fault in case.faults:
            if fault.type != "stuck":
                least, most = SIZES[fault.type][case.kind]
                assert least <= abs(fault.size) <= most


def test_what_counts_as_right():
    case = Case(0, 0, (Fault(1, "step", 1.0, 1.0), Fault(3, "step", 1.0, 2.0)), 9.0)

    def made(first, named):
        return Result(case, Finding(60, 60, first, frozenset(named)), 0.2)

    assert made((1,), {1, 3}).right and made((1,), {1, 3}).whole and not made((1,), {1, 3}).wrong
    assert made((1,), {1}).right and not made((1,), {1}).whole
    assert not made((1, 2), {1, 2}).right and made((1, 2), {1, 2}).wrong
    assert not made((), ()).right and not made((), ()).wrong


def test_alarms_close_together_are_one():
    half = np.repeat([0, 1], 500)
    assert episodes(np.array([10, 20, 109, 300, 700, 900]), half, RATE).tolist() == [2.0, 2.0]
    assert episodes(np.array([], dtype=np.int64), half, RATE).tolist() == [0.0, 0.0]


def test_a_share_has_bounds_that_a_few_cases_deserve():
    row = share("x", [True] * 9 + [False])
    assert row.value == 0.9 and 0.6 < row.p05 < 0.8 and 0.95 < row.p95 < 1.0
    assert share("x", [True] * 4).p95 == 1.0 and share("x", []).n == 0


def test_a_test_that_never_alarms_is_told_the_least():
    class Silent:
        name = title = "silent"

        def alarms(self, z, scale):
            return np.array([], dtype=np.int64), np.array([], dtype=np.int64)

    scale, alarms = calibrate(material(minutes=0.5), Silent())
    assert scale.tolist() == [0.5, 0.5] and alarms.tolist() == [0.0, 0.0]


def test_without_the_recordings_the_study_says_so(tmp_path):
    rows = reproduce("real", quick=True, data=tmp_path, out=tmp_path / "page", processes=1)
    assert [r.n for r in rows] == [0, 0] and all("skipped" in r.remark and "--data" in r.remark for r in rows)
    assert "quad4imu.npz" in rows[0].remark and "snapir_open.npz" in rows[1].remark
    assert "skipped" in (tmp_path / "page/index.html").read_text()


@pytest.mark.skipif(not (DATA / "quad4imu.npz").is_file(), reason="the recording with four IMUs is not on this machine (../shared/data/quad4imu.npz)")
def test_every_method_finds_the_bad_gyro_of_the_drone_at_once():
    flight = real_sensors.read(DATA / "quad4imu.npz")
    rows = real_sensors.natural_fault(flight, 45.0)
    assert len(rows) == 8
    for row in rows:
        assert row.value <= 1.0 and row.remark.startswith("named rightly"), row
    ground = real_sensors.prepare(flight)
    assert ground.hours(0) == pytest.approx(ground.hours(1), rel=0.05)
    same = Case(0, 0, (Fault(2, "step", 0.0, 60.0),), 70.0)
    assert ground.inject(same)[0] == pytest.approx(ground.clean[0][0][: len(ground.inject(same)[0])], abs=1e-12)
