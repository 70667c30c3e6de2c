"""Every test and method in the running fusion: detection, false alarms, changes at a stamp, blocks, covariance, noise estimated while running."""

from __future__ import annotations

import copy
import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from riins_core.noise import normal
from riins_core.settings import SettingError, build
from riins_fdi.health import HealthState
from riins_fdi.methods import make
from riins_fdi.sequential import Cusum, WindowedGlr
from riins_imu_fusion.config import DriftSettings, FusionConfig, SensorHealth
from riins_imu_fusion.methods import make as make_method
from riins_imu_fusion.noise_watch import NoiseSettings
from riins_imu_fusion.pipeline import FusionPipeline
from riins_imu_fusion.selection import CHOICES
from riins_imu_fusion.sequences import SequenceSettings
from riins_imu_fusion.types import FdiStatus, FusedBlock, join

DT = 10_000_000
ALL = 0b111111
SHORT = SensorHealth(isolate_count=3, clear_s=0.05, hold_s=0.5, probation_s=1.0)
CONFIG = FusionConfig(method="wls", health=SHORT)
RATE, FORCE = np.array([1e-3, -2e-3, 5e-4]), np.array([0.2, -0.1, -9.8])
EPOCH, SEQUENTIAL = CHOICES["parity_test"], ("cusum", "glr")


