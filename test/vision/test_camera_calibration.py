"""Cameras from views of a board, against the cameras that the views were made with."""

from itertools import cycle

import cv2
import numpy as np
import pytest
from support.boards import BOARD, LENSES, SIZE, view_of, views_of

from mvuav_ros.vision.board import BoardView
from mvuav_ros.vision.camera import CalibrationError, CameraModel
from mvuav_ros.vision.camera_calibration import calibrate_camera


@pytest.mark.parametrize('model', LENSES)
def test_the_camera_is_found_and_its_model(model):
    true = LENSES[model]
    for seed in (1,):
        found = calibrate_camera(views_of(true, 50, seed=seed), SIZE)
        assert found.camera.distortion_model == model
        k, wanted = np.array(found.camera.k), np.array(true.k)
        assert k[[0, 4]] == pytest.approx(wanted[[0, 4]], rel=0.003)
        assert k[[2, 5]] == pytest.approx(wanted[[2, 5]], abs=1.0)
        assert found.rms == pytest.approx(0.2, rel=0.05)
        # Within what it says of itself: four deviations hold 99.99 %.
        error = np.abs(k[[0, 4, 2, 5]] - wanted[[0, 4, 2, 5]])
        assert (error < 4 * np.array(found.deviations[:4])).all()


def test_a_wide_camera_held_upright_is_found():
    size, k = (360, 640), (210, 0, 178, 0, 210, 322, 0, 0, 1)
    camera = CameraModel(*size, k, (0.05, -0.01, 0, 0), 'equidistant')
    rng = np.random.default_rng(2)
    turns = [(0.6, 0.2, 0.1), (-0.6, 0.1, 0), (0.1, 0.6, -0.2), (0, -0.6, 0.3)]
    heights = [-0.5, -0.25, 0.25, 0.5]
    views = [view_of(camera, t, (0, y, 0.3), 0.1, rng) for t in turns for y in heights]
    found = calibrate_camera(views, size).camera
    assert found.distortion_model == 'equidistant'
    assert found.k == pytest.approx(k, rel=0.01)


@pytest.mark.parametrize('count', [5, 6, 7])
def test_a_few_views_of_a_wide_lens_are_fitted_with_no_narrow_one(count):
    true = LENSES['equidistant']
    wide = CameraModel(*SIZE, (270, 0, 315, 0, 271, 243, 0, 0, 1), true.d, 'equidistant')
    found = calibrate_camera(views_of(wide, count, noise=0.05), SIZE)
    assert found.rms < 0.1
    assert found.camera.k[0] == pytest.approx(270, rel=0.01)


def views_beside(true, count):
    """Of a board that reaches farther than 90 degrees off the axis, at either side."""
    rng = np.random.default_rng(1)
    for side, (low, turned, up) in zip(
        cycle((-1.0, 1.0)), rng.normal(size=(count, 3)), strict=False
    ):
        # OpenCV's model shows a corner 100 degrees off the axis at 80 on the other side.
        turn = np.array((0.1 * turned, 1.2 * side, 0.1 * up))
        place = np.array((0.2 * side, 0.05 * low, 0.06))
        middle = BOARD.points.mean(axis=0)
        x, y, z = ((BOARD.points - middle) @ cv2.Rodrigues(turn)[0].T + place).T
        angle, aside = np.arctan2(np.hypot(x, y), z), np.hypot(x, y)
        assert np.degrees(angle.max()) > 95
        bent = sum(c * angle**p for c, p in zip((1.0, *true.d), (1, 3, 5, 7, 9), strict=True))
        pixels = np.column_stack((318 + 200 * bent * x / aside, 241 + 200 * bent * y / aside))
        yield BoardView(BOARD.points, pixels, pixels[[0, 8, -1, -9]])


def test_corners_beside_the_camera_spoil_no_fisheye():
    k = (200, 0, 318, 0, 200, 241, 0, 0, 1)
    true = CameraModel(*SIZE, k, (0.03, -0.01, 0.004, -0.001), 'equidistant')
    views = views_of(true, 16, noise=0.1)
    found = calibrate_camera([*views, *views_beside(true, 2)], SIZE)
    assert found.camera.distortion_model == 'equidistant'
    assert np.flatnonzero(~found.used).tolist() == [16, 17]
    assert found.camera.k == pytest.approx(k, rel=0.005)
    # Too many to be left out; the words were about the tilt.
    with pytest.raises(CalibrationError, match='farther than 90 degrees off the axis'):
        calibrate_camera([*views, *views_beside(true, 8)], SIZE, 'equidistant')


def test_the_deviations_are_those_of_repeated_calibrations():
    true = LENSES['equidistant']
    found = [calibrate_camera(views_of(true, 12, seed=s), SIZE, 'equidistant') for s in range(16)]
    focal = np.array([each.camera.k[0] for each in found])
    told = np.array([each.deviations[0] for each in found])
    scores = (focal - true.k[0]) / told
    # Of 16 standard normal numbers, at 99.9 %.
    assert 0.4 < np.sqrt(np.mean(scores**2)) < 1.65


def test_a_rational_lens_needs_a_rational_model():
    d = (0.3, -0.1, 0.0, 0.0, 0.02, 0.6, 0.05, 0.01)
    true = type(LENSES['plumb_bob'])(*SIZE, (330, 0, 320, 0, 330, 240, 0, 0, 1), d)
    found = calibrate_camera(views_of(true, 40), SIZE, 'rational_polynomial')
    assert found.camera.distortion_model == 'rational_polynomial'
    assert len(found.camera.d) == 8
    assert found.camera.k[0] == pytest.approx(330, rel=0.005)


def test_a_blurred_view_is_left_out():
    views = views_of(LENSES['plumb_bob'], 20)
    rng = np.random.default_rng(5)
    bad = views[7]
    views[7] = BoardView(bad.points, bad.pixels + rng.normal(0, 4, bad.pixels.shape), bad.outline)
    found = calibrate_camera(views, SIZE)
    assert np.flatnonzero(~found.used).tolist() == [7]
    assert found.rms < 0.25


@pytest.mark.parametrize('tilt', [(0, 0), (0, 1)])
def test_views_parallel_to_the_image_are_refused(tilt):
    with pytest.raises(CalibrationError, match=r'do not determine the focal length.*tilted'):
        calibrate_camera(views_of(LENSES['plumb_bob'], 10, tilt=tilt), SIZE, 'plumb_bob')


def test_views_that_only_move_aside_are_refused():
    rng = np.random.default_rng(3)
    views = [
        view_of(LENSES['plumb_bob'], (0.5, 0.1, 0), (x, y, 0.5), 0.2, rng)
        for x in (-0.05, 0, 0.05)
        for y in (-0.03, 0, 0.03)
    ]
    with pytest.raises(CalibrationError, match='do not determine the focal length'):
        calibrate_camera(views, SIZE)


def test_views_of_which_opencv_finds_no_pose_are_refused(monkeypatch):
    monkeypatch.setattr(cv2, 'solvePnP', lambda *_, **__: (False, None, None))
    with pytest.raises(CalibrationError, match='no equidistant camera fits the views'):
        calibrate_camera(views_of(LENSES['equidistant'], 12), SIZE, 'equidistant')


def test_four_views_are_refused():
    with pytest.raises(CalibrationError, match='4 different views of the board are too few'):
        calibrate_camera(views_of(LENSES['plumb_bob'], 4), SIZE)
