"""sensor_msgs images to images and back, good and bad."""

import array
import sys

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sensor_msgs.msg import CompressedImage
from sensor_msgs.msg import Image as RosImage
from support.headers import make_header
from support.node_outputs import image_of

from mvuav_ros.messages.images import decode_compressed_image, decode_image
from mvuav_ros.vision.image import ENCODINGS, Image, ImageError

HEADER = make_header(5_000_000_007, 'nose')


def message(encoding, data, width, height, step=None, is_bigendian=0):
    data = np.ascontiguousarray(data)
    result = RosImage(
        header=HEADER,
        encoding=encoding,
        width=width,
        height=height,
        step=data.nbytes // height if step is None else step,
        is_bigendian=is_bigendian,
    )
    result.data = array.array('B', data.tobytes())
    return result


def random_pixels(encoding, height=6, width=8, seed=0):
    layout = ENCODINGS[encoding]
    shape = (height, width) if layout.channels == 1 else (height, width, layout.channels)
    high = np.iinfo(layout.dtype).max + 1
    return np.random.default_rng(seed).integers(0, high, shape).astype(layout.dtype)


@pytest.mark.parametrize('encoding', ENCODINGS)
def test_round_trip(encoding):
    pixels = random_pixels(encoding)
    encoded = image_of(Image(pixels, encoding), 5_000_000_007, 'nose')
    assert encoded.header == HEADER
    assert len(encoded.data) == pixels.nbytes
    decoded = decode_image(encoded)
    assert decoded.encoding == encoding
    np.testing.assert_array_equal(decoded.pixels, pixels)


@pytest.mark.parametrize('encoding', ENCODINGS)
def test_nothing_is_copied(encoding):
    encoded = image_of(Image(random_pixels(encoding), encoding), 5_000_000_007, 'nose')
    decoded = decode_image(encoded)
    before = decoded.pixels.ravel()[0]
    encoded.data[0] ^= 1
    assert decoded.pixels.ravel()[0] != before


@pytest.mark.parametrize('encoding', ENCODINGS)
@pytest.mark.parametrize('padding', [1, 4, 13])
def test_padded_rows(encoding, padding):
    pixels = random_pixels(encoding)
    rows = pixels.reshape(6, -1).view(np.uint8)
    padded = np.hstack([rows, np.full((6, padding), 77, np.uint8)])
    height = Image(pixels, encoding).height
    encoded = message(encoding, padded, 8, height, step=padded.shape[1])
    decoded = decode_image(encoded)
    np.testing.assert_array_equal(decoded.pixels, pixels)
    np.testing.assert_array_equal(decoded.gray(), Image(pixels, encoding).gray())


@pytest.mark.parametrize('encoding', ['mono16', '16UC1'])
def test_other_byte_order(encoding):
    pixels = random_pixels(encoding)
    swapped = message(
        encoding, pixels.byteswap(), 8, 6, is_bigendian=int(sys.byteorder == 'little')
    )
    np.testing.assert_array_equal(decode_image(swapped).pixels, pixels)


def test_colours_become_the_same_bgr_and_intensity():
    bgr = np.random.default_rng(1).integers(0, 256, (4, 6, 3), dtype=np.uint8)
    versions = {
        'bgr8': bgr,
        'rgb8': bgr[:, :, ::-1],
        'bgra8': np.dstack([bgr, np.full((4, 6), 9, np.uint8)]),
        'rgba8': np.dstack([bgr[:, :, ::-1], np.full((4, 6), 9, np.uint8)]),
    }
    expected = np.round(bgr @ np.array([0.114, 0.587, 0.299]))
    for encoding, pixels in versions.items():
        image = decode_image(message(encoding, pixels, 6, 4))
        np.testing.assert_array_equal(image.bgr(), bgr)
        assert np.abs(image.gray() - expected).max() <= 1
        np.testing.assert_array_equal(
            image.gray_window(slice(1, 3), slice(2, 5)), image.gray()[1:3, 2:5]
        )


@pytest.mark.parametrize(
    ('encoding', 'code'),
    [('yuv422', (1, 0, 2)), ('uyvy', (1, 0, 2)), ('yuv422_yuy2', (0, 1, 3)), ('yuyv', (0, 1, 3))],
)
def test_yuv_422(encoding, code):
    """A red and a dark grey pair; bytes of the pair's Y, U and V as the layout orders them."""
    y_at, u_at, v_at = code
    pair = np.zeros(4, np.uint8)
    pair[[y_at, y_at + 2]], pair[u_at], pair[v_at] = 81, 90, 240
    gray = np.zeros(4, np.uint8)
    gray[[y_at, y_at + 2]], gray[u_at], gray[v_at] = 60, 128, 128
    pixels = np.concatenate([pair, gray]).reshape(1, 4, 2)
    image = decode_image(message(encoding, pixels, 4, 1))
    np.testing.assert_array_equal(image.gray(), [[81, 81, 60, 60]])
    blue, green, red = image.bgr()[0, 0].astype(int)
    assert red > 240 and green < 15 and blue < 15


@pytest.mark.parametrize(
    ('encoding', 'top_left', 'red_at'),
    [
        ('bayer_rggb8', 'rggb', (0, 0)),
        ('bayer_bggr8', 'bggr', (1, 1)),
        ('bayer_gbrg8', 'gbrg', (1, 0)),
        ('bayer_grbg8', 'grbg', (0, 1)),
    ],
)
def test_bayer_patterns(encoding, top_left, red_at):
    mosaic = np.zeros((8, 8), np.uint8)
    mosaic[red_at[0] :: 2, red_at[1] :: 2] = 200
    blue, green, red = decode_image(message(encoding, mosaic, 8, 8)).bgr()[4, 4]
    assert (blue, green, red) == (0, 0, 200), top_left


