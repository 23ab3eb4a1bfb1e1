"""Malformed messages by the thousand into live nodes: each counted, good frames answered."""

import os
import random
import struct

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st
from support.live_stream import KEEP_EVERYTHING, Stream
from support.marker_scenes import draw, tanker_at

from mvuav_ros.messages.cdr import cdr_header
from mvuav_ros.messages.images import (
    COMPRESSED_IMAGE,
    IMAGE,
    ImageDecoder,
    serialize_compressed_image,
    serialize_image,
)
from mvuav_ros.vision.image import ENCODINGS, Image, ImageError

COUNT = int(os.environ.get('MVUAV_MALFORMED', '10000'))
FEWER = min(4000, COUNT)
GROUP = 20
SMALL = np.random.default_rng(0).integers(0, 255, (24, 32), np.uint8)
VALID = serialize_image(Image(SMALL, 'mono8'), cdr_header(5_000_000_007, 'nose'))
HEADER_BYTES = len(VALID) - SMALL.nbytes
EXTREMES = st.sampled_from([0, 1, 2, 31, 32, 33, 2**16, 2**31 - 1, 2**31, 2**32 - 1])


def cdr_text(before: bytes, length: int, text: bytes) -> bytes:
    before += bytes(-len(before) % 4)
    return before + struct.pack('<I', length) + text


def lying_image(height, width, step, encoding, length, data, frame_length, nanosec):
    message = cdr_text(b'\0\1\0\0' + struct.pack('<iI', 5, nanosec), frame_length, b'nose\0')
    message += bytes(-len(message) % 4) + struct.pack('<II', height, width)
    message = cdr_text(message, len(encoding) + 1, encoding + b'\0') + b'\0'
    message += bytes(-len(message) % 4) + struct.pack('<II', step, length)
    return message + data


LYING = st.builds(
    lying_image,
    height=EXTREMES,
    width=EXTREMES,
    step=EXTREMES,
    encoding=st.sampled_from([*(name.encode() for name in ENCODINGS), b'plaid8', b'', b'\xff\xfe']),
    length=EXTREMES,
    data=st.binary(max_size=64),
    frame_length=st.sampled_from([5, 5, 5, 0, 6, 2**31, 2**32 - 1]),
    nanosec=st.sampled_from([7, 7, 7, 10**9, 2**32 - 1]),
)
TRUNCATED = st.integers(4, len(VALID) - 1).map(lambda end: VALID[:end])


def flipped(flips):
    message = bytearray(VALID)
    for position, bits in flips:
        message[position] ^= bits
    return bytes(message)


FLIPPED = st.lists(
    st.tuples(st.integers(0, HEADER_BYTES - 1), st.integers(1, 255)), min_size=1, max_size=4
).map(flipped)

JPEG = cv2.imencode('.jpg', SMALL)[1].tobytes()
PNG = cv2.imencode('.png', SMALL)[1].tobytes()


def compressed(kind: str, data: bytes) -> bytes:
    return serialize_compressed_image(kind, data, cdr_header(5_000_000_007, 'nose'))


def claiming(width: int, height: int, file: bytes) -> bytes:
    """A small JPEG or PNG whose header claims another size."""
    if file is PNG:
        return PNG[:16] + struct.pack('>II', width % 2**32, height % 2**32) + PNG[24:]
    at = JPEG.index(b'\xff\xc0') + 5
    return JPEG[:at] + struct.pack('>HH', height % 2**16, width % 2**16) + JPEG[at + 4 :]


