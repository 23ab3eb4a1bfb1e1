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

    corners: NDArray[np.float64]
    normals: NDArray[np.float64]
    albedo: NDArray[np.float64]

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

    ``towards`` is the direction of the light in the world's frame (unit length).
    """

    ambient: float
    direct: float
    towards: tuple[float, float, float]


def paint_mesh(
    image: Pixels,
    mesh: Mesh,
    camera: PinholeCamera,
    rotation: Matrix,
    translation: Vector,
    light: Vector,
    lighting: Lighting,
    tint: tuple[float, float, float] = (1.06, 1.0, 0.95),
) -> None:
    """Paint a mesh into an 8-bit image, in place.

    Args:
        image: (height, width) or (height, width, 3).
        mesh: in the body's frame.
        camera: that took the image.
        rotation: of the body in the optical frame.
        translation: the same, m.
        light: direction to the light in the optical frame.
        lighting: how bright.
        tint: of blue, green and red.
    """
    corners = mesh.corners @ rotation.T + translation
    keep = corners[:, :, 2].min(axis=1) > NEAR
    if not keep.any():
        return
    corners, albedo = corners[keep], mesh.albedo[keep]
    normals = mesh.normals[keep] @ rotation.T
    middle = corners.mean(axis=1)
    facing = np.where((normals * middle).sum(axis=1) > 0.0, -1.0, 1.0)
    lit = np.maximum(facing * (normals @ light), 0.0)
    shade = albedo * (lighting.ambient + lighting.direct * lit)
    pixels = camera.project(corners.reshape(-1, 3)).reshape(-1, 4, 2)

    x0, y0 = np.maximum(np.floor(pixels.min(axis=(0, 1))) - 1, 0).astype(int)
    x1, y1 = np.minimum(np.ceil(pixels.max(axis=(0, 1))) + 2, (camera.width, camera.height)).astype(
        int
    )
    if x1 <= x0 or y1 <= y0:
        return
    part = image[y0:y1, x0:x1]
    # A pixel's centre lies half a fine pixel right of the first fine pixel's.
    fine = (pixels - (x0, y0) + 0.5) * SUPERSAMPLING - 0.5
    limit = 2**20
    places = np.rint(np.clip(fine * 2**_SHIFT, -limit, limit)).astype(np.int32)
    colored = part.ndim == 3
    levels = _levels(shade, tint if colored else None)
    canvas = np.zeros(
        (part.shape[0] * SUPERSAMPLING, part.shape[1] * SUPERSAMPLING, 4 if colored else 2),
        np.uint8,
    )
    for face in np.argsort(-np.linalg.norm(middle, axis=1)):
        cv2.fillConvexPoly(canvas, places[face], levels[face], cv2.LINE_8, _SHIFT)
    small = cv2.resize(canvas, (part.shape[1], part.shape[0]), interpolation=cv2.INTER_AREA)
    *colors, cover = cv2.split(small)
    behind = cv2.bitwise_not(cover)
    if colored:
        seen = cv2.multiply(part, cv2.merge([behind] * 3), scale=1.0 / 255.0)
        cv2.add(seen, cv2.merge(colors), dst=seen)
    else:
        seen = cv2.multiply(part, behind, scale=1.0 / 255.0)
        cv2.add(seen, colors[0], dst=seen)
    part[...] = seen


def _levels(
    shade: NDArray[np.float64], tint: tuple[float, float, float] | None
) -> list[tuple[float, ...]]:
    """Each face's grey or colour, and full cover."""
    factors = np.array(tint or (1.0,))
    colors = np.clip(shade[:, None] * factors, 0.0, 255.0)
    return [(*color, 255.0) for color in colors.tolist()]
