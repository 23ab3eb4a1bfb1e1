"""Undoing the compressions found in recordings, also of data that is cut off, corrupt or hostile.

Nothing is allocated because a header says so: a few hundred bytes can claim, or hold, gigabytes.
"""

from __future__ import annotations

import bz2
import os
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager
from io import BytesIO
from math import inf
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import lz4.frame  # type: ignore[import-untyped]
import zstandard

from mvuav_ros.recordings.account import Account, RecordingError

SIZE_LIMIT = 1 << 30
"""Bytes; a larger chunk or message is refused."""
VARIABLE = 'MVUAV_MAX_SIZE_MB'
"""The environment variable that ``--max-size`` sets, so that other processes know it too."""

_PROPORTION = 200
"""Images of a dark sky become 100 times as large."""
_MIN_ALLOWED = 1 << 29


class Limit:
    """How many bytes may come of one file in a pass through it, and how many are ``left``."""

    def __init__(self, size: int) -> None:
        """Take a file of so many bytes, whose size it is in proportion to."""
        given = os.environ.get(VARIABLE, '')
        in_proportion = max(size * _PROPORTION, _MIN_ALLOWED)
        self.allowed = int(given) * 1_000_000 if given.isdecimal() else in_proportion
        self.left = self.allowed

    def begin(self) -> None:
        """Begin a pass."""
        self.left = self.allowed

    @property
    def reason(self) -> str:
        """In words, what is wrong where nothing is left."""
        return f'it becomes larger than {self.allowed // 1_000_000} MB; --max-size allows more'


@contextmanager
def allowing(megabytes: int | None) -> Iterator[None]:
    """So many for each file meanwhile, as the user says."""
    before = os.environ.get(VARIABLE)
    if megabytes is not None:
        os.environ[VARIABLE] = str(megabytes)
    try:
        yield
    finally:
        if megabytes is not None:
            os.environ.pop(VARIABLE)
        if before is not None:
            os.environ[VARIABLE] = before


PLAIN = ('', 'none')
"""What recordings call no compression."""
_AT_ONCE = 1 << 26
_TOO_LARGE = 'it is larger than it says'
# A zstd block of 4 bytes can become 128 KiB: 1 KiB in makes 32 MiB out at most.
_ZSTD_PIECE = 1 << 10
_PIECE = 1 << 22
# Of a block; recorders write one. Each of an empty frame's few bytes would cost a decoder.
_MAX_FRAMES = 1 << 8
_DAMAGE = (zstandard.ZstdError, RuntimeError, OSError, ValueError, EOFError, MemoryError)


class Unpacked(NamedTuple):
    """Decompressed data, and in words why they are not all of it; '' if they are."""

    data: memoryview
    problem: str


def unpack(stream: BinaryIO, length: int, compression: str, size: int, limit: int) -> Unpacked:
    """Decompress a block as far as it goes.

    Args:
        stream: stands at the block.
        length: of the block, bytes; the stream may end before.
        compression: '' or 'none', 'zstd', 'lz4' or 'bz2'.
        size: what the recording says that the block becomes, bytes; -1 if it does not say.
        limit: the largest size that is accepted, bytes.
    """
    if compression in PLAIN:
        data = stream.read(min(length, limit + 1))
        return Unpacked(memoryview(data), _TOO_LARGE if len(data) > limit else '')
    if compression not in _DECODERS:
        return Unpacked(memoryview(b''), f'its compression {compression[:20]!r} is not known')
    if compression == 'zstd' and max(size, length) <= _AT_ONCE:
        block = stream.read(length)
        raw = _at_once(block, size)
        if raw is not None:
            return Unpacked(memoryview(raw), '')
        stream = BytesIO(block)
    if limit > _AT_ONCE:
        # A large block is only kept if it is as large as it says; the rest of a cut one is unknown.
        start = stream.tell()
        total, problem = _pour(stream, length, compression, limit, len)
        if problem == _TOO_LARGE or not (problem or size in (total, -1)):
            limit = _AT_ONCE
        stream.seek(start)
    output = BytesIO()
    _, problem = _pour(stream, length, compression, limit, output.write)
    return Unpacked(output.getbuffer()[:limit], problem)


