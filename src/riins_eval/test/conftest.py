"""Fixtures of riins_eval: one voyage, sailed once, for all tests that look at it or at its bag.

Lives here: `scenario`, `bag`, `run` of eval_voyage.VOYAGE. Nobody may change the bag.
Does not live here: tests.
"""

from __future__ import annotations

import pytest
from eval_voyage import VOYAGE

from riins_eval import offline
from riins_sim.scenario import from_yaml


@pytest.fixture(scope="session")
def scenario():
    return from_yaml(VOYAGE)


@pytest.fixture(scope="session")
def sailed(scenario, tmp_path_factory):
    bag = tmp_path_factory.mktemp("offline") / "short"
    return offline.sail(scenario, bag=bag, record="all"), bag


@pytest.fixture(scope="session")
def run(sailed):
    return sailed[0]


@pytest.fixture(scope="session")
def bag(sailed):
    return sailed[1]
