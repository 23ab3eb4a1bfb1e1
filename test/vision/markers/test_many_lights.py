"""All lights of a frame at once are measured as each by itself."""

import cv2
import numpy as np
import pytest

from mvuav_ros.parameters.marker_tracker import MarkerTrackerParameters
from mvuav_ros.vision.image import Image
from mvuav_ros.vision.markers.lights import Blobs, CentroidMeter
from mvuav_ros.vision.markers.marker_results import Window


def crowd(seed, encoding):
    """Lights of all sizes, some touching, at the border, and a long thin line."""
    rng = np.random.default_rng(seed)
    image = (rng.random((200, 260)) * 120).astype(np.uint8)
    for x, y in rng.uniform((0, 0), (260, 200), (30, 2)):
        radius, level = rng.uniform(0.5, 7.0), int(rng.integers(190, 256))
        centre = (round(x * 16), round(y * 16))
        cv2.circle(image, centre, round(radius * 16), level, -1, cv2.LINE_8, 4)
    cv2.line(image, (10, 10), (150, 170), 255, 1)
    image = cv2.GaussianBlur(image, (0, 0), 0.8)
    return Image(image.astype(np.uint16) * 257 if encoding == 'mono16' else image, encoding)


def parameters(weighted):
    return MarkerTrackerParameters(mode='track_any', centroid='weighted' if weighted else 'binary')


@pytest.mark.parametrize('weighted', [True, False])
@pytest.mark.parametrize('encoding', ['mono8', 'mono16'])
@pytest.mark.parametrize('seed', range(4))
def test_all_at_once_is_one_by_one(seed, encoding, weighted):
    image = crowd(seed, encoding)
    blobs = Blobs(image.gray(), parameters(weighted))
    assert len(blobs.stats) > 10
    every = blobs.measure()
    for number, expected in enumerate(every):
        (alone,) = blobs.measure(np.array([number]))
        np.testing.assert_allclose(alone, expected, atol=1e-4)


@pytest.mark.parametrize('weighted', [True, False])
@pytest.mark.parametrize('encoding', ['mono8', 'mono16'])
def test_a_light_apart_from_others_is_measured_as_in_its_window(encoding, weighted):
    image = crowd(0, encoding)
    blobs, meter = Blobs(image.gray(), parameters(weighted)), CentroidMeter(image, 0.7, weighted)
    measured, compared = blobs.measure(), 0
    for (x, y, width, height, area), place in zip(blobs.stats.tolist(), measured, strict=True):
        window = max(x - 1, 0), min(x + width, 259), max(y - 1, 0), min(y + height, 199)
        spot = meter.measure(Window(*window))
        if spot.area == area:
            np.testing.assert_allclose(place, spot, atol=1e-4)
            compared += 1
    assert compared > 10


def test_no_light_at_all():
    image = Image(np.zeros((20, 20), np.uint8), 'mono8')
    blobs = Blobs(image.gray(), parameters(weighted=True))
    assert not len(blobs.stats) and not blobs.measure()


def test_a_line_is_no_light():
    image = np.zeros((200, 260), np.uint8)
    cv2.circle(image, (60, 120), 4, 255, -1)
    cv2.line(image, (10, 10), (150, 170), 255, 1)
    cv2.line(image, (200, 20), (200, 90), 255, 2)
    blobs = Blobs(image, parameters(weighted=True))
    assert len(blobs.stats) == 3
    assert blobs.may_be_lights().tolist() == [blobs.stats[:, 3].argmin()]
