"""The fusion pipeline: estimates, isolation and return, statuses, settings, and that no result depends on the block size."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from fusion_feed import ALL, CONFIG, DT, FORCE, RATE, SHORT, Feed, changes, exact, in_use, state
from hypothesis import given, settings
from hypothesis import strategies as st

from riins_core.sensor_errors import normal
from riins_core.settings import SettingError, build
from riins_fdi.health import HealthState
from riins_fdi.parity import Capability
from riins_imu_fusion.config import FusionConfig
from riins_imu_fusion.pipeline import FusionPipeline
from riins_imu_fusion.types import Counters, Reason, join


def test_healthy_sensors_give_least_squares_with_the_stated_covariance() -> None:
    feed, pipeline = Feed(40_000), FusionPipeline(CONFIG)
    block = feed.into(pipeline)
    assert len(block) == 40_000 and np.all(block.gyro_used == ALL) and np.all(block.accel_used == ALL)
    np.testing.assert_allclose(block.rate, feed.gyro @ pipeline.array.least_squares().T, rtol=0, atol=1e-16)
    np.testing.assert_allclose(np.cov(block.rate.T), pipeline.rate_covariance(ALL), rtol=0, atol=0.03 * feed.sigma[0, 0] ** 2)
    np.testing.assert_allclose(np.cov(block.force.T), pipeline.force_covariance(ALL), rtol=0, atol=0.03 * feed.sigma[1, 0] ** 2)
    np.testing.assert_allclose(pipeline.rate_covariance(ALL), np.eye(3) * feed.sigma[0, 0] ** 2 / 2, atol=1e-20)
    assert block.gyro_statistic.mean() == pytest.approx(3.0, rel=0.03) and block.accel_statistic.var() == pytest.approx(6.0, rel=0.08)
    assert pipeline.counters == Counters(40_000, 40_000, 0, 0, 0, 0, 0, 0) and not pipeline.drain_events()


def test_unequal_sensors_are_weighted() -> None:
    config = replace(CONFIG, gyro_sigma=tuple(1e-5 * np.array([1.0, 2.0, 1.0, 4.0, 1.0, 3.0])))
    pipeline, feed = FusionPipeline(config), Feed(50, config)
    expected = feed.gyro @ pipeline.array.least_squares(None, np.array(config.gyro_sigma)).T
    np.testing.assert_allclose(feed.into(pipeline).rate, expected, rtol=0, atol=1e-16)


@pytest.mark.parametrize("kind", ["gyro", "accel"])
def test_a_lying_sensor_leaves_at_once_and_returns_after_probation(kind: str) -> None:
    feed, pipeline = Feed(1000), FusionPipeline(CONFIG)
    getattr(feed, kind)[300:500, 4] += 50.0 * feed.sigma[0 if kind == "gyro" else 1, 0]
    block = feed.into(pipeline)
    used = in_use(getattr(block, f"{kind}_used"), 4)
    assert used[:300].all() and not used[300:500].any()  # law 4: not one faulty sample enters
    fused, truth = (block.rate, RATE) if kind == "gyro" else (block.force, FORCE)
    clean = replace(CONFIG, method="wls")
    bare = getattr(feed.into(FusionPipeline(clean)), "rate" if kind == "gyro" else "force")
    np.testing.assert_allclose(bare[350], clean.array().least_squares(ALL & ~16) @ getattr(feed, kind)[350], rtol=0, atol=1e-14)
    assert np.abs(fused - truth).max() < 6.0 * feed.sigma[0 if kind == "gyro" else 1, 0]
    events = pipeline.drain_events()
    assert [(e.kind, e.index, e.state, e.reason) for e in events] == [
        (kind, 4, HealthState.SUSPECT, Reason.PARITY),
        (kind, 4, HealthState.ISOLATED, Reason.PARITY),
        (kind, 4, HealthState.PROBATION, Reason.PARITY),
        (kind, 4, HealthState.HEALTHY, Reason.RECOVERED),
    ]
    # the fault ends at sample 501, after the hold; probation begins there and lasts a second
    assert [e.stamp_ns // DT for e in events] == [301, 303, 501, 601]
    assert np.flatnonzero(~used)[-1] == 600 and used[601:].all()
    other = block.accel_used if kind == "gyro" else block.gyro_used
    assert np.all(other == ALL)


def test_a_slow_ramp_isolates_once_without_flapping() -> None:
    """The ramp of the harbour voyage in sigma: it crosses the threshold now and then, long before it stays above."""
    config = FusionConfig(method="wls")
    for seed in range(5):
        feed, pipeline = Feed(2000, config, seed), FusionPipeline(config)
        feed.gyro[:, 2] += 16.0 * feed.sigma[0, 0] * np.arange(2000) / 2000
        feed.into(pipeline)
        events = pipeline.drain_events()
        first = next(i for i, e in enumerate(events) if e.state is HealthState.ISOLATED)
        assert events[first].index == 2 and 500 < events[first].stamp_ns // DT < 1200 and first <= 4
        assert {e.index for e in events if e.state is HealthState.ISOLATED} == {2}


def test_a_slow_ramp_is_compensated_long_before_it_is_isolated() -> None:
    """The same ramp with the default: found at a tenth of the threshold of one sample, isolated at its limit, and nobody else is touched."""
    config = FusionConfig()
    for seed in range(5):
        feed, pipeline = Feed(2000, config, seed), FusionPipeline(config)
        feed.gyro[:, 2] += 16.0 * feed.sigma[0, 0] * np.arange(2000) / 2000
        feed.into(pipeline)
        events = [e for e in pipeline.drain_events() if e.kind == "gyro" and e.index >= 0]
        assert {e.index for e in events} == {2}
        declared = {e.state: e.stamp_ns // DT for e in reversed(events)}
        assert declared[HealthState.COMPENSATED] < 500 and 1000 < declared[HealthState.ISOLATED] < 1500


def test_probation_fails_when_the_fault_comes_back_and_the_hold_grows() -> None:
    feed, pipeline = Feed(1500), FusionPipeline(CONFIG)
    feed.gyro[100:200, 0] += 1e-3
    feed.gyro[250, 0] += 1e-3
    feed.into(pipeline)
    times = [(e.state.name, e.stamp_ns // DT) for e in pipeline.drain_events()]
    assert times == [("SUSPECT", 101), ("ISOLATED", 103), ("PROBATION", 201), ("ISOLATED", 251), ("PROBATION", 351), ("HEALTHY", 451)]


def test_a_small_lasting_fault_does_not_pass_probation() -> None:
    """Two sigma is far below the threshold of one sample; the mean over the probation shows it."""
    feed, pipeline = Feed(1000), FusionPipeline(CONFIG)
    feed.gyro[100:150, 2] += 1e-3
    feed.gyro[150:, 2] += 2.0 * feed.sigma[0, 0]
    block = feed.into(pipeline)
    events = pipeline.drain_events()
    assert not in_use(block.gyro_used, 2)[100:].any()
    assert any("mean residual +1." in e.text and e.state is HealthState.ISOLATED for e in events)


def test_two_faults_in_sequence_leave_four_that_detect() -> None:
    feed, pipeline = Feed(800), FusionPipeline(replace(CONFIG, health=replace(SHORT, hold_s=100.0)))
    feed.gyro[100:, 1] += 1e-3
    feed.gyro[200:, 5] -= 2e-3
    block = feed.into(pipeline, 0, 400)
    assert np.all(block.gyro_used[202:] == 0b011101) and changes(pipeline)[1::2] == [("gyro", 1, "ISOLATED", 1), ("gyro", 5, "ISOLATED", 1)]
    status = pipeline.status().gyro
    assert status.capability is Capability.DETECTS and status.dof == 1 and status.parity.shape == (1,) and not status.doubtful
    assert status.threshold == pytest.approx(26.38, abs=0.1)  # chi-square(1) at 2.8e-7
    # a third fault is seen; nobody can say whose it is: all four stay, in doubt
    feed.gyro[400:500, 3] += 2e-3
    block = feed.into(pipeline, 400, 500)
    assert np.all(block.gyro_used == 0b011101) and np.all(block.gyro_statistic > status.threshold)
    status = pipeline.status().gyro
    assert status.doubtful and status.detected and status.suspect == -1 and status.state[3] == HealthState.HEALTHY
    assert [e.text for e in pipeline.drain_events()] == ["gyro doubtful: a fault is seen but not isolated, these sensors detect only"]
    feed.into(pipeline, 500)
    assert not pipeline.status().gyro.doubtful and [e.stamp_ns // DT for e in pipeline.drain_events()] == [601]


def test_three_left_have_no_test() -> None:
    feed, pipeline = Feed(100), FusionPipeline(CONFIG)
    for sensor in (0, 2, 4):
        pipeline.set_sensor_use(f"accel_{sensor}", False)
    feed.accel[50:, 1] += 1.0
    block = feed.into(pipeline)
    status = pipeline.status().accel
    assert np.all(block.accel_used == 0b101010) and np.isnan(block.accel_statistic).all()
    assert status.capability is Capability.NEITHER and np.isnan(status.threshold) and status.dof == 0 and not status.detected
    np.testing.assert_allclose(block.force[10], np.linalg.solve(pipeline.array.H[[1, 3, 5]], feed.accel[10, [1, 3, 5]]), rtol=1e-12)


def test_unequal_simultaneous_faults_are_both_isolated() -> None:
    feed, pipeline = Feed(200), FusionPipeline(CONFIG)
    feed.gyro[100:, 0] += 60.0 * feed.sigma[0, 0]
    feed.gyro[100:, 3] += 25.0 * feed.sigma[0, 0]
    block = feed.into(pipeline)
    assert not in_use(block.gyro_used, 0)[100:].any() and not in_use(block.gyro_used, 3)[100:].any()
    assert [state(pipeline, i) for i in (0, 3)] == [HealthState.ISOLATED] * 2
    assert sum(s != 0 for s in pipeline.status().gyro.state) == 2


def test_equal_simultaneous_faults_are_ambiguous_and_isolate_nobody() -> None:
    feed, pipeline = Feed(300), FusionPipeline(CONFIG)
    feed.gyro[100:, 0] += 40.0 * feed.sigma[0, 0]
    feed.gyro[100:, 1] -= 40.0 * feed.sigma[0, 0]
    feed.into(pipeline)
    status = pipeline.status().gyro
    assert status.doubtful and status.detected and sum(s in (HealthState.ISOLATED, HealthState.PROBATION) for s in status.state) == 0
    assert any("more than one pair" in e.text for e in pipeline.drain_events())


def test_orthogonal_pairs_detect_and_keep_all() -> None:
    config = replace(CONFIG, configuration="orthogonal")
    feed, pipeline = Feed(200, config), FusionPipeline(config)
    feed.gyro[100:, 3] += 1e-3
    block = feed.into(pipeline)
    status = pipeline.status().gyro
    assert np.all(block.gyro_used == ALL) and status.capability is Capability.DETECTS and status.doubtful and status.suspect == -1


def test_ordinary_biases_do_not_alarm_with_their_prior() -> None:
    base = replace(CONFIG, false_alarm_probability=1e-3, health=replace(SHORT, isolate_count=1_000_000))
    feed, over = Feed(40_000, base), []
    bias = normal(9, 0, 0, 40_000, 6) * 1.5 * feed.sigma[0, 0]  # drawn anew at each sample: the prior is about the ensemble
    feed.gyro += bias
    for config in (base, replace(base, gyro_bias_sigma=1.5 * feed.sigma[0, 0])):
        pipeline = FusionPipeline(config)
        over.append(np.mean(feed.into(pipeline).gyro_statistic > pipeline.status().gyro.threshold))
    assert over[0] > 0.1 and over[1] == pytest.approx(1e-3, abs=6e-4)
    covariance = pipeline.rate_covariance(ALL)  # of the white noise alone
    np.testing.assert_allclose(covariance, np.eye(3) * feed.sigma[0, 0] ** 2 / 2, atol=1e-18)


def test_false_alarms_of_six_five_and_four_sensors() -> None:
    """The threshold follows the degrees of freedom: the same rate of alarms however many are in use."""
    config = replace(CONFIG, false_alarm_probability=2e-3, health=replace(SHORT, isolate_count=1_000_000))
    for out in ((), (2,), (2, 5)):
        pipeline, feed = FusionPipeline(config), Feed(150_000, config, seed=len(out))
        for sensor in out:
            pipeline.set_sensor_use(f"gyro_{sensor}", False)
        block = feed.into(pipeline)
        assert pipeline.status().gyro.dof == 3 - len(out)
        assert np.mean(block.gyro_statistic > pipeline.status().gyro.threshold) == pytest.approx(2e-3, rel=0.2)
        assert np.mean(block.accel_statistic > pipeline.status().accel.threshold) == pytest.approx(2e-3, rel=0.2)


def test_statuses_are_at_the_period_and_at_each_change() -> None:
    feed, pipeline = Feed(200), FusionPipeline(CONFIG, statuses=True)
    feed.gyro[104:, 0] += 1e-3
    feed.into(pipeline)
    statuses = pipeline.drain_statuses()
    assert [s.stamp_ns // DT for s in statuses] == sorted({1, *range(10, 201, 10), 105, 107})
    told = {s.stamp_ns // DT: s.text for s in statuses if s.text}
    assert told == {105: "gyro_0 healthy -> suspect (parity test)", 107: "gyro_0 suspect -> isolated (parity test)"}
    assert statuses[-1].gyro.state[0] == HealthState.ISOLATED and statuses[-1].counters.fused == 200
    assert not pipeline.drain_statuses() and not FusionPipeline(CONFIG).drain_statuses()


def test_more_than_six_sensors_of_any_geometry() -> None:
    rng = np.random.default_rng(2)
    axes = rng.standard_normal((9, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    config = build(FusionConfig, {"geometry": axes.ravel().tolist()})
    np.testing.assert_allclose(config.array().H, axes * [1.0, -1.0, -1.0], atol=1e-15)  # given in FLU
    feed, pipeline = Feed(200, config), FusionPipeline(config)
    feed.gyro[100:, 8] += 1e-3
    feed.gyro[150:, 3] += 1e-3
    block = feed.into(pipeline)
    assert np.all(block.gyro_used[152:] == (1 << 8) - 1 - 8) and pipeline.status().gyro.dof == 4
    assert np.abs(block.rate - RATE).max() < 6 * feed.sigma[0, 0]


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"geometry": [1.0, 0.0]}, "three elements"),
        ({"geometry": [1.0, 0.0, 0.0] * 4}, "plane"),
        ({"geometry": [1, 0, 0, 0, 1, 0, 0, 0, 0.5]}, "length"),
        ({"gyro_sigma": [1e-5, 1e-5]}, "1 or 6"),
        ({"accel_sigma": []}, "1 or 6"),
        ({"accel_sigma": [0.0]}, "accel_sigma"),
        ({"configuration": "dodecaedron"}, "dodecahedron"),
        ({"health": {"probation_count": 2}}, "probation_s"),
        ({"stuck_count": 1}, "stuck_count"),
        ({"rate": 100}, "rate_hz"),
    ],
)
def test_settings_are_checked(values: dict, message: str) -> None:
    with pytest.raises(SettingError, match=message):
        build(FusionConfig, values)


def test_threshold_defaults_to_a_time_between_false_alarms() -> None:
    assert FusionConfig().pfa() == pytest.approx(1 / 3.6e6)
    assert FusionConfig(rate_hz=200.0, mean_time_between_false_alarms_h=1.0).pfa() == pytest.approx(1 / 7.2e5)
    assert FusionConfig(false_alarm_probability=1e-3).pfa() == 1e-3
    assert FusionPipeline(FusionConfig()).status().gyro.threshold == pytest.approx(33.3, abs=0.05)


def spoilt(seed: int) -> Feed:
    """700 samples with everything that can go wrong."""
    rng, feed = np.random.default_rng(seed), Feed(700)
    for _ in range(int(rng.integers(2, 9))):
        kind, sensor = ("gyro", "accel")[rng.integers(2)], int(rng.integers(6))
        start = int(rng.integers(0, 650))
        stop = start + int(rng.integers(1, 200))
        values, valid = getattr(feed, kind), getattr(feed, f"{kind}_valid")
        what = rng.integers(5)
        if what == 0:
            values[start:stop, sensor] += rng.uniform(-40, 40) * feed.sigma[int(kind == "accel"), 0]
        elif what == 1:
            values[start:stop, sensor] = np.nan
        elif what == 2:
            values[start:stop, sensor] = values[start, sensor]
        elif what == 3:
            valid[start:stop] &= ~np.uint64(1 << sensor)
        else:
            values[start:stop, :4] = np.inf
    for k in rng.integers(1, 700, int(rng.integers(0, 5))):
        feed.stamp[k] -= int(rng.integers(0, 100 * DT))
    if rng.random() < 0.5:
        feed.stamp[int(rng.integers(1, 700)) :] += int(rng.choice([-1, 1])) * 3_000_000_000
    keep = rng.random(700) > 0.01
    for name in ("stamp", "sequence", "gyro", "accel", "gyro_valid", "accel_valid"):
        setattr(feed, name, getattr(feed, name)[keep])
    return feed


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10_000), st.lists(st.integers(1, 120), min_size=1, max_size=60))
def test_law_3_blocks_change_nothing(seed: int, lengths: list[int]) -> None:
    """Whole, re-blocked and one by one: outputs, events, statuses, counters and the state kept are the same, bit for bit."""
    feed, results = spoilt(seed), []
    m = feed.stamp.size
    cuts = [0, *np.clip(np.cumsum(lengths), 0, m).tolist(), m]
    for edges in ([0, m], cuts, range(m + 1)):
        pipeline = FusionPipeline(CONFIG, statuses=True)
        pipeline.set_sensor_use("gyro_0", False, int(feed.stamp[m // 3]))
        pipeline.set_sensor_use("gyro_0", True, int(feed.stamp[m // 2]))
        blocks = [feed.into(pipeline, a, b) for a, b in itertools.pairwise(edges)]
        whole = join(blocks)
        joined = [*whole[:-1], *whole.recalled()]
        results.append((joined, pipeline.drain_events(), pipeline.counters, [exact(s) for s in (*pipeline.drain_statuses(), pipeline.status())]))
    for other in results[1:]:
        for a, b in zip(results[0][0], other[0], strict=True):
            assert a.tobytes() == b.tobytes()
        assert results[0][1:] == other[1:]
    counters = results[0][2]
    assert counters.received == m == counters.fused + counters.rejected_stamp + counters.rejected_no_solution + counters.rejected_length
    assert np.isfinite(results[0][0][2]).all() and np.isfinite(results[0][0][3]).all()


def test_warm_up_touches_nothing() -> None:
    pipeline = FusionPipeline(CONFIG)
    before = repr(pipeline.status())
    pipeline.warm_up()
    assert repr(pipeline.status()) == before and pipeline.last_stamp_ns is None
