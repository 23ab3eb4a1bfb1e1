"""``mvuav repair``: what can be read of a damaged recording as a sound one."""

from __future__ import annotations

from typing import Annotated

import typer

from mvuav_ros.cli.options import Force, Format, SplitMb, Storage
from mvuav_ros.cli.progress import frame_progress
from mvuav_ros.recordings.errors import RecordingError
from mvuav_ros.recordings.remote import is_url, local_copy, local_output, size_at


def repair(
    source: Annotated[str, typer.Argument(metavar='INPUT', help='A bag in any condition.')],
    output: Annotated[
        str,
        typer.Option(
            '--output', '-o', help='OUT.mcap, or a new folder; or a URL.', show_default=False
        ),
    ],
    storage: Format = Storage.MCAP,
    split_mb: SplitMb = 0,
    force: Force = False,
) -> None:
    """Copy every readable message of all topics to a new file, and list what was lost."""
    from mvuav_ros.recordings.repairing import repair as write

    if is_url(output) and not force and size_at(output) is not None:
        raise RecordingError(f'{output} exists; --force overwrites it')
    with local_copy(source) as path, local_output(output) as target, frame_progress() as bar:
        task = bar.add_task(path.name, total=None)
        report = write(
            path,
            target,
            overwrite=force,
            split_bytes=storage.split_bytes(split_mb),
            progress=lambda done, total: bar.update(task, completed=done, total=total),
        )
    typer.echo(f'{output}: {sum(report.messages.values())} messages')
    for topic, count in report.messages.items():
        typer.echo(f'  {topic}: {count}')
    for topic, encoding in report.skipped.items():
        typer.echo(f'skipped: {topic} is {encoding or "without encoding"}, not CDR', err=True)
    for error in report.errors:
        typer.echo(f'damage: {error}', err=True)
    for warning in report.warnings:
        typer.echo(f'note: {warning}', err=True)
