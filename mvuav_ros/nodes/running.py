"""A process with nodes: which run in it, its transport, its start and its end."""

from __future__ import annotations

import os
import re
import shutil
import signal
import sys
import time
from argparse import ArgumentParser, Namespace
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from importlib import import_module
from itertools import pairwise
from pathlib import Path
from queue import SimpleQueue
from threading import Thread
from types import FrameType

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.exceptions import NameValidationException, ParameterException
from rclpy.executors import SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.qos_overriding_options import InvalidQosOverridesError
from rclpy.signals import SignalHandlerOptions, install_signal_handlers

from mvuav_ros.detectors import DETECTORS, load_class
from mvuav_ros.nodes.live_parameters import unused_overrides
from mvuav_ros.nodes.managed_node import ManagedNode
from mvuav_ros.parameters.declaration import ParameterError
from mvuav_ros.processing.process_tuning import freeze_garbage, tune_process
from mvuav_ros.sources.source import SourceError

PROFILE = Path(__file__).with_name('fastdds_images.xml')
"""Fast DDS settings for a process that publishes camera images."""
_SMALLER = 'DEFAULT?sockets_size=4MB'
"""Fast DDS makes a segment of twice that."""
_SEGMENTS = {True: 1 << 24, False: 1 << 23}
_TO_SPARE = 1 << 24
_SHARED_MEMORY = Path('/dev/shm')
_USERS_OWN = (
    'FASTRTPS_DEFAULT_PROFILES_FILE',
    'FASTDDS_DEFAULT_PROFILES_FILE',
    'FASTDDS_BUILTIN_TRANSPORTS',
)


def prepare_transport(*, camera_images: bool = True) -> None:
    """Give our own publishers room for large images; call before ``rclpy.init()``.

    Fast DDS's default shared-memory segment is 512 kB. A larger image goes out as UDP fragments,
    of which best-effort subscribers lose most (640x480 bgr8: 11 of 90 frames arrived). Other
    middlewares do not look at the variables. A set-up of the user's own is left alone.

    A publisher of camera images gets 16 MB, any other 8 MB, enough for debug images: every process
    takes its segment as a whole, and a container often has 64 MB for all of them.
    """
    if any(os.environ.get(name) for name in _USERS_OWN):
        return
    try:
        room = shutil.disk_usage(_SHARED_MEMORY).free
    except OSError:
        room = 0
    if room < _SEGMENTS[camera_images] + _TO_SPARE:
        # A segment that does not fit makes Fast DDS give up shared memory altogether.
        print(
            f'mvuav_ros: {_SHARED_MEMORY} is almost full or too small: large images may be lost; '
            'start the container with --shm-size=256m (docs/transport.md)',
            file=sys.stderr,
        )
    elif camera_images:
        # A file, as the variable below is ignored under ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST.
        os.environ['FASTRTPS_DEFAULT_PROFILES_FILE'] = str(PROFILE)
    else:
        os.environ['FASTDDS_BUILTIN_TRANSPORTS'] = _SMALLER


_LOG_INTERVAL = 5.0
_PAUSE_AFTER_ERROR = 0.02
_WAKE = 0.5  # s
_LONGEST_CLEANUP = 8.0
"""Seconds; a camera or a server that never answers must not keep a process that is to end."""
USERS_MISTAKES = (
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
        self.made, self._status = False, 0
        # Unlike an Event, it may be put to while a handler interrupts another put.
        self._ends: SimpleQueue[None] = SimpleQueue()
        Thread(target=self._end_at_last, daemon=True).start()
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._on_signal)

    def end(self, status: int) -> None:
        """Leave with a status at the latest when there was time enough to clean up."""
        self._status = status
        self._ends.put(None)

    def _end_at_last(self) -> None:
        self._ends.get()
        time.sleep(_LONGEST_CLEANUP)
        os._exit(self._status)

    def _on_signal(self, _number: int, _frame: FrameType | None) -> None:
        self.made = True
        self._ends.put(None)


@contextmanager
def _until_signal() -> Iterator[_StopRequest]:
    """SIGINT and SIGTERM end the block, and ROS, without an error; afterwards they do nothing."""
    stop = _StopRequest()
    try:
        yield stop
    except Exception:
        # After a signal rclpy's calls fail, each in its own way.
        if not stop.made:
            raise
    finally:
        rclpy.try_shutdown()
        # rclpy has put the handlers back that it found. To Python's end signals are to do nothing.
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_IGN)


