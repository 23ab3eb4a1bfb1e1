"""A pose as a few numbers and lines: the runway as the camera sees it, or the tanker's attitude."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.frames import OPTICAL_FROM_BODY, rpy

Array = NDArray[np.float64]
Segment = tuple[str, float, float, float, float]
"""Colour and two points; the sketch reaches from -1 to 1, y down."""

_FOCAL = 1.6
"""In half widths of the sketch: 64 degrees wide."""
_RUNWAY_LENGTH, _USUAL_WIDTH, _FAR, _NEAREST = 1500.0, 45.0, 1e5, 0.5
_TANKER_REACH = 38.0
_TANKER = (
    ('ink', (-36.0, 0.0, 0.0), (34.0, 0.0, 0.0)),
    ('left', (4.0, 0.0, 0.0), (-12.0, 29.8, 1.0)),
    ('right', (4.0, 0.0, 0.0), (-12.0, -29.8, 1.0)),
    ('left', (-32.0, 0.0, 2.0), (-37.0, 11.0, 3.0)),
    ('right', (-32.0, 0.0, 2.0), (-37.0, -11.0, 3.0)),
    ('accent', (-32.0, 0.0, 1.0), (-36.5, 0.0, 13.0)),
)


class Sketch(NamedTuple):
    """What the page shows of a pose: labels and values with units, and lines."""

    numbers: tuple[tuple[str, str], ...]
    segments: tuple[Segment, ...] = ()


def sketch_runway(position: Sequence[float], rotation: Array, width: float) -> Sketch:
    """The camera before a runway: its place in the runway's frame, m (see `Guidance`).

    ``rotation``: (3, 3), runway's frame from the camera's body axes; ``width`` in m, 0: not known.
    """
    x, y, z = position
    numbers = (
        ('before the near end', _metres(-x)),
        ('left of the centreline', _metres(y)),
        ('height', _metres(z)),
        *_attitude(rotation, 'heading error'),
    )
    if not all(map(math.isfinite, (y, z, *rotation.flat))):
        return Sketch(numbers)
    place = np.array([x if math.isfinite(x) else 0.0, y, z])
    half = (width if width > 0 else _USUAL_WIDTH) / 2
    far = _RUNWAY_LENGTH
    lines = (
        ('ink', (0.0, -half), (0.0, half)),
        ('ink', (far, -half), (far, half)),
        ('ink', (0.0, half), (far, half)),
        ('ink', (0.0, -half), (far, -half)),
        ('soft', (0.0, 0.0), (far, 0.0)),
        ('accent', (_FAR, 0.8 * _FAR), (_FAR, -0.8 * _FAR)),
    )
    optical = OPTICAL_FROM_BODY @ rotation.T
    ends = [(color, np.array(((*a, 0.0), (*b, 0.0)))) for color, a, b in lines]
    seen = [(color, optical @ (each - place).T) for color, each in ends]
    ahead = [(color, _projected(each)) for color, each in seen if each[2].max() > _NEAREST]
    return Sketch(numbers, tuple(_segment(color, each) for color, each in ahead))


def sketch_tanker(position: Sequence[float], rotation: Array) -> Sketch:
    """A body before the camera, in its optical frame (m); (3, 3) optical frame from the body's."""
    x, y, z = position
    numbers = (
        ('ahead', _metres(z)),
        ('to the right', _metres(x)),
        ('below', _metres(y)),
        *_attitude(OPTICAL_FROM_BODY.T @ rotation, 'yaw'),
    )
    if not all(map(math.isfinite, (x, y, z, *rotation.flat))):
        return Sketch(numbers)
    ends = [(color, rotation @ np.array(line).T / _TANKER_REACH) for color, *line in _TANKER]
    return Sketch(numbers, tuple(_segment(color, each) for color, each in ends))


def rotation_of(quaternion: Any) -> Array:
    """A geometry_msgs/Quaternion as a matrix; NaN where it is none."""
    q = np.array([quaternion.w, quaternion.x, quaternion.y, quaternion.z], dtype=float)
    length = float(np.linalg.norm(q)) if (np.abs(q) < 1e3).all() else 0.0
    if length < 1e-6:
        return np.full((3, 3), math.nan)
    w, x, y, z = q / length
    across = np.array([(0.0, -z, y), (z, 0.0, -x), (-y, x, 0.0)])
    return np.asarray(np.eye(3) + 2.0 * w * across + 2.0 * across @ across)


def _projected(ends: Array) -> Array:
    """The part that lies ahead of a line (3, 2) in the optical frame, as the camera sees it."""
    depth = ends[2]
    for near, far in ((0, 1), (1, 0)):
        if depth[near] < _NEAREST:
            share = (_NEAREST - depth[near]) / (depth[far] - depth[near])
            ends[:, near] += share * (ends[:, far] - ends[:, near])
    return np.asarray(_FOCAL * ends[:2] / ends[2])


def _segment(color: str, ends: Array) -> Segment:
    (x1, x2), (y1, y2) = np.clip(ends[:2], -1e4, 1e4).round(4).tolist()
    return color, x1, y1, x2, y2


def _attitude(rotation: Array, yaw: str) -> list[tuple[str, str]]:
    return list(zip(('roll', 'pitch', yaw), map(_degrees, rpy(rotation)), strict=True))


def _metres(value: float) -> str:
    return f'{value:.1f} m' if abs(value) < 1e6 else '-'


def _degrees(value: float) -> str:
    # Adding 0 makes -0.0 a 0.0.
    return f'{round(math.degrees(value), 1) + 0.0:.1f}°' if math.isfinite(value) else '-'
