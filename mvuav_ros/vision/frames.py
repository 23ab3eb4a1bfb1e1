"""The frames of REP-103, and rotations between them.

Bodies and the world: x forward, y left, z up. A camera's optical frame: x right, y down, z ahead.
"""

from __future__ import annotations

import math
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

Matrix = NDArray[np.float64]
Vector = NDArray[np.float64]
Array = TypeVar('Array', bound=NDArray[Any])

OPTICAL_FROM_BODY: Matrix = np.array([(0.0, -1.0, 0.0), (0.0, 0.0, -1.0), (1.0, 0.0, 0.0)])
"""The one matrix from a body's axes to the optical axes of a camera that looks along its x."""


def about_x(angle: float) -> Matrix:
    """Rotation by ``angle`` (rad) about x."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([(1.0, 0.0, 0.0), (0.0, c, -s), (0.0, s, c)])


def about_y(angle: float) -> Matrix:
    """Rotation by ``angle`` (rad) about y."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([(c, 0.0, s), (0.0, 1.0, 0.0), (-s, 0.0, c)])


def about_z(angle: float) -> Matrix:
    """Rotation by ``angle`` (rad) about z."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([(c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0)])


def from_rpy(roll: float, pitch: float, yaw: float) -> Matrix:
    """World from body for REP-103's fixed-axis angles (rad).

    Positive are: roll right wing down, pitch nose down, yaw nose left.
    """
    return about_z(yaw) @ about_y(pitch) @ about_x(roll)


def read_only(array: Array) -> Array:
    """Forbid writing to what several frames share."""
    array.setflags(write=False)
    return array
