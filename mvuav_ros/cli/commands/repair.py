"""``mvuav repair``: what can be read of a damaged recording as a sound one."""

from __future__ import annotations

from typing import Annotated

import typer

from mvuav_ros.cli.options import Force, Format, SplitMb, Storage, refuse_to_overwrite
from mvuav_ros.cli.terminal import frame_progress, tell_damage
from mvuav_ros.recordings.remote import local_copy, local_output


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

    refuse_to_overwrite(output, force)
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
    tell_damage(report.errors, report.warnings, err=True)
