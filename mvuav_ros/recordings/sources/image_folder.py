"""Folders and globs of image files."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from mvuav_ros.recordings.account import Account
from mvuav_ros.recordings.content import is_image_start, start_of
from mvuav_ros.recordings.foreign import words
from mvuav_ros.recordings.serialization.image_decoding import MAX_PIXELS, decode_image_file
from mvuav_ros.recordings.sources.frame import OPTICAL_FRAME, BadFrame, Frame, FrameSource
from mvuav_ros.recordings.sources.video import DEFAULT_RATE
from mvuav_ros.vision.image import ImageError

IMAGE_SUFFIXES = frozenset(
    {'.png', '.jpg', '.jpeg', '.bmp', '.tif', '.tiff', '.pgm', '.ppm', '.webp'}
)
# Of the most pixels, four channels of 16 bits.
_LARGEST_FILE = MAX_PIXELS * 8 + (1 << 20)


class ImageFolder(FrameSource):
    """Image files in the order of the numbers in their names; file k has the stamp k / rate."""

    def __init__(self, name: str, files: Sequence[Path], rate: float | None = None) -> None:
        """Take the files (in any order) that are images; the name is for people, the rate in Hz."""
        self.name = f'images {words(name)}'
        self.rate: float | None = rate or DEFAULT_RATE
        self.account = Account(self.name)
        self._files = sorted((file for file in files if is_image_file(file)), key=_natural_order)
        self.count: int | None = len(self._files)

    def frames(self) -> Iterator[Frame | BadFrame]:
        """Read from the start; a file that does not decode is a `BadFrame`."""
        assert self.rate is not None
        self.account.kept = 0
        for index, file in enumerate(self._files):
            stamp_ns = round(index * 1e9 / self.rate)
            try:
                if file.stat().st_size > _LARGEST_FILE:
                    raise ImageError(f'the file is larger than {_LARGEST_FILE >> 20} MB')
                image = decode_image_file(np.fromfile(file, np.uint8))
            except (ImageError, OSError) as error:
                yield BadFrame(stamp_ns, f'{file.name}: {error}')
            else:
                self.account.kept += 1
                yield Frame(stamp_ns, OPTICAL_FRAME, image)


def is_image_file(file: Path) -> bool:
    """Whether a file is an image by its name or, where that says nothing, by its content."""
    suffix = file.suffix.lower()
    if suffix in IMAGE_SUFFIXES:
        return file.is_file()
    # Not by cv2.haveImageReader, which a name that is not UTF-8 crashes.
    return not suffix and is_image_start(start_of(file))


def _natural_order(file: Path) -> list[tuple[int, str]]:
    """Sort key: image_2 before image_10."""
    parts = re.split(r'(\d+)', file.name)
    return [(int(p), '') if p.isdigit() else (0, p) for p in parts]
