"""A part of a bag as a bag: some topics, some time.

Lives here: `excerpt`.
Does not live here: rebuilding of damaged bags (recover.py), offline runs (riins_eval).
"""

from __future__ import annotations

import itertools
import os
from collections.abc import Collection

from riins_bag.errors import BagError
from riins_bag.reader import BagReader
from riins_bag.recording import AHEAD_TOPICS, RAW_TOPICS, selected
from riins_bag.writer import BagWriter


def excerpt(
    path: str | os.PathLike[str],
    out: str | os.PathLike[str],
    topics: Collection[str] = RAW_TOPICS,
    start_s: float = 0.0,
    stop_s: float = float("inf"),
    level: int = 19,
) -> int:
    """Copy messages as they are; of latched topics what held at the beginning comes along, with its own log time.

    Parameters
    ----------
    path, out : bag, and the new one, which must not exist
    topics : names, * and ? allowed
    start_s, stop_s : from the first message of the bag, start <= t < stop
    level : zstd level

    Returns
    -------
    number of messages copied

    Raises
    ------
    BagError
        No such topic; otherwise as `BagReader` and `BagWriter`.
    """
    with BagReader(path) as bag:
        chosen = sorted(topic for topic in bag.topics if selected(topic, topics))
        if not chosen:
            raise BagError(f"{path} has none of {', '.join(topics)}; it has {', '.join(sorted(bag.topics))}")
        begin = bag.start_ns + round(start_s * 1e9)
        end = None if stop_s == float("inf") else bag.start_ns + round(stop_s * 1e9)
        latched = [topic for topic in chosen if any(offer.durability == "transient_local" for offer in bag.qos(topic))]
        before = bag.messages(latched, stop_ns=begin) if latched else ()
        # what an operator said adds up: all of it holds, not the last alone
        held = {(message.topic, message.log_ns if message.topic in AHEAD_TOPICS else 0): message for message in before}
        schemas, channels, count = bag.schemas(), bag.channels(), 0
        with BagWriter(out, flush_period_s=0.0, chunk_bytes=1024 * 1024, level=level) as writer:
            for topic in chosen:
                msgtype, schema = bag.topics[topic].msgtype, schemas[bag.topics[topic].msgtype]
                digest = channels[topic].metadata.get("topic_type_hash")
                writer.add_topic(topic, msgtype, bag.qos(topic), schema=schema.data.decode(), digest=digest, encoding=schema.encoding)
            for message in itertools.chain(held.values(), bag.messages(chosen, begin, end)):
                writer.write(message.topic, message.msgtype, message.data, message.log_ns)
                count += 1
    return count
