"""A frame as the tracks see it."""

from __future__ import annotations

from typing import Any, NamedTuple

from numpy.typing import NDArray

from mvuav_ros.vision.approach.edges import LevelledFrame
from mvuav_ros.vision.approach.registration import Registration
from mvuav_ros.vision.approach.runway.candidates import LevelledImage


class View(NamedTuple):
    """A frame as the tracks see it.

    Attributes:
        frame: the frame itself.
        pixels: its working image.
        working: that, levelled.
        horizon: row of the vanishing point and its standard deviation, if known, px.
        registration: of the working images.
    """

    frame: LevelledFrame
    pixels: NDArray[Any]
    working: LevelledImage
    horizon: tuple[float, float] | None
    registration: Registration
