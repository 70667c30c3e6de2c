"""Alignment by the navigator itself over 50 seeds: rest, waves, under way; errors against their own sigmas. Minutes; see docs/results.md.

Lives here: the table. Does not live here: the methods (riins_federated), the papers' experiments (riins_eval.studies.alignment*).
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "src/riins_federated/test"))

from fed_alignment import Ship, config, feed

from riins_core.alignment.result import attitude_error
from riins_core.rotation import dcm_from_euler
from riins_federated.navigator import Navigator

SHIPS = {
    "at rest, auto": ({"duration": 190.0, "stay": 1000.0, "waves": 0.0}, "auto"),
    "at rest, redundant": ({"duration": 20.0, "stay": 1000.0, "waves": 0.0}, "redundant"),
    "swaying, auto": ({"duration": 310.0, "stay": 1000.0}, "auto"),
    "under way, auto": ({"duration": 310.0, "speed": 8.0, "turn": True, "stay": 60.0}, "auto"),
}
ARCMIN = 180.0 * 60.0 / np.pi


def main(seeds: int) -> None:
    """Print the table."""
    for name, (how, method) in SHIPS.items():
        scaled, own, after, without = [], [], [], 0
        for seed in range(100, 100 + seeds):
            ship = Ship(seed=seed, rate=25, **how)  # type: ignore[arg-type]
            reports = feed(Navigator(config({"method": method})), ship).drain_alignment()
            found = next((r.initial for r in reports if r.initial is not None), None)
            if found is None:
                without += 1
                continue
            truth = ship.truth(found.stamp_ns)
            phi = attitude_error(dcm_from_euler(*found.rph), truth.C_nb[0])
            scaled.append(np.concatenate([phi / found.sigma_attitude, (found.v_n - truth.v_n[0])[:2] / found.sigma_velocity[:2]]))
            own.append(found.sigma_attitude[2] * ARCMIN)
            after.append(reports[-1].elapsed_s)
        s = np.array(scaled)
        rms = ", ".join(f"{v:.2f}" for v in np.sqrt(np.mean(s**2, axis=0)))
        error = float(np.sqrt(np.mean((s[:, 2] * own) ** 2)))
        print(f"{name}: {len(s)} of {seeds} ({without} without a state), {np.median(after):.0f} s, method of the last {reports[-1].method}")
        print(f"    phi N, E, D and velocity N, E over their sigmas, RMS: {rms}; heading within 3 sigma: {np.mean(np.abs(s[:, 2]) <= 3.0):.2f}")
        print(f"    heading error {error:.2f} arcmin RMS, own sigma {np.mean(own):.2f}", flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("seeds", type=int, nargs="?", default=50)
    main(parser.parse_args().seeds)
