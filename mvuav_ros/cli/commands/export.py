"""``mvuav export``: results as tables and trajectories for other tools."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from mvuav_ros.recordings.remote import local_copy


class Form(StrEnum):
    """Of the files."""

    CSV = 'csv'
    PARQUET = 'parquet'
    TUM = 'tum'


def export(
    source: Annotated[str, typer.Argument(metavar='RESULTS', help='A bag of results.')],
    output: Annotated[
        Path, typer.Option('--output', '-o', help='The folder for the files.', show_default=False)
    ],
    form: Annotated[
        Form, typer.Option('--format', help='tum is for poses, as evo reads them.')
    ] = Form.CSV,
) -> None:
    """Write markers, roll, poses and lines, one file for each topic."""
    from mvuav_ros.recordings.exporting import export as write

    with local_copy(source) as path:
        for file, rows in write(path, output, form.value).items():
            typer.echo(f'{file}: {rows} rows')
