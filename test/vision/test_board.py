"""Boards found in images, and views that differ."""

import os
import subprocess
import sys

import cv2
import numpy as np
import pytest
from support.board_video import BoardVideo
from support.boards import BOARD, LENSES, SIZE, view_of
from support.places import ROOT

from mvuav_ros.sources.files import VideoFile
from mvuav_ros.vision.board import Board, BoardError, different_views, sharpness
from mvuav_ros.vision.camera import CameraModel

NO_ARUCO = not hasattr(cv2, 'aruco')


def rendered(seed, lens=None):
    """An image of a still board without noise of its corners, and where they are."""
    video = BoardVideo(seed, places=1, corner_noise=0.0, lens=lens)
    pose, _ = next(video.poses())
    return next(video.images()), video.camera.project(video.corners, pose[:3], pose[3:])


def error(view, true):
    """The board may be taken for one that is turned by half a turn."""
    return min(np.abs(view.pixels - order).max() for order in (true, true[::-1]))


def test_corners_are_found_to_a_tenth_of_a_pixel():
    image, true = rendered(4)
    view = BOARD.find(image)
    assert error(view, true) < 0.15
    # In an image that is searched at a smaller size the corners are those of the whole image.
    large = cv2.resize(image, None, fx=3, fy=3, interpolation=cv2.INTER_CUBIC)
    assert error(BOARD.find(large), 3 * (true + 0.5) - 0.5) < 0.45
    deep = BOARD.find(image.astype(np.uint16) * 40)
    assert error(deep, true) < 0.15


def test_corners_are_found_through_a_lens_that_sees_what_is_beside_it():
    k = (200, 0, 318, 0, 200, 241, 0, 0, 1)
    image, true = rendered(4, CameraModel(*SIZE, k, (0.03, -0.01, 0, 0), 'equidistant'))
    assert error(BOARD.find(image), true) < 0.15


def test_an_image_without_a_board_has_none():
    rng = np.random.default_rng(1)
    assert BOARD.find(np.full((480, 640), 90, np.uint8)) is None
    assert BOARD.find(rng.integers(0, 256, (240, 320)).astype(np.uint8)) is None


@pytest.mark.parametrize('shape', [(1, 2000), (2000, 1), (1, 1)])
def test_an_image_of_one_row_has_none(shape):
    line = np.full(shape, 90, np.uint8)
    assert BOARD.find(line) is None and sharpness(line) == 0.0


def charuco_picture(rows, side):
    """A board of 9 by so many inner corners, with so many px along a square."""
    aruco = cv2.aruco
    dictionary = aruco.getPredefinedDictionary(aruco.DICT_5X5_100)
    sides = (10, rows + 1), 0.03, 0.75 * 0.03, dictionary
    drawn = (10 * side, (rows + 1) * side)
    if hasattr(aruco, 'CharucoBoard_create'):
        return aruco.CharucoBoard_create(*sides[0], *sides[1:]).draw(drawn)
    return aruco.CharucoBoard(*sides).generateImage(drawn)


@pytest.mark.skipif(NO_ARUCO, reason='this OpenCV has no aruco')
@pytest.mark.parametrize('rows', [6, 7])
def test_a_charuco_board_is_found_in_part_as_well(rows):
    board = Board(9, rows, 0.03, 'DICT_5X5_100')
    image = np.pad(charuco_picture(rows, 60), 40, constant_values=255)
    view = board.find(image)
    assert len(view.points) == 9 * rows
    assert view.pixels[0] == pytest.approx((99.5, 99.5), abs=0.3)
    part = board.find(image[:, :420])
    assert 12 <= len(part.points) < 9 * rows
    # The same corner of the board in both.
    assert part.pixels[0] == pytest.approx(view.pixels[0], abs=0.3)
    assert (part.points[0] == view.points[0]).all()


def test_boards_that_cannot_be():
    with pytest.raises(BoardError, match='too few'):
        Board(9, 1, 0.03)
    with pytest.raises(BoardError, match='9x2 inner corners are too few: 3x3 at least'):
        Board(9, 2, 0.03)
    with pytest.raises(BoardError, match='too few: 12 in two rows at least'):
        Board(5, 2, 0.03, 'DICT_5X5_100')
    assert Board(3, 3, 0.03).find(np.full((100, 100), 90, np.uint8)) is None
    with pytest.raises(BoardError, match='write metres'):
        Board(9, 6, 0.0)
    with pytest.raises(BoardError, match='squares of 30 m cannot be; write metres'):
        Board(9, 6, 30.0)
    with pytest.raises(BoardError, match=r'no ArUco dictionary|has no aruco'):
        Board(9, 6, 0.03, 'DICT_NONE')


@pytest.mark.skipif(NO_ARUCO, reason='this OpenCV has no aruco')
def test_the_markers_of_a_charuco_board_draw_no_corner_aside():
    # Seen obliquely, at four times the resolution.
    picture = np.pad(charuco_picture(6, 160), 160, constant_values=255)
    plane = np.array([(1.7, 0.3, 200.0), (-0.3, 1.5, 500.0), (2e-4, 2e-4, 1.0)])
    fine = cv2.warpPerspective(picture, plane, (2560, 1920), borderValue=110)
    image = cv2.resize(fine, (640, 480), interpolation=cv2.INTER_AREA)
    view = Board(9, 6, 0.03, 'DICT_5X5_100').find(image)
    corners = (view.points[:, :2] / 0.03 + 2) * 160 - 0.5
    true = cv2.perspectiveTransform(corners[None], plane)[0]
    assert np.abs(view.pixels - ((true + 0.5) / 4 - 0.5)).max() < 0.3


@pytest.mark.skipif(NO_ARUCO, reason='this OpenCV has no aruco')
def test_a_charuco_board_has_no_more_markers_than_its_dictionary():
    with pytest.raises(BoardError, match='56 markers, and DICT_4X4_50 has 50'):
        Board(13, 7, 0.03, 'DICT_4X4_50')
    # 14 x 7 squares have 49.
    assert Board(13, 6, 0.03, 'DICT_4X4_50').find(np.full((100, 100), 90, np.uint8)) is None


def test_views_that_differ_are_chosen_and_those_alike_are_not():
    camera = LENSES['plumb_bob']
    places = (-0.1, -0.05, 0.0, 0.05, 0.1)
    views = [view_of(camera, (0.3, 0, 0), (x, 0, 0.6)) for x in places for _ in range(3)]
    chosen = different_views(views, SIZE, 20, 0.03)
    assert sorted(index // 3 for index in chosen) == [0, 1, 2, 3, 4]
    assert len(different_views(views, SIZE, 3, 0.03)) == 3
    assert different_views(views[:3], SIZE, 20, 0.03) in ([0], [1], [2])


def test_the_video_of_the_tutorial_shows_the_board(tmp_path):
    flight, video = 'sim:tanker?fov_deg=60&frames=1', tmp_path / 'board.mp4'
    command = [sys.executable, 'tools/render_board_video.py', flight, video]
    environment = {**os.environ, 'PYTHONPATH': str(ROOT)}
    out = subprocess.check_output(command, cwd=ROOT, env=environment, text=True)
    assert out.startswith('true focal length 554.3 554.3,')
    source = VideoFile(video)
    assert source.count == 20 * 8
    stills = [frame.image.gray() for frame in source.frames()][::8]
    assert sum(BOARD.find(image) is not None for image in stills) >= 10
