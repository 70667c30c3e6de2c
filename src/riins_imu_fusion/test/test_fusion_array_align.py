"""Alignment of several IMUs in time: closed forms, the order of arrival, and what happens when one is silent, late or wrong about the time."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from riins_core.rotation import dcm_from_euler
from riins_core.settings import SettingError
from riins_imu_fusion.array_align import AlignedSample, ArrayAligner, Cause
from riins_imu_fusion.array_config import ArrayConfig, MountingConfig, noise_gains

START = 1_700_000_000_000_000_000
Event = tuple[int, int, np.ndarray, np.ndarray]  # IMU, stamp, rate, force


def stamps(rate_hz: float, seconds: float, phase_s: float = 0.0) -> np.ndarray:
    return START + np.round((phase_s + np.arange(round(seconds * rate_hz)) / rate_hz) * 1e9).astype(np.int64)


def events(imu: int, at: Iterable[int], rate: Callable[[float], np.ndarray], force: Callable[[float], np.ndarray]) -> list[Event]:
    return [(imu, int(t), rate((int(t) - START) * 1e-9), force((int(t) - START) * 1e-9)) for t in at]


def feed(aligner: ArrayAligner, given_events: Iterable[Event]) -> list[AlignedSample]:
    return [sample for imu, stamp, rate, force in given_events for sample in aligner.add(imu, stamp, rate, force)]


def by_stamp(*parts: list[Event]) -> list[Event]:
    return sorted(itertools.chain(*parts), key=lambda event: event[1])


def wobble(t: float) -> np.ndarray:
    return np.array([np.sin(7.0 * t), np.cos(5.0 * t), t % 0.3])


def same(a: list[AlignedSample], b: list[AlignedSample]) -> bool:
    def key(s: AlignedSample) -> tuple:
        return (*s[:2], s.gyro.tobytes(), s.accel.tobytes(), *s[4:])

    return [key(s) for s in a] == [key(s) for s in b]


# ---- what an output is ----


def test_a_constant_comes_out_as_it_is_to_the_last_bit() -> None:
    rate, force = np.array([0.1, -0.2, 0.3]), np.array([1 / 3, 0.7, 9.81])
    aligner = ArrayAligner(ArrayConfig(topics=("a",), imu_rate_hz=(130.0,), stuck_count=0))
    out = feed(aligner, events(0, stamps(130.0, 1.0, 0.0017), lambda t: rate, lambda t: force))
    assert len(out) > 90 and all(np.array_equal(s.gyro, rate) and np.array_equal(s.accel, force) for s in out)
    assert {s.stamp_ns % 10_000_000 for s in out} == {0} and np.all(np.diff([s.sequence for s in out]) == 1)


@pytest.mark.parametrize("imu_hz", [40.0, 90.0, 100.0, 250.0])
def test_a_sinusoid_against_its_mean_over_the_interval(imu_hz: float) -> None:
    w = 2.0 * np.pi * 2.0
    aligner = ArrayAligner(ArrayConfig(topics=("a",), imu_rate_hz=(imu_hz,)))
    out = feed(aligner, events(0, stamps(imu_hz, 3.0, 0.0013), lambda t: np.sin(w * t) * np.ones(3), lambda t: np.cos(w * t) * np.ones(3)))
    end = (np.array([s.stamp_ns for s in out]) - START) * 1e-9
    mean_sine = (np.cos(w * (end - 0.01)) - np.cos(w * end)) / (w * 0.01)
    mean_cosine = (np.sin(w * end) - np.sin(w * (end - 0.01))) / (w * 0.01)
    worst = max(np.abs([s.gyro[0] for s in out] - mean_sine).max(), np.abs([s.accel[2] for s in out] - mean_cosine).max())
    bound = (w / imu_hz) ** 2 / 8.0  # of linear interpolation
    assert 0.2 * bound < worst <= bound * (1.0 + 1e-9)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32), st.sampled_from([37.0, 100.0, 180.0]))
def test_every_piece_of_time_enters_one_output(seed: int, imu_hz: float) -> None:
    """No sample is used twice: the outputs add up to the trapezoidal integral of the samples, also with jitter and losses."""
    rng = np.random.default_rng(seed)
    at = stamps(imu_hz, 1.5, 0.003) + rng.integers(-2_000_000, 2_000_000, round(1.5 * imu_hz))
    at = at[(rng.random(at.size) > 0.05) | (np.arange(at.size) < 2)]
    values = rng.standard_normal((at.size, 6))
    aligner = ArrayAligner(ArrayConfig(topics=("a",), imu_rate_hz=(imu_hz,), bridge=20.0))
    out = feed(aligner, [(0, int(t), v[:3], v[3:]) for t, v in zip(at, values, strict=True)])
    assert len(out) > 50 and np.all(np.diff([s.stamp_ns for s in out]) == 10_000_000)
    begin, end = out[0].stamp_ns - 10_000_000, out[-1].stamp_ns
    knots = np.unique(np.concatenate([[begin, end], at[(at > begin) & (at < end)]]))
    for axis in range(6):
        y = np.interp((knots - begin).astype(float), (at - begin).astype(float), values[:, axis])
        total = np.sum(0.5 * np.diff(knots) * (y[1:] + y[:-1])) * 1e-9
        got = 0.01 * sum(np.concatenate([s.gyro, s.accel])[axis] for s in out)
        assert got == pytest.approx(total, abs=1e-12)


def test_specific_force_of_a_lever_arm() -> None:
    """Rotation about all axes, an IMU 1.3 m away and turned: at the common point nothing but gravity is left."""

    def rate(t: float) -> np.ndarray:
        return np.array([0.5 * np.sin(3 * t), 0.4 * np.cos(2 * t), 0.3 + 0.2 * np.sin(t)])

    def turning(t: float) -> np.ndarray:
        return np.array([1.5 * np.cos(3 * t), -0.8 * np.sin(2 * t), 0.2 * np.cos(t)])

    arm, rpy = np.array([1.0, -0.5, 0.7]), np.array([30.0, -10.0, 100.0])
    C = dcm_from_euler(*np.radians(rpy))

    def force(t: float) -> np.ndarray:
        return C.T @ (np.array([0.0, 0.0, 9.8]) + np.cross(turning(t), arm) + np.cross(rate(t), np.cross(rate(t), arm)))

    config = ArrayConfig(topics=("a",), imu_rate_hz=(200.0,), mounting_rpy_deg=tuple(rpy), lever_arm_m=tuple(arm))
    out = feed(ArrayAligner(config), events(0, stamps(200.0, 3.0, 0.001), lambda t: C.T @ rate(t), force))
    H = config.geometry()
    got = np.array([np.linalg.solve(H, s.accel) for s in out])
    size = np.abs([np.cross(turning(t), arm) + np.cross(rate(t), np.cross(rate(t), arm)) for t in np.arange(0, 3, 0.01)]).max()
    assert size > 1.0
    np.testing.assert_allclose(got, np.tile([0.0, 0.0, 9.8], (len(out), 1)), atol=2e-4 * size)
    end = (np.array([s.stamp_ns for s in out]) - START) * 1e-9
    np.testing.assert_allclose([np.linalg.solve(H, s.gyro) for s in out], [rate(t - 0.005) for t in end], atol=2e-4)


def test_a_clock_offset_is_taken_off() -> None:
    config = ArrayConfig(topics=("a", "b"), imu_rate_hz=(100.0,), clock_offset_s=(0.25, -0.1))
    parts = [[(i, t + round(o * 1e9), r, f) for _, t, r, f in events(i, stamps(100.0, 1.0), wobble, wobble)] for i, o in enumerate((0.25, -0.1))]
    out = feed(ArrayAligner(config), sorted(itertools.chain(*parts), key=lambda e: e[1] - round(config.clock_offset_s[e[0]] * 1e9)))
    assert len(out) > 90 and all(np.array_equal(s.gyro[:3], s.gyro[3:]) and s.gyro_valid == 63 for s in out)


@pytest.mark.parametrize("imu_hz", [60.0, 100.0, 333.0])
def test_noise_of_an_output_is_as_said(imu_hz: float) -> None:
    """At random places among the samples; with a lever arm the difference of gyro values adds to the force."""
    rng, n = np.random.default_rng(3), round(60.0 * imu_hz)
    config = ArrayConfig(topics=("a",), imu_rate_hz=(imu_hz,), rate_hz=97.0, gyro_sigma=(2e-3,), accel_sigma=(5e-3,), lever_arm_m=(0.0, 0.5, 0.0))
    aligner = ArrayAligner(config)
    at = stamps(imu_hz, 60.0, 0.001)
    noise = np.hstack([2e-3 * rng.standard_normal((n, 3)), 5e-3 * rng.standard_normal((n, 3))])
    out = feed(aligner, [(0, int(t), v[:3], v[3:]) for t, v in zip(at, noise, strict=True)])
    got = np.concatenate([np.std([s.gyro for s in out], axis=0), np.std([s.accel for s in out], axis=0)])
    np.testing.assert_allclose(got, config.sigma().ravel(), rtol=0.06)
    assert config.sigma()[1, 0] > 1.5 * config.sigma()[1, 1]  # the lever arm lies along y


def test_noise_gains_at_their_limits() -> None:
    np.testing.assert_allclose(noise_gains(1e-3), (2 / 3, 2e-6), rtol=1e-3)
    np.testing.assert_allclose(noise_gains(1.0), (11 / 20, 1.0), rtol=1e-3)
    np.testing.assert_allclose(noise_gains(200.0), (1 / 200, 4 / 3), rtol=1e-2)


# ---- order of arrival ----


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32))
def test_the_order_of_arrival_does_not_matter(seed: int) -> None:
    """Delays up to max_wait, also within one IMU, with losses, a silence and a late start: the same outputs, bit for bit."""
    rng = np.random.default_rng(seed)
    rates = (100.0, 60.0, 180.0)
    parts = []
    for i, hz in enumerate(rates):
        at = stamps(hz, 2.5, rng.uniform(0.0, 0.5 if i == 2 else 0.01)) + rng.integers(-500_000, 500_000, round(2.5 * hz))
        at = at[rng.random(at.size) > 0.03]
        if i == 1:
            quiet = START + int(rng.uniform(0.3, 1.5) * 1e9)
            at = at[(at < quiet) | (at > quiet + int(rng.uniform(0.01, 0.6) * 1e9))]
        parts.append(events(i, at, wobble, lambda t: 9.8 * wobble(t)))
    in_order = by_stamp(*parts)
    config = ArrayConfig(imu_rate_hz=rates, lever_arm_m=(0.0,) * 6 + (0.3, 0.1, -0.2), max_wait_s=0.05)
    reference = ArrayAligner(config)
    expected = feed(reference, in_order)
    delay = rng.uniform(0.0, 50e6, len(in_order))
    shuffled = [in_order[k] for k in np.argsort([event[1] - START + d for event, d in zip(in_order, delay, strict=True)], kind="stable")]
    other = ArrayAligner(config)
    assert same(feed(other, shuffled), expected) and len(expected) > 200
    counts = [[{**s.counts, Cause.LATE: 0} for s in aligner.streams] for aligner in (other, reference)]
    assert counts[0] == counts[1]  # but for a straggler from before a return: late, and not needed


def test_an_output_comes_as_soon_as_all_have_passed_its_end() -> None:
    aligner = ArrayAligner(ArrayConfig(topics=("a", "b"), imu_rate_hz=(100.0,)))
    whole = by_stamp(*(events(i, stamps(100.0, 1.0, 0.001 + 0.002 * i), wobble, wobble) for i in range(2)))
    for event in whole:
        out = feed(aligner, [event])
        if event[1] > START + 500_000_000 and out:
            assert [s.stamp_ns for s in out] == [event[1] // 10_000_000 * 10_000_000] and event[0] == 1


# ---- what is wrong with an IMU ----


def test_a_silent_imu_is_waited_for_once_and_comes_back() -> None:
    """Others are never held up by more than `hold_s`; while it is silent, not at all; a gap within the bridge is interpolated."""
    at = stamps(100.0, 4.0, 0.003)
    gone = at[(at < START + 1_000_000_000) | (at > START + 2_000_000_000)]
    lost_one = np.delete(gone, np.searchsorted(gone, START + 3_003_000_000))
    aligner = ArrayAligner(ArrayConfig(topics=("a", "b"), imu_rate_hz=(100.0,)))
    out, waited = [], {}
    for event in by_stamp(events(0, at, wobble, wobble), events(1, lost_one, wobble, wobble)):
        for sample in feed(aligner, [event]):
            out.append(sample)
            waited[(sample.stamp_ns - START) // 10_000_000] = (event[1] - sample.stamp_ns) * 1e-9
    valid = {(s.stamp_ns - START) // 10_000_000: s.gyro_valid for s in out}
    assert aligner.hold_s == pytest.approx(0.075) and max(waited.values()) <= 0.086
    assert all(valid[k] == 63 for k in range(2, 100)) and all(valid[k] == 7 for k in range(101, 200))
    assert all(valid[k] == 63 for k in range(208, 390))  # back after max_wait; one lost sample is bridged
    assert max(waited[k] for k in range(110, 200)) < 0.011
    silent = aligner.streams[1].counts
    assert 99 <= silent[Cause.SILENT] <= 110 and silent[Cause.GAP] <= 2 and aligner.empty <= 1


def test_duplicates_stamps_back_and_values_that_are_not_finite() -> None:
    config = ArrayConfig(topics=("a", "b"), imu_rate_hz=(100.0,), lever_arm_m=(0.0, 0.0, 0.0, 0.1, 0.0, 0.0))
    parts = [events(i, stamps(100.0, 1.0, 0.003), wobble, wobble) for i in range(2)]
    parts[0].append(parts[0][50])  # heard again
    parts[0].append((0, parts[0][20][1] + 3, np.full(3, 1e6), np.zeros(3)))
    parts[1][40] = (1, parts[1][40][1], np.array([0.0, np.nan, 0.0]), parts[1][40][3])
    parts[0][60] = (0, parts[0][60][1], parts[0][60][2], np.array([0.0, 0.0, np.inf]))
    reference = feed(ArrayAligner(config), by_stamp(*([e for e in part if np.isfinite([*e[2], *e[3]]).all() and e[2][0] < 9] for part in parts)))
    aligner = ArrayAligner(config)
    head = by_stamp(parts[0][:100], parts[1])
    at = head.index(parts[0][50])
    out = feed(aligner, [*head[: at + 1], parts[0][100], *head[at + 1 :], parts[0][101]])
    counts = aligner.streams[0].counts
    assert counts[Cause.DUPLICATE] + counts[Cause.LATE] == 2 and counts[Cause.LATE] >= 1
    got = {(s.stamp_ns - START) // 10_000_000: s for s in out}
    nan, infinite = got[41], got[61]
    assert nan.gyro_valid == 63 - (1 << 4) and nan.gyro[4] == 0.0 and nan.accel_valid == 7  # the lever arm needs all gyros
    assert infinite.gyro_valid == 63 and infinite.accel_valid == 63 - (1 << 2)
    assert all(s.gyro_valid == s.accel_valid == 63 for k, s in got.items() if k not in (40, 41, 42, 60, 61, 62))
    assert np.array_equal(got[30].accel, {(s.stamp_ns - START) // 10_000_000: s for s in reference}[30].accel)


def test_a_stuck_axis_is_not_valid() -> None:
    def held(t: float) -> np.ndarray:
        return wobble(t) if t < 0.5 else np.append(wobble(t)[:2], 0.125)

    out = feed(ArrayAligner(ArrayConfig(topics=("a",), imu_rate_hz=(200.0,), stuck_count=20)), events(0, stamps(200.0, 1.0), held, wobble))
    stuck = [(s.stamp_ns - START) * 1e-9 for s in out if not s.gyro_valid & 4]
    assert stuck and 0.59 <= min(stuck) <= 0.61 and len(stuck) > 30 and all(s.gyro_valid & 3 == 3 and s.accel_valid == 7 for s in out)


@pytest.mark.parametrize("jump_s", [-30.0, -0.5, 0.4, 30.0])
def test_a_clock_that_jumps_costs_its_own_imu_alone(jump_s: float) -> None:
    aligner = ArrayAligner(ArrayConfig(imu_rate_hz=(100.0,)))
    plan = by_stamp(*(events(i, stamps(100.0, 3.0, 0.003 + 0.001 * i), wobble, wobble) for i in range(3)))
    jumped = [(i, t + round(jump_s * 1e9) * (i == 1 and t > START + 1_000_000_000), r, f) for i, t, r, f in plan]
    out = feed(aligner, jumped)
    assert np.all(np.diff([s.stamp_ns for s in out]) == 10_000_000) and out[-1].stamp_ns >= START + 2_900_000_000
    assert all(s.gyro_valid == (0b111111111 if s.stamp_ns < START + 1_000_000_000 else 0b111000111) for s in out if s.stamp_ns > START + 20_000_000)
    assert aligner.streams[1].counts[Cause.CLOCK] + aligner.streams[1].counts[Cause.LATE] >= 190 and aligner.restarts == 0


def test_which_of_two_clocks_is_ahead_does_not_stop_the_other() -> None:
    aligner = ArrayAligner(ArrayConfig(topics=("a", "b"), imu_rate_hz=(100.0,)))
    plan = by_stamp(*(events(i, stamps(100.0, 3.0, 0.003 + 0.001 * i), wobble, wobble) for i in range(2)))
    for jump, alive in ((50.0, 0b000111), (-50.0, 0b000111)):
        aligner = ArrayAligner(ArrayConfig(topics=("a", "b"), imu_rate_hz=(100.0,)))
        out = feed(aligner, [(i, t + round(jump * 1e9) * (i == 1 and t > START + 10**9), r, f) for i, t, r, f in plan])
        assert {s.gyro_valid for s in out if s.stamp_ns > START + 1_200_000_000} == {alive} and out[-1].stamp_ns >= START + 2_900_000_000


def test_the_last_imu_alive_goes_on_and_a_loop_restarts() -> None:
    aligner = ArrayAligner(ArrayConfig(imu_rate_hz=(100.0,)))
    first = by_stamp(*(events(i, stamps(100.0, 3.0 if i == 0 else 1.0, 0.003), wobble, wobble) for i in range(3)))
    out = feed(aligner, first)
    assert out[-1].stamp_ns >= START + 2_900_000_000 and out[-1].gyro_valid == 7 and np.all(np.diff([s.stamp_ns for s in out]) == 10_000_000)
    again = feed(aligner, first)
    assert aligner.restarts == 1
    fresh = feed(ArrayAligner(ArrayConfig(imu_rate_hz=(100.0,))), first)
    assert same(again[-200:], fresh[-200:]) and len(again) > len(fresh) - 30


def test_a_pause_of_all_gives_nothing_and_loses_no_time() -> None:
    aligner = ArrayAligner(ArrayConfig(topics=("a", "b"), imu_rate_hz=(100.0,)))
    plan = by_stamp(*(events(i, stamps(100.0, 2.0, 0.003), wobble, wobble) for i in range(2)))
    plan = [(i, t + 3_600_000_000_000 * (t > START + 10**9), r, f) for i, t, r, f in plan]
    out = feed(aligner, plan)
    steps = np.diff([s.stamp_ns for s in out])
    assert np.sum(steps > 10_000_000) == 1 and len(out) > 180 and out[-1].gyro_valid == 63
    assert aligner.empty == pytest.approx(360_000, abs=20)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"topics": ()}, "1 to 16"),
        ({"topics": ("a", "a")}, "different"),
        ({"imu_rate_hz": (100.0, 50.0)}, "imu_rate_hz"),
        ({"lever_arm_m": (1.0, 2.0)}, "lever_arm_m"),
        ({"topics": ("a",), "mounting_quaternion": (1.0, 1.0, 0.0, 0.0)}, "unit length"),
        ({"topics": ("a",), "mounting_quaternion": (0.0, 0.0, 0.0, 1.0), "mounting_rpy_deg": (0.0, 0.0, 0.0)}, "one of them"),
    ],
)
def test_settings_that_do_not_fit_are_refused_in_one_line(wrong: dict, words: str) -> None:
    with pytest.raises(SettingError, match=words):
        ArrayConfig(**wrong)


def test_geometry_is_that_of_a_static_transform() -> None:
    config = ArrayConfig(topics=("a", "b"), mounting_rpy_deg=(0.0, 0.0, 90.0, 180.0, 0.0, 0.0), mounting=MountingConfig(estimate=False))
    np.testing.assert_allclose(config.geometry(), [[0, 1, 0], [-1, 0, 0], [0, 0, 1], [1, 0, 0], [0, -1, 0], [0, 0, -1]], atol=1e-15)
    quaternion = ArrayConfig(topics=("a", "b"), mounting_quaternion=(0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5), 1.0, 0.0, 0.0, 0.0))
    np.testing.assert_allclose(quaternion.geometry(), config.geometry(), atol=1e-15)
