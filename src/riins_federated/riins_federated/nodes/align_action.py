"""The navigator node's alignment: action `~/align`, status on nav/alignment, commands on nav/align, the master INS on master/state.

Lives here: `AlignPart`, which the node makes, feeds after every sample and destroys.
Does not live here: any alignment (riins_federated.aligner), when it begins and ends (alignment_desk.py). Everything goes by measurement time.
"""

from __future__ import annotations

from functools import partial
from typing import Any

from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.lifecycle import LifecycleNode
from rclpy.task import Future

from riins_msgs import action, msg
from riins_node import alignment_fields, convert, qos

from ..alignment_report import state_of
from ..alignment_saved import read_heading, write_heading
from ..alignment_settings import CANCEL, AlignCommand, AlignmentReport, MasterState
from ..alignment_settle import FULL, AlignmentStatus, SettleWatch
from ..config import NavigatorConfig
from ..navigator import Navigator
from ..reporting import Grid
from ..types import NavSolution, Reason

KEPT_S = 60.0
"""Interval at which the settled heading is written to its file."""


class _Goal:
    """A goal that was taken: its handle, the stamp it holds from, and what will have become of it."""

    def __init__(self, handle: Any, begin_ns: int) -> None:
        self.handle, self.begin_ns = handle, begin_ns
        self.ended: Any = Future()


