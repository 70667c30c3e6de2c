"""The score of made-up runs, and its verdict."""

from __future__ import annotations

import json
import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from test_eval_metrics import S, make_judged, make_track

from riins_eval.lane import aid_notes
from riins_eval.run_record import FaultInterval, HealthChange, RunRecord, Samples, SensorUse
from riins_eval.score import fault_rows, score, table, verdict


def make_record(m: int = 100) -> RunRecord:
    """A run 1 m north and 0.01 m/s of truth, a GPS step and a gyro ramp found, a false isolation of accel_3."""
    truth = make_track(m)
    settled = truth.take(np.arange(m))
    settled.lat = truth.lat + 1.0 / 6.3642e6
    settled.v_n = truth.v_n + np.array([0.0, 0.01, 0.0])
    stamps = np.arange(1, 100 * m + 1) * (S // 100)
    gyro = np.full(100 * m, 0x3F, np.uint64)
    gyro[3000:] = 0x3B
    return RunRecord(
        "made up", settled, truth,
        covariance=np.broadcast_to(np.diag([1.0, 1.0, 1e-4, 1e-4, 1e-8, 1e-8, 1e-8]), (m, 7, 7)),
        judged={"gps": make_judged(list(range(10, m, 10)), [not 40 <= t < 60 for t in range(10, m, 10)])},
        health=[
            HealthChange(30 * S + S // 100, "gyro_2", 2, 1), HealthChange(40 * S, "gps", 1, 1), HealthChange(50 * S, "gps", 2, 1),
            HealthChange(70 * S, "accel_3", 2, 1),
        ],
        faults=[FaultInterval("gps", "step", 40 * S, 60 * S, "100 m"), FaultInterval("gyro_2", "ramp", 25 * S, 90 * S)],
        scoring_from_ns=20 * S, use=SensorUse.from_samples(stamps, gyro, np.full(100 * m, 0x3F, np.uint64)),
        samples=Samples(100 * m, 0, 0, 0), twin=truth, oracle=settled, realtime_factor=1000.0,
    )  # fmt: skip


def test_score_of_a_made_up_run():
    result = score(make_record())
    assert result["position_rms_m"] == pytest.approx(1.0, rel=2e-3)
    assert result["position_max_m"] == pytest.approx(1.0, rel=2e-3)
    assert result["velocity_rms_mps"] == pytest.approx(0.01)
    assert result["heading_rms_arcmin"] == 0.0
    assert result["nees_per_dof"] == pytest.approx(2.0 / 7.0, rel=5e-3)
    assert result["nis_per_dof"] == {"gps": pytest.approx(1.0)}
    assert result["oracle_ratio"] == {"position": 1.0, "velocity": 1.0, "heading": None}
    assert result["twin_deviation_max_m"] == pytest.approx(1.0, rel=2e-3)
    assert result["epochs"] == 81
    assert result["false_isolations"] == 1 and result["false_isolations_list"][0]["target"] == "accel_3"
    ramp, step = result["faults"]
    assert (ramp["target"], ramp["epochs_fused"], ramp["detected"], ramp["isolated_right"]) == ("gyro_2", 0, True, True)
    assert ramp["delay_s"] == pytest.approx(5.01)
    assert (step["target"], step["epochs_fused"], step["delay_s"]) == ("gps", 0, 0.0)
    assert result["missed_isolations"] == 0
    json.dumps(result, allow_nan=False)
    assert len(table(result)) > 10 and len(fault_rows(result)) == 2


def test_every_name_of_the_score_is_documented_and_the_other_way_round():
    result = score(make_record())
    text = (Path(__file__).parents[3] / "docs" / "json.md").read_text()
    documented = set(re.findall(r"`([a-z_]+)(?:\[\])?`", text.split("## `expect`")[0]))
    names = {*result, *result["samples"], *result["faults"][0], *result["subfilters"]["gps"]}
    missing = {n for n in names if n not in documented and f"`{n}[]`" not in text and not re.search(rf"[{{,] ?{n}[,}}]", text)}
    assert not missing
    run_names = set(re.findall(r"^\| `([a-z_]+)", text.split("A fault:")[0], flags=re.MULTILINE)) - {"name"}
    assert run_names - {"verdict"} <= set(result)


def test_unknown_things_are_null():
    record = make_record()
    record.covariance = record.twin = record.oracle = record.use = None
    record.judged, record.samples, record.realtime_factor = {}, Samples(), None
    result = score(record)
    assert result["nees_per_dof"] is None and result["twin_deviation_max_m"] is None and result["realtime_factor"] is None
    assert set(result["oracle_ratio"].values()) == {None} and set(result["samples"].values()) == {None}
    assert all(f["epochs_fused"] is None for f in result["faults"])
    record.truth.lat[:] = np.nan
    record.truth.rph[:] = np.nan
    assert score(record)["position_rms_m"] is None
    json.dumps(score(record), allow_nan=False)


def test_pieces_are_scored_each_with_its_own_window():
    record = make_record()
    record.pieces = [("1", 1 * S, 50 * S), ("2", 51 * S, 100 * S)]
    record.settled.lat[50:] = record.truth.lat[50:] + 3.0 / 6.3642e6
    result = score(record)
    first, second = result["pieces"]
    assert first["epochs"] == 31 and second["epochs"] == 31  # 19 s of each piece do not count
    assert second["position_rms_m"] == pytest.approx(3.0, rel=2e-3)
    assert result["position_rms_m"] == pytest.approx(np.sqrt(5.0), rel=2e-3)
    assert [f["target"] for f in second["faults"]] == ["gyro_2", "gps"]
    assert "samples" not in first


@pytest.mark.parametrize(
    ("expect", "words"),
    [
        ({"position_rms_m": {"max": 1.1}, "isolated": ["gps", "gyro_2"], "samples.lost": 0, "nis_per_dof.gps": {"min": 0.5, "max": 2}}, None),
        ({"position_rms_m": {"max": 0.5}}, "position_rms_m is 0.9987, must be at most 0.5"),
        ({"position_rms_m": {"min": 2.0}}, "must be at least 2.0"),
        ({"false_isolations": 0}, "false_isolations is 1, must be equal to 0"),
        ({"isolated": ["bds"]}, "no fault was put on it"),
        ({"not_isolated": ["accel_3"]}, "accel_3 was isolated"),
        ({"position_rms": {"max": 1.0}}, 'did you mean "position_rms_m"'),
        ({"position_rms_m": {"most": 1.0}}, '"min", "max" or "equals"'),
        ({"oracle_ratio.heading": {"max": 1.0}}, "not known"),
    ],
)
def test_verdict(expect, words):
    failures = verdict(score(make_record()), expect)
    if words is None:
        assert failures == []
    else:
        assert len(failures) == 1 and words in failures[0]


def test_a_missed_fault_fails_the_verdict_and_counts_all_its_samples():
    record = make_record()
    record.health = [c for c in record.health if c.target != "gyro_2"]
    result = score(record)
    assert verdict(result, {"isolated": ["gyro_2"]}) == ["gyro_2: the ramp at 24 s was not rightly isolated"]
    assert result["missed_isolations"] == 1
    assert result["faults"][0]["epochs_fused"] == 501  # 25.00 s .. 30.00 s, then it was out of use


def test_an_aid_that_never_spoke_and_a_navigator_without_aids_are_noted():
    counts = {"accepted": 0, "rejected": 0, "late": 0, "malformed": 0}
    spoke = [SimpleNamespace(name=f"aid{i}", **{**counts, count: 1}) for i, count in enumerate(counts)]
    assert aid_notes([*spoke, SimpleNamespace(name="no_fix", no_fix=3, **counts)]) == []
    assert aid_notes([*spoke, SimpleNamespace(name="compass", no_fix=0, **counts)]) == [
        'The aid "compass" is declared, and not one measurement of it came.'
    ]
    assert "no aid" in aid_notes([])[0]


def test_a_limit_on_what_is_no_number_fails_in_one_line():
    assert verdict({"name": "x", "faults": []}, {"name": {"max": 1}}) == ['"name" is no number of the score: it cannot be at most 1']
