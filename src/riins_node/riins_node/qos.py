"""QoS profiles of the graph by purpose, all of them overridable by parameter.

Lives here: `imu`, `aid`, `navigation`, `latched`, `overridable`.
Does not live here: topic names and message types (each node).
"""

from __future__ import annotations

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSPolicyKind, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions


def imu(depth: int = 400) -> QoSProfile:
    """Profile of the redundant and the fused IMU: reliable, 2 s deep at 200 Hz; samples are numbered, so a loss is known all the same."""
    return _profile(depth, DurabilityPolicy.VOLATILE)


def aid(depth: int = 100) -> QoSProfile:
    """Profile of GPS, BDS and log: reliable, more than 2 s deep at every rate such a sensor has."""
    return _profile(depth, DurabilityPolicy.VOLATILE)


def navigation(depth: int = 400) -> QoSProfile:
    """Profile of what the navigator publishes: reliable."""
    return _profile(depth, DurabilityPolicy.VOLATILE)


def latched(depth: int = 1) -> QoSProfile:
    """Profile of what a late joiner needs: reliable and transient-local."""
    return _profile(depth, DurabilityPolicy.TRANSIENT_LOCAL)


def overridable() -> QoSOverridingOptions:
    """Declare a parameter `qos_overrides./TOPIC.publisher|subscription.POLICY` for every policy of an endpoint."""
    return QoSOverridingOptions(
        [
            QoSPolicyKind.HISTORY,
            QoSPolicyKind.DEPTH,
            QoSPolicyKind.RELIABILITY,
            QoSPolicyKind.DURABILITY,
            QoSPolicyKind.DEADLINE,
            QoSPolicyKind.LIFESPAN,
            QoSPolicyKind.LIVELINESS,
            QoSPolicyKind.LIVELINESS_LEASE_DURATION,
        ]
    )


def _profile(depth: int, durability: DurabilityPolicy) -> QoSProfile:
    return QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=depth, reliability=ReliabilityPolicy.RELIABLE, durability=durability)
