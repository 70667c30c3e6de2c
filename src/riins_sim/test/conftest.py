"""Fixtures of riins_sim: small voyages.

Lives here: `voyage`, a scenario made of sim_voyage.BASE and what a test changes.
Does not live here: tests.
"""

import copy

import pytest
import yaml
from sim_voyage import BASE, FAULTS

from riins_sim.scenario import Scenario, from_yaml


@pytest.fixture
def voyage():
    """Make a Scenario: `voyage(duration_s=10.0, sea={"peak_period_s": 9.0})` changes keys, sections key by key."""

    def make(**changes) -> Scenario:
        values = copy.deepcopy(BASE)
        for key, value in changes.items():
            if isinstance(value, dict) and isinstance(values.get(key), dict):
                values[key].update(value)
            else:
                values[key] = value
        return from_yaml(yaml.safe_dump(values))

    return make


@pytest.fixture(scope="session")
def shared_trajectory():
    """One trajectory of the base voyage for property tests, which may not use function-scoped fixtures."""
    from riins_sim.trajectory import Trajectory

    return Trajectory(from_yaml(yaml.safe_dump(BASE)))


@pytest.fixture(scope="session")
def shared_imu(shared_trajectory):
    """A faulty redundant IMU and its schedule."""
    from riins_sim.sensors import RedundantImuSim

    scenario = from_yaml(yaml.safe_dump({**BASE, "faults": FAULTS}))
    return RedundantImuSim(scenario, shared_trajectory), scenario.fault_schedule()


@pytest.fixture(scope="session")
def shared_aids(shared_trajectory):
    """Faulty aids and their schedule."""
    from riins_sim.sensors import DopplerSim, PositionSim

    scenario = from_yaml(yaml.safe_dump({**BASE, "faults": FAULTS, "outages": [{"target": "gps", "start_s": 30.0, "end_s": 35.0}]}))
    schedule = scenario.fault_schedule()
    return {"gps": (PositionSim(scenario, "gps", shared_trajectory), schedule), "doppler": (DopplerSim(scenario, shared_trajectory), schedule)}
