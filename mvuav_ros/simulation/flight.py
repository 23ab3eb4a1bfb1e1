"""What all synthetic flights have in common: time, dropped frames, the camera's sensor."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property
from typing import Generic, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.simulation.settings import FlightSettings
from mvuav_ros.simulation.shake import VIBRATIONS, Shake
from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.image import Image
from mvuav_ros.vision.point_operations import Pixels

_POOL_EXTRA = 1 << 17
STEP_SECONDS = 2.5  # mean time between two steps of the gain


def gain_steps(
    amplitude: float, duration: float, rng: np.random.Generator
) -> Callable[[float], float]:
    """An automatic gain that jumps from one value to the next, by the time (s)."""
    starts, gains = [0.0], [1.0]
    while amplitude and starts[-1] < duration:
        starts.append(starts[-1] + float(rng.uniform(0.4, 1.6)) * STEP_SECONDS)
        gains.append(1.0 + amplitude * float(rng.uniform(-1.0, 1.0)))
    return lambda time: gains[int(np.searchsorted(starts, time, side='right')) - 1]


def apply_gain(image: Pixels, gain: float) -> Pixels:
    """Multiply and saturate; the image itself where the gain is 1."""
    if gain == 1.0:
        return image
    return cv2.convertScaleAbs(image, alpha=gain)


def motion_blur(image: Pixels, dx: float, dy: float) -> Pixels:
    """Smear an image along a straight path of (dx, dy) px, centred; the image itself if short.

    A path that is longer than the image, as right beside the camera, is cut to its length.
    """
    length = math.hypot(dx, dy)
    if length < 0.5:
        return image
    part = min(1.0, max(image.shape[:2]) / length)
    dx, dy, length = part * dx, part * dy, part * length
    half = math.ceil(0.5 * max(abs(dx), abs(dy)) + 0.5)
    kernel = np.zeros((2 * half + 1, 2 * half + 1), np.float32)
    for part in np.linspace(-0.5, 0.5, 4 * math.ceil(length) + 1):
        x, y = half + part * dx, half + part * dy
        column, row = math.floor(x), math.floor(y)
        fx, fy = x - column, y - row
        for r, wy in ((row, 1.0 - fy), (row + 1, fy)):
            for c, wx in ((column, 1.0 - fx), (column + 1, fx)):
                kernel[r, c] += wx * wy
    kernel /= kernel.sum()
    return cv2.filter2D(image, -1, kernel, borderType=cv2.BORDER_REPLICATE)


START_NS = 1_700_000_000_000_000_000
"""Stamp of the first frame; fixed, because a flight must not depend on the clock."""

TruthT = TypeVar('TruthT')


class RandomStream(IntEnum):
    """Independent sequences of random numbers of one seed."""

    DROPS = 1
    SHAKE = 2
    MOTION = 3
    BACKGROUND = 4
    GAIN = 5
    NOISE_POOL = 6
    NOISE = 7
    HOT_PIXELS = 8
    GLARES = 9


@dataclass(frozen=True, eq=False)
class SimulatedFrame(Generic[TruthT]):
    """One image, its time (ns) and what is true of it."""

    stamp_ns: int
    image: Image
    truth: TruthT


class Flight(ABC, Generic[TruthT]):
    """A sequence of frames that depends on the settings alone.

    Iterating again starts again and gives the same frames, bit for bit. Every frame is a
    function of its index, so that `frame` may be called in any order.
    """

    def __init__(
        self, settings: FlightSettings, camera: CameraModel, encoding: str = 'bgr8'
    ) -> None:
        self.camera, self.encoding = camera, encoding
        self.settings = settings
        vibration = VIBRATIONS[settings.shake]
        self._shake = Shake(vibration, settings.shake_gain, self._rng(RandomStream.SHAKE))
        self._gain = gain_steps(settings.gain_steps, self.duration, self._rng(RandomStream.GAIN))
        draws = self._rng(RandomStream.DROPS).random(settings.frames)
        # The indices of the frames that are not dropped.
        self.indices: list[int] = np.flatnonzero(draws >= settings.drop_probability).tolist()

    @property
    def rate(self) -> float:
        """Frames per second before drops."""
        return self.settings.fps

    @property
    def duration(self) -> float:
        """From the first frame to one frame after the last, s."""
        return self.settings.frames / self.settings.fps

    def __len__(self) -> int:
        return len(self.indices)

    def __iter__(self) -> Iterator[SimulatedFrame[TruthT]]:
        for index in self.indices:
            yield self.frame(index)

    def time(self, index: int) -> float:
        """When frame ``index`` is taken, s since the start."""
        return index / self.settings.fps

    def stamp_ns(self, index: int) -> int:
        """Stamp of frame ``index``, ns."""
        return START_NS + round(index * 1e9 / self.settings.fps)

    def seen_at(self, index: int) -> float:
        """The time that frame ``index`` shows, s: its own, or earlier while the camera hangs."""
        rate = self.settings.camera_rate
        if rate == 0.0:
            return self.time(index)
        # A hair more, because index / fps x rate falls just short of whole numbers.
        return math.floor(self.time(index) * rate + 1e-6) / rate

    def truth(self, index: int) -> TruthT:
        """What frame ``index`` shows, without drawing it."""
        return self.truth_at(self.seen_at(index))

    def frame(self, index: int) -> SimulatedFrame[TruthT]:
        """Draw frame ``index``, dropped or not."""
        time = self.seen_at(index)
        truth = self.truth_at(time)
        pixels = self._exposed(self._draw(truth, time), time)
        return SimulatedFrame(self.stamp_ns(index), Image(pixels, self.encoding), truth)

    @abstractmethod
    def truth_at(self, time: float) -> TruthT:
        """What is true at any time (s)."""

    @abstractmethod
    def _draw(self, truth: TruthT, time: float) -> Pixels:
        """The image at a time (s) before the lens's blur and the sensor."""

    def _exposed(self, pixels: Pixels, time: float) -> Pixels:
        """An image with the lens's blur and the sensor's faults; may be the same array."""
        settings = self.settings
        if settings.blur > 0.0:
            border = cv2.BORDER_REPLICATE
            pixels = cv2.GaussianBlur(pixels, (0, 0), settings.blur, borderType=border)
        if settings.noise > 0.0:
            # By the time shown, so that a camera that hangs repeats its image bit for bit.
            rng = self._rng(RandomStream.NOISE, round(time * 1e6))
            start = int(rng.integers(_POOL_EXTRA))
            brighter, darker = (
                pool[start : start + pixels.size].reshape(pixels.shape) for pool in self._noise
            )
            # Two saturating additions of bytes are ten times as fast as one of mixed types.
            cv2.subtract(cv2.add(pixels, brighter, dst=pixels), darker, dst=pixels)
        pixels[self._hot_pixels] = 255
        return pixels

    @cached_property
    def _noise(self) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
        """Gaussian noise of whole grey levels, upwards and downwards; each frame takes a part.

        Drawing a million normal numbers would take longer than the image itself.
        """
        size = self.camera.width * self.camera.height * (3 if self.encoding == 'bgr8' else 1)
        rng = self._rng(RandomStream.NOISE_POOL)
        normal = rng.standard_normal(size + _POOL_EXTRA, np.float32)
        noise = np.clip(np.rint(self.settings.noise * normal), -255, 255).astype(np.int16)
        return np.maximum(noise, 0).astype(np.uint8), np.maximum(-noise, 0).astype(np.uint8)

    @cached_property
    def _hot_pixels(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Rows and columns of pixels that are always white."""
        pixels = self.camera.width * self.camera.height
        count = min(self.settings.hot_pixels, pixels)
        chosen = self._rng(RandomStream.HOT_PIXELS).choice(pixels, count, replace=False)
        return np.divmod(chosen, self.camera.width)

    def _rng(self, stream: RandomStream, *index: int) -> np.random.Generator:
        return np.random.default_rng((self.settings.seed, stream, *index))
