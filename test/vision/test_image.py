"""The views of an image: every channel, of every encoding, whole and in windows."""

import cv2
import numpy as np
import pytest

from mvuav_ros.vision.image import CHANNELS, ENCODINGS, Image

COLORED = [name for name, e in ENCODINGS.items() if e.channels > 1 or e.to_gray is not None]


def noise(encoding, height=12, width=16):
    layout = ENCODINGS[encoding]
    shape = (height, width, layout.channels) if layout.channels > 1 else (height, width)
    return np.random.default_rng(3).integers(0, 256, shape, layout.dtype)


@pytest.mark.parametrize('encoding', COLORED)
@pytest.mark.parametrize('channel', CHANNELS)
@pytest.mark.parametrize('columns', [slice(0, 16), slice(3, 8), slice(4, 9), slice(15, 16)])
def test_a_window_is_a_part_of_the_whole(encoding, channel, columns):
    image = Image(noise(encoding), encoding).seen_in(channel)
    window = image.gray_window(slice(2, 7), columns)
    np.testing.assert_array_equal(window, image.gray()[2:7, columns])


@pytest.mark.parametrize('encoding', [name for name in COLORED if name != '8UC3'])
def test_channels_are_those_of_the_colour_image(encoding):
    image = Image(noise(encoding), encoding)
    bgr = image.bgr()
    for place, channel in enumerate(('blue', 'green', 'red')):
        np.testing.assert_array_equal(image.seen_in(channel).gray(), bgr[..., place])
    np.testing.assert_array_equal(image.seen_in('brightest').gray(), bgr.max(axis=2))
    if ENCODINGS[encoding].colors is not None:
        expected = cv2.cvtColor(bgr, cv2.COLOR_BGR2GRAY)
        np.testing.assert_array_equal(image.seen_in('intensity').gray(), expected)


@pytest.mark.parametrize('encoding', ['mono8', 'mono16'])
def test_a_grey_image_is_itself_in_every_channel(encoding):
    image = Image(noise(encoding), encoding)
    assert all(image.seen_in(channel) is image for channel in CHANNELS)


def test_gamma_is_applied_to_the_values():
    image = Image(noise('bgr8'), 'bgr8')
    assert image.gamma_corrected(1.0) is image
    darker = image.gamma_corrected(2.0)
    expected = np.round((image.pixels / 255.0) ** 2 * 255).astype(np.uint8)
    np.testing.assert_array_equal(darker.pixels, expected)
    assert darker.encoding == 'bgr8'