@contextmanager
def until_stopped(name: str) -> Iterator[Node]:
    """A node for a short program; SIGINT and SIGTERM end the block without an error."""
    with _until_signal() as stop:

        def look() -> None:
            if stop.made:
                rclpy.try_shutdown()

        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        node = rclpy.create_node(name)
        # A signal just before a wait, or before rclpy's handlers, does not end it: then this does.
        node.create_timer(_WAKE, look)
        install_signal_handlers()
        yield node


def run_nodes(names: Sequence[str]) -> int:
    """Spin nodes of `NODES` in one process until SIGINT, SIGTERM or shutdown.

    Returns:
        Exit status: 0, 2 with one line on stderr where the user's set-up is at fault, or 1 where a
        node has `failed` and said why in its log.
    """
    make_nodes = nodes_of(names)
    tune_process()
    prepare_transport(camera_images=SOURCE in names)
    nodes: Sequence[ManagedNode] = ()
    status = 1
    with _until_signal() as stop:
        try:
            _refuse_unreadable_files()
            # Signals would shut it down at once, even under a node in the making.
            rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
            # Before anything starts: a node that fails at once shuts the context down.
            executor = SingleThreadedExecutor()
            nodes = make_nodes()
            _start(nodes, executor)
            freeze_garbage()
            install_signal_handlers()
            if not stop.made:
                _spin(executor, nodes)
            status = int(any(node.failed for node in nodes))
        except Exception as error:
            status = 0 if stop.made else _explain(error, nodes)
        finally:
            stop.end(status)
            for node in nodes:
                node.destroy_node()
    return status


def _start(nodes: Sequence[ManagedNode], executor: SingleThreadedExecutor) -> None:
    for node in nodes:
        executor.add_node(node)
    for node in nodes:
        node.autostart()
    for node in nodes:
        node.siblings = nodes
        node.report_parameters()


def _explain(error: Exception, nodes: Sequence[ManagedNode]) -> int:
    """The exit status for an error, printed if it is the user's; any other is raised again."""
    if any(node.failed for node in nodes):
        return 1
    # rclpy has no exception of its own for QoS overrides.
    if not isinstance(error, USERS_MISTAKES) and 'QoS override' not in str(error):
        raise error
    print(explained(error), file=sys.stderr)
    return 2


_UNREADABLE = re.compile(r"parse .*: '(?:--params-file|-p) (.*)'\. Error: (.*?), at \S+:\d+")


def explained(error: Exception) -> str:
    """One of `USERS_MISTAKES` in words for who made it."""
    if found := _UNREADABLE.search(str(error)):
        # What rcl says is for those who know its C code.
        given, why = found.groups()
        words = 'a list of several types; write [0.0, 20.0, 0.0], not [0.0, 20, 0.0], in line'
        why = re.sub('Sequence should be of same type.*line_num', words, why)
        return f'{given}: {why.replace("error not set", "no value")}'
    if not isinstance(error, rclpy_implementation.UnknownROSArgsError):
        return str(error)
    strange = str(error).strip('[]')
    return (
        f'not arguments of ROS: {strange}; write -p NAME:=VALUE or --params-file FILE, and quote '
        'what has blanks in it'
    )


def _refuse_unreadable_files() -> None:
    """What rcl says of one is for those who know its C code."""
    for option, file in pairwise(sys.argv):
        if option == '--params-file':
            try:
                Path(file).open().close()
            except OSError as error:
                raise ParameterError(file, error.strerror or str(error)) from error


def _spin(executor: SingleThreadedExecutor, nodes: Sequence[ManagedNode]) -> None:
    logged = -_LOG_INTERVAL
    while rclpy.ok():
        try:
            executor.spin_once()
        except Exception as error:
            # Such as a request for a parameter of a type that does not exist, which rclpy itself
            # stumbles over: one client must not end the flight.
            if not rclpy.ok():
                break
            if time.monotonic() - logged >= _LOG_INTERVAL:
                logged = time.monotonic()
                nodes[0].get_logger().error(f'request dropped, {type(error).__name__}: {error}')
            time.sleep(_PAUSE_AFTER_ERROR)


