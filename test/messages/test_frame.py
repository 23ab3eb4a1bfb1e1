"""The images of one topic give what each message gives by itself, whatever came before it."""

import numpy as np
import pytest

from mvuav_ros.messages.cdr import cdr_header
from mvuav_ros.messages.images import IMAGE, ImageDecoder, decode_image, serialize_image, view_image
from mvuav_ros.vision.image import Image, ImageError

RANDOM = np.random.default_rng(0)
START_NS = 1_700_000_000_000_000_000


def message(encoding='mono8', shape=(4, 5), frame_id='camera', number=0):
    dtype = np.uint16 if encoding.endswith('16') else np.uint8
    pixels = RANDOM.integers(0, 256, shape).astype(dtype)
    return serialize_image(Image(pixels, encoding), cdr_header(START_NS + number, frame_id))


def alone(data):
    """What one message says, or why it is refused."""
    try:
        view = view_image(data)
        return view.frame_id, decode_image(view)
    except ImageError as error:
        return str(error)


def check(decoder, data):
    expected = alone(data)
    if isinstance(expected, str):
        with pytest.raises(ImageError) as refused:
            decoder.decode(IMAGE, data)
        assert str(refused.value) == expected
        return
    frame_id, image = decoder.decode(IMAGE, data)
    other_id, other = expected
    assert (frame_id, image.encoding) == (other_id, other.encoding)
    assert image.pixels.dtype == other.pixels.dtype
    np.testing.assert_array_equal(image.pixels, other.pixels)
    assert image.pixels.flags.writeable == other.pixels.flags.writeable


def test_a_stream_that_changes_now_and_then():
    decoder = ImageDecoder()
    streams = [
        {},
        {'frame_id': 'nose'},
        {'shape': (5, 4)},
        {'encoding': 'bgr8', 'shape': (4, 5, 3)},
        {'encoding': 'mono16'},
        {'encoding': '8UC1'},
        {'encoding': 'nv12', 'shape': (6, 4)},
    ]
    for kind in (*streams, *reversed(streams)):
        for number in range(3):
            check(decoder, message(number=number, **kind))


def test_padded_rows_and_the_other_byte_order():
    decoder = ImageDecoder()
    whole = message(shape=(4, 6))
    size = bytes([4, 0, 0, 0, 6, 0, 0, 0])
    padded = whole.replace(size, bytes([4, 0, 0, 0, 5, 0, 0, 0]))
    swapped = bytearray(message(encoding='mono16', shape=(4, 6)))
    swapped[swapped.index(b'mono16\0') + 7] = 1
    assert decode_image(view_image(padded)).pixels.strides == (6, 1)
    for data in (whole, padded, bytes(swapped), padded, whole):
        check(decoder, data)
        check(decoder, data)


def test_damage_after_a_good_image():
    good = message()
    for position in range(good.index(b'mono8') + 20):
        for value in (0, 1, 0x7F, 0xFF):
            decoder = ImageDecoder()
            check(decoder, good)
            check(decoder, good[:position] + bytes([value]) + good[position + 1 :])
            check(decoder, good[:position])
            check(decoder, good)
