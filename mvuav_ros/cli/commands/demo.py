"""``mvuav demo``: the nodes at work on the sample bags, once, or repeatedly with the panel."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path
from typing import TYPE_CHECKING, Optional

import typer

from mvuav_ros.cli.terminal import say
from mvuav_ros.offline.stopping import Interrupted
from mvuav_ros.recordings.account import SourceError
from mvuav_ros.recordings.layout import shipped_folder

if TYPE_CHECKING:
    from rich.console import Console

_STARTING_TIME = 180.0
_PREFIX = 'tuning_panel: '


def demo(
    output: Path = typer.Option(Path('out'), '--output', '-o', help='Folder for the results.'),
    bags: Optional[Path] = typer.Option(None, help='Folder of the sample bags.'),
    panel: bool = typer.Option(
        False, '--panel', help='Loop the bags and open the tuning panel, until Ctrl-C.'
    ),
) -> None:
    """Play the sample bags through real nodes in separate processes; takes half a minute.

    Leaves demo.mcap with all messages, and three figures: tanker, runway and roll.
    """
    from rich.console import Console

    # Of a checkout, or installed with the package.
    folder = bags or shipped_folder('bags')
    if folder is None:
        raise SourceError('the sample bags are not installed; name their folder with --bags')
    if panel:
        try:
            _run_panel(folder, Console())
        except Interrupted as interruption:
            if interruption.number != signal.SIGINT:
                raise
        return
    from mvuav_ros.cli.demo.live_demo import run_demo

    for path in run_demo(folder, output, Console()):
        say(path)


def _run_panel(bags: Path, console: Console) -> None:
    import webbrowser

    from mvuav_ros.cli.demo.sample_flights import sample_flights
    from mvuav_ros.cli.node_processes import NodeProcesses

    flights = sample_flights(bags)
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
        # Never a browser in the terminal.
        if os.environ.get('DISPLAY') or os.environ.get('WAYLAND_DISPLAY'):
            webbrowser.open(url)
        while not (reason := nodes.failure()):
            time.sleep(0.5)
        raise SourceError(reason)
