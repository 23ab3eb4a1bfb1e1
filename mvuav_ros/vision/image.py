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

    ``luma`` is the channel that already is the intensity (the Y of YUV 4:2:2). With
    ``chroma_below`` the rows of intensity are followed by half as many of colour (YUV 4:2:0).
    """

    dtype: type[np.uint8] | type[np.uint16]
    channels: int
    to_gray: int | None = None
    to_bgr: int | None = None
    luma: int | None = None
    chroma_below: bool = False

    @property
    def pixel_bytes(self) -> int:
        """Bytes of one pixel."""
        return self.channels * np.dtype(self.dtype).itemsize


_GRAY8 = Encoding(np.uint8, 1, to_bgr=cv2.COLOR_GRAY2BGR)
_GRAY16 = Encoding(np.uint16, 1, to_bgr=cv2.COLOR_GRAY2BGR)
_UYVY = Encoding(np.uint8, 2, to_bgr=cv2.COLOR_YUV2BGR_UYVY, luma=1)
_YUYV = Encoding(np.uint8, 2, to_bgr=cv2.COLOR_YUV2BGR_YUY2, luma=0)


# OpenCV names a pattern by its second row and column, ROS by its first.
_BAYER = {
    'rggb': (cv2.COLOR_BayerBG2GRAY, cv2.COLOR_BayerBG2BGR),
    'bggr': (cv2.COLOR_BayerRG2GRAY, cv2.COLOR_BayerRG2BGR),
    'gbrg': (cv2.COLOR_BayerGR2GRAY, cv2.COLOR_BayerGR2BGR),
    'grbg': (cv2.COLOR_BayerGB2GRAY, cv2.COLOR_BayerGB2BGR),
}


def _color(name: str, channels: int, to_gray: int, to_bgr: int | None) -> dict[str, Encoding]:
    """An encoding of 8 bits, and that of 16."""
    return {
        f'{name}8': Encoding(np.uint8, channels, to_gray, to_bgr),
        f'{name}16': Encoding(np.uint16, channels, to_gray, to_bgr),
    }


ENCODINGS = {
    'mono8': _GRAY8,
    '8UC1': _GRAY8,
    'mono16': _GRAY16,
    '16UC1': _GRAY16,
    **_color('bgr', 3, cv2.COLOR_BGR2GRAY, None),
    **_color('rgb', 3, cv2.COLOR_RGB2GRAY, cv2.COLOR_RGB2BGR),
    **_color('bgra', 4, cv2.COLOR_BGRA2GRAY, cv2.COLOR_BGRA2BGR),
    **_color('rgba', 4, cv2.COLOR_RGBA2GRAY, cv2.COLOR_RGBA2BGR),
    '8UC3': Encoding(np.uint8, 3, cv2.COLOR_BGR2GRAY),
    '8UC4': Encoding(np.uint8, 4, cv2.COLOR_BGRA2GRAY, cv2.COLOR_BGRA2BGR),
    '16UC3': Encoding(np.uint16, 3, cv2.COLOR_BGR2GRAY),
    '16UC4': Encoding(np.uint16, 4, cv2.COLOR_BGRA2GRAY, cv2.COLOR_BGRA2BGR),
    'yuv422': _UYVY,
    'uyvy': _UYVY,
    'yuv422_yuy2': _YUYV,
    'yuyv': _YUYV,
    'nv12': Encoding(np.uint8, 1, to_bgr=cv2.COLOR_YUV2BGR_NV12, chroma_below=True),
    'nv21': Encoding(np.uint8, 1, to_bgr=cv2.COLOR_YUV2BGR_NV21, chroma_below=True),
}
for _pattern, _codes in _BAYER.items():
    ENCODINGS |= _color(f'bayer_{_pattern}', 1, *_codes)


@dataclass(frozen=True)
class Image:
    """Pixels and their sensor_msgs encoding.

    ``pixels`` is (height, width) or (height, width, channels), of the encoding's dtype; rows may
    be padded (strided views are welcome); of NV12 and NV21 it has height * 3 / 2 rows. Nothing
    here writes to it.
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
        if layout.chroma_below and (self.pixels.shape[0] % 3 or self.width % 2):
            raise ImageError(f'{self.encoding} needs an even width and height')

    @property
    def height(self) -> int:
        """Rows."""
        rows = int(self.pixels.shape[0])
        return rows * 2 // 3 if ENCODINGS[self.encoding].chroma_below else rows

    @property
    def width(self) -> int:
        """Columns."""
        return int(self.pixels.shape[1])

    @property
    def is_gray(self) -> bool:
        """Whether the pixels are intensities already."""
        layout = ENCODINGS[self.encoding]
        return layout.channels == 1 and layout.to_gray is None and not layout.chroma_below

    def gray(self) -> Pixels:
        """The intensity (eq. 3.3), (height, width) uint8 or uint16; a view where it can be."""
        return self._gray(self.pixels[: self.height])

    def gray_window(self, rows: slice, columns: slice) -> Pixels:
        """The intensity of a part of the frame at the cost of that part alone."""
        layout = ENCODINGS[self.encoding]
        if layout.channels == 1 and layout.to_gray is not None:
            # The colour of a mosaic's pixel comes from its neighbours: cut after the conversion.
            return self.gray()[rows, columns]
        return self._gray(self.pixels[: self.height][rows, columns])

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
