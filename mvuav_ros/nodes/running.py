"""Starting and ending a node as a process."""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Callable, Sequence
from threading import Timer
from types import FrameType

import rclpy
from rclpy.exceptions import NameValidationException, ParameterException
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.qos_overriding_options import InvalidQosOverridesError
from rclpy.signals import SignalHandlerOptions, install_signal_handlers

from mvuav_ros.nodes.managed_node import ManagedNode
from mvuav_ros.nodes.transport import prepare_transport
from mvuav_ros.parameters.declaration import ParameterError
from mvuav_ros.processing.process_tuning import freeze_garbage, tune_process
from mvuav_ros.sources.source import SourceError

_LOG_INTERVAL = 5.0
_PAUSE_AFTER_ERROR = 0.02
_LONGEST_CLEANUP = 8.0
"""Seconds; a camera that never answers must not keep a process that was told to end."""
_USERS_MISTAKES = (
    ParameterError,
    SourceError,
    NameValidationException,
    ParameterException,
    InvalidQosOverridesError,
    rclpy_implementation.UnknownROSArgsError,
    rclpy_implementation.RCLError,
)


class _StopRequest:
    """SIGINT and SIGTERM as a wish, never as an exception in the midst of something.

    rclpy's own handlers, installed later, wake the executor and call these.
    """

    def __init__(self) -> None:
        self.made = False
        # From then on there is something to clean up.
        self.initialised = False
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._on_signal)

    def _on_signal(self, _number: int, _frame: FrameType | None) -> None:
        if not self.initialised:
            os._exit(0)
        self.made = True


def run_nodes(
    make_nodes: Callable[[], Sequence[ManagedNode]], *, camera_images: bool = False
) -> int:
    """Spin nodes in one process until SIGINT, SIGTERM or shutdown.

    ``make_nodes`` makes them, in the order in which they start, after ``rclpy.init()``;
    ``camera_images``: one of them publishes a camera's images, see `prepare_transport`.

    Returns:
        Exit status: 0, 2 with one line on stderr where the user's set-up is at fault, or 1 where a
        node has `failed` and said why in its log.
    """
    stop = _StopRequest()
    tune_process()
    prepare_transport(camera_images=camera_images)
    nodes: Sequence[ManagedNode] = ()
    try:
        stop.initialised = True
        # rclpy's handlers shut the context down at once, even under a node in the making.
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        nodes = make_nodes()
        for node in nodes:
            node.autostart()
        for node in nodes:
            node.siblings = nodes
            node.tell_parameters()
        freeze_garbage()
        install_signal_handlers()
        if not stop.made:
            _spin(nodes)
        if any(node.failed for node in nodes):
            return 1
    except (KeyboardInterrupt, ExternalShutdownException):
        return 0
    except Exception as error:
        if stop.made:
            return 0
        # rclpy has no exception of its own for this.
        if not isinstance(error, _USERS_MISTAKES) and 'QoS override' not in str(error):
            raise
        print(error, file=sys.stderr)
        return 2
    finally:
        watchdog = Timer(_LONGEST_CLEANUP, os._exit, (0,))
        watchdog.daemon = True
        watchdog.start()
        for node in nodes:
            node.destroy_node()
        rclpy.try_shutdown()
        # rclpy has put the handlers back that it found. To Python's end signals are to do nothing.
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_IGN)
    return 0


def _spin(nodes: Sequence[ManagedNode]) -> None:
    executor = SingleThreadedExecutor()
    for node in nodes:
        executor.add_node(node)
    logged = -_LOG_INTERVAL
    while rclpy.ok():
        try:
            executor.spin_once()
        except ExternalShutdownException:
            break
        except Exception as error:
            # Such as a request for a parameter of a type that does not exist, which rclpy itself
            # stumbles over: one client must not end the flight.
            if not rclpy.ok():
                break
            if time.monotonic() - logged >= _LOG_INTERVAL:
                logged = time.monotonic()
                nodes[0].get_logger().error(f'request dropped, {type(error).__name__}: {error}')
            time.sleep(_PAUSE_AFTER_ERROR)
