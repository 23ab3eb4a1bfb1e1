"""From received messages to frames, in the order in which they come."""

from __future__ import annotations

from unittest.mock import MagicMock

import pytest
from support.coded_videos import (
    compressed_image,
    compressed_video,
    ffmpeg_packet,
    number_in,
    packets,
)

from mvuav_ros.messages.images import BadFrame, Frame, StampReader
from mvuav_ros.nodes.image_input import ReceivedImage
from mvuav_ros.nodes.publishing import FrameAnswerer, FrameDecoder
from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.frames import Attitude

START_NS = 1_700_000_000_000_000_000
LEVEL = Attitude(0.0, 0.0, 0.0, 1.0)
CAMERA = CameraModel(64, 48, (50.0, 0.0, 32.0, 0.0, 50.0, 24.0, 0.0, 0.0, 1.0))


def stamp_of(number: int) -> int:
    return START_NS + number * 50_000_000


def received(
    data: bytes, number: int = 0, *, skipped: bool = False, lost: bool = False
) -> ReceivedImage:
    beside = (CAMERA, LEVEL) if number % 2 else (None, None)
    stamp_ns = StampReader().read(data, START_NS)
    return ReceivedImage(data, stamp_ns, 0.0, 0.0, *beside, is_skipped=skipped, follows_loss=lost)


@pytest.mark.parametrize(
    ('transport', 'make', 'codec', 'name'),
    [
        ('compressed', compressed_image, 'libx264', 'h264'),
        ('compressed', compressed_image, 'libx265', 'h265'),
        ('ffmpeg', ffmpeg_packet, 'libx264', 'libx264'),
        ('foxglove', compressed_video, 'libx265', 'h265'),
    ],
)
def test_each_packet_gives_its_frame_at_once(transport, make, codec, name) -> None:
    decoder = FrameDecoder(transport)
    for number, data in enumerate(packets(codec, 8)):
        (frame,) = decoder.frames(received(make(data, name, stamp_of(number)), number))
        assert isinstance(frame, Frame)
        assert (frame.stamp_ns, number_in(frame.image.pixels)) == (stamp_of(number), number)
        beside = (CAMERA, LEVEL) if number % 2 else (None, None)
        assert (frame.camera, frame.attitude) == beside


def test_what_is_skipped_is_decoded_only_where_others_need_it() -> None:
    decoder = FrameDecoder('compressed')
    coded = [
        compressed_image(data, 'h264', stamp_of(number))
        for number, data in enumerate(packets('libx264', 8))
    ]
    for number, data in enumerate(coded):
        frames = list(decoder.frames(received(data, skipped=number % 3 != 0)))
        assert [number_in(frame.image.pixels) for frame in frames] == [number] * (number % 3 == 0)
    jpeg = compressed_image(b'nothing that decodes', 'jpeg', START_NS)
    assert list(decoder.frames(received(jpeg, skipped=True))) == []


def test_after_a_lost_start_the_next_key_frame_is_the_first() -> None:
    decoder = FrameDecoder('compressed')
    numbers, reasons = [], []
    for number, data in enumerate(packets('libx264', 12)):
        if number == 0:
            continue
        for frame in decoder.frames(received(compressed_image(data, 'h264', stamp_of(number)))):
            if isinstance(frame, BadFrame):
                reasons.append(frame.reason)
            else:
                numbers.append(number_in(frame.image.pixels))
    assert numbers[-1] == 11 and len(numbers) >= 7
    assert all('does not decode' in reason for reason in reasons)
    assert len(numbers) + len(reasons) <= 11


def test_packets_that_never_become_frames_are_not_kept_for_ever() -> None:
    decoder = FrameDecoder('compressed')
    data = packets('libx264', 1)[0]
    for number in range(200):
        message = compressed_image(data, 'h264', stamp_of(number))
        assert list(decoder.frames(received(message, skipped=True))) == []
    assert len(decoder._video._waiting) <= 64


def test_after_a_pause_no_image_is_made_of_what_needs_those_before() -> None:
    processor = MagicMock(status='', frames_problem='')
    processor.process.return_value = []
    publishers = MagicMock()
    publishers.publish.return_value, publishers.debug_wanted.return_value = 0.0, []
    answerer = FrameAnswerer(MagicMock(), processor)
    answerer.restart(publishers, 'compressed')
    for number, data in enumerate(packets('libx265', 10)):
        answerer.statistics.enabled = number != 2
        answerer.answer(received(compressed_image(data, 'h265', stamp_of(number))))
    stamps = [given.args[0].stamp_ns for given in processor.process.call_args_list]
    assert stamps == [stamp_of(number) for number in (0, 1, 5, 6, 7, 8, 9)]
    # Those in between are counted.
    assert answerer.statistics.rejected.total() == 2
    # What was skipped is counted elsewhere.
    answerer.answer(received(compressed_image(data, 'h265', stamp_of(10)), skipped=True))
    assert answerer.statistics.received == 10


@pytest.mark.parametrize(('codec', 'name'), [('libx264', 'h264'), ('libx265', 'h265')])
@pytest.mark.parametrize('is_known', [True, False])
def test_no_image_is_made_of_a_packet_whose_predecessor_is_lost(codec, name, is_known) -> None:
    """Whether it was lost on the way, or left out while the node was disabled."""
    decoder = FrameDecoder('compressed')
    numbers, reasons = [], []
    for number, data in enumerate(packets(codec, 10)):
        if number == 2:
            if not is_known:
                decoder.forget()
            continue
        message = compressed_image(data, name, stamp_of(number))
        for frame in decoder.frames(received(message, lost=is_known and number == 3)):
            if isinstance(frame, BadFrame):
                reasons.append(frame.reason)
            else:
                numbers.append((frame.stamp_ns - START_NS) // 50_000_000)
    assert numbers == [0, 1, 5, 6, 7, 8, 9]
    assert len(reasons) == 2
