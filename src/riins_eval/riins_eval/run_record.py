"""What a finished run says about itself, as plain arrays.

Lives here: `RunRecord` and its parts, filled by the offline engine (offline.py) or from a bag (bag_record.py), read by score.py and report.py.
Does not live here: any computation on it (metrics.py, score.py), ROS messages (bag_record.py), drawing (report.py).
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Stamps = NDArray[np.int64]

HEALTHY, SUSPECT, ISOLATED, PROBATION = 0, 1, 2, 3
"""States of health that TriadFdi and SubfilterStatus number alike; 4 and 5 differ, see the messages."""
COMPENSATED, ABSENT = 4, 4
"""TriadFdi.COMPENSATED of an inertial sensor, SubfilterStatus.ABSENT of an aid."""

SENSOR_STATES = ("healthy", "suspect", "isolated", "probation", "compensated", "excluded")
SUBFILTER_STATES = ("healthy", "suspect", "isolated", "probation", "absent", "excluded")
SENSOR_REASONS = ("none", "parity", "stuck", "not finite", "saturated", "invalid", "operator", "recovered")
SUBFILTER_REASONS = (
    "none", "innovation", "hold", "late", "not finite", "no fix", "covariance", "operator", "separation", "not ready", "duplicate",
    "innovations", "frame",
)  # fmt: skip
FAULT_TYPES = ("step", "ramp", "stuck", "noise", "scale", "dropout")


def is_imu_sensor(target: str) -> bool:
    """Whether a fault target or health target is a sensor of the redundant IMU (`gyro_3`, `accel_0`) and not an aid."""
    return target.startswith(("gyro_", "accel_"))


@dataclasses.dataclass
class Track:
    """States at m epochs.

    Attributes
    ----------
    stamp_ns : (m,) int64, strictly increasing
    lat, lon : (m,) rad, WGS-84
    h : (m,) m above the ellipsoid
    v_n : (m, 3) m/s, NED
    rph : (m, 3) rad, roll, pitch, heading
    """

    stamp_ns: Stamps
    lat: Floats
    lon: Floats
    h: Floats
    v_n: Floats
    rph: Floats

    def __len__(self) -> int:
        return len(self.stamp_ns)

    def take(self, index: NDArray[Any]) -> Track:
        """The epochs of a mask or an index array."""
        return Track(*(getattr(self, f.name)[index] for f in dataclasses.fields(self)))

    def at(self, stamp_ns: Stamps) -> Track | None:
        """The track at exactly these stamps; None when it has not all of them."""
        index = np.clip(np.searchsorted(self.stamp_ns, stamp_ns), 0, max(len(self) - 1, 0))
        if not len(self) or (self.stamp_ns[index] != stamp_ns).any():
            return None
        return self.take(index)

    @classmethod
    def empty(cls) -> Track:
        """A track of no epoch."""
        z = np.zeros(0)
        return cls(np.zeros(0, np.int64), z, z, z, np.zeros((0, 3)), np.zeros((0, 3)))


@dataclasses.dataclass
class Judged:
    """Innovations of one subfilter, k measurements of d components, in the order they were judged.

    Attributes
    ----------
    stamp_ns : (k,) int64, measurement time
    innovation, sigma, standardized : (k, d) m or m/s; NaN where a component was not measured
    nis : (k,) normalized innovation squared
    threshold : (k,) what the NIS was compared with
    accepted : (k,) bool, it entered the navigation state
    reason : (k,) int, SubfilterStatus REASON_*
    """

    stamp_ns: Stamps
    innovation: Floats
    sigma: Floats
    standardized: Floats
    nis: Floats
    threshold: Floats
    accepted: NDArray[np.bool_]
    reason: NDArray[np.int64]

    def take(self, index: NDArray[Any]) -> Judged:
        """The measurements of a mask or an index array."""
        return Judged(*(getattr(self, f.name)[index] for f in dataclasses.fields(self)))


@dataclasses.dataclass(frozen=True)
class HealthChange:
    """A sensor or a subfilter changed its state of health.

    Attributes
    ----------
    stamp_ns : measurement time from which the new state holds
    target : gyro_0 .., accel_0 .., gps, bds, doppler
    state : index into SENSOR_STATES or SUBFILTER_STATES
    reason : index into SENSOR_REASONS or SUBFILTER_REASONS
    """

    stamp_ns: int
    target: str
    state: int
    reason: int = 0

    @property
    def state_name(self) -> str:
        """The state in a word."""
        return (SENSOR_STATES if is_imu_sensor(self.target) else SUBFILTER_STATES)[self.state]

    @property
    def operator(self) -> bool:
        """Done on the operator's word, thus no decision of ours."""
        return (SENSOR_REASONS if is_imu_sensor(self.target) else SUBFILTER_REASONS)[self.reason] == "operator"


