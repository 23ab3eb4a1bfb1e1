"""The Hough accumulator as a canvas that a person can read: the thesis's fourth video window."""

from __future__ import annotations

import cv2
import numpy as np

from mvuav_ros.vision.runway.drawing import BLACK, Canvas, write, write_centred
from mvuav_ros.vision.runway.hough import Accumulator, HoughGrid
from mvuav_ros.vision.runway.peaks import Peak
from mvuav_ros.vision.runway.results import RunwayResult

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
    the numbers the rows of the result.
    The axes are those of the confined rows; rho begins where a line can cross them.

    Returns:
        Always the same size, (height, width, 3) uint8, blue first.
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
    below = _TOP + _HEIGHT
    for degrees in _TICKS_DEG:
        x = _LEFT + round((degrees + 90) / 180 * (_WIDTH - 1))
        cv2.line(canvas, (x, below), (x, below + 4), _INK, 1)
        write_centred(canvas, str(degrees), (x, below + 13), _TEXT, _INK)
    for fraction in np.linspace(0, 1, _RHO_TICKS):
        y = _TOP + round(float(fraction) * (_HEIGHT - 1))
        cv2.line(canvas, (_LEFT - 5, y), (_LEFT - 1, y), _INK, 1)
        rho = grid.rho[first_cell] + fraction * (grid.rho[-1] - grid.rho[first_cell])
        write_centred(canvas, f'{rho:.0f}', (_LEFT - 26, y), _TEXT, _INK)
