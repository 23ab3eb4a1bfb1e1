"""What every command shows: one progress bar, tables, and what is wrong with a recording.

Nothing else of the command line prints: what comes from files passes `visible` here.
"""

from __future__ import annotations

from collections.abc import Container, Iterable, Sequence
from pathlib import PurePath
from typing import TYPE_CHECKING, Any

import typer

from mvuav_ros.messages.untrusted import visible
from mvuav_ros.recordings.account import Account

if TYPE_CHECKING:
    from rich.progress import Progress


def frame_progress(*, thread: bool = True) -> Progress:
    """A bar with frames, rate and time left, on stderr and only on a terminal.

    Args:
        thread: whether a thread redraws the bar; without, every update does.
    """
    from rich import progress
    from rich.console import Console
    from rich.text import Text

    class Rate(progress.ProgressColumn):
        def render(self, task: progress.Task) -> Text:
            speed = task.finished_speed or task.speed
            return Text(f'{speed:.0f}/s' if speed else '')

    console = Console(stderr=True)
    # rich 13 (Ubuntu 24.04's) ends even a disabled bar with an empty line.
    console.quiet = not console.is_terminal
    return progress.Progress(
        progress.TextColumn('{task.description}', markup=False),
        progress.BarColumn(),
        progress.MofNCompleteColumn(),
        Rate(),
        progress.TimeRemainingColumn(),
        console=console,
        auto_refresh=thread,
        disable=not console.is_terminal,
    )


def print_table(
    headings: Sequence[str], rows: Iterable[Sequence[str]], width: int, numbers: Container[str] = ()
) -> None:
    """Print a table; ``width`` is that of a pipe, which has none itself.

    Columns of ``numbers`` are justified to the right.
    """
    from rich.console import Console
    from rich.table import Table

    table = Table(box=None, pad_edge=False)
    for heading in headings:
        justify: Any = 'right' if heading in numbers else 'left'
        table.add_column(heading, justify=justify, overflow='fold')
    for row in rows:
        table.add_row(*map(visible, row))
    console = Console(markup=False, highlight=False)
    if not console.is_terminal:
        console.width = width
    console.print(table)


def say(*lines: object, err: bool = False) -> None:
    """Print lines; what others wrote in them comes out as visible characters."""
    for line in lines:
        typer.echo(visible(line), err=err)


def report_account(account: Account, name: str = '') -> None:
    """A line for each thing that is wrong with an input or worth a note, and what it cost."""
    account.is_reported = True
    errors = [*account.errors, *([account.balance] if account.is_lossy else [])]
    report_each('damage', errors, name)
    report_each('note', account.warnings, name)


def report_each(kind: str, texts: Iterable[str], name: str = '') -> None:
    """A line for each on stderr; it names the input, or its file, where that is one of several."""
    for text in texts:
        is_named = PurePath(name).name in text
        say(f'{kind}: {text if is_named else f"{name}: {text}"}', err=True)