COMPRESSED = st.one_of(
    st.binary(min_size=4, max_size=200),
    st.builds(compressed, st.sampled_from(['jpeg', 'png', 'h264', '']), st.binary(max_size=100)),
    st.integers(0, len(JPEG) // 2).map(lambda end: compressed('jpeg', JPEG[:end])),
    st.integers(0, len(PNG) // 2).map(lambda end: compressed('png', PNG[:end])),
    st.builds(claiming, EXTREMES, EXTREMES, st.sampled_from([JPEG, PNG])).map(
        lambda file: compressed('jpeg; png', file)
    ),
    st.integers(4, 80).map(lambda end: compressed('jpeg', JPEG)[:end]),
)


def is_refused(message: bytes, is_compressed: bool) -> bool:
    # As it arrives: DDS fills up to four bytes.
    message += bytes(-len(message) % 4)
    try:
        ImageDecoder().decode(COMPRESSED_IMAGE if is_compressed else IMAGE, message)
    except ImageError:
        return True
    return False


def hand_made() -> list[bytes]:
    big_endian = b'\0\0' + VALID[2:]
    return [
        # Four bytes at least: Fast DDS itself drops shorter ones or repeats the message before,
        # and an empty one stalls its reliable subscribers, plain rclpy's too.
        b'\0\1\0\0',
        b'\0\3\0\0' + VALID[4:],
        b'\xff' * 1000,
        bytes(1_000_000),
        random.Random(8).randbytes(300_000),
        big_endian,
        VALID[:-4],
        VALID[:HEADER_BYTES],
        lying_image(2**32 - 1, 2**32 - 1, 2**32 - 1, b'bgr8', 2**32 - 1, b'', 5, 7),
        lying_image(24, 32, 32, b'x' * 5000, 0, b'', 5, 7),
        lying_image(24, 32, 32, b'mono8', 768, bytes(768), 2_000_000, 7),
        lying_image(24, 32, 32, b'32FC1', 768, b'\xff' * 768, 5, 7),
    ]


@pytest.mark.parametrize(
    ('is_compressed', 'count'),
    [
        pytest.param(False, FEWER, id='raw'),
        pytest.param(False, COUNT, id='raw, many', marks=pytest.mark.long),
        pytest.param(True, COUNT // 5, id='compressed'),
    ],
)
def test_malformed_messages_are_counted_and_good_frames_processed(graph, is_compressed, count):
    transport = 'compressed' if is_compressed else 'raw'
    nodes = ['marker_tracker'] if is_compressed else ['marker_tracker', 'runway_detector']
    stream = Stream(
        graph, *nodes, compressed=is_compressed, image_transport=transport, **KEEP_EVERYTHING
    )
    bad = good = 0

    def good_frame() -> bytes:
        if not is_compressed:
            return stream.good()
        pixels = cv2.imencode('.png', draw(tanker_at()))[1].tobytes()
        return serialize_compressed_image('png', pixels, cdr_header(stream.next_stamp(), 'nose'))

    def send(messages: list[bytes]) -> None:
        nonlocal bad, good
        for message in messages:
            stream.publisher.publish(message)
        stream.publisher.publish(good_frame())
        bad, good = bad + len(messages), good + 1
        stream.until_answered(good)

    kinds = (
        COMPRESSED
        if is_compressed
        else st.one_of(st.binary(min_size=4, max_size=200), TRUNCATED, FLIPPED, LYING)
    )

    # Derandomised: the same messages in every run.
    @settings(
        max_examples=count // GROUP,
        derandomize=True,
        database=None,
        deadline=None,
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    @given(
        st.lists(
            kinds.filter(lambda message: is_refused(message, is_compressed)),
            min_size=GROUP,
            max_size=GROUP,
        )
    )
    def send_generated(messages):
        send(messages)

    made = hand_made()
    assert all(is_refused(message, is_compressed) for message in made)
    send(made)
    send_generated()
    assert bad >= count
    for name in nodes:
        values = graph.diagnostics(name)
        assert values['frames_rejected'] == values['rejected_bad_image'] == str(bad)
        assert values['frames_processed'] == str(good) == str(len(stream.answers[name]))
        assert 'images rejected' in values['message'] and values['level'] == 1
    assert stream.states() == [1] * 5
    stream.check_alive()
