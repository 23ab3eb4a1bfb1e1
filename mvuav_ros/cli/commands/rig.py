"""``mvuav rig``: marker rigs, examined before they fly."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import typer

from mvuav_ros.cli.terminal import say
from mvuav_ros.parameters.declaration import ParameterError

rig = typer.Typer(help='Examine marker rigs.', no_args_is_help=True)
_REACHES = (2.0, 5.0, 10.0, 20.0)
"""Distances that are looked at if none is given, in units of the rig's size."""
_LISTED = 6


@rig.callback()
def _rig() -> None:
    pass


@rig.command()
def check(
    file: Annotated[Path, typer.Argument(help='A rig file like config/tanker_747.yaml.')],
    distance: Annotated[
        list[float] | None,
        typer.Option(help='Distance from the camera, m; may be repeated.', show_default=False),
    ] = None,
    width: Annotated[int, typer.Option(help='Width of the images, px.', min=16)] = 640,
    fov: Annotated[
        float, typer.Option(help='Horizontal field of view, degrees.', min=1.0, max=150.0)
    ] = 60.0,
    noise: Annotated[
        float, typer.Option(help="Noise of a marker's position, px (1 sigma).", min=0.0)
    ] = 0.1,
) -> None:
    """Check a rig for ambiguities, and predict the errors of its pose.

    The exit status is 1 if marker_tracker refuses the rig unless allow_ambiguous is set.
    """
    from mvuav_ros.vision.camera import CameraModel
    from mvuav_ros.vision.rig import RigError, load_rig
    from mvuav_ros.vision.rig_examination import examine, is_flat, is_straight
    from mvuav_ros.vision.rig_observability import confusions, pose_error

    try:
        body = load_rig(file)
    except RigError as error:
        raise ParameterError('rig', str(error)) from error
    size = float(max(math.dist(a, b) for _, a in body.markers for _, b in body.markers))
    words = f'{body.name}: {len(body.names)} markers, {size:g} m across'
    if len(body.names) >= 3 and is_flat(body):
        words += ', all in one plane: the tilt is ambiguous'
    say(words)
    doubts = examine(body)
    for doubt in doubts:
        say(f'refused: {doubt}')
    if len(body.names) >= 3 and not is_straight(body):
        focal = 0.5 * width / math.tan(math.radians(0.5 * fov))
        height = round(0.75 * width)
        middle = 0.5 * (width - 1), 0.5 * (height - 1)
        k = (focal, 0.0, middle[0], 0.0, focal, middle[1], 0.0, 0.0, 1.0)
        camera = CameraModel(width, height, k)
        distances = distance or [size * reach for reach in _REACHES]
        say('')
        say(f'pose from straight behind, {width} px, {fov:g} deg, {noise:g} px of noise')
        say('distance m   size px  along m  across m  roll deg  pitch, yaw deg')
        for value in distances:
            e = pose_error(body, camera, value, noise)
            say(
                f'{e.distance:10.4g} {e.span:9.1f} {e.along:8.3g} {e.across:9.3g} '
                f'{e.roll:9.3g} {e.tilt:15.3g}'
            )
        say('')
        say(f'exchanged names with the smallest residuals, at {distances[0]:.4g} m')
        for found in confusions(body, camera, distances[0])[:_LISTED]:
            names = ', '.join(' -> '.join(cycle) for cycle in found.names)
            say(
                f'{found.residual:8.2f} px rms  {names} '
                f'(pitch {found.pitch_deg:g}, yaw {found.yaw_deg:g} deg)'
            )
    if doubts:
        raise typer.Exit(1)
