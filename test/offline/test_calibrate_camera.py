"""What a recording shows of a board, for the calibration and for people."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path

import cv2
import numpy as np
from support.board_video import BoardVideo
from support.boards import BOARD

from mvuav_ros.offline.calibrate_camera import search_board
from mvuav_ros.sources.opening import open_source


def test_the_pictures_of_a_camera_of_twelve_bits_are_not_black(tmp_path: Path) -> None:
    image = next(BoardVideo(4, places=1).images())
    cv2.imwrite(str(tmp_path / 'deep.png'), image.astype(np.uint16) * 16)
    with closing(open_source(str(tmp_path))) as source:
        search = search_board(source, BOARD, 1, 1.0)
    (picture,) = search.thumbnails
    assert picture.dtype == np.uint8
    assert picture.max() - picture.min() > 200
