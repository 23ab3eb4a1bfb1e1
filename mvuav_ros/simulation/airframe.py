"""The tanker as faces in space, painted from far to near, and its refuelling boom."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.simulation.pinhole import seen_by
from mvuav_ros.simulation.settings import ScheduleEntry
from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.frames import Matrix, Vector, read_only
from mvuav_ros.vision.point_operations import Pixels

SUPERSAMPLING = 2
"""Faces are painted at twice the size and reduced: OpenCV's own smooth edges show the seams."""
MIN_DEPTH = 0.5  # faces that come closer to the camera than this (m) are not painted
_SUBPIXEL_BITS = 4
_TINT = (1.06, 1.0, 0.95)  # blue, green and red of the light

Array = NDArray[np.float64]
Corner = tuple[float, float, float]
Face = tuple[Sequence[Corner], float]  # four corners (m) and an albedo, 0 to 1


@dataclass(frozen=True)
class Lighting:
    """Light from one side and from all around, as grey levels of a white face."""

    ambient: float
    direct: float
    towards: tuple[float, float, float]  # of unit length, in axes x ahead, y left, z up


def paint_tanker(
    image: Pixels,
    camera: CameraModel,
    pose: tuple[Matrix, Vector],
    lighting: Lighting,
    level: Matrix,
) -> None:
    """Paint the aircraft into an 8-bit image, grey or blue first, in place.

    The pose is the body's rotation in the optical frame and its place there, m; ``level`` turns
    the light's axes into that frame.
    """
    rotation, translation = pose
    corners, normals, albedo = _tanker_mesh()
    corners = corners @ rotation.T + translation
    pixels = seen_by(camera, corners.reshape(-1, 3)).reshape(-1, 4, 2)
    keep = (corners[:, :, 2].min(axis=1) > MIN_DEPTH) & np.isfinite(pixels).all(axis=(1, 2))
    if not keep.any():
        return
    pixels, middle = pixels[keep], corners[keep].mean(axis=1)
    normals = normals[keep] @ rotation.T
    # Each face shows the camera the side that looks towards it.
    facing = np.where((normals * middle).sum(axis=1) > 0.0, -1.0, 1.0)
    lit = np.maximum(facing * (normals @ (level @ np.array(lighting.towards))), 0.0)
    shade = albedo[keep] * (lighting.ambient + lighting.direct * lit)
    lowest = np.maximum(np.floor(pixels.min(axis=(0, 1))) - 1, 0)
    highest = np.minimum(np.ceil(pixels.max(axis=(0, 1))) + 2, (camera.width, camera.height))
    (x0, y0), (x1, y1) = lowest.astype(int), highest.astype(int)
    if x1 <= x0 or y1 <= y0:
        return
    part = image[y0:y1, x0:x1]
    factors = np.array(_TINT if part.ndim == 3 else (1.0,))
    # Each face's grey or colour; never 0, which means no face.
    levels = np.clip(shade[:, None] * factors, 1.0, 255.0).tolist()
    far_to_near = np.argsort(-np.linalg.norm(middle, axis=1))
    faces, cover = _fill(part, pixels - (x0, y0), levels, far_to_near)
    behind = cv2.bitwise_not(cover)
    if part.ndim == 3:
        behind = cv2.merge([behind] * 3)
    part[...] = cv2.add(cv2.multiply(part, behind, scale=1.0 / 255.0), faces)


def _fill(
    part: Pixels, pixels: Array, levels: Sequence[Sequence[float]], order: NDArray[np.intp]
) -> tuple[Pixels, Pixels]:
    """The faces on black, and their cover, 0 to 255."""
    # A pixel's centre lies half a fine pixel right of the first fine pixel's.
    fine = (pixels + 0.5) * SUPERSAMPLING - 0.5
    limit = 2**20
    places = np.rint(np.clip(fine * 2**_SUBPIXEL_BITS, -limit, limit)).astype(np.int32)
    height, width = part.shape[:2]
    canvas = np.zeros((height * SUPERSAMPLING, width * SUPERSAMPLING, *part.shape[2:]), np.uint8)
    for face in order:
        cv2.fillConvexPoly(canvas, places[face], levels[face], cv2.LINE_8, _SUBPIXEL_BITS)
    first = canvas if part.ndim == 2 else cv2.extractChannel(canvas, 0)
    cover = cv2.threshold(first, 0, 255, cv2.THRESH_BINARY)[1]
    faces, covered = (
        cv2.resize(fine, (width, height), interpolation=cv2.INTER_AREA) for fine in (canvas, cover)
    )
    return faces, covered


