"""Import of recordings in the common layout: made-up ones in the test, the real one where it is there."""

from __future__ import annotations

import dataclasses
import pickle
from pathlib import Path

import numpy as np
import pytest
import yaml

from riins_bag.bag import BagReader
from riins_core.earth import earth_rate_n
from riins_core.rotation import dcm_from_euler, euler_from_dcm, skew
from riins_eval import import_notes, importers, npz_recording, offline, units
from riins_eval.import_settings import recording_settings
from riins_eval.importers import ImportFailure, import_npz
from riins_eval.score import score_bag
from riins_sim.scenario import from_yaml
from riins_sim.sensors import DopplerSim
from riins_sim.trajectory import Trajectory

DATA = Path(__file__).resolve().parents[3].parent / "shared" / "data"
VEHICLE = """
name: vehicle
duration_s: 80
start: {latitude_deg: 33, longitude_deg: 35, height_m: -20, speed_kn: 4, heading_deg: 80}
legs: [{straight_s: 5}, {turn_deg: 90, rate_deg_s: 4}, {straight_s: 5}, {turn_deg: -90, rate_deg_s: 4}]
sea: {significant_wave_height_m: 0.5, peak_period_s: 5}
doppler: {sigma_kn: [0.02, 0.02, 0.02], lever_arm_m: [-1.0, 0.2, 0.5]}
"""
LEVER = np.array([2.0, -0.3, 0.4])


def make_recording(seeds: tuple[int, ...] = (1, 2), reference_point: np.ndarray = LEVER, height_step: float = 15.0) -> dict[str, np.ndarray]:
    """Pieces of 80 s, 300 s apart in the recording's clock that begins below zero; the reference holds at a point away from the IMU, every second."""
    parts: dict[str, list[np.ndarray]] = {k: [] for k in ("imu_t", "gyro_0", "accel_0", "imu_seg", "truth", "truth_seg", "dvl_t", "dvl_v", "dvl_seg")}
    for number, seed in enumerate(seeds):
        base = from_yaml(VEHICLE)
        ship = dataclasses.replace(base, seed=seed, start=dataclasses.replace(base.start, height_m=-20.0 - height_step * number))
        trajectory, offset = Trajectory(ship), -0.5 + 300.0 * number
        rng = np.random.default_rng(seed)
        rate, force = trajectory.increments(1, trajectory.samples)
        t = np.arange(1, trajectory.samples + 1) * trajectory.dt
        parts["imu_t"].append(t + offset)
        parts["gyro_0"].append(rate + rng.normal(0, 3e-5, rate.shape))
        parts["accel_0"].append(force + rng.normal(0, 3e-4, force.shape))
        parts["imu_seg"].append(np.full(len(t), number + 1))
        epochs = np.arange(0.33, 79.5, 1.0)
        truth = trajectory.truth(epochs)
        v_n = truth.v_n + np.einsum("kij,kj->ki", truth.C_nb, np.cross(truth.rate_nb_b, reference_point))
        moved = truth.C_nb @ reference_point
        lat, lon = truth.lat + moved[:, 0] / 6.357e6, truth.lon + moved[:, 1] / (6.384e6 * np.cos(truth.lat))
        parts["truth"].append(np.column_stack([epochs + offset, lat, lon, truth.h - moved[:, 2], v_n, *euler_from_dcm(truth.C_nb)]))
        parts["truth_seg"].append(np.full(len(epochs), number + 1))
        log = DopplerSim(dataclasses.replace(ship, doppler=dataclasses.replace(ship.doppler, misalignment_deg=0.0)), trajectory).block(1, 80)
        parts["dvl_t"].append(log.stamp_ns * 1e-9 + offset)
        parts["dvl_v"].append(log.v_b)
        parts["dvl_seg"].append(np.full(80, number + 1))
    made = {name: np.concatenate(values) for name, values in parts.items()}
    lever = np.array([-1.0, 0.2, 0.5]) - reference_point
    return {**made, "n_imu": np.array(1), "dvl_std": np.full(3, 0.01), "dvl_lever_frd": lever, "gnss_t": np.zeros(0)}


def save(path: Path, arrays: dict[str, np.ndarray]) -> Path:
    """A recording in a file."""
    np.savez(path, **arrays)
    return path


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    return save(tmp_path_factory.mktemp("recording") / "made_up.npz", make_recording())


