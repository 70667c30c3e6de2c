"""Scenarios: errors with line and suggestion, round trip, shipped files."""

import pytest
import yaml

from riins_sim import scenario_file
from riins_sim.scenario import ScenarioError, from_yaml, load, names

GOOD = """\
name: small
duration_s: 60
start: {latitude_deg: 40.0, longitude_deg: 121.0}
legs:
  - {straight_s: 10}
  - turn_deg: 30
    rate_deg_s: 1e0
imu:
  gyro:
    constant_drift_deg_h: 1e-2
faults:
  - {target: gyro_1, type: step, size_deg_h: 5, start_s: 3}
  - target: gps
    type: step
    size_m: 50
    start_s: 1
    end_s: 2
"""


def test_the_good_one():
    scenario = from_yaml(GOOD)
    assert scenario.imu.gyro.constant_drift_deg_h == 0.01  # 1e-2 is a number, as YAML 1.2 has it
    assert scenario.legs[1].turn_deg == 30.0
    assert scenario.imu_rate_hz == 100 and scenario.sea.significant_wave_height_m == 0.0
    assert len(scenario.fault_schedule().faults) == 2
    assert scenario.with_seed(-1) is scenario and scenario.with_seed(5).seed == 5


@pytest.mark.parametrize(
    ("old", "new", "line", "words"),
    [
        ("duration_s: 60", "duraton_s: 60", 2, 'unknown setting "duraton_s" (did you mean "duration_s"?)'),
        ("constant_drift_deg_h", "constant_drift_dgr_h", 10, 'did you mean "constant_drift_deg_h"?'),
        ("rate_deg_s: 1e0", "rate_rad_s: 1.0", 7, 'did you mean "rate_deg_s"?'),
        ("duration_s: 60", "duration_s: soon", 2, '"duration_s" must be a number'),
        ("latitude_deg: 40.0", "latitude_deg: 140.0", 3, "must be in -85"),
        ("{straight_s: 10}", "{straight_s: 10, turn_deg: 3}", 5, "exactly one of"),
        ("start_s: 3}", "start_s: 3, end_s: 2}", 12, "must end after it starts"),
        ("target: gyro_1, type: step, size_deg_h: 5", "target: accel_1, type: step, size_deg_h: 5", 12, "give size_ug or size_mg or size_mps2"),
        ("    size_m: 50", "    size_kn: 50", 15, '"size_kn" does not fit a step fault on gps; give size_m or size_arcmin'),
        ("    size_m: 50", "    slope_mps: 50", 15, '"slope_mps" does not fit a step fault on gps: a step fault has none'),
        ("    size_m: 50", "    size_m: 50\n    size_arcmin: 1", 16, "not both"),
        ("target: gps", "target: gsp", 13, 'did you mean "gps"?'),
        ("target: gyro_1", "target: gyro_6", 12, "the IMU has gyro_0 .. gyro_5"),
        ("    type: step", "    type: stepp", 14, 'did you mean "step"?'),
        ("    type: step", "    type: step\n    axis: forward", 15, "must be one of all, north, east, down"),
        ("    type: step\n    size_m: 50", "    type: scale\n    size_percent: 50", 14, "no meaning for the position"),
        ("duration_s: 60", "duration_s: 60\nduration_s: 70", 3, '"duration_s" is given twice, first in line 2'),
        ("legs:", "legs: [", 5, "expected"),
        ("name: small", "name: small one", 1, "letters, digits"),
        ("name: small\n", "", 1, '"name" is missing'),
        ("duration_s: 60", "duration_s: 60\nexpect: {position_rms_m: 3}", 3, "{min: .., max: ..} or a list"),
        ("duration_s: 60", "duration_s: 60\nexpect: {position_rms_m: {max: .nan}}", 3, "{min: .., max: ..} or a list"),
        ("duration_s: 60", "duration_s: 60\nexpect: {isolated: [[gps]]}", 3, "or a list of words"),
        ("duration_s: 60", "duration_s: 60\nexpect: {5: {max: 1}}", 3, '"expect.5" must be'),
        ("duration_s: 60", "duration_s: 60\noutages: [{target: gps, start_s: 1, end_s: 1e300}]", 3, "must be in 0.0 .. 10000000.0"),
        ("duration_s: 60", "duration_s: 60\nnavigator: gps", 3, "must be a mapping of names to values, not 'gps'"),
        ("duration_s: 60", "duration_s: 60\nimu_rate_hz: 12.5", 3, "must be a whole number"),
        ("duration_s: 60", "duration_s: 60\noutages: [{target: radar, start_s: 1, end_s: 2}]", 3, "must be one of imu, gps, bds, doppler"),
    ],
)
def test_errors_name_the_line(old, new, line, words):
    assert old in GOOD
    with pytest.raises(ScenarioError) as caught:
        from_yaml(GOOD.replace(old, new, 1), "small.yaml")
    text = str(caught.value)
    assert "\n" not in text
    assert words in text
    assert text.startswith(f"small.yaml:{line}: "), text


