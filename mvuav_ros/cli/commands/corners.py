"""``mvuav evaluate corners``: the runway detector against corners labelled by hand."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from mvuav_ros.cli.progress import frame_progress
from mvuav_ros.parameters.declaration import ParameterError
from mvuav_ros.parameters.parameter_file import parse_assignment, read_parameter_values
from mvuav_ros.recordings.sources.frame import SourceError

_NODE = 'runway_detector'


def corners(
    labels: Annotated[
        Path, typer.Argument(metavar='CSV', help='The labels; the images lie beside them.')
    ],
    params_file: Annotated[Path | None, typer.Option(help='A ROS 2 parameter file.')] = None,
    param: Annotated[
        list[str] | None,
        typer.Option(help='runway_detector:name:=value; may be repeated.', show_default=False),
    ] = None,
    as_json: Annotated[
        Path | None, typer.Option('--json', help='Write the figures of every frame there.')
    ] = None,
    images: Annotated[
        Path | None, typer.Option(help='Folder for overlays: best, median, worst, each failure.')
    ] = None,
    minimum: Annotated[
        float,
        typer.Option(help='Exit with status 1 if both edges are found in a smaller share.', min=0),
    ] = 0.0,
) -> None:
    """Say in how many frames both runway edges were found.

    The columns of CSV are file and near_left, near_right, far_right, far_left, each with _x and
    _y, px. An edge is found when a line with its role passes within max(3 px, 5 % of the near
    width) of both its corners. Frames count from the 25th on. Mode approach is used unless
    another one is given.
    """
    from mvuav_ros.offline.evaluation.corners import WARM_UP, CornersError, read_corners
    from mvuav_ros.offline.evaluation.corners_run import run_detector, write_images
    from mvuav_ros.parameters.runway_detector import RunwayDetectorParameters

    values: dict[str, Any] = {'mode': 'approach'}
    if params_file is not None:
        values |= read_parameter_values(params_file, _NODE)
    for node, name, value in map(parse_assignment, param or []):
        if node != _NODE:
            raise ParameterError(f'{node}:{name}', f'there is only {_NODE}')
        values[name] = value
    parameters = RunwayDetectorParameters.from_mapping(values)
    try:
        frames = read_corners(labels)
        with frame_progress() as progress:
            task = progress.add_task('frames', total=len(frames))
            score = run_detector(labels, frames, parameters, lambda: progress.advance(task))
        if images is not None:
            write_images(labels, frames, parameters, score, images)
    except CornersError as error:
        raise SourceError(str(error)) from error
    errors = [frame.error for frame in score.counted if math.isfinite(frame.error)]
    typer.echo(f'frames counted {len(score.counted)} (from the {WARM_UP + 1}th)')
    for name, share in (
        ('both edges found', score.both),
        ('left edge found', score.left),
        ('right edge found', score.right),
        ('both edges reported', score.reported),
    ):
        typer.echo(f'{name} {100 * share:.1f} %')
    if errors:
        median, high = np.percentile(errors, [50, 90])
        typer.echo(f'error / tolerance: median {median:.2f}, 90th percentile {high:.2f}')
    for name, count in sorted(score.failures.items()):
        typer.echo(f'failures {name} {count}')
    if as_json is not None:
        as_json.write_text(json.dumps(score.figures(), indent=2) + '\n')
    if not score.both >= minimum:
        raise typer.Exit(1)