class Feed:
    """Samples 1 .. m of a healthy unit."""

    def __init__(self, m: int, config: FusionConfig = CONFIG, seed: int = 7) -> None:
        array, self.sigma = config.array(), config.sigma()
        self.stamp = np.arange(1, m + 1, dtype=np.int64) * DT
        self.gyro = array.H @ RATE + self.sigma[0] * normal(seed, "gyro", 0, m, array.n)
        self.accel = array.H @ FORCE + self.sigma[1] * normal(seed, "accel", 0, m, array.n)
        self.valid = np.full(m, (1 << array.n) - 1, np.uint64)

    def into(self, pipeline: FusionPipeline, a: int = 0, b: int | None = None) -> FusedBlock:
        s = slice(a, b)
        return pipeline.process(self.stamp[s], (self.stamp[s] // DT).astype(np.uint32), self.gyro[s], self.accel[s], self.valid[s], self.valid[s])


def isolated(pipeline: FusionPipeline) -> list[tuple[str, int, int]]:
    return [(e.kind, e.index, e.stamp_ns // DT) for e in pipeline.drain_events() if e.state is HealthState.ISOLATED]


@pytest.mark.parametrize("name", EPOCH)
def test_each_parity_test_isolates_a_step_in_the_right_sensor(name: str) -> None:
    config = replace(CONFIG, parity_test=name)
    for sensor in (0, 3, 5):
        feed, pipeline = Feed(140, config, sensor), FusionPipeline(config)
        feed.accel[100:, sensor] += 18.0 * feed.sigma[1, 0]
        block = feed.into(pipeline)
        assert [e[:2] for e in isolated(pipeline)] == [("accel", sensor)]
        assert not np.any(block.accel_used[110:] >> np.uint64(sensor) & np.uint64(1)) and np.all(block.gyro_used == ALL)


@pytest.mark.parametrize("name", EPOCH)
def test_statistic_threshold_and_answer_are_those_of_the_method(name: str) -> None:
    """What the loop computes is what the object of riins_fdi says, with six, five and nine sensors; sensors that leave form another threshold."""
    rng = np.random.default_rng(3)
    nine = rng.standard_normal((9, 3))
    nine /= np.linalg.norm(nine, axis=1, keepdims=True)
    for base, out in ((CONFIG, ()), (CONFIG, (2,)), (build(FusionConfig, {"geometry": nine.ravel().tolist(), "method": "wls"}), (1, 4))):
        config = replace(base, parity_test=name, false_alarm_probability=1e-3, health=replace(SHORT, isolate_count=1_000_000))
        n = config.array().n
        feed, pipeline = Feed(400, config), FusionPipeline(config)
        feed.gyro += feed.sigma[0] * (normal(1, "size", 0, 400, n) > 1.9) * 12.0
        for sensor in out:
            pipeline.set_sensor_use(f"gyro_{sensor}", False)
        block = feed.into(pipeline)
        mask = (1 << n) - 1 - sum(1 << i for i in out)
        method = make(name, config.array(), config.sigma()[0], 1e-3, mask)
        np.testing.assert_allclose(block.gyro_statistic, method.statistic(feed.gyro), rtol=1e-6, atol=1e-9)
        if np.isfinite(pipeline.status().gyro.threshold):
            assert pipeline.status().gyro.threshold == pytest.approx(method.threshold)
        loud = method.statistic(feed.gyro) > method.threshold
        assert np.all(block.gyro_used[~loud] == mask) and loud.sum() > 20
        for k in np.flatnonzero(loud)[:40]:
            answer = method.diagnose(feed.gyro[k])
            left = mask & ~int(block.gyro_used[k])
            if len(answer.explanations) == 1 and len(answer.sensors) == 1 and left.bit_count() == 1 and name != "svd":
                assert left == 1 << answer.sensors[0]


@pytest.mark.parametrize("name", EPOCH)
def test_false_alarms_are_as_asked_for_with_any_test(name: str) -> None:
    config = replace(CONFIG, parity_test=name, false_alarm_probability=4e-3, health=replace(SHORT, isolate_count=1_000_000))
    for out in ((), (2,)):
        feed, pipeline = Feed(60_000, config, len(out)), FusionPipeline(config)
        for sensor in out:
            pipeline.set_sensor_use(f"gyro_{sensor}", False)
        block = feed.into(pipeline)
        assert np.mean(block.gyro_statistic > pipeline.status().gyro.threshold) == pytest.approx(4e-3, rel=0.25)


@pytest.mark.parametrize("name", SEQUENTIAL)
def test_a_sequential_test_finds_a_slow_drift_earlier_than_single_samples(name: str) -> None:
    """A ramp of 2 sigma a second at the same rate of false alarms of the whole, half of it spent on each test."""
    delays = {"none": [], name: []}
    for seed in range(6):
        for sequential, delay in delays.items():
            config = replace(CONFIG, sequential_test=sequential)
            feed, pipeline = Feed(1500, config, seed), FusionPipeline(config)
            feed.gyro[300:, 4] += 2.0 * feed.sigma[0, 0] * np.arange(1200) / 100.0
            feed.into(pipeline)
            kind, index, at = isolated(pipeline)[0]
            assert (kind, index) == ("gyro", 4) and at > 300
            delay.append(at - 300)
    assert np.mean(delays[name]) < 0.5 * np.mean(delays["none"]) and max(delays[name]) < min(delays["none"])


@pytest.mark.parametrize("name", SEQUENTIAL)
def test_the_sequential_test_in_the_loop_is_the_object(name: str) -> None:
    """Same samples, same threshold: the first alarm is at the same sample."""
    config = replace(CONFIG, sequential_test=name, sequence=SequenceSettings(window_s=0.5), mean_time_between_false_alarms_h=0.01)
    for seed in range(3):
        feed, pipeline = Feed(600, config, seed), FusionPipeline(config)
        feed.gyro[200:, 1] += 1.5 * feed.sigma[0, 0]
        block = feed.into(pipeline)
        test = make("glt", config.array(), config.sigma()[0], 1e-6).test
        feed.into(early := FusionPipeline(config), 0, 10)
        threshold = float(early._state.sequence.level[0, 0])
        other = WindowedGlr(test, window=50, threshold=threshold) if name == "glr" else Cusum(test, threshold=threshold)
        answer = other.process(feed.gyro)
        first = int(np.argmax(answer.alarm))
        assert first > 200 and np.all(block.gyro_used[:first] == ALL) and block.gyro_used[first] == ALL & ~(1 << answer.sensor[first])


@pytest.mark.parametrize("name", SEQUENTIAL)
def test_ordinary_biases_do_not_alarm_a_sequential_test(name: str) -> None:
    config = replace(CONFIG, sequential_test=name)
    prior = replace(config, gyro_bias_sigma=CONFIG.gyro_sigma[0])
    counts = []
    for one in (config, prior):
        counts.append(0)
        for seed in range(8):
            feed, pipeline = Feed(400, one, seed), FusionPipeline(one)
            feed.gyro += feed.sigma[0] * normal(seed, "bias", 0, 1, 6)
            feed.into(pipeline)
            counts[-1] += bool(isolated(pipeline)) or pipeline.status().gyro.doubtful
    assert counts[0] >= 6 and counts[1] == 0


@pytest.mark.parametrize("name", ["opt", "aopt", "optdc"])
def test_a_fusion_method_in_the_loop_is_the_object(name: str) -> None:
    """Told that gyro 1 drifts: same output, drift and covariance as the object of riins_imu_fusion.methods on the same samples."""
    drift = DriftSettings(gyro_sigma=(1e-6, 4e-5, *[1e-6] * 4), gyro_walk=(1e-8, 1e-6, *[1e-8] * 4))
    config = replace(CONFIG, method=name, drift=drift, false_alarm_probability=1e-9)
    feed, pipeline = Feed(2000, config), FusionPipeline(config)
    feed.gyro[:, 1] += 3.0 * feed.sigma[0, 0]
    block = feed.into(pipeline)
    out = make_method(name, config.drift_models()[0]).process(feed.gyro)
    np.testing.assert_allclose(block.rate, out.x, rtol=0, atol=1e-9 * feed.sigma[0, 0])
    np.testing.assert_allclose(block.gyro_drift, out.drift, rtol=0, atol=1e-9 * feed.sigma[0, 0])
    covariance = pipeline.rate_covariance(ALL) + block.gyro_excess
    np.testing.assert_allclose(covariance, out.covariance, rtol=1e-6, atol=1e-20)
    plain = feed.into(FusionPipeline(CONFIG))
    error, other = (np.linalg.norm((b.rate - RATE)[500:].mean(axis=0)) for b in (block, plain))
    assert error < (0.98 if name == "aopt" else 0.25) * other


@pytest.mark.parametrize("name", ["opt", "aopt", "optdc"])
def test_the_fused_covariance_of_optimal_fusion_is_honest(name: str) -> None:
    """NEES of the fused rate where the drifts are as the settings say: three, at any time of the run."""
    s = FusionConfig().gyro_sigma[0]
    start, walk = s * np.array([3.0, 0.5, 1.0, 2.0, 0.5, 0.5]), s * np.array([1.0, 0.1, 0.1, 0.5, 0.1, 0.1])
    config = replace(CONFIG, method=name, drift=DriftSettings(gyro_sigma=tuple(start), gyro_walk=tuple(walk)), false_alarm_probability=1e-12)
    nees = []
    for seed in range(100):
        feed, pipeline = Feed(300, config, seed), FusionPipeline(config)
        steps = normal(seed, "walk", 0, 301, 6)
        feed.gyro += start * steps[0] + np.cumsum(walk * 0.1 * steps[1:], axis=0)
        block = feed.into(pipeline)
        at = [0, 99, 299]
        error = (block.rate - RATE)[at]
        nees.append(np.einsum("ki,kij,kj->k", error, np.linalg.inv(pipeline.rate_covariance(ALL) + block.gyro_excess[at]), error))
    mean = np.mean(nees, axis=0)  # of 100 values of chi-square(3): 3 +- 0.25
    assert np.all(np.abs(mean - 3.0) < 0.9)


def test_a_sensor_that_returns_begins_anew() -> None:
    config = replace(CONFIG, method="opt", drift=DriftSettings(gyro_sigma=(1e-4, *[1e-6] * 5), gyro_walk=(1e-8,)))
    feed, pipeline = Feed(600, config), FusionPipeline(config)
    feed.gyro[:, 0] += 5.0 * feed.sigma[0, 0]
    feed.into(pipeline, 0, 200)
    assert pipeline.drift[0, 0] > 4.0 * feed.sigma[0, 0]
    pipeline.set_sensor_use("gyro_0", False)
    pipeline.set_sensor_use("gyro_0", True, int(feed.stamp[300]))
    feed.gyro[200:, 0] -= 5.0 * feed.sigma[0, 0]
    block = feed.into(pipeline, 200)
    back = int(np.flatnonzero(block.gyro_used == ALL)[0])
    assert abs(block.gyro_drift[back, 0]) < 3.0 * feed.sigma[0, 0] and abs(pipeline.drift[0, 0]) < feed.sigma[0, 0]


@pytest.mark.parametrize("name", ["opt", "aopt", "optdc"])
def test_what_a_fault_did_to_the_drifts_of_the_others_goes_with_it(name: str) -> None:
    """Law 4: the part of it that lies in the range of H would stay in the fused rate for good, for no parity shows it."""
    s = FusionConfig().gyro_sigma[0]
    config = replace(CONFIG, method=name, drift=DriftSettings(gyro_sigma=(3.0 * s,), gyro_walk=(1.0 * s,)))
    feed, pipeline = Feed(2500, config), FusionPipeline(config)
    feed.gyro[300:, 1] += 2.0 * s * np.arange(2200) / 100.0
    block = feed.into(pipeline)
    _, index, out = isolated(pipeline)[0]
    assert index == 1 and 500 < out < 1500
    assert np.abs(block.gyro_drift[out - 2, [0, 2, 3, 4, 5]]).max() > 1.0 * s
    plain = FusionPipeline(CONFIG)
    plain.set_sensor_use("gyro_1", False)
    apart = (block.rate - feed.into(plain).rate)[out + 5 :]
    assert np.linalg.norm(apart.mean(axis=0)) < 0.6 * s


def exact(status: FdiStatus) -> list[object]:
    """A status with its floats as bytes."""
    fields: list[object] = [status.stamp_ns, status.text, status.counters]
    for triad in (status.gyro, status.accel):
        fields += [np.asarray(value).tobytes() for value in vars(triad).values()]
    return fields


names = st.tuples(*(st.sampled_from(("", *CHOICES[word])) for word in ("fusion", "parity_test", "sequential_test")), st.booleans())


@settings(max_examples=6, deadline=None)
@given(st.integers(0, 10_000), st.lists(names, min_size=1, max_size=3), st.lists(st.integers(1, 150), min_size=1, max_size=40))
def test_law_3_blocks_change_nothing_whatever_is_selected_when(seed: int, selections: list, lengths: list[int]) -> None:
    """Whole, re-blocked and one by one, with faults, gaps and changes of method: outputs, events, statuses are the same, bit for bit."""
    rng, m = np.random.default_rng(seed), 300
    config = replace(CONFIG, noise=NoiseSettings(window_s=1.1), sequence=SequenceSettings(window_s=0.2), mean_time_between_false_alarms_h=0.1)
    feed = Feed(m, config, seed)
    feed.gyro[150:, int(rng.integers(6))] += 3.0 * feed.sigma[0, 0]
    feed.accel[200:240, int(rng.integers(6))] += 30.0 * feed.sigma[1, 0]
    feed.gyro[rng.integers(0, m, 5), rng.integers(0, 6, 5)] = np.nan
    feed.accel[:, 2] *= 1.0 + 0.001 * normal(seed, "noise", 0, m, 1)[:, 0]
    stamps = np.sort(rng.choice(feed.stamp, len(selections)))
    cuts = [0, *np.clip(np.cumsum(lengths), 0, m).tolist(), m]
    results = []
    for edges in ([0, m], cuts, range(m + 1)):
        pipeline = FusionPipeline(config, statuses=True)
        for chosen, stamp in zip(selections, stamps, strict=True):
            assert pipeline.set_method(*chosen, effective_ns=int(stamp)).success
        whole = join([feed.into(pipeline, a, b) for a, b in itertools.pairwise(edges)])
        told = [exact(s) for s in (*pipeline.drain_statuses(), pipeline.status())]
        results.append(([a.tobytes() for a in (*whole[:-1], *whole.recalled())], pipeline.drain_events(), pipeline.counters, told))
    assert results[0] == results[1] == results[2]


def test_a_copy_goes_on_alone() -> None:
    config = replace(CONFIG, method="aopt", parity_test="direct_comparison", sequential_test="glr")
    feed, pipeline = Feed(400), FusionPipeline(config)
    feed.gyro[250:, 3] += 4.0 * feed.sigma[0, 0]
    feed.into(pipeline, 0, 200)
    other = copy.deepcopy(pipeline)
    one = feed.into(pipeline, 200)
    two = feed.into(other, 200)
    assert all(a.tobytes() == b.tobytes() for a, b in zip(one[:-1], two[:-1], strict=True))


def test_a_method_is_changed_at_its_stamp() -> None:
    feed, pipeline = Feed(400), FusionPipeline(CONFIG)
    result = pipeline.set_method("opt", parity_test="svd", effective_ns=int(feed.stamp[200]))
    assert result.success and result.message == "fusion opt, parity test svd, sequential test none, noise as stated from 2.010 s on"
    assert pipeline.selected().fusion == "wls" and pipeline.selected(int(feed.stamp[300])).fusion == "opt"
    assert pipeline.selected(int(feed.stamp[100])).fusion == "wls"
    later = pipeline.set_method(sequential_test="cusum", effective_ns=int(feed.stamp[300]))
    assert later.message.startswith("fusion opt, parity test svd, sequential test cusum")
    block = feed.into(pipeline)
    assert np.all(block.gyro_excess[:200] == 0.0) and np.all(np.trace(block.gyro_excess[200:], axis1=1, axis2=2) > 0.0)
    events = [(e.stamp_ns // DT, e.kind, e.text.partition(",")[0]) for e in pipeline.drain_events()]
    assert events == [(201, "command", "method: fusion opt"), (301, "command", "method: fusion opt")]
    assert pipeline.selected() == ("opt", "svd", "cusum", False)


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (("glrkf", "", ""), 'no fusion "glrkf" (did you mean "glr_kf"?): wls, glr_kf, opt, aopt, optdc, rfdc, irfdc'),
        (("", "gtl", ""), 'no parity test "gtl" (did you mean "glt"?)'),
        (("", "", "sprt"), 'no sequential test "sprt": none, cusum, glr'),
    ],
)
def test_a_selection_of_what_is_not_there_is_refused(names: tuple[str, str, str], message: str) -> None:
    pipeline = FusionPipeline(CONFIG)
    result = pipeline.set_method(*names)
    assert not result.success and result.message.startswith(message) and pipeline.counters.commands_refused == 1
    with pytest.raises(SettingError, match="glt"):
        build(FusionConfig, {"parity_test": "gtl"})


def test_direct_comparison_of_too_many_sensors_is_refused() -> None:
    many = normal(1, "axes", 0, 25, 3)
    geometry = (many / np.linalg.norm(many, axis=1, keepdims=True)).ravel().tolist()
    result = FusionPipeline(build(FusionConfig, {"geometry": geometry})).set_method(parity_test="direct_comparison")
    assert not result.success and result.message == "direct_comparison takes at most 24 sensors, not 25"
    with pytest.raises(SettingError, match="at most 24 sensors"):
        build(FusionConfig, {"geometry": geometry, "parity_test": "direct_comparison"})


def test_a_selection_whose_stamp_has_passed_is_refused_and_counted() -> None:
    feed, pipeline = Feed(100), FusionPipeline(CONFIG)
    feed.into(pipeline)
    result = pipeline.set_method("opt", effective_ns=int(feed.stamp[-1]))
    assert not result.success and "passed 0.000 s ago" in result.message and pipeline.counters.commands_refused == 1
    assert pipeline.set_method("opt").effective_ns == feed.stamp[-1] + 1


def test_leaving_glr_kf_takes_its_word_back() -> None:
    config = replace(CONFIG, method="glr_kf")
    feed, pipeline = Feed(4000, config), FusionPipeline(config)
    feed.gyro[500:, 2] += 3.0 * feed.sigma[0, 0]
    pipeline.set_method("wls", effective_ns=int(feed.stamp[3000]))
    feed.into(pipeline, 0, 3000)
    assert pipeline.status().gyro.state[2] == HealthState.COMPENSATED
    block = feed.into(pipeline, 3000)
    assert (
        HealthState(pipeline.status().gyro.state[2]) is HealthState.HEALTHY and np.all(block.gyro_drift == 0.0) and np.all(block.gyro_excess == 0.0)
    )


NOISE = replace(CONFIG, false_alarm_probability=2e-3, noise=NoiseSettings(window_s=80.0), health=replace(SHORT, isolate_count=1_000_000))


def test_a_noisy_sensor_is_found_and_the_false_alarms_are_back_when_adapted() -> None:
    rates = []
    for adapt in (False, True):
        feed, pipeline = Feed(40_000, NOISE), FusionPipeline(replace(NOISE, adapt_noise=adapt), statuses=True)
        feed.gyro[:, 4] += np.sqrt(8.0) * feed.sigma[0, 0] * normal(11, "more", 0, 40_000, 1)[:, 0]
        block = feed.into(pipeline)
        status = pipeline.status().gyro
        np.testing.assert_allclose(status.sigma / feed.sigma[0], [1, 1, 1, 1, 3, 1], rtol=0.25)
        assert status.sigma[4] / feed.sigma[0, 4] == pytest.approx(3.0, rel=0.08)
        told = [(e.index, e.stamp_ns // DT, e.text) for e in pipeline.drain_events() if "times the stated" in e.text]
        assert len(told) == 1 and told[0][:2] == (4, 8000) and told[0][2].startswith("gyro_4: noise is ")
        late = slice(8000, None)
        rates.append(np.mean(block.gyro_statistic[late] > status.threshold))
        used = block.gyro_used[late] == ALL
        error = (block.rate - RATE)[late][used]
        covariance = pipeline.rate_covariance(ALL) + block.gyro_excess[late][used]
        nees = np.mean(np.einsum("ki,kij,kj->k", error, np.linalg.inv(covariance), error))
        assert np.array_equal(block.gyro_excess[:7990], np.zeros((7990, 3, 3)))
        assert (abs(nees - 3.0) < 0.2) == adapt
    assert rates[0] > 0.05 and rates[1] == pytest.approx(2e-3, rel=0.6)


def test_an_isolated_noisy_sensor_comes_back_with_its_weight() -> None:
    config = replace(NOISE, adapt_noise=True, health=SHORT, false_alarm_probability=1e-6)
    feed, pipeline = Feed(20_000, config), FusionPipeline(config)
    feed.accel[:, 1] += np.sqrt(15.0) * feed.sigma[1, 0] * normal(12, "more", 0, 20_000, 1)[:, 0]
    block = feed.into(pipeline)
    used = block.accel_used >> np.uint64(1) & np.uint64(1)
    assert used[4000:8000].mean() < 0.5 and used[16_000:].mean() > 0.99  # the hold had grown


def test_noise_is_not_told_from_five_sensors_and_not_estimated_when_not_wanted() -> None:
    feed, pipeline = Feed(10_000, NOISE), FusionPipeline(NOISE)
    feed.gyro[:, 0] = np.nan
    feed.into(pipeline)
    assert np.isnan(pipeline.status().gyro.sigma).all() and np.isfinite(pipeline.status().accel.sigma).all()
    off = FusionPipeline(replace(NOISE, noise=NoiseSettings(window_s=0.0)))
    feed.into(off)
    assert np.isnan(off.status().accel.sigma).all()
