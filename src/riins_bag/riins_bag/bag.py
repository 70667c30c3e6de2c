"""Bags: the names that other packages import.

Lives here: `BagWriter`, `BagReader`, `BagError`, `typestore`, `message`, `serialize`, `deserialize`, gathered from their modules.
Does not live here: any code; recovery is `riins_bag.recover`, a summary of a bag `riins_bag.info`.
"""

from riins_bag.errors import BagError
from riins_bag.qos import Qos
from riins_bag.reader import BagReader, Message, Topic
from riins_bag.typesys import deserialize, message, schema_text, serialize, type_hash, typestore
from riins_bag.writer import CONFIGURATION_TOPIC, BagWriter

__all__ = [
    "CONFIGURATION_TOPIC",
    "BagError",
    "BagReader",
    "BagWriter",
    "Message",
    "Qos",
    "Topic",
    "deserialize",
    "message",
    "schema_text",
    "serialize",
    "type_hash",
    "typestore",
]
