"""What is true of an image of the runway."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.simulation.camera import PinholeCamera
from mvuav_ros.vision.frames import Matrix, Vector
from mvuav_ros.vision.runway.normal_form import NormalForm
from mvuav_ros.vision.runway.results import LineRole

NEAR = 0.1
"""Lines are cut where they come closer than this to the camera's plane, m."""


class LineTruth(NamedTuple):
    """A straight line in the image: x cos theta + y sin theta = rho.

    Attributes:
        role: which line of the runway; the edges are the pavement's.
        visible: whether any of it is on the frame; all numbers are NaN otherwise.
        rho: px.
        theta: rad, in (-pi/2, pi/2].
        x1: px; the end that is nearer, or left for the runway's ends, cut at the frame.
        y1: px.
        x2: px; the other end.
        y2: px.
    """

    role: LineRole
    visible: bool
    rho: float
    theta: float
    x1: float
    y1: float
    x2: float
    y2: float


class CameraPose(NamedTuple):
    """The camera in the runway's frame.

    The frame: origin on the centreline at the near end, x along the centreline towards the far
    end, y left, z up.

    Attributes:
        position: (3,), m.
        roll: rad, right wing down positive.
        pitch: rad, REP-103: positive looking down.
        yaw: rad, REP-103: positive looking left of the runway's direction.
        rotation: (3, 3), runway's from the camera's optical frame.
    """

    position: Vector
    roll: float
    pitch: float
    yaw: float
    rotation: Matrix


@dataclass(frozen=True, eq=False)
class RunwayTruth:
    """What an image of the runway shows.

    Attributes:
        time: s since the start of the flight.
        lines: in the order of `LineRole`.
        vanishing_point: px, where the runway's lines meet; NaN when it is behind the camera.
        horizon: rho (px) and theta (rad) of the ground's horizon.
        pose: the camera in the runway's frame, shake included.
        gain: by which the camera's image is brighter than usual.
        camera: with its matrix K.
    """

    time: float
    lines: tuple[LineTruth, ...]
    vanishing_point: tuple[float, float]
    horizon: tuple[float, float]
    pose: CameraPose
    gain: float
    camera: PinholeCamera

    def line(self, role: LineRole) -> LineTruth:
        """The line of that role."""
        return self.lines[role - 1]


def true_lines(
    camera: PinholeCamera, pose: CameraPose, width: float, length: float
) -> tuple[LineTruth, ...]:
    """The runway's lines as seen by a camera without distortion."""
    half = 0.5 * width
    ends = {
        LineRole.LEFT_EDGE: ((0.0, half), (length, half)),
        LineRole.RIGHT_EDGE: ((0.0, -half), (length, -half)),
        LineRole.CENTRELINE: ((0.0, 0.0), (length, 0.0)),
        LineRole.FAR_END: ((length, half), (length, -half)),
        LineRole.NEAR_END: ((0.0, half), (0.0, -half)),
    }
    return tuple(
        _project_line(camera, pose, role, np.array([(*a, 0.0), (*b, 0.0)]))
        for role, (a, b) in ends.items()
    )


def normal_form(line: NDArray[np.floating[Any]]) -> tuple[float, float]:
    """The normal form of a x + b y + c = 0: rho, and theta in (-pi/2, pi/2]."""
    a, b, c = (float(v) for v in line)
    size = math.hypot(a, b)
    if size == 0.0:
        return math.nan, math.nan
    return NormalForm(-c / size, math.atan2(b, a)).normalised()


def vanishing_point(camera: PinholeCamera, pose: CameraPose) -> tuple[float, float]:
    """Where lines along the runway meet, px."""
    ((x, y),) = camera.project(pose.rotation[:1]).tolist()
    return x, y


def horizon(camera: PinholeCamera, pose: CameraPose) -> tuple[float, float]:
    """The horizon of the runway's plane: rho (px) and theta (rad)."""
    up = pose.rotation.T[:, 2]
    return normal_form(np.linalg.inv(camera.matrix).T @ up)


def horizon_anchor(camera: PinholeCamera, pose: CameraPose) -> tuple[float, float, float]:
    """Where the horizon is straight ahead (px), and its slope in the image (rad)."""
    forward = pose.rotation[:, 2] * (1.0, 1.0, 0.0)
    up = pose.rotation[2]
    ((x, y),) = camera.project((pose.rotation.T @ forward)[None]).tolist()
    return x, y, math.atan2(up[0], -up[1])


def _project_line(
    camera: PinholeCamera, pose: CameraPose, role: LineRole, ends: Matrix
) -> LineTruth:
    nothing = LineTruth(role, False, *[math.nan] * 6)
    points = (ends - pose.position) @ pose.rotation
    plane = np.cross(points[0], points[1])
    cut = _cut_near(points)
    if cut is None:
        return nothing
    (x1, y1), (x2, y2) = camera.project(cut)
    segment = clip_segment(x1, y1, x2, y2, camera.width - 1.0, camera.height - 1.0)
    if segment is None:
        return nothing
    rho, theta = normal_form(np.linalg.inv(camera.matrix).T @ plane)
    return LineTruth(role, True, rho, theta, *segment)


def _cut_near(points: Matrix) -> Matrix | None:
    """Two points moved along their line until both are in front of the camera."""
    depth = points[:, 2] - NEAR
    if depth.max() <= 0.0:
        return None
    cut = points.copy()
    for end in (0, 1):
        if depth[end] < 0.0:
            part = depth[end] / (depth[end] - depth[1 - end])
            cut[end] = points[end] + part * (points[1 - end] - points[end])
    return cut


def clip_segment(
    x1: float, y1: float, x2: float, y2: float, right: float, bottom: float
) -> tuple[float, float, float, float] | None:
    """The part of a segment with 0 <= x <= right and 0 <= y <= bottom (Liang-Barsky)."""
    dx, dy = x2 - x1, y2 - y1
    enter, leave = 0.0, 1.0
    for step, room in ((-dx, x1), (dx, right - x1), (-dy, y1), (dy, bottom - y1)):
        if step == 0.0:
            if room < 0.0:
                return None
        elif step < 0.0:
            enter = max(enter, room / step)
        else:
            leave = min(leave, room / step)
    if enter > leave:
        return None
    return (
        float(x1 + enter * dx),
        float(y1 + enter * dy),
        float(x1 + leave * dx),
        float(y1 + leave * dy),
    )
