"""The recordings in bags/ can be navigated and scored alone, by the code as it is.

Lives here: every bag of bags/ once through `navigate` and `score`, and its message definitions.
Does not live here: what a bag must hold (riins_bag), replay through the live graph (test_graph_law_2.py).
"""

from __future__ import annotations

from pathlib import Path

import pytest

from riins_bag.bag import BagReader
from riins_bag.typesys import type_hash
from riins_eval import offline
from riins_eval.score import score_bag

BAGS = sorted(path.parent for path in (Path(__file__).resolve().parents[1] / "bags").glob("*/metadata.yaml"))


@pytest.mark.parametrize("bag", BAGS, ids=lambda path: path.name)
def test_a_recorded_bag_is_navigated_and_scored_alone(bag: Path, tmp_path: Path) -> None:
    offline.navigate(bag, tmp_path / "again")
    found = score_bag(tmp_path / "again")
    assert found["position_rms_m"] < 1.0 and found["false_isolations"] == 0 and found["samples"]["lost"] == 0
    assert all(fault["isolated_right"] and not fault["epochs_fused"] for fault in found["faults"])


@pytest.mark.parametrize("bag", BAGS, ids=lambda path: path.name)
def test_a_recorded_bag_has_the_messages_of_today(bag: Path) -> None:
    """The player refuses other ones."""
    with BagReader(bag) as reader:
        recorded = {topic: (reader.topics[topic].msgtype, channel.metadata["topic_type_hash"]) for topic, channel in reader.channels().items()}
    assert recorded and all(type_hash(msgtype) == digest for msgtype, digest in recorded.values())
