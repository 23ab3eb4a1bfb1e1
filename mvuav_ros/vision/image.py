"""A camera frame's pixels with the name of their layout, and their grey and colour views."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.point_operations import (
    BLUE_FIRST,
    RED_FIRST,
    Pixels,
    gamma_correct,
    select_channel,
)

CHANNELS = ('brightest', 'intensity', 'red', 'green', 'blue')
"""What a colour image can be looked at in: its intensity (eq. 3.3), one of its colours, or in each
pixel the strongest of the three."""


class ImageError(ValueError):
    """An image that cannot be used, with the reason."""


@dataclass(frozen=True)
class Encoding:
    """How pixels of one sensor_msgs encoding lie in memory, and OpenCV's conversions from it."""

    dtype: type[np.uint8] | type[np.uint16]
    channels: int
    to_gray: int | None = None
    to_bgr: int | None = None
    luma: int | None = None  # channel that already is the intensity (the Y of YUV 4:2:2)
    colors: tuple[int, int, int] | None = None  # places of blue, green, red in a pixel of all three
    chroma_below: bool = False  # half as many rows of colour follow those of intensity (YUV 4:2:0)

    @property
    def pixel_bytes(self) -> int:
        """Bytes of one pixel."""
        return self.channels * np.dtype(self.dtype).itemsize


_GRAY8 = Encoding(np.uint8, 1, to_bgr=cv2.COLOR_GRAY2BGR)
_GRAY16 = Encoding(np.uint16, 1, to_bgr=cv2.COLOR_GRAY2BGR)
_UYVY = Encoding(np.uint8, 2, to_bgr=cv2.COLOR_YUV2BGR_UYVY, luma=1)
_YUYV = Encoding(np.uint8, 2, to_bgr=cv2.COLOR_YUV2BGR_YUY2, luma=0)


_BGR: tuple[Any, ...] = (3, cv2.COLOR_BGR2GRAY, None, None, BLUE_FIRST)
_BGRA: tuple[Any, ...] = (4, cv2.COLOR_BGRA2GRAY, cv2.COLOR_BGRA2BGR, None, BLUE_FIRST)
_COLORS: dict[str, tuple[Any, ...]] = {
    'bgr': _BGR,
    'rgb': (3, cv2.COLOR_RGB2GRAY, cv2.COLOR_RGB2BGR, None, RED_FIRST),
    'bgra': _BGRA,
    'rgba': (4, cv2.COLOR_RGBA2GRAY, cv2.COLOR_RGBA2BGR, None, RED_FIRST),
    # OpenCV names a pattern by its second row and column, ROS by its first.
    'bayer_rggb': (1, cv2.COLOR_BayerBG2GRAY, cv2.COLOR_BayerBG2BGR),
    'bayer_bggr': (1, cv2.COLOR_BayerRG2GRAY, cv2.COLOR_BayerRG2BGR),
    'bayer_gbrg': (1, cv2.COLOR_BayerGR2GRAY, cv2.COLOR_BayerGR2BGR),
    'bayer_grbg': (1, cv2.COLOR_BayerGB2GRAY, cv2.COLOR_BayerGB2BGR),
}
ENCODINGS = {
    'mono8': _GRAY8,
    '8UC1': _GRAY8,
    'mono16': _GRAY16,
    '16UC1': _GRAY16,
    **{f'{name}8': Encoding(np.uint8, *rest) for name, rest in _COLORS.items()},
    **{f'{name}16': Encoding(np.uint16, *rest) for name, rest in _COLORS.items()},
    '8UC3': Encoding(np.uint8, *_BGR),
    '8UC4': Encoding(np.uint8, *_BGRA),
    '16UC3': Encoding(np.uint16, *_BGR),
    '16UC4': Encoding(np.uint16, *_BGRA),
    'yuv422': _UYVY,
    'uyvy': _UYVY,
    'yuv422_yuy2': _YUYV,
    'yuyv': _YUYV,
    'nv12': Encoding(np.uint8, 1, to_bgr=cv2.COLOR_YUV2BGR_NV12, chroma_below=True),
    'nv21': Encoding(np.uint8, 1, to_bgr=cv2.COLOR_YUV2BGR_NV21, chroma_below=True),
}


