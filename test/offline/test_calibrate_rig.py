"""Whose calibration a rig is calibrated with."""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace
from pathlib import Path

import cv2
import pytest

from mvuav_ros.messages.images import Frame
from mvuav_ros.offline.calibrate_rig import name_lights
from mvuav_ros.parameters.marker_tracker import MarkerTrackerParameters
from mvuav_ros.sources.opening import open_source
from mvuav_ros.sources.source import SourceError
from mvuav_ros.vision.rig import TANKER_747


@pytest.mark.parametrize('is_rectified', [False, True])
def test_images_that_are_rectified_are_taken_as_such(is_rectified: bool) -> None:
    parameters = MarkerTrackerParameters(image_is_rectified=is_rectified)
    with closing(open_source('sim:tanker?frames=2&motion=still')) as source:
        (frame, *_) = source.frames()
        assert frame.camera is not None
        k = frame.camera.k
        bent = replace(frame.camera, d=(1e-4, 0, 0, 0, 0), p=(*k[:3], 0, *k[3:6], 0, *k[6:], 0))
        _, used, _ = name_lights(source, TANKER_747, bent, parameters, lambda _: None)
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
