"""``tuning_panel``: a ROS 2 node that serves the page."""

from __future__ import annotations

import argparse
import os
import socket
import sys
import tempfile
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from mvuav_ros.nodes.running import USERS_MISTAKES, explained, parse_arguments

if TYPE_CHECKING:
    from rclpy.node import Node

    from mvuav_ros.panel.ros_thread import RosThread

PORT = 8642


def main() -> None:
    """Run the node."""
    parser = _parser()
    parse_arguments(parser)
    # Before ROS: without the extra nothing is to be started.
    import nicegui  # noqa: F401

    from mvuav_ros.panel.ros_thread import RosThread
    from mvuav_ros.processing.process_tuning import tune_process

    tune_process()
    try:
        ros = RosThread('tuning_panel')
    except USERS_MISTAKES as error:
        print(explained(error), file=sys.stderr)
        sys.exit(2)
    try:
        arguments = _with_parameters(parser, ros.node)
        try:
            listening = _listen(arguments.host, arguments.port)
        except (OSError, OverflowError) as error:
            reason = getattr(error, 'strerror', error)
            print(f'{reason}; choose another --host or --port', file=sys.stderr)
            sys.exit(2)
        _serve(ros, arguments, listening)
    finally:
        ros.stop()


def _with_parameters(parser: argparse.ArgumentParser, node: Node) -> argparse.Namespace:
    """The arguments, those included that came as parameters, ``-p port:=8700``; says which did not.

    They count as if they were written on the command line in place of those there.
    """
    from rcl_interfaces.msg import ParameterDescriptor

    from mvuav_ros.nodes.live_parameters import unused_overrides

    words, fixed = [], ParameterDescriptor(read_only=True, dynamic_typing=True)
    for name, value in vars(parse_arguments(parser)).items():
        shown = list(map(str, value or ())) if name == 'bags' else str(value)
        given = node.declare_parameter(name, shown, fixed).value
        words += [f'--{name}={each}' for each in (given if name == 'bags' else [given])]
    if problem := unused_overrides(node):
        node.get_logger().warning(problem)
    return parser.parse_args(words)


def _parser() -> argparse.ArgumentParser:
    what = 'Serves a page that tunes running marker_tracker and runway_detector nodes.'
    parser = argparse.ArgumentParser('tuning_panel', description=what)
    what = 'address to serve on; any other than loopback asks visitors for a token'
    parser.add_argument('--host', default='127.0.0.1', help=what)
    parser.add_argument('--port', type=int, default=PORT, help='TCP port (%(default)s); 0: free')
    folder = Path(os.environ.get('XDG_DATA_HOME') or Path.home() / '.local' / 'share') / 'mvuav_ros'
    what = 'folder for saved sets and runs (%(default)s)'
    parser.add_argument('--folder', type=Path, default=folder, help=what)
    what = 'a recording, or a folder of them, for runs; repeatable (default: the sample bags)'
    parser.add_argument('--bags', type=_existing, action='append', help=what)
    return parser


def _existing(text: str) -> Path:
    path = Path(text).expanduser().absolute()
    if not path.exists():
        raise argparse.ArgumentTypeError(f'{text}: no such file or folder')
    return path


def _listen(host: str, port: int) -> socket.socket:
    if ':' not in host:
        return socket.create_server((host, port))
    both = socket.has_dualstack_ipv6()
    return socket.create_server((host, port), family=socket.AF_INET6, dualstack_ipv6=both)


def _address(host: str, port: int, token: str) -> str:
    name = f'[{host}]' if ':' in host else host
    if host in ('0.0.0.0', '::'):
        name = socket.gethostname()
    return f'http://{name}:{port}/' + (f'?token={token}' if token else '')


def _serve(ros: RosThread, arguments: argparse.Namespace, listening: socket.socket) -> None:
    import uvicorn

    from mvuav_ros.panel.application import make_application
    from mvuav_ros.panel.guard import make_token
    from mvuav_ros.panel.page.context import Services

    token = make_token(arguments.host)
    folder: Path = arguments.folder.expanduser().resolve()
    with tempfile.TemporaryDirectory(prefix='tuning_panel_') as scratch:
        services = Services(ros, folder, arguments.bags, Path(scratch))
        application = make_application(services, token)
        port = listening.getsockname()[1]
        print(f'tuning_panel: {_address(arguments.host, port, token)}', flush=True)
        config = uvicorn.Config(
            application,
            log_level='warning',
            access_log=False,
            ws='websockets-sansio',
            ws_per_message_deflate=False,
            timeout_graceful_shutdown=1,
        )
        with suppress(KeyboardInterrupt):
            uvicorn.Server(config).run(sockets=[listening])
