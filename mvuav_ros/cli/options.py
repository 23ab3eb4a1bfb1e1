"""Options that several commands share."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from mvuav_ros.recordings.account import RecordingError
from mvuav_ros.recordings.remote import is_url, size_at


class Storage(StrEnum):
    """The form of a recording."""

    MCAP = 'mcap'
    ROSBAG2 = 'rosbag2'

    def split_bytes(self, split_mb: int) -> int | None:
        """None for a single file; of a folder the size at which its next part begins."""
        return split_mb * 1_000_000 if self is Storage.ROSBAG2 else None


ParamsFile = Annotated[
    Path | None, typer.Option(help='A ROS 2 parameter file.', show_default=False)
]
Param = Annotated[
    list[str] | None,
    typer.Option(help='A parameter, node:name:=value; may be repeated.', show_default=False),
]
ImageTopic = Annotated[str | None, typer.Option(help='Image topic of a bag that has several.')]
CameraInfo = Annotated[
    str | None,
    typer.Option(
        help="The camera's calibration for all images: the YAML file of camera_calibration.",
        metavar='FILE',
        show_default=False,
    ),
]
Dask = Annotated[
    str | None,
    typer.Option(help='Run on a Dask cluster; the address of its scheduler.', metavar='tcp://…'),
]
Json = Annotated[Path | None, typer.Option('--json', help='Also write the numbers to this file.')]
Format = Annotated[
    Storage, typer.Option('--format', help='mcap files, or rosbag2 folders with metadata.yaml.')
]
SplitMb = Annotated[
    int, typer.Option(help='MB after which a rosbag2 folder starts its next file.', min=0)
]
Strict = Annotated[
    bool, typer.Option('--strict', help='Exit with status 1 if anything was lost or rejected.')
]
MaxSize = Annotated[
    int | None,
    typer.Option(
        help='MB that each file may become when it is unpacked; default: 200 times its size, and '
        'at least 537.',
        metavar='MB',
        min=1,
        show_default=False,
    ),
]
AsJson = Annotated[
    bool, typer.Option('--json', help='Print JSON, with the account of what was lost.')
]
Force = Annotated[bool, typer.Option('--force', help='Overwrite existing output.')]


def refuse_to_overwrite(output: Path | str, force: bool) -> None:
    """RecordingError where a local path or a URL exists already; force overwrites it."""
    if force or (isinstance(output, str) and not is_url(output)):
        return
    if output.exists() if isinstance(output, Path) else size_at(output) is not None:
        raise RecordingError(f'{output} exists; --force overwrites it')