IN_SKY = Lighting(ambient=40.0, direct=52.0, towards=(-0.55, 0.52, 0.65))
IN_LAB = Lighting(ambient=26.0, direct=66.0, towards=(-0.60, 0.33, 0.73))
"""Darker than any background, as an aircraft against the light and a grey model are."""

_FUSELAGE = (
    (33.0, 0.15, -0.9),
    (32.0, 1.3, -0.7),
    (29.0, 2.6, -0.3),
    (24.0, 3.25, 0.0),
    (6.0, 3.25, 0.0),
    (-16.0, 3.25, 0.0),
    (-24.0, 2.7, 0.5),
    (-31.0, 1.7, 1.2),
    (-36.0, 0.8, 1.9),
    (-38.0, 0.3, 2.2),
)
_UPPER_DECK = ((30.0, 0.6, 2.0), (26.5, 2.3, 2.3), (14.0, 2.3, 2.3), (4.0, 0.5, 2.4))
"""Stations from nose to tail: x, radius, z of the axis."""
_Section = tuple[float, float, float, float, float]
"""Of a wing: x of the leading edge, chord, y, z and thickness, m."""
_WING: tuple[_Section, ...] = (
    (13.0, 15.5, 2.6, -2.2, 1.9),
    (6.3, 10.6, 12.0, -1.1, 1.2),
    (-1.6, 6.8, 22.0, 0.1, 0.6),
    (-8.2, 3.9, 29.7, 1.0, 0.3),
)
_STABILIZER: tuple[_Section, ...] = (
    (-27.5, 8.0, 0.8, 1.7, 0.8),
    (-31.5, 5.2, 6.0, 2.4, 0.5),
    (-34.6, 2.5, 10.9, 3.0, 0.25),
)
_FIN: tuple[_Section, ...] = (
    (-22.0, 12.5, 0.0, 2.6, 0.9),
    (-28.0, 8.7, 0.0, 7.5, 0.6),
    (-33.0, 3.6, 0.0, 12.8, 0.3),
)
_ENGINES = ((6.6, 11.7, -3.4), (-2.2, 20.9, -2.0))  # middle of the left nacelles


@lru_cache(maxsize=1)
def _tanker_mesh() -> tuple[Array, Array, Array]:
    """Faces: corners (n, 4, 3), m, in the body's frame; unit normals, either side; albedo (n,)."""
    faces, albedo = zip(*_faces(), strict=True)
    corners = np.array(faces, np.float64)
    # By the diagonals, since a face that ends in a tip has two corners in one place.
    normals = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    return read_only(corners), read_only(normals), read_only(np.array(albedo))


def _faces() -> Iterator[Face]:
    yield from _turned(_FUSELAGE, 16, 0.95)
    yield from _turned(_UPPER_DECK, 12, 0.95)
    for side in (1.0, -1.0):
        for sections in (_WING, _STABILIZER):
            outlines = [[(x, side * y, z) for x, y, z in _outline(s)] for s in sections]
            yield from _closed(outlines, 0.85)
        for x, y, z in _ENGINES:
            yield from _engine(x, side * y, z)
    # The fin is a wing stood on end: its thickness lies along y.
    fin = []
    for section in _FIN:
        (leading, _, z), (top, *_), (trailing, *_), _ = _outline(section)
        half = 0.5 * section[-1]
        fin.append([(leading, 0.0, z), (top, half, z), (trailing, 0.0, z), (top, -half, z)])
    yield from _closed(fin, 0.9)


def _turned(stations: Sequence[Corner], sides: int, albedo: float) -> Iterator[Face]:
    """A body of revolution about an axis along x that may bend."""
    angles = [2 * math.pi * k / sides for k in range(sides)]
    yield from _skin(
        [[(x, r * math.cos(a), z + r * math.sin(a)) for a in angles] for x, r, z in stations],
        albedo,
    )


def _skin(rings: Sequence[Sequence[Corner]], albedo: float) -> Iterator[Face]:
    """Faces from each ring of points to the next."""
    for front, back in pairwise(rings):
        for k in range(len(front)):
            following = (k + 1) % len(front)
            yield (front[k], front[following], back[following], back[k]), albedo


def _closed(outlines: Sequence[Sequence[Corner]], albedo: float) -> Iterator[Face]:
    """A wing of outlines from the root to the tip, which is closed."""
    yield from _skin(outlines, albedo)
    yield outlines[-1], albedo


