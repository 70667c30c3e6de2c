"""What the messages of alignment hold, as nested dicts, and what a reading of them means; see fields.py and readings.py.

Lives here: AlignmentStatus, AlignCommand, and the state of a master INS.
Does not live here: the other messages (fields.py, status_fields.py), the alignment (riins_federated).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from riins_core.rotation import dcm_from_euler
from riins_node.message_parts import MAP_NED, Fields, header
from riins_node.readings import to_ns

NAVIGATING, COASTING = 2, 3
"""Modes of NavState with a state to learn from."""
INVALID = 2
"""Validity of NavState."""


def alignment_status(status: Any) -> Fields:
    """riins_msgs/AlignmentStatus of a riins_federated AlignmentStatus."""
    names = ("roll", "pitch", "heading")
    return {
        "header": header(int(status.stamp_ns), MAP_NED),
        "phase": int(status.phase),
        "code": int(status.code),
        "method": status.method,
        **{name: float(angle) for name, angle in zip(names, status.rph, strict=True)},
        **{f"sigma_{name}": float(sigma) for name, sigma in zip(names, status.sigma, strict=True)},
        "heading_bound": float(status.bound),
        "heading_limit": float(status.limit),
        "elapsed": float(status.elapsed_s),
        "settle_time": float(status.settle_s),
        "text": status.text,
    }


def align_command(command: Any) -> Fields:
    """riins_msgs/AlignCommand of a riins_federated AlignCommand."""
    return {
        "header": header(int(command.stamp_ns), ""),
        "method": command.method,
        "time_limit": float(command.time_limit_s),
        "heading": float(command.heading),
        "sigma_heading": float(command.sigma_heading),
    }


def read_align_command(msg: Any) -> dict[str, Any]:
    """Read riins_msgs/AlignCommand: the arguments of riins_federated AlignCommand by name."""
    return {
        "stamp_ns": to_ns(msg.header.stamp),
        "method": str(msg.method),
        "time_limit_s": float(msg.time_limit),
        "heading": float(msg.heading),
        "sigma_heading": float(msg.sigma_heading),
    }


def read_master_state(msg: Any) -> dict[str, Any]:
    """Read riins_msgs/NavState of another INS: the arguments of riins_federated MasterState by name."""
    return {
        "stamp_ns": to_ns(msg.header.stamp),
        "lat": float(np.radians(msg.latitude)),
        "lon": float(np.radians(msg.longitude)),
        "h": float(msg.height),
        "v_n": np.array([msg.velocity_north, msg.velocity_east, msg.velocity_down], np.float64),
        "C_nb": dcm_from_euler(msg.roll, msg.pitch, msg.heading),
        "sigma_position": np.array([msg.sigma_north, msg.sigma_east, msg.sigma_down], np.float64),
        "sigma_velocity": np.array([msg.sigma_velocity_north, msg.sigma_velocity_east, msg.sigma_velocity_down], np.float64),
        "sigma_attitude": np.array([msg.sigma_roll, msg.sigma_pitch, msg.sigma_heading], np.float64),
        "valid": bool(msg.mode in (NAVIGATING, COASTING) and INVALID not in (msg.position_validity, msg.velocity_validity, msg.heading_validity)),
    }
