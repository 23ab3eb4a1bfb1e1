"""A camera's settings: asked for by V4L2 names, and compared with what it says."""

import cv2
import numpy as np
import pytest

from mvuav_ros.parameters.declaration import ParameterError
from mvuav_ros.parameters.video_source import VideoSourceParameters
from mvuav_ros.sources.source import SourceError
from mvuav_ros.sources.v4l2_camera import Camera


def fourcc(text):
    return sum(ord(letter) << 8 * place for place, letter in enumerate(text))


class Driver:
    """Stands for cv2.VideoCapture: a camera that has some sizes, one format and no gain."""

    SIZES = {640: 480, 1280: 720}

    def __init__(self, device):
        self.device, self.opened = device, True
        self.said = {
            cv2.CAP_PROP_FOURCC: fourcc('YUYV'),
            cv2.CAP_PROP_FRAME_WIDTH: 640,
            cv2.CAP_PROP_FRAME_HEIGHT: 480,
            cv2.CAP_PROP_FPS: 30.0,
            cv2.CAP_PROP_AUTO_EXPOSURE: 3,
            cv2.CAP_PROP_EXPOSURE: 157,
        }
        self.asked = []
        Driver.newest = self

    def isOpened(self):
        return self.opened

    def set(self, number, value):
        self.asked.append((number, value))
        if number == cv2.CAP_PROP_FOURCC and value not in map(fourcc, ('YUYV', 'MJPG', 'Y16 ')):
            return False
        if number == cv2.CAP_PROP_EXPOSURE and self.said[cv2.CAP_PROP_AUTO_EXPOSURE] != 1:
            return False
        if number == cv2.CAP_PROP_FPS:
            value = min(value, 29.97)
        if number == cv2.CAP_PROP_FRAME_WIDTH and value not in self.SIZES:
            return False
        if number == cv2.CAP_PROP_FRAME_WIDTH:
            self.said[cv2.CAP_PROP_FRAME_HEIGHT] = self.SIZES[value]
        elif number == cv2.CAP_PROP_FRAME_HEIGHT or number not in self.said:
            return False
        self.said[number] = value
        return True

    def get(self, number):
        return self.said.get(number, 0.0)

    def read(self):
        height, width = (int(self.said[n]) for n in (cv2.CAP_PROP_FRAME_HEIGHT, 3))
        return True, np.zeros((height, width, 3), np.uint8)

    def release(self):
        self.opened = False


@pytest.fixture(autouse=True)
def driver(monkeypatch):
    monkeypatch.setattr(cv2, 'VideoCapture', Driver)


def first(**settings):
    return next(Camera(0, VideoSourceParameters(**settings)).frames())


def test_nothing_is_asked_for_by_default():
    frame = first()
    assert (frame.image.width, frame.image.height) == (640, 480)
    assert frame.frame_id == 'camera_optical_frame'
    assert Driver.newest.asked == []


def test_a_gray_camera_that_says_nothing_of_itself(monkeypatch):
    monkeypatch.setattr(Driver, 'get', lambda *_: -1.0)
    monkeypatch.setattr(Driver, 'read', lambda _: (True, np.zeros((480, 640), np.uint8)))
    assert first().image.encoding == 'mono8'


def test_settings_are_made_in_an_order_that_drivers_take():
    camera = Camera(
        0,
        VideoSourceParameters(
            width=1280, height=720, fps=30.0, pixel_format='MJPG', exposure_time_absolute=80
        ),
    )
    frames = camera.frames()
    frame = next(frames)
    assert (frame.image.width, frame.image.height) == (1280, 720)
    numbers = [number for number, _ in Driver.newest.asked]
    assert numbers[0] == cv2.CAP_PROP_FOURCC
    assert numbers.index(cv2.CAP_PROP_AUTO_EXPOSURE) < numbers.index(cv2.CAP_PROP_EXPOSURE)
    assert camera.rate == 30.0
    frames.close()
    assert not Driver.newest.opened


@pytest.mark.parametrize(
    ('settings', 'words'),
    [
        ({'width': 1920, 'height': 1080}, 'width is 640, not 1920, height is 480, not 1080'),
        ({'fps': 120.0}, 'fps is 29.97, not 120'),
        ({'fps': 31.0}, None),
        ({'pixel_format': 'GREY'}, 'pixel_format is YUYV, not GREY'),
        ({'gain': 0}, None),
        ({'gain': 5}, 'gain is 0, not 5'),
    ],
)
def test_a_camera_that_does_something_else_is_not_used(settings, words):
    if words is None:
        first(**settings)
        return
    with pytest.raises(SourceError) as error:
        first(**settings)
    assert words in str(error.value) and 'v4l2-ctl' in str(error.value)
    assert not Driver.newest.opened


def test_a_pixel_format_has_four_letters():
    first(pixel_format='Y16 ')  # the last letter is a blank
    with pytest.raises(ParameterError, match='four letters'):
        VideoSourceParameters(pixel_format='mjpeg')