@dataclass(frozen=True, eq=False)
class Image:
    """Pixels and their sensor_msgs encoding.

    ``pixels`` is (height, width) or (height, width, channels), of the encoding's dtype; rows may
    be padded (strided views are welcome). Nothing here writes to it. ``channel`` is what `gray` and
    `gray_window` give of a colour image (one of `CHANNELS`); a grey one has only its intensity.
    NV12 and NV21 have height * 3 / 2 rows of pixels.

    Raises:
        ImageError: the encoding or the channel is unknown, the pixels do not fit, have a mask, or
            there are none.

    Examples:
        >>> import numpy as np
        >>> from mvuav_ros import Image
        >>> image = Image(np.full((2, 3, 3), (255, 0, 0), np.uint8), 'bgr8')
        >>> image.width, image.height, int(image.gray()[0, 0])
        (3, 2, 29)
    """

    pixels: Pixels
    encoding: str
    channel: str = 'intensity'

    def __post_init__(self) -> None:
        layout = ENCODINGS.get(self.encoding)
        if layout is None:
            raise ImageError(f'unknown encoding {self.encoding!r}')
        if self.channel not in CHANNELS:
            raise ImageError(f'channel is one of {", ".join(CHANNELS)}, not {self.channel!r}')
        object.__setattr__(self, 'pixels', _plain(self.pixels))
        plane = () if layout.channels == 1 else (layout.channels,)
        if (
            self.pixels.ndim < 2
            or self.pixels.shape[2:] != plane
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

    def seen_in(self, channel: str) -> Image:
        """The same image, looked at in another channel; its pixels are not copied."""
        if channel == self.channel or self.is_gray:
            return self
        return replace(self, channel=channel)

    def gamma_corrected(self, gamma: float) -> Image:
        """The image with out = in ** gamma on each value (eq. 3.2); 1 gives the image itself.

        Of brightness and colour differences (YUV, NV12) that is done to the colours that they give.

        Raises:
            ValueError: gamma is not a positive number.
        """
        if gamma == 1.0:
            return self
        layout = ENCODINGS[self.encoding]
        if layout.luma is not None or layout.chroma_below:
            return Image(gamma_correct(self.bgr(), gamma), 'bgr8', self.channel)
        return replace(self, pixels=gamma_correct(self.pixels, gamma))

    def gray(self) -> Pixels:
        """The channel, (height, width) uint8 or uint16; a view where it can be."""
        has_more = ENCODINGS[self.encoding].chroma_below and self.channel == 'intensity'
        return self._gray(self.pixels[: self.height] if has_more else self.pixels)

    def gray_window(self, rows: slice, columns: slice) -> Pixels:
        """The channel in a part of the frame, given by its ends, at the cost of that part alone."""
        layout, pixels = ENCODINGS[self.encoding], self.pixels
        is_mosaic = layout.to_gray is not None and layout.channels == 1
        is_yuv = layout.luma is not None or layout.chroma_below
        if not (is_mosaic or (is_yuv and self.channel != 'intensity')):
            return self._gray(pixels[rows, columns])
        # Pixels have their colour from neighbours, or share it in pairs: some of these as well.
        top, bottom = _around(rows, self.height)
        left, right = _around(columns, self.width)
        part = pixels[top:bottom, left:right]
        if layout.chroma_below:
            below = slice(self.height + top // 2, self.height + bottom // 2)
            part = np.concatenate((part, pixels[below, left:right]))
        part = self._gray(part)
        return part[rows.start - top : rows.stop - top, columns.start - left : columns.stop - left]

    def bgr(self) -> NDArray[np.uint8]:
        """The image in colour, (height, width, 3) uint8, blue first.

        A view where it can be; 16 bits are cut to the upper 8.
        """
        return np.asarray(self.in_colour(), np.uint8)

    def in_colour(self, *, all_bits: bool = False) -> Pixels:
        """As `bgr`; an image of 16 bits keeps them where ``all_bits`` are asked for."""
        layout = ENCODINGS[self.encoding]
        pixels = self.pixels
        if pixels.dtype == np.uint16 and not all_bits:
            pixels = (pixels >> 8).astype(np.uint8)
        if layout.to_bgr is None:
            return pixels
        return self._convert(pixels, layout.to_bgr)

    def _gray(self, pixels: Pixels) -> Pixels:
        layout = ENCODINGS[self.encoding]
        if self.channel != 'intensity' and not self.is_gray and pixels.size:
            if layout.colors is not None:
                return select_channel(pixels, self.channel, layout.colors)
            assert layout.to_bgr is not None
            return select_channel(self._convert(pixels, layout.to_bgr), self.channel)
        if layout.luma is not None:
            return pixels[:, :, layout.luma]
        if layout.to_gray is None or pixels.size == 0:
            return pixels
        return self._convert(pixels, layout.to_gray)

    def _convert(self, pixels: Pixels, code: int) -> Pixels:
        # OpenCV 4.6 makes up colours for the pixel without a partner.
        if ENCODINGS[self.encoding].luma is not None and pixels.shape[1] % 2:
            raise self._unconvertible('two pixels share a colour, and the width is odd')
        try:
            return cv2.cvtColor(pixels, code)
        except cv2.error as error:
            raise self._unconvertible(error.err) from error

    def _unconvertible(self, why: str) -> ImageError:
        size = f'{self.width} x {self.height}'
        return ImageError(f'{self.encoding} of {size} does not convert: {why}')


def _around(part: slice, size: int) -> tuple[int, int]:
    """Bounds of a part with two pixels on either side, in whole pairs, of so many."""
    return max(part.start - part.start % 2 - 2, 0), min(part.stop + part.stop % 2 + 2, size)


def as_image(given: Image | Pixels) -> Image:
    """An image of what a caller has: an `Image`, or an array as OpenCV has it.

    That is (height, width) grey or (height, width, 3) colour, blue first, uint8 or uint16.

    Raises:
        ImageError: it is something else, or has no pixels.
    """
    if isinstance(given, Image):
        return given
    pixels = as_pixels(given)
    bits = 8 if pixels.dtype == np.uint8 else 16
    return Image(pixels, f'mono{bits}' if pixels.ndim == 2 else f'bgr{bits}')


def as_pixels(given: Image | Pixels, *, all_bits: bool = False) -> Pixels:
    """As `as_image`, but the pixels, grey or blue first; there may be none.

    Colours of 16 bits are cut to the upper 8, unless ``all_bits`` are asked for.

    Raises:
        ImageError: it is something else.
    """
    if isinstance(given, Image):
        return given.pixels if given.is_gray else given.in_colour(all_bits=all_bits)
    if isinstance(given, np.ndarray) and given.dtype in (np.uint8, np.uint16):
        given = _plain(given)
        if given.ndim == 2 or (given.ndim == 3 and given.shape[2] == 3):
            return given
    is_array = isinstance(given, np.ndarray)
    got = f'{given.shape} of {given.dtype}' if is_array else type(given).__name__
    raise ImageError(
        'the image must be an Image, or (height, width) or (height, width, 3) of uint8 or uint16, '
        f'not {got}'
    )


def _plain(pixels: Pixels) -> Pixels:
    """An array without an axis of one channel, and without what a subclass does otherwise.

    Raises:
        ImageError: it has a mask, which nothing here would regard.
    """
    if hasattr(pixels, 'mask'):
        raise ImageError('an image with a mask is not taken: fill what is masked, as with 0')
    plain = np.asarray(pixels)
    return plain[:, :, 0] if plain.ndim == 3 and plain.shape[2] == 1 else plain
