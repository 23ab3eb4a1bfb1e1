"""A node and a replay see the same pixels of a message, or refuse it in the same words."""

import random

import cv2
import numpy as np
import pytest

from mvuav_ros.messages.cdr import cdr_header
from mvuav_ros.messages.images import (
    COMPRESSED_IMAGE,
    IMAGE,
    BadFrame,
    Frame,
    StampReader,
    serialize_compressed_image,
    serialize_image,
)
from mvuav_ros.messages.untrusted import MAX_LINE, words
from mvuav_ros.nodes.image_input import ReceivedImage
from mvuav_ros.nodes.publishing import FrameDecoder
from mvuav_ros.recordings.stored_file import RecordedMessage
from mvuav_ros.sources.bag import EncodedFrame
from mvuav_ros.vision.image import ENCODINGS, Image, ImageError

STAMP_NS = 1_700_000_000_000_000_007
RANDOM = np.random.default_rng(0)
TYPES = {'raw': IMAGE, 'compressed': COMPRESSED_IMAGE}


def raw(encoding: str) -> bytes:
    layout = ENCODINGS[encoding]
    shape = (6, 8) if layout.channels == 1 else (6, 8, layout.channels)
    pixels = RANDOM.integers(0, 255, shape).astype(layout.dtype)
    return serialize_image(Image(pixels, encoding), cdr_header(STAMP_NS, 'nose'))


def compressed(ending: str) -> bytes:
    pixels = RANDOM.integers(0, 255, (6, 8, 3)).astype(np.uint8)
    data = cv2.imencode(ending, pixels)[1].tobytes()
    return serialize_compressed_image(ending[1:], data, cdr_header(STAMP_NS, 'nose'))


MESSAGES = [
    *(('raw', raw(encoding)) for encoding in ENCODINGS),
    *(('compressed', compressed(ending)) for ending in ('.jpg', '.png', '.webp', '.tif')),
]


def said(frame: Frame) -> tuple[object, ...]:
    pixels = frame.image.pixels
    return frame.stamp_ns, frame.frame_id, frame.image.encoding, pixels.shape, pixels.tobytes()


def live(decoder: FrameDecoder, message: bytes) -> object:
    try:
        stamp_ns = StampReader().read(message, STAMP_NS)
        (frame,) = decoder.frames(ReceivedImage(message, stamp_ns, 0.0, 0.0))
    except ImageError as error:
        return words(error, MAX_LINE)
    return said(frame)


def replayed(transport: str, message: bytes) -> object:
    recorded = RecordedMessage('/camera', TYPES[transport], STAMP_NS, message)
    frame = EncodedFrame(recorded, StampReader().read(message, STAMP_NS)).decoded()
    return frame.reason if isinstance(frame, BadFrame) else said(frame)


@pytest.mark.parametrize('number', range(len(MESSAGES)))
def test_sound_and_damaged_messages(number):
    transport, message = MESSAGES[number]
    decoder = FrameDecoder(transport)
    assert live(decoder, message) == replayed(transport, message)
    assert not isinstance(live(decoder, message), str)
    choose = random.Random(0)
    refused = 0
    # All of the fields before the pixels or the file, its header, and some of the rest.
    places = [*range(4, 80), *(choose.randrange(80, len(message)) for _ in range(40))]
    for place in places:
        for value in (0, 1, 0x7F, 0xFF):
            damaged = message[:place] + bytes([value]) + message[place + 1 :]
            answer = live(decoder, damaged)
            assert answer == replayed(transport, damaged), (place, value)
            refused += isinstance(answer, str)
        assert live(decoder, message[:place]) == replayed(transport, message[:place])
        assert live(decoder, message) == replayed(transport, message)
    assert refused > 20
