"""What all synthetic flights have in common: time, dropped frames, iteration."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.simulation.camera import PinholeCamera
from mvuav_ros.simulation.exposure import SensorNoise, defocus, gain_steps, hot_pixels
from mvuav_ros.simulation.settings import FlightSettings
from mvuav_ros.simulation.shake import VIBRATIONS, Shake
from mvuav_ros.vision.image import Image
from mvuav_ros.vision.point_operations import Pixels

START_NS = 1_700_000_000_000_000_000
"""Stamp of the first frame; fixed, because a flight must not depend on the clock."""

TruthT = TypeVar('TruthT')


class Stream(IntEnum):
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

    Attributes:
        camera: that takes the images.
    """

    def __init__(self, settings: FlightSettings, camera: PinholeCamera) -> None:
        self.camera = camera
        self._basics = settings
        self._noise: SensorNoise | None = None
        self._shake = Shake(
            VIBRATIONS[settings.shake], settings.shake_gain, self._rng(Stream.SHAKE)
        )
        self._gain = gain_steps(settings.gain_steps, self.duration, self._rng(Stream.GAIN))
        draws = self._rng(Stream.DROPS).random(settings.frames)
        self._kept: NDArray[np.intp] = np.flatnonzero(draws >= settings.drop_probability)

    @property
    def rate(self) -> float:
        """Frames per second before drops."""
        return self._basics.fps

    @property
    def duration(self) -> float:
        """From the first frame to one frame after the last, s."""
        return self._basics.frames / self._basics.fps

    @property
    def indices(self) -> list[int]:
        """The indices of the frames that are not dropped."""
        return [int(index) for index in self._kept]

    def __len__(self) -> int:
        return len(self._kept)

    def __iter__(self) -> Iterator[SimulatedFrame[TruthT]]:
        for index in self.indices:
            yield self.frame(index)

    def time(self, index: int) -> float:
        """When frame ``index`` is taken, s since the start."""
        return index / self._basics.fps

    def stamp_ns(self, index: int) -> int:
        """Stamp of frame ``index``, ns."""
        return START_NS + round(index * 1e9 / self._basics.fps)

    def seen_at(self, index: int) -> float:
        """The time that frame ``index`` shows, s: its own, or earlier while the camera hangs."""
        rate = self._basics.camera_rate
        if rate == 0.0:
            return self.time(index)
        # A hair more, because index / fps x rate falls just short of whole numbers.
        return math.floor(self.time(index) * rate + 1e-6) / rate

    def truth(self, index: int) -> TruthT:
        """What frame ``index`` shows, without drawing it."""
        return self.truth_at(self.seen_at(index))

    @abstractmethod
    def frame(self, index: int) -> SimulatedFrame[TruthT]:
        """Draw frame ``index``, dropped or not."""

    @abstractmethod
    def truth_at(self, time: float) -> TruthT:
        """What is true at any time (s)."""

    def _exposed(self, pixels: Pixels, time: float) -> Pixels:
        """An image with the lens's blur and the sensor's faults; may be the same array."""
        settings = self._basics
        pixels = defocus(pixels, settings.blur)
        if settings.noise > 0.0:
            if self._noise is None:
                rng = self._rng(Stream.NOISE_POOL)
                self._noise = SensorNoise(pixels.size, settings.noise, rng)
            # By the time shown, so that a camera that hangs repeats its image bit for bit.
            self._noise.add(pixels, self._rng(Stream.NOISE, round(time * 1e6)))
        pixels[self._hot_pixels] = 255
        return pixels

    @cached_property
    def _hot_pixels(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        size = self.camera.width, self.camera.height
        return hot_pixels(*size, self._basics.hot_pixels, self._rng(Stream.HOT_PIXELS))

    def _rng(self, stream: Stream, *index: int) -> np.random.Generator:
        return np.random.default_rng((self._basics.seed, stream, *index))
