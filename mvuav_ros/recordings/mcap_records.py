"""Walking through an mcap file record by record, over damage where there is some.

mcap's own readers parse the records' contents; they end at the first damaged byte, and take a
record that is cut short for a whole one. Hence this walk, which knows where a record must end
and finds the next one behind damage.
"""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Iterator
from io import BytesIO
from typing import BinaryIO, NamedTuple

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Footer

from mvuav_ros.recordings.account import Account
from mvuav_ros.recordings.limits import SIZE_LIMIT

MAGIC = b'\x89MCAP0\r\n'
HEADER = struct.Struct('<BQ')
CHUNK_HEADER = struct.Struct('<QQQII')
MESSAGE_HEADER = struct.Struct('<HIQQ')

_MINIMUM_LENGTHS = {
    Opcode.HEADER: 8,
    Opcode.FOOTER: 20,
    Opcode.SCHEMA: 14,
    Opcode.CHANNEL: 16,
    Opcode.MESSAGE: 22,
    Opcode.CHUNK: 40,
    Opcode.MESSAGE_INDEX: 6,
    Opcode.CHUNK_INDEX: 64,
    Opcode.ATTACHMENT: 36,
    Opcode.ATTACHMENT_INDEX: 48,
    Opcode.STATISTICS: 46,
    Opcode.METADATA: 8,
    Opcode.METADATA_INDEX: 20,
    Opcode.SUMMARY_OFFSET: 17,
    Opcode.DATA_END: 4,
}
_PRIVATE_OPCODES = 0x80
_LONGEST_COMPRESSION_NAME = 16
_CANDIDATE = re.compile(rb'[\x01-\x0f](?=.{4}\0{4})', re.DOTALL)
_SEARCH_BLOCK = 1 << 20
_BLOCK = 1 << 20
_FOOTER_SIZE = HEADER.size + 20 + len(MAGIC)


class RecordSpan(NamedTuple):
    """Where a record lies; fewer bytes are ``available`` than its ``length`` if it is cut."""

    opcode: int
    body: int
    length: int
    available: int


class ChunkHeader(NamedTuple):
    """What stands before a chunk's data; times in ns, sizes in bytes."""

    start_ns: int
    end_ns: int
    uncompressed_size: int
    crc: int
    compression: str
    data_offset: int
    data_size: int


