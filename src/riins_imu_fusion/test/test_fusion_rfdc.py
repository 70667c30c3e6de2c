"""RFDC and IRFDC in the running fusion: the object of riins_fdi, what they gain, honest covariance, changing sets, blocks, selection."""

from __future__ import annotations

import copy
import itertools
from dataclasses import replace
from typing import Any

import fusion_feed
import numpy as np
import pytest
from fusion_feed import ALL, DT, FORCE, RATE, SHORT

from riins_core.imu_array import CONFIGURATIONS
from riins_core.noise import normal
from riins_core.settings import SettingError, build
from riins_fdi.drift import DriftCompensator, DriftConfig, voting_rows
from riins_fdi.health import HealthState
from riins_imu_fusion.config import DriftSettings, FusionConfig
from riins_imu_fusion.pipeline import FusionPipeline
from riins_imu_fusion.reporting import diagnosis
from riins_imu_fusion.rfdc import RfdcSettings
from riins_imu_fusion.types import FusedBlock, join

WLS = FusionConfig(method="wls", health=SHORT, false_alarm_probability=1e-9)


def config(name: str, base: FusionConfig = WLS, **settings: Any) -> FusionConfig:
    return replace(base, method=name, drift=DriftSettings(rfdc=RfdcSettings(**settings)))


class Feed(fusion_feed.Feed):
    """Samples whose gyros drift, in sigma."""

    def drift(self, sensor: int, size: float, start: int, rise: int = 300) -> Feed:
        self.gyro[start:, sensor] += size * self.sigma[0, sensor] * np.minimum(1.0, np.arange(len(self.gyro) - start) / rise)
        return self


def bias(block: FusedBlock, start: int, stop: int | None = None) -> float:
    """Mean error of the fused rate, in sigma of a sample."""
    return float(np.linalg.norm((block.rate[start:stop] - RATE).mean(axis=0)) / WLS.sigma()[0, 0])


@pytest.mark.parametrize("name", ["rfdc", "irfdc"])
@pytest.mark.parametrize("kind", ["ekf", "aekf"])
def test_the_loop_in_the_fusion_is_the_object(name: str, kind: str) -> None:
    feed = Feed(800).drift(1, 4.0, 100)
    block = feed.into(FusionPipeline(config(name, filter=kind)))
    s = RfdcSettings()
    settings = DriftConfig(kind, name == "irfdc", s.gain, 0.01, 1.0, s.process, s.vote, s.most)
    loop = DriftCompensator(WLS.array(), settings)
    unit = feed.sigma[0, 0]
    out = loop.process(feed.gyro / unit)
    np.testing.assert_allclose(block.rate / unit, out.compensated @ WLS.array().least_squares().T, atol=1e-6)
    np.testing.assert_allclose(block.gyro_drift[1:] / unit, out.compensation[:-1], atol=1e-6)  # what is taken out was known before the sample
    assert np.array_equal(block.gyro_used, np.full(800, ALL))


def test_a_drifting_gyro_is_compensated() -> None:
    """Mean error of the fused rate over that of weighted least squares; the drift factor is what does it."""
    ratio = {"rfdc": [], "irfdc": []}
    for name, seed, size in itertools.product(ratio, range(8), (2.0, 4.0)):
        feed = Feed(2000, seed=seed).drift(seed % 6, size, 400)
        ratio[name].append(bias(feed.into(FusionPipeline(config(name))), 1000) / bias(feed.into(FusionPipeline(WLS)), 1000))
    assert np.mean(ratio["irfdc"]) < 0.25 and max(ratio["irfdc"]) < 0.6
    assert np.mean(ratio["irfdc"]) < 0.5 * np.mean(ratio["rfdc"])


def test_particles_compensate_too() -> None:
    ratio = []
    for seed in range(3):
        feed = Feed(1500, seed=seed).drift(1, 4.0, 300)
        made = config("irfdc", filter="aekpf_optimal", process=0.1, vote=0.3)
        ratio.append(bias(feed.into(FusionPipeline(made)), 900) / bias(feed.into(FusionPipeline(WLS)), 900))
    assert np.mean(ratio) < 0.25


