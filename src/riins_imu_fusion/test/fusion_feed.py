"""Samples of a redundant unit, healthy until a test spoils them, and what the tests of the fusion ask of a pipeline.

Lives here: `Feed`, the settings that the tests share, short questions about health, a status as bytes.
Does not live here: any test.
"""

from __future__ import annotations

import numpy as np

from riins_core.sensor_errors import normal
from riins_fdi.health import HealthState
from riins_imu_fusion.config import FusionConfig, SensorHealth
from riins_imu_fusion.pipeline import FusionPipeline
from riins_imu_fusion.types import FdiStatus, FusedBlock

DT = 10_000_000
ALL = 0b111111
SHORT = SensorHealth(isolate_count=3, clear_s=0.05, hold_s=0.5, probation_s=1.0)
CONFIG = FusionConfig(health=SHORT, status_period_s=0.1)
RATE, FORCE = np.array([1e-3, -2e-3, 5e-4]), np.array([0.2, -0.1, -9.8])


class Feed:
    """Raw samples 1 .. m of a healthy unit, to be spoilt by a test."""

    def __init__(self, m: int, config: FusionConfig = CONFIG, seed: int = 7) -> None:
        array, sigma = config.array(), config.sigma()
        self.stamp = np.arange(1, m + 1, dtype=np.int64) * DT
        self.sequence = np.arange(1, m + 1).astype(np.uint32)
        self.gyro = array.H @ RATE + sigma[0] * normal(seed, 0, 0, m, array.n)
        self.accel = array.H @ FORCE + sigma[1] * normal(seed, 1, 0, m, array.n)
        self.gyro_valid = np.full(m, (1 << array.n) - 1, np.uint64)
        self.accel_valid = self.gyro_valid.copy()
        self.sigma = sigma

    def into(self, pipeline: FusionPipeline, start: int = 0, stop: int | None = None) -> FusedBlock:
        part = slice(start, stop)
        return pipeline.process(
            self.stamp[part], self.sequence[part], self.gyro[part], self.accel[part], self.gyro_valid[part], self.accel_valid[part]
        )


def in_use(used: np.ndarray, sensor: int) -> np.ndarray:
    return (used >> np.uint64(sensor)) & np.uint64(1) == 1


def state(pipeline: FusionPipeline, sensor: int, kind: str = "gyro") -> HealthState:
    return HealthState(getattr(pipeline.status(), kind).state[sensor])


def changes(pipeline: FusionPipeline) -> list[tuple[str, int, str, int]]:
    return [(e.kind, e.index, e.state.name, e.reason) for e in pipeline.drain_events() if e.state is not None]


def exact(status: FdiStatus) -> list[object]:
    """A status with its floats as bytes."""
    fields = [status.stamp_ns, status.text, status.counters]
    for triad in (status.gyro, status.accel):
        fields += [np.asarray(value).tobytes() for value in vars(triad).values()]
    return fields
