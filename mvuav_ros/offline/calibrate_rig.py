"""A rig calibrated from a flight: the names of its lights, the adjustment, its report."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.offline.report import Figure, Report, Section, Table
from mvuav_ros.offline.report_figures import COLORS, residual_figure
from mvuav_ros.parameters.declaration import ParameterError
from mvuav_ros.parameters.marker_tracker import MarkerTrackerParameters
from mvuav_ros.processing.tracking import track
from mvuav_ros.sources.source import FrameSource, SourceError, nothing_to_read
from mvuav_ros.vision.camera import CalibrationError, CameraModel
from mvuav_ros.vision.markers.marker_results import named_places
from mvuav_ros.vision.rig import MarkerRig
from mvuav_ros.vision.rig_calibration import (
    MIN_LIGHTS,
    RigCalibration,
    RigCalibrationError,
    calibrate_rig,
    refuse_few_lights,
)

_MAX_PASSES = 4
_MORE = 1.01  # Times the lights that are named: a pass that names no more is the last one
_DRAWN = 4000  # Residuals


@dataclass(frozen=True, eq=False)
class CalibratedRig:
    """A rig, the rough one that it was made from, and how.

    The pixels (f, n, 2), NaN where a light is not seen, are by the names of the last pass over the
    flight's frames, of which each had a better rig.
    """

    rig: MarkerRig
    rough: MarkerRig
    camera: CameraModel
    pixels: NDArray[np.float64]
    found: RigCalibration
    frames: int
    passes: int

    @property
    def detections(self) -> int:
        """How many lights are seen in all images."""
        return _count(self.pixels)


_MAX_OFF = 1.5
"""Times the rough rig's: a measured distance beyond is in another unit, or of other lights."""


def calibrate_from(
    source: FrameSource,
    rough: MarkerRig,
    camera: CameraModel | None,
    parameters: MarkerTrackerParameters,
    distance: tuple[str, str, float] | None = None,
    advance: Callable[[int], object] = lambda frames: None,
) -> CalibratedRig:
    """Name the lights in a flight and calibrate the rig, again with each better rig.

    The rough rig is known within a few percent; without a camera the flight's own is taken.
    ``distance`` is that of two of the lights, m. ``advance`` gets the number of frames read in a
    pass.

    Raises:
        SourceError: the flight has no images, or no calibration of theirs.
        RigCalibrationError: the flight does not determine the rig.
    """
    if source.live:
        raise SourceError(f'{source.name}: record the flight first; it is read several times')
    refuse_few_lights(len(rough.names))
    between = None if distance is None else _between(rough, *distance)
    rig, before, best = rough, 0, None
    for number in range(1, _MAX_PASSES + 1):
        used, pixels = name_lights(source, rig, camera, parameters, advance)
        named, frames = _count(pixels), len(pixels)
        if not (best or named):
            nameless = f'no light of {rough.name} is named in {frames} images: '
            raise RigCalibrationError(nameless + _signs(source, rough, used, parameters))
        if best is not None and named <= _MORE * before:
            break
        before = named
        found = calibrate_rig(rough.positions, used, pixels, between, rough.names)
        rig = rough.moved(found.positions)
        best = CalibratedRig(rig, rough, used, pixels, found, frames, number)
    assert best is not None
    return best


def _signs(
    source: FrameSource, rig: MarkerRig, camera: CameraModel, parameters: MarkerTrackerParameters
) -> str:
    """With which signs of a rig's coordinates its lights are named in a flight, in words."""
    for axes, signs in {'y or z': (1, -1, 1), 'x': (-1, 1, 1), 'x and y': (-1, -1, 1)}.items():
        other = rig.moved(rig.positions * signs)
        if _count(name_lights(source, other, camera, parameters, lambda frames: None)[1]):
            return f'they are with the other sign of {axes}; x is forward, y left, z up'
    return 'see mvuav rig check, and the threshold of marker_tracker (--param)'


def _between(rough: MarkerRig, first: str, second: str, metres: float) -> tuple[int, int, float]:
    """Two lights by their numbers and their distance, if it can be meant in m."""
    for name in (first, second):
        if name not in rough.names:
            raise RigCalibrationError(
                f'there is no light {name} in {rough.name}: {", ".join(rough.names)}'
            )
    one, other = map(rough.names.index, (first, second))
    roughly = math.dist(rough.positions[one], rough.positions[other])
    if not roughly / _MAX_OFF < metres < roughly * _MAX_OFF:
        raise RigCalibrationError(
            f'{first} and {second} are {roughly:.4g} m apart on the rough rig, not '
            f'{metres:g}: is the distance in m?'
        )
    return one, other, metres


