"""``mvuav calibrate`` and ``mvuav rig``: a camera from views of a board, lights from a flight."""

from __future__ import annotations

import math
from collections.abc import Iterable
from contextlib import closing
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Optional

import typer

from mvuav_ros.cli import options
from mvuav_ros.cli.terminal import frame_progress, say
from mvuav_ros.parameters.declaration import ParameterError
from mvuav_ros.recordings.account import SourceError

if TYPE_CHECKING:
    from mvuav_ros.vision.camera import CameraModel
    from mvuav_ros.vision.rig import MarkerRig
    from mvuav_ros.vision.rig_examination import PoseError


ReportFolder = Annotated[
    Optional[Path],
    typer.Option(help='Folder for the report; _report beside the file if not given.'),
]


# Of ``--model``; typer 0.9, which a robot has, knows no ``Literal``.
LensModel = StrEnum('LensModel', ['auto', 'plumb_bob', 'rational_polynomial', 'equidistant'])


def calibrate(
    source: str = typer.Argument(
        ..., help="A video, folder or '*.png', bag, or camera (0, /dev/video0)."
    ),
    board: str = typer.Option(..., help='Inner corners of the board, columns x rows, as in 9x6.'),
    square: float = typer.Option(..., help='Side of a square, m.'),
    charuco: Optional[str] = typer.Option(
        None, help='The board is a ChArUco board with this dictionary: DICT_5X5_100.'
    ),
    marker: float = typer.Option(
        0.75, help="Side of a ChArUco board's markers over that of its squares."
    ),
    model: LensModel = typer.Option(
        LensModel.auto, help='Of the lens. auto: the simplest that does best on views kept back.'
    ),
    output: Path = typer.Option(Path('camera.yaml'), '--output', '-o', help='Calibration file.'),
    report: ReportFolder = None,
    name: str = typer.Option('camera', help='Name of the camera in the file.'),
    topic: options.ImageTopic = None,
    views: int = typer.Option(120, help='Different views that are used at most.', min=5),
    seconds: float = typer.Option(
        120.0, help='Time after which a camera is left, if views are missing, s.'
    ),
    force: options.Force = False,
) -> None:
    """Calibrate a camera from a recording of a checkerboard or a ChArUco board.

    Move the board slowly over the whole image, near and far, and tilt it in all directions by 20
    to 45 degrees. Sharp images that differ are picked by themselves. The file is what
    camera_calibration writes; nothing is written if the views do not determine the camera.
    """
    from mvuav_ros.offline import calibrate_camera as work
    from mvuav_ros.offline.report import write_report
    from mvuav_ros.sources.calibration import save_calibration
    from mvuav_ros.sources.opening import open_source
    from mvuav_ros.vision.board import Board, BoardError
    from mvuav_ros.vision.camera import CalibrationError
    from mvuav_ros.vision.camera_calibration import TOO_MUCH, TUNING

    corners = options.parse_pair('--board', board, 'columns x rows, as in 9x6')
    try:
        printed = Board(*corners, square, charuco or '', marker)
    except BoardError as error:
        raise ParameterError('--board, --square, --charuco, --marker', str(error)) from error
    report = _report_folder(report, output, force, source)
    with closing(open_source(source, topic=topic)) as images, frame_progress() as progress:
        task = progress.add_task('frames', total=images.count)
        search = work.search_board(images, printed, views, seconds, lambda: progress.advance(task))
    try:
        chosen, found = work.calibrate_from(search, printed, model.value, views)
    except CalibrationError as error:
        raise SourceError(f'{images.name}: {error}') from error
    save_calibration(found.camera, output, name)
    page = write_report(work.report_of(images.name, printed, search, chosen, found), report)
    say(
        f'{search.frames} frames, board found in {len(search.views)} of {search.searched} looked '
        f'at, {found.used.sum()} views used'
    )
    if len(search.views) < search.searched / 2:
        said = 'the board is found in fewer than half of the images looked at; if it is in view in '
        images.account.note('board', said + 'more of them, --board does not say its size')
    poor = f': {TOO_MUCH}' if found.rms > TUNING.most_rms else ''
    say(f'model {found.camera.distortion_model}, residual {found.rms:.3f} px rms{poor}')
    for what, value, deviation, unit in work.describe(found):
        say(f'{what} {value:.6g} ± {deviation:.2g} {unit}'.rstrip())
    say(work.extent([search.views[i] for i in chosen], found))
    say(output, page)


