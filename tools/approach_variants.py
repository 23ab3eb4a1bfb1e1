"""Changed copies of a labelled flight, as like it as another flight of its kind would be.

A decision on a knife's edge is right or wrong by chance; over such copies it shows as what it is.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.offline.evaluation.corners import LabelledFrame
from mvuav_ros.vision.approach.attitude import HorizonLine

Pixels = NDArray[Any]


@dataclass(frozen=True)
class Variant:
    """What is changed, in this order.

    Attributes:
        name: for the table.
        skip: frames left out at the beginning.
        crop: columns and rows cut off at the left and the top; at the right and the bottom where
            negative.
        gamma: exponent of brightness.
        gain: factor of brightness.
        noise: standard deviation, grey levels.
        jpeg: quality; 0 leaves the images alone.
        mirrored: left and right are exchanged.
    """

    name: str
    skip: int = 0
    crop: tuple[int, int] = (0, 0)
    gamma: float = 1.0
    gain: float = 1.0
    noise: float = 0.0
    jpeg: int = 0
    mirrored: bool = False

    def image(self, pixels: Pixels, index: int) -> Pixels:
        """A frame, (height, width) or (height, width, 3) uint8; ``index`` seeds its noise."""
        columns, rows = (slice(max(cut, 0), cut if cut < 0 else None) for cut in self.crop)
        pixels = np.ascontiguousarray(pixels[rows, columns])
        if self.gamma != 1.0 or self.gain != 1.0:
            levels = 255.0 * self.gain * (np.arange(256) / 255.0) ** self.gamma
            pixels = cv2.LUT(pixels, np.clip(levels, 0, 255).round().astype(np.uint8))
        if self.noise:
            noise = np.random.default_rng(index).normal(0.0, self.noise, pixels.shape)
            pixels = np.clip(pixels + noise, 0, 255).round().astype(np.uint8)
        if self.jpeg:
            coded = cv2.imencode('.jpg', pixels, [cv2.IMWRITE_JPEG_QUALITY, self.jpeg])[1]
            pixels = np.asarray(cv2.imdecode(coded, cv2.IMREAD_UNCHANGED))
        return np.ascontiguousarray(pixels[:, ::-1]) if self.mirrored else pixels

    def label(self, label: LabelledFrame, width: int) -> LabelledFrame:
        """Labels on the changed frame; ``width`` is the frame's own, px."""
        cut, down = (max(each, 0) for each in self.crop)
        kept = width - abs(self.crop[0])
        corners = [
            (kept - 1 - (x - cut) if self.mirrored else x - cut, y - down)
            for x, y in (label.near_left, label.near_right, label.far_right, label.far_left)
        ]
        if self.mirrored:
            corners = [corners[number] for number in (1, 0, 3, 2)]
        return LabelledFrame(label.file, *corners)

    def horizon(self, line: HorizonLine | None, width: int) -> HorizonLine | None:
        """The horizon on the changed frame."""
        if line is None:
            return None
        cut, down = (max(each, 0) for each in self.crop)
        # At the middle of the frame, which the crop moves.
        moved = cut + 0.5 * (width - abs(self.crop[0])) - 0.5 * width
        row = line.row + moved * float(np.tan(line.slope)) - down
        return replace(line, row=row, slope=-line.slope if self.mirrored else line.slope)


PLAIN = Variant('as it is')
VARIANTS = (
    PLAIN,
    Variant('from frame 14', skip=13),
    Variant('from frame 61', skip=60),
    Variant('cropped left, top', crop=(1, 2)),
    Variant('cropped right, bottom', crop=(-2, -1)),
    Variant('gamma 0.75', gamma=0.75),
    Variant('gamma 1.3', gamma=1.3),
    Variant('darker', gain=0.75),
    Variant('noise 2', noise=2.0),
    Variant('noise 4', noise=4.0),
    Variant('JPEG 70', jpeg=70),
    Variant('mirrored', mirrored=True),
    Variant('mirrored, JPEG 70', jpeg=70, mirrored=True),
)
