"""Undoing the compressions found in recordings, also of data that was cut off."""

from __future__ import annotations

import bz2
from collections.abc import Callable
from pathlib import Path

import lz4.frame  # type: ignore[import-untyped]
import zstandard

from mvuav_ros.recordings.errors import RecordingError
from mvuav_ros.recordings.recording import Losses

ZSTD_MAGIC = b'\x28\xb5\x2f\xfd'
# A corrupt length must not make us ask for all of the machine's memory.
SIZE_LIMIT = 1 << 30
_PIECE = 1 << 20
# Black video shrinks a thousandfold: small pieces in bound the pieces that come out.
_FILE_PIECE = 1 << 14


class CompressionError(ValueError):
    """Data that cannot be decompressed, with a reason in words."""


def decompress(data: bytes, compression: str, size: int) -> bytes:
    """Decompress a whole block.

    Args:
        data: the compressed block.
        compression: '' or 'none', 'zstd', 'lz4' or 'bz2'.
        size: the decompressed size in bytes that the recording promises.

    Raises:
        CompressionError: the data is corrupt, or has another size.
    """
    if compression not in _DECOMPRESSORS:
        raise CompressionError(f'its compression {compression!r} is not known')
    if size > SIZE_LIMIT:
        raise CompressionError('its size cannot be true')
    try:
        raw = _DECOMPRESSORS[compression](data, size)
    except (zstandard.ZstdError, RuntimeError, OSError, ValueError, EOFError, MemoryError):
        raise CompressionError('it cannot be decompressed') from None
    if len(raw) != size:
        raise CompressionError('its size is wrong')
    return raw


def decompress_start(data: bytes, compression: str) -> bytes:
    """Decompress what there is of a block whose end is missing; never raises."""
    if compression in ('', 'none'):
        return data
    if compression not in _STREAMS:
        return b''
    stream = _STREAMS[compression]()
    pieces: list[bytes] = []
    try:
        for start in range(0, len(data), _PIECE):
            pieces.append(stream(data[start : start + _PIECE]))  # noqa: PERF401
    except (zstandard.ZstdError, RuntimeError, OSError, ValueError, EOFError, MemoryError):
        pass
    return b''.join(pieces)


def decompress_message(data: bytes) -> bytes:
    """Decompress one message of a bag recorded with rosbag2's compression mode MESSAGE.

    Raises:
        CompressionError: the data is corrupt.
    """
    try:
        size = zstandard.frame_content_size(data)
        if size < 0:
            stream = zstandard.ZstdDecompressor().decompressobj()
            raw = stream.decompress(data)
            if not stream.eof:
                raise CompressionError('its end is missing')
            return raw
    except zstandard.ZstdError:
        raise CompressionError('it cannot be decompressed') from None
    return decompress(data, 'zstd', size)


def decompress_file(source: Path, target: Path, losses: Losses) -> None:
    """Decompress a zstd file as far as it goes; what is missing is noted as a loss.

    Raises:
        RecordingError: ``source`` cannot be read, or ``target`` not be written.
    """
    frame = zstandard.ZstdDecompressor().decompressobj()
    reason = 'cut off'
    try:
        with source.open('rb') as packed, target.open('wb') as unpacked:
            while piece := packed.read(_FILE_PIECE):
                while piece:
                    unpacked.write(frame.decompress(piece))
                    piece = frame.unused_data
                    if frame.eof:
                        reason = ''
                        frame = zstandard.ZstdDecompressor().decompressobj()
                    else:
                        reason = 'cut off'
    except zstandard.ZstdError:
        reason = 'corrupt'
    except OSError as error:
        raise RecordingError(
            f'{source} cannot be decompressed into {target.parent}: {error.strerror or error} '
            '(set TMPDIR to a folder with more space)'
        ) from None
    if reason:
        losses.note((source, 'zstd'), f'{source.name}: zstd data {reason}, read as far as it goes')


def _unzstd(data: bytes, size: int) -> bytes:
    promised = zstandard.frame_content_size(data)
    if promised > size:
        raise CompressionError('its size is wrong')
    raw = zstandard.ZstdDecompressor().decompress(data, max_output_size=size)
    if len(raw) < size:  # several frames
        return zstandard.ZstdDecompressor().stream_reader(data, read_across_frames=True).read(size)
    return raw


def _unlz4(data: bytes, size: int) -> bytes:
    raw: bytes = lz4.frame.decompress(data)
    return raw


_DECOMPRESSORS: dict[str, Callable[[bytes, int], bytes]] = {
    '': lambda data, size: data,
    'none': lambda data, size: data,
    'zstd': _unzstd,
    'lz4': _unlz4,
    'bz2': lambda data, size: bz2.decompress(data),
}

_STREAMS: dict[str, Callable[[], Callable[[bytes], bytes]]] = {
    'zstd': lambda: zstandard.ZstdDecompressor().decompressobj().decompress,
    'lz4': lambda: lz4.frame.LZ4FrameDecompressor().decompress,
    'bz2': lambda: bz2.BZ2Decompressor().decompress,
}
