"""``mvuav demo``: see the nodes at work on the sample bags."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from mvuav_ros.cli.terminal import say
from mvuav_ros.recordings.layout import shipped_folder


def demo(
    output: Annotated[Path, typer.Option('--output', '-o', help='Folder for the results.')] = Path(
        'out'
    ),
    bags: Annotated[
        Path | None, typer.Option(help='Folder of the sample bags.', show_default=False)
    ] = None,
    panel: Annotated[
        bool,
        typer.Option('--panel', help='Loop the bags and open the tuning panel, until Ctrl-C.'),
    ] = False,
) -> None:
    """Play the sample bags through real nodes in separate processes; takes half a minute.

    Leaves demo.mcap with all messages, and three figures: tanker, runway and roll.
    """
    from rich.console import Console

    from mvuav_ros.cli.demo.live_demo import run_demo
    from mvuav_ros.cli.demo.panel_demo import run_panel
    from mvuav_ros.sources.source import SourceError

    # Of a checkout, or installed with the package.
    folder = bags or shipped_folder('bags')
    if folder is None:
        raise SourceError('the sample bags are not installed; name their folder with --bags')
    if panel:
        run_panel(folder, Console())
        return
    for path in run_demo(folder, output, Console()):
        say(path)
