"""Parameters of the navigator, with description, unit and range.

Lives here: `NavigatorConfig` and its own sections; the node's ROS parameters and a scenario's `navigator` section are these.
Does not live here: sections of aids (aids/), how a scenario becomes a configuration (riins_eval.configure), declaration (riins_node.parameters).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from riins_core.settings import SettingError, declared, section, setting

from .aid_inputs import check_aids
from .aids import DEFAULT_AIDS, aid_settings
from .alignment_settings import AlignmentSettings
from .damping import DampingSettings, check_damping
from .inertial_model import InertialModel
from .known_height import HeightAid
from .state_blocks import StateModel
from .structure_settings import STRUCTURES, Sharing, SolutionSeparation


@dataclass(frozen=True)
class Isolation:
    """Fault test of the subfilters."""

    false_alarm_probability: float = setting(1e-5, "probability that a good measurement fails the innovation test", "", 1e-15, 0.5)
    mean_time_between_false_alarms_h: float = setting(
        0.0, "of each aid, from which and its period the probability follows; 0: false_alarm_probability", "h", 0.0, 1e9
    )
    isolate_after: int = setting(3, "consecutive failed tests until the subfilter is isolated", "", 1, 1000)
    hold_s: float = setting(30.0, "an isolated subfilter stays so at least this long after its last failed test", "s", 0.0, 1e5)
    readmit_after: int = setting(3, "consecutive passed tests on probation until it is fused again", "", 1, 1000)


@dataclass(frozen=True)
class ValidityLimits:
    """Limits of the validity flags: valid up to the first, invalid beyond the second (95 % radius, 1.96 sigma)."""

    position_m: float = setting(100.0, "position valid up to this 95 % radius", "m", 0.0, 1e6)
    position_invalid_m: float = setting(1000.0, "position invalid beyond", "m", 0.0, 1e7)
    velocity_mps: float = setting(0.5, "velocity valid up to this 95 % radius", "m/s", 0.0, 1e3)
    velocity_invalid_mps: float = setting(5.0, "velocity invalid beyond", "m/s", 0.0, 1e3)
    heading_deg: float = setting(0.75, "heading valid up to this 95 % error, times sec(latitude) (A.821)", "deg", 0.0, 180.0)
    heading_invalid_deg: float = setting(3.0, "heading invalid beyond, times sec(latitude)", "deg", 0.0, 180.0)
    integrity_risk: float = setting(1e-5, "probability that the horizontal error leaves the protection radius", "", 1e-15, 0.5)


@dataclass(frozen=True)
class NavigatorConfig:
    """Everything the navigator needs to know before it starts."""

    structure: str = setting(
        "separated",
        "separated: exact master, and masters that leave aids out, whose solutions are compared; information: exact master; fusion_reset, no_reset, "
        "partial: local filters that keep none, all or a part of themselves when they are fused",
        choices=STRUCTURES,
    )
    retention: float = setting(0.5, "partial: the part of its information that a local filter keeps", "", 0.0, 1.0)
    max_delay_s: float = setting(
        2.0, "a measurement later than this, by IMU time, is counted and dropped; an IMU stamp that jumps by more restarts the run", "s", 0.05, 600.0
    )
    max_gap_s: float = setting(
        20.0, "a jump by more than max_delay_s and up to this is bridged where as many numbers of samples are missing; what the motion of the last "
        "minute leaves unknown of attitude and velocity is uncertainty", "s", 0.0, 600.0,
    )  # fmt: skip
    covariance_period_s: float = setting(1.0, "interval of the covariance propagation", "s", 0.01, 60.0)
    settle_period_s: float = setting(1.0, "interval of the settled state", "s", 0.01, 3600.0)
    feedback_period_s: float = setting(
        0.0, "output correction for this long, then feedback, and the uncorrected solution on nav/inertial; 0: feedback at every measurement",
        "s", 0.0, 1e6,
    )  # fmt: skip
    calibration_period_s: float = setting(10.0, "interval at which the fusion is told the inertial biases, measurement time; 0: never", "s", 0.0, 1e5)
    calibration_lead_s: float = setting(
        20.0, "they hold from this much later on: more than max_delay_s and what the fusion may be ahead (10 s offline)", "s", 0.05, 1e5
    )
    states: tuple[str, ...] = setting(
        ("gyro_markov",), "states beyond the fifteen of the INS, for the inertial sensors: gyro_markov, accel_markov, gyro_scale, accel_scale"
    )
    inertial: InertialModel = section(InertialModel, "error model of the fused triad")
    aids: tuple[str, ...] = setting(tuple(DEFAULT_AIDS), "names of the aids; each has a section of its own, whose type says what it is")
    aid: Mapping[str, Any] = declared("aids", aid_settings, DEFAULT_AIDS)
    height: HeightAid = section(HeightAid, "mean height")
    damping: DampingSettings = section(DampingSettings, "horizontal damping")
    isolation: Isolation = section(Isolation, "fault test")
    separation: SolutionSeparation = section(SolutionSeparation, "separation of solutions")
    sharing: Sharing = section(Sharing, "information shares")
    validity: ValidityLimits = section(ValidityLimits, "validity flags")
    alignment: AlignmentSettings = section(AlignmentSettings, "finding the attitude where no initial state is given")

    def __post_init__(self) -> None:
        StateModel(self.inertial, self.states)
        check_aids(self.aid)
        for name, aid in self.aid.items():
            if aid.false_alarm_probability and aid.mean_time_between_false_alarms_h:
                raise SettingError(f'"{name}" has a false-alarm probability and a mean time between false alarms: one of them', (name,))
        check_damping(self.damping, self.aid, self.feedback_period_s)
        if self.calibration_lead_s <= self.max_delay_s:
            raise SettingError('"calibration_lead_s" must exceed "max_delay_s": it would come too late')
        limits = self.validity
        for name in ("position_m", "velocity_mps", "heading_deg"):
            stem, unit = name.rsplit("_", 1)
            if getattr(limits, name) > getattr(limits, f"{stem}_invalid_{unit}"):
                raise SettingError(f'"validity.{name}" must not exceed "validity.{stem}_invalid_{unit}"')


@dataclass(frozen=True)
class NodeConfig(NavigatorConfig):
    """Parameters of the node: the navigator's, and how its results are published."""

    datum: tuple[float, ...] = setting((), "origin of the frame map: latitude [deg], longitude [deg], height [m]; empty: the initial position")
    state_period_s: float = setting(0.0, "interval of nav/state and imu/data; 0: every IMU sample", "s", 0.0, 10.0)
    odometry_period_s: float = setting(0.05, "interval of nav/odometry and nav/fix; 0: every IMU sample", "s", 0.0, 10.0)
    imu_topic_type: str = setting(
        "fused", "fused: imu/fused of imu_fusion; imu: an ordinary IMU, sensor_msgs/Imu on imu/data_raw, without fusion", choices=("fused", "imu")
    )
    imu_values: str = setting("instant", "an ordinary IMU's values: at its stamp, or means since the last one", choices=("instant", "mean"))
    imu_rate_hz: float = setting(0.0, "nominal rate of an ordinary IMU, by which its losses are counted; 0: they are not", "Hz", 0.0, 1e5)
    imu_timeout_s: float = setting(1.0, "wall time without a sample after which the node says that there is no IMU", "s", 0.05, 100.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.datum) not in (0, 3):
            raise SettingError(f'"datum" must be empty or latitude, longitude, height, not {len(self.datum)} numbers')
