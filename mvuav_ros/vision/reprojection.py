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

MIN_MARKERS = 3  # Markers for a pose: with three there may be four solutions, all of which fit
_TILTS = tuple(math.radians(angle) for angle in (-30.0, 0.0, 30.0))
_MAX_STEPS = 20
_FIRST_DAMPING = 1e-3  # part of the normal matrix's diagonal
_SMALL_STEP = 2e-6  # of the pose, after which the next step is lost in rounding
_NEXT, _LAST = [1, 2, 0], [2, 0, 1]
"""Of the axes, for a cross product."""

Solution = tuple[Array, Array, float]
"""Rotation vector and translation, each (3, 1), and the sum of the squared residuals, px²."""


class Reprojection:
    """Some markers of a rig in one image."""

    def __init__(self, camera: CameraModel, points: Array, image: Array) -> None:
        self.image = image
        self._points = points
        self._camera = camera
        # The newest solution's rotation vector, and the derivatives and places there.
        self._newest: tuple[Array, Array, Array] | None = None
        self._turned: tuple[Array, Array] | None = None  # its rotation matrix
        # OpenCV's solvers know pinhole cameras alone.
        self._matrix, self._distortion = camera.matrix, camera.distortion
        self._flat = image
        if camera.is_fisheye:
            self._matrix, self._distortion = np.eye(3), np.zeros(5)
            self._flat = camera.undistort(image)

    def refine(self, rvec: Array, tvec: Array) -> Solution | None:
        """The nearest minimum of the reprojection error; None behind the camera."""
        try:
            rvec, tvec, squares = self._descend(rvec, tvec)
        except (cv2.error, np.linalg.LinAlgError):
            return None
        if not (math.isfinite(squares) and np.isfinite(rvec).all() and np.isfinite(tvec).all()):
            return None
        depths = self._points.dot(self._rotation(rvec)[2])
        return (rvec, tvec, squares) if float(depths.min()) + float(tvec[2, 0]) > 0.0 else None

    def _descend(self, rvec: Array, tvec: Array) -> Solution:
        """Levenberg-Marquardt on the image error, for any camera model.

        OpenCV's knows pinhole cameras alone, and goes on to differences that no light shows. A
        small step is taken as the derivatives have it: what is left is its square.
        """
        at = np.concatenate((rvec.ravel(), tvec.ravel()))
        seen, jacobian = self._camera.project_with_jacobian(self._points, at[:3], at[3:])
        residual, damping = (self.image - seen).ravel(), _FIRST_DAMPING
        squares = float(residual.dot(residual))
        for _ in range(_MAX_STEPS):
            normal = jacobian.T.dot(jacobian)
            normal.reshape(-1)[::7] *= 1.0 + damping
            regular, step = cv2.solve(
                normal, jacobian.T.dot(residual)[:, None], flags=cv2.DECOMP_CHOLESKY
            )
            if not regular:
                damping *= 10.0
                continue
            step = step.ravel()
            tried = at + step
            if step.dot(step) <= _SMALL_STEP**2 * at.dot(at):
                at, residual = tried, residual - jacobian.dot(step)
                squares = float(residual.dot(residual))
                break
            seen, changed = self._camera.project_with_jacobian(self._points, tried[:3], tried[3:])
            left = (self.image - seen).ravel()
            less = float(left.dot(left))
            if less <= squares:
                at, jacobian, residual, squares, damping = tried, changed, left, less, 0.1 * damping
            else:
                damping *= 10.0
        rvec, tvec = at[:3].reshape(3, 1), at[3:].reshape(3, 1)
        self._newest = rvec, jacobian, self.image - residual.reshape(-1, 2)
        self._turned = rvec, rotation_of(rvec)
        return rvec, tvec, squares

    def _rotation(self, rvec: Array) -> Array:
        if self._turned is None or self._turned[0] is not rvec:
            self._turned = rvec, rotation_of(rvec)
        return self._turned[1]

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
        if len(self._points) == MIN_MARKERS:
            methods = [cv2.SOLVEPNP_P3P, cv2.SOLVEPNP_AP3P, cv2.SOLVEPNP_SQPNP]
        found: list[tuple[Array, Array]] = []
        for method in methods:
            try:
                _, rvecs, tvecs, _ = cv2.solvePnPGeneric(
                    self._points, self._flat, self._matrix, self._distortion, flags=method
                )
            except cv2.error:
                continue
            found += [
                (np.asarray(rvec, np.float64), np.asarray(tvec, np.float64))
                for rvec, tvec in zip(rvecs, tvecs, strict=True)
            ]
        return found

    def places(self, rvec: Array, tvec: Array) -> Array:
        """Where the markers should be seen in a pose, (n, 2) px."""
        if self._newest is not None and self._newest[0] is rvec:
            return self._newest[2]
        return self._camera.project(self._points, rvec, tvec)

    def jacobian(self, rvec: Array, tvec: Array) -> Array:
        """(2n, 6), of the pixels by translation (m) and small turns about the fixed axes (rad)."""
        if self._newest is not None and self._newest[0] is rvec:
            derivatives = self._newest[1]
        else:
            derivatives = self._camera.project_with_jacobian(self._points, rvec, tvec)[1]
        by_place = derivatives[:, 3:6].reshape(-1, 2, 3)
        # A small turn w moves a point p, as seen from the body's origin, by w x p.
        arms = self._points.dot(self._rotation(rvec).T)[:, None]
        found = np.empty((len(arms), 2, 6))
        found[..., :3] = by_place
        found[..., 3:] = arms[..., _NEXT] * by_place[..., _LAST]
        found[..., 3:] -= arms[..., _LAST] * by_place[..., _NEXT]
        return found.reshape(-1, 6)


def projection_derivatives(
    camera: CameraModel,
    points: Array,
    rotation: Array,
    translation: Array,
    about: Sequence[float],
) -> tuple[Array, Array, Array]:
    """Where points of a body are seen, and how that changes with its pose.

    Args:
        camera: calibrated.
        points: (n, 3), m, in the body's frame.
        rotation: (3, 3), optical frame from the body's.
        translation: (3,), of the body's origin, m.
        about: (3,), m, the body's point that small turns leave in its place.

    Returns:
        The pixels (n, 2), and their derivatives by the place (n, 2, 3, px/m) and by small turns
        about the optical axes (n, 2, 3, px/rad).
    """
    rvec = cv2.Rodrigues(rotation)[0]
    seen, derivatives = camera.project_with_jacobian(points, rvec, translation)
    by_place = derivatives[:, 3:6].reshape(-1, 2, 3)
    # A small turn w moves a point p, as seen from the fixed one, by w x p.
    arms = ((points - about) @ rotation.T)[:, None, :]
    by_turn = arms[:, :, _NEXT] * by_place[:, :, _LAST] - arms[:, :, _LAST] * by_place[:, :, _NEXT]
    return seen, by_place, by_turn


def rotation_of(rvec: Array) -> Array:
    """Rotation matrix of a rotation vector."""
    return np.asarray(cv2.Rodrigues(rvec)[0], np.float64)


def inverse(matrix: Array) -> Array | None:
    """Of a symmetric positive matrix; None where it has none."""
    regular, inverted = cv2.invert(matrix, flags=cv2.DECOMP_CHOLESKY)
    return np.asarray(inverted, np.float64) if regular else None