class RecordWalk:
    """The records of an open mcap file in stored order."""

    def __init__(self, stream: BinaryIO, name: str, account: Account) -> None:
        self._stream = stream
        self._name = name
        self._account = account
        self._size = stream.seek(0, 2)
        self._base = 0

    def spans(self) -> Iterator[RecordSpan]:
        """Every record, those of files that were joined included; damage is stepped over."""
        offset = len(MAGIC)
        search_from = offset
        is_closed = False
        while offset < self._size:
            span = self._span_at(offset)
            if span is None or not self._credible(span):
                found = self._next_record(search_from)
                if found is None:
                    self._note_end(offset, is_closed)
                    return
                self._account.lose(
                    self._name,
                    offset,
                    f'{self._name}: damaged at byte {offset}, reading continues at byte {found}',
                )
                offset, search_from = found, found + 1
                continue
            if span.opcode >= _PRIVATE_OPCODES:
                self._account.lose(
                    self._name,
                    offset,
                    f'{self._name}: record of unknown kind {span.opcode} skipped at byte {offset}',
                    0,
                )
            elif span.opcode == Opcode.HEADER:
                self._base = offset - len(MAGIC)
            yield span
            if span.available < span.length:
                self._note_end(offset)
                return
            offset = span.body + span.length
            is_closed = span.opcode == Opcode.FOOTER
            while is_closed and self.read(offset, len(MAGIC)) == MAGIC:
                offset += len(MAGIC)
            # A message's length cannot be checked: if what follows makes no sense, it was wrong.
            search_from = span.body if span.opcode == Opcode.MESSAGE else offset + 1

    def read(self, offset: int, size: int) -> bytes:
        """The bytes there, fewer at the file's end."""
        return self.stream_at(offset).read(size)

    def stream_at(self, offset: int) -> BinaryIO:
        """The file, to be read from there."""
        self._stream.seek(offset)
        return self._stream

    def chunk_header(self, span: RecordSpan) -> ChunkHeader | None:
        """The header of a chunk; None if it contradicts the record's length."""
        fixed = CHUNK_HEADER.size
        head = self.read(span.body, min(fixed + _LONGEST_COMPRESSION_NAME + 8, span.available))
        if len(head) < fixed:
            return None
        start_ns, end_ns, size, crc, name_length = CHUNK_HEADER.unpack_from(head)
        end = fixed + name_length + 8
        if name_length > _LONGEST_COMPRESSION_NAME or len(head) < end:
            return None
        (data_size,) = struct.unpack_from('<Q', head, end - 8)
        if end + data_size != span.length:
            return None
        compression = head[fixed : end - 8].decode('ascii', 'replace')
        if size > SIZE_LIMIT and compression in ('', 'none'):
            return None  # its records can be found one by one
        return ChunkHeader(start_ns, end_ns, size, crc, compression, span.body + end, data_size)

    def _span_at(self, offset: int) -> RecordSpan | None:
        head = self.read(offset, HEADER.size)
        if len(head) < HEADER.size:
            return None
        opcode, length = HEADER.unpack(head)
        minimum = 0 if opcode >= _PRIVATE_OPCODES else _MINIMUM_LENGTHS.get(opcode)
        if minimum is None or length < minimum:
            return None
        body = offset + HEADER.size
        return RecordSpan(opcode, body, length, min(length, self._size - body))

    def _credible(self, span: RecordSpan) -> bool:
        """Whether the length may be true: a chunk's header repeats it, others must fit."""
        if span.opcode == Opcode.CHUNK:
            return self.chunk_header(span) is not None
        return span.available == span.length

    def _next_record(self, start: int) -> int | None:
        while start < self._size:
            # 8 bytes more, so that no candidate is split between two blocks.
            block = self.read(start, _SEARCH_BLOCK + 8)
            for match in _CANDIDATE.finditer(block):
                if self._convinces(start + match.start()):
                    return start + match.start()
            start += _SEARCH_BLOCK
        return None

    def _convinces(self, offset: int) -> bool:
        """Whether a chunk, the footer, or three records in a row begin there."""
        for _ in range(3):
            span = self._span_at(offset)
            if span is None or not self._credible(span):
                return False
            if span.opcode == Opcode.CHUNK:
                return True
            offset = span.body + span.length
            if span.opcode == Opcode.FOOTER:
                return self.read(offset, len(MAGIC)) == MAGIC
            if offset == self._size:
                return True
        return True

    def is_summary_intact(self, footer: RecordSpan) -> bool:
        """Whether the checksum in a footer holds, if it has one."""
        end = footer.body + footer.length
        start = summary_start(self._stream, end + len(MAGIC), self._base)
        return start is not None and is_intact(self._stream, start, end)

    def _note_end(self, offset: int, is_closed: bool = False) -> None:
        if is_closed:
            left = self._size - offset
            said = f'{self._name}: the {left} bytes behind its end are no records'
            self._account.note((self._name, 'end'), said)
            return
        self._account.lose(
            self._name,
            'end',
            f'{self._name}: cut off or damaged; '
            f'its last {self._size - offset} bytes cannot be read in full',
        )


def summary_start(stream: BinaryIO, size: int, base: int = 0) -> int | None:
    """Where the summary begins (the footer, if there is none); None without a footer.

    Args:
        stream: the file.
        size: where the file ends, or that one of several that were joined.
        base: where it begins.
    """
    footer_offset = size - _FOOTER_SIZE
    if footer_offset < base + len(MAGIC):
        return None
    stream.seek(footer_offset)
    end = stream.read(_FOOTER_SIZE)
    if end[-len(MAGIC) :] != MAGIC or HEADER.unpack_from(end) != (Opcode.FOOTER, 20):
        return None
    footer = Footer.read(ReadDataStream(BytesIO(end[HEADER.size :])))
    if footer.summary_start == 0:
        return footer_offset
    start: int = base + footer.summary_start
    return start if start <= footer_offset else None


def is_intact(stream: BinaryIO, start: int, end: int) -> bool:
    """Whether the checksum at the summary's end holds; without one it is believed."""
    stream.seek(end - 4)
    (expected,) = struct.unpack('<I', stream.read(4))
    if expected == 0:
        return True
    stream.seek(start)
    checksum, left = 0, end - 4 - start
    while left > 0:
        block = stream.read(min(left, _BLOCK))
        checksum = zlib.crc32(block, checksum)
        left -= len(block)
    return bool(checksum == expected)
