"""Faces in space, painted from far to near."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.simulation.camera import PinholeCamera
from mvuav_ros.vision.frames import Matrix, Vector, read_only
from mvuav_ros.vision.point_operations import Pixels

SUPERSAMPLING = 2
"""Faces are painted at twice the size and reduced: OpenCV's own smooth edges show the seams."""
NEAR = 0.5
"""Faces that come closer to the camera than this (m) are not painted."""
_SHIFT = 4

Array = NDArray[np.float64]
Face = tuple[Sequence[tuple[float, float, float]], float]
"""Four corners (m) and an albedo, 0 to 1."""


@dataclass(frozen=True)
class Mesh:
    """Flat faces of four corners.

    Attributes:
        corners: (n, 4, 3), m, in the body's frame.
        normals: (n, 3) of unit length, either side.
        albedo: (n,), 0 to 1.
    """

    corners: Array
    normals: Array
    albedo: Array

    @classmethod
    def of(cls, faces: Iterable[Face]) -> Mesh:
        """Build from faces."""
        chosen = list(faces)
        corners = np.array([corner for corner, _ in chosen], np.float64)
        # By the diagonals, since a face that ends in a tip has two corners in one place.
        normals = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
        albedo = np.array([shade for _, shade in chosen])
        return cls(read_only(corners), read_only(normals), read_only(albedo))


@dataclass(frozen=True)
class Lighting:
    """Light from one side and from all around, as grey levels of a white face.

    ``towards`` is the direction of the light (unit length).
    """

    ambient: float
    direct: float
    towards: tuple[float, float, float]


def paint_mesh(
    image: Pixels,
    mesh: Mesh,
    camera: PinholeCamera,
    pose: tuple[Matrix, Vector],
    lighting: Lighting,
    tint: tuple[float, float, float] = (1.06, 1.0, 0.95),
) -> None:
    """Paint a mesh into an 8-bit image, grey or blue first, in place.

    The pose is the body's rotation in the optical frame and its place there, m; the light comes
    from a direction in the optical frame, and has a tint of blue, green and red.
    """
    rotation, translation = pose
    corners = mesh.corners @ rotation.T + translation
    keep = corners[:, :, 2].min(axis=1) > NEAR
    if not keep.any():
        return
    corners, albedo = corners[keep], mesh.albedo[keep]
    middle = corners.mean(axis=1)
    shade = albedo * _lit(mesh.normals[keep] @ rotation.T, middle, lighting)
    pixels = camera.project(corners.reshape(-1, 3)).reshape(-1, 4, 2)
    lowest = np.maximum(np.floor(pixels.min(axis=(0, 1))) - 1, 0)
    highest = np.minimum(np.ceil(pixels.max(axis=(0, 1))) + 2, (camera.width, camera.height))
    (x0, y0), (x1, y1) = lowest.astype(int), highest.astype(int)
    if x1 <= x0 or y1 <= y0:
        return
    part = image[y0:y1, x0:x1]
    factors = np.array(tint if part.ndim == 3 else (1.0,))
    # Each face's grey or colour; never 0, which means no face.
    levels = np.clip(shade[:, None] * factors, 1.0, 255.0).tolist()
    far_to_near = np.argsort(-np.linalg.norm(middle, axis=1))
    faces, cover = _fill(part, pixels - (x0, y0), levels, far_to_near)
    behind = cv2.bitwise_not(cover)
    if part.ndim == 3:
        behind = cv2.merge([behind] * 3)
    part[...] = cv2.add(cv2.multiply(part, behind, scale=1.0 / 255.0), faces)


def _lit(normals: Array, middle: Array, lighting: Lighting) -> Array:
    """Grey levels of white faces; each shows the camera the side that looks towards it."""
    facing = np.where((normals * middle).sum(axis=1) > 0.0, -1.0, 1.0)
    lit = np.maximum(facing * (normals @ np.asarray(lighting.towards)), 0.0)
    return np.asarray(lighting.ambient + lighting.direct * lit)


def _fill(
    part: Pixels, pixels: Array, levels: Sequence[Sequence[float]], order: NDArray[np.intp]
) -> tuple[Pixels, Pixels]:
    """The faces on black, and their cover, 0 to 255."""
    # A pixel's centre lies half a fine pixel right of the first fine pixel's.
    fine = (pixels + 0.5) * SUPERSAMPLING - 0.5
    limit = 2**20
    places = np.rint(np.clip(fine * 2**_SHIFT, -limit, limit)).astype(np.int32)
    height, width = part.shape[:2]
    canvas = np.zeros((height * SUPERSAMPLING, width * SUPERSAMPLING, *part.shape[2:]), np.uint8)
    for face in order:
        cv2.fillConvexPoly(canvas, places[face], levels[face], cv2.LINE_8, _SHIFT)
    first = canvas if part.ndim == 2 else cv2.extractChannel(canvas, 0)
    cover = cv2.threshold(first, 0, 255, cv2.THRESH_BINARY)[1]
    faces, covered = (
        cv2.resize(fine, (width, height), interpolation=cv2.INTER_AREA) for fine in (canvas, cover)
    )
    return faces, covered
