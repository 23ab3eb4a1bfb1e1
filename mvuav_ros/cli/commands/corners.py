"""``mvuav evaluate corners``: the runway detector against corners labelled by hand."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer

from mvuav_ros.cli.options import Json, Param, ParamsFile, takes
from mvuav_ros.cli.terminal import frame_progress, say
from mvuav_ros.offline.node_parameters import resolve_parameters
from mvuav_ros.sources.source import SourceError

if TYPE_CHECKING:
    from mvuav_ros.offline.evaluation.corners import CornersScore

_NODE = 'runway_detector'


@dataclass(frozen=True)
class CornersOptions:
    """The options of ``mvuav evaluate corners``."""

    labels: Annotated[
        Path, typer.Argument(metavar='CSV', help='The labels; the images are in the same folder.')
    ]
    params_file: ParamsFile = None
    param: Param = None
    horizon: Annotated[
        Path | None,
        typer.Option(
            help='CSV file with the horizon of each frame, instead of an attitude: columns file, '
            'row_at_centre (px) and slope_deg (right end down positive).'
        ),
    ] = None
    gray: Annotated[bool, typer.Option('--gray', help='Convert the images to grey first.')] = False
    tolerance: Annotated[float, typer.Option(help='Horizontal error allowed, px.', min=0)] = 3.0
    tolerance_share: Annotated[
        float,
        typer.Option(help='The same as a share of the near width; the larger one holds.', min=0),
    ] = 0.05
    as_json: Json = None
    images: Annotated[
        Path | None, typer.Option(help='Folder for overlays: best, median, worst, each failure.')
    ] = None
    minimum: Annotated[
        float,
        typer.Option(
            help='Exit with status 1 if both edges are found in fewer frames (share).', min=0
        ),
    ] = 0.0


@takes(CornersOptions)
def corners(options: CornersOptions) -> None:
    """Say in how many frames both runway edges were found, and in how many they are wrong.

    The columns of CSV are file and near_left, near_right, far_right, far_left, each with _x and
    _y, px. An edge is right when a line with its role is within max(3 px, 5 % of the near
    width) of its corners. That is measured along the rows of both corners. Wrong are
    frames in which both edges were reported (so with at least min_confidence) and one is not
    right. Frames count from the 25th on; the first report is counted from the first frame. Mode
    approach is used unless another one is given.
    """
    from mvuav_ros.offline.evaluation.corners import (
        CornersError,
        LabelledRun,
        Tolerance,
        read_corners,
        read_horizon,
        run_detector,
        write_images,
    )
    from mvuav_ros.parameters.runway_detector import RunwayDetectorParameters

    given = resolve_parameters([_NODE], options.params_file, options.param or [])[_NODE]
    parameters = RunwayDetectorParameters.from_mapping({'mode': 'approach', **given})
    try:
        frames = read_corners(options.labels)
        horizon = None if options.horizon is None else read_horizon(options.horizon, frames)
        allowed = Tolerance(options.tolerance, options.tolerance_share)
        run = LabelledRun(options.labels.parent, frames, horizon, options.gray, allowed)
        with frame_progress() as progress:
            task = progress.add_task('frames', total=len(frames))
            score = run_detector(run, parameters, lambda: progress.advance(task))
        if options.images is not None:
            write_images(run, parameters, score, options.images)
    except CornersError as error:
        raise SourceError(str(error)) from error
    _tell(score)
    if options.as_json is not None:
        options.as_json.write_text(json.dumps(score.figures(), indent=2) + '\n')
    if not score.both >= options.minimum:
        raise typer.Exit(1)


def _tell(score: CornersScore) -> None:
    from mvuav_ros.offline.evaluation.corners import WARM_UP

    say(f'frames counted {len(score.counted)} (from the {WARM_UP + 1}th)')
    for name, share in (
        ('both edges found', score.both),
        ('left edge found', score.left),
        ('right edge found', score.right),
        ('both edges reported', score.reported),
        ('both edges reported and wrong', score.wrong),
    ):
        say(f'{name} {100 * share:.1f} %')
    say(f'first report in frame {score.first_report or "none"}')
    errors = [frame.error for frame in score.counted if math.isfinite(frame.error)]
    if errors:
        median, high = np.percentile(errors, [50, 90])
        say(f'error / tolerance: median {median:.2f}, 90th percentile {high:.2f}')
    for name, count in sorted(score.failures.items()):
        say(f'failures {name} {count}')
