"""Heave: the filter against its frequency response, a ship in waves against the usual 5 cm or 5 %, and the laws.

Lives here: heave.py and motion.py with riins_sim's ship and the real navigator.
Does not live here: the node (test_nmea_node.py).
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from riins_nmea.heave import SETTLING_PERIODS, HeaveFilter, drift_gain, transfer
from riins_nmea.motion import COASTING, DOUBTFUL, INVALID, NAVIGATING, VALID, MotionConfig, MotionEstimator
from riins_sim.scenario import from_yaml
from riins_sim.trajectory import Trajectory

DT = 20_000_000
SEA = """
name: sea
seed: {seed}
duration_s: {duration}
imu_rate_hz: 50
start: {{latitude_deg: 40.0, longitude_deg: 120.0, height_m: 5.0, speed_kn: 10.0, heading_deg: 60.0}}
legs: [{{straight_s: 200.0}}, {{turn_deg: 90.0, rate_deg_s: 1.0}}]
sea: {{significant_wave_height_m: {height}, peak_period_s: {period}, direction_deg: 80.0}}
vessel: {{length_m: {length}}}
"""


def states(trajectory: Trajectory, sigma_velocity: float = 0.002):
    """True navigation states at the IMU rate."""
    t = np.arange(1, trajectory.samples + 1) * trajectory.dt
    truth = trajectory.truth(t)
    rph = [
        np.arctan2(truth.C_nb[:, 2, 1], truth.C_nb[:, 2, 2]),
        -np.arcsin(truth.C_nb[:, 2, 0]),
        np.arctan2(truth.C_nb[:, 1, 0], truth.C_nb[:, 0, 0]),
    ]
    step = round(trajectory.dt * 1e9)
    fixed = {"mode": NAVIGATING, "validity": (0, 0, 0), "sigma_rph": np.full(3, 1e-4), "sigma_velocity": np.full(3, sigma_velocity), "reset_count": 0}
    made = [
        {"stamp_ns": (k + 1) * step, "h": h, "v_n": v, "rph": np.array(a), "rate_b": w, **fixed}
        for k, (h, v, a, w) in enumerate(zip(truth.h, truth.v_n, zip(*rph, strict=True), truth.rate_nb_b, strict=True))
    ]
    return made, truth


def calm(seconds: float, **changes):
    """States of a ship that heaves 1 m at 8 s, from a formula."""
    made = []
    for k in range(1, round(seconds * 50) + 1):
        t = k * DT * 1e-9
        w = 2 * math.pi / 8.0
        state = {
            "stamp_ns": k * DT,
            "mode": NAVIGATING,
            "validity": (0, 0, 0),
            "h": 7.0 + math.sin(w * t),
            "v_n": np.array([5.0, 0.0, -w * math.cos(w * t)]),
            "rph": np.zeros(3),
            "rate_b": np.zeros(3),
            "sigma_rph": np.full(3, 1e-4),
            "sigma_velocity": np.full(3, 0.002),
            "reset_count": 0,
        }
        made.append({**state, **changes})
    return made


@pytest.mark.parametrize("period", [3.0, 5.0, 8.0, 12.0, 16.0, 20.0])
def test_amplitude_and_phase_of_a_wave(period: float) -> None:
    """One sinusoid through the filter: gain and phase are those of the transfer function, and within 5 % of the wave itself."""
    cutoff, w = 80.0, 2.0 * math.pi / period
    one = HeaveFilter(cutoff)
    one.start(w)
    t = np.arange(1, round((300.0 + 10 * period) * 50) + 1) * DT * 1e-9
    out = np.array([one.step(DT, w * math.cos(w * s)) for s in t])  # displacement sin(w t)
    late = t > 300.0
    basis = np.column_stack([np.sin(w * t), np.cos(w * t)])[late]
    (a, b), *_ = np.linalg.lstsq(basis, out[late, 0], rcond=None)
    expected = transfer(period, cutoff)
    # velocity linear between samples loses (w dt)^2 / 12 of the amplitude
    assert complex(a, b) == pytest.approx(expected, abs=1e-3 + (w * DT * 1e-9) ** 2 / 12)
    assert abs(complex(a, b) - 1.0) < 0.05 and abs(math.degrees(np.angle(complex(a, b)))) < 2.5
    (c, d), *_ = np.linalg.lstsq(basis, out[late, 1], rcond=None)
    assert complex(c, d) == pytest.approx(1j * w * expected, abs=2e-3 * w)


def test_without_the_correction_it_would_be_a_fifth_out() -> None:
    """The plain filter of the same cut-off and the corrected one at 10 s; what is left falls with the third power of the period."""
    s = 1j * 80.0 / 10.0
    plain = s**2 / (s**2 + math.sqrt(2.0) * s + 1.0)
    assert abs(plain - 1.0) > 0.15 and abs(transfer(10.0, 80.0) - 1.0) < 0.006
    assert abs(transfer(4.0, 80.0) - 1.0) / abs(transfer(2.0, 80.0) - 1.0) == pytest.approx(8.0, rel=0.05)


def test_a_new_mean_level_is_forgotten() -> None:
    """A step of the level is below 1 % after SETTLING_PERIODS for good; a constant velocity error gives no heave, a drifting one drift_gain."""
    one = HeaveFilter(30.0)
    one.step(DT, 1.0 / (DT * 1e-9))  # a triangle of area 1 m
    after = np.array([one.step(DT, 0.0)[0] for _ in range(round(4 * 30.0 * 50))])
    assert np.abs(after[round(SETTLING_PERIODS * 30.0 * 50) :]).max() < 0.01 and np.abs(after[round(1.5 * 30.0 * 50) :]).max() > 0.01
    level = HeaveFilter(30.0)
    assert abs([level.step(DT, 0.3) for _ in range(20000)][-1][0]) < 1e-6
    rng, tau = np.random.default_rng(5), 50.0
    e, found, fine = 0.0, [], HeaveFilter(30.0)
    for _ in range(60000):
        e += -e / tau * 0.1 + math.sqrt(2.0 * 0.1 / tau) * rng.standard_normal()
        found.append(fine.step(100_000_000, e))
    np.testing.assert_allclose(np.std(found[5000:], axis=0), drift_gain(30.0, tau), rtol=0.12)


@pytest.mark.parametrize(
    ("height", "period", "length", "point"),
    [(4.0, 9.0, 60.0, (0.0, 0.0, 0.0)), (2.0, 6.0, 20.0, (15.0, 0.0, -6.0)), (6.0, 14.0, 60.0, (30.0, 0.0, 2.0))],
)
def test_a_ship_in_waves_within_5_cm_or_5_percent(height, period, length, point) -> None:
    """RMS error of valid heave at a point, in three seas with a turn, the states being true: what the filter alone does.

    The points are amidships and the sea is met: the heel of a turn, off the middle line, and a sea that the ship runs with at its own speed move the
    mean level of the point, which only time tells from heave.
    """
    trajectory = Trajectory(from_yaml(SEA.format(seed=3, duration=330, height=height, period=period, length=length)))
    given, truth = states(trajectory)
    estimator = MotionEstimator(MotionConfig(point_m=point, max_gap_s=0.5))
    out = [estimator.add(one) for one in given]
    level = truth.h - truth.C_nb[:, 2] @ np.array(point)
    valid = np.array([m.heave_validity == VALID for m in out])
    assert valid[-1] and not valid[: round(SETTLING_PERIODS * 80.0 * 50)].any()
    heave, true = np.array([m.heave for m in out])[valid], (level - level.mean())[valid]
    error = heave - true - np.mean(heave - true)
    assert true.std() > 0.15 and error.std() < max(0.05, 0.05 * true.std())
    rate = np.array([m.heave_velocity for m in out])[valid]
    down = truth.v_n[:, 2] + np.einsum("ij,ij->i", truth.C_nb[:, 2], np.cross(truth.rate_nb_b, point))
    assert np.std(rate + down[valid]) < max(0.02, 0.05 * np.std(down[valid]))
    sigma = np.array([m.sigma_heave for m in out])[valid]
    assert np.sqrt(np.mean((error / sigma) ** 2)) < 2.0


def test_the_error_is_what_its_sigma_says() -> None:
    """Velocity errors as the navigator has them, slow and of its own sigma: heave is out by its sigma, and doubtful while that is too large."""
    given = calm(500.0)
    rng, errors, tau = np.random.default_rng(2), [], 300.0
    config = MotionConfig(velocity_error_time_s=tau)
    for sigma, wanted in ((0.004, VALID), (0.04, DOUBTFUL)):
        for _ in range(2):
            estimator, e = MotionEstimator(config), sigma * rng.standard_normal()
            for state in given[::2]:
                e += -e / tau * 0.04 + sigma * math.sqrt(2.0 * 0.04 / tau) * rng.standard_normal()
                v = state["v_n"] + np.array([0.0, 0.0, e])
                motion = estimator.add({**state, "v_n": v, "sigma_velocity": np.full(3, sigma)})
                if motion.heave_validity != INVALID:
                    assert motion.heave_validity == wanted
                    errors.append((motion.heave - math.sin(2 * math.pi / 8.0 * state["stamp_ns"] * 1e-9)) / motion.sigma_heave)
    assert 0.3 < np.sqrt(np.mean(np.square(errors))) < 2.0


def test_euler_rates_are_derivatives() -> None:
    trajectory = Trajectory(from_yaml(SEA.format(seed=4, duration=20, height=5.0, period=7.0, length=30.0)))
    given, _ = states(trajectory)
    out = [MotionEstimator(MotionConfig()).add(one) for one in given]
    rph = np.unwrap([m.rph for m in out], axis=0)
    np.testing.assert_allclose((rph[2:] - rph[:-2]) / (2.0 * trajectory.dt), [m.rph_rate for m in out[1:-1]], atol=2e-4)


def test_heave_is_invalid_until_settled_and_anew_after_what_breaks_it() -> None:
    """A gap, a jump back, no navigation, a reset that moves the height: each is counted and heave is invalid until it has settled again."""
    given = calm(300.0)
    first = int(SETTLING_PERIODS * 80.0 * 50)
    breaks = {
        "gap": lambda k, s: {**s, "stamp_ns": s["stamp_ns"] + 2_000_000_000 * (k >= 10_000)},
        "stamp jumped back": lambda k, s: {**s, "stamp_ns": s["stamp_ns"] - 2_000_000_000 * (k >= 10_000)},
        "no navigation": lambda k, s: {**s, "mode": 4 if k == 10_000 else COASTING},
        "reset": lambda k, s: {**s, "reset_count": int(k >= 10_000), "h": s["h"] - 0.3 * (k >= 10_000)},
    }
    for reason, change in breaks.items():
        estimator = MotionEstimator(MotionConfig())
        validity = [estimator.add(change(k, s)).heave_validity for k, s in enumerate(given[:12_000])]
        assert set(validity[: first - 1]) == {INVALID} and set(validity[first + 10 : 9_990]) == {VALID} and set(validity[10_000:]) == {INVALID}
        assert estimator.restarts == {**dict.fromkeys(estimator.restarts, 0), reason: 1}
    estimator = MotionEstimator(MotionConfig())
    harmless = [estimator.add({**s, "reset_count": int(k >= 10_000)}) for k, s in enumerate(given[:12_000])]  # the reset of another state
    assert harmless[-1].heave_validity == VALID and not any(estimator.restarts.values())


def test_a_fault_taken_out_by_the_navigator_is_out_of_heave() -> None:
    """An accelerometer pulls the velocity for 3 s, the navigator takes it out with a reset: what it put in does not stay in heave as valid."""
    given, estimator = calm(260.0), MotionEstimator(MotionConfig())
    for k, state in enumerate(given):
        t = max(0, k - 10_000) * DT * 1e-9
        bad = k >= 10_000 and t < 3.0
        pulled = {"v_n": state["v_n"] - np.array([0.0, 0.0, t]), "h": state["h"] + 0.5 * t * t} if bad else {}
        motion = estimator.add({**state, **pulled, "reset_count": int(k >= 10_000 and not bad)})
        if motion.heave_validity != INVALID and not bad:
            assert motion.heave == pytest.approx(math.sin(2 * math.pi / 8.0 * state["stamp_ns"] * 1e-9), abs=0.03)
    assert estimator.restarts["reset"] == 1


def test_results_depend_on_stamps_alone() -> None:
    """Samples twice or late are dropped and counted and change no bit; another sample interval gives the same heave."""
    given = calm(60.0)
    plain, disturbed, coarse = (MotionEstimator(MotionConfig(cutoff_period_s=20.0)) for _ in range(3))
    wanted = [plain.add(one) for one in given]
    got = []
    for k, one in enumerate(given):
        got.append(disturbed.add(one))
        assert disturbed.add(one) is None and (k == 0 or disturbed.add(given[k - 1]) is None)
    assert got == wanted and disturbed.dropped == 2 * len(given) - 1
    ragged = [coarse.add(one) for k, one in enumerate(given) if k % 5 != 2]
    assert ragged[-1].heave == pytest.approx(wanted[-1].heave, abs=2e-3)
