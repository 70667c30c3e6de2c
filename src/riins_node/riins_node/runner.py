"""Start, spin and stop a node, the same way for all: exit status 0, 1 or 2, errors in one line, clean shutdown on any signal.

Lives here: `run`, `AutostartLifecycleNode`.
Does not live here: what a node does (each package's node.py), parameters (parameters.py).
"""

from __future__ import annotations

import signal
import sys
import traceback
from collections.abc import Callable, Sequence
from typing import Any

import rclpy
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.logging import get_logger
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.signals import uninstall_signal_handlers

from riins_core.settings import SettingError
from riins_node import entry
from riins_node.parameters import ParameterError, check_qos_names, parameter_file

OK, FAILED, BAD_USE = 0, 1, 2
HELP = """usage: {name} [--print-parameters] [--ros-args -p NAME:=VALUE ... --params-file FILE -r FROM:=TO ...]
--print-parameters prints every parameter with description, unit and range, as a parameter file"""
WAKE_S = 0.5
"""The executor looks for shutdown at least this often."""


class StartError(RuntimeError):
    """A node cannot do its work; the message is one line."""


class AutostartLifecycleNode(LifecycleNode):
    """Lifecycle node that configures and activates itself, unless the parameter `autostart` is false.

    Subclasses override on_configure, on_activate, ... as in rclpy; what they raise is logged in one line or, at the start, told by `run`,
    which ends the process with the right status (rclpy itself swallows it).
    """

    def __init__(self, node_name: str, **kwargs: Any) -> None:
        super().__init__(node_name, **kwargs)
        self.failure: Exception | None = None
        self._starting = False
        descriptor = ParameterDescriptor(description="configure and activate at start, without a lifecycle manager", read_only=True)
        try:
            self.declare_parameter("autostart", Parameter.Type.BOOL, descriptor) if "autostart" in self._parameter_overrides else (
                self.declare_parameter("autostart", True, descriptor)
            )
        except rclpy.exceptions.InvalidParameterTypeException:
            raise ParameterError(f'parameter "autostart" must be true or false, not {self._parameter_overrides["autostart"].value!r}') from None
        for state, callback in list(self._callbacks.items()):
            self._callbacks[state] = self._guarded(callback)

    @property
    def active(self) -> bool:
        """The node is in the active state: guard subscription and timer callbacks with it, rclpy does not."""
        return self._state_machine.current_state[1] == "active"

    def start(self) -> None:
        """Configure and activate, if `autostart` says so; the runner calls it once the node is made.

        Raises
        ------
        StartError, ParameterError, SettingError or whatever the transition raised
        """
        if not self.get_parameter("autostart").value:
            return
        self._starting = True  # what fails now is told by `run`, once
        for name, transition in (("configure", self.trigger_configure), ("activate", self.trigger_activate)):
            self.failure = None
            if transition() != TransitionCallbackReturn.SUCCESS:
                raise self.failure or StartError(f"{name} failed")
        self._starting = False

    def _guarded(self, callback: Callable[[LifecycleState], TransitionCallbackReturn]) -> Callable[[LifecycleState], TransitionCallbackReturn]:
        def guarded(state: LifecycleState) -> TransitionCallbackReturn:
            try:
                return callback(state)
            except (ParameterError, SettingError, StartError) as error:  # the user can put it right and configure again
                self._failed(error, str(error))
                return TransitionCallbackReturn.FAILURE
            except Exception as error:
                self._failed(error, _one_line(error))
                self.get_logger().debug(traceback.format_exc())
                return TransitionCallbackReturn.ERROR

        return guarded

    def _failed(self, error: Exception, line: str) -> None:
        self.failure = error
        if not self._starting:
            self.get_logger().error(line)


def run(factory: Callable[[], Node], args: Sequence[str] | None = None, name: str = "node") -> int:
    """Make a node, spin it until a signal or shutdown, and clean up.

    Parameters
    ----------
    factory : makes the node, after rclpy.init
    args : command line, None: that of the process; `--print-parameters` prints a parameter file with descriptions and ends,
        `--help` what there is to say here
    name : name for messages before the node has one

    Returns
    -------
    exit status: 0 after SIGINT, SIGTERM (also repeated) or shutdown; 1 for an error; 2 for bad parameters or arguments
    """
    words = list(sys.argv[1:] if args is None else args)
    if "--help" in words or "-h" in words:
        print(HELP.format(name=name))
        return OK
    show = "--print-parameters" in words
    node: Node | None = None
    executor: SingleThreadedExecutor | None = None
    started, initialised = False, False
    try:
        words = rclpy.utilities.remove_ros_args(["", *words])[1:] if words else []
        unknown = [word for word in words if word != "--print-parameters"]
        if unknown:
            raise ParameterError(f'unknown argument "{unknown[0]}" (parameters go behind --ros-args -p NAME:=VALUE)')
        rclpy.init(args=args)
        entry.node_runs()
        initialised = True
        node = factory()
        if show:
            print(parameter_file(node), end="")
            return OK
        if isinstance(node, AutostartLifecycleNode):
            node.start()
        if not isinstance(node, AutostartLifecycleNode) or node.active:
            check_qos_names(node)
        started = True
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        while rclpy.ok():
            executor.spin_once(timeout_sec=WAKE_S)  # spin() waits without end, and a signal's wake-up can be lost between its check and its wait
        return OK
    except (KeyboardInterrupt, ExternalShutdownException):
        return OK
    except (ParameterError, SettingError) as error:
        return _report(name, error, BAD_USE)
    except Exception as error:
        if node is not None and not rclpy.ok():
            return OK  # a signal took the context away while the node was being made or was publishing
        if started:
            traceback.print_exc()  # an error in a callback is a defect: say where
        bad_use = not initialised or type(error).__name__ == "UnknownROSArgsError" or "QoS override" in str(error)
        return _report(name, error, BAD_USE if bad_use else FAILED)
    finally:
        _ignore_signals()
        uninstall_signal_handlers()  # waits for the thread that shuts the context down after a signal: a node destroyed meanwhile may crash
        _ignore_signals()
        if executor is not None:
            executor.shutdown(timeout_sec=1.0)
        if node is not None:
            node.destroy_node()
        try:
            rclpy.try_shutdown()
        except RuntimeError:  # RCLError: between its look and its call the thread of a signal was quicker
            if rclpy.ok():
                raise


def _ignore_signals() -> None:
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)


def _one_line(error: Exception) -> str:
    text = " ".join(str(error).split())
    return text if isinstance(error, ParameterError | SettingError | StartError) else f"{type(error).__name__}: {text}"


def _report(name: str, error: Exception, status: int) -> int:
    print(f"{name}: error: {_one_line(error)}", file=sys.stderr, flush=True)
    if rclpy.ok():
        get_logger(name).debug(traceback.format_exc())
    return status