@dataclasses.dataclass(frozen=True)
class FaultInterval:
    """A fault as it was injected: in force at stamps in [start_ns, end_ns).

    Attributes
    ----------
    target, type : as in the scenario (FAULT_TYPES)
    size_text : size with unit, for people
    """

    target: str
    type: str
    start_ns: int
    end_ns: int
    size_text: str = ""

    def covers(self, stamp_ns: Stamps) -> NDArray[np.bool_]:
        """(m,) bool: in force at the stamps."""
        return (stamp_ns >= self.start_ns) & (stamp_ns < self.end_ns)


@dataclasses.dataclass
class SensorUse:
    """Which IMU sensors entered the fused samples: runs of samples with the same bit masks.

    Attributes
    ----------
    first_ns, last_ns : (r,) int64, stamp of the first and the last sample of the run
    count : (r,) int64, samples in it
    gyro, accel : (r,) uint64, bit i set: sensor i entered
    """

    first_ns: Stamps
    last_ns: Stamps
    count: NDArray[np.int64]
    gyro: NDArray[np.uint64]
    accel: NDArray[np.uint64]

    @classmethod
    def from_samples(cls, stamp_ns: Stamps, gyro: NDArray[np.uint64], accel: NDArray[np.uint64]) -> SensorUse:
        """Run lengths of per-sample masks, all (m,)."""
        if not len(stamp_ns):
            empty, none = np.zeros(0, np.int64), np.zeros(0, np.uint64)
            return cls(empty, empty, empty, none, none)
        first = np.flatnonzero(np.r_[True, (np.diff(gyro) != 0) | (np.diff(accel) != 0)])
        last = np.r_[first[1:], len(stamp_ns)] - 1
        return cls(stamp_ns[first], stamp_ns[last], (last - first + 1).astype(np.int64), gyro[first], accel[first])

    @classmethod
    def concatenate(cls, parts: list[SensorUse]) -> SensorUse:
        """Runs of consecutive blocks one after the other (a run may stay cut at a block's edge)."""
        names = [f.name for f in dataclasses.fields(cls)]
        parts = parts or [cls.from_samples(np.zeros(0, np.int64), np.zeros(0, np.uint64), np.zeros(0, np.uint64))]
        return cls(*(np.concatenate([getattr(p, n) for p in parts]) for n in names))

    def samples_with(self, target: str, start_ns: int, end_ns: int) -> int:
        """Samples with stamps in [start_ns, end_ns) that the IMU sensor `target` entered (evenly spaced within a run)."""
        kind, number = target.rsplit("_", 1)
        masks = self.gyro if kind == "gyro" else self.accel
        used = (masks >> np.uint64(int(number))) & np.uint64(1) == 1
        step = np.where(self.count > 1, (self.last_ns - self.first_ns) / np.maximum(self.count - 1, 1), 1.0)
        # number of samples of the run that lie before a stamp s: ceil((s - first) / step) within 0 .. count
        before_end = np.clip(np.ceil((end_ns - self.first_ns) / step), 0, self.count)
        before_start = np.clip(np.ceil((start_ns - self.first_ns) / step), 0, self.count)
        return int(np.sum((before_end - before_start)[used]))


@dataclasses.dataclass(frozen=True)
class Samples:
    """Counters of what came in. None: not known (the bag lacks the topic).

    Attributes
    ----------
    received : IMU samples received by the fusion
    lost : IMU samples missing in the sequence numbers
    late : aid measurements older than max_delay, dropped
    rejected : IMU samples and aid measurements that were malformed (length, stamp, not finite, covariance) and not used
    no_fix : aid measurements that the sensor itself said to be none
    """

    received: int | None = None
    lost: int | None = None
    late: int | None = None
    rejected: int | None = None
    no_fix: int | None = None


@dataclasses.dataclass(frozen=True)
class Alignment:
    """One alignment.

    Attributes
    ----------
    method, text : of its last report
    aligned : it ended in a state
    began_ns, ended_ns : of its beginning and its last report
    settle_s : from its beginning until the heading given out had settled; negative: it did not
    """

    method: str
    text: str
    aligned: bool
    began_ns: int
    ended_ns: int
    settle_s: float = -1.0


