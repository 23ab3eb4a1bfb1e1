"""What a file is, by its first bytes; its name counts only where those are damaged."""

from __future__ import annotations

from pathlib import Path

MCAP_START = b'\x89MCAP0\r\n'
SQLITE_START = b'SQLite format 3\0'
ROS1_START = b'#ROSBAG V'
ZSTD_START = b'\x28\xb5\x2f\xfd'
BAG_SUFFIXES = ('.mcap', '.db3', '.bag')
"""After `plain_name`."""

_BAG_STARTS = (MCAP_START, SQLITE_START, ROS1_START, ZSTD_START)
# PNG, JPEG, TIFF, BMP, grey and colour PNM.
_IMAGE_STARTS = (b'\x89PNG', b'\xff\xd8\xff', b'II*\0', b'MM\0*', b'BM', b'P5\n', b'P6\n')
# AVI and WebP; Matroska; Ogg; Flash; MPEG.
_MEDIA_STARTS = (
    *_IMAGE_STARTS,
    *(b'RIFF', b'\x1a\x45\xdf\xa3', b'OggS', b'FLV', b'\0\0\1\xba', b'\0\0\1\xb3'),
)
_ISO_MEDIA = slice(4, 8), b'ftyp'
_OWN_ENDINGS = ('.zstd', '.zst', '.active')


def plain_name(name: str) -> str:
    """A file's name in small letters without what compression and a running recorder append."""
    name = name.lower()
    for ending in _OWN_ENDINGS:
        name = name.removesuffix(ending)
    return name


def start_of(path: Path) -> bytes:
    """The first bytes of a regular file; nothing of a pipe or device, which would block.

    Raises:
        OSError: it cannot be read.
    """
    if not path.is_file():
        return b''
    with path.open('rb') as stream:
        return stream.read(16)


def is_image_start(start: bytes) -> bool:
    """Whether a file that begins so is an image."""
    return start.startswith(_IMAGE_STARTS) or (start[:4] == b'RIFF' and start[8:12] == b'WEBP')


def is_bag_file(path: Path) -> bool:
    """Whether a file is (part of) a recording, perhaps with damaged first bytes."""
    try:
        start = start_of(path)
    except OSError:
        start = b''
    if start.startswith(_BAG_STARTS):
        return True
    place, mark = _ISO_MEDIA
    if start.startswith(_MEDIA_STARTS) or start[place] == mark:
        return False
    return plain_name(path.name).endswith(BAG_SUFFIXES)
