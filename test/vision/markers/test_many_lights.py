"""All lights of a frame at once are measured as each by itself."""

import cv2
import numpy as np
import pytest

from mvuav_ros.parameters.marker_tracker import MarkerTrackerParameters
from mvuav_ros.vision.image import Image
from mvuav_ros.vision.markers.centroid import CentroidMeter, cutter
from mvuav_ros.vision.markers.lights import Blobs


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


@pytest.mark.parametrize('weighted', [True, False])
@pytest.mark.parametrize('encoding', ['mono8', 'mono16'])
@pytest.mark.parametrize('seed', range(4))
def test_all_at_once_is_one_by_one(seed, encoding, weighted):
    image = crowd(seed, encoding)
    blobs = Blobs(image.gray(), MarkerTrackerParameters(mode='track_any'))
    assert len(blobs) > 10
    meter = CentroidMeter(0.7, weighted)
    one_by_one = [blobs.measure(blob, cutter(image), meter)[:3] for blob in blobs.boxes]
    np.testing.assert_allclose(blobs.measure_all(0.7, weighted), one_by_one, atol=1e-5)


def test_no_light_at_all():
    image = Image(np.zeros((20, 20), np.uint8), 'mono8')
    blobs = Blobs(image.gray(), MarkerTrackerParameters(mode='track_any'))
    assert blobs.measure_all(0.7, True).shape == (0, 3)
