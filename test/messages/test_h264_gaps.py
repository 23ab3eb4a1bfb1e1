"""What is missing of an H.264 stream is seen in its pictures' numbers, and nothing else is."""

from __future__ import annotations

from fractions import Fraction

import av
import numpy as np
import pytest
from support.coded_videos import HEIGHT, WIDTH, image

from mvuav_ros.messages.h264_gaps import PictureNumbers

COUNT = 40


def encoded(settings: str, pixels: str = 'yuv420p') -> list[bytes]:
    context = av.CodecContext.create('libx264', 'w')
    context.width, context.height, context.pix_fmt = WIDTH, HEIGHT, pixels
    context.time_base = Fraction(1, 20)
    context.options = {'x264-params': f'{settings}:scenecut=0', 'crf': '5'}
    made: list[bytes] = []
    for number in range(COUNT):
        frame = av.VideoFrame.from_ndarray(image(number % 20), format='bgr24')
        frame.pts, frame.time_base = number, Fraction(1, 20)
        made += [bytes(packet) for packet in context.encode(frame)]
    return made + [bytes(packet) for packet in context.encode(None)]


def followers(packets: list[bytes]) -> list[int]:
    numbers = PictureNumbers()
    return [index for index, packet in enumerate(packets) if numbers.follows_loss(packet)]


@pytest.mark.parametrize(
    ('settings', 'pixels'),
    [
        ('keyint=10:bframes=0', 'yuv420p'),
        ('keyint=10:bframes=0:ref=4:cqm=jvt:slices=4', 'yuv420p'),
        ('keyint=10:bframes=0:interlaced=1', 'yuv420p'),
        ('keyint=10:bframes=0', 'yuv444p'),
        ('keyint=10:bframes=0:intra-refresh=1', 'yuv420p'),
    ],
)
def test_only_what_follows_a_lost_picture_is_found(settings: str, pixels: str) -> None:
    packets = encoded(settings, pixels)
    assert len(packets) == COUNT and followers(packets) == []
    for lost in (2, 15, 27):
        assert followers([*packets[:lost], *packets[lost + 1 :]]) == [lost]


@pytest.mark.parametrize('lists', [{0: '1' * 16}, {6: '1' * 64, 7: '1' + '000010001'}, {}])
def test_scaling_lists_are_stepped_over(lists: dict[int, str]) -> None:
    """A list says differences, 0 as one bit; -8 at once ends the last of them."""

    def unit(kind: int, bits: str) -> bytes:
        bits += '1' + '0' * (-len(bits) - 1 & 7)
        return b'\0\0\1' + bytes([kind]) + int(bits, 2).to_bytes(len(bits) // 8, 'big')

    said = ''.join(f'1{lists[index]}' if index in lists else '0' for index in range(8))
    # Profile High, its level, what comes before the lists; 4 bits of a number, order 2, no gaps.
    parameters = unit(0x67, f'{100:08b}{40:016b}10101101{said}10110100')
    numbers = PictureNumbers()
    packets = [unit(0x41, f'111{number:04b}1') for number in (0, 1, 3, 4)]
    found = [numbers.follows_loss(parameters + packet) for packet in packets]
    assert found == [False, False, True, False]


def test_pictures_that_no_other_needs_may_be_missing() -> None:
    packets = encoded('keyint=20:bframes=2:b-pyramid=none:b-adapt=0')
    assert followers(packets) == []
    found = [bool(followers([*packets[:lost], *packets[lost + 1 :]])) for lost in range(1, 10)]
    assert found == [True, False, False] * 3


@pytest.mark.parametrize('seed', range(20))
def test_damaged_packets_are_left_to_the_decoder(seed: int) -> None:
    random = np.random.default_rng(seed)
    numbers = PictureNumbers()
    for packet in encoded('keyint=10:bframes=0')[:6]:
        data = np.frombuffer(packet, np.uint8).copy()
        data[random.integers(0, min(len(data), 60), 4)] = random.integers(0, 256, 4)
        for size in (0, 1, 4, 5, 9, len(data)):
            numbers.follows_loss(data[:size].tobytes())
    for beginning in (b'\0\0\1\0\0\1', b'\0\0\1\x67\x64\0\0' + bytes(400) + b'\1'):
        assert not numbers.follows_loss(beginning + packet)
