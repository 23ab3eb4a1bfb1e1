"""The debug images of a frame (the thesis's video windows two to five), and their drawing.

All are contiguous uint8, grey or blue first, at least 1 x 1 px even for an empty frame.
"""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.point_operations import Pixels
from mvuav_ros.vision.runway.hough import Accumulator, HoughGrid
from mvuav_ros.vision.runway.normal_form import Ends, segment_ends
from mvuav_ros.vision.runway.peaks import Peak
from mvuav_ros.vision.runway.results import LineFlag, RunwayLine, RunwayResult

Canvas = NDArray[np.uint8]
Color = tuple[int, int, int]
Point = tuple[float, float]

WHITE, BLACK = (255, 255, 255), (0, 0, 0)

# OpenCV draws between whole pixels unless coordinates carry fractional bits.
_SHIFT = 4
_LIMIT = 1e5
_FONT = cv2.FONT_HERSHEY_SIMPLEX


def eight_bits(image: Pixels) -> Canvas:
    """An image in 8 bits, itself if it has them."""
    return (image >> 8 if image.dtype == np.uint16 else image).astype(np.uint8, copy=False)


def blank(height: int, width: int, *channels: int) -> Canvas:
    """Black, at least 1 x 1 px."""
    return np.zeros((max(1, height), max(1, width), *channels), np.uint8)


def canvas_of(image: Pixels) -> tuple[Canvas, float]:
    """A copy of an image to draw on, (height, width, 3), and by how much larger to draw on it."""
    canvas = np.array(eight_bits(image), order='C')
    if canvas.ndim == 2:
        canvas = np.stack([canvas] * 3, axis=2)
    return canvas, max(1.0, min(image.shape[:2]) / 240)


def draw_line(canvas: Canvas, first: Point, last: Point, color: Color, thickness: int) -> None:
    """Draw a line between two points (x, y), fractions of px."""
    begin, end = (
        [round(min(max(value, -_LIMIT), _LIMIT) * 2**_SHIFT) for value in point]
        for point in (first, last)
    )
    cv2.line(canvas, begin, end, color, thickness, cv2.LINE_AA, _SHIFT)


def write(
    canvas: Canvas, text: str, place: tuple[int, int], size: float, color: Color = WHITE
) -> None:
    """Write a line of ASCII text on a black box that keeps it readable on any canvas.

    Its lower left corner is at ``place`` (x, y in px); ``size`` is OpenCV's font scale.
    """
    thickness = max(1, round(2 * size))
    (width, height), below = cv2.getTextSize(text, _FONT, size, thickness)
    x, y = place
    cv2.rectangle(canvas, (x - 2, y - height - 2), (x + width + 1, y + below), BLACK, -1)
    cv2.putText(canvas, text, place, _FONT, size, color, thickness, cv2.LINE_AA)


def write_centred(
    canvas: Canvas, text: str, centre: tuple[int, int], size: float, color: Color = WHITE
) -> None:
    """Write a line of text, its middle at ``centre`` (x, y in px)."""
    thickness = max(1, round(2 * size))
    (width, height), _ = cv2.getTextSize(text, _FONT, size, thickness)
    place = centre[0] - width // 2, centre[1] + height // 2
    cv2.putText(canvas, text, place, _FONT, size, color, thickness, cv2.LINE_AA)


GREEN, AMBER, MAGENTA, RED = (80, 230, 60), (0, 190, 255), (255, 80, 230), (60, 60, 255)

_DASH, _GAP = 9, 9


def line_color(flags: LineFlag) -> Color:
    """Blue, green, red: green believed, amber rho error, magenta theta error, red both."""
    if flags & LineFlag.RHO_ERROR:
        return RED if flags & LineFlag.THETA_ERROR else AMBER
    return MAGENTA if flags & LineFlag.THETA_ERROR else GREEN


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
    if math.isnan(ends[0]):
        return
    thickness = max(2, round(1.8 * scale))
    for ink, more in ((BLACK, 2), (color, 0)):
        for part in dashes(ends, scale) if line.corrected else [ends]:
            draw_line(canvas, part[:2], part[2:], ink, thickness + more)


def dashes(ends: Ends, scale: float) -> list[Ends]:
    """The parts of a line that are drawn where it is dashed."""
    x, y, x2, y2 = ends
    step_x, step_y = x2 - x, y2 - y
    length = math.hypot(step_x, step_y)
    if not length > 0:
        return []
    period = (_DASH + _GAP) * scale / length
    parts = []
    for number in range(math.ceil(1 / period)):
        first = number * period
        last = min(1.0, first + _DASH * scale / length)
        parts.append((x + first * step_x, y + first * step_y, x + last * step_x, y + last * step_y))
    return parts


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
    first, last, tip = rows[0], rows[1] - 1, round(8 * scale)
    if last <= first or last - first == height - 1:
        return
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


