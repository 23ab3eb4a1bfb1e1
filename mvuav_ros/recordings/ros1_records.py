"""The records that a ROS 1 bag (format 2.0) consists of, one by one."""

from __future__ import annotations

import struct
from io import RawIOBase
from typing import BinaryIO, NamedTuple, cast

from rosbags.rosbag1.reader import Header, ReaderError, RecordType

MAGIC = b'#ROSBAG V'
VERSION_LINE = MAGIC + b'2.0\n'
PARSE_ERRORS = (ReaderError, struct.error, UnicodeDecodeError, ValueError)
_LONGEST_HEADER = 1 << 20
_SEARCH_BLOCK = 1 << 20
_KINDS = frozenset(int(kind) for kind in RecordType)


class Record(NamedTuple):
    """A record's header and kind, and where its data are (bytes)."""

    header: Header
    kind: int
    data: int
    size: int


def record_at(stream: BinaryIO, position: int) -> Record | None:
    """The record there, None where none is; the stream is left at its data."""
    stream.seek(position)
    length = stream.read(4)
    if len(length) < 4 or not 0 < int.from_bytes(length, 'little') < _LONGEST_HEADER:
        return None
    stream.seek(position)
    try:
        header = Header.read(stream)
        kind = header.get_uint8('op')
    except PARSE_ERRORS:
        return None
    length = stream.read(4)
    if len(length) < 4 or kind not in _KINDS:
        return None
    return Record(header, kind, stream.tell(), int.from_bytes(length, 'little'))


def next_chunk(stream: BinaryIO, start: int, size: int) -> int | None:
    """Where the next chunk's record begins; its header holds three fields in any order."""
    first = start
    while start < size:
        stream.seek(start)
        block = stream.read(_SEARCH_BLOCK + 64)
        place = block.find(b'op=\x05')
        while 0 <= place < _SEARCH_BLOCK + 32:
            for back in range(8, 64):
                record = None
                if start + place - back >= first:
                    record = record_at(stream, start + place - back)
                if (
                    record is not None
                    and record.kind == RecordType.CHUNK
                    and {'compression', 'size'} <= record.header.keys()
                ):
                    return start + place - back
            place = block.find(b'op=\x05', place + 1)
        start += _SEARCH_BLOCK
    return None


def stream_of(raw: memoryview) -> BinaryIO:
    """A chunk as a stream, without copying it as BytesIO does."""
    return cast(BinaryIO, _View(raw))


class _View(RawIOBase):
    def __init__(self, raw: memoryview) -> None:
        self._raw = raw
        self._position = 0

    def seek(self, offset: int, whence: int = 0) -> int:
        assert whence == 0
        self._position = offset
        return offset

    def tell(self) -> int:
        return self._position

    def read(self, size: int = -1) -> bytes:
        data = bytes(self._raw[self._position : self._position + size])
        self._position += len(data)
        return data
