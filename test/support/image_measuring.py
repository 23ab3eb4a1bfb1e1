"""Measures images independently of the code that drew them."""

import numpy as np
from scipy.ndimage import map_coordinates


def weighted_centroid(gray, x, y, radius=12):
    """Centroid (px) of what is brighter than the window's border, around a rough place."""
    x0, y0 = round(x) - radius, round(y) - radius
    window = gray[y0 : y0 + 2 * radius + 1, x0 : x0 + 2 * radius + 1].astype(float)
    border = np.r_[window[0], window[-1], window[:, 0], window[:, -1]]
    weights = np.clip(window - np.median(border) - 15.0, 0.0, None)
    rows, columns = np.mgrid[0 : window.shape[0], 0 : window.shape[1]]
    total = weights.sum()
    return x0 + (weights * columns).sum() / total, y0 + (weights * rows).sum() / total


def edge_offsets(gray, line, inside, samples=40, reach=2.5):
    """How far the image's steepest rise lies from a line, px, at places along the line.

    ``inside`` is a point on the bright side; only places well within the frame count.
    """
    gray = gray.astype(float)
    normal = np.array([np.cos(line.theta), np.sin(line.theta)])
    normal *= np.sign(np.dot(inside, normal) - line.rho)
    steps = np.arange(-reach, reach + 0.01, 0.1)
    offsets = []
    for part in np.linspace(0.03, 0.97, samples):
        place = np.array([line.x1, line.y1]) * (1 - part) + np.array([line.x2, line.y2]) * part
        if not np.all((place > 6) & (place < np.array(gray.shape[::-1]) - 7)):
            continue
        profile = map_coordinates(
            gray, [place[1] + steps * normal[1], place[0] + steps * normal[0]], order=1
        )
        rise = np.clip(np.diff(profile), 0.0, None)
        middle = 0.5 * (steps[1:] + steps[:-1])
        near = np.abs(middle - middle[rise.argmax()]) < 1.2
        offsets.append((rise * near * middle).sum() / (rise * near).sum())
    return np.array(offsets)