@pytest.mark.parametrize(("kind", "seeds"), [("ekf", 8), ("aekpf", 2)])
def test_the_covariance_promises_no_more_than_is_kept(kind: str, seeds: int) -> None:
    """Whatever is guessed: no drift, one, two that no one tells apart. The mean normalized square of the error is not above three."""
    for drifting in ((), (1,), (1, 4)):
        nees = []
        for seed in range(seeds):
            feed, pipeline = Feed(1600, seed=seed), FusionPipeline(config("irfdc", filter=kind))
            for sensor in drifting:
                feed.drift(sensor, 3.0, 400)
            block = feed.into(pipeline)
            at = np.arange(700, 1600, 150)
            error = (block.rate - RATE)[at]
            nees.append(np.einsum("ki,kij,kj->k", error, np.linalg.inv(pipeline.rate_covariance(ALL) + block.gyro_excess[at]), error).mean())
        assert 0.05 < np.mean(nees) < 3.5
        assert len(np.unique(block.gyro_excess[500:, 0, 0])) < 20  # it stands still: a change means another bias to a navigator


def test_a_drift_like_a_body_rate_stays() -> None:
    """Target 16: nothing of it is found, and nothing is promised about it."""
    feed = Feed(1500)
    hidden = np.array([2.0, 1.0, -1.0]) * feed.sigma[0, 0]
    feed.gyro[300:] += WLS.array().H @ hidden
    block = feed.into(FusionPipeline(config("irfdc")))
    error = (block.rate - RATE)[700:].mean(axis=0)
    np.testing.assert_allclose(error, hidden, atol=0.6 * feed.sigma[0, 0])


@pytest.mark.parametrize("kind", ["ekf", "aekpf"])
@pytest.mark.parametrize("name", ["rfdc", "irfdc"])
def test_law_3_blocks_change_nothing_when_sensors_leave_and_return(name: str, kind: str) -> None:
    m = 300
    made = config(name, filter=kind, particles=20)
    feed = Feed(m).drift(1, 4.0, 20, 50)
    feed.accel[100:, 3] += 40.0 * feed.sigma[1, 3]  # isolated
    feed.gyro[150:154, 0] = np.nan
    feed.gyro[60, 2] += 1e-2  # one sample is left out
    rng, results = np.random.default_rng(3), []
    cuts = [0, *np.sort(rng.choice(m, 30, replace=False)).tolist(), m]
    for edges in ([0, m], cuts, range(m + 1)):
        pipeline = FusionPipeline(made, statuses=True)
        pipeline.set_sensor_use("gyro_5", False, int(feed.stamp[170]))
        pipeline.set_sensor_use("gyro_5", True, int(feed.stamp[200]))
        whole = join([feed.into(pipeline, a, b) for a, b in itertools.pairwise(edges)])
        results.append(([a.tobytes() for a in (*whole[:-1], *whole.recalled())], pipeline.drain_events(), pipeline.counters))
    assert results[0] == results[1] == results[2]
    kept = FusionPipeline(made)
    feed.into(kept, 0, 130)
    again = [feed.into(one, 130) for one in (copy.deepcopy(kept), kept)]
    assert all(a.tobytes() == b.tobytes() for a, b in zip(again[0][:-1], again[1][:-1], strict=True))


def test_a_restart_begins_the_random_numbers_anew() -> None:
    feed, made = Feed(80), config("irfdc", filter="pf", particles=20)
    fresh, used = FusionPipeline(made), FusionPipeline(made)
    expected = feed.into(fresh)
    feed.into(used, 0, 37)
    feed.stamp += 100 * 10**9
    again = feed.into(used)
    assert used.counters.restarts == 1 and again.rate.tobytes() == expected.rate.tobytes()