@pytest.mark.parametrize(
    ('of', 'kind', 'encoding'),
    [
        ('bayer_rggb8', 'png', 'bayer_rggb8'),
        ('bayer_rggb8', 'jpeg', 'bayer_rggb8'),
        ('bayer_grbg16', 'png', 'bayer_grbg16'),
        ('bayer_grbg16', 'jpeg', 'bayer_grbg8'),
        ('bayer_plaid8', 'png', 'mono8'),
    ],
)
def test_a_compressed_mosaic_is_one(of, kind, encoding):
    """image_transport compresses it as it is, and says so in front of the semicolon."""
    is_deep = of.endswith('16') and kind == 'png'
    mosaic = np.zeros((8, 8), np.uint16 if is_deep else np.uint8)
    mosaic[::2, ::2] = 200
    data = cv2.imencode(f'.{kind}', mosaic)[1].tobytes()
    message = CompressedImage(format=f'{of}; {kind} compressed ', data=data)
    assert decode_compressed_image(message).encoding == encoding
    # Of a camera that has made colours of it before.
    data = cv2.imencode(f'.{kind}', np.zeros((8, 8, 3), np.uint8))[1].tobytes()
    message = CompressedImage(format=f'{of}; {kind} compressed bgr8', data=data)
    assert decode_compressed_image(message).encoding == 'bgr8'


def bad(changes):
    good = message('mono8', np.zeros((4, 6), np.uint8), 6, 4)
    for name, value in changes.items():
        setattr(good, name, value)
    return good


@pytest.mark.parametrize(
    ('changes', 'reason'),
    [
        ({'data': array.array('B', [0] * 23)}, 'needs 24 bytes'),
        ({'data': array.array('B', [0] * 25)}, 'needs 24 bytes'),
        ({'data': array.array('B')}, 'the message has 0'),
        ({'encoding': 'plaid8'}, 'unknown encoding'),
        ({'encoding': ''}, 'unknown encoding'),
        ({'encoding': 'x' * 10_000}, 'unknown encoding'),
        ({'width': 0}, 'empty'),
        ({'height': 0}, 'empty'),
        ({'width': 2**31, 'height': 2**31, 'step': 2**31}, 'megapixels'),
        ({'step': 3}, 'too short'),
        ({'step': 0}, 'too short'),
        ({'encoding': 'rgb8'}, 'too short'),
        ({'encoding': 'mono16'}, 'too short'),
    ],
)
def test_bad_images_are_refused_with_the_reason(changes, reason):
    with pytest.raises(ImageError, match=reason):
        decode_image(bad(changes))


@settings(max_examples=300, deadline=None)
@given(
    height=st.integers(0, 9),
    width=st.integers(0, 9),
    step=st.integers(0, 40),
    encoding=st.sampled_from([*ENCODINGS, 'plaid8', '']),
    is_bigendian=st.integers(0, 1),
    size=st.integers(0, 200),
)
def test_any_header_gives_a_image_or_an_image_error(
    height, width, step, encoding, is_bigendian, size
):
    made = RosImage(
        height=height, width=width, step=step, encoding=encoding, is_bigendian=is_bigendian
    )
    made.data = array.array('B', bytes(size))
    try:
        image = decode_image(made)
        assert image.gray().shape == (height, width)
        assert image.bgr().shape == (height, width, 3)
    except ImageError as error:
        assert str(error)


@pytest.mark.parametrize('kind', ['jpeg', 'png', 'mono8; jpeg compressed ', 'PNG'])
def test_compressed(kind):
    gray = cv2.GaussianBlur(random_pixels('mono8', 48, 64), (0, 0), 3)
    suffix = '.png' if 'png' in kind.lower() else '.jpg'
    data = cv2.imencode(suffix, gray)[1].tobytes()
    image = decode_compressed_image(CompressedImage(format=kind, data=data))
    assert image.encoding == 'mono8'
    assert np.abs(image.pixels.astype(int) - gray).max() <= (0 if suffix == '.png' else 8)


@pytest.mark.parametrize('encoding', ['mono16', 'bgr8', 'bgra8', 'bgr16', 'bgra16'])
def test_compressed_png_keeps_depth_and_colour(encoding):
    pixels = random_pixels(encoding)
    data = cv2.imencode('.png', pixels)[1].tobytes()
    image = decode_compressed_image(CompressedImage(format='png', data=data))
    assert image.encoding == encoding
    np.testing.assert_array_equal(image.pixels, pixels)


@pytest.mark.parametrize(
    ('kind', 'data', 'reason'),
    [
        ('jpeg', b'', 'do not decode'),
        ('jpeg', b'0123456789', '10 bytes'),
        ('png', b'\x89PNG\r\n\x1a\n' + bytes(40), 'do not decode'),
        ('16UC1; compressedDepth png', b'0123', 'holds distances'),
        ('h264', b'0123', 'no JPEG, PNG, WebP or TIFF .format .h264'),
        ('', b'0123', 'no JPEG, PNG, WebP or TIFF'),
    ],
)
def test_bad_compressed_images_are_refused_with_the_reason(kind, data, reason):
    with pytest.raises(ImageError, match=reason):
        decode_compressed_image(CompressedImage(format=kind, data=data))