@dataclasses.dataclass
class RunRecord:
    """Everything that scoring and reporting need of one run.

    Attributes
    ----------
    name : scenario or recording
    description : one sentence
    settled : Track, m settled epochs (1 Hz)
    truth : Track, the reference at the same m stamps, NaN where it is not known
    covariance : (m, n, n) of the error state (riins_core.ins_error.State order), or (m, 7, 7) of NEES7, or None
    protection_radius : (m,) m
    mode : (m,) NavState MODE_*
    judged : by subfilter
    health : changes in order of time
    faults : what was injected
    origin_ns : where times of this run count from; None: the first settled epoch
    scoring_from_ns : epochs before it do not count in RMS, NEES, NIS
    use : which IMU sensors were fused, None when not known
    samples : counters
    n_sensors : sensors of each kind
    twin : the fault-free twin (same noise, no fault) at the same stamps, None when not known
    oracle : the same navigator, told the fault intervals, at the same stamps, None when not known
    realtime_factor : simulated or recorded seconds per second of computing
    pieces : (name, first stamp, last stamp) of the pieces of an imported recording; empty: one run
    aid_fixes : positions of the position aids {name: (stamp_ns, lat, lon)}, for the track
    expect : what the scenario promises (score.verdict)
    notes : what the reader must know (simulated aids, unknown things)
    drift : (2, n), removed from each gyro [rad/s] and accelerometer [m/s^2] at the end of the run, None when not known
    ended_ns : stamp of the last IMU sample, 0: not known; for a run that was fused but not navigated
    alignments : how the navigator found its attitude, each time; empty: a state was given, or the run does not say
    inertial : the inertial solution without output correction at the same stamps, None where there is none
    """

    name: str
    settled: Track
    truth: Track
    description: str = ""
    covariance: Floats | None = None
    protection_radius: Floats | None = None
    mode: NDArray[np.int64] | None = None
    judged: dict[str, Judged] = dataclasses.field(default_factory=dict)
    health: list[HealthChange] = dataclasses.field(default_factory=list)
    faults: list[FaultInterval] = dataclasses.field(default_factory=list)
    origin_ns: int | None = None
    scoring_from_ns: int = 0
    use: SensorUse | None = None
    samples: Samples = dataclasses.field(default_factory=Samples)
    n_sensors: int = 6
    twin: Track | None = None
    oracle: Track | None = None
    realtime_factor: float | None = None
    pieces: list[tuple[str, int, int]] = dataclasses.field(default_factory=list)
    aid_fixes: dict[str, tuple[Stamps, Floats, Floats]] = dataclasses.field(default_factory=dict)
    expect: dict[str, Any] = dataclasses.field(default_factory=dict)
    notes: list[str] = dataclasses.field(default_factory=list)
    drift: Floats | None = None
    ended_ns: int = 0
    alignments: list[Alignment] = dataclasses.field(default_factory=list)
    inertial: Track | None = None

    @property
    def start_ns(self) -> int:
        """Stamp that times are counted from."""
        return self.origin_ns if self.origin_ns is not None else int(self.settled.stamp_ns[0]) if len(self.settled) else 0

    @property
    def last_ns(self) -> int:
        """Stamp the run ends at: the last settled epoch, or the last IMU sample; 0: not known."""
        return int(self.settled.stamp_ns[-1]) if len(self.settled) else self.ended_ns

    def between(self, start_ns: int, stop_ns: int) -> RunRecord:
        """The part of the run with stamps in [start_ns, stop_ns]; counters and pieces are dropped, they belong to the whole."""
        inside = (self.settled.stamp_ns >= start_ns) & (self.settled.stamp_ns <= stop_ns)

        def cut(value: Any) -> Any:
            if value is None:
                return None
            return value.take(inside) if isinstance(value, Track) else value[inside]

        return dataclasses.replace(
            self,
            settled=cut(self.settled), truth=cut(self.truth), covariance=cut(self.covariance), mode=cut(self.mode),
            protection_radius=cut(self.protection_radius), twin=cut(self.twin), oracle=cut(self.oracle),
            inertial=cut(self.inertial),
            judged={k: j.take((j.stamp_ns >= start_ns) & (j.stamp_ns <= stop_ns)) for k, j in self.judged.items()},
            health=[c for c in self.health if start_ns <= c.stamp_ns <= stop_ns],
            faults=[f for f in self.faults if f.start_ns <= stop_ns and f.end_ns > start_ns],
            alignments=[a for a in self.alignments if start_ns <= a.ended_ns <= stop_ns],
            samples=Samples(), pieces=[], expect={}, origin_ns=start_ns, drift=None, ended_ns=min(self.ended_ns, stop_ns),
        )  # fmt: skip
