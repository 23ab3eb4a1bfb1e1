"""Whether a rig's markers can be distinguished and give a pose, and how well from a distance."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations, permutations, product
from operator import ne

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.frames import OPTICAL_FROM_BODY
from mvuav_ros.vision.reprojection import Reprojection, rotation_of
from mvuav_ros.vision.rig import MAX_NAMED, MarkerRig, same_place

Array = NDArray[np.float64]
Cycles = tuple[tuple[str, ...], ...]


ALIKE = 0.02
"""Part of the rig's size by which a turned marker may miss another one's place and still be taken
for it; twice what the start allows a body among other lights."""
NEARLY = 0.5
"""The same of a turn that is looked at for what it leaves unexplained in the image: a light that
is out of the plane by as much may be hardly seen to be, from far away."""
STRAIGHT = 0.01
"""Part of the rig's length by which markers on one line, or in one plane, may lie beside it."""
FARTHEST_TILT = math.radians(40.0)
"""Between the camera's axis and the body's, when it is seen from behind."""


@dataclass(frozen=True)
class Symmetry:
    """A turn after which a rig looks the same but for the names."""

    exchanged: Cycles  # the cycles of names: each marker comes to lie where the next one was
    axis: tuple[float, float, float]  # of the turn, in the body's frame
    angle_deg: float  # of the turn

    def __str__(self) -> str:
        cycles = ', '.join(' -> '.join(cycle) for cycle in self.exchanged)
        axis = ', '.join(f'{part:.2f}' for part in self.axis)
        return f'{cycles} are exchanged by a rotation of {self.angle_deg:.0f} deg about [{axis}]'


def examine(rig: MarkerRig) -> tuple[str, ...]:
    """Why names or a pose cannot be certain with a rig: a line for each reason; empty for none."""
    if len(rig.names) < 3:
        return (f'{len(rig.names)} markers are too few for a pose, which needs four',)
    if len(rig.names) > MAX_NAMED:
        return (f'{len(rig.names)} markers are too many: names can be given to {MAX_NAMED}',)
    if twins := same_place(rig):
        return (twins,)
    if dimensions(rig) < 2:
        return ('all markers lie on one line: there is no pose',)
    return tuple(f'the shape is symmetric: {symmetry}' for symmetry in symmetries(rig))


def dimensions(rig: MarkerRig) -> int:
    """Of the markers: 1 where all lie on one line; 2 in one plane: two tilts look nearly alike."""
    lengths = np.linalg.svd(rig.positions - rig.middle, compute_uv=False)
    return int((lengths > STRAIGHT * lengths[0]).sum())


def symmetries(rig: MarkerRig) -> list[Symmetry]:
    """The turns that exchange markers and leave the body in sight from behind; none backwards.

    A turn about the middle takes two markers that do not lie on one line with it to two others;
    every such pair is tried, and holds where all markers come to lie on markers.
    """
    points = rig.positions - rig.middle
    found: dict[tuple[int, ...], Symmetry] = {}
    for order, rotation in _turned(points, ALIKE):
        back = tuple(np.argsort(order).tolist())
        if not {order, back} & set(found):
            found[order] = _symmetry(rig.names, order, rotation)
    return list(found.values())


def _turned(points: Array, alike: float) -> Iterator[tuple[tuple[int, ...], Array]]:
    """Where turns take each of (n, 3) points to another one, up to a part of their size."""
    tolerance = alike * float(np.linalg.norm(points, axis=1).max())
    for rotation in _turns(points, tolerance):
        apart = np.linalg.norm((points @ rotation.T)[:, None] - points, axis=2)
        order = tuple(apart.argmin(axis=1).tolist())
        is_alike = len(set(order)) == len(order) and apart.min(axis=1).max() <= tolerance
        is_from_behind = rotation[0, 0] >= math.cos(2 * FARTHEST_TILT)
        if is_alike and is_from_behind and order != tuple(range(len(order))):
            yield order, rotation


def _turns(points: Array, tolerance: float) -> Iterator[Array]:
    """Rotations that take two of (n, 3) points to two others, as far as distances allow."""
    far = np.linalg.norm(points, axis=1)
    first = int(far.argmax())
    beside = np.linalg.norm(np.cross(points[:, None], points), axis=2)
    second = int(beside[first].argmax())
    apart = float(np.linalg.norm(points[first] - points[second]))
    here = _frame(points[first], points[second])
    for i, j in permutations(range(len(points)), 2):
        there = float(np.linalg.norm(points[i] - points[j]))
        changes = far[i] - far[first], far[j] - far[second], there - apart
        on_one_line = beside[i, j] <= 1e-6 * beside[first, second]
        if max(abs(change) for change in changes) <= 2 * tolerance and not on_one_line:
            yield _frame(points[i], points[j]) @ here.T


