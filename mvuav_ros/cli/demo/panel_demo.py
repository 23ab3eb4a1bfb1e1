"""The sample bags again and again, with the nodes and the tuning panel, until Ctrl-C."""

from __future__ import annotations

import os
import signal
import sys
import time
import webbrowser
from pathlib import Path

from rich.console import Console

from mvuav_ros.cli.demo.sample_flights import panel_flights
from mvuav_ros.cli.node_processes import NodeProcesses
from mvuav_ros.offline.stopping import Interrupted
from mvuav_ros.sources.source import SourceError

_STARTING_TIME = 180.0
_PREFIX = 'tuning_panel: '


def run_panel(bags: Path, console: Console) -> None:
    """Start everything, say where the panel is, and wait for Ctrl-C.

    Raises:
        SourceError: a bag is missing, or a process failed.
    """
    try:
        _run(bags, console)
    except Interrupted as interruption:
        if interruption.number != signal.SIGINT:
            raise


def _run(bags: Path, console: Console) -> None:
    flights = panel_flights(bags)
    with NodeProcesses() as nodes:
        panel = nodes.start('mvuav_ros', 'tuning_panel', '--port', '0', '--bags', str(bags))
        for flight in flights:
            flight.start_node(nodes)
            flight.start_source(nodes, loop='true')
        url = panel.wait_for(_PREFIX, _STARTING_TIME).removeprefix(_PREFIX)
        console.print('The tuning panel is at', style='bold')
        console.print(f'  {url}', style='bold cyan', highlight=False, soft_wrap=True)
        console.print(
            f'ROS_DOMAIN_ID is {nodes.domain_id}. Ctrl-C ends everything.', highlight=False
        )
        if _has_browser():
            webbrowser.open(url)
        while not (reason := nodes.failure()):
            time.sleep(0.5)
        raise SourceError(reason)


def _has_browser() -> bool:
    """Whether there is a screen to open a browser on; never one in the terminal."""
    screen = os.environ.get('DISPLAY') or os.environ.get('WAYLAND_DISPLAY')
    return bool(screen) or sys.platform == 'darwin'
