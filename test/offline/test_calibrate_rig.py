"""Whose calibration a rig is calibrated with."""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from mvuav_ros.messages.images import Frame
from mvuav_ros.offline.calibrate_rig import name_lights
from mvuav_ros.parameters.marker_tracker import MarkerTrackerParameters
from mvuav_ros.simulation.light_drawing import Light, add_lights
from mvuav_ros.sources.opening import open_source
from mvuav_ros.sources.source import FrameSource, SourceError
from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.frames import OPTICAL_FROM_BODY
from mvuav_ros.vision.image import Image
from mvuav_ros.vision.rig import TANKER_747

CAMERA = CameraModel(640, 480, (600, 0, 319.5, 0, 600, 239.5, 0, 0, 1))


@pytest.mark.parametrize('is_rectified', [False, True])
def test_images_that_are_rectified_are_taken_as_such(is_rectified: bool) -> None:
    parameters = MarkerTrackerParameters(image_is_rectified=is_rectified)
    with closing(open_source('sim:tanker?frames=2&motion=still')) as source:
        (frame, *_) = source.frames()
        assert frame.camera is not None
        k = frame.camera.k
        bent = replace(frame.camera, d=(1e-4, 0, 0, 0, 0), p=(*k[:3], 0, *k[3:6], 0, *k[6:], 0))
        used, _ = name_lights(source, TANKER_747, bent, parameters, lambda _: None)
    assert used == (bent.rectified() if is_rectified else bent)


def test_images_of_another_size_in_the_middle_are_refused(tmp_path: Path) -> None:
    with closing(open_source('sim:tanker?frames=2&motion=still')) as source:
        for number, frame in enumerate(source.frames()):
            assert isinstance(frame, Frame)
            pixels = frame.image.pixels[number * 240 :]
            cv2.imwrite(str(tmp_path / f'{number}.png'), pixels)
    with closing(open_source(str(tmp_path))) as source:
        given = source, TANKER_747, frame.camera, MarkerTrackerParameters(), lambda _: None
        with pytest.raises(SourceError, match='for 640 x 480 px, the images are 640 x 240 px'):
            name_lights(*given)


class SlidingOut(FrameSource):
    """The tanker's lights move to the left, until the border cuts the left wing's off."""

    places = CAMERA.project(
        np.concatenate(
            [
                TANKER_747.positions @ OPTICAL_FROM_BODY.T + (x, 0, 90)
                for x in np.linspace(-10.0, -11.5, 16)
            ]
        )
    ).reshape(-1, 5, 2)

    def frames(self):
        for number, places in enumerate(self.places):
            pixels = np.full((480, 640), 60, np.uint8)
            add_lights(pixels, [Light(6.0, place[None]) for place in places])
            yield Frame(number * 33_000_000, 'camera', Image(pixels, 'mono8'))


def test_lights_that_the_border_cuts_off_are_not_measured() -> None:
    given = SlidingOut(), TANKER_747, CAMERA, MarkerTrackerParameters(), lambda _: None
    _, pixels = name_lights(*given)
    assert pixels.shape == (16, 5, 2) and 70 < np.isfinite(pixels[..., 0]).sum() < 80
    assert np.nanmax(np.abs(pixels - SlidingOut.places)) < 0.05
