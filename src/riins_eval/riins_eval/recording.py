"""The bag of an offline run: topics, types and stamps as the live graph has them; log time is the stamp of the header.

Lives here: `RunWriter`.
Does not live here: bag files (riins_bag), what a message holds (riins_node.fields, blocks.py).
"""

from __future__ import annotations

import shutil
from collections.abc import Iterable, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from rosbags.typesys.store import Typestore

from riins_bag.bag import BagReader, BagWriter, deserialize, serialize, type_hash
from riins_bag.typesys import OWN_PACKAGE
from riins_core.frames import LocalFrame
from riins_imu_fusion.reporting import inertial_fdi
from riins_imu_fusion.types import FdiStatus
from riins_node import alignment_fields, fields
from riins_sim.further_sensors import AttitudeBlock, HeightBlock
from riins_sim.sensors import PositionBlock, RawBlock, VelocityBlock
from riins_sim.trajectory import Truth

from . import blocks
from .run_record import Track

RECORDS = ("none", "nav", "raw", "all")
"""nav: what the navigator says, aids and truth; raw: what it was given (sensors), and truth; all: both, and the fused samples."""

NAV_STATE, NAV_COVARIANCE, INNOVATION = "riins_msgs/msg/NavState", "riins_msgs/msg/NavCovariance", "riins_msgs/msg/Innovation"
FEDERATED, INERTIAL, FAULTS, INITIAL = (
    "riins_msgs/msg/FederatedStatus", "riins_msgs/msg/InertialFdi", "riins_msgs/msg/FaultArray", "riins_msgs/msg/InitialState",
)  # fmt: skip
CALIBRATION, METHOD = "riins_msgs/msg/InertialCalibration", "riins_msgs/msg/FusionMethod"
ALIGNMENT = "riins_msgs/msg/AlignmentStatus"
REDUNDANT_IMU, FUSED_IMU = "riins_msgs/msg/RedundantImu", "riins_msgs/msg/FusedImu"
ODOMETRY, FIX, TWIST = "nav_msgs/msg/Odometry", "sensor_msgs/msg/NavSatFix", "geometry_msgs/msg/TwistWithCovarianceStamped"
POSE = "geometry_msgs/msg/PoseWithCovarianceStamped"

RAW_IMU, TWIN_TOPIC, ORACLE_TOPIC = "/rimu/raw", "/evaluation/twin", "/evaluation/oracle"


AidBlock = PositionBlock | VelocityBlock | HeightBlock | AttitudeBlock


