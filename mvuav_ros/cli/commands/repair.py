"""``mvuav repair``: what can be read of a damaged recording as a sound one."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from mvuav_ros.cli.options import Force, Format, SplitMb, Storage, refuse_to_overwrite
from mvuav_ros.cli.terminal import frame_progress, say
from mvuav_ros.messages.untrusted import visible
from mvuav_ros.recordings.remote import local_copy, local_output

_MOST_ROWS = 200


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
) -> dict[str, Any]:
    """Copy every readable message of all topics to a new file, and list what was lost."""
    from mvuav_ros.recordings.repairing import repair as write

    refuse_to_overwrite(output, force)
    with local_copy(source) as path, local_output(output) as target, frame_progress() as bar:
        task = bar.add_task(visible(path.name), total=None)
        report = write(
            path,
            target,
            overwrite=force,
            split_bytes=storage.split_bytes(split_mb),
            progress=lambda done, total: bar.update(task, completed=done, total=total),
        )
    say(f'{output}: {sum(report.messages.values())} messages')
    for topic, count in list(report.messages.items())[:_MOST_ROWS]:
        say(f'  {topic}: {count}')
    if len(report.messages) > _MOST_ROWS:
        say(f'  and {len(report.messages) - _MOST_ROWS} more topics')
    return {'output': output, 'messages': report.messages}