@pytest.fixture(scope="module")
def imported(recording, tmp_path_factory):
    out = tmp_path_factory.mktemp("imported") / "bag"
    faults = [
        {"target": "gps", "type": "step", "axis": "east", "size_m": 80.0, "start_s": 40.0, "end_s": 55.0},
        {"target": "gyro_1", "type": "step", "size_deg_h": 1000.0, "start_s": 35.0, "end_s": 60.0},
    ]
    lines = import_npz(recording, out, seed=3, faults=faults)
    return out, lines


@pytest.fixture(scope="module")
def navigated(imported, tmp_path_factory):
    out = tmp_path_factory.mktemp("navigated") / "bag"
    return offline.navigate(imported[0], out), out


def test_it_navigates_in_pieces_and_finds_the_faults_of_each(navigated):
    run, out = navigated
    result = run.score
    assert [p["name"] for p in result["pieces"]] == ["1", "2"]
    assert result["samples"]["lost"] == 0 and result["samples"]["late"] == 0
    assert result["position_rms_m"] < 2.5
    for piece in result["pieces"]:
        assert piece["velocity_rms_mps"] < 0.1 and piece["nis_per_dof"]["doppler"] < 2.0
        assert {f["target"]: (f["isolated_right"], f["epochs_fused"], f["onset_s"]) for f in piece["faults"]} == {
            "gps": (True, 0, 40.0), "gyro_1": (True, 0, 35.0),
        }  # fmt: skip
        assert piece["epochs"] in (18, 19, 20)  # of 79 s, after the first 60 s
    alone = score_bag(out)
    assert alone["position_rms_m"] == pytest.approx(result["position_rms_m"])
    assert [p["name"] for p in alone["pieces"]] == ["1", "2"] and alone["notes"] == result["notes"]
    assert alone["twin_deviation_max_m"] is None


def test_the_bag_says_what_is_simulated(imported):
    out, lines = imported
    text = " ".join(lines)
    assert "GPS: SIMULATED" in text and "BDS: SIMULATED" in text and "taken as means" in text and "as recorded" in text
    with BagReader(out) as reader:
        content = yaml.safe_load(reader.configuration())
        assert content["recording"]["simulated"] == ["gps", "bds"]
        first, second = content["recording"]["pieces"]
        assert second["start_ns"] - first["stop_ns"] == import_notes.GAP_S * 1e9
        assert second["recorded_start_s"] - first["recorded_start_s"] == pytest.approx(300.0, abs=0.02)
        assert reader.topics["/nav/initial_state"][1] == 2 and reader.start_ns == first["start_ns"] == importers.EPOCH_S * 10**9
        stamps = reader.columns("/rimu/raw", ("header.stamp", "sequence"))
        steps = np.diff(stamps["header.stamp"])
        assert (np.sort(steps)[:-1] == 10_000_000).all() and steps.max() > 10e9
        fix = reader.columns("/gps/fix", ("header.stamp", "status.service"))
        assert set(fix["status.service"].tolist()) == {1}


def test_the_lever_arm_of_the_reference_is_found_and_the_log_is_used_as_recorded(recording, imported):
    loaded = npz_recording.load(recording)
    moved, note = importers._at_imu(loaded, None)
    assert moved.log_lever == pytest.approx([-1.0, 0.2, 0.5], abs=0.03)
    assert "found from its turns" in note[0]
    given, note = importers._at_imu(loaded, LEVER)
    assert given.log_lever == pytest.approx([-1.0, 0.2, 0.5]) and "as given" in note[0]
    # moved to the IMU the reference is that of the simulation
    truth = Trajectory(dataclasses.replace(from_yaml(VEHICLE), seed=1)).truth(loaded.pieces[0].reference[:, 0] + 0.5)
    assert given.pieces[0].reference[:, 4:7] == pytest.approx(truth.v_n, abs=5e-3)
    assert (given.pieces[0].reference[:, 1] - truth.lat) * 6.36e6 == pytest.approx(np.zeros(len(truth.lat)), abs=0.01)
    with BagReader(imported[0]) as reader:
        log = reader.columns("/doppler/velocity", ("header.stamp", "twist.twist.linear.x", "twist.twist.linear.y"))
        recorded = loaded.pieces[0].log_v
        n = 78
        assert log["twist.twist.linear.x"][:n] == pytest.approx(recorded[:n, 0])
        assert log["twist.twist.linear.y"][:n] == pytest.approx(-recorded[:n, 1])  # FLU at the topic


