"""``mvuav export``: results as tables, trajectories and pictures."""

from __future__ import annotations

from contextlib import ExitStack
from enum import StrEnum
from typing import Annotated, Any

import typer

from mvuav_ros.cli.options import Force, refuse_to_overwrite
from mvuav_ros.cli.terminal import say
from mvuav_ros.recordings.remote import inside, local_copy, local_output


class Form(StrEnum):
    """Of the files."""

    CSV = 'csv'
    PARQUET = 'parquet'
    TUM = 'tum'
    MOT = 'mot'


def export(
    sources: Annotated[
        list[str],
        typer.Argument(metavar='RESULTS...', help='Bags of results, or folders of them.'),
    ],
    output: Annotated[
        str,
        typer.Option(
            '--output', '-o', help='The folder for the files, or its URL.', show_default=False
        ),
    ],
    form: Annotated[
        Form,
        typer.Option(
            '--format', help='Format of the files; tum: poses for evo, mot: markers for TrackEval.'
        ),
    ] = Form.CSV,
    plot: Annotated[
        bool, typer.Option('--plot', help='Also draw a page for each flight, and an overview.')
    ] = False,
    force: Force = False,
) -> dict[str, Any]:
    """Write markers, roll, poses and lines of all flights, one file for each topic."""
    from mvuav_ros.recordings.exporting import export as write
    from mvuav_ros.recordings.layout import by_flight, recordings_in

    named = by_flight([each for source in sources for each in recordings_in(source)])
    refuse_to_overwrite(output, force)
    with local_output(output) as folder, ExitStack() as copies:
        flights = {name: copies.enter_context(local_copy(each)) for name, each in named.items()}
        files = write(flights, folder, form.value, overwrite=force)
        pictures = []
        if plot:
            from mvuav_ros.offline.plots import plot as draw

            pictures = draw(flights, folder / 'plots', overwrite=force)
    rows = {str(file.relative_to(folder)): count for file, count in files.items()}
    for name, count in rows.items():
        say(f'{inside(output, name)}: {count} rows')
    for picture in pictures:
        say(inside(output, f'plots/{picture.name}'))
    return {'files': rows, 'pictures': [f'plots/{picture.name}' for picture in pictures]}