def name_lights(
    source: FrameSource,
    rig: MarkerRig,
    camera: CameraModel | None,
    parameters: MarkerTrackerParameters,
    advance: Callable[[int], object],
) -> tuple[CameraModel, NDArray[np.float64]]:
    """The frames' camera, and where (f, n, 2), px, the tracker sees each light; NaN if not.

    Raises:
        SourceError: there are no images, or no calibration of theirs.
    """
    used, pixels = None, []
    try:
        for frame in track(source, camera, rig, parameters):
            if frame.image is None:
                source.account.leave_out(frame.stamp_ns, frame.status)
                continue
            if frame.camera is None:
                said = 'has no calibration beside its images: --camera-info, or --camera-info-topic'
                raise SourceError(f'{source.name} {said}')
            size = frame.image.width, frame.image.height
            frame.camera.check(*size)
            used = used or frame.camera
            labels, places = named_places(frame.result, size)
            pixels.append(np.full((len(rig.names), 2), np.nan))
            pixels[-1][labels] = places
            advance(len(pixels))
    except CalibrationError as error:
        raise SourceError(f'{source.name}: {error}') from error
    if used is None:
        raise nothing_to_read(source)
    return used, np.array(pixels)


def _count(pixels: NDArray[np.float64]) -> int:
    """How many lights are seen."""
    return int(np.isfinite(pixels[..., 0]).sum())


def report_of(name: str, made: CalibratedRig) -> Report:
    """The page: the lights, and what they leave unexplained."""
    found = made.found
    moved = 1000 * (found.positions - made.rough.positions)
    rows = []
    for index, light in enumerate(made.rig.names):
        mine = found.used[:, index]
        rms = float(np.sqrt(np.mean(found.residuals[mine, index] ** 2)))
        rows.append(
            (
                light,
                *found.positions[index].tolist(),
                *(1000 * found.deviations[index]).tolist(),
                float(np.linalg.norm(moved[index])),
                int(mine.sum()),
                rms,
            )
        )
    scale = '; the given distance is taken as exact.'
    if deviation := 100 * found.scale_deviation:
        scale = f', and of the scale ({deviation:.2g} %), which is the rough rig’s.'  # noqa: RUF001
    lights = Table.of(
        'lights',
        'Lights',
        'light | x [m] .5 | y [m] .5 | z [m] .5 | sd x [mm] .2 | sd y [mm] .2 | sd z [mm] .2 | '
        'moved [mm] .1 | detections | residual [px] .3',
        rows,
        f'Standard deviations (sd) are of the noise in the images{scale} Moved is the distance to '
        'the rough position.',
    )
    return Report(
        f'Calibration of {made.rig.name}',
        (
            f'{len(made.rig.names)} lights from {found.frames} images; noise of a light '
            f'{found.noise:.3f} px per axis; {int(found.used.sum())} of {made.detections} '
            'detections used.',
        ),
        {
            'source': name,
            'rough rig': made.rough.name,
            'frames': made.frames,
            'passes': made.passes,
            'fewest lights in an image': MIN_LIGHTS,
        },
        (Section('Lights', (), (lights,)), Section('Residuals', (), (_residual_figure(made),))),
    )


def _residual_figure(made: CalibratedRig) -> Figure:
    found = made.found
    every = -(-int(found.used.sum()) // _DRAWN)
    residuals = []
    for index, name in enumerate(made.rig.names):
        mine = np.flatnonzero(found.used[:, index])[::every]
        color = COLORS[index % len(COLORS)]
        own = made.pixels[mine, index], found.residuals[mine, index]
        residuals.append((*own, color, name))
    return residual_figure(
        'Residuals of the lights',
        (made.camera.width, made.camera.height),
        found.noise,
        residuals,
        'arrows over the image',
        'a wrong camera calibration, a body that bends, or lights that look different from aside.',
    )


def parse_distance(text: str) -> tuple[str, str, float]:
    """Read ``left:right=0.82``.

    Raises:
        ParameterError: it is anything else.
    """
    names, _, metres = text.partition('=')
    first, colon, second = names.partition(':')
    try:
        value = float(metres)
    except ValueError:
        value = 0.0
    if not (first and second and colon and 0.0 < value < 1e6) or first == second:
        said = f'write two lights and metres, as in left:right=0.82, not {text!r}'
        raise ParameterError('--distance', said)
    return first, second, value
