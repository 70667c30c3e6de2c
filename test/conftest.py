"""What the whole-system tests share: they run in the built workspace, on this machine alone, in a DDS domain of their own."""

from __future__ import annotations

import importlib.util
import os
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[1]

# Ubuntu's ephemeral ports start above domain 101's; 0 to 19 are left to people
os.environ["ROS_DOMAIN_ID"] = str(20 + os.getpid() % 80)
os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")


def pytest_configure(config: pytest.Config) -> None:
    """Say how to run the tests instead of failing in every import."""
    if importlib.util.find_spec("riins_msgs") is None:
        pytest.exit("the workspace is not in the environment: run `make test`, or `./riins exec python -m pytest test`", returncode=2)


@pytest.fixture(scope="session")
def root() -> Path:
    """The workspace."""
    return ROOT


@pytest.fixture(scope="session")
def run(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """The live run of live_ship.py."""
    from live_ship import observe

    return observe(tmp_path_factory.mktemp("live"))
