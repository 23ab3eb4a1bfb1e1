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