rig = typer.Typer(help='Examine and calibrate marker rigs.', no_args_is_help=True)
_REACHES = (2.0, 5.0, 10.0, 20.0)
"""Distances that are looked at if none is given, in units of the rig's size."""
_LISTED = 6
_ONE_POINT = 5.0
"""Size in the image, px, below which nearly all exchanges of names fit."""


@rig.command()
def check(
    file: Path = typer.Argument(..., help='A rig file like config/tanker_747.yaml.'),
    distance: Optional[list[float]] = typer.Option(
        None, help='Distance from the camera, m; may be repeated.'
    ),
    camera_info: options.CameraInfo = None,
    width: int = typer.Option(
        640, help='Width without a calibration, px; the height is 3/4 of it.', min=16
    ),
    fov: float = typer.Option(
        60.0, help='Horizontal field of view without a calibration, degrees.', min=1.0, max=150.0
    ),
    noise: float = typer.Option(0.1, help="Noise of a marker's position, px (1 sigma).", min=0.0),
) -> None:
    """Check a rig for ambiguities, and predict the errors of its pose.

    The exit status is 1 if marker_tracker refuses the rig unless allow_ambiguous is set.
    """
    from mvuav_ros.messages.marker_messages import refused_names
    from mvuav_ros.vision.reprojection import MIN_MARKERS
    from mvuav_ros.vision.rig import RigError, load_rig
    from mvuav_ros.vision.rig_examination import dimensions, examine, pose_error

    for value in distance or ():
        if not 0 < value < math.inf:
            raise ParameterError('--distance', f'must be above 0 m, not {value:g}')
    camera = _camera(camera_info, width, fov)
    try:
        body = load_rig(file)
    except RigError as error:
        raise ParameterError('rig', str(error)) from error
    plane = len(body.names) > MIN_MARKERS and dimensions(body) < 3
    note = ', all in one plane: the tilt is ambiguous' if plane else ''
    if len(body.names) == MIN_MARKERS:
        note = ': names, but no pose, which takes four'
    say(f'{body.name}: {len(body.names)} markers, {body.size:.4g} m across{note}')
    _say_order(body)
    doubts = (*examine(body), *refused_names(body))
    for doubt in doubts:
        say(f'refused: {doubt}')
    if len(body.names) >= MIN_MARKERS and dimensions(body) > 1:
        distances = distance or [body.size * reach for reach in _REACHES]
        errors = [pose_error(body, camera, value, noise) for value in distances]
        if len(body.names) > MIN_MARKERS:
            seen = f'{camera.width} px, {camera_info or f"{fov:g} deg"}'
            say('', f'pose from straight behind, {seen}, {noise:g} px of noise')
            _say_errors(errors)
        if in_view := [e for e in errors if not math.isnan(e.span)]:
            _say_exchanges(body, camera, in_view[0])
    if doubts:
        raise typer.Exit(1)


def _say_order(body: MarkerRig) -> None:
    for direction, axis in (('left to right', 1), ('top to bottom', 2)):
        order = sorted(zip(-body.positions[:, axis], body.names, strict=True))
        say(f'from behind, {direction}: {", ".join(name for _, name in order)}')


def _camera(camera_info: str | None, width: int, fov: float) -> CameraModel:
    """That of a calibration, or one without distortion: its width, px, and field of view, deg."""
    from mvuav_ros.simulation.pinhole import pinhole_camera
    from mvuav_ros.sources.calibration import load_calibration

    if not camera_info:
        return pinhole_camera(width, round(0.75 * width), fov)
    camera = load_calibration(camera_info)
    if flaw := camera.objection(camera.width, camera.height):
        raise SourceError(f'{camera_info}: {flaw}')
    return camera


def _say_errors(errors: Iterable[PoseError]) -> None:
    say('distance m   size px  gap px  along m  across m  roll deg  pitch, yaw deg')
    for e in errors:
        sizes = f'{e.span:9.1f} {e.gap:7.1f}'
        numbers = f'{e.along:8.3g} {e.across:9.3g} {e.roll:9.3g} {e.tilt:15.3g}'
        near = ' too near: not all markers are in view'
        say(f'{e.distance:10.4g} {near if math.isnan(e.span) else sizes + " " + numbers}')


