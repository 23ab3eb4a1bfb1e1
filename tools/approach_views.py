"""What else a camera may show of labelled footage: no horizon, or text burned into the picture."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import cv2
import numpy as np
from approach_variants import Variant
from numpy.typing import NDArray

from mvuav_ros.offline.evaluation.corners import LabelledFrame
from mvuav_ros.vision.approach.attitude import HorizonLine

Pixels = NDArray[Any]
Point = tuple[float, float]


class Shot(NamedTuple):
    """One frame: its pixels, what is known of it, and where text was drawn (bool) if anywhere.

    It may be magnified, and the errors of its labels with it.
    """

    image: Pixels
    label: LabelledFrame | None = None
    horizon: HorizonLine | None = None
    text: NDArray[np.bool_] | None = None
    zoom: int = 1


View = Callable[[Shot, int], Shot]
"""Changes a shot with a number."""


def as_it_is(shot: Shot, index: int) -> Shot:
    """No change."""
    return shot


def hazy(half: float) -> View:
    """Haze that leaves half of the contrast so many rows below the horizon."""

    def view(shot: Shot, index: int) -> Shot:
        assert shot.horizon is not None
        height, width = shot.image.shape[:2]
        y, x = np.mgrid[:height, :width].astype(np.float32)
        depth = y - shot.horizon.row - (x - 0.5 * width) * math.tan(shot.horizon.slope)
        above = (depth < -2) & (depth > -12)
        sky = shot.image[above].mean(axis=0)
        left = np.where(depth > 0, np.exp2(-half / np.maximum(depth, 0.1)), 1.0)
        left = left if shot.image.ndim == 2 else left[..., None]
        image = np.rint(sky + (shot.image - sky) * left).astype(np.uint8)
        return shot._replace(image=image)

    return view


def cropped(top: int, zoom: int = 1) -> View:
    """Cut off the rows above one; ``zoom`` magnifies what is left of the width, too."""

    def view(shot: Shot, index: int) -> Shot:
        assert shot.label is not None
        assert shot.horizon is not None
        return _cut(shot, top, zoom)

    return view


_ROWS_BELOW = 100
"""Of 240, which are left in every frame of runs 2, 3 and 5."""


def following(below: float, zoom: int = 1) -> View:
    """Cut off all that is above so many rows below the horizon, as a gimbal would keep it."""

    def view(shot: Shot, index: int) -> Shot:
        assert shot.horizon is not None
        width = shot.image.shape[1]
        lower_side = shot.horizon.row + 0.5 * width * abs(math.tan(shot.horizon.slope))
        # Every frame has the same size.
        shot = _cut(shot, math.ceil(lower_side + below), zoom)
        return shot if zoom > 1 else shot._replace(image=shot.image[:_ROWS_BELOW])

    return view


def _cut(shot: Shot, top: int, zoom: int) -> Shot:
    image, label, horizon = shot[:3]
    height, width = image.shape[:2]
    left = 0
    if zoom > 1:
        assert label is not None
        middle = 0.5 * (label.near_left[0] + label.near_right[0])
        # The frame follows the runway in steps, as a gimbal would turn.
        left = int(
            np.clip(32 * round((middle - 0.5 * width / zoom) / 32), 0, width - width // zoom)
        )
        rows = min(height // zoom, _ROWS_BELOW)
        part = image[top : top + rows, left : left + width // zoom]
        image = cv2.resize(part, None, fx=zoom, fy=zoom, interpolation=cv2.INTER_CUBIC)
    else:
        image = image[top:]
    if label is not None:
        corners = _above_cut(label, top)
        moved = [(zoom * (x - left + 0.5) - 0.5, zoom * (y - top + 0.5) - 0.5) for x, y in corners]
        label = LabelledFrame(label.file, *moved)
    if horizon is not None:
        middle = left + 0.5 * width / zoom - 0.5 * width
        row = horizon.row + middle * math.tan(horizon.slope)
        horizon = replace(horizon, row=zoom * (row - top + 0.5) - 0.5)
    return Shot(np.ascontiguousarray(image), label, horizon, None, zoom)


def magnified(zoom: int) -> View:
    """Show the runway as a longer lens does; there is no label where its near end is in view."""

    def view(shot: Shot, index: int) -> Shot:
        label, horizon = shot.label, shot.horizon
        assert label is not None
        assert horizon is not None
        height, width = (side // zoom for side in shot.image.shape[:2])
        slope = math.tan(horizon.slope)
        middle = 0.5 * (label.far_left[0] + label.far_right[0])
        left = int(np.clip(8 * round((middle - 0.5 * width) / 8), 0, shot.image.shape[1] - width))
        row = horizon.row + (left + 0.5 * (width - shot.image.shape[1])) * slope
        top = int(np.clip(round(row - 0.35 * height), 0, shot.image.shape[0] - height))
        part = shot.image[top : top + height, left : left + width]
        image = cv2.resize(part, None, fx=zoom, fy=zoom, interpolation=cv2.INTER_CUBIC)
        line = replace(horizon, row=zoom * (row - top + 0.5) - 0.5)
        last = top + height - 1.0
        if min(label.near_left[1], label.near_right[1]) <= last:
            return Shot(image, None, line, None, zoom)
        near_left = _at_row(label.near_left, label.far_left, last)
        near_right = _at_row(label.near_right, label.far_right, last)
        corners = near_left, near_right, label.far_right, label.far_left
        moved = [(zoom * (x - left + 0.5) - 0.5, zoom * (y - top + 0.5) - 0.5) for x, y in corners]
        return Shot(image, LabelledFrame(label.file, *moved), line, None, zoom)

    return view


def faint(share: float, level: float) -> View:
    """Show a share of all contrast about a grey level: in fog, or underexposed."""

    def view(shot: Shot, index: int) -> Shot:
        return shot._replace(image=np.rint(level + share * (shot.image - level)).astype(np.uint8))

    return view


FAINT = {'in fog': faint(0.2, 160.0), 'underexposed': faint(0.2, 0.0)}


def taken_by(before: View = as_it_is, *, defocus: float = 0.0, **faults: Any) -> View:
    """Show all as a bad camera does, after another change.

    Args:
        before: the other change.
        defocus: standard deviation of the blur, in px of an image of 320 px width.
        **faults: of a `Variant`.
    """
    camera = Variant('', **faults)

    def view(shot: Shot, index: int) -> Shot:
        shot = before(shot, index)
        seen = shot.image
        if defocus:
            seen = cv2.GaussianBlur(seen, (0, 0), defocus * seen.shape[1] / 320)
        return shot._replace(image=camera.image(seen, index))

    return view


BAD_CAMERAS: dict[str, dict[str, Any]] = {
    'noisy': {'noise': 12.0},
    'defocused': {'defocus': 1.2},
    'compressed': {'jpeg': 15},
}
"""Of `taken_by`."""


def _at_row(one: Point, other: Point, row: float) -> Point:
    share = (row - one[1]) / (other[1] - one[1])
    return one[0] + share * (other[0] - one[0]), row


def _above_cut(label: LabelledFrame, top: float) -> list[Point]:
    """Corners, of which the far ones are moved along the edges into the picture."""

    def inside(near: Point, far: Point) -> Point:
        if far[1] >= top or near[1] <= top + 1:
            return far
        return _at_row(near, far, top)

    return [
        label.near_left,
        label.near_right,
        inside(label.near_right, label.far_right),
        inside(label.near_left, label.far_left),
    ]


def _text(image: Pixels, words: str, x: float, y: float, size: float, **how: Any) -> None:
    """Words with their lower left corner at shares of the width and height."""
    height, width = image.shape[:2]
    scale = size * width / 640
    place = int(x * width), int(y * height)
    line = max(1, round(1.6 * scale))
    if how.get('box'):
        (w, h), base = cv2.getTextSize(words, cv2.FONT_HERSHEY_SIMPLEX, scale, line)
        corner = place[0] + w + 2, place[1] + base
        cv2.rectangle(image, (place[0] - 2, place[1] - h - 2), corner, (0, 0, 0), -1)
    if how.get('outline'):
        cv2.putText(
            image, words, place, cv2.FONT_HERSHEY_SIMPLEX, scale, (0, 0, 0), line + 2, cv2.LINE_AA
        )
    colour = how.get('colour', (255, 255, 255))
    cv2.putText(image, words, place, cv2.FONT_HERSHEY_SIMPLEX, scale, colour, line, cv2.LINE_AA)


def painted_over(image: Pixels, boxes: list[Any], slope: float = 0.0) -> Pixels:
    """Without what is in polygons (n, 2) or boxes of two corners, grown by half and 3 px.

    There is what lies beside it along the horizon, of a slope in rad, without a seam: smears of
    what is around it would look like a strip that begins at the horizon.
    """
    colour = image if image.ndim == 3 else cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
    height, width = image.shape[:2]
    for box in boxes:
        corners = np.asarray(box, float)
        ends = np.array([corners.min(axis=0), corners.max(axis=0)])
        grown = ends + 0.25 * (ends - ends[::-1]) + [[-3], [3]]
        (left, top), (right, bottom) = np.clip(np.rint(grown), 1, (width - 2, height - 2))
        mask = np.zeros((height, width), np.uint8)
        mask[int(top) : int(bottom) + 1, int(left) : int(right) + 1] = 255
        away = (right - left + 8) * (1 if width - right > left else -1)
        move = np.array([[1, 0, -away], [0, 1, -away * math.tan(slope)]])
        beside = cv2.warpAffine(
            colour, move, (width, height), flags=cv2.INTER_NEAREST, borderMode=cv2.BORDER_REFLECT
        )
        middle = int(left + right + 1) // 2, int(top + bottom + 1) // 2
        colour = cv2.seamlessClone(beside, colour, mask, middle, cv2.NORMAL_CLONE)
    return np.asarray(colour if image.ndim == 3 else cv2.cvtColor(colour, cv2.COLOR_BGR2GRAY))


def without_runway(shot: Shot, index: int) -> Shot:
    """Paint over the runway with the land beside it."""
    assert shot.label is not None
    label, slope = shot.label, 0.0 if shot.horizon is None else shot.horizon.slope
    corners = [label.near_left, label.near_right, label.far_right, label.far_left]
    return shot._replace(image=painted_over(shot.image, [corners], slope))


_YELLOW = (0, 255, 255)


def _flight_controller(image: Pixels, index: int) -> None:
    """An OSD as a flight controller draws it: white with black outlines, digits that change."""
    seconds = index / 25
    for words, x, y in (
        (f'{16.2 - 0.004 * index:.1f}V', 0.03, 0.08),
        (f'{int(seconds) // 60:02d}:{int(seconds) % 60:02d}', 0.45, 0.07),
        (f'RSSI {90 + index // 7 % 9}', 0.76, 0.08),
        (f'{55 + index // 3 % 23} KM/H', 0.03, 0.5),
        (f'{120 - 0.1 * index:.0f} M', 0.83, 0.5),
        (f'{2.1 + 0.01 * index:.2f} KM', 0.03, 0.95),
        ('MANUAL', 0.44, 0.95),
        (f'{1200 + index} MAH', 0.74, 0.95),
    ):
        _text(image, words, x, y, 0.75, outline=True)


def _status_lines(image: Pixels, index: int) -> None:
    """Lines of white and yellow text along the top and the bottom, and a date."""
    _text(image, 'LANDING RWY 27L  COCKPIT VIEW  LIVE', 0.04, 0.07, 0.7)
    _text(image, f'ALT {1200 - 2 * index:5d} FT  IAS {138 + index // 5 % 7} KT', 0.04, 0.14, 0.7)
    _text(image, 'youtube.com/flightvideos', 0.3, 0.965, 0.6, colour=_YELLOW)
    _text(image, f'2014-06-0{1 + index // 90 % 9} 14:{index // 25 % 60:02d}', 0.62, 0.9, 0.6)


def _boxes(image: Pixels, index: int) -> None:
    """Text in black boxes at the top, in the middle and at the bottom."""
    _text(image, f'SPD {140 + index // 4 % 9}', 0.08, 0.2, 0.8, box=True, colour=_YELLOW)
    _text(image, f'HDG {269 + index // 9 % 4}', 0.4, 0.12, 0.8, box=True)
    _text(image, f'ALT {900 - index}', 0.7, 0.2, 0.8, box=True, colour=(0, 255, 0))
    _text(image, 'TERRAIN AHEAD', 0.3, 0.62, 0.7, box=True, colour=_YELLOW)
    _text(image, f'REC {index:06d}', 0.05, 0.93, 0.7, box=True, colour=(0, 0, 255))


def _ladder(image: Pixels, index: int) -> None:
    """A head-up display: a pitch ladder that moves, and scales at both sides."""
    height, width = image.shape[:2]
    green = (80, 255, 80)
    pitch = 0.04 * math.sin(0.06 * index)
    roll = 0.06 * math.sin(0.045 * index + 1)
    cos, sin = math.cos(roll), math.sin(roll)

    def turned(x: float, y: float) -> tuple[int, int]:
        return (
            round(0.5 * width + width * (cos * x - sin * y)),
            round(0.45 * height + width * (sin * x + cos * y)),
        )

    for step in range(-3, 4):
        y = 0.09 * step + pitch
        long = 0.2 if step == 0 else 0.11
        for side in (-1, 1):
            inner, outer = turned(side * 0.05, y), turned(side * long, y)
            cv2.line(image, inner, outer, green, 1, cv2.LINE_AA)
            cv2.line(image, outer, turned(side * long, y + 0.012), green, 1, cv2.LINE_AA)
    for side, first in ((0.12, 138 + index // 5), (0.88, 1200 - 2 * index)):
        x = int(side * width)
        cv2.line(image, (x, int(0.25 * height)), (x, int(0.7 * height)), green, 1)
        for number in range(8):
            y = int((0.25 + 0.055 * number + 0.001 * (index * 3 % 55)) * height)
            cv2.line(image, (x - 4, y), (x + 4, y), green, 1)
        _text(image, str(first), side - 0.05, 0.47, 0.6, colour=green, box=True)


def _reticle(image: Pixels, index: int) -> None:
    """Wings, a circle and a dot in the middle, as flight controllers draw them."""
    height, width = image.shape[:2]
    middle = width // 2, height // 2
    for ink, thick in (((0, 0, 0), 3), ((255, 255, 255), 1)):
        for side in (-1, 1):
            inner, outer = (middle[0] + round(side * far * width) for far in (0.035, 0.09))
            cv2.line(image, (inner, middle[1]), (outer, middle[1]), ink, thick, cv2.LINE_AA)
        cv2.circle(image, middle, round(0.035 * width), ink, thick, cv2.LINE_AA)
        cv2.circle(image, middle, thick, ink, -1, cv2.LINE_AA)


TEXTS: dict[str, Callable[[Pixels, int], None]] = {
    'OSD': _flight_controller,
    'status lines': _status_lines,
    'boxes': _boxes,
    'ladder': _ladder,
    'reticle': _reticle,
}


def with_text(style: str, before: View = as_it_is) -> View:
    """Draw text of a style of `TEXTS`, after another change."""

    def view(shot: Shot, index: int) -> Shot:
        shot = before(shot, index)
        drawn = shot.image.copy()
        TEXTS[style](drawn, index)
        other = drawn != shot.image
        other = other if other.ndim == 2 else other.any(axis=2)
        size = max(3, drawn.shape[1] // 40) | 1
        text = cv2.dilate(other.astype(np.uint8), np.ones((size, size), np.uint8)) > 0
        return shot._replace(image=drawn, text=text)

    return view


def in_sky_or_text(corners: list[Point], shot: Shot) -> bool:
    """Whether a report lies above the horizon, or half in text."""
    points = np.array(corners)
    if shot.horizon is not None:
        away = points[:, 0] - 0.5 * (shot.image.shape[1] - 1)
        row = shot.horizon.row + math.tan(shot.horizon.slope) * away
        if (points[:, 1] < row).all():
            return True
    if shot.text is None:
        return False
    within = np.zeros(shot.text.shape, np.uint8)
    cv2.fillPoly(within, [np.rint(points).astype(np.int32)], 1)
    inside = within > 0
    return bool(inside.any() and shot.text[inside].mean() > 0.5)
