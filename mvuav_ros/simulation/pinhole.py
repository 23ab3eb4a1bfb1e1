"""The simulator's camera: a pinhole with lens distortion, and where it is over the ground."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.parameters.declaration import ParameterError
from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.frames import Matrix, Vector

_MAX_COEFFICIENT = 1e6  # of any distortion that a lens might have, and far below what overflows


def pinhole_camera(
    width: int, height: int, fov_deg: float, distortion: tuple[float, ...] = ()
) -> CameraModel:
    """A camera of square pixels, with its axis in the middle of the image.

    The field of view is the horizontal one without distortion, from edge to edge of the frame.

    Raises:
        ParameterError: the distortion folds the image onto itself.
    """
    focal = 0.5 * width / math.tan(math.radians(0.5 * fov_deg))
    k = (focal, 0.0, 0.5 * (width - 1), 0.0, focal, 0.5 * (height - 1), 0.0, 0.0, 1.0)
    camera = CameraModel(width, height, k, distortion)
    if camera.widest <= 0.5 * math.hypot(width, height) / focal:
        reason = 'folds the image onto itself within the field of view'
        raise ParameterError('distortion', reason)
    return camera


def seen_by(camera: CameraModel, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Where points (n, 3), m, in the optical frame are seen, (n, 2) px; NaN where they are not."""
    pixels = camera.project(points)
    pixels[~camera.shows(points)] = np.nan
    return pixels


class CameraPose(NamedTuple):
    """The camera in the runway's frame.

    The frame: origin on the centreline at the near end, x along the centreline towards the far
    end, y left, z up.

    Angles are rad, as in REP-103.
    """

    position: Vector  # (3,), m
    roll: float  # right wing down positive
    pitch: float  # positive looking down
    yaw: float  # positive looking left of the runway's direction
    rotation: Matrix  # (3, 3), runway's from the camera's optical frame


def parse_distortion(text: str) -> tuple[float, ...]:
    """Read ``k1, k2, p1, p2`` or ``k1, k2, p1, p2, k3``; nothing means no distortion.

    Raises:
        ParameterError: it is anything else.
    """
    if not text.strip():
        return (0.0,) * 5
    try:
        numbers = [float(word) for word in text.replace(',', ' ').split()]
    except ValueError:
        numbers = []
    if len(numbers) not in (4, 5) or not all(abs(number) < _MAX_COEFFICIENT for number in numbers):
        reason = f'takes k1, k2, p1, p2 and perhaps k3, not {text!r}'
        raise ParameterError('distortion', reason)
    return (*numbers, 0.0)[:5]
