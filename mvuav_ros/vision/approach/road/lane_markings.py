"""Pairs of painted lines that may be the two sides of a lane."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.approach.channels import Table
from mvuav_ros.vision.approach.road.strip import Shapes
from mvuav_ros.vision.approach.road.targets import Target

_HIGHEST, _LOWEST = 0.3, 0.72
"""Shares of the image's height between which the lines may meet: the camera looks ahead."""
_BESIDE = 6
"""Px: paint is brighter than what is so far to its left and to its right."""
_BRIGHTER = 12.0
_LEAST_VOTES = 14
_MOST_LINES, _MOST = 24, 12
_FLATTEST = 4.0
_SAME_PLACE, _SAME_SLOPE = 6.0, 0.15


def find_lanes(table: Table, target: Target) -> Shapes:
    """Candidates from pairs of painted lines of plausible widths and offsets, strongest first."""
    height, width = table.shape[1], table.shape[2] - 1
    lines = _painted_lines(table)
    found: list[tuple[float, tuple[float, float, float, float]]] = []
    for place_left, left, votes_left in lines:
        for place_right, right, votes_right in lines:
            ratio = right - left
            if not 0.7 * target.usual_widths[0] < ratio < target.widest:
                continue
            if abs(left + right) / 2 / ratio > target.farthest_aside:
                continue
            # Places are columns on the lowest row.
            depth = (place_right - place_left) / ratio
            row = height - 1 - depth
            column = place_left - left * depth
            if _HIGHEST * height < row < _LOWEST * height and 0 <= column < width:
                found.append((min(votes_left, votes_right), (column, row, left, right)))
    found.sort(key=lambda entry: -entry[0])
    return np.array([shape for _, shape in found[:_MOST]]).reshape(-1, 4)


def _painted_lines(table: Table) -> list[tuple[float, float, float]]:
    """Column on the lowest row, columns per row, and votes of lines; strongest first."""
    brightness = table[0, :, 1:] - table[0, :, :-1]
    height = brightness.shape[0]
    top = int(_HIGHEST * height)
    mask = _paint(brightness[top:])
    found = cv2.HoughLinesWithAccumulator(mask, 1.0, math.radians(1.5), _LEAST_VOTES)
    lines: list[tuple[float, float, float]] = []
    for rho, theta, votes in () if found is None else found.reshape(-1, 3)[:200]:
        cos, sin = math.cos(theta), math.sin(theta)
        if abs(sin) > _FLATTEST * abs(cos):
            continue
        slope = -sin / cos
        place = rho / cos + slope * (height - 1 - top)
        if any(
            abs(place - p) < _SAME_PLACE * (1 + abs(slope)) and abs(slope - s) < _SAME_SLOPE
            for p, s, _ in lines
        ):
            continue
        lines.append((float(place), float(slope), float(votes)))
        if len(lines) == _MOST_LINES:
            break
    return lines


def _paint(brightness: NDArray[np.float32]) -> NDArray[np.uint8]:
    """1 where a row has a narrow bright place."""
    mask = np.zeros(brightness.shape, np.uint8)
    inner = brightness[:, _BESIDE:-_BESIDE] - _BRIGHTER
    bright = (inner > brightness[:, : -2 * _BESIDE]) & (inner > brightness[:, 2 * _BESIDE :])
    mask[:, _BESIDE:-_BESIDE] = bright
    return mask
