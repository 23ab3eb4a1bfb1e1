"""From two edges and the horizon's slope to where the camera is."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.approach.approach_results import UNKNOWN_VARIANCE, Guidance
from mvuav_ros.vision.approach.attitude import Derotation
from mvuav_ros.vision.approach.strip_edges import EdgePoints, Edges
from mvuav_ros.vision.approach.tuning import EDGES, GUIDANCE
from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.frames import OPTICAL_FROM_BODY, rpy

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]


def locate(
    edges: Edges,
    near_row: float | None,
    level: Derotation,
    slope_sigma: float,
    camera: CameraModel,
    runway_width: float,
) -> Guidance:
    """Where the camera is in the runway's frame; nothing is known of few points, or if under it.

    The near end's row on the levelled working image is known if it is in sight. The level's slope
    has a standard deviation, rad; the runway is so many m wide from edge to edge.
    """
    rows, measured, noise = np.zeros(4), np.zeros(6), np.zeros((6, 6))
    for ends, points in zip((slice(0, 2), slice(2, 4)), edges, strict=True):
        fitted = _fitted(points, level, camera)
        if fitted is None:
            return Guidance()
        measured[ends], rows[ends], noise[ends, ends] = fitted
    measured[5] = math.nan if near_row is None else near_row
    inwards = np.kron([1.0, -1.0], np.eye(2))
    outside = np.concatenate([edge.outside for edge in edges])
    measured[:4] += outside * inwards.sum(axis=0)
    alike = np.hypot(GUIDANCE.width_bias / level.factor, GUIDANCE.outside_share * outside)
    noise[:4, :4] += (alike * inwards).T @ (alike * inwards)
    noise[4, 4] = slope_sigma**2
    noise[5, 5] = 0.0 if near_row is None else GUIDANCE.near_sigma**2

    def pose(values: Vector) -> Vector:
        return _pose(values, rows, level, camera, runway_width)

    solution = pose(measured)
    if not (np.isfinite(solution[1:]).all() and solution[2] > 0.0):
        return Guidance()
    jacobian = _jacobian(pose, measured)
    covariance = jacobian @ noise @ jacobian.T
    if not math.isfinite(solution[0]):
        covariance[0, :] = covariance[:, 0] = 0.0
        covariance[0, 0] = UNKNOWN_VARIANCE
    else:
        covariance[0, 0] += GUIDANCE.beginning_sigma**2
    x, y, z, roll, pitch, yaw = solution.tolist()
    return Guidance(x, y, z, roll, pitch, yaw, covariance)


def _fitted(
    points: EdgePoints, level: Derotation, camera: CameraModel
) -> tuple[Vector, Vector, Matrix] | None:
    """Columns and rows of an edge's two ends on a straight line, and the columns' covariance."""
    on_frame = np.stack(level.to_frame(points.columns, points.rows), axis=1)
    used, factor = (points.weights > 0) & camera.reaches(on_frame), level.factor
    if used.sum() < 4:
        return None
    rows, columns, weights = points.rows[used], points.columns[used], points.weights[used]
    ends = np.array([rows.min(), rows.max()])
    length = ends[1] - ends[0]
    if length < 2.0:
        return None
    share = (rows - ends[0]) / length
    design = np.stack([1.0 - share, share])
    weighted = design * weights
    inverse = np.linalg.inv(weighted @ design.T)
    at_ends = inverse @ (weighted @ columns)
    spread = float(np.average((columns - at_ends @ design) ** 2, weights=weights))
    least = (GUIDANCE.min_spread / factor) ** 2
    covariance = inverse * (max(spread, least) * EDGES.correlated_rows)
    covariance += np.diag((GUIDANCE.edge_bias / factor) ** 2 + np.square(points.doubt))
    return at_ends, ends, covariance


def _jacobian(function: Callable[[Vector], Vector], at: Vector) -> NDArray[np.float64]:
    """(6, n) slopes of a pose at n measurements; 0 where one of them is not known."""
    jacobian = np.zeros((6, at.size))
    for index in np.flatnonzero(np.isfinite(at)):
        step = GUIDANCE.jacobian_step * (np.arange(at.size) == index)
        change = (function(at + step) - function(at - step)) / (2 * GUIDANCE.jacobian_step)
        jacobian[:, index] = np.where(np.isfinite(change), change, 0.0)
    return jacobian


def _pose(
    values: Vector, rows: Vector, level: Derotation, camera: CameraModel, runway_width: float
) -> Vector:
    """x, y, z, roll, pitch, yaw.

    Of the columns of both edges at (4,) rows, the slope's error (rad), and the near end's row.
    """
    rays = _rays(values[:4], rows, level, camera)
    left, right = np.cross(rays[0], rays[1]), np.cross(rays[2], rays[3])
    forward = np.cross(left, right)
    if forward[2] < 0:
        forward = -forward
    forward /= np.linalg.norm(forward)
    if forward[2] < 1e-6:
        return np.full(6, np.nan)
    # The horizon passes through the vanishing point. Its slope was seen where it is nearest to the
    # camera's axis, where no radial distortion turns it.
    slope = level.slope + values[4]
    along = math.cos(slope) / camera.matrix[0, 0], math.sin(slope) / camera.matrix[1, 1], 0.0
    up = np.cross(along, forward)
    up /= np.linalg.norm(up)
    aside = np.cross(up, forward)
    left_slope = -(left @ up) / (left @ aside)
    right_slope = -(right @ up) / (right @ aside)
    # Seen from the camera, an edge lies (aside, -1) heights to the left and below.
    z = runway_width / (right_slope - left_slope)
    y = 0.5 * runway_width + left_slope * z
    rotation = np.stack([forward, aside, up]) @ OPTICAL_FROM_BODY
    x = math.nan
    if math.isfinite(values[5]):
        share = (values[5] - rows[0]) / (rows[1] - rows[0])
        column = values[0] + share * (values[1] - values[0])
        ray = _rays(np.array([column]), values[5:6], level, camera)[0]
        down = -(ray @ up)
        x = -z * float(ray @ forward) / down if down > 1e-6 else math.nan
    return np.array([x, y, z, *rpy(rotation)])


def _rays(columns: Vector, rows: Vector, level: Derotation, camera: CameraModel) -> Matrix:
    """(n, 3) directions in the optical frame of points of the levelled working image.

    NaN where the lens model has none.
    """
    pixels = np.stack(level.to_frame(columns, rows), axis=1)
    flat = camera.undistort(pixels)
    flat[~camera.reaches(pixels)] = math.nan
    return np.concatenate([flat, np.ones((len(flat), 1))], axis=1)
