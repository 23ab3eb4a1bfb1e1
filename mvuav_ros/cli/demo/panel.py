"""The sample bags again and again, with the nodes and the tuning panel, until Ctrl-C."""

from __future__ import annotations

import os
import random
import sys
import time
import webbrowser
from contextlib import suppress
from pathlib import Path

from rich.console import Console

from mvuav_ros.cli.demo.flights import FLIGHTS
from mvuav_ros.cli.demo.processes import NodeProcesses
from mvuav_ros.recordings.sources.frame import SourceError

_STARTING_TIME = 60.0
_PREFIX = 'tuning_panel: '


def run_panel(bags: Path, console: Console) -> None:
    """Start everything, say where the panel is, and wait for Ctrl-C.

    Args:
        bags: folder of the sample bags.
        console: where the address is shown.

    Raises:
        SourceError: a bag is missing, or a process failed.
    """
    flights = [flight for flight in FLIGHTS if (bags / f'{flight.name}.mcap').is_file()]
    if not flights:
        raise SourceError(f'{bags}: no sample bags there')
    # A domain of its own: other ROS systems on the network are neither heard nor disturbed.
    domain_id = random.SystemRandom().randint(1, 100)
    with suppress(KeyboardInterrupt), NodeProcesses(domain_id) as nodes:
        nodes.start('tuning_panel', before=['--port', '0', '--bags', str(bags)])
        for flight in flights:
            nodes.start(flight.processor.name, ['-r', f'image_raw:={flight.image_topic}'])
            nodes.start(
                'video_source',
                [
                    *('-r', f'__ns:=/{flight.name}', '-p', 'loop:=true'),
                    *('-p', f'source:={bags / flight.name}.mcap'),
                ],
            )
        url = _address(nodes)
        console.print('The tuning panel is at', style='bold')
        console.print(f'  {url}', style='bold cyan', highlight=False, soft_wrap=True)
        console.print(f'ROS_DOMAIN_ID is {domain_id}. Ctrl-C ends everything.', highlight=False)
        if _has_browser():
            webbrowser.open(url)
        while not (reason := nodes.failure()):
            time.sleep(0.5)
        raise SourceError(reason)


def _address(nodes: NodeProcesses) -> str:
    end = time.monotonic() + _STARTING_TIME
    while time.monotonic() < end:
        if reason := nodes.failure():
            raise SourceError(reason)
        for line in nodes.output('tuning_panel').splitlines():
            if line.startswith(_PREFIX):
                return line.removeprefix(_PREFIX)
        time.sleep(0.1)
    raise SourceError(f'tuning_panel did not start within {_STARTING_TIME:.0f} s')


def _has_browser() -> bool:
    """Whether there is a screen to open a browser on; never one in the terminal."""
    screen = os.environ.get('DISPLAY') or os.environ.get('WAYLAND_DISPLAY')
    return bool(screen) or sys.platform == 'darwin'
