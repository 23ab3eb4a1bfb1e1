"""Finding the messages of a damaged rosbag2 database page by page, without SQLite.

SQLite reaches a row through pages that point to it and gives up where one of those is gone,
though the row itself may be there. The format is https://www.sqlite.org/fileformat2.html.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from mvuav_ros.recordings.compression import SIZE_LIMIT

_HEADER_SIZE = 100
_MIN_PAGE = 512
_LOG_HEADER_SIZE, _FRAME_HEADER_SIZE = 32, 24
_TABLE_LEAF = 13
_INTEGER_SIZES = {0: 0, 1: 1, 2: 2, 3: 3, 4: 4, 5: 6, 6: 8, 8: 0, 9: 0}
_MIN_BLOB = 12
_MAX_LOCAL_FRACTION = 35
# A damaged pointer may lead several rows into one chain of pages, but not all rows into all pages.
_MAX_PASSES = 8


MessageRow = tuple[int, int, bytes]
"""A row of the table ``messages``: number of the topic, log time (ns), and data."""


class PageFile:
    """A database file as a sequence of pages.

    ``missing_bytes`` is how much shorter the file is than its header says, 0 if the write-ahead
    log beside it has all of that: a crash left them so. ``incomplete_rows`` is how many messages
    `messages` found of which a part is gone.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self.incomplete_rows = 0
        with path.open('rb') as stream:
            header = stream.read(_HEADER_SIZE)
            self._size = stream.seek(0, 2)
        self._page_size = self._usable = self.missing_bytes = 0
        if len(header) == _HEADER_SIZE:
            (page_size,) = struct.unpack_from('>H', header, 16)
            self._page_size = 65536 if page_size == 1 else page_size
            self._usable = self._page_size - header[20]
            (pages,) = struct.unpack_from('>I', header, 28)
            # The count is only valid if it was written at the last change.
            if header[24:28] != header[92:96]:
                pages = -(-self._size // max(self._page_size, 1))
            self.missing_bytes = max(pages * self._page_size - self._size, 0)
            if self.missing_bytes and self._page_size >= _MIN_PAGE:
                logged = _logged_pages(Path(f'{path}-wal'), self._page_size)
                if all(n in logged for n in range(self._size // self._page_size + 1, pages + 1)):
                    self.missing_bytes = 0

    def messages(self, after_rowid: int) -> Iterator[MessageRow]:
        """The whole messages in the file's order, without those up to ``after_rowid``."""
        self.incomplete_rows = 0
        self._overflow_left = _MAX_PASSES * self._size
        if self._page_size < _MIN_PAGE:
            return
        with self._path.open('rb') as stream:
            for offset in range(0, self._size, self._page_size):
                stream.seek(offset)
                page = stream.read(self._page_size)
                for start in _cells(page, _HEADER_SIZE if offset == 0 else 0):
                    try:
                        row = self._row(stream, page, start, after_rowid)
                    except (IndexError, struct.error):
                        continue
                    if row is not None:
                        yield row

    def _row(
        self, stream: BinaryIO, page: bytes, start: int, after_rowid: int
    ) -> MessageRow | None:
        """The message in a cell; None if it is another table's, known, or incomplete."""
        size, position = _varint(page, start)
        rowid, position = _varint(page, position)
        local = self._local_size(size)
        kinds, body = _serial_types(page, position)
        if rowid <= after_rowid or not _is_message(kinds, size - (body - position)):
            return None
        position, end = body, position + local
        topic_id, position = _integer(page, position + _INTEGER_SIZES[kinds[0]], kinds[1])
        stamp_ns, position = _integer(page, position, kinds[2])
        data = page[position:end]
        if local < size:
            data += self._overflow(stream, page[end : end + 4], size - local)
        if len(data) != (kinds[3] - _MIN_BLOB) // 2:
            self.incomplete_rows += 1
            return None
        return topic_id, stamp_ns, data

    def _local_size(self, size: int) -> int:
        if size <= self._usable - _MAX_LOCAL_FRACTION:
            return size
        least = (self._usable - 12) * 32 // 255 - 23
        wanted = least + (size - least) % (self._usable - 4)
        return wanted if wanted <= self._usable - _MAX_LOCAL_FRACTION else least

    def _overflow(self, stream: BinaryIO, pointer: bytes, size: int) -> bytes:
        pieces: list[bytes] = []
        (number,) = struct.unpack('>I', pointer)
        if size > min(self._size, SIZE_LIMIT):
            return b''
        while size > 0 and number > 0 and self._overflow_left > 0:
            self._overflow_left -= self._page_size
            stream.seek((number - 1) * self._page_size)
            page = stream.read(self._usable)
            if len(page) < 4 + min(size, self._usable - 4):
                break
            pieces.append(page[4 : 4 + size])
            size -= len(pieces[-1])
            (number,) = struct.unpack_from('>I', page)
        return b''.join(pieces)


def _logged_pages(log: Path, page_size: int) -> set[int]:
    """The numbers of the pages that a write-ahead log holds; none if there is no such file."""
    pages: set[int] = set()
    if log.is_file():
        with log.open('rb') as stream:
            salts = stream.read(_LOG_HEADER_SIZE)[16:24]
            # Behind the newest frames may be older ones, with other salts.
            while (frame := stream.read(_FRAME_HEADER_SIZE))[8:16] == salts != b'':
                pages.add(int.from_bytes(frame[:4], 'big'))
                stream.seek(page_size, 1)
    return pages


def _cells(page: bytes, start: int) -> tuple[int, ...]:
    """Where the cells of a table's leaf begin; none on other pages."""
    if len(page) < start + 8 or page[start] != _TABLE_LEAF:
        return ()
    (count,) = struct.unpack_from('>H', page, start + 3)
    if start + 8 + 2 * count > len(page):
        return ()
    return tuple(dict.fromkeys(struct.unpack_from(f'>{count}H', page, start + 8)))


def _is_message(kinds: list[int], body_size: int) -> bool:
    """Whether a record is (id, topic_id, timestamp, data) and as long as it says."""
    if len(kinds) != 4 or any(kind not in _INTEGER_SIZES for kind in kinds[:3]):
        return False
    blob = kinds[3] - _MIN_BLOB
    integers = sum(_INTEGER_SIZES[kind] for kind in kinds[:3])
    return blob >= 0 and blob % 2 == 0 and integers + blob // 2 == body_size


def _serial_types(page: bytes, start: int) -> tuple[list[int], int]:
    """The serial types of a record's columns and where its values begin."""
    header_size, position = _varint(page, start)
    end = start + header_size
    kinds: list[int] = []
    while position < end and len(kinds) <= 4:
        kind, position = _varint(page, position)
        kinds.append(kind)
    return kinds, end


def _integer(page: bytes, position: int, kind: int) -> tuple[int, int]:
    if kind in (8, 9):
        return kind - 8, position
    end = position + _INTEGER_SIZES[kind]
    return int.from_bytes(page[position:end], 'big', signed=True), end


def _varint(page: bytes, position: int) -> tuple[int, int]:
    value = 0
    for count in range(8):
        byte = page[position + count]
        value = (value << 7) | (byte & 0x7F)
        if byte < 0x80:
            return value, position + count + 1
    return (value << 8) | page[position + 8], position + 9