SOURCE = 'video_source'
NODES = (*DETECTORS, SOURCE)


def nodes_of(names: Sequence[str]) -> Callable[[], list[ManagedNode]]:
    """What makes the nodes of a process, in the order of their start, after ``rclpy.init()``.

    Beside a source detectors take its frames as they are, without DDS in between.
    """
    from mvuav_ros.nodes.vision_node import VisionNode

    handed_over = SOURCE in names
    processors = [load_class(each.processor) for name, each in DETECTORS.items() if name in names]
    if handed_over:
        from mvuav_ros.nodes.video_source_node import VideoSource

    def make() -> list[ManagedNode]:
        detectors = [VisionNode(each(), handed_over=handed_over) for each in processors]
        # The source last: what it plays is to be answered from the first frame on.
        return [*detectors, VideoSource(detectors)] if handed_over else list(detectors)

    return make


def _run(name: str) -> None:
    parse_arguments(ArgumentParser(name))
    sys.exit(run_nodes([name]))


def vision_process() -> None:
    """Run several nodes in one process."""
    parser = ArgumentParser('vision_process', description='Several nodes in one process.')
    words = f'separated by commas, of {", ".join(NODES)}; all unless given'
    parser.add_argument('--nodes', default=','.join(NODES), help=words)
    names = [name.strip() for name in parse_arguments(parser).nodes.split(',')]
    if unknown := [name for name in names if name not in NODES]:
        parser.error(f'--nodes: {unknown[0]!r} is not one of {", ".join(NODES)}')
    sys.exit(run_nodes(names))


def own_arguments() -> list[str]:
    """The command line without what is ROS's: from ``--ros-args`` to ``--`` or the end.

    rclpy's own function stumbles over a mistake in those.
    """
    words, own, is_ros = sys.argv[1:], [], False
    for word in words:
        is_ros = (is_ros or word == '--ros-args') and word != '--'
        if not is_ros and word != '--':
            own.append(word)
    return own


def parse_arguments(parser: ArgumentParser) -> Namespace:
    """A process's own arguments; those of ROS without --ros-args would do nothing: refused."""
    parser.epilog = 'Arguments of ROS follow --ros-args: -p NAME:=VALUE, --params-file FILE …'
    own, strange = parser.parse_known_args(own_arguments())
    if strange:
        parser.error(f'{" ".join(strange)}: not used; arguments of ROS follow --ros-args')
    return own


def __getattr__(name: str) -> Callable[[], None]:
    """The executable of a node."""
    if name in NODES:
        return partial(_run, name)
    raise AttributeError(name)


PLAYER = 'rosbag2_player'
SETTLING_TIME = 1.0
"""Seconds from the moment that detectors see the player until it surely sees them."""


def resume_bag() -> None:
    """Wait until as many detectors as asked for name the player as a publisher, then resume it."""
    parser = ArgumentParser('resume_bag')
    parser.add_argument('detectors', type=int, help='how many there are')
    wanted = parser.parse_args(own_arguments()).detectors
    try:
        kind = import_module('rosbag2_interfaces.srv').Resume
    except ImportError as error:
        sys.exit(f'resume_bag needs rosbag2: apt install ros-jazzy-rosbag2 ({error})')
    ready = set[str]()

    def follow(message: DiagnosticArray) -> None:
        for status in message.status:
            values = {pair.key: pair.value for pair in status.values}
            if f'/{PLAYER}' in values.get('image_publishers', '').split():
                ready.add(status.name)

    with until_stopped('resume_bag') as node:
        node.create_subscription(DiagnosticArray, '/diagnostics', follow, 10)
        if problem := unused_overrides(node):
            node.get_logger().warning(problem)
        client = node.create_client(kind, f'/{PLAYER}/resume')
        while len(ready) < wanted or not client.service_is_ready():
            rclpy.spin_once(node, timeout_sec=0.1)
        node.get_clock().sleep_for(rclpy.duration.Duration(seconds=SETTLING_TIME))
        rclpy.spin_until_future_complete(node, client.call_async(kind.Request()))
        node.get_logger().info(f'{", ".join(sorted(ready))} found the bag: it plays')