@pytest.mark.parametrize("text", ["", "- a\n- b\n", "just words", "a: &x [*x]\n", "\x00"])
def test_no_scenario_at_all(text):
    with pytest.raises(ScenarioError, match=r"^bad\.yaml:1: "):
        from_yaml(text, "bad.yaml")


@pytest.mark.parametrize("value", ["2020-13-45", "9" * 5000])
def test_a_value_that_yaml_cannot_read(value):
    with pytest.raises(ScenarioError, match=r"^bad\.yaml: a value cannot be read: "):
        from_yaml(GOOD.replace("duration_s: 60", f"duration_s: {value}"), "bad.yaml")


def test_round_trip_through_yaml(voyage):
    faults = [{"target": "accel_2", "type": "ramp", "slope_ug_s": 3.0, "start_s": 5.0}]
    outages = [{"target": "bds", "start_s": 1.0, "end_s": 2.5}]
    scenario = voyage(faults=faults, outages=outages, navigator={"a": {"b": [1, 2.5]}}, expect={"isolated": ["accel_2"]})
    again = from_yaml(scenario.to_yaml())
    assert again == scenario
    assert again.to_yaml() == scenario.to_yaml()


def test_shipped_scenarios():
    assert {"harbour", "voyage_12h", "calm_12h", "voyage_straight", "three_faults"} <= set(names())
    for name in names():
        scenario = load(name)
        assert scenario.name == name
        assert from_yaml(scenario.to_yaml()) == scenario
        assert all(f.start_s < scenario.duration_s for f in scenario.faults)
        assert scenario.scoring.from_s < scenario.duration_s


def test_shipped_voyages_are_the_papers():
    voyage, calm, straight = (load(name) for name in ("voyage_12h", "calm_12h", "voyage_straight"))
    assert voyage.duration_s == 12 * 3600.0 and voyage.start.speed_kn == 15.0
    assert [leg.turn_deg for leg in voyage.legs if leg.turn_deg] == [90.0] * 7  # at 1.5 h .. 10.5 h
    # of the fused triad: a sixth of the sensors' information on each axis is a half of one sensor's variance
    assert voyage.imu.gyro.constant_drift_deg_h == pytest.approx(0.01 * 2**0.5, rel=1e-4)
    assert voyage.imu.accel.bias_ug == pytest.approx(50.0 * 2**0.5, rel=1e-4)
    for other in (calm, straight):
        for name in ("start", "sea", "imu", "gps", "bds", "doppler", "initial", "duration_s", "scoring", "seed"):
            assert getattr(other, name) == getattr(voyage, name), (other.name, name)
    assert calm.legs == voyage.legs and not calm.faults and not calm.outages
    assert straight.faults == voyage.faults and straight.outages == voyage.outages and not straight.legs


def test_finding_scenarios(tmp_path, monkeypatch):
    path = tmp_path / "mine.yaml"
    path.write_text(GOOD)
    assert load(path) == load(str(path)) == from_yaml(GOOD)
    with pytest.raises(ScenarioError, match=r"^no scenario is named; shipped: .*harbour"):
        load("")
    with pytest.raises(ScenarioError, match=r'no scenario "harbur" \(did you mean "harbour"\?\); shipped: .*voyage_12h'):
        load("harbur")
    for word, said in (("nowhere/harbour.yaml", "no such file"), ("/dev/null", "no regular file"), (str(tmp_path), "a directory")):
        with pytest.raises(ScenarioError, match=f"{word}: {said}; a YAML file or the name of a shipped scenario is wanted: .*harbour"):
            load(word)
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ScenarioError, match="cannot be read"):
        load(path)
    # an installed riins_bringup goes before the source tree
    share = tmp_path / "share" / "riins_bringup" / "scenarios"
    share.mkdir(parents=True)
    (share / "harbour.yaml").write_text(GOOD)
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))
    assert load("harbour").name == "small"
    assert scenario_file.find("harbour") == share / "harbour.yaml"


def test_yaml_text_is_plain(voyage):
    values = yaml.safe_load(voyage().to_yaml())
    assert values["start"]["speed_kn"] == 15.0
    assert "turn_deg" not in values["legs"][0] and values["legs"][0]["straight_s"] == 60.0
