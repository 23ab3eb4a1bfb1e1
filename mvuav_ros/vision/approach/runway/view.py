"""A frame as the tracks see it."""

from __future__ import annotations

from typing import Any, NamedTuple

from numpy.typing import NDArray

from mvuav_ros.vision.approach.derotation import Derotation
from mvuav_ros.vision.approach.registration import Registration
from mvuav_ros.vision.approach.runway.candidates import LevelledImage


class View(NamedTuple):
    """A frame as the tracks see it.

    Attributes:
        image: the frame, (height, width) or (height, width, 3), blue first.
        pixels: its working image.
        working: that, levelled.
        level: of the frame.
        horizon: row of the vanishing point and its standard deviation, if known, px.
        registration: of the working images.
    """

    image: NDArray[Any]
    pixels: NDArray[Any]
    working: LevelledImage
    level: Derotation
    horizon: tuple[float, float] | None
    registration: Registration
