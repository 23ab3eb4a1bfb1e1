"""The frame with what was found drawn on it: markers, predictions, search windows, a pose."""

from __future__ import annotations

import math
from collections.abc import Sequence
from colorsys import hsv_to_rgb

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.image import Image
from mvuav_ros.vision.markers.marker_results import Label, Marker, MarkerResult, MarkerState
from mvuav_ros.vision.pose import Pose
from mvuav_ros.vision.rig import MarkerRig

Color = tuple[int, int, int]

RED, GREEN, BLUE = (60, 60, 255), (80, 220, 80), (255, 140, 60)
YELLOW, WHITE, BLACK = (0, 220, 255), (255, 255, 255), (0, 0, 0)
_GOLDEN_RATIO = 0.618034  # Of a turn: its multiples spread most evenly

COLORS: dict[Label, Color] = {
    Label.LEFT_WING: RED,
    Label.LEFT_STABILIZER: RED,
    Label.RUDDER: BLUE,
    Label.RIGHT_STABILIZER: GREEN,
    Label.RIGHT_WING: GREEN,
    Label.UNLABELLED: YELLOW,
}
"""Red left and green right, as an aircraft's navigation lights; the thesis has red right."""


def draw_markers(
    image: Image, result: MarkerResult, names: Sequence[str] = ()
) -> NDArray[np.uint8]:
    """Draw the result on a copy of the frame, (height, width, 3) uint8, blue first.

    Stars for wings, circles for stabilizers, a diamond for the rudder; red left, green right, blue
    centre; unlabelled clusters are yellow circles. A marker of another rig is a circle of a colour
    of its own, beside it its name, or its number without ``names``. A predicted marker is thin and
    yellow, a searched window a thin rectangle.
    """
    canvas = image.bgr().copy()
    size = max(5, round(min(canvas.shape[:2]) / 60))
    for x0, x1, y0, y1 in result.windows:
        if x0 <= x1 and y0 <= y1:
            cv2.rectangle(canvas, (x0 - 1, y0 - 1), (x1 + 1, y1 + 1), WHITE, 1)
    for marker in result.markers:
        if marker.state is not MarkerState.LOST:
            _draw_marker(canvas, marker, size, names)
    _write(canvas, _caption(result), (2 * size, 3 * size), size / 16)
    return canvas


def _draw_marker(
    canvas: NDArray[np.uint8], marker: Marker, size: int, names: Sequence[str]
) -> None:
    is_predicted = marker.state is MarkerState.PREDICTED
    # The markers of another rig are numbered from 0, as the tanker's are.
    label = marker.label if isinstance(marker.label, Label) else None
    own = _color_of(marker.label) if label is None else COLORS[label]
    color = YELLOW if is_predicted else own
    thickness = 1 if is_predicted else 2
    # A wild prediction may lie anywhere; OpenCV takes 32-bit coordinates.
    x, y = (int(np.clip(round(v), -(2**20), 2**20)) for v in (marker.x, marker.y))
    if label in (Label.LEFT_WING, Label.RIGHT_WING):
        outline = _star(x, y, size)
    elif label is Label.RUDDER:
        outline = np.array([(x, y - size), (x + size, y), (x, y + size), (x - size, y)], np.int32)
    else:
        cv2.circle(canvas, (x, y), size, color, thickness, cv2.LINE_AA)
        if label is None:
            name = names[marker.label] if names else str(marker.label)
            _write(canvas, name, (x + 2 * size, y + size // 2), size / 20, own)
        return
    cv2.polylines(canvas, [outline], True, color, thickness, cv2.LINE_AA)


def _color_of(label: int) -> Color:
    """Of a marker of another rig: far from those of the next ones, and never yellow."""
    hue = 0.25 + 0.8 * (label * _GOLDEN_RATIO % 1.0)
    red, green, blue = (round(255 * part) for part in hsv_to_rgb(hue % 1.0, 0.8, 1.0))
    return blue, green, red


def _star(x: int, y: int, size: int) -> NDArray[np.int32]:
    """Ten corners, alternating between the outer radius and 0.4 of it."""
    angles = -math.pi / 2 + np.arange(10) * math.pi / 5
    radii = 1.4 * size * np.where(np.arange(10) % 2 == 0, 1.0, 0.4)
    corners = np.column_stack((x + radii * np.cos(angles), y + radii * np.sin(angles)))
    return np.round(corners).astype(np.int32)


def _caption(result: MarkerResult) -> str:
    words = []
    if not math.isnan(result.roll):
        words.append(f'roll {math.degrees(result.roll):+.1f} deg')
    if result.status:
        words.append(result.status)
    elif result.markers and result.markers[0].label is Label.UNLABELLED:
        words.append(f'{len(result.markers)} clusters')
    return '   '.join(words)


def _write(
    canvas: NDArray[np.uint8], text: str, place: tuple[int, int], scale: float, color: Color = WHITE
) -> None:
    # A shadow instead of an outline: OpenCV 5 draws thicker letters wider.
    for shift, ink in ((1, BLACK), (0, color)):
        at = place[0] + shift, place[1] + shift
        cv2.putText(canvas, text, at, cv2.FONT_HERSHEY_SIMPLEX, scale, ink, 1, cv2.LINE_AA)


_AXIS_PART = 0.4  # Length of an axis, in reaches of the body
_SHIFT = 4  # Binary digits of a coordinate after the point


def draw_pose(image: NDArray[np.uint8], pose: Pose, camera: CameraModel, rig: MarkerRig) -> None:
    """Draw the axes at the body's dock point, and a cross at each light's reprojection.

    Red is x forward, green y left, blue z up. The image is (height, width, 3), blue first.
    """
    origin = np.array(rig.dock)
    length = _AXIS_PART * rig.reach
    tips = origin + length * np.eye(3)
    points = np.vstack((origin, tips)) @ pose.rotation.T + pose.translation
    if camera.shows(points).all():
        pixels = camera.project(points)
        if np.abs(pixels).max() < 2.0**20:
            start, *ends = (np.round(pixels * 2**_SHIFT)).astype(int).tolist()
            for end, color in zip(ends, (RED, GREEN, BLUE), strict=True):
                cv2.line(image, start, end, color, 2, cv2.LINE_AA, _SHIFT)
    for x, y in pose.reprojections.tolist():
        if abs(x) < 2**20 and abs(y) < 2**20:
            cv2.drawMarker(image, (round(x), round(y)), WHITE, cv2.MARKER_TILTED_CROSS, 7, 1)
