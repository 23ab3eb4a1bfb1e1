"""Options that several commands share, and commands whose options are not in their code."""

# What may be left out is an Optional: typer 0.9, which a robot has, knows no X | None.

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Optional, TypeVar, get_type_hints

import typer

from mvuav_ros.parameters.declaration import ParameterError
from mvuav_ros.recordings.account import RecordingError
from mvuav_ros.recordings.remote import is_url, size_at

if TYPE_CHECKING:
    from mvuav_ros.offline.replay.job import ReplaySettings

ResultT = TypeVar('ResultT')


def take_options(
    command: Callable[..., Any],
    added: Mapping[str, tuple[Any, Any]],
    like: Callable[..., Any] | None = None,
) -> None:
    """Let a command that takes ``**given`` be one with options, in both places where typer looks.

    Args:
        command: is changed.
        added: what ``**given`` stands for: annotation and default by name.
        like: whose other parameters it has; its own if None.
    """
    own = inspect.signature(like or command, eval_str=True).parameters.values()
    parameters = [each for each in own if each.kind is not inspect.Parameter.VAR_KEYWORD]
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


ParamsFile = Annotated[
    Optional[list[Path]],
    typer.Option(help='A ROS 2 parameter file; may be repeated, later ones win as in ROS.'),
]
Param = Annotated[
    Optional[list[str]], typer.Option(help='A parameter, node:name:=value; may be repeated.')
]
ImageTopic = Annotated[Optional[str], typer.Option(help='Image topic of a bag that has several.')]
CameraInfo = Annotated[
    Optional[str],
    typer.Option(
        help="The camera's calibration for all images: a file of camera_calibration, OpenCV or "
        'Kalibr.',
        metavar='FILE',
    ),
]
CameraInfoTopic = Annotated[
    Optional[str],
    typer.Option(help='Calibration topic of a bag; default: camera_info beside the images.'),
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


@dataclass(frozen=True)
class RunOptions:
    """What describes a run of nodes over recordings, an option for each; see `describes_run`."""

    params_file: ParamsFile = None
    image_topic: ImageTopic = None
    imu_topic: Annotated[
        Optional[str],
        typer.Option(help='Attitude topic of a bag; default: imu beside the images, else /imu.'),
    ] = None
    camera_info_topic: CameraInfoTopic = None
    fps: Annotated[
        Optional[float],
        typer.Option(
            help='Frame rate of images without stamps (folder: 30, video: its own).',
            min=0.001,
            max=1e6,
        ),
    ] = None
    start: Annotated[
        float, typer.Option(help='Start at this time of the recording, s.', min=0.0, max=1e9)
    ] = 0.0
    duration: Annotated[
        Optional[float], typer.Option(help='Length of the part to process, s.', min=0.0, max=1e9)
    ] = None
    every: Annotated[
        int, typer.Option(help='Process only every N-th frame.', metavar='N', min=1)
    ] = 1
    camera_info: CameraInfo = None
    image_is_rectified: Annotated[
        bool,
        typer.Option(
            '--image-is-rectified',
            help='The images are rectified: P of the calibration holds, without distortion.',
        ),
    ] = False
    gamma: Annotated[
        float,
        typer.Option(
            help='out = in ** gamma on every image (eq. 3.2), as video_source does: above 1 '
            'darkens, below 1 brightens; 1: off.',
            min=0.01,
            max=100.0,
        ),
    ] = 1.0

    def settings(self, nodes: Sequence[str], assignments: Iterable[str] = ()) -> ReplaySettings:
        """The run of these nodes, with parameters as ``node:name:=value`` as well.

        Raises:
            ParameterError: see `resolve_parameters`.
            SourceError: the calibration cannot be read.
        """
        from mvuav_ros.offline.replay.job import ReplaySettings
        from mvuav_ros.parameters.parameter_file import resolve_parameters
        from mvuav_ros.sources.calibration import load_calibration
        from mvuav_ros.sources.source import Selection

        rectified = nodes if self.image_is_rectified else ()
        given = [*assignments, *(f'{node}:image_is_rectified:=true' for node in rectified)]
        return ReplaySettings(
            parameters=resolve_parameters(nodes, self.params_file or (), given, self.image_topic),
            image_topic=self.image_topic,
            imu_topic=self.imu_topic,
            camera_info_topic=self.camera_info_topic,
            fps=self.fps,
            selection=Selection(self.start, self.duration, self.every),
            gamma=self.gamma,
            camera=load_calibration(self.camera_info) if self.camera_info else None,
        )


def describes_run(command: Callable[..., ResultT]) -> Callable[..., ResultT]:
    """Give a command that takes ``**run`` the options that are the fields of `RunOptions`."""
    kinds = get_type_hints(RunOptions, include_extras=True)
    take_options(command, {f.name: (kinds[f.name], f.default) for f in fields(RunOptions)})
    return command


def parse_pair(option: str, text: str, form: str) -> tuple[int, int]:
    """Two whole numbers with an x between; a `ParameterError` that names the form else."""
    first, _, second = text.lower().partition('x')
    if not (first.isdecimal() and second.isdecimal()):
        raise ParameterError(option, f'write {form}, not {text!r}')
    return int(first), int(second)


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
