"""Cost of the redundant-IMU fusion: microseconds per sample, and what 12 h at 100 Hz take on one core.

Run: python bench/fusion_cost.py [--samples 1000000] [--block 1000]   (in the workspace's environment)
"""

from __future__ import annotations

import argparse
import time

import numpy as np

from riins_core.sensor_errors import normal
from riins_imu_fusion.config import FusionConfig
from riins_imu_fusion.pipeline import FusionPipeline

VOYAGE = 12 * 3600 * 100


def cost(samples: int, block: int, faulty: bool, statuses: bool) -> float:
    """Microseconds per sample, fed in blocks of `block`; `faulty`: one gyro lies all the time."""
    pipeline = FusionPipeline(FusionConfig(), statuses=statuses)
    pipeline.warm_up()
    sigma, n = pipeline.config.sigma(), pipeline.n
    size = min(samples, 100_000)
    gyro, accel = (s[0] * normal(1, stream, 0, size, n) for stream, s in enumerate(sigma))
    if faulty:
        gyro[:, 2] += 1e-3
    valid = np.full(size, (1 << n) - 1, np.uint64)
    elapsed = 0.0
    for start in range(0, samples, block):
        k = np.arange(start, min(start + block, samples))
        part = k % size
        arguments = ((k + 1) * 10_000_000, k.astype(np.uint32), gyro[part], accel[part], valid[part], valid[part])
        before = time.perf_counter()
        pipeline.process(*arguments)
        pipeline.drain_statuses()
        pipeline.drain_events()
        elapsed += time.perf_counter() - before
    return elapsed / samples * 1e6


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--samples", type=int, default=1_000_000, help="samples of each measurement")
    parser.add_argument("--block", type=int, default=1000, help="samples in a block")
    given = parser.parse_args()
    print(f"{'case':42} {'us/sample':>10} {'12 h, s':>8}")
    for name, samples, block, faulty, statuses in (
        ("healthy", given.samples, given.block, False, False),
        ("one gyro isolated", given.samples, given.block, True, False),
        ("healthy, with 10 Hz status", given.samples, given.block, False, True),
        ("one by one, with 10 Hz status, as live", min(given.samples, 50_000), 1, False, True),
    ):
        each = cost(samples, block, faulty, statuses)
        print(f"{name:42} {each:10.3f} {each * VOYAGE * 1e-6:8.2f}", flush=True)


if __name__ == "__main__":
    main()
