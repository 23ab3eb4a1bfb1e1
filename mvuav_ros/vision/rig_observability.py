"""How well a rig's pose and names can be known from a distance."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations, product

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.frames import OPTICAL_FROM_BODY
from mvuav_ros.vision.reprojection import Reprojection, rotation_of
from mvuav_ros.vision.rig import MarkerRig
from mvuav_ros.vision.rig_examination import cycles_of

Array = NDArray[np.float64]

TILTS_DEG = (-30.0, 0.0, 30.0)  # Pitch and yaw, each, of the views that are tried
_LEAST_AHEAD = math.cos(math.radians(60.0))
"""A pose whose x axis is turned away further is not one seen from behind, and no confusion."""
_MOST_MARKERS = 8  # Of a rig of which more than two names are exchanged at once
_STEP = 1e-6


@dataclass(frozen=True)
class PoseError:
    """What to expect of a pose (1 sigma), at one distance from straight behind."""

    distance: float  # from the camera to the middle of the markers, m
    span: float  # of the markers on the image, px
    along: float  # of the distance, m
    across: float  # sideways, the larger of x and y, m
    roll: float  # about the camera's axis, deg
    tilt: float  # of the body's axis, the larger of pitch and yaw, deg


@dataclass(frozen=True)
class Confusion:
    """Names that could be exchanged."""

    names: tuple[tuple[str, ...], ...]  # the cycles that are exchanged
    residual: float  # root mean square that the best pose with the wrong names leaves, px
    pitch_deg: float  # of the view in which it is least
    yaw_deg: float  # of the body there


def pose_error(rig: MarkerRig, camera: CameraModel, distance: float, noise: float) -> PoseError:
    """The pose's standard deviation: noise² (JᵀJ)⁻¹ of the reprojection's derivative J.

    Args:
        rig: whose markers do not lie on one line.
        camera: calibrated.
        distance: to the middle of the markers, m.
        noise: of a marker's place, px per axis (1 sigma).
    """
    points = rig.positions - rig.positions.mean(axis=0)
    rotation, translation = OPTICAL_FROM_BODY, np.array((0.0, 0.0, distance))
    columns = []
    for index in range(6):
        step = np.zeros(6)
        step[index] = _STEP
        sides = [
            _project(
                points,
                rotation_of(sign * step[3:]) @ rotation,
                translation + sign * step[:3],
                camera,
            )
            for sign in (1.0, -1.0)
        ]
        columns.append((sides[0] - sides[1]).ravel() / (2 * _STEP))
    jacobian = np.stack(columns, axis=-1)
    deviation = noise * np.sqrt(np.diag(np.linalg.pinv(jacobian.T @ jacobian)))
    x, y, z, pitch, yaw, roll = deviation.tolist()
    seen = _project(points, rotation, translation, camera)
    span = float(np.linalg.norm(seen[:, None] - seen, axis=2).max())
    tilt = math.degrees(max(pitch, yaw))
    return PoseError(distance, span, z, max(x, y), math.degrees(roll), tilt)


def confusions(rig: MarkerRig, camera: CameraModel, distance: float) -> list[Confusion]:
    """Every exchange of names with what it leaves unexplained, the worst (least) first.

    Args:
        rig: of three or more markers.
        camera: calibrated.
        distance: to the middle of the markers, m.
    """
    points = rig.positions - rig.positions.mean(axis=0)
    translation = np.array((0.0, 0.0, distance))
    views = []
    for pitch, yaw in product(TILTS_DEG, TILTS_DEG):
        turn = rotation_of(np.radians((pitch, yaw, 0.0)))
        views.append((_project(points, turn @ OPTICAL_FROM_BODY, translation, camera), pitch, yaw))
    found = []
    for order in _exchanges(len(points)):
        residual, pitch, yaw = min(
            (_least_residual(points, seen[list(order)], camera), pitch, yaw)
            for seen, pitch, yaw in views
        )
        if math.isfinite(residual):
            names = tuple(cycles_of(rig.names, order))
            found.append(Confusion(names, residual, pitch, yaw))
    return sorted(found, key=lambda confusion: confusion.residual)


def _exchanges(count: int) -> Iterator[tuple[int, ...]]:
    """Two names exchanged, three in a cycle, and two pairs."""
    identity = list(range(count))
    for a, b in combinations(range(count), 2):
        order = identity.copy()
        order[a], order[b] = b, a
        yield tuple(order)
        if count > _MOST_MARKERS:
            continue
        for c, d in combinations(range(a + 1, count), 2):
            if b not in (c, d):
                yield tuple({c: d, d: c}.get(index, other) for index, other in enumerate(order))
        for c in range(b + 1, count):
            for cycle in ({a: b, b: c, c: a}, {a: c, c: b, b: a}):
                yield tuple(cycle.get(index, index) for index in identity)


def _least_residual(points: Array, seen: Array, camera: CameraModel) -> float:
    """Root mean square of the best pose that is seen from behind, px; infinite for none."""
    view = Reprojection(camera, points, np.ascontiguousarray(seen))
    least = math.inf
    for rvec, tvec in view.closed_forms():
        solution = view.refine(rvec, tvec)
        # The body's x axis is to point away from the camera.
        if solution is not None and rotation_of(solution[0])[2, 0] >= _LEAST_AHEAD:
            least = min(least, math.sqrt(solution[2] / len(points)))
    return least


def _project(points: Array, rotation: Array, translation: Array, camera: CameraModel) -> Array:
    return camera.project(points, cv2.Rodrigues(rotation)[0], translation)
