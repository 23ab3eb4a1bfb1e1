"""The frame with the shape drawn on it, for a pilot's glance."""

from __future__ import annotations

import math

from mvuav_ros.vision.approach.approach_results import ApproachResult, Point
from mvuav_ros.vision.runway.debug_images import (
    BLACK,
    WHITE,
    Canvas,
    Color,
    blank,
    canvas_of,
    dashes,
    draw_line,
    write,
)
from mvuav_ros.vision.runway.results import LineRole, RunwayLine

# Blue, green, red. Left red and right green, as the marker lights are drawn.
ROLE_COLORS: dict[LineRole, Color] = {
    LineRole.UNKNOWN: (255, 255, 255),
    LineRole.LEFT_EDGE: (60, 60, 255),
    LineRole.RIGHT_EDGE: (80, 230, 60),
    LineRole.CENTRELINE: (255, 200, 60),
    LineRole.FAR_END: (60, 230, 255),
    LineRole.NEAR_END: (60, 230, 255),
}
_HORIZON = (255, 160, 160)


def draw_approach(result: ApproachResult) -> Canvas:
    """Edges, ends, centreline, vanishing point, horizon and numbers on the frame.

    The left edge is red, the right one green, the centreline blue, the ends yellow; a line that
    keeps old values (the thesis's flags) is dashed. The cross is where the edges meet, the thin
    line the horizon.

    Returns:
        (height, width, 3) uint8, blue first; at least 1 x 1 px.
    """
    if result.image.size == 0:
        return blank(result.height, result.width, 3)
    canvas, scale = canvas_of(result.image)
    if result.horizon is not None:
        draw_line(canvas, *result.horizon, _HORIZON, 1)
    for line in result.lines:
        if line.found and not math.isnan(line.x):
            _draw_role(canvas, line, scale)
    _draw_cross(canvas, result.vanishing_point, scale)
    for number, text in enumerate(_words(result)):
        place = round(3 * scale), round((12 + 13 * number) * scale)
        write(canvas, text, place, 0.4 * scale)
    return canvas


def _draw_role(canvas: Canvas, line: RunwayLine, scale: float) -> None:
    ends = line.x, line.y, line.x2, line.y2
    thin = line.role is LineRole.CENTRELINE
    width = 1 if thin else max(1, round(1.6 * scale - 0.6))
    if width > 1 and not line.corrected:
        draw_line(canvas, ends[:2], ends[2:], BLACK, width + 2)
    for part in dashes(ends, scale) if line.corrected else [ends]:
        draw_line(canvas, part[:2], part[2:], ROLE_COLORS[line.role], width)


def _draw_cross(canvas: Canvas, point: Point, scale: float) -> None:
    x, y = point
    if not (abs(x) < 1e5 and abs(y) < 1e5):
        return
    # Open in the middle, so that a runway far away is not hidden.
    gap, reach = 3 * scale, 8 * scale
    for ink, width in ((BLACK, 3), (WHITE, 1)):
        for dx, dy in ((-1, 0), (1, 0), (0, -1)):
            first = (x + gap * dx, y + gap * dy)
            draw_line(canvas, first, (x + reach * dx, y + reach * dy), ink, width)


def _words(result: ApproachResult) -> list[str]:
    if result.corners is None:
        return [result.status]
    words = [f'confidence {100 * result.confidence:.0f} %']
    if result.status:
        words.append(result.status)
    guidance = result.guidance
    if guidance is not None and guidance.known:
        side = 'left' if guidance.y > 0 else 'right'
        turned = 'left' if guidance.yaw > 0 else 'right'
        words += [
            f'{abs(guidance.y):.1f} m {side} of centre, {guidance.z:.0f} m high',
            f'heading {math.degrees(abs(guidance.yaw)):.1f} deg {turned}',
        ]
    return words
