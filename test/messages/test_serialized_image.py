"""Images to and from their bytes in CDR."""

import array

import numpy as np
import pytest
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import CompressedImage
from sensor_msgs.msg import Image as RosImage
from support.headers import make_header

from mvuav_ros.messages.cdr import cdr_header
from mvuav_ros.messages.images import (
    COMPRESSED_IMAGE,
    decode_image,
    serialize_compressed_image,
    serialize_image,
    view_coded_image,
    view_image,
)
from mvuav_ros.vision.image import ENCODINGS, Image

FRAME_IDS = ['', 'c', 'nose', 'a/b_optical', 'Kamera µ']
STAMP_NS = -5_000_000_007


@pytest.mark.parametrize('frame_id', FRAME_IDS)
@pytest.mark.parametrize('encoding', ENCODINGS)
def test_serialized_images_are_those_of_ros(encoding, frame_id):
    layout = ENCODINGS[encoding]
    shape = (6, 8) if layout.channels == 1 else (6, 8, layout.channels)
    pixels = np.random.default_rng(0).integers(0, 255, shape).astype(layout.dtype)
    message = RosImage(
        header=make_header(STAMP_NS, frame_id),
        height=4 if layout.chroma_below else 6,
        width=8,
        encoding=encoding,
        step=pixels.nbytes // 6,
        data=array.array('B', pixels.tobytes()),
    )
    serialized = serialize_image(Image(pixels, encoding), cdr_header(STAMP_NS, frame_id))
    assert deserialize_message(serialized, RosImage) == message
    view = view_image(serialize_message(message))
    assert (view.stamp_ns, view.frame_id) == (STAMP_NS, frame_id)
    np.testing.assert_array_equal(decode_image(view).pixels, pixels)


@pytest.mark.parametrize('frame_id', FRAME_IDS)
def test_serialized_compressed_images_are_those_of_ros(frame_id):
    message = CompressedImage(
        header=make_header(STAMP_NS, frame_id), format='jpeg', data=b'\xff\xd8image'
    )
    serialized = serialize_compressed_image(
        'jpeg', b'\xff\xd8image', cdr_header(STAMP_NS, frame_id)
    )
    assert deserialize_message(serialized, CompressedImage) == message
    view = view_coded_image(COMPRESSED_IMAGE, serialize_message(message))
    assert (view.stamp_ns, view.frame_id, view.format) == (STAMP_NS, frame_id, 'jpeg')
    assert bytes(view.data) == b'\xff\xd8image'


def test_a_serialized_image_is_not_copied():
    message = serialize_image(Image(np.zeros((6, 8), np.uint8), 'mono8'), cdr_header(0, ''))
    pixels = decode_image(view_image(message)).pixels
    assert np.shares_memory(pixels, np.frombuffer(message, np.uint8))