def test_without_noise_parity_is_zero_and_with_it_it_is_not(recording, tmp_path):
    for noise in (False, True):
        import_npz(recording, tmp_path / str(noise), noise=noise)
        with BagReader(tmp_path / str(noise)) as reader:
            gyro = reader.columns("/rimu/raw", ("gyro",), reader.start_ns, reader.start_ns + 5 * 10**9)["gyro"]
        from riins_core.imu_array import CONFIGURATIONS, ImuArray

        parity = gyro @ ImuArray(CONFIGURATIONS["dodecahedron"]).parity().T
        wanted = 0.02 / 60 * np.pi / 180 / np.sqrt(0.01)
        assert np.std(parity) == pytest.approx(wanted, rel=0.1) if noise else np.abs(parity).max() < 1e-15


def test_the_same_seed_gives_the_same_bag(recording, tmp_path):
    bags = []
    for name, seed in (("a", 1), ("b", 1), ("c", 2)):
        import_npz(recording, tmp_path / name, seed=seed)
        with BagReader(tmp_path / name) as reader:
            bags.append([m for m in reader.messages() if m.topic != "/riins/configuration"])
    assert bags[0] == bags[1]
    assert bags[0] != bags[2]


def test_the_mounting_of_the_imu_is_undone(tmp_path):
    arrays = make_recording((1,))
    turn = dcm_from_euler(0.2, -0.1, 1.0)
    plain = npz_recording.load(save(tmp_path / "plain.npz", arrays))
    arrays["gyro_0"], arrays["accel_0"] = arrays["gyro_0"] @ turn, arrays["accel_0"] @ turn
    for extra in ({"C_body_imu_0": turn}, {"euler_deg_0": np.degrees([0.2, -0.1, 1.0])}):
        turned = npz_recording.load(save(tmp_path / "turned.npz", {**arrays, **extra}))
        assert turned.pieces[0].rate == pytest.approx(plain.pieces[0].rate, abs=1e-12)
    with pytest.raises(ImportFailure, match="no rotation"):
        npz_recording.load(save(tmp_path / "bad.npz", {**arrays, "C_body_imu_0": skew([1.0, 2.0, 3.0])}))


def test_recorded_gnss_is_used_as_it_is(tmp_path):
    arrays = make_recording((1,), np.zeros(3), 0.0)
    truth = arrays["truth"]
    arrays |= {"gnss_t": truth[:, 0], "gnss_llh": truth[:, 1:4], "gnss_vned": truth[:, 4:7], "gnss_std": np.array([1.0, 1.0, 2.0, 0.1, 0.1, 0.1])}
    arrays["gnss_llh"] = arrays["gnss_llh"].copy()
    arrays["gnss_llh"][10] = np.nan
    lines = import_npz(
        save(tmp_path / "gnss.npz", arrays), tmp_path / "bag", options={"outages": [{"target": "gps", "start_s": 20.0, "end_s": 22.0}]}
    )
    assert not any("GPS: SIMULATED" in line for line in lines) and any("BDS: SIMULATED" in line for line in lines)
    with BagReader(tmp_path / "bag") as reader:
        fix = reader.columns("/gps/fix", ("latitude", "status.status", "position_covariance"))
        assert (fix["status.status"] == -1).sum() == 3
        good = fix["status.status"] == 0
        assert np.isin(np.round(fix["latitude"][good], 12), np.round(np.degrees(truth[:, 1]), 12)).all()
        assert fix["position_covariance"][0][[0, 4, 8]].tolist() == [1.0, 1.0, 4.0]
        assert yaml.safe_load(reader.configuration())["scenario"]["gps"]["sigma_m"] == [1.0, 1.0, 2.0]
    assert offline.navigate(tmp_path / "bag").score["samples"]["no_fix"] == 3


def test_a_recording_without_a_reference_has_no_truth_and_says_so(tmp_path):
    arrays = {k: v for k, v in make_recording((1,)).items() if not k.startswith("truth")}
    lines = import_npz(save(tmp_path / "bare.npz", arrays), tmp_path / "bag")
    assert any("no initial state" in line for line in lines)
    with BagReader(tmp_path / "bag") as reader:
        assert set(reader.topics) == {"/riins/configuration", "/rimu/raw", "/doppler/velocity"}
    result = offline.navigate(tmp_path / "bag").score
    assert result["scored"] == "sensors" and result["epochs"] == 0 and result["position_rms_m"] is None and len(result["sensors"]) == 12


