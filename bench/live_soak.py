"""The live graph at work for ten minutes or two hours: samples lost, latency from the IMU stamp to NavState, faults isolated, distance from the twin.

Lives here: `./riins exec python bench/live_soak.py [--duration 60] [--scenario voyage_2h --rate 2]`, exit status 1 if a sample is lost.
Does not live here: the graph and its launcher (riins_bringup), scoring (riins_eval).
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import shutil
import sys
import time
from pathlib import Path

from rich.console import Console

from riins_bringup.graph import GraphSettings, build_graph
from riins_bringup.live import run_live

SCENARIO = """\
name: soak
description: The harbour's ship and sensors for ten minutes, with turns, a GPS spoof and a gyro that drifts.
seed: 21
duration_s: {duration:.1f}
imu_rate_hz: 100
start: {{latitude_deg: 40.7, longitude_deg: 121.05, height_m: 8.0, speed_kn: 7.0, heading_deg: 30.0}}
legs:
  - {{straight_s: 60.0}}
  - {{turn_deg: 60.0, rate_deg_s: 1.5}}
  - {{straight_s: 120.0}}
  - {{turn_deg: -90.0, rate_deg_s: 1.5}}
sea: {{significant_wave_height_m: 1.5, peak_period_s: 7.0, direction_deg: 250.0}}
imu:
  configuration: dodecahedron
  gyro: {{constant_drift_deg_h: 0.05, markov_drift_deg_h: 0.01, markov_time_s: 3600.0, arw_deg_sqrt_h: 0.005}}
  accel: {{bias_ug: 100.0, vrw_ug_sqrt_hz: 20.0}}
gps: {{period_s: 1.0, sigma_m: [2.0, 2.0, 4.0], lever_arm_m: [-8.0, 1.5, -12.0]}}
bds: {{period_s: 1.0, sigma_m: [4.0, 4.0, 8.0], lever_arm_m: [-8.0, -1.5, -12.0]}}
doppler: {{period_s: 1.0, sigma_kn: [0.1, 0.1, 0.1], misalignment_deg: 0.1, lever_arm_m: [15.0, 0.0, 3.0]}}
initial: {{position_m: 5.0, height_m: 2.0, velocity_mps: 0.1, tilt_arcsec: 30.0, heading_arcmin: 6.0}}
faults:
  - {{target: gyro_2, type: ramp, slope_deg_h_s: 1.6, start_s: {third:.1f}}}
  - {{target: gps, type: step, axis: north, size_m: 60.0, start_s: {half:.1f}, end_s: {end:.1f}}}
scoring: {{from_s: 10.0}}
"""


def machine() -> str:
    """Processor and number of cores."""
    try:
        names = [line.split(":", 1)[1].strip() for line in Path("/proc/cpuinfo").read_text().splitlines() if line.startswith("model name")]
    except OSError:
        names = []
    return f"{names[0] if names else platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}"


def main() -> int:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenario", default="", help="a shipped scenario instead of the ten minutes in a harbour")
    parser.add_argument("--duration", type=float, default=0.0, help="length of the run in measurement time [s] (0: all of it)")
    parser.add_argument("--rate", type=float, default=1.0, help="times real time (latency is measured at 1 only)")
    parser.add_argument("--no-record", action="store_true", help="without recorder, and so without the score of the bag")
    parser.add_argument("--out", type=Path, default=Path("out/soak"), help="directory, made anew")
    arguments = parser.parse_args()
    shutil.rmtree(arguments.out, ignore_errors=True)
    arguments.out.mkdir(parents=True)
    scenario, duration = arguments.scenario, arguments.duration
    if not scenario:
        scenario, length = str(arguments.out / "soak.yaml"), duration or 600.0
        Path(scenario).write_text(SCENARIO.format(duration=length, third=length / 3.0, half=length / 2.0, end=length * 0.75))
    bag = "" if arguments.no_record else str(arguments.out / "bag")
    console = Console()
    graph = build_graph(GraphSettings(scenario=scenario, record=bag, rate=arguments.rate, duration_s=duration))
    loads = [os.getloadavg()[0]]
    live = run_live(graph, console=console, directory=arguments.out / "logs", record=bag, json_file=arguments.out / "live.json")
    loads.append(os.getloadavg()[0])
    result = {"machine": machine(), "date": time.strftime("%Y-%m-%d"), "load": loads, "live": live}
    lost = live["samples"].get("lost", 0) + live["samples"].get("navigator_lost", 0) + live["samples"]["nav_states_lost"]
    if bag and live["status"] == 0:
        from riins_eval.score import score_bag

        result["score"] = score_bag(bag, twins=True)
        if (deviation := result["score"]["twin_deviation_max_m"]) is not None:
            console.print(f"deviation from the fault-free twin, largest: {deviation:.2f} m", highlight=False)
    (arguments.out / "soak.json").write_text(json.dumps(result, indent=2) + "\n")
    console.print(f"{result['date']}, {result['machine']}, load {loads[0]:.1f} to {loads[1]:.1f}: {lost} samples lost", highlight=False)
    return 0 if live["status"] == 0 and lost == 0 else 1


if __name__ == "__main__":
    sys.exit(main())
