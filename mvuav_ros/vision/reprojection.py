"""The reprojection error of some markers of a rig, and the poses that make it least."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import product

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.frames import OPTICAL_FROM_BODY

Array = NDArray[np.float64]

FEWEST = 3  # Markers for a pose: with three there may be four solutions, all of which fit
_TILTS = tuple(math.radians(angle) for angle in (-30.0, 0.0, 30.0))
_REFINEMENT = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 20, 1e-10)
_NEXT, _LAST = [1, 2, 0], [2, 0, 1]
"""Of the axes, for a cross product."""

Solution = tuple[Array, Array, float]
"""Rotation vector and translation, each (3, 1), and the sum of the squared residuals, px²."""


class Reprojection:
    """Some markers of a rig in one image."""

    def __init__(self, camera: CameraModel, points: Array, image: Array) -> None:
        self.image = image
        self._points = points
        self._matrix, self._distortion = camera.matrix, camera.distortion

    def refine(self, rvec: Array, tvec: Array) -> Solution | None:
        """The nearest minimum of the reprojection error; None behind the camera."""
        try:
            refined = cv2.solvePnPRefineLM(
                self._points,
                self.image,
                self._matrix,
                self._distortion,
                rvec.copy(),
                tvec.copy(),
                _REFINEMENT,
            )
        except cv2.error:
            return None
        rvec, tvec = (np.asarray(vector, np.float64) for vector in refined)
        if not (np.isfinite(rvec).all() and np.isfinite(tvec).all()):
            return None
        in_front = (self._points @ rotation_of(rvec).T)[:, 2] + tvec[2] > 0.0
        if not in_front.all():
            return None
        seen, _ = cv2.projectPoints(self._points, rvec, tvec, self._matrix, self._distortion)
        residual = self.image - seen.reshape(-1, 2)
        return rvec, tvec, float((residual * residual).sum())

    def solve(self) -> list[Solution]:
        """All solutions that OpenCV's solvers and a few tilted starts lead to."""
        starts = self.closed_forms()
        middle = self._points.mean(axis=0)
        for rvec, tvec in starts[:1]:
            centre = rotation_of(rvec) @ middle + tvec.reshape(3)
            roll = rotation_of(np.array((0.0, 0.0, self._roll())))
            for pitch, yaw in product(_TILTS, _TILTS):
                rotation = roll @ rotation_of(np.array((pitch, yaw, 0.0))) @ OPTICAL_FROM_BODY
                turned = np.asarray(cv2.Rodrigues(rotation)[0], np.float64)
                starts.append((turned, (centre - rotation @ middle).reshape(3, 1)))
        refined = [self.refine(rvec, tvec) for rvec, tvec in starts]
        return [solution for solution in refined if solution is not None]

    def _roll(self) -> float:
        """In the image, rad, as if the markers were seen from straight behind."""
        _, y, z = (self._points - self._points.mean(axis=0)).T
        u, v = (self.image - self.image.mean(axis=0)).T
        return float(np.angle(((z * 1j - y) * (u + 1j * v)).sum()))

    def closed_forms(self) -> list[tuple[Array, Array]]:
        """Rotation vectors and translations by OpenCV's solvers, all that there are of three."""
        methods = [cv2.SOLVEPNP_SQPNP]
        if len(self._points) == FEWEST:
            methods = [cv2.SOLVEPNP_P3P, cv2.SOLVEPNP_AP3P, cv2.SOLVEPNP_SQPNP]
        found: list[tuple[Array, Array]] = []
        for method in methods:
            try:
                _, rvecs, tvecs, _ = cv2.solvePnPGeneric(
                    self._points, self.image, self._matrix, self._distortion, flags=method
                )
            except cv2.error:
                continue
            found += [
                (np.asarray(rvec, np.float64), np.asarray(tvec, np.float64))
                for rvec, tvec in zip(rvecs, tvecs, strict=True)
            ]
        return found

    def jacobian(self, rvec: Array, tvec: Array) -> Array:
        """(2n, 6), of the pixels by translation (m) and small turns about the fixed axes (rad)."""
        derivatives = cv2.projectPoints(self._points, rvec, tvec, self._matrix, self._distortion)[1]
        by_place = derivatives[:, 3:6]
        # A small turn w moves a point p, as seen from the body's origin, by w x p.
        points = np.repeat(self._points @ rotation_of(rvec).T, 2, axis=0)
        by_turn = points[:, _NEXT] * by_place[:, _LAST] - points[:, _LAST] * by_place[:, _NEXT]
        return np.hstack((by_place, by_turn))


def projection_derivatives(
    camera: CameraModel,
    points: Array,
    rotation: Array,
    translation: Array,
    about: Sequence[float],
) -> tuple[Array, Array, Array, Array, Array]:
    """Where points of a body are seen, and how that changes with its pose and the calibration.

    Args:
        camera: calibrated.
        points: (n, 3), m, in the body's frame.
        rotation: (3, 3), optical frame from the body's.
        translation: (3,), of the body's origin, m.
        about: (3,), m, the body's point that small turns leave in its place.

    Returns:
        The pixels (n, 2), and their derivatives: by the place (n, 2, 3, px/m), by small turns
        about the optical axes (n, 2, 3, px/rad), by the focal length's relative error (n, 2, px)
        and by the principal point (n, 2, 2).
    """
    rvec = cv2.Rodrigues(rotation)[0]
    seen, derivatives = cv2.projectPoints(
        points, rvec, translation, camera.matrix, camera.distortion
    )
    count = len(points)
    derivatives = derivatives.reshape(count, 2, -1)
    by_place = derivatives[:, :, 3:6]
    # A small turn w moves a point p, as seen from the fixed one, by w x p.
    arms = ((points - about) @ rotation.T)[:, None, :]
    by_turn = arms[:, :, _NEXT] * by_place[:, :, _LAST] - arms[:, :, _LAST] * by_place[:, :, _NEXT]
    by_focal = derivatives[:, :, 6] * camera.k[0] + derivatives[:, :, 7] * camera.k[4]
    return seen.reshape(-1, 2), by_place, by_turn, by_focal, derivatives[:, :, 8:10]


def rotation_of(rvec: Array) -> Array:
    """Rotation matrix of a rotation vector."""
    return np.asarray(cv2.Rodrigues(rvec)[0], np.float64)


def inverse(matrix: Array) -> Array | None:
    """Of a symmetric matrix; None where it has none."""
    try:
        return np.asarray(np.linalg.inv(matrix), np.float64)
    except np.linalg.LinAlgError:
        return None