def test_unix_time_is_kept_and_lost_samples_stay_lost(tmp_path):
    arrays = make_recording((1,))
    for name in ("imu_t", "dvl_t"):
        arrays[name] = arrays[name] + 1_654_000_000.0
    arrays["truth"] = arrays["truth"] + np.r_[1_654_000_000.0, np.zeros(9)]
    keep = np.ones(len(arrays["imu_t"]), dtype=bool)
    keep[3000:3004] = False
    for name in ("imu_t", "gyro_0", "accel_0", "imu_seg"):
        arrays[name] = arrays[name][keep]
    import_npz(save(tmp_path / "unix.npz", arrays), tmp_path / "bag")
    with BagReader(tmp_path / "bag") as reader:
        assert reader.start_ns // 10**9 in (1_653_999_999, 1_654_000_000)
    result = offline.navigate(tmp_path / "bag").score
    assert result["samples"]["lost"] == 4 and result["position_rms_m"] < 3.0


def _timeless() -> np.ndarray:
    truth = make_recording((1,))["truth"]
    truth[3, 0] = np.nan
    return truth


def bad_recordings() -> list[tuple[str, dict, str]]:
    """Name, change of the arrays (None: take out), words of the failure."""
    spoiled = np.zeros((8000, 3))
    spoiled[17, 1] = np.nan
    return [
        ("without gyros", {"gyro_0": None}, "gyro_0 is missing"),
        ("nan", {"gyro_0": spoiled}, "gyro_0 has 1 rows that are not finite, the first is row 17"),
        ("second imu", {"n_imu": np.array(2)}, "gyro_1 is missing"),
        ("no imu", {"n_imu": np.array(0)}, "n_imu is 0"),
        ("truth time", {"truth": _timeless()}, "row 3 of truth has values but no time"),
        ("shape", {"accel_0": np.zeros((10, 3))}, "accel_0 has shape"),
        ("text", {"imu_t": np.array(["a"] * 8000)}, "not numbers"),
        ("backwards", {"imu_t": -np.arange(8000.0)}, "does not increase"),
        ("rate", {"imu_t": np.arange(8000) * 0.0123}, "whole number of samples"),
        ("segments", {"imu_seg": np.zeros(5)}, "imu_seg has shape"),
        ("truth", {"truth": np.zeros((79, 9))}, "truth has shape"),
        ("values", {"imu_values": np.array("average")}, "imu_values"),
        ("no count", {"n_imu": None}, "n_imu is missing"),
    ]


@pytest.mark.parametrize(("name", "change", "words"), bad_recordings(), ids=lambda v: v if isinstance(v, str) and " is " not in v else None)
def test_a_bad_recording_is_refused_in_one_sentence(tmp_path, name, change, words):
    arrays = {k: v for k, v in {**make_recording((1,)), **change}.items() if v is not None}
    with pytest.raises(ImportFailure, match=words) as failure:
        import_npz(save(tmp_path / "bad.npz", arrays), tmp_path / "bag")
    assert "\n" not in str(failure.value)
    assert not (tmp_path / "bag").exists()


def test_a_file_that_is_no_recording_is_refused(tmp_path):
    (tmp_path / "text.npz").write_text("hello")
    (tmp_path / "pickled.npz").write_bytes(pickle.dumps({"a": 1}))
    np.savez(tmp_path / "objects.npz", n_imu=np.array([{"a": 1}], dtype=object))
    np.save(tmp_path / "single.npy", np.zeros(3))
    whole = save(tmp_path / "whole.npz", make_recording((1,))).read_bytes()
    (tmp_path / "cut.npz").write_bytes(whole[: len(whole) // 2])
    for name, words in (
        ("missing.npz", "no such file"), ("text.npz", "pickle|no readable"), ("pickled.npz", "pickle|no readable"),
        ("objects.npz", "pickled objects"),
        ("single.npy", "single array"), ("cut.npz", "no readable"),
    ):  # fmt: skip
        with pytest.raises(ImportFailure, match=words):
            import_npz(tmp_path / name, tmp_path / "bag")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("- {target: gps, type: step, size_m: 10, start_s: 5, end_s: 9}\n- {target: gyro_2, type: step, size_m: 1, start_s: 3}", "fault 2.*size_m"),
        ("- {target: gsp, type: step, size_m: 10, start_s: 5}", 'fault 1.*"gsp"|fault 1.*gsp'),
        ("target: gps", "a list of faults"),
        ("- [", "faults.yaml"),
        ("- {target: gyro_9, type: step, size_deg_h: 10, start_s: 5}", "gyro_9"),
    ],
)
def test_bad_faults_are_refused_in_one_sentence(recording, tmp_path, text, words):
    (tmp_path / "faults.yaml").write_text(text)
    with pytest.raises(ImportFailure, match=words) as failure:
        import_npz(recording, tmp_path / "bag", faults=tmp_path / "faults.yaml")
    assert "\n" not in str(failure.value)