class AlignPart:
    """Alignment of a navigator node.

    Parameters
    ----------
    node : the navigator node, being configured
    navigator : its algorithm
    config : its settings
    """

    def __init__(self, node: LifecycleNode, navigator: Navigator, config: NavigatorConfig) -> None:
        self._node, self._navigator = node, navigator
        self._watch = SettleWatch(config)
        self._goals: list[_Goal] = []
        self._told: set[AlignCommand] = set()  # commands we have published, which come back
        self._commanded_ns = 0
        self._last = AlignmentStatus.unknown()
        self._file = config.alignment.heading_file
        self._hot = bool(self._file) and config.alignment.method == "hot_start" and not config.alignment.heading
        self._kept = Grid(KEPT_S)
        publish = partial(node.create_publisher, qos_overriding_options=qos.overridable())
        take = partial(node.create_subscription, qos_overriding_options=qos.overridable())
        self._status = publish(msg.AlignmentStatus, "nav/alignment", qos.latched())
        self._commands = publish(msg.AlignCommand, "nav/align", qos.latched(100))
        self._inputs = [
            take(msg.AlignCommand, "nav/align", self._on_command, qos.latched(100)),
            take(msg.NavState, "master/state", self._on_master, qos.navigation()),
        ]
        self._server = ActionServer(
            node, action.Align, "~/align", self._execute, goal_callback=lambda _: GoalResponse.ACCEPT, handle_accepted_callback=self._accepted,
            cancel_callback=self._cancel,
        )  # fmt: skip

    def destroy(self) -> None:
        """Undo the making; goals that wait are aborted."""
        self._keep(self._last)
        for goal in self._goals:
            goal.ended.set_result((False, "the node is being cleaned up"))
        self._server.destroy()
        for subscription in self._inputs:
            self._node.destroy_subscription(subscription)
        for publisher in (self._status, self._commands):
            self._node.destroy_publisher(publisher)

    def take(self, solutions: list[NavSolution]) -> list[NavSolution]:
        """Publish what is settled; the states of a navigator that is being aligned, for nav/state."""
        if self._hot:
            self._hot = False
            self._start_hot()
        reports = self._navigator.drain_alignment()
        for status in self._watch.take(reports, solutions):
            self._last = status
            self._status.publish(self._message(status))
            if status.code == FULL and self._kept.due(status.stamp_ns):
                self._keep(status)
            if status.text:
                self._node.get_logger().info(f"at {status.stamp_ns * 1e-9:.3f} s: {status.text}")
        for report in reports:
            self._tell(report)
        return [] if self._navigator.head() is not None else [state_of(report) for report in reports]

    def _start_hot(self) -> None:
        """Align from the heading that was kept; where there is none, as the motion wants it."""
        found, words = read_heading(self._file)
        problem = self._command("hot_start", None, 0.0, *found) if found else self._command("auto", None)
        self._node.get_logger().info(f"{words}{': ' if problem else ''}{problem}")

    def _keep(self, status: AlignmentStatus) -> None:
        if self._file and status.code == FULL:
            problem = write_heading(self._file, float(status.rph[2]), float(status.sigma[2]), status.stamp_ns)
            if problem:
                self._node.get_logger().warning(problem, throttle_duration_sec=60.0)

    def _message(self, status: AlignmentStatus) -> Any:
        return convert.fill(msg.AlignmentStatus, alignment_fields.alignment_status(status))

    def _tell(self, report: AlignmentReport) -> None:
        """Feedback and result of the goal that a report belongs to."""
        for goal in [g for g in self._goals if g.begin_ns == report.begin_ns]:
            if report.ended:
                goal.ended.set_result((report.ended == "aligned", report.text))
            elif goal.handle.is_active:
                goal.handle.publish_feedback(action.Align.Feedback(status=self._message(self._last)))

    def _accepted(self, handle: Any) -> None:
        """Every goal is taken up, so that a refusal can say why."""
        goal = _Goal(handle, 0)
        self._goals.append(goal)
        wish = handle.request
        if wish.method == CANCEL:  # it would wait for a report that never comes
            problem = "cancel the goal that is under way; a goal has no method cancel"
        else:
            problem = self._command(str(wish.method) or "auto", goal, float(wish.time_limit), float(wish.heading), float(wish.sigma_heading))
        if problem:
            goal.ended.set_result((False, problem))
        handle.execute()

    def _command(self, method: str, goal: _Goal | None, *rest: float) -> str:
        """Give a command from the next sample on, and tell the recorder; '' or one sentence why not."""
        newest = self._navigator.status().stamp_ns
        if not newest:
            return "there is no IMU sample yet"
        command = AlignCommand(max(newest, self._commanded_ns) + 1, method, *rest)
        problem = self._navigator.align(command)
        if not problem:
            if goal is not None:
                goal.begin_ns = command.stamp_ns
            self._told.add(command)
            self._commanded_ns = command.stamp_ns
            self._commands.publish(convert.fill(msg.AlignCommand, alignment_fields.align_command(command)))
        return problem

    async def _execute(self, handle: Any) -> Any:
        goal = next(g for g in self._goals if g.handle is handle)
        success, message = await goal.ended
        self._goals.remove(goal)
        if handle.is_cancel_requested:
            handle.canceled()
        elif success:
            handle.succeed()
        else:
            handle.abort()
        return action.Align.Result(success=success, message=message, status=self._message(self._last))

    def _cancel(self, handle: Any) -> CancelResponse:
        for goal in [g for g in self._goals if g.handle.goal_id == handle.goal_id and not g.ended.done()]:
            problem = self._command(CANCEL, None)
            goal.ended.set_result((False, problem or "alignment cancelled: the operator gave it up"))
        return CancelResponse.ACCEPT

    def _on_command(self, message: Any) -> None:
        """A command of a recording that is played."""
        command = AlignCommand(**alignment_fields.read_align_command(message))
        if command in self._told:
            return
        problem = self._navigator.align(command)
        if problem:
            self._node.get_logger().warning(f"command to align refused: {problem}")

    def _on_master(self, message: Any) -> None:
        reason = self._navigator.add_master(MasterState(**alignment_fields.read_master_state(message)))
        if reason is not Reason.NONE:
            words = "not valid" if reason is Reason.NO_FIX else reason.name.lower()
            self._node.get_logger().warning(f"master: state dropped ({words})", throttle_duration_sec=10.0)
