"""``mvuav calibrate``: a camera's calibration from a recording of a board."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from mvuav_ros.cli.options import Force, ImageTopic, refuse_to_overwrite, takes
from mvuav_ros.cli.terminal import frame_progress, say
from mvuav_ros.parameters.declaration import ParameterError

_LITTLE = 0.6
"""Part of the image below which its coverage is worth a word."""


class LensModel(StrEnum):
    """Of ``--model``; typer 0.9, which a robot has, knows no ``Literal``."""

    AUTO = 'auto'
    PLUMB_BOB = 'plumb_bob'
    RATIONAL_POLYNOMIAL = 'rational_polynomial'
    EQUIDISTANT = 'equidistant'


@dataclass(frozen=True)
class CalibrateOptions:
    """The options of ``mvuav calibrate``."""

    source: Annotated[
        str, typer.Argument(help='A video, folder of images, bag, or camera (0, /dev/video0).')
    ]
    board: Annotated[
        str, typer.Option(help='Inner corners of the board, columns x rows, as in 9x6.')
    ]
    square: Annotated[float, typer.Option(help='Side of a square, m.')]
    charuco: Annotated[
        str | None,
        typer.Option(help='The board is a ChArUco board with this dictionary: DICT_5X5_100.'),
    ] = None
    marker: Annotated[
        float, typer.Option(help="Side of a ChArUco board's markers over that of its squares.")
    ] = 0.75
    model: Annotated[
        LensModel,
        typer.Option(help='Of the lens. auto: the simplest that does best on views kept back.'),
    ] = LensModel.AUTO
    output: Annotated[Path, typer.Option('--output', '-o', help='Calibration file.')] = Path(
        'camera.yaml'
    )
    report: Annotated[
        Path | None,
        typer.Option(help='Folder for the report; _report beside the file if not given.'),
    ] = None
    name: Annotated[str, typer.Option(help='Name of the camera in the file.')] = 'camera'
    topic: ImageTopic = None
    views: Annotated[int, typer.Option(help='Different views that are used at most.', min=5)] = 120
    seconds: Annotated[
        float, typer.Option(help='Time after which a camera is left, if views are missing, s.')
    ] = 120.0
    force: Force = False


@takes(CalibrateOptions)
def calibrate(options: CalibrateOptions) -> None:
    """Calibrate a camera from a recording of a checkerboard or a ChArUco board.

    Move the board slowly over the whole image, near and far, and tilt it in all directions by 20
    to 45 degrees. Sharp images that differ are picked by themselves. The file is what
    camera_calibration writes; nothing is written if the views do not determine the camera.
    """
    from mvuav_ros.offline import camera_calibration as work
    from mvuav_ros.offline.report import write_report
    from mvuav_ros.sources.calibration import save_calibration
    from mvuav_ros.sources.opening import open_source
    from mvuav_ros.sources.source import SourceError
    from mvuav_ros.vision.board import Board, BoardError
    from mvuav_ros.vision.camera import CalibrationError

    columns, _, rows = options.board.lower().partition('x')
    if not (columns.isdigit() and rows.isdigit()):
        raise ParameterError('--board', f'write columns x rows, as in 9x6, not {options.board!r}')
    try:
        board = Board(
            int(columns), int(rows), options.square, options.charuco or '', options.marker
        )
    except BoardError as error:
        raise ParameterError('--board', str(error)) from error
    report = options.report or options.output.with_name(f'{options.output.stem}_report')
    refuse_to_overwrite(options.output, options.force)
    source = open_source(options.source, topic=options.topic)
    try:
        with frame_progress() as progress:
            task = progress.add_task('frames', total=source.count)
            search = work.search_board(
                source, board, options.views, options.seconds, lambda: progress.advance(task)
            )
        chosen, found = work.calibrate_from(search, board, options.model.value, options.views)
    except CalibrationError as error:
        raise SourceError(f'{source.name}: {error}') from error
    finally:
        source.close()
    page = work.report_of(source.name, board, search, chosen, found)
    write_report(page, report)
    save_calibration(found.camera, options.output, options.name)
    say(
        f'{search.frames} frames, board found in {len(search.views)} of {search.searched} looked '
        f'at, {found.used.sum()} views used'
    )
    say(f'model {found.camera.distortion_model}, residual {found.rms:.3f} px rms')
    for what, value, deviation, unit in work.describe(found):
        say(f'{what} {value:.6g} ± {deviation:.2g} {unit}'.rstrip())
    covered = work.coverage([search.views[i] for i in chosen], search.size)
    say(
        f'corners in {100 * covered:.0f} % of the image'
        + ('' if covered >= _LITTLE else ': the lens is extrapolated outside; show the board there')
    )
    say(options.output)
    say(report / 'index.html')
