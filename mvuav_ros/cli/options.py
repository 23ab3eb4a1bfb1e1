"""Options that several commands share, and commands whose options are not in their code."""

# What may be left out is an Optional: typer 0.9, which a robot has, knows no X | None.

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any, Optional

import typer

from mvuav_ros.parameters.declaration import ParameterError
from mvuav_ros.recordings.account import RecordingError
from mvuav_ros.recordings.remote import is_url, size_at


def take_options(
    command: Callable[..., None],
    own: Iterable[inspect.Parameter],
    added: Mapping[str, tuple[Any, Any]],
) -> None:
    """Let a command that takes ``**given`` be one with options, in both places where typer looks.

    Args:
        command: is changed.
        own: its parameters, whose annotations are no texts.
        added: more of them: annotation and default by name.
    """
    parameters = [*own]
    for name, (annotation, default) in added.items():
        kind = inspect.Parameter.KEYWORD_ONLY
        parameters.append(inspect.Parameter(name, kind, default=default, annotation=annotation))
    command.__annotations__ = {each.name: each.annotation for each in parameters}
    command.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]


class CommandFailedError(Exception):
    """A command that has a result, which ``--json`` prints, although it ends by an error."""

    def __init__(self, result: dict[str, Any], ending: Exception) -> None:
        super().__init__(str(ending))
        self.result, self.ending = result, ending


class Storage(StrEnum):
    """The form of a recording."""

    MCAP = 'mcap'
    ROSBAG2 = 'rosbag2'

    def split_bytes(self, split_mb: int) -> int | None:
        """None for a single file; of a folder the size at which its next part begins.

        Raises:
            ParameterError: a single file cannot be split.
        """
        if split_mb and self is not Storage.ROSBAG2:
            raise ParameterError('--split-mb', 'only a folder is split; add --format rosbag2')
        return split_mb * 1_000_000 if self is Storage.ROSBAG2 else None


ParamsFile = Annotated[Optional[Path], typer.Option(help='A ROS 2 parameter file.')]
Param = Annotated[
    Optional[list[str]], typer.Option(help='A parameter, node:name:=value; may be repeated.')
]
ImageTopic = Annotated[Optional[str], typer.Option(help='Image topic of a bag that has several.')]
ImuTopic = Annotated[
    Optional[str],
    typer.Option(help='Attitude topic of a bag; default: imu beside the images, else /imu.'),
]
CameraInfo = Annotated[
    Optional[str],
    typer.Option(
        help="The camera's calibration for all images: the YAML file of camera_calibration.",
        metavar='FILE',
    ),
]
Dask = Annotated[
    Optional[str],
    typer.Option(help='Run on a Dask cluster; the address of its scheduler.', metavar='tcp://…'),
]
Json = Annotated[
    Optional[Path], typer.Option('--json', help='Also write the numbers to this file.')
]
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
    Optional[int],
    typer.Option(
        help='MB that each file may become when it is unpacked; default: 200 times its size, and '
        'at least 537.',
        metavar='MB',
        min=1,
    ),
]
AsJson = Annotated[
    bool, typer.Option('--json', help='Print JSON, with the account of what was lost.')
]
Force = Annotated[bool, typer.Option('--force', help='Overwrite existing output.')]


def refuse_to_overwrite(
    output: Path | str, force: bool, *, inputs: Iterable[str | Path | None] = ()
) -> None:
    """RecordingError where a local path or a URL exists already; force overwrites it.

    Inputs of the command are never overwritten.
    """
    for given in inputs:
        local = Path(given or '').expanduser()
        if given and local.exists() and Path(output).exists() and local.samefile(output):
            raise RecordingError(f'{output} is the input itself; give another output')
    if isinstance(output, Path) and output.is_dir():
        raise RecordingError(f'{output} is a folder; give the name of a file')
    if force or (isinstance(output, str) and not is_url(output)):
        return
    if output.exists() if isinstance(output, Path) else size_at(output) is not None:
        raise RecordingError(f'{output} exists; --force overwrites it')


def take_folder(folder: Path, force: bool, *files: str) -> None:
    """Make the folder of a report; one that holds a page or these files is taken by force only.

    Before the work: what took an hour must not be lost to a folder that cannot be made.
    """
    from mvuav_ros.offline.report import PAGE

    for name in (PAGE, *files):
        refuse_to_overwrite(folder / name, force)
    folder.mkdir(parents=True, exist_ok=True)
