"""``mvuav export``: results as tables and trajectories for other tools."""

from __future__ import annotations

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


def export(
    source: Annotated[str, typer.Argument(metavar='RESULTS', help='A bag of results.')],
    output: Annotated[
        str,
        typer.Option(
            '--output', '-o', help='The folder for the files, or its URL.', show_default=False
        ),
    ],
    form: Annotated[
        Form, typer.Option('--format', help='Format of the files; tum: poses for evo.')
    ] = Form.CSV,
    force: Force = False,
) -> dict[str, Any]:
    """Write markers, roll, poses and lines, one file for each topic."""
    from mvuav_ros.recordings.exporting import export as write

    refuse_to_overwrite(output, force)
    with local_copy(source) as path, local_output(output) as folder:
        files = write(path, folder, form.value, overwrite=force)
    for file, rows in files.items():
        say(f'{inside(output, file.name)}: {rows} rows')
    return {'files': {file.name: rows for file, rows in files.items()}}
