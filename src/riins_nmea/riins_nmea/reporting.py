"""What the node `nmea` tells the operator about its links and about what comes in.

Lives here: `diagnosis_out`, `diagnosis`.
Does not live here: counting (links.py, aids.py), messages (riins_node.fields).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from .aids import AidReader
from .links import Sender

Status = tuple[str, str, str, dict[str, Any]]
"""Name, level, message, values of a diagnostic_msgs/DiagnosticStatus."""


def diagnosis_out(sender: Sender, silent: bool) -> Status:
    """Status of one output; `silent`: there is no navigation state, the sentences say invalid."""
    values = {"sentences sent": sender.sent, "sentences not sent": sender.failed}
    problem = sender.problem or ("no nav/state: the sentences say invalid" if silent else "")
    return f"nmea: {sender.link.text}", "warn" if problem else "ok", problem or "sending", values


def diagnosis(reader: AidReader, problems: Sequence[str], too_long: int) -> list[Status]:
    """Status of each aid that is wanted, and of what was rejected.

    Parameters
    ----------
    reader : its counters
    problems : of the inputs, one line each
    too_long : lines without an end
    """
    statuses: list[Status] = []
    rejected = {f"{sentence or 'unreadable'}: {reason}": number for (sentence, reason), number in sorted(reader.rejected.items())}
    if too_long:
        rejected["unreadable: too long"] = rejected.get("unreadable: too long", 0) + too_long
    for aid, sentence in reader.wanted.items():
        bad = {reason: number for (kind, reason), number in sorted(reader.rejected.items()) if kind == sentence}
        news = reader.news(aid, sentence)
        words = {"": "receiving", "silent": f"no {sentence} since the last report", "rejected": f"{sentence} rejected: {', '.join(bad)}"}
        statuses.append((f"nmea: {aid}", "warn" if news else "ok", words[news], {"accepted": reader.accepted[aid], **bad}))
    level, text = ("error", "; ".join(problems)) if problems else ("ok", f"{sum(rejected.values())} sentences rejected so far")
    statuses.append(("nmea: inputs", level, text, {"unused": reader.unused, **rejected}))
    return statuses