# One size for all resolutions: a viewer or a video file does not take changing ones.
_WIDTH, _HEIGHT = 540, 400
_LEFT, _TOP, _RIGHT, _BOTTOM = 52, 24, 14, 24
_INK, _MARK = (210, 210, 210), (120, 255, 80)
_TEXT = 0.4
_TICKS_DEG = (-90, -45, 0, 45, 90)
_RHO_TICKS = 5


def draw_hough(result: RunwayResult) -> Canvas:
    """The accumulator, theta to the right and rho downwards, with the peaks marked and numbered.

    Brightness is the square root of votes over the most votes, since a linear scale shows
    nothing beside the peaks. The boxes are the neighbourhoods in which no other peak is taken,
    the numbers the rows of the result. The axes are those of the confined rows; rho begins where
    a line can cross them. The size, (height, width, 3), is always the same.
    """
    canvas = np.zeros((_TOP + _HEIGHT + _BOTTOM, _LEFT + _WIDTH + _RIGHT, 3), np.uint8)
    workings = result.workings
    grid, votes = workings.grid, workings.accumulator
    if votes is None or grid is None:
        write(canvas, result.status or 'no accumulator', (8, _TOP + _HEIGHT // 2), _TEXT, _INK)
        return canvas
    first_cell = grid.first_reachable_cell
    area = canvas[_TOP : _TOP + _HEIGHT, _LEFT : _LEFT + _WIDTH]
    area[:] = _colored(votes)
    for row, line in enumerate(result.lines, 1):
        if line.peak is not None:
            peak = workings.peaks[line.peak]
            moved = peak._replace(rho_index=peak.rho_index - first_cell)
            _mark(area, row, moved, votes.shape, workings.peak_reach)
    _draw_axes(canvas, grid, first_cell)
    title = f'votes (brightest: {int(votes.max())}) over theta, deg, and rho, px'
    write(canvas, title, (_LEFT, _TOP - 8), _TEXT, _INK)
    return canvas


def _colored(votes: Accumulator) -> Canvas:
    columns, cells = votes.shape
    share = np.divide(votes.T, max(1, int(votes.max())), dtype=np.float64)
    brightness = np.sqrt(share) * 255
    # Spread the maxima before shrinking, which would lose them.
    spread = (-(-cells // _HEIGHT), -(-columns // _WIDTH))
    shown = cv2.dilate(brightness.astype(np.uint8), np.ones(spread, np.uint8))
    shown = cv2.resize(shown, (_WIDTH, _HEIGHT), interpolation=cv2.INTER_NEAREST)
    return np.asarray(cv2.applyColorMap(shown, cv2.COLORMAP_INFERNO), np.uint8)


def _mark(
    area: Canvas, number: int, peak: Peak, shape: tuple[int, ...], reach: tuple[int, int]
) -> None:
    across, down = _WIDTH / shape[0], _HEIGHT / shape[1]
    x, y = (peak.theta_index + 0.5) * across, (peak.rho_index + 0.5) * down
    half_width = max(6.0, (reach[1] + 0.5) * across)
    half_height = max(6.0, (reach[0] + 0.5) * down)
    corners = [(round(x + side * half_width), round(y + side * half_height)) for side in (-1, 1)]
    for ink, thickness in ((BLACK, 3), (_MARK, 1)):
        cv2.rectangle(area, corners[0], corners[1], ink, thickness)
    # Above the box, or below where there is no room.
    label_y = corners[0][1] - 10 if corners[0][1] > 20 else corners[1][1] + 10
    write_centred(area, str(number), (min(max(round(x), 8), _WIDTH - 8), label_y), 0.5, _MARK)


def _draw_axes(canvas: Canvas, grid: HoughGrid, first_cell: int) -> None:
    # At the middles of cells; that of 90° would be the one after the last.
    below, columns, cells = _TOP + _HEIGHT, grid.theta.size, grid.rho.size - first_cell
    for degrees in _TICKS_DEG:
        x = _LEFT + round(((degrees + 90) / 180 * columns + 0.5) * _WIDTH / columns)
        if x >= canvas.shape[1]:
            continue
        cv2.line(canvas, (x, below), (x, below + 4), _INK, 1)
        write_centred(canvas, str(degrees), (x, below + 13), _TEXT, _INK)
    for fraction in np.linspace(0, 1, _RHO_TICKS):
        y = _TOP + round((float(fraction) * (cells - 1) + 0.5) * _HEIGHT / cells)
        cv2.line(canvas, (_LEFT - 5, y), (_LEFT - 1, y), _INK, 1)
        rho = grid.rho[first_cell] + fraction * (grid.rho[-1] - grid.rho[first_cell])
        write_centred(canvas, f'{rho:.0f}', (_LEFT - 26, y), _TEXT, _INK)
