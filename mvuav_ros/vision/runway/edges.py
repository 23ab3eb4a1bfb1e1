"""From a frame to the opened edge image (thesis eqs 3.3, 3.19-3.24)."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.point_operations import Mask, Pixels, full_scale

# float32 or float64.
Gradient = NDArray[np.floating[Any]]

# The sum of a Sobel kernel's positive and negative weights, by which MATLAB divides it.
_KERNEL_SUM = 8


def detect_edges(gray: Pixels, threshold: float = 0.0, *, thinning: bool = False) -> Mask:
    """Find edges with the Sobel kernels (eqs 3.19-3.21) as ``edge(gray, 'sobel')`` does.

    Args:
        gray: (height, width), uint8 or uint16, not empty; continued at the border by its
            outermost pixels.
        threshold: gradient above which a pixel is an edge, fraction of full scale with kernels
            divided by 8; 0: `automatic_threshold`.
        thinning: keep only pixels above both neighbours in the row or in the column, as Octave's
            ``edge`` does. A sharp step's gradient is two equal pixels wide: it vanishes, there too.

    Returns:
        (height, width) uint8, 1 at edges, else 0.
    """
    if thinning:
        return _thinned_edges(gray, threshold)
    squared = _squared_gradient(gray)
    if threshold > 0:
        limit = math.floor((threshold * _KERNEL_SUM * full_scale(gray)) ** 2)
    else:
        # Four times the mean, rounded down, which compares like the mean with whole numbers.
        # Python's integers keep it exact: an edge more or less would differ from the reference.
        limit = 4 * int(cv2.sumElems(squared)[0]) // squared.size
    return (squared > limit).view(np.uint8)


def automatic_threshold(gray: Pixels) -> float:
    """The threshold that MATLAB and Octave choose: twice the gradient's root mean square.

    It is a fraction of full scale, as in `detect_edges`.
    """
    total = cv2.sumElems(_squared_gradient(gray))[0]
    return math.sqrt(4 * total / gray.size) / (_KERNEL_SUM * full_scale(gray))


def open_edges(edges: Mask, shape: str, length: int) -> Mask:
    """Remove what the structuring element does not fit in: erosion, dilation (eqs 3.22-3.24).

    Outside the image is ignored: a run that touches the border is as long as its visible part.

    Args:
        edges: (height, width) uint8.
        shape: of the structuring element, one of `OPENING_SHAPES`.
        length: its height in rows, odd; 1: no opening.
    """
    if length == 1:
        return edges
    return cv2.morphologyEx(edges, cv2.MORPH_OPEN, structuring_element(shape, length))


@lru_cache(maxsize=8)
def structuring_element(shape: str, length: int) -> Mask:
    """The structuring elements of section 3.4.2.1: one of `OPENING_SHAPES`, of odd length in rows.

    Returns:
        (length, length) uint8, or (length, 1) of the line; 1 in the neighbourhood, else 0.
    """
    if shape == 'vertical_line':
        return np.ones((length, 1), np.uint8)
    reach = length // 2
    y, x = np.abs(np.mgrid[-reach : reach + 1, -reach : reach + 1])
    inside = {
        'square': np.ones_like(x, bool),
        # A radius half a pixel longer than the reach gives discs that look round.
        'disk': x * x + y * y <= (reach + 0.5) ** 2,
        'diamond': x + y <= reach,
    }[shape]
    return np.asarray(inside, np.uint8)


def _squared_gradient(gray: Pixels) -> Gradient:
    """Gx² + Gy² with the kernels undivided: whole numbers, exact in the type returned.

    8 bits give at most 2.1 million, below float32's 2^24; 16 bits need float64.
    """
    border = cv2.BORDER_REPLICATE
    if gray.dtype == np.uint8:
        squared = np.zeros(gray.shape, np.float32)
        for part in cv2.spatialGradient(gray, borderType=border):
            cv2.accumulateSquare(np.abs(part, out=part).view(np.uint16), squared)
        return squared
    across, down = (
        np.asarray(cv2.Sobel(gray, cv2.CV_64F, dx, dy, borderType=border))
        for dx, dy in ((1, 0), (0, 1))
    )
    np.multiply(across, across, out=across)
    np.multiply(down, down, out=down)
    return np.add(across, down, out=across)


def _thinned_edges(gray: Pixels, threshold: float) -> Mask:
    strength = _strength_in_octave(gray)
    limit = threshold**2 if threshold > 0 else 4 * strength.mean()
    strength[strength <= limit] = 0
    framed = cv2.copyMakeBorder(strength, 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=0)
    row, column = framed[1:-1], framed[:, 1:-1]
    maximum = (strength > row[:, :-2]) & (strength > row[:, 2:])
    maximum |= (strength > column[:-2]) & (strength > column[2:])
    return maximum.view(np.uint8)


def _strength_in_octave(gray: Pixels) -> NDArray[np.float64]:
    """The squared gradient, fraction of full scale squared, rounded as Octave's ``conv2`` does.

    Thinning compares neighbours. Where these are equal, Octave's rounding decides, which depends
    on the order of summation: columns from right to left, each from the bottom up.
    """
    height, width = gray.shape
    eighths = gray / full_scale(gray) * (1 / _KERNEL_SUM)
    p = cv2.copyMakeBorder(eighths, 1, 1, 1, 1, cv2.BORDER_REPLICATE)
    top, middle, bottom = p[:height], p[1 : height + 1], p[2:]
    left, centre, right = slice(0, width), slice(1, width + 1), slice(2, None)

    vertical = top[:, right] - bottom[:, right]
    vertical -= 2 * bottom[:, centre]
    vertical += 2 * top[:, centre]
    vertical -= bottom[:, left]
    vertical += top[:, left]

    horizontal = -bottom[:, right] - 2 * middle[:, right]
    horizontal -= top[:, right]
    horizontal += bottom[:, left]
    horizontal += 2 * middle[:, left]
    horizontal += top[:, left]
    return vertical * vertical + horizontal * horizontal
