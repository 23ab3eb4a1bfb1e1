"""Which H.264 pictures follow a lost one: FFmpeg would decode them into false images.

By ITU-T H.264, clauses 7.3 and 7.4.3: reference pictures are numbered (``frame_num``). Also where a
group of pictures begins, in the codecs of topics.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import suppress

_START = b'\0\0\1'
_SLICE, _KEY_SLICE, _PARAMETERS = 1, 5, 7
_SLICE_HEADER_BYTES, _MAX_PARAMETER_BYTES = 32, 1024
_HIGH_PROFILES = frozenset({44, 83, 86, 100, 110, 118, 122, 128, 134, 135, 138, 139, 244})
_YUV_444 = 3
_HEVC_PARAMETERS, _HEVC_KEYS, _HEVC_OPEN_KEY = 33, range(16, 21), 21
# A video object layer, and behind it a picture of coding type 0, intra.
_MPEG4_KEY = re.compile(b'\0\0\1[\x20-\x2f].*?\0\0\1\xb6[\0-\x3f]', re.DOTALL)
_VP9_PROFILE, _VP9_MARKER, _VP9_MARKER_EXISTING_INTER = 0x30, 0x80, 0xCC


class PictureNumbers:
    """The numbers of a stream's pictures, in the order of decoding."""

    def __init__(self, extradata: bytes = b'') -> None:
        """Begin a stream; ``extradata`` is what MP4 and Matroska keep apart of it (avcC)."""
        self._digits = 0  # bits of a number; 0 where none is known, or gaps are allowed
        self._last: int | None = None
        self._length_bytes = 0  # of the length before each unit; 0 where start codes are there
        if extradata[:1] == b'\1' and len(extradata) > 8:
            self.follows_loss(_START + extradata[8:])  # the first of its parameter sets
            self._length_bytes = (extradata[4] & 3) + 1

    def follows_loss(self, packet: bytes) -> bool:
        """Whether a picture is missing before this one, the next of the stream."""
        with suppress(ValueError, IndexError):  # it ends too early, and is left to the decoder
            length = self._length_bytes
            for unit in _measured_units(packet, length) if length else _units(packet):
                kind = unit[0] & 0x1F
                if kind == _PARAMETERS:
                    self._digits = _digits(_Bits(unit[1:_MAX_PARAMETER_BYTES]))
                elif kind in (_SLICE, _KEY_SLICE):
                    return self._digits > 0 and self._slice_follows_loss(unit)
        return False

    def _slice_follows_loss(self, unit: bytes) -> bool:
        bits = _Bits(unit[1:_SLICE_HEADER_BYTES])
        for _ in ('first_mb_in_slice', 'slice_type', 'pic_parameter_set_id'):
            bits.exponential()
        number, last = bits.number(self._digits), self._last
        if unit[0] & 0x60 or last is None:  # a reference; others repeat the next number
            self._last = number
        if unit[0] & 0x1F == _KEY_SLICE or last is None:
            return False
        return number not in (last, (last + 1) % (1 << self._digits))


def groups_needed(codec: str, packet: bytes) -> int:
    """How many groups of pictures are needed from this packet on, of the one that it begins.

    2: the one before as well, by what comes behind the packet but is shown before it. 0: it begins
    none, or that is not known.
    """
    is_open, is_closed = False, codec == 'mjpeg'
    if not packet:
        return 0
    if codec == 'hevc':
        kinds = {unit[0] >> 1 for unit in _units(packet) if unit}
        is_closed = _HEVC_PARAMETERS in kinds and not kinds.isdisjoint(_HEVC_KEYS)
        is_open = {_HEVC_PARAMETERS, _HEVC_OPEN_KEY} <= kinds
    elif codec == 'h264':
        is_closed = {_PARAMETERS, _KEY_SLICE} <= {unit[0] & 0x1F for unit in _units(packet) if unit}
    elif codec == 'mpeg4':
        is_open = _MPEG4_KEY.search(packet) is not None
    elif codec == 'vp8':
        is_closed = packet[0] & 1 == 0
    elif codec == 'vp9' and packet[0] & _VP9_PROFILE != _VP9_PROFILE:  # 3 has its bits elsewhere
        is_closed = packet[0] & _VP9_MARKER_EXISTING_INTER == _VP9_MARKER
    return 1 if is_closed else 2 if is_open else 0


def _units(packet: bytes) -> Iterator[bytes]:
    """NAL units; of the last one more than its beginning may not be wanted."""
    at = packet.find(_START)
    while 0 <= at < len(packet) - len(_START):
        start = at + len(_START)
        is_last = packet[start] & 0x1F in (_SLICE, _KEY_SLICE)
        at = -1 if is_last else packet.find(_START, start)
        yield packet[start : start + _MAX_PARAMETER_BYTES if at < 0 else at]


def _measured_units(packet: bytes, length_bytes: int) -> Iterator[bytes]:
    """The beginnings of units with their lengths before them, as in MP4 and Matroska."""
    at = 0
    while (start := at + length_bytes) < len(packet):
        at = start + int.from_bytes(packet[at:start], 'big')
        yield packet[start : min(at, start + _MAX_PARAMETER_BYTES)]


class _Bits:
    """Reads an RBSP; ValueError at its end."""

    def __init__(self, unit: bytes) -> None:
        data = unit.replace(b'\0\0\3', b'\0\0')
        self._bits, self._at = ''.join(f'{byte:08b}' for byte in data), 0

    def number(self, digits: int) -> int:
        start, self._at = self._at, self._at + digits
        if self._at > len(self._bits):
            raise ValueError
        return int(self._bits[start : self._at], 2)

    def exponential(self) -> int:
        """An Exp-Golomb code, without a sign."""
        zeros = self._bits.index('1', self._at) - self._at
        self._at += zeros
        return self.number(zeros + 1) - 1

    def signed(self) -> int:
        """An Exp-Golomb code with a sign."""
        code = self.exponential()
        return (code + 1) // 2 if code % 2 else -code // 2


def _digits(bits: _Bits) -> int:
    """Of a sequence parameter set: the bits of ``frame_num``, 0 if it may have gaps."""
    profile = bits.number(8)
    bits.number(16)
    bits.exponential()
    if profile in _HIGH_PROFILES:
        chroma = bits.exponential()
        if chroma == _YUV_444 and bits.number(1):
            return 0  # colour planes apart: a field more in each slice
        bits.exponential()
        bits.exponential()
        bits.number(1)
        if bits.number(1):
            for index in range(12 if chroma == _YUV_444 else 8):
                if bits.number(1):
                    _skip_scaling_list(bits, 16 if index < 6 else 64)
    digits = bits.exponential() + 4
    order = bits.exponential()
    if order == 0:
        bits.exponential()
    elif order == 1:
        bits.number(1)
        bits.signed()
        bits.signed()
        for _ in range(bits.exponential()):
            bits.signed()
    bits.exponential()
    return 0 if bits.number(1) else digits


def _skip_scaling_list(bits: _Bits, size: int) -> None:
    last = 8
    for _ in range(size):
        last = (last + bits.signed()) % 256
        if last == 0:
            return  # the rest repeats the one before