def _say_exchanges(body: MarkerRig, camera: CameraModel, at: PoseError) -> None:
    """Which names look most alike at a distance."""
    from mvuav_ros.vision.rig_examination import confusions

    say('', f'exchanged names with the smallest residuals, at {at.distance:.4g} m')
    if at.span < _ONE_POINT:
        say('too far away: all markers are nearly one point')
        return
    exchanges = confusions(body, camera, at.distance)
    if not exchanges:
        say('none: with other names the body would not be seen from behind')
    for found in exchanges[:_LISTED]:
        names = ', '.join(' -> '.join(cycle) for cycle in found.names)
        turned = f'pitch {found.pitch_deg:g}, yaw {found.yaw_deg:g} deg'
        say(f'{found.residual:8.2f} px rms  {names} ({turned})')


@rig.command('calibrate')
def calibrate_rig(
    source: str = typer.Argument(..., help='A recorded flight: bag, video or images.'),
    rig: Path = typer.Option(..., help='The rig as far as it is known, within a few percent.'),
    camera_info: options.CameraInfo = None,
    camera_info_topic: options.CameraInfoTopic = None,
    distance: Optional[str] = typer.Option(
        None,
        help='A measured distance of two lights, m; without, the scale is that of the rough rig.',
        metavar='left:right=0.82',
    ),
    output: Path = typer.Option(Path('rig.yaml'), '--output', '-o', help='Rig file.'),
    report: ReportFolder = None,
    topic: options.ImageTopic = None,
    params_file: options.ParamsFile = None,
    param: options.Param = None,
    force: options.Force = False,
) -> None:
    """Find out from a flight where the lights of a rig really are.

    The body has to turn before the camera, by 20 degrees and more about two axes. marker_tracker
    names the lights by the rough rig; then their positions are adjusted to all images. Nothing is
    written if the flight does not determine them.
    """
    from mvuav_ros.offline import calibrate_rig as work
    from mvuav_ros.offline.report import write_report
    from mvuav_ros.parameters.marker_tracker import MarkerTrackerParameters
    from mvuav_ros.parameters.parameter_file import resolve_parameters
    from mvuav_ros.recordings.remote import write_whole
    from mvuav_ros.sources.calibration import load_calibration
    from mvuav_ros.sources.opening import open_source
    from mvuav_ros.vision.rig import RigError, load_rig, rig_text
    from mvuav_ros.vision.rig_calibration import RigCalibrationError

    try:
        rough = load_rig(rig)
    except RigError as error:
        raise ParameterError('--rig', str(error)) from error
    measured = work.parse_distance(distance) if distance else None
    given = resolve_parameters(['marker_tracker'], params_file or (), param or (), topic)
    parameters = MarkerTrackerParameters.from_mapping(given['marker_tracker'])
    inputs = source, camera_info, rig, *(params_file or ())
    report = _report_folder(report, output, force, *inputs)
    camera = load_calibration(camera_info) if camera_info else None
    opened = open_source(source, topic=topic, camera_info_topic=camera_info_topic)
    with closing(opened) as flight, frame_progress() as progress:
        task = progress.add_task('frames', total=flight.count)

        def show(frames: int) -> None:
            progress.update(task, completed=frames)

        try:
            made = work.calibrate_from(flight, rough, camera, parameters, measured, show)
        except RigCalibrationError as error:
            raise SourceError(f'{flight.name}: {error}') from error
    found = made.found
    write_whole(output, rig_text(made.rig, found.deviations))
    page = write_report(work.report_of(flight.name, made), report)
    say(
        f'{made.frames} frames, {found.frames} used; {found.used.sum()} of {made.detections} '
        f'detections fit, noise {found.noise:.2f} px',
        'light: position m, standard deviation mm, moved mm',
    )
    for name, place, deviation, before in zip(
        rough.names, found.positions, found.deviations, rough.positions, strict=True
    ):
        position = ' '.join(f'{value:.4f}' for value in place)
        spread = ' '.join(f'{1000 * value:.2f}' for value in deviation)
        say(f'{name}: {position}, {spread}, {1000 * math.dist(place, before):.1f}')
    if measured is None:
        say(
            f'the scale is that of the rough rig, known to {100 * found.scale_deviation:.2g} %; '
            'a measured --distance is better'
        )
    say(output, page)


def _report_folder(
    given: Path | None, output: Path, force: bool, *inputs: str | Path | None
) -> Path:
    from mvuav_ros.offline.report import PAGE

    options.refuse_to_overwrite(output, force, inputs=inputs)
    folder = given or output.parent / f'{output.stem}_report'
    options.refuse_to_overwrite(folder / PAGE, force)
    return folder
