"""Lights at sub-pixel places: saturated discs with a glow; reflections that look like them."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.frames import read_only
from mvuav_ros.vision.point_operations import Pixels

LARGEST_RADIUS = 6.4
"""px; a wider light would fall apart under the thesis's grouping distance of 15 px."""
TINT = (0.90, 0.97, 1.0)
"""Blue, green and red of the glow, which shows it only where it is not saturated."""
SOFTNESS = 1.2  # sigma of a disc's edge, px
PEAK, GLOW = 850.0, 55.0
"""Grey levels of a disc, well above 255, as of a light that overexposes the camera, and of the
bloom at its centre."""
GLOW_LENGTH = 5.0  # distance over which the bloom falls to 1/e, px
_STEPS_PER_PIXEL = 16
DRIFT = 6.0  # greatest way of a reflection from its middle, px
CLEAR = 45.0
"""Distance that it keeps from every marker's path and other reflections where there is room, px."""
_TRIES = 60


class Light(NamedTuple):
    """A light, which looks alike in all directions from its centre.

    What a pixel collects over its area is taken at the pixel's centre; with edges this soft its sum
    over the pixels keeps the light's centre to a thousandth of a pixel.
    """

    radius: float  # of the disc at half its peak, px
    path: NDArray[np.float64]  # of the centre during the exposure, (n, 2) px


def reach_of(radius: float) -> int:
    """Beyond this distance a light adds nothing, px."""
    return int(radius + 4.5 * GLOW_LENGTH)


def core_of(radius: float) -> float:
    """Radius that is saturated against a dark background, px."""
    return radius + 1.5 * SOFTNESS


def _levels_at(radius: float, distance: NDArray[np.float32]) -> NDArray[np.float32]:
    """Grey levels at distances in px."""
    levels = _levels(radius)
    place = distance * np.float32(_STEPS_PER_PIXEL)
    np.minimum(place, len(levels) - 2, out=place)
    left = place.astype(np.int32)
    place -= left
    value = levels.take(left)
    return value + place * (levels.take(left + 1) - value)


@lru_cache(maxsize=1024)
def _levels(radius: float) -> NDArray[np.float32]:
    """Grey levels at multiples of 1 / `_STEPS_PER_PIXEL` px; the same lights are drawn often."""
    r = np.arange(reach_of(radius) * _STEPS_PER_PIXEL + 2) / _STEPS_PER_PIXEL
    edge = (r - radius) / (math.sqrt(2.0) * SOFTNESS)
    disc = 0.5 * PEAK * np.array([math.erfc(x) for x in edge.tolist()])
    glow = GLOW * np.exp(-r / GLOW_LENGTH)
    # Down to zero at the window's edge, or its corners would show and pull the centroid.
    taper = np.clip(1.0 - (r / reach_of(radius)) ** 2, 0.0, None) ** 2
    return read_only(((disc + glow) * taper).astype(np.float32))


def add_lights(image: Pixels, lights: list[Light], gain: float = 1.0) -> None:
    """Add lights to an 8-bit image, in place.

    What lies right behind a light is evened out first, as by the glare in a real lens: a
    structure that came up to the light on one side would move its centroid. They may reach over
    the borders; the gain multiplies the light before it saturates.
    """
    windows = [_Window(image, light) for light in lights if np.isfinite(light.path).all()]
    for window in windows:
        window.even_out()
    for window in windows:
        window.add(gain)


class _Window:
    """The part of an image that one light reaches, perhaps none."""

    def __init__(self, image: Pixels, light: Light) -> None:
        self._light = light
        reach = reach_of(light.radius) + 1
        low = np.floor(light.path.min(axis=0)).astype(int) - reach
        high = np.ceil(light.path.max(axis=0)).astype(int) + reach + 1
        first = np.maximum(low, 0)
        last = np.maximum(np.minimum(high, image.shape[1::-1]), first)
        (x0, y0), (x1, y1) = first.tolist(), last.tolist()
        self._part = image[y0:y1, x0:x1]
        self._columns = np.arange(x0, x1, dtype=np.float32)
        self._rows = np.arange(y0, y1, dtype=np.float32)[:, None]

    def _distance(self, centre: NDArray[np.float64]) -> NDArray[np.float32]:
        dx = self._columns - np.float32(centre[0])
        dy = self._rows - np.float32(centre[1])
        return np.asarray(np.sqrt(dx * dx + dy * dy), np.float32)

    def even_out(self) -> None:
        distance = self._distance(self._light.path.mean(axis=0))
        share = np.clip((core_of(self._light.radius) + 5.0 - distance) / 4.0, 0.0, 1.0)
        if self._part.ndim == 3:
            share = share[:, :, None]
        total = float(share.sum())
        if total == 0.0:
            return
        mean = (self._part * share).sum(axis=(0, 1)) / total
        self._part[...] = np.rint(self._part + share * (mean - self._part)).astype(np.uint8)

    def add(self, gain: float) -> None:
        light = np.zeros((len(self._rows), len(self._columns)), np.float32)
        for centre in self._light.path:
            light += _levels_at(self._light.radius, self._distance(centre))
        light *= gain / len(self._light.path)
        if self._part.ndim == 3:
            light = light[:, :, None] * np.array(TINT, np.float32)
        # A response with a shoulder, as a camera's knee: a hard limit's edges are so steep that
        # pixels cannot show where within them the light lies.
        dark = np.exp(light * (-1.0 / 255.0))
        self._part[...] = np.rint(255.0 - (255.0 - self._part) * dark).astype(np.uint8)


def drifting_glares(
    count: int, camera: CameraModel, paths: NDArray[np.float64], rng: np.random.Generator
) -> Callable[[float], NDArray[np.float64]]:
    """Reflections that look like markers and drift slowly, clear of the markers' paths.

    Returns:
        Their places, (n, 2) px, by the time (s).
    """
    taken = paths[np.isfinite(paths).all(axis=1)]
    chosen: list[NDArray[np.float64]] = []
    low, high = np.array((20.0, 20.0)), np.array((camera.width, camera.height)) - 20.0
    for _ in range(count):
        best, best_room = low, -1.0
        for place in rng.uniform(low, high, (_TRIES, 2)):
            room = float(np.hypot(*(taken - place).T).min()) if len(taken) else math.inf
            if room > best_room:
                best, best_room = place, room
            if room >= CLEAR:
                break
        chosen.append(best)
        taken = np.vstack((taken, best))
    middles = np.array(chosen).reshape(-1, 2)
    phases = rng.uniform(0.0, 2 * math.pi, (count, 2))

    def places(time: float) -> NDArray[np.float64]:
        turn = 2 * math.pi * time / np.array((7.0, 9.0))
        return np.asarray(middles + DRIFT * np.sin(turn + phases), np.float64)

    return places