class RunWriter:
    """Writes one run; a context manager that removes the unfinished bag when an error or an interrupt ends it.

    Parameters
    ----------
    path : bag directory to make; it must not exist
    record : nav, raw or all, see RECORDS

    Raises
    ------
    BagError
        The path exists or cannot be written.
    """

    def __init__(self, path: str | Path, record: str) -> None:
        if record not in RECORDS[1:]:
            raise ValueError(f"record must be one of {', '.join(RECORDS[1:])}, not {record!r}")
        self._bag = BagWriter(path, flush_period_s=0.0, chunk_bytes=1 << 20)
        self.nav, self.raw = record in ("nav", "all"), record in ("raw", "all")
        self.fused = record == "all"
        self._settled = self._truth = 0
        self._frame: LocalFrame | None = None
        self._covariance: tuple[np.ndarray[Any, Any], bytes] | None = None

    def __enter__(self) -> RunWriter:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._bag.close()
        if kind is not None:  # closed it would look like a finished run
            shutil.rmtree(self._bag.path, ignore_errors=True)

    def configuration(self, text: str, stamp_ns: int) -> None:
        """Text of /riins/configuration; by habit the first message."""
        self._bag.write_configuration(text, stamp_ns)

    def initial_state(self, state: Any) -> None:
        """A riins_federated InitialState, or riins_sim DrawnInitialState with its `source`."""
        self._bag.write_message("/nav/initial_state", INITIAL, fields.initial_state(state), int(state.stamp_ns))

    def method(self, effective_ns: int, selection: Any, log_ns: int) -> None:
        """What fuses and judges from a stamp on (riins_imu_fusion Selection); 0 or less: from the first sample on."""
        self._bag.write_message("/fdi/method", METHOD, fields.fusion_method(effective_ns, selection), log_ns)

    def faults(self, stamp_ns: int, faults: Iterable[Any], start_at_ns: int, source: str = "") -> None:
        """The riins_sim faults of the run, whose times count from `start_at_ns`; `source` tells arrays of several sources apart."""
        message = fields.fault_array(stamp_ns, faults, start_at_ns)
        message["header"]["frame_id"] = source
        self._bag.write_message("/truth/faults", FAULTS, message, stamp_ns)

    def raw_imu(self, stamp_ns: Any, sequence: Any, block: RawBlock) -> None:
        """Redundant IMU samples with their stamps; `sequence` (m,) uint32."""
        if self.raw:
            content = fields.redundant_imu(stamp_ns, sequence, block.gyro, block.accel, block.gyro_valid, block.accel_valid)
            self._bag.write_block(RAW_IMU, REDUNDANT_IMU, stamp_ns, content)

    def position(self, name: str, stamp_ns: Any, block: PositionBlock, velocity: bool = True) -> None:
        """Fixes of gps or bds, and the velocity where there is a fix."""
        content = fields.position_fix(stamp_ns, block.lat, block.lon, block.h, block.covariance, f"{name}_link", fields.SERVICE[name])
        content["status"]["status"] = np.where(block.has_fix, fields.STATUS_FIX, fields.STATUS_NO_FIX).astype(np.int8)
        self._bag.write_block(f"/{name}/fix", FIX, stamp_ns, content, qos="aid")
        good = np.flatnonzero(block.has_fix)
        if velocity and len(good):
            content = fields.velocity(stamp_ns[good], block.v_n[good], block.velocity_covariance)
            self._bag.write_block(f"/{name}/velocity", TWIST, stamp_ns[good], content, qos="aid")

    def aid(self, name: str, stamp_ns: Any, block: AidBlock) -> None:
        """Measurements of any aid; those that are not valid are no messages, a receiver without a fix says so."""
        if isinstance(block, PositionBlock):
            self.position(name, stamp_ns, block)
            return
        good = np.flatnonzero(block.valid)
        if not good.size:
            return
        stamps = stamp_ns[good]
        if isinstance(block, VelocityBlock):
            topic, kind, content = "velocity", TWIST, fields.doppler(stamps, block.v_b[good], block.covariance, f"{name}_link")
        elif isinstance(block, HeightBlock):
            topic, kind, content = "height", POSE, fields.height(stamps, block.h[good], block.variance, f"{name}_link")
        else:
            topic, kind, content = "attitude", POSE, fields.attitude(stamps, block.rph[good], block.covariance)
        self._bag.write_block(f"/{name}/{topic}", kind, stamps, content, qos="aid")

    def truth(self, stamp_ns: Any, truth: Truth) -> None:
        """True states; epochs at which it is not known are left out."""
        known = np.flatnonzero(np.isfinite(truth.lat))
        track = blocks.track_of_truth(truth, stamp_ns).take(known)
        self._bag.write_block("/truth/state", NAV_STATE, track.stamp_ns, blocks.nav_states(track, self._truth, rate=truth.rate_nb_b[known]))
        self._truth += len(known)

    def fused_imu(self, block: Any, pipeline: Any) -> None:
        """Fused samples (riins_imu_fusion FusedBlock) with the covariance that belongs to the sensors used."""
        if not (self.fused and len(block)):
            return
        rate, force = blocks.covariances(block, pipeline)
        angle, velocity, onset = block.recalled()
        content = fields.fused_imu(
            block.stamp_ns, block.sequence, block.rate, block.force, rate, force, block.gyro_used, block.accel_used,
            block.gyro_drift, block.accel_drift,
            angle_recall=angle, velocity_recall=velocity, recall_onset_ns=onset,
        )  # fmt: skip
        self._bag.write_block("/imu/fused", FUSED_IMU, block.stamp_ns, content)

    def settled(self, solutions: Sequence[Any], labels: Sequence[str]) -> None:
        """Settled states with covariance, odometry and fix, and the inertial ones beside them, if there are (riins_federated NavSolution)."""
        if not (self.nav and solutions):
            return
        stamps = np.array([s.stamp_ns for s in solutions], np.int64)
        if self._frame is None:
            first = solutions[0]
            self._frame = LocalFrame(first.lat, first.lon, first.h)
            self._bag.write_message("/nav/origin", FIX, fields.origin(first.stamp_ns, first.lat, first.lon, first.h), first.stamp_ns)
        self._bag.write_block("/nav/settled", NAV_STATE, stamps, blocks.solution_states(solutions, self._settled))
        alone = [s.inertial for s in solutions if s.inertial is not None]
        if len(alone) == len(solutions):
            self._bag.write_block("/nav/inertial", NAV_STATE, stamps, blocks.solution_states(alone, self._settled))
        self._bag.write_block("/nav/odometry", ODOMETRY, stamps, blocks.odometries(solutions, self._frame))
        self._bag.write_block("/nav/fix", FIX, stamps, blocks.nav_fixes(solutions))
        for solution in solutions:
            self._bag.write("/nav/covariance", NAV_COVARIANCE, self._covariance_cdr(solution, labels), int(solution.stamp_ns))
        self._settled += len(solutions)

    def calibrations(self, calibrations: Iterable[Any]) -> None:
        """What the navigator tells the fusion of the biases (riins_federated Calibration); the log time is that of the newest state behind it."""
        if self.nav:
            for one in calibrations:
                self._bag.write_message("/nav/calibration", CALIBRATION, fields.inertial_calibration(one), int(one.estimated_ns))

    def alignment(self, statuses: Iterable[Any]) -> None:
        """How the navigator finds its attitude, and what has become of it (riins_federated AlignmentStatus)."""
        if self.nav:
            for one in statuses:
                self._bag.write_message("/nav/alignment", ALIGNMENT, alignment_fields.alignment_status(one), int(one.stamp_ns))

    def judged(self, judged: Iterable[Any]) -> None:
        """Innovations (riins_federated Judged)."""
        if self.nav:
            for one in judged:
                self._bag.write_message("/nav/innovations", INNOVATION, fields.innovation(one), int(one.stamp_ns))

    def federated(self, report: Any, text: str = "", events: Iterable[Any] = ()) -> None:
        """State of the subfilters (riins_federated FederatedReport), and what happened."""
        if self.nav and report.stamp_ns > 0:
            self._bag.write_message("/nav/subfilters", FEDERATED, fields.federated_status(report, text, events), int(report.stamp_ns))

    def inertial(self, status: FdiStatus) -> None:
        """State of the redundant IMU."""
        if self.nav:
            self._bag.write_message("/fdi/status", INERTIAL, inertial_fdi(status), int(status.stamp_ns))

    def evaluation(self, topic: str, track: Track) -> None:
        """States of the fault-free twin or of the oracle."""
        self._bag.write_block(topic, NAV_STATE, track.stamp_ns, blocks.nav_states(track, 0))

    def copy(self, reader: BagReader, topics: Iterable[str], drop: Iterable[str] = ()) -> None:
        """Copy topics of another bag as they are, but for `drop`; messages of ours that have changed since it was recorded, as they are now.

        A bag holds one definition of a type, and the results have today's; a field that the recording does not have is 0.
        """
        wanted = [t for t in reader.topics if t in set(topics) and t not in set(drop)]
        schemas, older = reader.schemas(), set()
        for topic in wanted:
            msgtype = reader.topics[topic].msgtype
            digest = reader.channels()[topic].metadata.get("topic_type_hash") or None
            schema = schemas[msgtype]
            if digest and msgtype.startswith(OWN_PACKAGE) and digest != type_hash(msgtype):
                older.add(topic)
                self._bag.add_topic(topic, msgtype, reader.qos(topic) or None)
                continue
            self._bag.add_topic(topic, msgtype, reader.qos(topic) or None, schema=schema.data.decode(), digest=digest, encoding=schema.encoding)
        for message in reader.messages(wanted):
            data = message.data
            if message.topic in older:
                data = serialize(message.msgtype, _fields_of(deserialize(message.msgtype, data, reader.typestore), reader.typestore))
            self._bag.write(message.topic, message.msgtype, data, message.log_ns)

    def _covariance_cdr(self, solution: Any, labels: Sequence[str]) -> bytes:
        """CDR of a NavCovariance: all have the same layout, so that only stamp and matrix (the last field) are put into the first one's bytes."""
        P = np.ascontiguousarray(solution.P, np.float64)
        if self._covariance is None or self._covariance[0].shape != P.shape:
            self._covariance = (P, serialize(NAV_COVARIANCE, fields.nav_covariance(solution, labels)))
        template = self._covariance[1]
        seconds, nanoseconds = divmod(int(solution.stamp_ns), 1_000_000_000)
        stamp = np.array([seconds, nanoseconds], "<u4").tobytes()
        return template[:4] + stamp + template[12 : len(template) - P.nbytes] + P.astype("<f8").tobytes()


def _fields_of(message: Any, store: Typestore) -> Any:
    """A message of another definition as nested mappings."""
    if hasattr(message, "__msgtype__"):
        return {name: _fields_of(getattr(message, name), store) for name, _ in store.fielddefs[message.__msgtype__][1]}
    return [_fields_of(item, store) for item in message] if isinstance(message, list) else message