def _outline(section: _Section) -> tuple[Corner, Corner, Corner, Corner]:
    """Leading edge, top, trailing edge and bottom."""
    x, chord, y, z, thickness = section
    thickest = x - 0.35 * chord
    top, bottom = z + 0.6 * thickness, z - 0.4 * thickness
    return (x, y, z), (thickest, y, top), (x - chord, y, z), (thickest, y, bottom)


def _engine(x: float, y: float, z: float) -> Iterator[Face]:
    stations = ((x + 3.0, 1.15, z), (x + 1.6, 1.4, z), (x - 1.2, 1.2, z), (x - 2.6, 0.75, z))
    for corners, albedo in _turned(stations, 10, 0.75):
        yield [(cx, cy + y, cz) for cx, cy, cz in corners], albedo
    # The nozzle from behind, and the pylon up to the wing.
    nozzle = ((-0.55, -0.55), (0.55, -0.55), (0.55, 0.55), (-0.55, 0.55))
    yield [(x - 2.62, y + across, z + up) for across, up in nozzle], 0.35
    pylon = ((1.5, 1.2), (-2.0, 1.0), (-5.5, 2.1), (-1.0, 2.1))
    yield [(x + ahead, y, z + up) for ahead, up in pylon], 0.7


BOOM_TRAVEL = 0.25  # seconds in which the boom extends and retracts; it turns while it is short
BOOM_TURN = 1.0
BOOM_REST = 0.35
"""Length at rest, in distances from its pivot to the farthest light; no light is that close."""
BOOM_SHADE = 24.0


@dataclass(frozen=True)
class Boom:
    """A straight bar in the image, from the pivot (2,) to the tip (2,), px."""

    pivot: NDArray[np.float64]
    tip: NDArray[np.float64]
    half_width: float

    def distance(self, point: NDArray[np.float64]) -> float:
        """How far a point (px) lies outside the bar; negative inside."""
        along = self.tip - self.pivot
        length = float(np.hypot(*along))
        if length == 0.0:
            return math.inf
        along = along / length
        offset = point - self.pivot
        forward = float(offset @ along)
        across = abs(float(offset[0] * along[1] - offset[1] * along[0]))
        return max(forward - length, -forward, across - self.half_width)

    def paint(self, image: Pixels) -> None:
        """Paint it into an 8-bit image, in place."""
        along = self.tip - self.pivot
        length = float(np.hypot(*along))
        if not math.isfinite(length) or length < 1.0:
            return
        side = np.array((-along[1], along[0])) * (self.half_width / length)
        gray = image.ndim == 2
        for width, factor in ((1.0, 1.0), (0.45, 1.7)):
            out = width * side
            corners = np.array([self.pivot - out, self.pivot + out, self.tip + out, self.tip - out])
            limit = 2.0**24
            places = np.rint(np.clip(corners * 2**_SUBPIXEL_BITS, -limit, limit)).astype(np.int32)
            shade = BOOM_SHADE * factor
            color = (shade,) if gray else (1.1 * shade, shade, 0.95 * shade)
            cv2.fillConvexPoly(image, places, color, cv2.LINE_AA, _SUBPIXEL_BITS)


def place_boom(
    pivot: NDArray[np.float64],
    down: NDArray[np.float64],
    lights: dict[str, NDArray[np.float64]],
    schedule: tuple[ScheduleEntry, ...],
    time: float,
    half_width: float,
) -> Boom:
    """Where the boom is at a time (s).

    Between two entries, which do not overlap, it rests, pointing ``down``; before an entry it
    turns towards the light, then extends, so that it covers the light during the whole of the
    interval. Places and lengths are px in the image.
    """
    lengths = [float(np.hypot(*(place - pivot))) for place in lights.values()]
    rest_angle = math.atan2(down[1], down[0])
    rest_length = min(BOOM_REST * max(lengths), 0.6 * min(lengths))
    angle, length = rest_angle, rest_length
    for interval in schedule:
        outside = max(interval.start - time, time - interval.end, 0.0)
        if outside >= BOOM_TRAVEL + BOOM_TURN:
            continue
        target = lights[interval.marker] - pivot
        turn = math.remainder(math.atan2(target[1], target[0]) - rest_angle, 2 * math.pi)
        reached = float(np.hypot(*target)) + 3.0 * half_width
        extended = 1.0 - min(outside / BOOM_TRAVEL, 1.0)
        turned = 1.0 - max(outside - BOOM_TRAVEL, 0.0) / BOOM_TURN
        angle = rest_angle + turn * turned
        length = rest_length + (reached - rest_length) * extended
        if outside == 0.0:
            break
    tip = pivot + length * np.array((math.cos(angle), math.sin(angle)))
    return Boom(pivot, tip, half_width)
