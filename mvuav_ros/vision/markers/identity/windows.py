"""The usual frame: every marker looked for in a window of its own."""

from __future__ import annotations

import math

from mvuav_ros.vision.markers.centroid import Detection
from mvuav_ros.vision.markers.grouping import area_fits
from mvuav_ros.vision.markers.identity.appearance import AppearanceModel
from mvuav_ros.vision.markers.identity.marker_memory import MarkerMemory
from mvuav_ros.vision.markers.lights import Frame
from mvuav_ros.vision.markers.results import NO_WINDOW, Window

EDGE = 4.0  # px of dark that a window shows around a light


def look_into_windows(
    frame: Frame, memory: MarkerMemory
) -> tuple[list[Detection | None], list[Window]]:
    """The markers to which nothing has happened, None for the others; and their windows."""
    windows: list[Window] = []
    spots: list[Detection | None] = []
    for index, marker in enumerate(memory.markers):
        spot = None
        window = NO_WINDOW
        if not (marker.unseen or marker.returning):
            look = marker.look
            radius = max(frame.parameters.search_radius, math.ceil(look.radius + EDGE))
            x, y = memory.predicted[2 * index], memory.predicted[2 * index + 1]
            window = Window.around(x, y, radius, frame.size)
            # The background changes slowly: every third frame is enough to look at it.
            pull = look.pull if (index + frame.number) % 3 else None
            spot = frame.meter.measure(frame.cut, window, frame.size, pull)
            if pull is None:
                look.pull = frame.meter.pull
            if spot is not None and not _is_usual(look, spot, window, frame):
                spot = None
        windows.append(window)
        spots.append(spot)
    return spots, windows


def _is_usual(look: AppearanceModel, spot: Detection, window: Window, frame: Frame) -> bool:
    """Whether nothing has happened to a light, nor does the window cut it."""
    if not look.is_usual(spot.area, spot.spread) or not area_fits(spot.area, frame.parameters):
        return False
    x0, x1, y0, y1 = window
    right, bottom = frame.size[0] - 1, frame.size[1] - 1
    reach = look.radius + 1.0
    x, y = spot.x, spot.y
    cut_x = x - reach < x0 > 0 or x + reach > x1 < right
    return not (cut_x or y - reach < y0 > 0 or y + reach > y1 < bottom)
