"""A camera frame's pixels with the name of their layout, and their grey and colour views."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.point_operations import Pixels


class ImageError(ValueError):
    """An image that cannot be used, with the reason."""


@dataclass(frozen=True)
class Encoding:
    """How pixels of one sensor_msgs encoding lie in memory, and OpenCV's conversions from it.

    ``luma`` is the channel that already is the intensity (the Y of YUV 4:2:2).
    """

    dtype: type[np.uint8] | type[np.uint16]
    channels: int
    to_gray: int | None = None
    to_bgr: int | None = None
    luma: int | None = None

    @property
    def pixel_bytes(self) -> int:
        """Bytes of one pixel."""
        return self.channels * np.dtype(self.dtype).itemsize


_GRAY8 = Encoding(np.uint8, 1, to_bgr=cv2.COLOR_GRAY2BGR)
_GRAY16 = Encoding(np.uint16, 1, to_bgr=cv2.COLOR_GRAY2BGR)
_BGR8 = Encoding(np.uint8, 3, to_gray=cv2.COLOR_BGR2GRAY)
_UYVY = Encoding(np.uint8, 2, to_bgr=cv2.COLOR_YUV2BGR_UYVY, luma=1)
_YUYV = Encoding(np.uint8, 2, to_bgr=cv2.COLOR_YUV2BGR_YUY2, luma=0)


def _bayer(to_gray: int, to_bgr: int) -> Encoding:
    return Encoding(np.uint8, 1, to_gray=to_gray, to_bgr=to_bgr)


ENCODINGS = {
    'mono8': _GRAY8,
    '8UC1': _GRAY8,
    'mono16': _GRAY16,
    '16UC1': _GRAY16,
    'bgr8': _BGR8,
    '8UC3': _BGR8,
    'rgb8': Encoding(np.uint8, 3, cv2.COLOR_RGB2GRAY, cv2.COLOR_RGB2BGR),
    'bgra8': Encoding(np.uint8, 4, cv2.COLOR_BGRA2GRAY, cv2.COLOR_BGRA2BGR),
    'rgba8': Encoding(np.uint8, 4, cv2.COLOR_RGBA2GRAY, cv2.COLOR_RGBA2BGR),
    'yuv422': _UYVY,
    'uyvy': _UYVY,
    'yuv422_yuy2': _YUYV,
    'yuyv': _YUYV,
    # OpenCV names a pattern by its second row and column, ROS by its first.
    'bayer_rggb8': _bayer(cv2.COLOR_BayerBG2GRAY, cv2.COLOR_BayerBG2BGR),
    'bayer_bggr8': _bayer(cv2.COLOR_BayerRG2GRAY, cv2.COLOR_BayerRG2BGR),
    'bayer_gbrg8': _bayer(cv2.COLOR_BayerGR2GRAY, cv2.COLOR_BayerGR2BGR),
    'bayer_grbg8': _bayer(cv2.COLOR_BayerGB2GRAY, cv2.COLOR_BayerGB2BGR),
}


@dataclass(frozen=True, eq=False)
class Image:
    """Pixels and their sensor_msgs encoding.

    ``pixels`` is (height, width) or (height, width, channels), of the encoding's dtype; rows may
    be padded (strided views are welcome). Nothing here writes to it.

    Raises:
        ImageError: the encoding is unknown, the pixels do not fit it, or there are none.

    Example:
        >>> import numpy as np
        >>> from mvuav_ros import Image
        >>> image = Image(np.full((2, 3, 3), (255, 0, 0), np.uint8), 'bgr8')
        >>> image.width, image.height, int(image.gray()[0, 0])
        (3, 2, 29)
    """

    pixels: Pixels
    encoding: str

    def __post_init__(self) -> None:
        layout = ENCODINGS.get(self.encoding)
        if layout is None:
            raise ImageError(f'unknown encoding {self.encoding!r}')
        channels = self.pixels.shape[2] if self.pixels.ndim == 3 else 1
        if (
            self.pixels.ndim not in (2, 3)
            or channels != layout.channels
            or self.pixels.dtype != layout.dtype
        ):
            raise ImageError(
                f'{self.encoding} pixels cannot have shape {self.pixels.shape} '
                f'and type {self.pixels.dtype}'
            )
        if self.pixels.size == 0:
            raise ImageError(f'the image is empty ({self.width} x {self.height})')

    @property
    def height(self) -> int:
        """Rows."""
        return int(self.pixels.shape[0])

    @property
    def width(self) -> int:
        """Columns."""
        return int(self.pixels.shape[1])

    @property
    def is_gray(self) -> bool:
        """Whether the pixels are intensities already."""
        layout = ENCODINGS[self.encoding]
        return layout.channels == 1 and layout.to_gray is None

    def gray(self) -> Pixels:
        """The intensity (eq. 3.3), (height, width) uint8 or uint16; a view where it can be."""
        return self._gray(self.pixels)

    def gray_window(self, rows: slice, columns: slice) -> Pixels:
        """The intensity of a part of the frame at the cost of that part alone."""
        layout = ENCODINGS[self.encoding]
        if layout.channels == 1 and layout.to_gray is not None:
            # The colour of a mosaic's pixel comes from its neighbours: cut after the conversion.
            return self.gray()[rows, columns]
        return self._gray(self.pixels[rows, columns])

    def bgr(self) -> NDArray[np.uint8]:
        """The image in colour, (height, width, 3) uint8, blue first.

        A view where it can be; 16 bits are cut to the upper 8.
        """
        layout = ENCODINGS[self.encoding]
        pixels = self.pixels
        if pixels.dtype == np.uint16:
            pixels = (pixels >> 8).astype(np.uint8)
        if layout.to_bgr is None:
            return pixels
        return self._convert(pixels, layout.to_bgr)

    def _gray(self, pixels: Pixels) -> Pixels:
        layout = ENCODINGS[self.encoding]
        if layout.luma is not None:
            return pixels[:, :, layout.luma]
        if layout.to_gray is None or pixels.size == 0:
            return pixels if pixels.ndim == 2 else pixels[:, :, 0]
        return self._convert(pixels, layout.to_gray)

    def _convert(self, pixels: Pixels, code: int) -> Pixels:
        try:
            return cv2.cvtColor(pixels, code)
        except cv2.error as error:
            raise ImageError(
                f'{self.encoding} of {self.width} x {self.height} does not convert: {error.err}'
            ) from error
