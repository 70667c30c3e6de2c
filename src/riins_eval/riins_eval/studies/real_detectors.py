"""Every method of detection behind one interface, as the studies on real sensors need it: told a noise, it says when it alarms and whom it names.

Lives here: `Detector`, its eight kinds by `detectors`: four parity tests of one epoch, CUSUM, windowed GLR, the pipelines WLS + GLT and glr_kf.
Does not live here: the methods (riins_fdi, riins_imu_fusion), the recordings, the cases and what is counted (real_cases.py).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from riins_core.frames import frd_to_flu
from riins_core.imu_array import ImuArray
from riins_fdi.health import HealthState
from riins_fdi.methods import METHODS, ParityMethod
from riins_fdi.methods import make as make_method
from riins_fdi.parity import parity_test
from riins_fdi.run_length import cusum_threshold
from riins_fdi.sequential import Cusum, SequentialTest, WindowedGlr
from riins_imu_fusion.config import KINDS, FusionConfig
from riins_imu_fusion.pipeline import FusionPipeline
from riins_imu_fusion.types import Reason

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Pair = tuple[Array, Array]
"""Gyros and accelerometers, (m, n) each."""

MOST_NAMED = 3
"""Sensors a sequential test may name one after the other."""
LOOKS = 48
"""Epochs over the threshold at which a test of one epoch is asked for a name."""
START_NS = 1_000_000_000


class Sensors(NamedTuple):
    """What every method is told of the sensors: sample rate [Hz], geometry, noise of a sample (2, n), ordinary bias (2,), alarms an hour."""

    rate_hz: float
    array: ImuArray
    sigma: Array
    bias: Array
    alarms_h: float


class Finding(NamedTuple):
    """What a method says about a stretch with a fault: sample of the first alarm and of the first name, -1: none; all it has named at the end."""

    alarm: int
    naming: int
    first: tuple[int, ...]
    named: frozenset[int]


class Detector(Protocol):
    """A method, which is told a multiple of the noise that Sensors says: one scale for gyros, one for accelerometers."""

    name: str
    title: str

    def alarms(self, z: Pair, scale: float) -> tuple[Index, Index]:
        """Samples of a stretch at which it alarms, of gyros and accelerometers, both told the same scale."""
        ...

    def find(self, z: Pair, kind: int, onset: int, scales: Sequence[float]) -> Finding:
        """What it makes of a stretch with a fault from sample `onset` on; `scales` of gyros and accelerometers."""
        ...


class OneEpoch:
    """A parity test of one epoch at a time."""

    def __init__(self, name: str, sensors: Sensors) -> None:
        self.name, self.title = name, _TITLES[name]
        pfa = sensors.alarms_h / (3600.0 * sensors.rate_hz)
        sigma = np.hypot(sensors.sigma, sensors.bias[:, None])
        self._tests: list[ParityMethod] = [make_method(name, sensors.array, s, pfa) for s in sigma]

    def alarms(self, z: Pair, scale: float) -> tuple[Index, Index]:
        """See Detector."""
        return self._over(z[0], 0, scale), self._over(z[1], 1, scale)

    def _over(self, z: Array, kind: int, scale: float) -> Index:
        return np.flatnonzero(self._tests[kind].statistic(z / scale) > self._tests[kind].threshold)

    def find(self, z: Pair, kind: int, onset: int, scales: Sequence[float]) -> Finding:
        """See Detector. Its name is that of the first alarm that has one; what it names last is what the last alarm with a name says."""
        test, seen = self._tests[kind], z[kind] / scales[kind]
        over = self._over(seen, kind, 1.0)
        over = over[over >= onset]
        if not len(over):
            return _NOTHING
        first, naming = _first_name(test, seen, over[:LOOKS])
        last, _ = _first_name(test, seen, over[: -1 - LOOKS : -1])
        return Finding(int(over[0]), naming, first, frozenset(last))


class OverTime:
    """A sequential test; whom it names is left out, and it goes on with the others from the estimated onset on."""

    def __init__(self, name: str, sensors: Sensors, build: Callable[..., SequentialTest], threshold: float) -> None:
        self.name, self.title = name, _TITLES[name]
        self._sensors, self._build, self._threshold = sensors, build, threshold
        self._sigma = np.hypot(sensors.sigma, sensors.bias[:, None])
        self._lead = round(LEAD_S * sensors.rate_hz)

    def alarms(self, z: Pair, scale: float) -> tuple[Index, Index]:
        """See Detector."""
        every = (1 << self._sensors.array.n) - 1
        gyro, accel = (np.flatnonzero(self._test(kind, every).process(z[kind] / scale).alarm) for kind in range(2))
        return gyro, accel

    def find(self, z: Pair, kind: int, onset: int, scales: Sequence[float]) -> Finding:
        """See Detector."""
        seen = z[kind] / scales[kind]
        mask, start, first, earliest = (1 << seen.shape[1]) - 1, max(0, onset - self._lead), -1, onset
        named: list[int] = []
        while len(named) < MOST_NAMED and mask.bit_count() > 4:
            block = self._test(kind, mask).process(seen[start:])
            over = np.flatnonzero(block.alarm)
            over = over[over + start >= earliest]
            if not len(over):
                break
            k = int(over[0])
            first = k + start if first < 0 else first
            earliest = k + start
            named.append(int(block.sensor[k]))
            mask &= ~(1 << named[-1])
            start = max(start, min(start + int(block.onset[k]), k + start))
        return Finding(first, first, tuple(named[:1]), frozenset(named)) if named else _NOTHING

    def _test(self, kind: int, mask: int) -> SequentialTest:
        return self._build(parity_test(self._sensors.array, mask, self._sigma[kind], 1e-3), threshold=self._threshold)


class Pipeline:
    """The whole fusion with its health machine; an alarm is a sensor isolated or compensated, or a fault reported that it cannot place."""

    def __init__(self, method: str, sensors: Sensors) -> None:
        self.name, self.title = method, _TITLES[method]
        self._sensors = sensors

    def alarms(self, z: Pair, scale: float) -> tuple[Index, Index]:
        """See Detector."""
        found = self.run(z, (scale, scale))
        gyro, accel = (np.array([k for other, k, _ in found if other == kind], dtype=np.int64) for kind in range(2))
        return gyro, accel

    def find(self, z: Pair, kind: int, onset: int, scales: Sequence[float]) -> Finding:
        """See Detector."""
        start = max(0, onset - round(PIPELINE_LEAD_S * self._sensors.rate_hz))
        run = self.run((z[0][start:], z[1][start:]), scales)
        mine = [(k + start, index) for other, k, index in run if other == kind and k + start >= onset]
        names = [(k, index) for k, index in mine if index >= 0]
        if not mine:
            return _NOTHING
        first = tuple(index for k, index in names if k == names[0][0])
        return Finding(mine[0][0], names[0][0] if names else -1, first, frozenset(index for _, index in names))

    def run(self, z: Pair, scales: Sequence[float]) -> list[tuple[int, int, int]]:
        """Alarms (kind, sample, sensor; -1: it cannot say which) of a run over a stretch."""
        pipeline = FusionPipeline(self.config(scales))
        m, n = z[0].shape
        step = round(1e9 / self._sensors.rate_hz)
        every = np.full(m, (1 << n) - 1, dtype=np.uint64)
        stamps = START_NS + step * np.arange(m)
        pipeline.process(stamps, np.arange(m), z[0], z[1], every, every)
        found = []
        for event in pipeline.drain_events():
            if event.kind not in KINDS:
                continue
            declared = event.state in (HealthState.ISOLATED, HealthState.COMPENSATED)
            if declared or (event.index < 0 and event.reason == Reason.PARITY):
                found.append((KINDS.index(event.kind), (event.stamp_ns - START_NS) // step, event.index if declared else -1))
        return found

    def config(self, scales: Sequence[float]) -> FusionConfig:
        """Settings of a run."""
        s = self._sensors
        return FusionConfig(
            rate_hz=s.rate_hz,
            method=self.name,
            geometry=tuple(frd_to_flu(s.array.H).ravel().tolist()),
            gyro_sigma=tuple((scales[0] * s.sigma[0]).tolist()),
            accel_sigma=tuple((scales[1] * s.sigma[1]).tolist()),
            gyro_bias_sigma=float(s.bias[0]),
            accel_bias_sigma=float(s.bias[1]),
            mean_time_between_false_alarms_h=1.0 / s.alarms_h,
            recall_window_s=0.0,
        )


LEAD_S = 5.0
"""A sequential test has been running for so long when a fault begins."""
PIPELINE_LEAD_S = 60.0
"""And a pipeline, whose filter learns."""
_NOTHING = Finding(-1, -1, (), frozenset())
_TITLES = {
    "direct_comparison": "direct comparison",
    "optimal_parity_vector": "optimal parity vector",
    "svd": "singular values",
    "glt": "GLT",
    "cusum": "CUSUM",
    "windowed_glr": "windowed GLR",
    "wls": "pipeline WLS + GLT",
    "glr_kf": "pipeline glr_kf",
}


def detectors(sensors: Sensors, window_s: float) -> list[Detector]:
    """All eight, the longest window of the GLR being `window_s` [s]."""
    epochs = sensors.rate_hz * 3600.0 / sensors.alarms_h
    sequential: list[Detector] = [
        OverTime("cusum", sensors, Cusum, cusum_threshold(epochs, 0.5, 2 * sensors.array.n)),
        OverTime("windowed_glr", sensors, _windowed(round(window_s * sensors.rate_hz)), _GLR_THRESHOLD),
    ]
    return [
        *(OneEpoch(name, sensors) for name in ("direct_comparison", "optimal_parity_vector", "svd", "glt") if name in METHODS),
        *sequential,
        *(Pipeline(method, sensors) for method in ("wls", "glr_kf")),
    ]


_GLR_THRESHOLD = 30.0
"""About that of an alarm in hours of white noise; what is real about the noise is in the scale, which is found from the recording."""


def _windowed(window: int) -> Callable[..., SequentialTest]:
    def build(test: object, threshold: float) -> SequentialTest:
        return WindowedGlr(test, window=window, threshold=threshold)  # type: ignore[arg-type]

    return build


def _first_name(test: ParityMethod, z: Array, epochs: Index) -> tuple[tuple[int, ...], int]:
    """Sensors named at the first of these epochs that names any, and that epoch; (), -1: none does."""
    for k in epochs.tolist():
        if sensors := test.diagnose(z[k]).sensors:
            return sensors, k
    return (), -1