def test_bad_options_are_refused(recording, tmp_path):
    with pytest.raises(ImportFailure, match="did you mean"):
        import_npz(recording, tmp_path / "bag", options={"navigator": {"hieght": {}}})
    with pytest.raises(ImportFailure, match="self_aligned"):
        import_npz(recording, tmp_path / "bag", options={"initial": {"self_aligned": True}})


@pytest.mark.skipif(not (DATA / "snapir_open.npz").is_file(), reason="the sea recording is not on this machine (../shared/data/snapir_open.npz)")
def test_the_sea_recording_navigates_with_all_aids_and_with_the_log_alone(tmp_path):
    with np.load(DATA / "snapir_open.npz", allow_pickle=False) as file:
        arrays = {name: file[name] for name in file.files}
    chosen = (1, 7, 12)  # three of the nine pieces: turns, dives, a straight one
    for stem in ("imu", "dvl", "truth"):
        rows = np.isin(arrays[f"{stem}_seg"], chosen)
        for name in [n for n in arrays if len(arrays[n].shape) and len(arrays[n]) == len(rows) and n.startswith((stem, "gyro", "accel"))]:
            arrays[name] = arrays[name][rows]
    lines = import_npz(save(tmp_path / "sea.npz", arrays), tmp_path / "sea")
    assert any("+1.7" in line and "found from its turns" in line for line in lines)
    everything = offline.navigate(tmp_path / "sea").score
    assert [p["name"] for p in everything["pieces"]] == ["1", "7", "12"] and everything["false_isolations"] == 0
    assert all(p["position_rms_m"] < 2.0 and p["velocity_rms_mps"] < 0.05 and p["heading_rms_arcmin"] < 45.0 for p in everything["pieces"])
    alone = offline.navigate(tmp_path / "sea", overrides={"navigator": {"gps": {"enabled": False}, "bds": {"enabled": False}}}).score
    assert all(p["position_rms_m"] < 20.0 and p["velocity_rms_mps"] < 0.05 for p in alone["pieces"])  # the start alone is 5 m off in each axis


def test_units_that_cannot_be_meant_are_refused_unless_one_insists(recording, tmp_path):
    arrays = make_recording((1,))
    wrong = (("accel_0", 1.0 / 9.80665, "looks like g"), ("gyro_0", 180.0 / np.pi, "look like deg/s"), ("accel_0", 3.0, "gravity is"))
    for name, scale, words in wrong:
        file = save(tmp_path / "scaled.npz", {**arrays, name: arrays[name] * scale})
        with pytest.raises(ImportFailure, match=words) as failure:
            npz_recording.load(file)
        assert "\n" not in str(failure.value) and "--no-check-units" in str(failure.value)
        settings, _ = recording_settings({"recording": {"check_units": False}})
        assert npz_recording.load(file, settings).rate_hz == 100


def test_a_still_gyro_shows_its_unit_by_the_earth_rate_and_a_bias_alone_shows_nothing():
    t = np.arange(0.0, 60.0, 0.01)
    reference = np.column_stack([np.arange(0.0, 60.0), np.tile([0.6, 0.6, 0.0, 0, 0, 0, 0, 0, 0.3], (60, 1))])
    w = dcm_from_euler(0.0, 0.0, 0.3).T @ earth_rate_n(0.6)
    force = np.tile([0.0, 0.0, -9.8], (len(t), 1))
    noise = np.random.default_rng(1).normal(0.0, 1e-5, (len(t), 3))
    assert units.implausible(t, w + noise, force, reference) == ""
    assert "deg/s" in units.implausible(t, np.degrees(w + noise), force, reference)
    assert units.implausible(t, np.array([0.004, -0.002, 0.003]) + noise, force, reference) == ""


def test_rows_of_the_reference_without_anything_in_them_are_left_out_and_counted(tmp_path):
    arrays = make_recording((1,))
    arrays["truth"][[5, 9]] = np.nan
    loaded = npz_recording.load(save(tmp_path / "empty.npz", arrays))
    assert len(loaded.pieces[0].reference) == len(arrays["truth"]) - 2 and "2 empty rows of truth" in loaded.notes[0] and "row 5" in loaded.notes[0]
