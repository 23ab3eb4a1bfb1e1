"""The reprojection error of some markers of a rig, and the poses that make it least."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from functools import partial
from itertools import product
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.frames import OPTICAL_FROM_BODY

Array = NDArray[np.float64]

MIN_MARKERS = 3  # Markers for a pose: with three there may be four solutions, all of which fit
_TILTS = tuple(math.radians(angle) for angle in (-30.0, 0.0, 30.0))
_MAX_STEPS = 20
_DAMPING = 1e-3  # part of the normal matrix's diagonal, where a step has made the error larger
_SMALL_STEP = 3e-5
"""rad, and parts of the distance: after such a step the pose is right to its square."""
_NO_TURN: Array = np.zeros(3)


class Solution(NamedTuple):
    """A pose at which the reprojection error has a minimum."""

    rotation: Array  # (3, 3), optical frame from the body's
    translation: Array  # (3,), m
    squares: float  # sum of the squared residuals, px²
    seen: Array  # (n, 2), px: where the markers should be seen
    # (2n, 6), of that by small turns about the optical axes (rad) and by the translation (m).
    slopes: Array
    spread: Array | None  # (6, 6), (JᵀJ)⁻¹ with these slopes J; None where there is no inverse


class Reprojection:
    """Some markers of a rig in one image."""

    def __init__(self, camera: CameraModel, points: Array, image: Array) -> None:
        self.image = image
        self._points = points
        self._camera = camera

    def refine(
        self, rotation: Array, translation: Array, last: Solution | None = None
    ) -> Solution | None:
        """The nearest minimum of the reprojection error; None behind the camera.

        The last image's solution, if it is where to start, has the slopes for the first step.
        """
        try:
            found = self._descend(rotation, translation, last)
        except (cv2.error, np.linalg.LinAlgError):
            return None
        # What is not finite is in the squares as well.
        depths = self._points.dot(found.rotation[2]) + found.translation[2]
        return found if math.isfinite(found.squares) and min(depths.tolist()) > 0.0 else None

    def _descend(self, rotation: Array, translation: Array, last: Solution | None) -> Solution:
        """Gauss and Newton's steps on the image error, damped where they fail (Levenberg's).

        For any camera model: OpenCV's knows pinhole cameras alone, and goes on to differences that
        no light shows. What a small step changes is taken as the derivatives have it.
        """
        seen, slopes, spread = last[3:] if last else (*self.look(rotation, translation), None)
        residual, damping = (self.image - seen).ravel(), 0.0
        squares = float(residual.dot(residual))
        for number in range(_MAX_STEPS):
            spread = _spread_of(slopes, damping) if spread is None else spread
            if spread is None:
                damping = max(10.0 * damping, _DAMPING)
                continue
            step = spread.dot(slopes.T.dot(residual))
            turned, moved = rotation_of(step[:3]).dot(rotation), translation + step[3:]
            if (number or not last) and step.dot(step) <= _SMALL_STEP**2 * (1.0 + moved.dot(moved)):
                rotation, translation = turned, moved
                residual = residual - slopes.dot(step)
                squares = float(residual.dot(residual))
                break
            seen, changed = self.look(turned, moved)
            left = (self.image - seen).ravel()
            less = float(left.dot(left))
            if less <= squares:
                rotation, translation, slopes = turned, moved, changed
                residual, squares, damping = left, less, 0.1 * damping
            else:
                damping = max(10.0 * damping, _DAMPING)
            spread = None
        if damping or spread is None:
            spread = _spread_of(slopes)
        seen = self.image - residual.reshape(-1, 2)
        return Solution(rotation, translation, squares, seen, slopes, spread)

    def look(self, rotation: Array, translation: Array) -> tuple[Array, Array]:
        """Where the markers should be seen, and the slopes of that (see `Solution`)."""
        arms = self._points.dot(rotation.T)
        return self._camera.project_with_jacobians(arms, _NO_TURN, translation)[:2]

    def solve(self) -> list[Solution]:
        """All solutions that OpenCV's solvers and a few tilted starts lead to."""
        starts = self.closed_forms()
        middle = self._points.mean(axis=0)
        for rotation, translation in starts[:1]:
            centre = rotation @ middle + translation
            roll = rotation_of(np.array((0.0, 0.0, self._roll())))
            for pitch, yaw in product(_TILTS, _TILTS):
                turned = roll @ rotation_of(np.array((pitch, yaw, 0.0))) @ OPTICAL_FROM_BODY
                starts.append((turned, centre - turned @ middle))
        return self.refined(starts)

    def refined(self, starts: Iterable[tuple[Array, Array]]) -> list[Solution]:
        """The minima to which some rotations and translations lead."""
        found = (self.refine(*start) for start in starts)
        return [solution for solution in found if solution is not None]

    def _roll(self) -> float:
        """In the image, rad, as if the markers were seen from straight behind."""
        _, y, z = (self._points - self._points.mean(axis=0)).T
        u, v = (self.image - self.image.mean(axis=0)).T
        return float(np.angle(((z * 1j - y) * (u + 1j * v)).sum()))

    def closed_forms(self) -> list[tuple[Array, Array]]:
        """Rotations and translations by OpenCV's solvers, of three by all, else by the first."""
        camera = self._camera
        flat, matrix, distortion = self.image, camera.matrix, camera.distortion
        if camera.is_fisheye:
            # These solvers know pinhole cameras alone.
            flat, matrix, distortion = camera.undistort(flat), np.eye(3), np.zeros(5)
        solvers: list[Callable[..., Any]] = [partial(cv2.solvePnPGeneric, flags=cv2.SOLVEPNP_SQPNP)]
        is_three = len(self._points) == MIN_MARKERS
        if is_three:
            methods = cv2.SOLVEPNP_P3P, cv2.SOLVEPNP_AP3P
            solvers[:0] = [partial(cv2.solveP3P, flags=method) for method in methods]
        else:
            # SQPNP has no solution in one of 300 views of four lights; EPNP is less exact.
            solvers.append(partial(cv2.solvePnPGeneric, flags=cv2.SOLVEPNP_EPNP))
        found: list[tuple[Array, Array]] = []
        for solve in solvers:
            if found and not is_three:
                break
            try:
                _, rvecs, tvecs, *_ = solve(self._points, flat, matrix, distortion)
            except cv2.error:
                continue
            found += [
                (rotation_of(np.asarray(rvec, np.float64)), np.asarray(tvec, np.float64).ravel())
                for rvec, tvec in zip(rvecs, tvecs, strict=True)
            ]
        return found


def rotation_of(rvec: Array) -> Array:
    """Rotation matrix of a rotation vector."""
    return np.asarray(cv2.Rodrigues(rvec)[0], np.float64)


def _spread_of(slopes: Array, damping: float = 0.0) -> Array | None:
    """(JᵀJ)⁻¹ with slopes J, whose diagonal grows by the damping; None where there is none."""
    normal = slopes.T.dot(slopes)
    if damping:
        normal.reshape(-1)[::7] *= 1.0 + damping
    regular, inverted = cv2.invert(normal, flags=cv2.DECOMP_CHOLESKY)
    return np.asarray(inverted, np.float64) if regular else None