def test_a_sensor_isolated_takes_what_it_did_to_the_others_with_it() -> None:
    """The loop begins anew with the set that is left, goes on compensating, and the sensor that returns comes in without a past."""
    feed, pipeline = Feed(3000).drift(4, 3.5, 200), FusionPipeline(config("irfdc"))
    feed.gyro[1000:1500, 1] += 30.0 * feed.sigma[0, 1]
    block = feed.into(pipeline)
    states = [(e.index, e.state, e.stamp_ns // DT) for e in pipeline.drain_events() if e.state in (HealthState.ISOLATED, HealthState.HEALTHY)]
    out = next(at for index, state, at in states if (index, state) == (1, HealthState.ISOLATED))
    assert 1000 < out < 1010
    assert abs(block.gyro_drift[990, 4]) > 2.0 * feed.sigma[0, 4] and np.all(block.gyro_drift[out] == 0.0)
    without = np.flatnonzero(block.gyro_used == ALL & ~2)
    assert np.all(block.gyro_drift[without, 1] == 0.0)
    back = 1 + int(np.flatnonzero(block.gyro_used != ALL)[-1])
    assert back < 2900 and block.gyro_used[-1] == ALL
    plain = feed.into(FusionPipeline(WLS))
    assert bias(block, out + 200, 1500) < 0.7 * bias(plain, out + 200, 1500) and bias(block, back + 200) < 0.5 * bias(plain, back + 200)


def test_with_four_sensors_nothing_is_learned() -> None:
    feed, pipeline = Feed(400).drift(0, 3.0, 50), FusionPipeline(config("irfdc"))
    for sensor in (4, 5):
        pipeline.set_sensor_use(f"gyro_{sensor}", False)
    block = feed.into(pipeline)
    assert np.all(block.gyro_drift == 0.0) and np.all(np.isfinite(block.gyro_excess)) and np.trace(block.gyro_excess[-1]) > 0.0


def test_votes_of_a_set_leave_out_who_is_not_in_it() -> None:
    array = WLS.array()
    rows = voting_rows(array, ALL & ~4)
    used = [0, 1, 3, 4, 5]
    assert np.all(rows[2] == 0.0) and np.all(rows[:, 2] == 0.0) and np.all(np.diag(rows) == 0.0)
    np.testing.assert_allclose(rows @ array.H, 0.0, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(rows[used], axis=1), 1.0)
    with pytest.raises(ValueError, match="every parity relation"):
        voting_rows(array, 0b001111)


def test_selected_while_running_and_by_parameter() -> None:
    """From its stamp on the same as one that has run it from there; the text says what to beware of."""
    feed = Feed(300).drift(1, 4.0, 0)
    whole = build(FusionConfig, {"method": "irfdc", "drift": {"rfdc": {"filter": "aekf"}}, "health": {"isolate_count": 1000}})
    first = replace(whole, method="wls")
    pipeline = FusionPipeline(first)
    result = pipeline.set_method("irfdc", effective_ns=int(feed.stamp[100]))
    assert result.success and result.message.startswith("fusion irfdc (whose drift it is is a guess")
    block = feed.into(pipeline)
    other = feed.into(FusionPipeline(whole), 100)
    assert block.rate[100:].tobytes() == other.rate.tobytes() and np.all(block.gyro_drift[:101] == 0.0)
    assert np.any(block.gyro_drift[101] != 0.0)
    name, _, _, values = diagnosis(pipeline.status(), True, pipeline.selected())[0]
    assert name == "imu_fusion" and values["fusion"] == "irfdc" and "body rate" in values["caution"]


@pytest.mark.parametrize("n", [4, 25])
def test_too_few_and_too_many_sensors_are_refused(n: int) -> None:
    many = normal(1, "axes", 0, n, 3)
    geometry = (many / np.linalg.norm(many, axis=1, keepdims=True)).ravel().tolist()
    result = FusionPipeline(build(FusionConfig, {"geometry": geometry})).set_method("rfdc")
    assert not result.success and result.message == f"rfdc takes 5 to 24 sensors, not {n}"
    with pytest.raises(SettingError, match=f"irfdc takes 5 to 24 sensors, not {n}"):
        build(FusionConfig, {"geometry": geometry, "method": "irfdc"})


def test_nine_sensors() -> None:
    nine = np.vstack([CONFIGURATIONS["dodecahedron"], np.eye(3)]) * [1.0, -1.0, -1.0]
    made = build(FusionConfig, {"geometry": nine.ravel().tolist(), "method": "irfdc", "false_alarm_probability": 1e-9})
    array, sigma = made.array(), made.sigma()[0]
    gyro = array.H @ RATE + sigma * normal(4, "nine", 0, 1500, 9)
    gyro[300:, 7] += 3.0 * sigma[7]
    accel = array.H @ FORCE + made.sigma()[1] * normal(5, "nine", 0, 1500, 9)
    valid = np.full(1500, 511, np.uint64)
    block = FusionPipeline(made).process(np.arange(1, 1501) * DT, np.arange(1500), gyro, accel, valid, valid)
    found = block.gyro_drift[-500:].mean(axis=0) / sigma
    assert np.argmax(np.abs(found)) == 7 and found[7] == pytest.approx(3.0, abs=0.6)