def _frame(first: Array, second: Array) -> Array:
    """Right-handed axes, the first along one vector, the second in the plane of two."""
    x = first / np.linalg.norm(first)
    z = np.cross(first, second)
    z = z / np.linalg.norm(z)
    return np.column_stack((x, np.cross(z, x), z))


def _symmetry(names: tuple[str, ...], order: tuple[int, ...], rotation: Array) -> Symmetry:
    rvec = cv2.Rodrigues(rotation)[0].ravel()
    angle = float(np.linalg.norm(rvec))
    x, y, z = (np.round(rvec / angle, 3) + 0.0).tolist()
    return Symmetry(tuple(cycles_of(names, order)), (x, y, z), math.degrees(angle))


def cycles_of(names: tuple[str, ...], order: tuple[int, ...]) -> Iterator[tuple[str, ...]]:
    """The cycles of a permutation, without the markers that stay."""
    left = [index for index, other in enumerate(order) if index != other]
    while left:
        cycle = [left[0]]
        while order[cycle[-1]] != cycle[0]:
            cycle.append(order[cycle[-1]])
        left = [index for index in left if index not in cycle]
        yield tuple(names[index] for index in cycle)


TILTS_DEG = (-30.0, 0.0, 30.0)  # Pitch and yaw, each, of the views that are tried
_MIN_AHEAD = math.cos(math.radians(60.0))
"""A pose whose x axis is turned away further is not one seen from behind, and no confusion."""
_MAX_MARKERS = 8  # Of a rig of which more than two names are exchanged at once


@dataclass(frozen=True)
class PoseError:
    """What to expect of a pose (1 sigma), at one distance from straight behind."""

    distance: float  # from the camera to the middle of the markers, m
    span: float  # of the markers on the image, px
    gap: float  # between the two that are nearest to each other there, px
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

    It is NaN, as span and gap are, where the camera does not see all markers, which must not lie
    on one line. The noise is that of a marker's place, px per axis (1 sigma).
    """
    points = rig.positions - rig.middle
    view = Reprojection(camera, points, image=np.empty((len(points), 2)))
    ahead = np.array((0.0, 0.0, distance))
    seen, jacobian = view.look(OPTICAL_FROM_BODY, ahead)
    limits = camera.width - 0.5, camera.height - 0.5
    is_shown = camera.shows(points @ OPTICAL_FROM_BODY.T + ahead)
    if not (is_shown.all() and ((seen > -0.5) & (seen < limits)).all()):
        return PoseError(distance, *[math.nan] * 6)
    deviation = noise * np.sqrt(np.diag(np.linalg.pinv(jacobian.T @ jacobian)))
    pitch, yaw, roll, x, y, z = deviation.tolist()
    apart = np.linalg.norm(seen[:, None] - seen, axis=2)[np.triu_indices(len(seen), 1)]
    span, gap = float(apart.max()), float(apart.min())
    tilt = math.degrees(max(pitch, yaw))
    return PoseError(distance, span, gap, z, max(x, y), math.degrees(roll), tilt)


def confusions(rig: MarkerRig, camera: CameraModel, distance: float) -> list[Confusion]:
    """Exchanges of names with what they leave unexplained, the worst (least) first.

    They are those of few names, and those of all by a turn after which the rig looks similar.
    """
    points = rig.positions - rig.middle
    views = []
    for pitch, yaw in product(TILTS_DEG, TILTS_DEG):
        turned = rotation_of(np.radians((pitch, yaw, 0.0))) @ OPTICAL_FROM_BODY
        seen = camera.project(points @ turned.T + (0.0, 0.0, distance))
        views.append((seen, pitch, yaw))
    found = []
    orders = [*_exchanges(len(points)), *(order for order, _ in _turned(points, NEARLY))]
    for order in dict.fromkeys(orders):
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
    for moved in (2,) if count > _MAX_MARKERS else (2, 3, 4):
        for names in combinations(range(count), moved):
            for others in permutations(names):
                order = dict(zip(names, others, strict=True))
                is_pairs = all(order[other] == name for name, other in order.items())
                if all(map(ne, names, others)) and (moved < 4 or is_pairs):
                    yield tuple(order.get(index, index) for index in range(count))


def _least_residual(points: Array, seen: Array, camera: CameraModel) -> float:
    """Root mean square of the best pose that is seen from behind, px; infinite for none."""
    view = Reprojection(camera, points, np.ascontiguousarray(seen))
    # The body's x axis is to point away from the camera.
    ahead = [s for s in view.refined(view.closed_forms()) if s.rotation[2, 0] >= _MIN_AHEAD]
    return math.sqrt(min((s.squares for s in ahead), default=math.inf) / len(points))
