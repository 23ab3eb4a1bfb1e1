"""The four debug images of a frame: the thesis's video windows two to five.

Each is drawn only when its function is called. All are contiguous uint8, either (height, width) or
(height, width, 3), blue first, and at least 1 x 1 px even for an empty frame.
"""

from __future__ import annotations

import math

import cv2
import numpy as np

from mvuav_ros.vision.runway.drawing import (
    BLACK,
    WHITE,
    Canvas,
    Color,
    blank,
    canvas_of,
    draw_line,
    eight_bits,
    write,
    write_centred,
)
from mvuav_ros.vision.runway.normal_form import Ends, segment_ends
from mvuav_ros.vision.runway.results import LineFlag, RunwayLine, RunwayResult

GREEN, AMBER, MAGENTA, RED = (80, 230, 60), (0, 190, 255), (255, 80, 230), (60, 60, 255)

_DASH, _GAP = 9, 9


def line_color(flags: LineFlag) -> Color:
    """Blue, green, red: green believed, amber rho error, magenta theta error, red both."""
    rho, theta = flags & LineFlag.RHO_ERROR, flags & LineFlag.THETA_ERROR
    if rho and theta:
        return RED
    if rho:
        return AMBER
    return MAGENTA if theta else GREEN


def draw_confined(result: RunwayResult) -> Canvas:
    """The channel in the rows searched, (rows, width)."""
    gray = result.workings.gray
    return blank(0, result.width) if gray is None else np.ascontiguousarray(eight_bits(gray))


def draw_edges(result: RunwayResult) -> Canvas:
    """The opened edges, white on black, (rows, width)."""
    edges = result.workings.edges
    return blank(0, result.width) if edges is None else edges * np.uint8(255)


def draw_overlay(result: RunwayResult) -> Canvas:
    """The whole frame with its lines, (height, width, 3).

    A line believed is solid green. A line that keeps old values is dashed, in the colour of its
    flags (`line_color`), with its rejected measurement as a thin line beside it. Numbers are
    rows of the result, counted from 1. Brackets at both sides show the rows searched.
    """
    if result.workings.image.size == 0:
        return blank(result.height, result.width, 3)
    canvas, scale = canvas_of(result.workings.image)
    _draw_brackets(canvas, result.rows, scale)
    numbered = [(number, line) for number, line in enumerate(result.lines, 1) if line.found]
    # Believed lines last, so that they lie on top.
    numbered.sort(key=lambda entry: not entry[1].corrected)
    for _, line in numbered:
        _draw_line(canvas, line, scale)
    for number, line in numbered:
        _draw_number(canvas, number, line, scale)
    write(canvas, _caption(result), (round(3 * scale), round(12 * scale)), 0.4 * scale)
    return canvas


def _draw_line(canvas: Canvas, line: RunwayLine, scale: float) -> None:
    height, width = canvas.shape[:2]
    ends = (line.x, line.y, line.x2, line.y2)
    color = line_color(line.flags)
    measured = segment_ends(line.raw, width, height)
    if line.corrected and not math.isnan(measured[0]):
        draw_line(canvas, measured[:2], measured[2:], color, 1)
    if not math.isnan(ends[0]):
        _stroke(canvas, _dashes(ends, scale) if line.corrected else [ends], color, scale)


def _stroke(canvas: Canvas, strokes: list[Ends], color: Color, scale: float) -> None:
    width = max(2, round(1.8 * scale))
    for ink, thickness in ((BLACK, width + 2), (color, width)):
        for ends in strokes:
            draw_line(canvas, ends[:2], ends[2:], ink, thickness)


def _dashes(ends: Ends, scale: float) -> list[Ends]:
    x, y, x2, y2 = ends
    length = math.hypot(x2 - x, y2 - y)
    if not length > 0:
        return []
    period = (_DASH + _GAP) * scale / length
    step_x, step_y = x2 - x, y2 - y
    dashes = []
    for number in range(math.ceil(1 / period)):
        first = number * period
        last = min(1.0, first + _DASH * scale / length)
        dashes.append(
            (x + first * step_x, y + first * step_y, x + last * step_x, y + last * step_y)
        )
    return dashes


def _draw_number(canvas: Canvas, number: int, line: RunwayLine, scale: float) -> None:
    if math.isnan(line.x):
        return
    height, width = canvas.shape[:2]
    # Lines of a runway meet at the top, so their lower parts are apart; numbers of lines that are
    # not stand above one another.
    place = 0.92 - 0.08 * ((number - 1) % 6)
    radius = round(7 * scale)
    x = _inside(line.x + place * (line.x2 - line.x), radius, width)
    y = _inside(line.y + place * (line.y2 - line.y), radius, height)
    cv2.circle(canvas, (x, y), radius, BLACK, -1, cv2.LINE_AA)
    cv2.circle(canvas, (x, y), radius, line_color(line.flags), 1, cv2.LINE_AA)
    write_centred(canvas, str(number), (x, y), 0.38 * scale)


def _draw_brackets(canvas: Canvas, rows: tuple[int, int], scale: float) -> None:
    height, width = canvas.shape[:2]
    first, last = rows[0], rows[1] - 1
    if last <= first or last - first == height - 1:
        return
    tip = round(8 * scale)
    for side, inner in ((1, tip), (width - 2, width - 1 - tip)):
        outline = np.array([(inner, first), (side, first), (side, last), (inner, last)], np.int32)
        for ink, thickness in ((BLACK, round(scale) + 2), (WHITE, round(scale))):
            cv2.polylines(canvas, [outline], False, ink, thickness)


def _caption(result: RunwayResult) -> str:
    found = sum(line.found for line in result.lines)
    held = sum(line.corrected for line in result.lines)
    words = f'{found} of {len(result.lines)} lines'
    if held:
        words += f', {held} held'
    return f'{words}: {result.status}' if result.status else words


def _inside(value: float, margin: int, size: int) -> int:
    return round(min(max(value, margin), max(margin, size - 1 - margin)))
