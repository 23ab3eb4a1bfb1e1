"""One progress bar for every command."""

from __future__ import annotations

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    Task,
    TextColumn,
    TimeRemainingColumn,
)
from rich.text import Text


class _Rate(ProgressColumn):
    def render(self, task: Task) -> Text:
        speed = task.finished_speed or task.speed
        return Text(f'{speed:.0f}/s' if speed else '')


def frame_progress(*, thread: bool = True) -> Progress:
    """A bar with frames, rate and time left, on stderr and only on a terminal.

    Args:
        thread: whether a thread redraws the bar; without, every update does.
    """
    console = Console(stderr=True)
    # rich 13 (Ubuntu 24.04's) ends even a disabled bar with an empty line.
    console.quiet = not console.is_terminal
    return Progress(
        TextColumn('{task.description}', markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        _Rate(),
        TimeRemainingColumn(),
        console=console,
        auto_refresh=thread,
        disable=not console.is_terminal,
    )
