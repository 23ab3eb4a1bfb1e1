"""What a recording shows of a board, for the calibration and for people."""

from __future__ import annotations

import re
from contextlib import closing
from pathlib import Path

import cv2
import numpy as np
from support.board_video import BoardVideo
from support.boards import BOARD, LENSES, SIZE, views_of

from mvuav_ros.offline.calibrate_camera import extent, search_board
from mvuav_ros.sources.opening import open_source
from mvuav_ros.vision.camera_calibration import calibrate_camera


def test_the_pictures_of_a_camera_of_twelve_bits_are_not_black(tmp_path: Path) -> None:
    image = next(BoardVideo(4, places=1).images())
    cv2.imwrite(str(tmp_path / 'deep.png'), image.astype(np.uint16) * 16)
    with closing(open_source(str(tmp_path))) as source:
        search = search_board(source, BOARD, 1, 1.0)
    (picture,) = search.thumbnails
    assert picture.dtype == np.uint8
    assert picture.max() - picture.min() > 200


def test_a_calibration_says_where_no_view_shows_the_board() -> None:
    """Seven views that left the corners empty were wrong there by 13 px, without a word."""
    views, middle = views_of(LENSES['plumb_bob'], 200), np.array(SIZE) / 2
    inside = [each for each in views if (abs(each.pixels - middle) < 0.6 * middle).all()][:7]
    few = calibrate_camera(inside, SIZE)
    shown, missing = extent(inside, few).split(', but none ')
    missing, _, advice = missing.partition(': ')
    assert {'top left', 'top right'} <= {*missing.split(', ')}
    assert 'the lens is extrapolated' in advice
    reach, whole = map(int, re.findall(r'up to (\d+) of (\d+) degrees', shown)[0])
    assert reach < 0.7 * whole
    whole_image = extent(views[:40], calibrate_camera(views[:40], SIZE))
    assert whole_image.endswith('degrees off the axis')
