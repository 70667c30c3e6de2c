"""Recordings of several IMUs, each with its own clock and mounting: made-up ones in the test, the real one where it is there."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from riins_bag.bag import BagReader
from riins_core.rotation import dcm_from_euler, euler_from_dcm
from riins_eval import npz_recording, offline
from riins_eval.importers import import_npz
from riins_eval.run_configuration import read_configuration
from riins_eval.score import score_bag
from riins_eval.several_imus import Imu, RecordingSettings, clock_offsets, lowpass, noise
from riins_sim.scenario import from_yaml
from riins_sim.trajectory import Trajectory

DATA = Path(__file__).resolve().parents[3].parent / "shared" / "data"
BOAT = """
name: boat
duration_s: 90
start: {latitude_deg: 33, longitude_deg: 35, speed_kn: 6, heading_deg: 80}
legs: [{straight_s: 5}, {turn_deg: 90, rate_deg_s: 6}, {turn_deg: -90, rate_deg_s: 6}]
sea: {significant_wave_height_m: 1.5, peak_period_s: 4}
"""
TURNS = np.radians([[0.0, 0.0, 0.0], [3.0, -2.0, 90.0], [-4.0, 1.0, 200.0]])
OFFSETS = (0.0, 0.013, -0.35)
RATES = (100.0, 99.7, 61.0)
BIAS = np.radians(np.random.default_rng(4).normal(0.0, 0.1, (3, 3)))


def three_imus(whole: bool = True, seed: int = 1) -> dict[str, np.ndarray]:
    """Three IMUs on a boat: clock i reads OFFSETS[i] too little and ticks at RATES[i], IMU i is turned by TURNS[i]; `whole`: a reference too."""
    ship = dataclasses.replace(from_yaml(BOAT), seed=seed)
    trajectory, rng = Trajectory(ship), np.random.default_rng(seed)
    fine = np.arange(1, trajectory.samples + 1)
    rate, force = trajectory.increments(1, trajectory.samples)
    arrays = {"n_imu": np.array(3)}
    for i, (offset, hz) in enumerate(zip(OFFSETS, RATES, strict=True)):
        t = np.arange(1.0 + 0.003 * i, 88.5, 1.0 / hz)
        turn = dcm_from_euler(*TURNS[i])
        for name, values, sigma, bias in (("gyro", rate, 2e-4, BIAS[i]), ("accel", force, 5e-3, np.zeros(3))):
            # the mean over a sample belongs to the middle of its interval; the grid is fine enough for a line between two of them
            seen = np.column_stack([np.interp(t, (fine - 0.5) * trajectory.dt, column) for column in values.T]) @ turn
            arrays[f"{name}_{i}"] = seen + bias + rng.normal(0.0, sigma, seen.shape)
        arrays[f"imu_t_{i}"] = t - offset
        arrays[f"euler_deg_{i}"] = np.degrees(TURNS[i])
    if whole:
        epochs = np.arange(0.5, 89.0, 0.5)
        truth = trajectory.truth(epochs)
        arrays["truth"] = np.column_stack([epochs, truth.lat, truth.lon, truth.h, truth.v_n, *euler_from_dcm(truth.C_nb)])
    return arrays


def save(path: Path, arrays: dict[str, np.ndarray]) -> Path:
    """A recording in a file."""
    np.savez(path, **arrays)
    return path


def test_clocks_mountings_and_noise_are_found(tmp_path):
    loaded = npz_recording.load(save(tmp_path / "three.npz", three_imus()))
    stacked, (piece,) = loaded.stacked, loaded.pieces
    assert stacked.offsets == pytest.approx(OFFSETS, abs=1e-3)
    gyro, accel, valid = piece.sensors
    assert gyro.shape == accel.shape == valid.shape == (len(piece.t), 9) and valid.all()
    assert stacked.axes[3:6] == pytest.approx(dcm_from_euler(*TURNS[1]).T)
    assert np.diff(piece.t) == pytest.approx(1.0 / loaded.rate_hz)
    # what is left of the motion in the parity is little: without the clocks it would be thirty times as much
    Q = np.eye(9) - stacked.axes @ np.linalg.pinv(stacked.axes)
    left = np.std(gyro @ Q, axis=0).max()
    blind = npz_recording.load(tmp_path / "three.npz", RecordingSettings(fit_clocks=False))
    assert left < 3e-4 and np.std(blind.pieces[0].sensors[0] @ Q, axis=0).max() > 10.0 * left
    assert stacked.gyro_sigma == pytest.approx(np.full(9, np.median(stacked.gyro_sigma)), rel=0.7)


def test_noise_of_each_sensor_from_contradictions():
    rng = np.random.default_rng(3)
    axes = np.concatenate([dcm_from_euler(*r) for r in rng.uniform(-1.0, 1.0, (4, 3))])
    sigma = rng.uniform(0.5, 2.0, 12)
    z = rng.normal(0.0, 1.0, (40000, 3)) @ axes.T + sigma * rng.normal(size=(40000, 12)) + rng.normal(size=12)
    assert noise([z], axes, 4000) == pytest.approx(sigma, rel=0.05)


def test_the_low_pass_is_causal_and_its_delay_is_taken_off_the_stamps():
    t = np.arange(0.0, 20.0, 0.01)
    step = np.where(t < 10.0, 0.0, 1.0)[:, None]
    out = lowpass(step, 2.0, 100.0)
    assert np.abs(out[t < 9.999]).max() < 1e-12 and out[-1, 0] == pytest.approx(1.0, abs=1e-6)
    wave = np.sin(2.0 * np.pi * 0.2 * t)[:, None]
    delay = np.sqrt(2.0) / (2.0 * np.pi * 2.0)
    assert lowpass(wave, 2.0, 100.0)[500:, 0] == pytest.approx(np.sin(2.0 * np.pi * 0.2 * (t - delay))[500:], abs=5e-3)


def test_clocks_that_cannot_be_seen_are_left_alone():
    rng, t = np.random.default_rng(5), np.arange(0.0, 60.0, 0.01)
    still = [Imu(t, rng.normal(0.0, 1e-3, (len(t), 3)), np.tile([0.0, 0.0, -9.8], (len(t), 1)), np.eye(3)) for _ in range(3)]
    assert not clock_offsets(still).any()


def test_three_imus_navigate_from_the_bag_alone_and_a_bad_sensor_is_named(tmp_path):
    fault = {"target": "gyro_7", "type": "step", "size_deg_h": 20000.0, "start_s": 40.0}
    lines = import_npz(save(tmp_path / "three.npz", three_imus()), tmp_path / "bag", faults=[fault], options={"scoring": {"from_s": 20.0}})
    assert any("9 gyros" in line for line in lines) and not any("BDS" in line for line in lines)
    with BagReader(tmp_path / "bag") as reader:
        assert read_configuration(reader).fusion.array().n == 9
    run = offline.navigate(tmp_path / "bag", tmp_path / "again")
    result = run.score
    assert result["position_rms_m"] < 5.0 and result["samples"]["lost"] == 0
    assert [(f["isolated_right"], f["epochs_fused"]) for f in result["faults"]] == [(True, 0)]
    named = [s for s in result["sensors"] if s["first_change_s"] is not None]
    assert [(s["kind"], s["index"], s["state"], s["reason"]) for s in named] == [("gyro", 7, "isolated", "parity")]
    assert 40.0 <= named[0]["first_change_s"] < 41.0
    assert score_bag(tmp_path / "again")["sensors"] == result["sensors"]


def test_without_any_aid_and_reference_fusion_and_detection_run_alone(tmp_path):
    arrays = three_imus(whole=False)
    arrays["accel_1"][6000:] = arrays["accel_1"][6000]  # the whole IMU sticks
    lines = import_npz(save(tmp_path / "bare.npz", arrays), tmp_path / "bag")
    assert any("no initial state" in line for line in lines)
    result = offline.navigate(tmp_path / "bag", tmp_path / "again").score
    assert result["scored"] == "sensors" and result["epochs"] == 0 and result["duration_s"] == pytest.approx(85.0, abs=1.0)
    assert all(result[key] is None for key in ("position_rms_m", "heading_rms_arcmin", "nees_per_dof", "twin_deviation_max_m"))
    states = {f"{s['kind']}_{s['index']}": (s["state"], s["reason"]) for s in result["sensors"]}
    assert all(states[f"accel_{i}"] == ("isolated", "stuck") for i in (3, 4, 5))
    assert all(states[name] == ("healthy", "none") for name in states if name not in ("accel_3", "accel_4", "accel_5"))
    alone = score_bag(tmp_path / "again")
    assert alone["sensors"] == result["sensors"] and alone["scored"] == "sensors"


def test_a_hole_of_one_imu_takes_its_sensors_out_and_no_others(tmp_path):
    arrays = three_imus(whole=False)
    keep = (arrays["imu_t_2"] < 30.0) | (arrays["imu_t_2"] > 33.0)
    for name in ("imu_t_2", "gyro_2", "accel_2"):
        arrays[name] = arrays[name][keep]
    (piece,) = npz_recording.load(save(tmp_path / "hole.npz", arrays)).pieces
    assert not piece.sensors[2][(piece.t > 30.2) & (piece.t < 32.0), 6:].any() and piece.sensors[2][:, :6].all()


@pytest.mark.skipif(not (DATA / "quad4imu.npz").is_file(), reason="the recording with four IMUs is not on this machine (../shared/data/quad4imu.npz)")
def test_the_bad_gyro_of_the_recording_with_four_imus_is_found_at_once(tmp_path):
    lines = import_npz(DATA / "quad4imu.npz", tmp_path / "bag", options={"gps": {"enabled": False}})
    assert any("one source" in line and "withheld" in line for line in lines)
    result = offline.navigate(tmp_path / "bag").score
    bad = {f"{s['kind']}_{s['index']}": s for s in result["sensors"] if s["first_change_s"] is not None}
    assert bad["gyro_9"]["first_change_s"] < 0.2 and bad["gyro_9"]["state"] == "isolated"
    assert [name for name in bad if bad[name]["state"] == "isolated"] == ["gyro_9"]
    assert all(bad[name]["first_change_s"] > 10.0 for name in bad if name != "gyro_9")
    assert len(result["sensors"]) == 24