def decompress_message(data: bytes | memoryview, limit: Limit) -> memoryview | None:
    """A message of rosbag2's compression mode MESSAGE; None if corrupt, or too large."""
    try:
        size = zstandard.frame_content_size(data)
    except zstandard.ZstdError:
        return None
    if size > SIZE_LIMIT or limit.left <= 0:
        return None
    largest = size if size >= 0 else SIZE_LIMIT
    raw, problem = unpack(BytesIO(data), len(data), 'zstd', size, largest)
    limit.left -= len(raw)
    return None if problem else raw


def decompress_file(source: Path, target: Path, account: Account, limit: Limit) -> None:
    """Decompress a zstd file as far as it goes; what is missing is noted as an error.

    Raises:
        RecordingError: ``source`` cannot be read, or ``target`` not be written.
    """
    reason = 'zstd data corrupt'
    try:
        with source.open('rb') as packed, target.open('wb') as unpacked:
            pieces = _decoded(packed, source.stat().st_size, 'zstd')
            try:
                left = limit.allowed
                while left > 0:
                    left -= unpacked.write(next(pieces))
                reason = limit.reason
            except StopIteration as end:
                reason = 'zstd data cut off' if end.value else ''
            except zstandard.ZstdError:
                pass
    except OSError as error:
        raise RecordingError(
            f'{source} cannot be decompressed into {target.parent}: {error.strerror or error} '
            '(set TMPDIR to a folder with more space)'
        ) from None
    if reason:
        account.lose(target.name, 'zstd', f'{source.name}: {reason}; read as far as it goes')


def _at_once(block: bytes, size: int) -> bytes | None:
    """The fast way for an honest block of a single frame; None of any other."""
    try:
        if size < 0 or zstandard.frame_content_size(block) != size:
            return None
        return zstandard.ZstdDecompressor().decompress(block, max_output_size=size)
    except (zstandard.ZstdError, MemoryError):
        return None


def _pour(
    stream: BinaryIO, length: int, compression: str, limit: int, take: Callable[[bytes], Any]
) -> tuple[int, str]:
    """Decompress until more than ``limit`` bytes have come; their number, and what is wrong."""
    pieces = _decoded(stream, length, compression, _MAX_FRAMES)
    total = 0
    try:
        while total <= limit:
            piece = next(pieces)
            total += len(piece)
            take(piece)
    except StopIteration as end:
        return total, str(end.value)
    except _DAMAGE:
        return total, 'it cannot be decompressed'
    return total, _TOO_LARGE


def _decoded(
    stream: BinaryIO, length: int, compression: str, max_frames: float = inf
) -> Generator[bytes, None, str]:
    """Yield small pieces; return why the end is not reached, '' if it is."""
    decoder_type, size, limit = _DECODERS[compression]
    decoder = decoder_type()
    fresh = True
    data = b''
    while True:
        if not data and getattr(decoder, 'needs_input', True):
            data = stream.read(min(length, size))
            length -= len(data)
            if not data:
                return '' if fresh else 'its end is missing'
        yield decoder.decompress(data, *limit)
        data, fresh = b'', False
        if decoder.eof:
            max_frames -= 1
            if max_frames < 0:
                return 'it consists of too many pieces'
            data = decoder.unused_data or b''
            decoder, fresh = decoder_type(), True


_DECODERS: dict[str, tuple[Callable[[], Any], int, tuple[int, ...]]] = {
    'zstd': (lambda: zstandard.ZstdDecompressor().decompressobj(), _ZSTD_PIECE, ()),
    'lz4': (lz4.frame.LZ4FrameDecompressor, _PIECE, (_PIECE,)),
    'bz2': (bz2.BZ2Decompressor, _PIECE, (_PIECE,)),
}
"""What decompresses, and how many bytes go in and come out at once; zstandard limits none."""
