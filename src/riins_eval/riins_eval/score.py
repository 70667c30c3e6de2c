"""The score of a run: one dictionary with stable names, documented in docs/json.md, and the verdict against what a scenario expects.

Lives here: `score`, `score_bag`, `verdict`, `table`.
Does not live here: the measures themselves (metrics.py), where the arrays come from (offline.py, bag_record.py).
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from . import metrics
from .run_record import COMPENSATED, HEALTHY, SENSOR_REASONS, SENSOR_STATES, SUSPECT, FaultInterval, HealthChange, RunRecord, is_imu_sensor

ARCMIN = 180.0 * 60.0 / math.pi
Score = dict[str, Any]


def score(record: RunRecord) -> Score:
    """Score a run.

    Parameters
    ----------
    record : of a simulated, recorded or imported run

    Returns
    -------
    dict, JSON-ready, keys as in docs/json.md; None (null) where the run does not say
    """
    result = _numbers(record)
    unknown = not len(record.settled) or (bool(record.pieces) and not np.isfinite(record.truth.lat).any())
    result["scored"] = "sensors" if unknown else "navigation"
    result["samples"] = {
        "received": record.samples.received, "lost": record.samples.lost, "late": record.samples.late, "rejected": record.samples.rejected,
        "no_fix": record.samples.no_fix,
    }  # fmt: skip
    result["realtime_factor"] = _number(record.realtime_factor)
    result["pieces"] = []
    for name, start_ns, stop_ns in record.pieces:
        piece = record.between(start_ns, stop_ns)
        # the scoring window of a recording is counted from the start of each piece
        piece.scoring_from_ns = start_ns + max(0, record.scoring_from_ns - record.pieces[0][1])
        result["pieces"].append({**_numbers(piece), "name": name})
    if record.pieces:
        whole = _over_pieces(result["pieces"])
        result.update(whole)
    result["notes"] = list(record.notes)
    return result


def score_bag(bag: str | Path, twins: bool | None = None, progress: Callable[[float, float], None] | None = None) -> Score:
    """Score a recorded run.

    Parameters
    ----------
    bag : rosbag2 directory with /nav/settled and a truth (/truth/state or /truth/odometry); without them the sensors alone are scored
    twins : sail the fault-free twin and the oracle again where the bag lacks them; None: where it is cheap
    progress : called with (seconds done, seconds in all)

    Returns
    -------
    dict as of `score`

    Raises
    ------
    RecordError
        The bag lacks what scoring needs.
    """
    from .bag_record import read_record

    return score(read_record(bag, twins=twins, progress=progress))


def verdict(result: Mapping[str, Any], expect: Mapping[str, Any]) -> list[str]:
    """What a scenario promises and the score does not hold.

    Parameters
    ----------
    result : of `score`
    expect : key -> limit. A key is a name of the score, dots lead into it (`samples.lost`, `oracle_ratio.heading`, `nis_per_dof.gps`). A limit is
        a mapping of `min`, `max`, `equals`, or a value that must be equal. `isolated: [targets]`: each was isolated, and nothing healthy with it;
        `detected: [targets]`; `not_isolated: [targets]`: never isolated rightly or wrongly.

    Returns
    -------
    list of sentences, empty when everything holds
    """
    failures: list[str] = []
    for key, limit in expect.items():
        if key in ("isolated", "detected"):
            failures += _missing_targets(result, key, limit)
        elif key == "not_isolated":
            bad = {f["target"] for f in result["faults"] if f["isolated_right"]} | {f["target"] for f in result["false_isolations_list"]}
            failures += [f"{target} was isolated" for target in limit if target in bad]
        else:
            failures += _limit(result, key, limit)
    return failures


def table(result: Mapping[str, Any]) -> list[tuple[str, str, str]]:
    """Rows (what, value, unit) of the score for people, in a fixed order."""
    ratio, samples = result["oracle_ratio"], result["samples"]
    rows = [
        ("position error, RMS horizontal", _text(result["position_rms_m"], 2), "m"),
        ("position error, largest", _text(result["position_max_m"], 2), "m"),
        ("velocity error, RMS horizontal", _text(result["velocity_rms_mps"], 4), "m/s"),
        ("heading error, RMS", _text(result["heading_rms_arcmin"], 3), "arcmin"),
        ("roll and pitch error, RMS", _text(result["tilt_rms_arcmin"], 3), "arcmin"),
        ("NEES per degree of freedom (1: consistent)", _text(result["nees_per_dof"], 2), ""),
    ]
    rows += [(f"NIS per degree of freedom, {name}", _text(value, 2), "") for name, value in result["nis_per_dof"].items()]
    if any(v is not None for v in ratio.values()):
        rows.append(("to the oracle: position, velocity, heading", ", ".join(_text(ratio[k], 3) for k in ("position", "velocity", "heading")), ""))
    if result["twin_deviation_max_m"] is not None:
        rows.append(("largest distance from the fault-free twin", _text(result["twin_deviation_max_m"], 2), "m"))
    if result["alignment"] is not None:
        found = result["alignment"]
        how = f"{found['method']}, {_text(found['elapsed_s'], 0)} s" if found["aligned"] else found["text"]
        rows.append(("alignment", how, ""))
        rows.append(("heading error at its end", _text(found["heading_error_arcmin"], 2), "arcmin"))
        rows.append(("heading settled after (A.821)", _text(found["settle_s"], 0), "s"))
    rows.append(("false isolations", str(result["false_isolations"]), ""))
    rows += [
        (f"samples {name}", _text(samples[name], 0), "") for name in ("received", "lost", "late", "rejected", "no_fix") if samples[name] is not None
    ]
    if result["realtime_factor"] is not None:
        rows.append(("speed", _text(result["realtime_factor"], 0 if result["realtime_factor"] >= 10 else 1), "x real time"))
    return rows


def sensor_rows(result: Mapping[str, Any]) -> list[tuple[str, str, str, str, str]]:
    """Rows (sensor, state, first change, reason, drift) of the inertial sensors that ever changed, for people."""
    rows = []
    for sensor in result["sensors"]:
        if sensor["first_change_s"] is not None:
            scale, unit = (math.degrees(1.0), "deg/s") if sensor["kind"] == "gyro" else (1.0, "m/s^2")
            drift = f"{sensor['drift'] * scale:+.3g} {unit}" if sensor["drift"] else "-"
            rows.append((f"{sensor['kind']}_{sensor['index']}", sensor["state"], f"{sensor['first_change_s']:.2f} s", sensor["reason"], drift))
    return rows


def fault_rows(result: Mapping[str, Any]) -> list[tuple[str, str, str, str, str, str, str]]:
    """Rows (target, type, onset, detected, delay, isolated right, fused) of the fault table for people."""
    rows = []
    for fault in result["faults"]:
        yes = {True: "yes", False: "no", None: "-"}
        delay = "-" if fault["delay_s"] is None else f"{fault['delay_s']:.2f} s"
        fused = "-" if fault["epochs_fused"] is None else str(fault["epochs_fused"])
        kind = f"{fault['type']} {fault['size']}".strip()
        rows.append((fault["target"], kind, f"{fault['onset_s']:.1f} s", yes[fault["detected"]], delay, yes[fault["isolated_right"]], fused))
    return rows


def _numbers(record: RunRecord) -> Score:
    settled, truth = record.settled, record.truth
    window = settled.stamp_ns >= record.scoring_from_ns
    scored, reference = settled.take(window), truth.take(window)
    position = metrics.position_error(scored, reference)[:, :2]
    velocity = (scored.v_n - reference.v_n)[:, :2]
    tilt = metrics.attitude_error(scored, reference)[:, :2]
    heading = metrics.heading_error(scored, reference)
    length = np.hypot(*position.T)
    nees = metrics.nees7(scored, reference, record.covariance[window]) if record.covariance is not None else np.zeros(0)
    nees = nees[np.isfinite(nees)]
    wrong = metrics.false_isolations(record.health, record.faults)
    return {
        "name": record.name,
        "duration_s": _seconds(record.last_ns - record.start_ns) if record.last_ns else None,
        "epochs": int(np.isfinite(length).sum()),
        "position_rms_m": _number(metrics.rms(position)),
        "velocity_rms_mps": _number(metrics.rms(velocity)),
        "heading_rms_arcmin": _number(metrics.rms(heading) * ARCMIN),
        "tilt_rms_arcmin": _number(metrics.rms(tilt) * ARCMIN / math.sqrt(2.0)),
        "position_max_m": _number(np.nanmax(length) if np.isfinite(length).any() else None),
        "velocity_max_mps": _number(np.nanmax(np.hypot(*velocity.T)) if np.isfinite(velocity).any() else None),
        "heading_max_arcmin": _number(np.nanmax(np.abs(heading)) * ARCMIN if np.isfinite(heading).any() else None),
        "nees_per_dof": _number(np.mean(nees) / len(metrics.NEES7) if len(nees) else None),
        "nis_per_dof": {name: _number(metrics.nis_per_dof(j, _of(record.faults, name))) for name, j in sorted(record.judged.items())},
        "oracle_ratio": _ratio(record, window, position, velocity, heading),
        "twin_deviation_max_m": _twin(record),
        "faults": [_fault(record, fault) for fault in sorted(record.faults, key=lambda f: f.start_ns)],
        "missed_isolations": sum(not _outcome(record, f).isolated for f in record.faults),
        "alignment": _alignment(record),
        "false_isolations": len(wrong),
        "false_isolations_list": [_change(record, c) for c in wrong],
        "sensors": _sensors(record),
        "subfilters": {name: _subfilter(record, name) for name in sorted(record.judged)},
    }  # fmt: skip


def _alignment(record: RunRecord) -> Score | None:
    """How the attitude was found; the heading error is that of the first settled epoch after."""
    if not record.alignments:
        return None
    found = record.alignments[-1]
    after = record.settled.stamp_ns >= found.ended_ns
    error = metrics.heading_error(record.settled.take(after), record.truth.take(after)) if found.aligned and after.any() else np.zeros(0)
    return {
        "method": found.method, "aligned": found.aligned, "text": found.text, "elapsed_s": _seconds(found.ended_ns - found.began_ns),
        "heading_error_arcmin": _number(error[0] * ARCMIN if len(error) else None), "settle_s": found.settle_s if found.settle_s >= 0.0 else None,
    }  # fmt: skip


def _fault(record: RunRecord, fault: FaultInterval) -> Score:
    outcome = _outcome(record, fault)
    return {
        "target": fault.target, "type": fault.type, "size": fault.size_text,
        "onset_s": _seconds(fault.start_ns - record.start_ns), "end_s": _seconds(fault.end_ns - record.start_ns),
        "detected": outcome.detected, "delay_s": _number(outcome.delay_s), "isolated_right": outcome.isolated_right,
        "compensated": outcome.compensated, "wrongly_isolated": list(outcome.wrong), "epochs_fused": _epochs_fused(record, fault),
    }  # fmt: skip


def _outcome(record: RunRecord, fault: FaultInterval) -> metrics.FaultOutcome:
    return metrics.fault_outcome(fault, record.faults, record.health, record.judged.get(fault.target))


def _epochs_fused(record: RunRecord, fault: FaultInterval) -> int | None:
    if not is_imu_sensor(fault.target):
        judged = record.judged.get(fault.target)
        return metrics.epochs_accepted(judged, fault) if judged is not None else None
    if record.use is None:
        return None
    declared = metrics.declared_at(fault, record.health)
    if declared is None:  # never declared: every sample of the fault went in
        return record.use.samples_with(fault.target, fault.start_ns, fault.end_ns)
    # from the declaration to the return, but for the time in which it is used without its drift
    later = sorted((c for c in record.health if c.target == fault.target and declared <= c.stamp_ns < fault.end_ns), key=lambda c: c.stamp_ns)
    count, since, out = 0, declared, True
    for change in later:
        count += record.use.samples_with(fault.target, since, change.stamp_ns) if out else 0
        since, out = change.stamp_ns, change.state not in (COMPENSATED, SUSPECT)
        if change.state == HEALTHY:
            return count
    return count + (record.use.samples_with(fault.target, since, fault.end_ns) if out else 0)


def _sensors(record: RunRecord) -> list[Score]:
    """State of every inertial sensor at the end, gyros first."""
    listed = []
    for number, kind in enumerate(("gyro", "accel")):
        for index in range(record.n_sensors):
            own = [c for c in record.health if c.target == f"{kind}_{index}"]
            state, reason = (own[-1].state, own[-1].reason) if own else (HEALTHY, 0)
            first = _seconds(own[0].stamp_ns - record.start_ns) if own else None
            drift = _number(record.drift[number, index]) if record.drift is not None else None
            words = {"state": SENSOR_STATES[state], "first_change_s": first, "reason": SENSOR_REASONS[reason], "drift": drift}
            listed.append({"kind": kind, "index": index, **words})
    return listed


def _subfilter(record: RunRecord, name: str) -> Score:
    judged, faults = record.judged[name], _of(record.faults, name)
    return {
        "judged": len(judged.stamp_ns), "accepted": int(judged.accepted.sum()), "rejected": int((~judged.accepted).sum()),
        "good_rejected": metrics.good_rejected(judged, faults), "nis_per_dof": _number(metrics.nis_per_dof(judged, faults)),
    }  # fmt: skip


def _ratio(record: RunRecord, window: Any, position: Any, velocity: Any, heading: Any) -> dict[str, float | None]:
    if record.oracle is None:
        return {"position": None, "velocity": None, "heading": None}
    oracle, truth = record.oracle.take(window), record.truth.take(window)
    own = (metrics.rms(position), metrics.rms(velocity), metrics.rms(heading))
    told = (
        metrics.rms(metrics.position_error(oracle, truth)[:, :2]),
        metrics.rms((oracle.v_n - truth.v_n)[:, :2]),
        metrics.rms(metrics.heading_error(oracle, truth)),
    )
    return {key: _number(a / b if b > 0.0 else None) for key, a, b in zip(("position", "velocity", "heading"), own, told, strict=True)}


def _twin(record: RunRecord) -> float | None:
    if record.twin is None or not len(record.twin):
        return None
    distance = metrics.horizontal_distance(record.settled, record.twin)
    return _number(np.nanmax(distance) if np.isfinite(distance).any() else None)


def _change(record: RunRecord, change: HealthChange) -> Score:
    return {"target": change.target, "time_s": _seconds(change.stamp_ns - record.start_ns), "reason": change.reason}


def _of(faults: list[FaultInterval], name: str) -> list[FaultInterval]:
    return [f for f in faults if f.target == name]


def _over_pieces(pieces: list[Score]) -> Score:
    """RMS, NEES and maxima of a recording from those of its pieces: each piece has its own scoring window."""
    total: Score = {}
    for key in ("position_rms_m", "velocity_rms_mps", "heading_rms_arcmin", "tilt_rms_arcmin"):
        known = [(p[key] ** 2, p["epochs"]) for p in pieces if p[key] is not None]
        total[key] = _number(math.sqrt(sum(s * n for s, n in known) / sum(n for _, n in known)) if known else None)
    for key in ("position_max_m", "velocity_max_mps", "heading_max_arcmin"):
        total[key] = max((p[key] for p in pieces if p[key] is not None), default=None)
    known = [(p["nees_per_dof"], p["epochs"]) for p in pieces if p["nees_per_dof"] is not None]
    total["nees_per_dof"] = _number(sum(v * n for v, n in known) / sum(n for _, n in known) if known else None)
    total["epochs"] = sum(p["epochs"] for p in pieces)
    total["duration_s"] = sum(p["duration_s"] or 0.0 for p in pieces)
    return total


def _missing_targets(result: Mapping[str, Any], key: str, targets: Any) -> list[str]:
    flag, words = ("isolated_right", "rightly isolated") if key == "isolated" else ("detected", "detected")
    failures = []
    for target in [targets] if isinstance(targets, str) else targets:
        own = [f for f in result["faults"] if f["target"] == target]
        if not own:
            failures.append(f"{target}: expected to be {words}, but no fault was put on it")
        failures += [f"{target}: the {f['type']} at {f['onset_s']:.0f} s was not {words}" for f in own if not f[flag]]
    return failures


def _limit(result: Mapping[str, Any], key: str, limit: Any) -> list[str]:
    value: Any = result
    for part in key.split("."):
        if not isinstance(value, Mapping) or part not in value:
            near = difflib.get_close_matches(part, list(value) if isinstance(value, Mapping) else [], n=1)
            return [f'"{key}" is no number of the score' + (f' (did you mean "{near[0]}"?)' if near else "")]
        value = value[part]
    bounds = limit if isinstance(limit, Mapping) else {"equals": limit}
    failures = []
    for word, bound in bounds.items():
        if word not in ("min", "max", "equals"):
            failures.append(f'{key}: a limit is "min", "max" or "equals", not "{word}"')
        elif value is None:
            failures.append(f"{key} is not known, but must be {_words(word)} {bound}")
        elif word != "equals" and not isinstance(value, int | float):
            failures.append(f'"{key}" is no number of the score: it cannot be {_words(word)} {bound}')
        elif (word == "min" and value < bound) or (word == "max" and value > bound) or (word == "equals" and value != bound):
            failures.append(f"{key} is {value if isinstance(value, int) else format(value, '.4g')}, must be {_words(word)} {bound}")
    return failures


def _words(word: str) -> str:
    return {"min": "at least", "max": "at most", "equals": "equal to"}[word]


def _number(value: Any) -> float | None:
    """A JSON number, or None for what is not finite."""
    return float(value) if value is not None and math.isfinite(value) else None


def _seconds(ns: Any) -> float:
    """Nanoseconds in seconds; a division, so that round stamps give round numbers."""
    return int(ns) / 1e9


def _text(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:,.{digits}f}"
